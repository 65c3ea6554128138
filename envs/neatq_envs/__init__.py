"""Worlds for neuroevolution and reinforcement learning.

Robots, walls and a flag, benchmark tasks with known answers, and any Gymnasium task in rows. They
know nothing of genomes or learning. Importing this package tells Gymnasium about its tasks, so
that `gymnasium.make("neatq_envs:neatq/MountainCar-v0")` needs no other import.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

import gymnasium

from neatq_envs.checks import ScenarioError
from neatq_envs.episodes import EpisodeError
from neatq_envs.gymnasium_task import GymnasiumTask, TaskError
from neatq_envs.scenario import TASKS, Scenario, find_scenario

if TYPE_CHECKING:
    from neatq_envs.pettingzoo_env import TeamEnv
    from neatq_envs.torchrl_env import ArenaEnv
    from neatq_envs.torchrl_rows import GymnasiumRows

__all__ = ["TASKS", "EpisodeError", "GymnasiumTask", "Scenario", "ScenarioError", "TaskError"]
__all__ += ["ArenaEnv", "GymnasiumRows", "TeamEnv", "find_scenario"]
_LAZY = {"ArenaEnv": "torchrl_env", "GymnasiumRows": "torchrl_rows", "TeamEnv": "pettingzoo_env"}
"""What takes seconds to import, and where it is."""

# Of each id: module and name of its classes (+ "Env", + "VectorEnv"), the steps after which an
# episode is cut off (None: it ends by itself, or the task cuts it off), arguments of the classes.
_TASKS: dict[str, tuple[str, int | None, dict[str, Any]]] = {
    "neatq/DoublePole-v0": ("double_pole:DoublePole", 100_000, {}),
    "neatq/DoublePoleNoVelocities-v0": ("double_pole:DoublePole", 100_000, {"velocities": False}),
    "neatq/MountainCar-v0": ("mountain_car:MountainCar", 1_000, {}),
    "neatq/ServerJobs-v0": ("server_jobs:ServerJobs", None, {}),
}
# Scenario "moving" is one draw of these flags, of which an episode would see but the first.
_ANYWHERE = {"name": "moving", "flag": {"ring": [100, 250]}}
_SCENARIOS = {"Flag": "flag", "Moving": _ANYWHERE, "Wall": "wall", "Trap": "trap"}
_SCENARIOS |= {"Maze": "maze", "Switch": "switch", "Behind": "behind"}
for _name, _own in _SCENARIOS.items():
    _TASKS[f"neatq/{_name}-v0"] = "robot:Robot", None, {"scenario": _own, "reward": "progress"}


def register_all() -> None:
    """Tell Gymnasium about all tasks; calling it again changes nothing."""
    for name, (place, steps, kwargs) in _TASKS.items():
        if name not in gymnasium.registry:
            gymnasium.register(
                name,
                entry_point=f"neatq_envs.{place}Env",
                vector_entry_point=f"neatq_envs.{place}VectorEnv",
                max_episode_steps=steps,
                kwargs=dict(kwargs),
            )


register_all()


def __getattr__(name: str) -> Any:
    if name not in _LAZY:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_LAZY[name]}"), name)
