"""Lives and battles as one file: the page of the training window with all that it plays."""

from __future__ import annotations

import base64
import json
import re
import struct
from typing import Any

import numpy as np
from tensordict import TensorDictBase
from torch import Tensor

from neatq_envs.random_play import EnvFacts
from neatq_torch.kinds import ConfigError
from neatq_trainers.build import build
from neatq_trainers.callbacks import Callback
from neatq_trainers.folder import RunFolder
from neatq_trainers.live.messages import CHANNELS, PAGE, Clip
from neatq_trainers.live.scene import Scene
from neatq_trainers.loop import strides
from neatq_trainers.nero.match import Film
from neatq_trainers.run import Run

TICKS_PER_SECOND = 60
"""Of a recording, when somebody opens it."""
TICKS_PER_FRAME = 4
FRAMES_PER_CLIP = 25
_NOTHING: dict[str, Any] = {
    "type": "hello",
    "can": [],
    "curves": [],
    "exploration": {},
    "weights": {},
    "saved": [],
    "opponents": [],
    "rows": [],
    "species": [],
}
"""What a recording has nothing of."""


class _Recorder(Callback):
    """Keeps the clips of a run."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.clips: list[Clip] = []

    def batch(self, run: Run, batch: TensorDictBase, error: Tensor) -> None:
        self.scene.see(batch, error)
        ticks = batch.shape[-1]
        self.clips.append(self.scene.clip(ticks / TICKS_PER_SECOND, min(TICKS_PER_FRAME, ticks)))

    def advance(self, run: Run, newborn: Tensor) -> None:
        self.scene.note_births()


def record_life(folder: RunFolder, ticks: int) -> dict[str, Any]:
    """What a run does in its next ticks, as the page plays it; the folder stays as it is.

    Raises:
        ConfigError: If its world has no field.
        CheckpointError: If the run is damaged.
    """
    state = folder.read()
    config = folder.config.split(len(state["runs"]))[0]
    facts = None if state["facts"] is None else EnvFacts.from_dict(state["facts"])
    run = build(config, state["runs"][0], facts=facts)
    try:
        scene = Scene(run)
        if not scene.has_field:
            raise ConfigError(
                f"html: {config.task} has no field; a champion's episode is in champion.gif"
            )
        scene.look()
        recorder, first = _Recorder(scene), run.tick
        for stride in strides(run, [recorder]):
            if stride.tick >= first + ticks:
                break
        robots = {str(slot): scene.robot(slot) for slot in range(run.shape[1])}
        hello = _NOTHING | scene.introduction() | _titles(config.task, config.arm, config.seed)
        hello["state"] = _state(run.world.env.arena.scenario.to_dict())
        return _packed(hello, recorder.clips) | {"robots": robots}
    finally:
        run.world.close()


def record_battle(film: Film, names: tuple[str, str]) -> dict[str, Any]:
    """A battle between two teams, as the page plays it."""
    facts = {
        "world": "nero",
        "robots": len(film.team),
        "channels": ["x", "y", "heading_rad", *CHANNELS],
        "colours": [{"name": "hit points", "channel": 3 + CHANNELS.index("hit_points")}],
        "observations": [],
        "actions": [],
        "sensors": None,
    }
    hello = _NOTHING | facts | _titles(" against ".join(names), "battle", 0)
    hello["state"] = _state(film.scenario.to_dict())
    return _packed(hello, _clips_of(film))


def page_with(recording: dict[str, Any]) -> str:
    """The page as one text of HTML that plays a recording, with nothing from anywhere else."""
    page = (PAGE / "index.html").read_text(encoding="utf-8")
    found = re.search(r"<!-- modules: (.*) -->", page)
    assert found is not None
    modules = (_bare((PAGE / name).read_text(encoding="utf-8")) for name in found[1].split())
    style = (PAGE / "style.css").read_text(encoding="utf-8")
    data = json.dumps(recording, allow_nan=False).replace("<", "\\u003c")
    parts = {
        '<link rel="stylesheet" href="page/style.css">': f"<style>\n{style}</style>",
        '<script type="module" src="page/main.js"></script>': (
            f'<script id="recording" type="application/json">{data}</script>\n'
            f'<script type="module">\n{"".join(modules)}</script>'
        ),
        found[0]: "",
    }
    for tag, text in parts.items():
        assert page.count(tag) == 1, tag
        page = page.replace(tag, text)
    return page


def _bare(module: str) -> str:
    """A module without imports and exports, to stand beside the others in one script."""
    lines = (line for line in module.splitlines(keepends=True) if not line.startswith("import "))
    return "".join(line.removeprefix("export ") for line in lines)


def _titles(task: str, arm: str, seed: int) -> dict[str, Any]:
    return {"task": task, "arm": arm, "seed": seed, "folder": ""}


def _state(scenario: dict[str, Any]) -> dict[str, Any]:
    return {
        "tick": 0,
        "paused": False,
        "over": False,
        "ticks_per_second": TICKS_PER_SECOND,
        "scenario": scenario,
        "weights": {},
        "exploration": {},
        "protected": [],
        "preferred": [],
        "undo": 0,
    }


def _packed(hello: dict[str, Any], clips: list[Clip]) -> dict[str, Any]:
    parts = [clip.pack() for clip in clips]
    joined = b"".join(struct.pack("<I", len(one)) + one for one in parts)
    text = base64.b64encode(joined).decode()
    hello["length"] = {"unit": "ticks", "total": None}
    return {"hello": hello, "ticks_per_second": TICKS_PER_SECOND, "base64": text}


def _clips_of(film: Film) -> list[Clip]:
    frames = np.arange(0, len(film.pose), TICKS_PER_FRAME)
    poses = np.where(film.hit_points[..., None] >= 0, film.pose, np.nan).astype(np.float32)
    return [
        _film_clip(film, poses, frames[first : first + FRAMES_PER_CLIP])
        for first in range(0, len(frames), FRAMES_PER_CLIP)
    ]


def _film_clip(film: Film, poses: np.ndarray, frames: np.ndarray) -> Clip:
    robots = np.full((len(film.team), len(CHANNELS)), np.nan, np.float32)
    columns = dict(zip(CHANNELS, robots.T, strict=True))
    columns["hit_points"][:], columns["team"][:] = film.hit_points[frames[-1]], film.team
    columns["alive"][:] = film.hit_points[frames[-1]] >= 0
    return Clip(
        tick=int(frames[0]),
        ticks_per_frame=TICKS_PER_FRAME,
        seconds=len(frames) * TICKS_PER_FRAME / TICKS_PER_SECOND,
        poses=poses[frames],
        robots=robots,
        flags=np.zeros((len(frames), 0, 3), np.float32),
        shots=_shots(film, int(frames[0]), int(frames[-1]) + TICKS_PER_FRAME),
    )


def _shots(film: Film, first: int, end: int) -> np.ndarray:
    """Those of some ticks, see `Clip`."""
    tick, robot = np.nonzero(film.shot[first:end] >= 0)
    pose, target = film.pose[first:end], film.shot[first:end][tick, robot]
    columns = tick // TICKS_PER_FRAME, pose[tick, robot, :2], pose[tick, target, :2]
    return np.column_stack([*columns, film.team[robot]]).astype(np.float32)
