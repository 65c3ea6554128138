"""What a page asks for, and the clips that it is sent.

All other messages to a page are JSON objects with a `type`; `Scene` and `Window` make them.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np

from neatq_torch.kinds import ConfigError
from neatq_trainers.changes import AnyChange

PAGE = Path(__file__).parent / "page"
"""The files of the page."""
CHANNELS = ("fitness", "age_ticks", "species", "value", "td_error", "hit_points", "team", "alive")
"""What is known of each robot in a clip, beside its pose."""
_MAGIC = b"NQC1"
_MOST_COUNTED = 65_535
"""Of robots, frames and shots, each a number of two bytes."""
_HEADER = struct.Struct("<4sIHHHHfHH")


class Ask(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="type", tag=str.lower):
    """Something that a page asks for."""


class Pause(Ask, frozen=True):
    """Let the run stand."""


class Go(Ask, frozen=True):
    """Let it go on."""


class StepOnce(Ask, frozen=True, tag="step"):
    """Let it go on to the next moment at which it can stand."""


class Speed(Ask, frozen=True):
    """Let it take so many ticks a second; None: as many as it can."""

    ticks_per_second: float | None


class Choose(Ask, frozen=True):
    """Look into the robot of a slot, or into none."""

    slot: int | None


class Undo(Ask, frozen=True):
    """Take the last change back that can be."""


class Save(Ask, frozen=True):
    """Keep the team by a name."""

    name: str


class Load(Ask, frozen=True):
    """Let a team that was kept take the slots."""

    name: str


class Battle(Ask, frozen=True):
    """Let the team fight one of the opponents."""

    against: str


class Watch(Ask, frozen=True):
    """Let the champion of a Gymnasium task play an episode."""


class Changing(Ask, frozen=True, tag="change"):
    """Change something."""

    change: AnyChange


AnyAsk = Pause | Go | StepOnce | Speed | Choose | Undo | Save | Load | Battle | Watch | Changing


def read_ask(text: str | bytes) -> AnyAsk:
    """What the text of a message asks for.

    Raises:
        ConfigError: If it is none.
    """
    try:
        return msgspec.json.decode(text, type=AnyAsk)
    except (msgspec.DecodeError, RecursionError, UnicodeDecodeError) as error:
        raise ConfigError(f"message: {error}") from error


class Clip(NamedTuple):
    """Some ticks of a field.

    Attributes:
        tick: Of the first frame.
        ticks_per_frame: From one frame to the next.
        seconds: In which they are to be played; 0: at once.
        poses: x and y in units, heading in rad, float32 [frames, robots, 3].
        robots: `CHANNELS` after the last frame, float32 [robots, channels]; NaN: unknown.
        flags: x, y, and 1 for a flag that counts, float32 [frames, flags, 3].
        shots: Frame, from x and y, to x and y, and team; float32 [shots, 6].
    """

    tick: int
    ticks_per_frame: int
    seconds: float
    poses: np.ndarray
    robots: np.ndarray
    flags: np.ndarray
    shots: np.ndarray

    def pack(self) -> bytes:
        """As bytes, little-endian: the header, then the four arrays."""
        frames, robots, _ = self.poses.shape
        shots = self.shots[:_MOST_COUNTED]
        head = _HEADER.pack(
            _MAGIC,
            self.tick,
            frames,
            robots,
            3 + len(CHANNELS),
            self.ticks_per_frame,
            self.seconds,
            len(shots),
            self.flags.shape[1],
        )
        arrays = self.poses, self.robots, self.flags, shots
        return head + b"".join(one.astype("<f4").tobytes() for one in arrays)
