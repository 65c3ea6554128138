"""Battles whose results are made up, for tests that start processes; `play` as the real one."""

from __future__ import annotations

import os
import zlib
from typing import Any

from neatq_trainers.nero.match import MatchResult
from neatq_trainers.nero.teams import Team


def made_up(blue: Team, red: Team, *, seed: int, rules: Any) -> MatchResult:
    """Damage that depends on all that a battle depends on."""
    text = f"{blue.name} {red.name} {seed} {rules.ticks}"
    damage_blue, damage_red = divmod(zlib.crc32(text.encode()) % 10_000, 100)
    return MatchResult(damage_blue=damage_blue, damage_red=damage_red, ticks=rules.ticks)


def fatal(blue: Team, red: Team, *, seed: int, rules: Any) -> MatchResult:
    """The same, but a process that plays with seed 3 ends."""
    if seed == 3:
        os._exit(1)
    return made_up(blue, red, seed=seed, rules=rules)
