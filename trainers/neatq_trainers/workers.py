"""Who trains the arenas of a run: this process, or several at once.

Arenas, but for rivals, do not influence each other, so they can be dealt to processes in any way:
the results are the same, bit for bit. Of a run of one part on a Gymnasium task the slots are dealt
instead (`rollouts`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from copy import deepcopy
from itertools import pairwise
from typing import Any, NamedTuple

import torch

from neatq_envs.machines import Crew, Distant, Here, Machines
from neatq_envs.random_play import EnvFacts
from neatq_torch.genome import Genome
from neatq_trainers.build import build
from neatq_trainers.callbacks import Callback
from neatq_trainers.changes import AnyChange
from neatq_trainers.compiling import CompilingTold
from neatq_trainers.config import RunConfig
from neatq_trainers.islands import emigrants, immigrate
from neatq_trainers.loop import Stride, strides
from neatq_trainers.migration import Travellers
from neatq_trainers.run import Champion, State

ARENAS_PER_WORKER = 4
"""A tick of one arena costs nearly as much as a tick of four."""


class Snapshot(NamedTuple):
    """A run as it stands between two strides.

    Attributes:
        state: What `Run.state_dict` gives.
        champion: The fittest genome of the first arena, with the weights its robot has learnt.
        champions: Those that are remembered, one for each arena.
    """

    state: State
    champion: Genome | None
    champions: list[Champion | None]


class Worker:
    """Trains some arenas of a run in its process; see `build`.

    `batch` and `advance` of the callbacks are called here.
    """

    def __init__(
        self,
        config: RunConfig,
        state: State | None,
        facts: EnvFacts | None,
        callbacks: Sequence[Callback],
        crew: Crew | None = None,
        *,
        tells: bool = True,
    ) -> None:
        self._hearing = ExitStack()
        if tells:
            self._hearing.callback(CompilingTold().close)
        try:
            self._run = build(config, state, facts=facts, crew=crew)
        except BaseException:
            self._hearing.close()
            raise
        self._strides = strides(self._run, callbacks)

    def stride(self) -> Stride:
        """Train one stride more."""
        stride = next(self._strides)
        self._hearing.close()
        return stride

    def check(self, change: AnyChange) -> None:
        """Refuse a change that cannot be made, see `Change`."""
        change.check(self._run)

    def make(self, change: AnyChange) -> None:
        """Make a change that was checked."""
        change.make(self._run)

    def emigrants(self, times: int) -> Travellers:
        """Who goes of each arena, see `islands`."""
        assert self._run.config.migration is not None
        return emigrants(self._run, self._run.config.migration, times)

    def immigrate(self, arriving: Travellers) -> None:
        """Let them arrive."""
        immigrate(self._run, arriving)

    def snapshot(self) -> Snapshot:
        """The run as it stands."""
        run = self._run
        return Snapshot(run.state_dict(), run.champion(0), run.metrics.champions)

    def close(self) -> None:
        """Close what training has opened."""
        self._hearing.close()
        self._strides.close()
        self._run.world.close()


Part = tuple[RunConfig, State | None, EnvFacts | None, Sequence[Callback]]
"""What a `Worker` is made of."""


class Host:
    """The workers of some parts of a run, in one process.

    Args:
        parts: A worker for each.
        crew: Of the only one.
        tells: Whether one of them tells of compiling.
    """

    def __init__(
        self, parts: Sequence[Part], crew: Crew | None = None, *, tells: bool = True
    ) -> None:
        self._closing, self._workers = ExitStack(), list[Worker]()
        with self._closing:
            for number, (config, state, facts, callbacks) in enumerate(parts):
                own = callbacks if len(parts) == 1 else deepcopy(callbacks)  # as in other processes
                arguments = config, state, facts, own, crew
                self._workers.append(Worker(*arguments, tells=tells and number == 0))
                self._closing.callback(self._workers[-1].close)
            self._closing = self._closing.pop_all()

    def every(self, method: str, *arguments: Any) -> list[Any]:
        """What all workers answer to the same."""
        return [getattr(one, method)(*arguments) for one in self._workers]

    def each(self, method: str, shares: Sequence[Any]) -> list[Any]:
        """What the first workers answer to a share each, as many as there are."""
        pairs = zip(self._workers, shares, strict=False)
        return [getattr(one, method)(share) for one, share in pairs]

    def close(self) -> None:
        """Close them."""
        self._closing.close()


def _host_in_process(tells: bool, parts: Sequence[Part]) -> Host:
    torch.set_num_threads(1)
    return Host(parts, tells=tells)


class Workforce:
    """All workers of a run, in the order of its parts, wherever their hosts are.

    Args:
        hosts: Each is a `Host`.
        first_parts: The number of the first part of each.
    """

    def __init__(self, hosts: Sequence[Distant], first_parts: Sequence[int]) -> None:
        self.hosts, self._first_parts = hosts, first_parts

    def ask(self, method: str, *arguments: Any) -> None:
        """Have a method of all called."""
        for host in self.hosts:
            host.ask("every", method, *arguments)

    def answers(self) -> list[Any]:
        """What each answers to what it was asked the longest ago."""
        return [one for host in self.hosts for one in host.answer()]

    def asked(self, method: str, *arguments: Any) -> list[Any]:
        """What each answers, with nothing else under way."""
        self.ask(method, *arguments)
        return self.answers()

    def first(self, method: str, argument: Any) -> Any:
        """What the first answers, likewise."""
        self.hosts[0].ask("each", method, [argument])
        return self.hosts[0].answer()[0]

    def deal(self, method: str, shares: Sequence[Any]) -> list[Any]:
        """What each answers to its share, likewise."""
        for host, (first, end) in zip(
            self.hosts, pairwise([*self._first_parts, len(shares)]), strict=True
        ):
            host.ask("each", method, shares[first:end])
        return self.answers()


@contextmanager
def open_team(
    parts: Sequence[RunConfig],
    states: Sequence[State | None],
    facts: EnvFacts | None,
    callbacks: Sequence[Callback],
    crew: Crew,
) -> Iterator[Workforce]:
    """A `Worker` for each part of a run, in as many processes as the crew has.

    One process is this one. There the environments of a run of one part are dealt to the crew.
    """
    own = [one for one in callbacks if _is_called_there(one)]
    everything = [(part, state, facts, own) for part, state in zip(parts, states, strict=True)]
    hosts = min(len(parts), crew.size)
    first_parts = [len(parts) * host // hosts for host in range(hosts)]
    with ExitStack() as stack:
        opened: list[Distant] = []
        for first, end in pairwise([*first_parts, len(parts)]):
            if hosts == 1:
                host: Distant = Here(Host(everything, crew if len(parts) == 1 else None))
            else:
                dealt = _host_in_process, first == 0, everything[first:end]
                host = crew.machines.open(*dealt, together=hosts)
            opened.append(host)
            stack.callback(host.close)
        yield Workforce(opened, first_parts)


def _is_called_there(callback: Callback) -> bool:
    """Whether a callback has something to do where arenas are trained."""
    kind = type(callback)
    return kind.batch is not Callback.batch or kind.advance is not Callback.advance


def fitting_workers(config: RunConfig, machines: Machines) -> int:
    """How many processes make the most of machines for a run."""
    if config.world.lasting:
        each = 1 if machines.elastic else ARENAS_PER_WORKER  # a core more is at hand there
        return max(1, min(machines.cores(), config.arenas // each))
    return machines.cores()
