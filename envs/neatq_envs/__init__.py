"""Worlds for neuroevolution and reinforcement learning.

Robots, walls and a flag (`arena`), and benchmark tasks with known answers. The environments know
nothing of genomes or learning. Importing this package tells Gymnasium about them, so that
`gymnasium.make("neatq_envs:neatq/MountainCar-v0")` needs no other import.
"""

from __future__ import annotations

from neatq_envs.registration import register_all

register_all()
