"""Taking a candidate: the best one, or now and then another."""

from __future__ import annotations

import math
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
_LASTING = ("epsilon", "held", "until_tick")
_FACTORS = (_signed(0xBF58476D1CE4E5B9), _signed(0x94D049BB133111EB))


def _scramble(bits: Tensor) -> Tensor:
    """The SplitMix64 finaliser (Steele, Lea & Flood 2014) on int64 tensors."""
    for shift, factor in zip((30, 27), _FACTORS, strict=True):
        bits = (bits ^ _shift_right(bits, shift)) * factor
    return bits ^ _shift_right(bits, 31)


def _shift_right(bits: Tensor, shift: int) -> Tensor:
    return (bits >> shift) & ((1 << (64 - shift)) - 1)


Seeds = Sequence[int] | Sequence[Sequence[int]]
"""One for each arena; or one for each slot, `[arenas][slots]`, which then explores like the first
slot of an arena with that seed."""


def slot_keys(seeds: Seeds, shape: Sequence[int], *, draws: int) -> Tensor:
    """Keys of as many streams of chance for every slot, int64 [draws, *shape].

    Raises:
        ValueError: If there are more or fewer seeds than arenas, or slots.
    """
    rows = [one if isinstance(one, Sequence) else [one] for one in seeds]
    robots = math.prod(shape[1:])
    slots = range(1 if rows and isinstance(seeds[0], Sequence) else robots)
    wide = {len(row) * len(slots) for row in rows}
    if len(rows) != math.prod(shape[:1]) or wide != {robots}:
        raise ValueError(
            f"expected one seed for each arena of {tuple(shape)}, or one for each slot, got "
            f"{len(rows)} of {sorted(wide)} slots"
        )
    arenas = torch.tensor([[_signed(seed * _STEP) for seed in row] for row in rows])
    within = torch.tensor([_signed(slot * _STEP) for slot in slots])
    keys = _scramble(_scramble(arenas) + within)
    numbers = torch.tensor([_signed(draw * _FACTORS[0]) for draw in range(draws)])
    return (keys + numbers.view(draws, 1, 1)).view(draws, *shape)


def drawn_bits(keys: Tensor, first: int) -> Tensor:
    """Bits of streams [draws, *shape] for the ticks from `first` on [draws, ticks, *shape]."""
    ones = (1,) * (keys.ndim - 1)
    steps = [_signed(tick * _STEP) for tick in range(first, first + _DRAWN_TICKS)]
    return _scramble(keys.unsqueeze(1) + keys.new_tensor(steps).view(-1, *ones))


def state_of_slots(state: dict[str, Any], slots: slice) -> dict[str, Any]:
    """What a policy, or a part of it, has saved of some slots of all arenas; copies."""
    return {
        name: value[:, slots].clone()
        if isinstance(value, Tensor)
        else state_of_slots(value, slots)
        if isinstance(value, dict)
        else value
        for name, value in state.items()
    }


def state_of_all(states: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """The opposite of `state_of_slots`; where some have more columns, the others get zeros."""
    return {name: _joined([state[name] for state in states]) for name in states[0]}


def _joined(values: Sequence[Any]) -> Any:
    if isinstance(values[0], dict):
        return state_of_all(values)
    if not isinstance(values[0], Tensor):
        return values[0]  # how many ticks there were
    if values[0].ndim > 2:
        columns = max(value.shape[-1] for value in values)
        values = [nn.functional.pad(one, (0, columns - one.shape[-1])) for one in values]
    return torch.cat(list(values), dim=1)


class EpsilonGreedy(nn.Module):
    """Epsilon-greedy over candidates, for every robot on its own.

    With probability epsilon a robot starts to explore: it draws a candidate and takes it for n
    ticks, P(n) = 1 / (n (n + 1)) up to `max_hold_ticks`. `max_hold_ticks=1` is plain
    epsilon-greedy, larger values epsilon-z-greedy (Dabney, Ostrovski & Barreto 2021), whose runs
    leave the path instead of stepping off it for one tick.

    The numbers are a function of (seed of the arena, slot, tick) alone, so an arena explores in
    the same way whatever stands beside it, on any device, and nothing waits for the host. They are
    drawn for many ticks at a time.

    Under `ExplorationType.DETERMINISTIC` (and MODE and MEAN) the best candidate is taken.

    Args:
        shape: (arenas, robots), or the batch shape of any environment: of (3,) each is an arena of
            one, and () is one arena of one.
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

    Example:
        >>> exploration = EpsilonGreedy((1, 50), seeds=[0], epsilon=0.1)
        >>> index = exploration(torch.rand(1, 50, 3))  # of 3 candidates
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
        self.max_hold_ticks = max_hold_ticks
        self.shape = tuple(shape)
        self.register_buffer("epsilon", torch.full(self.shape, epsilon), persistent=False)
        for name in ("held", "until_tick", "_keys", "_chance", "_choice", "_end"):
            self.register_buffer(name, torch.empty(0), persistent=False)
        self.begin(seeds)

    def part(self, slots: slice) -> EpsilonGreedy:
        """Some slots of all arenas, which go on as they do here."""
        shape = self.epsilon[:, slots].shape
        part = EpsilonGreedy(shape, seeds=[0] * shape[0], max_hold_ticks=self.max_hold_ticks)
        part._keys = self._keys[..., slots].clone()
        part.load_state_dict(state_of_slots(self.state_dict(), slots))
        return part.to(self.epsilon.device)

    def begin(self, seeds: Seeds) -> None:
        """Start anew: tick 0, nothing held, other chance; epsilon stays.

        Raises:
            ValueError: If there are more or fewer seeds.
        """
        self.tick = 0
        self._candidates = 0  # for which numbers are drawn; 0: none are
        self._keys = slot_keys(seeds, self.shape, draws=3).to(self.epsilon.device)
        self.held = torch.zeros_like(self.epsilon, dtype=torch.long)
        self.until_tick = torch.zeros_like(self.held)

    def forward(self, values: Tensor) -> Tensor:
        """The candidates to take [*shape], by Q-values [*shape, K]; of equal ones the first.

        Raises:
            ValueError: If there are values for more or fewer, or in another shape.
        """
        greedy = values.argmax(-1)
        if exploration_type() not in (None, ExplorationType.RANDOM) or values.shape[-1] == 1:
            return greedy
        if values.shape[:-1] != self.shape:
            raise ValueError(
                f"expected values of shape [{', '.join([*map(str, self.shape), 'K'])}], "
                f"got {list(values.shape)}"
            )
        self.tick += 1
        drawn = self.tick % _DRAWN_TICKS
        if drawn == 0 or values.shape[-1] != self._candidates:
            self._draw(self.tick - drawn, values.shape[-1])
        running = self.until_tick >= self.tick
        start = (self._chance[drawn] < self.epsilon) > running
        held, until_tick = self.held, self.until_tick
        torch.where(start, self._choice[drawn], held, out=held)
        torch.where(start, self._end[drawn], until_tick, out=until_tick)
        return torch.where(running | start, held, greedy)

    def reset(self, newborn: Tensor) -> None:
        """End the runs of newborns (mask [*shape])."""
        self.until_tick = self.until_tick.masked_fill(newborn, 0)

    def state_dict(self, *args: Any, **settings: Any) -> dict[str, Any]:
        """Ticks so far, running explorations and epsilon; torch's own for a module around it."""
        if args or settings:
            return super().state_dict(*args, **settings)
        return {"tick": self.tick, **{name: getattr(self, name).clone() for name in _LASTING}}

    def load_state_dict(self, state: dict[str, Any]) -> None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Go on from `state`."""
        self.tick = state["tick"]
        self._candidates = 0
        for name in _LASTING:
            setattr(self, name, torch.as_tensor(state[name]).to(getattr(self, name)))

    def _draw(self, first: int, candidates: int) -> None:
        """Draw for the ticks from `first` on [ticks, *shape]."""
        uniform = _shift_right(drawn_bits(self._keys, first), 40) * 2.0**-24
        self._chance, choice, duration = uniform
        self._choice = (choice * candidates).long()
        hold = (1 / (1 - duration)).clamp_max(self.max_hold_ticks).long()
        ticks = torch.arange(first, first + _DRAWN_TICKS, device=hold.device)
        self._end = hold + (ticks - 1).view(-1, *(1,) * len(self.shape))
        self._candidates = candidates


class ActionNoise(nn.Module):
    """Noise on continuous actions, for every robot on its own.

    For each number of an action an autoregressive process of mean 0 and standard deviation 1,

        x <- rho x + sqrt(1 - rho^2) n,

    where n is the sum of twelve uniform numbers less six: nearly normal, with the same bits on any
    device. rho is the `persistence`: 0 is white noise; with more, exploration lasts. The chance is
    that of `EpsilonGreedy`: a function of (seed of the arena, slot, tick) alone.

    Args:
        shape: (arenas, robots).
        actions: Numbers A of an action.
        seeds: One seed for each arena.
        scale: Standard deviation of what `forward` gives.
        persistence: rho, in [0, 1).

    Example:
        >>> noise = ActionNoise((1, 50), 2, seeds=[0], scale=0.1)
        >>> noise().shape
        torch.Size([1, 50, 2])
    """

    value: Tensor
    _keys: Tensor
    _drawn: Tensor

    def __init__(
        self,
        shape: Sequence[int],
        actions: int,
        *,
        seeds: Seeds,
        scale: float,
        persistence: float = 0.0,
    ) -> None:
        super().__init__()
        if not (scale >= 0 and 0 <= persistence < 1):
            raise ValueError(
                "expected a scale of at least 0 and a persistence in [0, 1), got "
                f"{scale} and {persistence}"
            )
        self.shape, self.actions = tuple(shape), actions
        self.scale, self.persistence = scale, persistence
        self.register_buffer("value", torch.zeros(*self.shape, actions), persistent=False)
        for name in ("_keys", "_drawn"):
            self.register_buffer(name, torch.empty(0), persistent=False)
        self.begin(seeds)

    def part(self, slots: slice) -> ActionNoise:
        """Some slots of all arenas, which go on as they do here."""
        shape = self.value[:, slots].shape
        own = {"scale": self.scale, "persistence": self.persistence}
        part = ActionNoise(shape[:2], self.actions, seeds=[0] * shape[0], **own)
        part._keys = self._keys[..., slots].clone()
        part.load_state_dict(state_of_slots(self.state_dict(), slots))
        return part.to(self.value.device)

    def begin(self, seeds: Seeds) -> None:
        """Start anew: tick 0, no noise so far, other chance."""
        self.tick, self._drawn = 0, self.value.new_empty(0)
        keys = slot_keys(seeds, self.shape, draws=3 * self.actions + 3)[3:]  # not epsilon's
        self._keys = keys.to(self.value.device)
        self.value = torch.zeros_like(self.value)

    def forward(self) -> Tensor:
        """The noise of the next tick [*shape, actions]; none under deterministic exploration."""
        if exploration_type() not in (None, ExplorationType.RANDOM) or not self.scale:
            return torch.zeros_like(self.value)
        self.tick += 1
        at = self.tick % _DRAWN_TICKS
        if at == 0 or not len(self._drawn):
            self._draw(self.tick - at)
        fresh = math.sqrt(1 - self.persistence**2)
        self.value = self.persistence * self.value + fresh * self._drawn[at]
        return self.scale * self.value

    def _draw(self, first: int) -> None:
        bits = drawn_bits(self._keys, first).unflatten(0, (self.actions, 3))
        # One after the other, so that the sum is the same to the last bit wherever it stands.
        total = torch.zeros_like(bits[:, 0], dtype=torch.float32)
        for stream in bits.unbind(1):
            for shift in (0, 16, 32, 48):
                total += (_shift_right(stream, shift) & 0xFFFF) * 2.0**-16
        self._drawn = (total - 6 + 6 * 2.0**-16).movedim(0, -1)

    def reset(self, newborn: Tensor) -> None:
        """Begin without noise (mask [*shape])."""
        self.value = self.value.masked_fill(newborn.unsqueeze(-1), 0)

    def state_dict(self, *args: Any, **settings: Any) -> dict[str, Any]:
        """Ticks so far and the processes; torch's own for a module around it."""
        if args or settings:
            return super().state_dict(*args, **settings)
        return {"tick": self.tick, "value": self.value.clone()}

    def load_state_dict(self, state: dict[str, Any]) -> None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Go on from `state`."""
        self.tick, self._drawn = state["tick"], self.value.new_empty(0)
        self.value = torch.as_tensor(state["value"]).to(self.value)
