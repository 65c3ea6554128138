"""Settings of the anchor `ppo`.

On Gymnasium tasks they are those of CleanRL's ppo.py (actions to choose from) and
ppo_continuous_action.py (boxes) (Huang et al. 2022, https://github.com/vwxyzjn/cleanrl); for boxes
the 2,048 steps of a batch come from 8 environments side by side instead of one. In the arena they
are those of examples/ppo.py, with a discount of 0.99 instead of 0.97.

Seven were tried there in runs of 8,000 ticks, the figure is the mean distance over the last fifth:

| discount | wall, seeds 100 and 101 | maze, seed 101 | flag, seed 102 |
| --- | --- | --- | --- |
| 0.97 | 146, 145 | - | - |
| 0.99 | 91, 152 | 139 | 11 |
| 0.99, entropy 0.01 | 152, - | - | - |
| 0.99, learning rate 3e-4 | 146, - | - | - |
| 0.99, batches of 50 ticks | 154, - | - | - |
| 0.99, batches of 200 ticks | 127, 146 | - | - |
| 0.995 | 150, - | - | - |

The second is taken.
"""

from __future__ import annotations

from typing import Any

CLEANRL = {"learning_rate": 2.5e-4, "anneal": True, "discount": 0.99, "gae_lambda": 0.95}
CLEANRL |= {"clip": 0.2, "critic": 0.5, "most_norm": 0.5}
_SETTINGS: dict[str, dict[str, Any]] = {
    "choices": CLEANRL
    | {"rows": 4, "batch_steps": 128, "epochs": 4, "minibatch": 128, "entropy": 0.01},
    "box": CLEANRL
    | {"rows": 8, "batch_steps": 256, "epochs": 10, "minibatch": 64, "entropy": 0.0}
    | {"learning_rate": 3e-4},
    "arena": CLEANRL
    | {"batch_steps": 100, "epochs": 4, "minibatch": 1000, "entropy": 0.001, "critic": 1.0}
    | {"learning_rate": 1e-3, "anneal": False, "discount": 0.99},
}
_SOURCES = {
    "choices": "settings of CleanRL's ppo.py",
    "box": "settings of CleanRL's ppo_continuous_action.py, 8 environments",
    "arena": "settings of examples/ppo.py, with a discount of 0.99",
}


def ppo_settings(where: str) -> dict[str, Any]:
    """The settings for "choices", a "box" or the "arena", and where they come from."""
    return {"settings": _SETTINGS[where], "source": _SOURCES[where]}
