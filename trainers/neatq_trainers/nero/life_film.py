"""A life of a team that trains, to look at."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from PIL import Image, ImageDraw
from torchrl.envs.utils import ExplorationType, set_exploration_type

from neatq_envs.nero.picture import Painter, Still
from neatq_envs.nero.state import Field
from neatq_envs.render import GROUND, TICK
from neatq_trainers.nero.animation import caption_font
from neatq_trainers.nero.nero_world import NeroConfig, NeroWorld
from neatq_trainers.run import Run

CAPTION = 24
"""Height in pixels of the line below the field."""


@torch.no_grad()
def life_frames(run: Run, ticks: int, every: int) -> list[np.ndarray]:
    """Pictures of arena 0, uint8 [height, width, 3], every so many ticks of a life of the team.

    All begin together, on the field of the last stage and against whomever a league begins with,
    without exploration and learning. The networks of the run act; their recurrent state is used up.
    """
    world = run.config.world
    assert isinstance(world, NeroConfig)
    stages = run.world.env.arena.stages[-1:]  # as somebody may have made it
    last = replace(world, stages=stages, held_out=(), round_ticks=ticks + 1)
    env = NeroWorld(last, run.config.seeds).env
    painter, frames = Painter(last.scenario), []
    done = np.zeros(2, np.int64)  # hits and damage of the team
    run.policy.reset(torch.ones(run.shape, dtype=torch.bool))
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        rows = env.reset()
        for tick in range(ticks):
            _, rows = env.step_and_maybe_reset(run.policy(rows))
            field = env.arena.fields[0]
            robots = run.shape[1]
            done += field.hits[:robots].sum(), field.taken[:robots].sum()
            if tick % every == 0:
                words = f"tick {tick + 1:,}   hits {done[0]:,}   damage taken {done[1]:,}"
                frames.append(_life_frame(painter, field, last.scenario.hit_points, words))
    return frames


def _life_frame(painter: Painter, field: Field, hit_points: int, words: str) -> np.ndarray:
    still = Still(
        pose=field.pose,
        team=field.team,
        left=(1 - field.damage / hit_points).clip(0, 1),
        shot=field.shot,
        struck=field.pending > 0,
        mark=np.zeros(len(field.team)),
    )
    picture = painter.paint(still)
    image = Image.new("RGB", (picture.width, picture.height + CAPTION), GROUND)
    image.paste(picture)
    ImageDraw.Draw(image).text((8, picture.height + 4), words, TICK, caption_font(13))
    return np.asarray(image)
