"""Objects that live in actors of a Ray cluster; imported only where one is asked for."""

from __future__ import annotations

import math
import os
import pickle
import signal
import threading
import traceback
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from neatq_envs.machines import ClusterError, Distant
from neatq_envs.processes import MachinesLeft, ProcessEnded

try:
    import grpc
    import ray
    from ray.cloudpickle.cloudpickle import dumps as pickled  # functions of scripts, too
    from ray.exceptions import RayActorError, RayError
except ImportError as error:
    raise ClusterError(
        "cluster: Ray is not installed; install it here and on all machines: "
        'pip install "neatq_torch[ray]"'
    ) from error

BEGIN_SECONDS = 5.0
"""Time after which whoever waits for an object looks whether it can still begin."""
CONNECT_SECONDS = 8.0
"""Time after which an address at which nobody answers is a wrong one."""
_PORTS = {"ray": 10001, "": 6379}
_QUIET = {"RAY_USAGE_STATS_ENABLED": "0", "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0"}
"""Settings of Ray for whoever has chosen none: it tells nobody, and warns of nothing of ours."""


class Actor:
    """Makes an object, and does with it what is asked for; errors are answers, too."""

    def __init__(self, request: bytes) -> None:
        self._made, self._error = None, None
        try:
            make, arguments = pickle.loads(request)
            self._made = make(*arguments)
        except Exception as error:
            self._error = _noted(error)

    def call(self, request: bytes) -> bytes:
        """What a method returns, or an exception."""
        try:
            method, arguments = pickle.loads(request)
            answer = self._error or getattr(self._made, method)(*arguments)
        except Exception as error:
            answer = _noted(error)
        return pickle.dumps(answer)  # arrays that Ray reads by itself could not be written


def _noted(error: Exception) -> Exception:
    error.add_note(traceback.format_exc())
    return error


class RayRemote:
    """An object in an actor; see `Distant`."""

    def __init__(self, actor: Any, cluster: RayCluster) -> None:
        self._actor, self._cluster, self._begun = actor, cluster, False
        self._cores = cluster.cores()
        self.under_way: deque[Any] = deque()

    def ask(self, method: str, *arguments: Any) -> None:
        """See `Distant`."""
        self.under_way.append(self._actor.call.remote(pickled((method, arguments))))

    def answer(self) -> Any:
        """See `Distant`."""
        call = self.under_way.popleft()
        try:
            while not self._begun and not ray.wait([call], timeout=BEGIN_SECONDS)[0]:
                self._refuse_to_wait_for_ever()
            answer = pickle.loads(ray.get(call))
        except RayActorError as error:
            cause = (
                str(error).strip().splitlines()[-1].partition(". ")[0].partition(" Worker exit")[0]
            )
            raise ProcessEnded(f"an actor of Ray is gone ({cause})") from error
        except RayError as error:
            raise ProcessEnded(f"Ray has lost an answer ({type(error).__name__})") from error
        self._begun = True
        if isinstance(answer, Exception):
            raise answer
        return answer

    def close(self) -> None:
        """See `Distant`."""
        ray.kill(self._actor)

    def _refuse_to_wait_for_ever(self) -> None:
        """An actor that has not begun may need a core of a machine that has gone since."""
        if self._cluster.cores() < self._cores:
            raise MachinesLeft("the cluster has fewer cores than when an actor was asked for")


class RayCluster:
    """The machines of a Ray cluster; see `Machines`."""

    elastic = True

    def __init__(self, dashboard: str = "") -> None:
        self.dashboard = dashboard

    def cores(self) -> int:
        """See `Machines`."""
        return max(1, int(sum(node["CPU"] for node in self._nodes())))

    def _nodes(self) -> list[dict[str, float]]:
        """What each machine has, of those that have cores."""
        alive: Any = [node["Resources"] for node in ray.nodes() if node["Alive"]]
        return [node for node in alive if node.get("CPU")]

    def open(self, make: Callable[..., Any], *arguments: Any, together: int = 1) -> Distant:
        """See `Machines`; a core for each object, or less if there are not as many."""
        share = fitting_share([node["CPU"] for node in self._nodes()], together)
        kind: Any = ray.remote(Actor)
        options = {"num_cpus": share, "max_restarts": 0, "scheduling_strategy": "SPREAD"}
        actor = kind.options(**options).remote(pickled((make, arguments)))
        return RayRemote(actor, self)

    def answering(self, distant: Sequence[Distant], seconds: float) -> list[Distant]:
        """See `Machines`."""
        calls = {one.under_way[0]: one for one in distant if isinstance(one, RayRemote)}
        ready, _ = ray.wait(list(calls), num_returns=1, timeout=seconds)
        more, _ = ray.wait(list(calls), num_returns=len(calls), timeout=0)
        return [calls[one] for one in more or ready]


def fitting_share(cores: Sequence[float], objects: int) -> float:
    """The largest part of a core, at most one, of which all objects find room on the machines.

    Args:
        cores: Of each machine.
        objects: How many there are; none of them may stand on two machines. 0: they rest meanwhile
            for whom this is asked.
    """
    if not objects:
        return 0.0
    shares = {1.0} | {one / count for one in cores for count in range(1, objects + 1)}
    for share in sorted((one for one in shares if one <= 1.0), reverse=True):
        if sum(int(one / share + 1e-9) for one in cores) >= objects:
            return math.floor(1e4 * share) / 1e4  # Ray counts in these
    return 1.0  # there is no machine yet


@contextmanager
def connected(address: str) -> Iterator[RayCluster]:
    """The cluster at an address; see `open_machines`. One that the program has already is kept."""
    if ray.is_initialized():
        yield RayCluster()
        return
    _check_address(address)
    for name, value in _QUIET.items():
        os.environ.setdefault(name, value)
    try:
        quiet: Any = {"log_to_driver": False, "logging_level": "ERROR"}
        ends = signal.getsignal(signal.SIGTERM)
        context: Any = ray.init(address, runtime_env=_surroundings(), **quiet)
        if threading.current_thread() is threading.main_thread():
            # Ray's own would end a run without a checkpoint.
            signal.signal(signal.SIGTERM, ends or signal.SIG_DFL)
    except (ConnectionError, RuntimeError, ValueError, RayError) as error:
        words = str(error).strip().partition("\n")[0]
        raise ClusterError(f"cluster: no Ray at {address}: {words}") from error
    try:
        yield RayCluster(getattr(context, "dashboard_url", None) or "")
    finally:
        ray.shutdown()


def _surroundings() -> dict[str, Any]:
    """What workers have beside their own: the folders in which a user keeps modules."""
    folders = [one for one in os.environ.get("PYTHONPATH", "").split(os.pathsep) if one]
    if not folders:
        return {}
    return {"env_vars": {"PYTHONPATH": os.pathsep.join(map(os.path.abspath, folders))}}


def _noted_address() -> str:
    """What `ray start` has noted on this machine, be it gone since; "" without a note."""
    folder = os.environ.get("RAY_TMPDIR", "/tmp")
    try:
        return Path(folder, "ray", "ray_current_cluster").read_text(encoding="utf-8").strip()
    except OSError:
        return ""


def _check_address(address: str) -> None:
    """Refuse an address at which nobody listens, for which Ray itself would wait for minutes."""
    if address == "auto":
        address = os.environ.get("RAY_ADDRESS", "auto")
        address = _noted_address() or "local" if address == "auto" else address
    if address == "local":
        return
    parts = urlsplit(address if "://" in address else f"//{address}")
    host, port = None, 0
    with suppress(KeyError, ValueError):  # another scheme, a port that is no number
        host, port = parts.hostname, parts.port or _PORTS[parts.scheme]
    if not host or not port:
        raise ClusterError(
            f"cluster: expected auto, local, ray://HOST:10001 or HOST:6379, got {address}"
        )
    if os.environ.get("RAY_USE_TLS", "0") != "0":
        return  # Ray has the certificates
    with grpc.insecure_channel(f"{host}:{port}") as channel:
        try:
            grpc.channel_ready_future(channel).result(CONNECT_SECONDS)
        except grpc.FutureTimeoutError as error:
            raise ClusterError(
                f"cluster: no Ray answers at {host}:{port}; ray start --head begins a cluster, ray "
                "status shows whether it runs"
            ) from error
