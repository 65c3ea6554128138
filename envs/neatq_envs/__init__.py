"""Worlds for neuroevolution and reinforcement learning: robots, walls and a flag.

The environments know nothing of genomes or learning.
"""

from __future__ import annotations
