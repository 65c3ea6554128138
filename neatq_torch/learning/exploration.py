"""Taking a candidate: the best one, or now and then another."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor, nn
from torchrl.envs.utils import ExplorationType, exploration_type


def _signed(number: int) -> int:
    """A 64-bit pattern as the int64 that torch knows."""
    number &= (1 << 64) - 1
    return number - (1 << 64) if number >> 63 else number


_STEP = 0x9E3779B97F4A7C15
_DRAWN_TICKS = 64
_FACTORS = (_signed(0xBF58476D1CE4E5B9), _signed(0x94D049BB133111EB))


def _scramble(bits: Tensor) -> Tensor:
    """The SplitMix64 finaliser (Steele, Lea & Flood 2014) on int64 tensors."""
    for shift, factor in zip((30, 27), _FACTORS, strict=True):
        bits = (bits ^ _shift_right(bits, shift)) * factor
    return bits ^ _shift_right(bits, 31)


def _shift_right(bits: Tensor, places: int) -> Tensor:
    return (bits >> places) & ((1 << (64 - places)) - 1)


class EpsilonGreedy(nn.Module):
    """Epsilon-greedy over candidates, for every robot on its own.

    With probability epsilon a robot starts to explore: it draws a candidate and takes it for n
    ticks, P(n) = 1 / (n (n + 1)) up to `max_hold_ticks`. `max_hold_ticks=1` is plain
    epsilon-greedy, larger values epsilon-z-greedy (Dabney, Ostrovski & Barreto 2021), whose runs
    leave the path instead of stepping off it for one tick.

    The numbers are a function of (seed of the arena, robot, tick) alone, so an arena explores in
    the same way whatever stands beside it, on any device, and nothing waits for the host. They are
    drawn for many ticks at a time.

    Under `ExplorationType.DETERMINISTIC` (and MODE and MEAN) the best candidate is taken.

    Args:
        shape: (arenas, robots).
        seeds: One seed for each arena.
        epsilon: Probability of starting to explore, per tick and robot.
        max_hold_ticks: Longest run of one explored candidate.

    Attributes:
        epsilon: Per robot [*shape]; may be changed in place.
        tick: Ticks so far.
        held: The candidate that each robot explored last [*shape].
        until_tick: The last tick of that run [*shape].

    Raises:
        ValueError: If an argument is out of range.
    """

    epsilon: Tensor
    held: Tensor
    until_tick: Tensor
    _keys: Tensor
    _chance: Tensor
    _choice: Tensor
    _end: Tensor

    def __init__(
        self,
        shape: Sequence[int],
        *,
        seeds: Sequence[int],
        epsilon: float = 0.1,
        max_hold_ticks: int = 1,
    ) -> None:
        super().__init__()
        if not 0 <= epsilon <= 1:
            raise ValueError(f"epsilon: expected a probability, got {epsilon}")
        if max_hold_ticks < 1:
            raise ValueError(f"max_hold_ticks: expected at least 1, got {max_hold_ticks}")
        if len(shape) != 2 or len(seeds) != shape[0]:
            raise ValueError(f"expected one seed for each arena of {shape}, got {len(seeds)}")
        self.max_hold_ticks = max_hold_ticks
        self.tick = 0
        self._candidates = 0  # for which numbers are drawn; 0: none are
        place = torch.tensor([[_signed(seed * _STEP)] for seed in seeds])
        robots = torch.tensor([_signed(robot * _STEP) for robot in range(shape[1])])
        keys = _scramble(_scramble(place) + robots)
        draws = torch.tensor([_signed(draw * _FACTORS[0]) for draw in range(3)])
        self.register_buffer("_keys", keys + draws.view(3, 1, 1), persistent=False)
        self.register_buffer("epsilon", torch.full(tuple(shape), epsilon), persistent=False)
        empty = torch.zeros(tuple(shape), dtype=torch.long)
        self.register_buffer("held", empty, persistent=False)
        self.register_buffer("until_tick", empty.clone(), persistent=False)
        for name in ("_chance", "_choice", "_end"):
            self.register_buffer(name, torch.empty(0), persistent=False)

    def forward(self, values: Tensor) -> Tensor:
        """Take a candidate.

        Args:
            values: Q-values [*shape, K].

        Returns:
            Indices [*shape]; of equal values the first.
        """
        greedy = values.argmax(-1)
        if exploration_type() not in (None, ExplorationType.RANDOM) or values.shape[-1] == 1:
            return greedy
        place = self._next_tick(values.shape[-1])
        running = self.until_tick >= self.tick
        start = (self._chance[place] < self.epsilon) > running
        held, until_tick = self.held, self.until_tick
        torch.where(start, self._choice[place], held, out=held)
        torch.where(start, self._end[place], until_tick, out=until_tick)
        return torch.where(running | start, held, greedy)

    def reset(self, newborn: Tensor) -> None:
        """End the runs of newborns (mask [*shape])."""
        self.until_tick = self.until_tick.masked_fill(newborn, 0)

    def state(self) -> dict[str, Any]:
        """What a checkpoint must keep: ticks so far, running explorations, epsilon."""
        names = ("epsilon", "held", "until_tick")
        return {"tick": self.tick, **{name: getattr(self, name).clone() for name in names}}

    def load_state(self, state: dict[str, Any]) -> None:
        """Go on from `state`."""
        self.tick = state["tick"]
        self._candidates = 0
        for name in ("epsilon", "held", "until_tick"):
            setattr(self, name, torch.as_tensor(state[name]).to(getattr(self, name)))

    def _next_tick(self, candidates: int) -> int:
        """Begin a tick; returns its place in the numbers drawn."""
        self.tick += 1
        place = self.tick % _DRAWN_TICKS
        if place == 0 or candidates != self._candidates:
            self._draw(self.tick - place, candidates)
        return place

    def _draw(self, first: int, candidates: int) -> None:
        """Draw for the ticks from `first` on [ticks, *shape]."""
        steps = [_signed(tick * _STEP) for tick in range(first, first + _DRAWN_TICKS)]
        bits = self._keys.unsqueeze(1) + self._keys.new_tensor(steps).view(-1, 1, 1)
        uniform = _shift_right(_scramble(bits), 40) * 2.0**-24
        self._chance, choice, duration = uniform
        self._choice = (choice * candidates).long()
        hold = (1 / (1 - duration)).clamp_max(self.max_hold_ticks).long()
        ticks = torch.arange(first, first + _DRAWN_TICKS, device=hold.device)
        self._end = hold + (ticks - 1).view(-1, 1, 1)
        self._candidates = candidates
