"""Tasks that are done elsewhere, in whichever order they are over."""

from __future__ import annotations

import pickle
import platform
import traceback
from collections import Counter, deque
from collections.abc import Callable, Generator, Sequence
from typing import Any, NamedTuple

from neatq_envs.machines import Distant, Machines
from neatq_envs.processes import ProcessEnded

TRIES = 3
"""So often a task is begun whose process or machine was lost under it."""


class Outcome(NamedTuple):
    """What came of a task.

    Attributes:
        task: That was done.
        answer: What came of it; None if it failed.
        error: Why it failed; `ProcessEnded` if its process was lost `TRIES` times.
        host: The machine that did it.
        tries: How often it was begun.
    """

    task: Any
    answer: Any
    error: Exception | None
    host: str
    tries: int


class Hand:
    """Does tasks elsewhere."""

    _work: Callable[[Any], Any]

    def come(self) -> None:
        """Say that it is there, and reads what it is told, however long that is."""

    def begin(self, begin: Callable[..., Callable[[Any], Any]], *arguments: Any) -> str:
        """Call with each task what `begin` of the arguments gives; returns the machine's name."""
        self._work = begin(*arguments)
        return platform.node()

    def do(self, task: Any) -> tuple[Any, Exception | None]:
        """What comes of a task, or what it raises."""
        try:
            answer = self._work(task)
            pickle.dumps(answer)  # what cannot be sent is an error of the task, too
            return answer, None
        except Exception as error:
            error.add_note(traceback.format_exc())
            return None, _sendable(error)


def _sendable(error: Exception) -> Exception:
    """An error that can go to another process, which not every one can."""
    try:
        pickle.loads(pickle.dumps(error))
        return error
    except Exception:
        told = RuntimeError(f"{type(error).__name__}: {error}")
        for note in error.__notes__:
            told.add_note(note)
        return told


class _Hired:
    """What a hand does, and where; no host before it has begun, no task while it waits for one."""

    def __init__(self) -> None:
        self.came = False
        self.host: str | None = None
        self.task: Any = None


class Pool:
    """Hands that do tasks; see `performed`."""

    def __init__(
        self, machines: Machines, begin: Sequence[Any], tasks: Sequence[Any], jobs: int | None
    ) -> None:
        self._machines, self._begin, self._jobs = machines, begin, jobs
        self._waiting, self._tries = deque(tasks), Counter[Any]()
        self._hands: dict[Distant, _Hired] = {}
        self._stillborn = 0

    def work(self, seconds: float) -> list[Outcome]:
        """Let everybody work, for so long or until something comes of it; returns that."""
        self._hire()
        for hand, one in list(self._hands.items()):
            if self._waiting and one.host is not None and one.task is None:
                one.task = self._waiting.popleft()
                hand.ask("do", one.task)
        for hand, one in list(self._hands.items()):
            if one.host is not None and one.task is None:  # nothing waits for it
                del self._hands[hand]
                hand.close()
        busy = [hand for hand, one in self._hands.items() if one.host is None or one.task]
        came = [self._took(hand) for hand in self._machines.answering(busy, seconds)]
        return [outcome for outcome in came if outcome is not None]

    def close(self) -> None:
        """Let everybody go, whatever they do."""
        for hand in self._hands:
            hand.close()

    def _hire(self) -> None:
        most = cores = self._machines.cores()
        if self._jobs is not None:
            most = min(self._jobs, cores) if self._machines.elastic else self._jobs
        free = sum(one.task is None for one in self._hands.values())
        wanted = most - len(self._hands)
        for _ in range(min(wanted, len(self._waiting) - free)):
            hand = self._machines.open(Hand)
            self._hands[hand] = _Hired()
            hand.ask("come")

    def _took(self, hand: Distant) -> Outcome | None:
        one = self._hands[hand]
        try:
            answer = hand.answer()
        except ProcessEnded as error:
            return self._lost(hand, error)
        if not one.came:
            one.came = True
            hand.ask("begin", *self._begin)
            return None
        if one.host is None:
            one.host, self._stillborn = answer, 0
            return None
        task, one.task = one.task, None
        self._tries[task] += 1
        came, error = answer
        return Outcome(task, came, error, one.host, self._tries[task])

    def _lost(self, hand: Distant, error: ProcessEnded) -> Outcome | None:
        one = self._hands.pop(hand)
        hand.close()
        if one.host is None:
            self._stillborn += 1
            if self._stillborn >= TRIES:
                raise error
            return None
        self._tries[one.task] += 1
        if self._tries[one.task] < TRIES:
            self._waiting.appendleft(one.task)
            return None
        return Outcome(one.task, None, error, one.host, self._tries[one.task])


def performed(
    machines: Machines,
    begin: Sequence[Any],
    tasks: Sequence[Any],
    *,
    jobs: int | None,
    seconds: float = 1.0,
) -> Generator[Outcome | None]:
    """What comes of tasks, in whichever order they are over; None where nothing was for a while.

    A task whose process or machine is lost is begun again. What a task raises is its outcome; the
    others go on.

    Args:
        machines: Where they are done.
        begin: A callable that is called elsewhere with the rest as arguments; what it gives is
            called with each task.
        tasks: Hashable, no two equal, none false.
        jobs: Most tasks at a time; on a cluster there are never more than cores. None: one for each
            core that there is.
        seconds: Time between two looks.

    Raises:
        ProcessEnded: If no process can begin.
    """
    pool, left = Pool(machines, begin, tasks, jobs), len(tasks)
    try:
        while left:
            outcomes = pool.work(seconds)
            left -= len(outcomes)
            yield from outcomes or [None]
    finally:
        pool.close()
