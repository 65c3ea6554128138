"""The server of the training window, and pages that mean no good."""

from __future__ import annotations

import base64
import json
import socket
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from neatq_torch.kinds import ConfigError
from neatq_trainers.changes import ChangeExploration
from neatq_trainers.cli import main
from neatq_trainers.folder import load_run
from neatq_trainers.live import command
from neatq_trainers.live.messages import CHANNELS, Choose, Clip, Pause, read_ask
from neatq_trainers.live.recording import record_life
from neatq_trainers.train import Session, resume, train

pytest.importorskip("starlette", reason="the extra live is not installed")
import httpx
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from neatq_trainers.live import server as live_server
from neatq_trainers.live.server import MOST_CLIPS, MOST_MESSAGES, Client, Hub, Server, bound_socket
from neatq_trainers.live.window import Window

SMALL = {"robots": 6, "lifetime_ticks": 100}


@pytest.fixture(scope="module")
def hub() -> Hub:
    return Hub()


@pytest.fixture(scope="module")
def server(hub: Hub) -> Iterator[Server]:
    with Server(hub, port=8750) as opened:
        yield opened


def socket_of(server: Server, token: str | None = None, **headers: str) -> ClientConnection:
    page = httpx.URL(server.url)
    given = page.params["token"] if token is None else token
    address = f"ws://{page.netloc.decode()}/socket?token={given}"
    return connect(address, additional_headers=headers, max_size=None)


def told(connection: ClientConnection, kind: str, seconds: float = 10) -> dict[str, Any]:
    """The next message of a kind."""
    while True:
        text = connection.recv(timeout=seconds)
        if isinstance(text, str) and (message := json.loads(text))["type"] == kind:
            return message


def test_the_page_is_for_whoever_has_the_token(server: Server) -> None:
    answer = httpx.get(server.url)
    assert answer.status_code == 200
    assert "default-src 'self'" in answer.headers["content-security-policy"]
    for other in (server.url[:-1], server.url.split("?")[0], server.url + "a"):
        assert httpx.get(other).status_code == 403
    script = server.url.split("?")[0] + "page/main.js"
    assert httpx.get(script).headers["x-content-type-options"] == "nosniff"
    assert httpx.get(script.replace("main.js", "../server.py")).status_code == 404
    assert httpx.get(script.replace("main.js", "%2e%2e/server.py")).status_code == 404


@pytest.mark.parametrize(
    ("token", "headers"),
    [
        ("wrong", {}),
        ("", {}),
        (None, {"Origin": "http://evil.example"}),
        (None, {"Origin": "null"}),
        (None, {"Origin": "http://127.0.0.1:1"}),
    ],
)
def test_a_socket_of_another_origin_or_without_the_token_is_refused(
    server: Server, token: str | None, headers: dict[str, str]
) -> None:
    with pytest.raises(InvalidStatus, match="403"):
        socket_of(server, token, **headers)


def test_another_name_for_this_machine_is_refused(server: Server) -> None:
    rebound = httpx.get(server.url, headers={"Host": f"evil.example:{server.port}"})
    assert rebound.status_code == 403


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "[" * 10_000,
        '"pause"',
        '{"type": "fly"}',
        '{"type": "speed", "ticks_per_second": "fast"}',
        '{"type": "choose", "slot": 1.5}',
        '{"type": "change", "change": {"kind": "scenario", "scenario": [1]}}',
        '{"type": "change", "change": {"kind": "exploration", "epsilon": NaN}}',
        '{"type": "pause", "too": "much"}',
    ],
)
def test_a_message_that_is_none_is_refused_with_a_sentence(text: str, server: Server) -> None:
    with pytest.raises(ConfigError, match="message: "):
        read_ask(text)
    with socket_of(server) as connection:
        connection.send(text)
        assert "message: " in told(connection, "refused")["message"]


def test_bytes_that_are_no_text_are_refused(server: Server) -> None:
    with socket_of(server) as connection:
        connection.send(b"\xff\xfe\x00")
        assert told(connection, "refused")


def test_a_message_of_100_megabytes_ends_its_connection_alone(server: Server) -> None:
    with socket_of(server) as other, socket_of(server) as connection:
        with pytest.raises(ConnectionClosed):
            for _ in range(100):
                connection.send("x" * 1_000_000 + "y")
                connection.recv(timeout=1)
        other.send("{")
        assert told(other, "refused")


def test_a_flood_of_messages_is_refused_and_memory_stays(hub: Hub, server: Server) -> None:
    with socket_of(server) as connection:
        for _ in range(2000):
            connection.send('{"type": "pause"}')
        assert "too many messages" in told(connection, "refused")["message"]
        assert len(hub.asked()) <= 2 * 100


def test_a_page_that_takes_nothing_is_cut_off_and_never_waited_for() -> None:
    hub, client = Hub(), Client(wake=lambda: None)
    hub.enter(client)
    hub.send(client, {"type": "hello"})
    for number in range(MOST_MESSAGES + 10):
        hub.show(b"clip")
        hub.tell({"type": "state", "state": number})
        hub.tell({"type": "rows", "rows": [number]})
    assert len(client.clips) == MOST_CLIPS
    assert client.lost
    states = [one for one in client.messages if one["type"] == "state"]
    assert states == [{"type": "state", "state": MOST_MESSAGES + 9}]


def test_a_page_whose_machine_went_to_sleep_is_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live_server, "PING_SECONDS", 0.3)
    hub = Hub()
    with (
        Server(hub, port=8790) as opened,
        socket.create_connection(("127.0.0.1", opened.port)) as lid,
    ):
        token = opened.url.partition("=")[2]
        lines = [f"GET /socket?token={token} HTTP/1.1", f"Host: 127.0.0.1:{opened.port}"]
        lines += ["Upgrade: websocket", "Connection: Upgrade", "Sec-WebSocket-Version: 13"]
        lines += ["Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==", "", ""]
        lid.sendall("\r\n".join(lines).encode())
        assert b"101" in lid.recv(100)
        for there in (True, False):  # it answers no ping, and does not close
            end = time.monotonic() + 10
            while hub.watched != there:
                assert time.monotonic() < end
                time.sleep(0.05)


def test_pages_are_told_of_the_robot_that_they_look_into_alone() -> None:
    hub = Hub()
    one, two = (Client(wake=lambda: None) for _ in range(2))
    for client, slot in ((one, 3), (two, 5)):
        hub.enter(client)
        hub.send(client, {"type": "hello"})
        hub.ask(client, Choose(slot))
    assert hub.chosen() == [3, 5]
    hub.tell({"type": "robot", "slot": 3}, about=3)
    assert [len(client.messages) for client in (one, two)] == [2, 1]
    hub.leave(one)
    assert hub.chosen() == [5]


def test_a_busy_port_is_passed_over() -> None:
    with socket.socket() as busy:
        busy.bind(("127.0.0.1", 0))
        busy.listen()
        port = busy.getsockname()[1]
        with bound_socket("127.0.0.1", port) as found:
            assert port < found.getsockname()[1] <= port + 20


def test_a_clip_is_read_back_from_its_bytes() -> None:
    rng = np.random.default_rng(0)
    shapes = {"poses": (4, 3, 3), "robots": (3, len(CHANNELS)), "flags": (4, 1, 3), "shots": (2, 6)}
    arrays = {name: rng.random(shape).astype("<f4") for name, shape in shapes.items()}
    packed = Clip(tick=1234, ticks_per_frame=2, seconds=0.5, **arrays).pack()
    assert packed[:4] == b"NQC1"
    head = np.frombuffer(packed[8:16], "<u2").tolist()
    assert int.from_bytes(packed[4:8], "little") == 1234
    assert head == [4, 3, 3 + len(CHANNELS), 2]
    assert np.frombuffer(packed[16:20], "<f4")[0] == 0.5
    assert np.frombuffer(packed[20:24], "<u2").tolist() == [2, 1]
    joined = np.concatenate([one.ravel() for one in arrays.values()])
    np.testing.assert_array_equal(np.frombuffer(packed[24:], "<f4"), joined)


class Person(Window):
    """A window that looks from inside: what its hub would tell is kept."""

    def __init__(self, ask: dict[int, Any], **settings: Any) -> None:
        self.hub_of_mine, self.client = Hub(), Client(wake=lambda: None)
        super().__init__(self.hub_of_mine, **settings)
        self.hub_of_mine.enter(self.client)
        self._ask = ask

    def rows(self, session: Session, rows: Any) -> None:
        if (ask := self._ask.pop(session.lengths["ticks"], None)) is not None:
            self.hub_of_mine.ask(self.client, ask)
        super().rows(session, rows)

    def messages(self, kind: str) -> list[dict[str, Any]]:
        return [one for one in self.client.messages if one["type"] == kind]


def test_a_run_is_the_same_with_a_page_open_and_without(tmp_path: Path) -> None:
    runs = []
    for name, callbacks in (("alone", []), ("watched", [Person({}, ticks_per_second=None)])):
        path = tmp_path / name
        train("wall", env_kwargs=SMALL, ticks=400, out=path, callbacks=callbacks)
        runs.append((path / "metrics.csv").read_bytes())
    assert runs[0] == runs[1]


@pytest.mark.parametrize(
    ("task", "arm", "world"),
    [
        ("switch", "neatq", "arena"),
        ("wall", "qlearning", "arena"),
        ("nero", "rtneat", "nero"),
        ("gym:CartPole-v1", "neat", "gymnasium"),
        ("gym:CartPole-v1", "rtneat", "gymnasium"),
    ],
)
def test_every_world_is_shown(task: str, arm: str, world: str, tmp_path: Path) -> None:
    person = Person({}, ticks_per_second=None)
    person.hub_of_mine.ask(person.client, Choose(2))
    gymnasium = world == "gymnasium"
    length: dict[str, Any] = {"steps": 2000} if gymnasium else {"ticks": 400}
    kwargs = None if gymnasium else SMALL
    settings = {"world.slots": 6} if gymnasium else None
    out = tmp_path / "run"
    train(task, arm, env_kwargs=kwargs, settings=settings, **length, out=out, callbacks=[person])
    (hello,) = person.messages("hello")
    assert hello["world"] == world
    assert hello["robots"] == 6
    json.dumps(list(person.client.messages), allow_nan=False)
    assert bool(person.client.clips) == (not gymnasium)
    assert person.messages("robots")[-1]["robots"][5]["slot"] == 5
    assert person.messages("robot")[-1]["slot"] == 2
    assert person.messages("rows")
    if arm == "neat":
        assert "replace" not in hello["can"]


def test_a_pause_lets_the_run_stand_until_it_is_to_go_on(tmp_path: Path) -> None:
    class Patient(Person):
        idles = 0

        def idle(self, session: Session) -> None:
            self.idles += 1
            assert session.lengths["ticks"] == 120
            session.paused = self.idles < 3

    person = Patient({120: Pause()}, ticks_per_second=None)
    train("wall", env_kwargs=SMALL, ticks=200, out=tmp_path / "run", callbacks=[person])
    assert person.idles == 3


def test_a_speed_is_kept_to(tmp_path: Path) -> None:
    begun = time.monotonic()
    person = Person({}, ticks_per_second=400)
    train("wall", env_kwargs=SMALL, ticks=800, out=tmp_path / "run", callbacks=[person])
    assert time.monotonic() - begun > 1.9


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--port", "0"], "port: expected 1 to 65535"),
        (["--port", "many"], "invalid int value"),
        (["--speed", "-1"], "speed: expected 0 to 100,000"),
        (["--host", "256.0.0.1"], "256.0.0.1"),
        (["--workers", "4"], "workers: expected 1 with a window"),
        (["--task", "nosuch"], "nosuch"),
        (["runs/none"], "runs/none"),
    ],
)
def test_play_refuses_bad_options_in_a_sentence(
    arguments: list[str], words: str, capsys: Any, tmp_path: Path, monkeypatch: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["play", "--no-browser", *arguments]) == 2
    said = capsys.readouterr()
    assert words in said.err
    assert "http" not in said.out or "256" in words
    assert list(tmp_path.iterdir()) == []


def test_play_without_the_extra_says_what_to_install(
    capsys: Any, tmp_path: Path, monkeypatch: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(command, "find_spec", lambda name: None if name == "uvicorn" else name)
    assert main(["play"]) == 2
    assert "pip install 'neatq_torch[live]'" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_without_a_browser_the_address_is_printed(
    capsys: Any, tmp_path: Path, monkeypatch: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(command.webbrowser, "open", lambda _: False)
    arguments = ["--task", "flag", "--env-kwargs", "robots=4", "--ticks", "40", "--speed", "0"]
    assert main(["play", *arguments]) == 0
    said = capsys.readouterr()
    assert "http://127.0.0.1:" in said.out
    assert "no browser was found" in said.err
    assert (tmp_path / "runs" / "play-1" / "metrics.csv").is_file()


def test_a_finished_run_stays_and_a_copy_of_it_goes_on(
    capsys: Any, tmp_path: Path, monkeypatch: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    run = train("flag", "rtneat", env_kwargs=SMALL, ticks=200, out="runs/mine")
    before = {path.name: path.read_bytes() for path in run.path.iterdir() if path.is_file()}
    monkeypatch.setattr(Window, "rows", _stop_at_400)
    assert main(["play", "runs/mine", "--no-browser", "--speed", "0"]) == 0
    assert "runs/play-1 goes on from there" in capsys.readouterr().out
    assert load_run("runs/play-1").metrics()["tick"][-1] == 400
    assert before == {path.name: path.read_bytes() for path in run.path.iterdir()}


def _stop_at_400(_: Window, session: Session, rows: Any) -> None:
    session.stop |= session.lengths["ticks"] >= 400


def test_a_run_of_several_processes_is_refused_in_a_sentence(
    capsys: Any, tmp_path: Path, monkeypatch: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    train("flag", "rtneat", env_kwargs=SMALL, ticks=80, arenas=2, workers=2, out="runs/two")
    assert main(["play", "runs/two", "--ticks", "400", "--no-browser"]) == 2
    assert "begin a run with --workers 1" in capsys.readouterr().err


@pytest.mark.parametrize("task", ["wall", "nero"])
def test_a_page_in_one_file_shows_what_a_resumed_run_does(task: str, tmp_path: Path) -> None:
    class Explorer(Window):
        def rows(self, session: Session, rows: Any) -> None:
            if task == "wall" and not session.folder.record.entries:
                session.wanted.append(ChangeExploration(0.9))

    arm, more = ("replay", {}) if task == "wall" else ("rtneat", {"hit_points": 10_000})
    how: dict[str, Any] = {"env_kwargs": {**SMALL, "lifetime_ticks": 1000, **more}, "ticks": 240}
    run = train(task, arm, **how, out=tmp_path / "run", callbacks=[Explorer(Hub())])
    clips = clip_bytes(record_life(run, 80)["base64"])
    track = resume(run.path, ticks=400).read()["track"].swapaxes(0, 1)  # before each tick
    for clip in clips:
        tick, poses = int.from_bytes(clip[4:8], "little"), poses_of(clip)[:, :6]
        np.testing.assert_array_equal(poses, track[tick : tick + 4 * len(poses) : 4])


def clip_bytes(text: str) -> list[bytes]:
    data, clips = base64.b64decode(text), []
    while data:
        length = int.from_bytes(data[:4], "little")
        clips.append(data[4 : 4 + length])
        data = data[4 + length :]
    return clips


def poses_of(clip: bytes) -> np.ndarray:
    frames, robots = np.frombuffer(clip[8:12], "<u2").tolist()
    return np.frombuffer(clip, "<f4", frames * robots * 3, 24).reshape(frames, robots, 3)
