"""Serves the page of the training window, and carries messages between pages and a run.

The server has a thread of its own. A `Hub` is where the two threads meet: the run leaves messages
for pages and takes what they ask for; neither waits for the other.
"""

from __future__ import annotations

import asyncio
import errno
import json
import secrets
import socket
import threading
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import urlsplit

import uvicorn
from starlette.applications import Starlette
from starlette.requests import HTTPConnection, Request
from starlette.responses import FileResponse, PlainTextResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.websockets import WebSocket, WebSocketDisconnect

from neatq_torch.kinds import ConfigError
from neatq_trainers.live.messages import PAGE, AnyAsk, Choose, read_ask

MOST_MESSAGE_BYTES = 1_000_000
"""Of a message from a page; the connection of a longer one is closed."""
MOST_ASKED = 100
"""Messages of a page that may wait for the run; more are refused."""
MOST_CLIPS = 4
"""Clips that wait for a slow page; older ones are dropped."""
MOST_MESSAGES = 1000
"""Other messages that wait for a slow page, which is cut off when there are more."""
SEND_SECONDS = 20.0
"""A page that takes nothing for so long is gone."""
PING_SECONDS = 20.0
"""How often a page is asked whether it is still there, and how long its answer may take."""
PORTS_TRIED = 20
_LATEST = ("state", "robots", "robot", "saved")
"""Types of which a page needs the latest message alone."""
_HEADERS = {
    "Content-Security-Policy": (
        "default-src 'self'; connect-src 'self'; img-src 'self' data: blob:; "
        "media-src blob:; style-src 'self' 'unsafe-inline'; frame-ancestors 'none'"
    ),
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-store",
}


@dataclass(kw_only=True, eq=False)
class Client:
    """A page that looks.

    Attributes:
        clips: What it has not been sent of the field.
        messages: What else it has not been sent.
        chosen: The slot into which it looks.
        fresh: Whether it has chosen that since anybody asked.
        asked: How many of its messages wait for the run.
    """

    wake: Callable[[], None]
    clips: deque[bytes] = field(default_factory=lambda: deque(maxlen=MOST_CLIPS))
    messages: deque[dict[str, Any]] = field(default_factory=deque)
    chosen: int | None = None
    fresh: bool = False
    greeted: bool = False
    asked: int = 0
    lost: bool = False

    def put(self, message: dict[str, Any]) -> None:
        """Leave a message; it takes the room of an older one of which only the latest counts."""
        if message["type"] in _LATEST:
            same = [one for one in self.messages if one["type"] == message["type"]]
            for one in same:
                self.messages.remove(one)
        self.messages.append(message)
        self.lost |= len(self.messages) > MOST_MESSAGES
        self.wake()


@dataclass(frozen=True)
class Asked:
    """What a page asks for; with no `ask` it has just been opened."""

    hub: Hub
    client: Client
    ask: AnyAsk | None

    def answer(self, message: dict[str, Any]) -> None:
        """Tell that page alone."""
        self.hub.send(self.client, message)


class Hub:
    """Where a run and its pages meet; all methods may be called in any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._clients: list[Client] = []
        self._asked: deque[Asked] = deque()
        self._hear: Callable[[], None] = lambda: None

    def listen(self, hear: Callable[[], None]) -> None:
        """Have something called whenever a page asks for something."""
        self._hear = hear

    @property
    def watched(self) -> bool:
        """Whether any page looks."""
        return bool(self._clients)

    def chosen(self, *, fresh: bool = False) -> list[int]:
        """Slots into which pages look; `fresh`: those that were chosen since the last call."""
        with self._lock:
            found = {one.chosen for one in self._clients if one.fresh or not fresh}
            for one in self._clients:
                one.fresh = False
        return sorted(found - {None})  # type: ignore[type-var]

    def show(self, clip: bytes) -> None:
        """Leave a clip for all pages."""
        with self._lock:
            for client in self._clients:
                if client.greeted:
                    client.clips.append(clip)
                    client.wake()

    def tell(self, message: dict[str, Any], *, about: int | None = None) -> None:
        """Leave a message for all pages, or for those that look into the robot of a slot."""
        with self._lock:
            for client in self._clients:
                if client.greeted and (about is None or client.chosen == about):
                    client.put(message)

    def send(self, client: Client, message: dict[str, Any]) -> None:
        """Leave a message for one page."""
        with self._lock:
            client.greeted |= message["type"] == "hello"
            client.put(message)

    def take(self, client: Client) -> dict[str, Any] | bytes | None:
        """The next thing for a page; None: there is none, or it is too far behind."""
        with self._lock:
            if client.lost:
                return None
            if client.messages:
                return client.messages.popleft()
            return client.clips.popleft() if client.clips else None

    def asked(self) -> list[Asked]:
        """Take what pages have asked for."""
        with self._lock:
            found = list(self._asked)
            self._asked.clear()
            for one in found:
                one.client.asked -= 1
        return found

    def enter(self, client: Client) -> None:
        """A page was opened."""
        with self._lock:
            self._clients.append(client)
        self.ask(client, None)

    def leave(self, client: Client) -> None:
        """A page was closed."""
        with self._lock:
            self._clients.remove(client)

    def ask(self, client: Client, ask: AnyAsk | None) -> None:
        """A page asks for something; ConfigError if too much of it waits already."""
        with self._lock:
            if isinstance(ask, Choose):
                client.chosen, client.fresh = ask.slot, True
            else:
                if client.asked >= MOST_ASKED:
                    raise ConfigError("too many messages; the run takes them one after the other")
                client.asked += 1
                self._asked.append(Asked(self, client, ask))
        self._hear()


class Server:
    """The page and its socket, in a thread of its own; use it in a `with` statement.

    Args:
        hub: Where the run is.
        host: Address to listen at. Any other than the default can be reached from outside.
        port: The first port to try.

    Attributes:
        url: The address of the page, with the token without which nothing is shown.
    """

    def __init__(self, hub: Hub, host: str = "127.0.0.1", port: int = 8642) -> None:
        self._hub, self._token = hub, secrets.token_urlsafe(24)
        self._socket, self._host = bound_socket(host, port), host
        self.port = self._socket.getsockname()[1]
        named = "127.0.0.1" if host in ("0.0.0.0", "::", "localhost") else host
        address = f"[{named}]" if ":" in named else named
        self.url = f"http://{address}:{self.port}/?token={self._token}"
        config = uvicorn.Config(
            self.app(),
            log_level="error",
            ws="websockets-sansio",
            ws_max_size=MOST_MESSAGE_BYTES,
            ws_ping_interval=PING_SECONDS,
            ws_ping_timeout=PING_SECONDS,
            lifespan="off",
            timeout_graceful_shutdown=1,
        )
        self._server = uvicorn.Server(config)
        self._thread = threading.Thread(
            target=self._server.run, kwargs={"sockets": [self._socket]}, daemon=True
        )

    def __enter__(self) -> Server:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._server.should_exit = True
        self._thread.join(timeout=5)
        self._socket.close()

    def app(self) -> Starlette:
        """The application."""
        return Starlette(
            routes=[
                Route("/", self._page),
                WebSocketRoute("/socket", self._talk),
                Mount("/page", _Static(directory=PAGE)),
            ]
        )

    async def _page(self, request: Request) -> Response:
        if not (self._is_known(request) and self._is_here(request)):
            text = "403: the address has a token, which neatq has printed; open that address\n"
            return PlainTextResponse(text, status_code=403, headers=_HEADERS)
        return FileResponse(PAGE / "index.html", headers=_HEADERS)

    def _is_known(self, connection: HTTPConnection) -> bool:
        given = connection.query_params.get("token", "").encode()
        return secrets.compare_digest(given, self._token.encode())

    def _is_here(self, connection: HTTPConnection) -> bool:
        """Whether the page is of this server: no other origin, and no other name for it."""
        host = connection.headers.get("host", "")
        origin = connection.headers.get("origin")
        name = (urlsplit(f"//{host}").hostname or "").lower()
        named = self._host not in ("127.0.0.1", "::1", "localhost") or name in (
            "127.0.0.1",
            "::1",
            "localhost",
        )
        return named and (origin is None or urlsplit(origin).netloc == host)

    async def _talk(self, websocket: WebSocket) -> None:
        if not (self._is_known(websocket) and self._is_here(websocket)):
            await websocket.close(1008)  # before it is accepted: the answer is 403
            return
        await websocket.accept()
        loop, news = asyncio.get_running_loop(), asyncio.Event()

        def wake() -> None:
            with suppress(RuntimeError):  # the loop is closing
                loop.call_soon_threadsafe(news.set)

        client = Client(wake=wake)
        self._hub.enter(client)
        sending = asyncio.create_task(self._send(websocket, client, news))
        hearing = asyncio.create_task(self._hear(websocket, client))
        try:
            await asyncio.wait({sending, hearing}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            self._hub.leave(client)
            for task in (sending, hearing):
                task.cancel()
            await asyncio.gather(sending, hearing, return_exceptions=True)  # it is gone anyway
            with suppress(RuntimeError, WebSocketDisconnect):
                await websocket.close(1001)

    async def _hear(self, websocket: WebSocket, client: Client) -> None:
        while True:
            message = await websocket.receive()
            if message["type"] != "websocket.receive":
                return
            try:
                self._hub.ask(client, read_ask(message.get("text") or message.get("bytes") or b""))
            except ConfigError as error:
                self._hub.send(client, {"type": "refused", "message": str(error)})
                await asyncio.sleep(0.05)  # whoever floods it is heard slowly

    async def _send(self, websocket: WebSocket, client: Client, news: asyncio.Event) -> None:
        while not client.lost:
            await news.wait()
            news.clear()
            while (one := self._hub.take(client)) is not None:
                if isinstance(one, bytes):
                    sent = websocket.send_bytes(one)
                else:
                    sent = websocket.send_text(json.dumps(one, allow_nan=False))
                await asyncio.wait_for(sent, SEND_SECONDS)


class _Static(StaticFiles):
    """The files of the page, with headers."""

    def file_response(self, *args: Any, **kwargs: Any) -> Response:
        """See `StaticFiles`."""
        response = super().file_response(*args, **kwargs)
        response.headers.update(_HEADERS)
        return response


def bound_socket(host: str, port: int) -> socket.socket:
    """A socket that listens at the first free port from `port` on.

    Raises:
        OSError: If there is none, or the address is not this machine's.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    last = min(port + PORTS_TRIED, 65536) - 1
    for number in range(port, last + 1):
        own = socket.socket(family)
        own.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            own.bind((host, number))
            own.listen()
            return own
        except OSError as error:
            own.close()
            if number == last or error.errno not in (errno.EADDRINUSE, errno.EACCES):
                error.filename = f"{host}:{number}"
                raise
    raise AssertionError("there is at least one port")
