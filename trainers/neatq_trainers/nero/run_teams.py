"""Teams of run folders: the robots of a run, with what they had learnt."""

from __future__ import annotations

from bisect import bisect
from pathlib import Path

from neatq_torch.kinds import ConfigError
from neatq_trainers.build import build
from neatq_trainers.folder import load_run
from neatq_trainers.nero.nero_world import NERO, NeroConfig
from neatq_trainers.nero.teams import Team, present_team, read_team


def find_team(path: Path | str) -> Team:
    """The team of an OpenNERO file, or of a run: of arena 0 of a folder, of arena N of FOLDER:N.

    Raises:
        ConfigError: In one sentence, if there is none. `TeamFileError` is one, too.
        RunFolderError: If there is no run in the folder.
        CheckpointError: If the run is damaged.
    """
    folder, colon, arena = str(path).rpartition(":")
    if colon and arena.isdecimal() and Path(folder).is_dir():
        return _run_team(Path(folder), int(arena), f"{Path(folder).resolve().name}:{arena}")
    path = Path(path)
    return _run_team(path, 0, path.resolve().name) if path.is_dir() else read_team(path)


def _run_team(path: Path, arena: int, name: str) -> Team:
    folder = load_run(path)
    config = folder.config
    if not isinstance(config.world, NeroConfig):
        raise ConfigError(f"{path}: expected a run of --task {NERO}, got one of {config.task}")
    if config.network.double_activation:
        raise ConfigError(f"{path}: networks that are activated twice a tick know no battle")
    state = folder.read()
    if arena >= config.arenas:
        raise ConfigError(f"{path}: expected an arena below {config.arenas}, got {arena}")
    parts = len(state["runs"])
    part = bisect(config.first_arenas(parts), arena) - 1
    run = build(config.split(parts)[part], state["runs"][part])
    if run.network is None:
        raise ConfigError(f"{path}: the arm {config.arm} has tables instead of networks")
    return present_team(run, arena - config.first_arenas(parts)[part], name)
