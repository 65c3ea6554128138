"""What Gymnasium knows our tasks by: `gymnasium.make("neatq/...")` after `import neatq_envs`."""

from __future__ import annotations

from typing import NamedTuple

import gymnasium


class Task(NamedTuple):
    """A task in Gymnasium's registry.

    Attributes:
        name: its id.
        env: "module:class" of the environment of one row.
        vector_env: "module:class" of the environment of many rows.
        max_episode_steps: when an episode is cut off; None if it ends by itself, or if the task
            cuts it off.
        kwargs: arguments of both classes.
    """

    name: str
    env: str
    vector_env: str
    max_episode_steps: int | None = None
    kwargs: dict[str, object] = {}  # noqa: RUF012  (never written)


_ROBOT = "neatq_envs.robot:RobotEnv", "neatq_envs.robot:RobotVectorEnv"

TASKS = [
    Task(
        "neatq/DoublePole-v0",
        "neatq_envs.double_pole:DoublePoleEnv",
        "neatq_envs.double_pole:DoublePoleVectorEnv",
        max_episode_steps=100_000,
    ),
    Task(
        "neatq/DoublePoleNoVelocities-v0",
        "neatq_envs.double_pole:DoublePoleEnv",
        "neatq_envs.double_pole:DoublePoleVectorEnv",
        max_episode_steps=100_000,
        kwargs={"velocities": False},
    ),
    Task(
        "neatq/MountainCar-v0",
        "neatq_envs.mountain_car:MountainCarEnv",
        "neatq_envs.mountain_car:MountainCarVectorEnv",
        max_episode_steps=1_000,
    ),
    Task(
        "neatq/ServerJobs-v0",
        "neatq_envs.server_jobs:ServerJobsEnv",
        "neatq_envs.server_jobs:ServerJobsVectorEnv",
    ),
    Task("neatq/Flag-v0", *_ROBOT, kwargs={"scenario": "flag", "reward": "progress"}),
    # Scenario "moving" is one draw of these flags, of which an episode would see but the first.
    Task(
        "neatq/Moving-v0",
        *_ROBOT,
        kwargs={"scenario": {"name": "moving", "flag": {"ring": [100, 250]}}, "reward": "progress"},
    ),
    Task("neatq/Wall-v0", *_ROBOT, kwargs={"scenario": "wall", "reward": "progress"}),
    Task("neatq/Trap-v0", *_ROBOT, kwargs={"scenario": "trap", "reward": "progress"}),
    Task("neatq/Maze-v0", *_ROBOT, kwargs={"scenario": "maze", "reward": "progress"}),
    Task("neatq/Switch-v0", *_ROBOT, kwargs={"scenario": "switch", "reward": "progress"}),
]


def register_all() -> None:
    """Tell Gymnasium about all tasks; calling it again changes nothing."""
    for task in TASKS:
        if task.name not in gymnasium.registry:
            gymnasium.register(
                task.name,
                entry_point=task.env,
                vector_entry_point=task.vector_env,
                max_episode_steps=task.max_episode_steps,
                kwargs=dict(task.kwargs),
            )
