"""An episode of the champion of a Gymnasium task, for the page."""

from __future__ import annotations

import base64
from typing import Any

from neatq_envs.episodes import TEST, episode_seeds
from neatq_envs.render import animation
from neatq_torch.kinds import ConfigError
from neatq_trainers.folder import RunFolder
from neatq_trainers.policy import make_policy
from neatq_trainers.report import episode_film
from neatq_trainers.worlds import GymnasiumConfig


def champion_episode(folder: RunFolder) -> dict[str, Any]:
    """A film of the champion of the latest checkpoint, as a message for pages; the run waits.

    Raises:
        ConfigError: If it is no Gymnasium task, or its environment draws nothing.
        CheckpointError: If there is no champion yet.
        TaskError: If the environment cannot be made, played or drawn.
    """
    config = folder.config
    if not isinstance(config.world, GymnasiumConfig):
        raise ConfigError("watch: it is for Gymnasium tasks")
    policy = make_policy(config, folder.champion(), folder.facts())
    seed = int(episode_seeds(config.seed, 0, 1, purpose=TEST)[0])
    frames = episode_film(config.world.task, policy, seed)
    if not frames:
        raise ConfigError(f"watch: {config.task} draws nothing (it has no render mode rgb_array)")
    gif = base64.b64encode(animation(frames)).decode()
    words = f"a test episode of the champion of the latest checkpoint, {config.task}"
    return {"type": "film", "gif": f"data:image/gif;base64,{gif}", "words": words}
