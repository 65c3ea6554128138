"""Settings of the anchor `sac`.

Four were tried in runs of 8,000 ticks, the figure is the mean distance over the last fifth:

| discount | horizon | learning rate | wall, seeds 100 and 101 | maze, seed 101 | flag, seed 102 |
| --- | --- | --- | --- | --- | --- |
| 0.97 | 1 | 3e-4 | 142, - | 139 | - |
| 0.97 | 5 | 1e-3 | 141, - | 138 | - |
| 0.99 | 20 | 1e-3 | 44, 57 | 140 | 6 |
| 0.99 | 20 | 3e-4 | 92, - | - | - |

The third is taken. Minibatch and tau are those of Haarnoja et al. (2018); there is one update for
every tick, and as much is remembered, as in `neatq`.
"""

from __future__ import annotations

from typing import Any

_IN_ARENA: dict[str, Any] = {"batch_steps": 20, "updates_per_tick": 1, "minibatch": 256}
_IN_ARENA |= {"learning_rate": 1e-3, "discount": 0.99, "horizon": 20, "tau": 0.005}
_IN_ARENA |= {"capacity": 300_000, "warmup": 1000, "alpha": 0.1}


def sac_settings() -> dict[str, Any]:
    """The settings in the arena, and where they come from."""
    return {"settings": dict(_IN_ARENA), "source": "tuned in the arena, see sac_settings.py"}
