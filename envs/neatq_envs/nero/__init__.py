"""NERO: teams of robots that shoot at each other, for battle and for training.

The field and its rules are those of OpenNERO (mods/NERO, mods/NERO_Battle and the tournament of
2011). `NeroEnv` trains a team in TorchRL, `NeroBattle` lets two fight in PettingZoo's parallel
form.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from neatq_envs.nero.scenario import NeroScenario, Stage, find_nero, find_stages

if TYPE_CHECKING:
    from neatq_envs.nero.pettingzoo_nero import NeroBattle
    from neatq_envs.nero.torchrl_nero import NeroEnv

__all__ = ["NeroBattle", "NeroEnv", "NeroScenario", "Stage", "find_nero", "find_stages"]
_LATER = {"NeroBattle": "pettingzoo_nero", "NeroEnv": "torchrl_nero"}
"""What takes seconds to import, and where it is."""


def __getattr__(name: str) -> Any:
    if name not in _LATER:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_LATER[name]}"), name)
