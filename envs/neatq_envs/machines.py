"""Where work is done beside this process: in processes of this machine, or on a cluster.

Who has work to do opens objects elsewhere, and does not know where that is.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

from neatq_envs.processes import Remote, usable_cores, wait_for


class ClusterError(RuntimeError):
    """A cluster cannot be used; the message says why."""


class Distant(Protocol):
    """An object elsewhere, which does one thing after the other; see `Remote`."""

    def ask(self, method: str, *arguments: Any) -> None:
        """Have a method called; several calls may be under way."""
        ...

    def answer(self) -> Any:
        """What the earliest call under way returns or raises.

        Raises:
            ProcessEnded: If the object is gone, with its process or its machine.
        """
        ...

    def close(self) -> None:
        """End it, whatever it does."""
        ...


class Here:
    """An object of this process, which does what it is asked for when the answer is wanted."""

    def __init__(self, served: Any) -> None:
        self._served = served
        self._asked: deque[tuple[str, Any]] = deque()

    def ask(self, method: str, *arguments: Any) -> None:
        """See `Distant`."""
        self._asked.append((method, arguments))

    def answer(self) -> Any:
        """See `Distant`."""
        method, arguments = self._asked.popleft()
        return getattr(self._served, method)(*arguments)

    def close(self) -> None:
        """See `Distant`."""
        self._served.close()


class Machines(Protocol):
    """What objects elsewhere are opened on.

    Attributes:
        elastic: Whether machines may come and go, so that whoever loses an object goes on with
            another one.
        dashboard: Address of a page that shows what goes on; "": there is none.
    """

    elastic: bool
    dashboard: str

    def cores(self) -> int:
        """How many cores there are now."""
        ...

    def open(self, make: Callable[..., Any], *arguments: Any, together: int = 1) -> Distant:
        """Make an object elsewhere of the arguments; `make` must be importable there.

        Args:
            make: Makes it. What that raises the first `answer` raises.
            arguments: Of `make`.
            together: How many objects must live at the same time, however few cores there are; 0
                for those who work while others rest that have the cores.
        """
        ...

    def answering(self, distant: Sequence[Distant], seconds: float) -> list[Distant]:
        """Those that have an answer, or are gone, as soon as there are any; none after a time."""
        ...


class ThisMachine:
    """Processes of this machine."""

    elastic = False
    dashboard = ""

    def cores(self) -> int:
        """See `Machines`."""
        return usable_cores()

    def open(self, make: Callable[..., Any], *arguments: Any, together: int = 1) -> Distant:
        """See `Machines`."""
        return Remote(make, *arguments)

    def answering(self, distant: Sequence[Distant], seconds: float) -> list[Distant]:
        """See `Machines`."""
        return list(wait_for([one for one in distant if isinstance(one, Remote)], seconds))


@dataclass(frozen=True)
class Crew:
    """So many objects elsewhere among which work may be dealt; one is this process alone."""

    size: int = 1
    machines: Machines = field(default_factory=ThisMachine)
    rested_for: bool = False

    @property
    def beside(self) -> Crew:
        """Others who work while these rest, and so need no cores of their own."""
        return replace(self, rested_for=True)

    def open(self, make: Callable[..., Any], *arguments: Any) -> list[Distant]:
        """Make an object for each of the crew."""
        opened, together = [], 0 if self.rested_for else self.size
        try:
            for _ in range(self.size):
                opened.append(self.machines.open(make, *arguments, together=together))
        except BaseException:
            for one in opened:
                one.close()
            raise
        return opened


@contextmanager
def open_machines(cluster: str | None) -> Iterator[Machines]:
    """The machines at an address, as long as they are needed.

    Args:
        cluster: "auto" for the Ray cluster that this machine belongs to, "local" for one that is
            begun for the time being, "ray://host:10001", "host:6379"; None for this machine.

    Raises:
        ClusterError: If Ray is not installed, or nobody answers there within ten seconds.
    """
    if cluster is None:
        yield ThisMachine()
        return
    from neatq_envs.ray_cluster import connected

    with connected(cluster) as machines:
        yield machines
