"""Teams of run folders: the robots of a run, with what they had learnt."""

from __future__ import annotations

from bisect import bisect
from itertools import chain
from pathlib import Path

from neatq_torch.genome import Genome, unpack_genomes
from neatq_torch.kinds import ConfigError
from neatq_torch.network import Evaluation, PopulationNetwork
from neatq_trainers.folder import load_run
from neatq_trainers.nero.nero_world import NERO, NeroConfig
from neatq_trainers.nero.teams import Team, read_team, team_of_run
from neatq_trainers.run import State
from neatq_trainers.saved import restoring


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
    firsts = config.first_arenas(len(state["runs"]))
    part = bisect(firsts, arena) - 1
    with restoring(path):
        genomes = _learnt(state["runs"][part], config.network.evaluation, arena - firsts[part])
    return team_of_run(config, genomes, name)


def _learnt(state: State, evaluation: Evaluation, arena: int) -> list[Genome]:
    """The genomes of an arena with what their robots have learnt."""
    populations = [unpack_genomes(one["genomes"]) for one in state["populations"]]
    network = PopulationNetwork(list(chain(*populations)), evaluation=evaluation)
    network.load_weights(state["weight"])
    first = sum(map(len, populations[:arena]))
    return [network.genome(first + slot) for slot in range(len(populations[arena]))]
