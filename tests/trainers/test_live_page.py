"""The page of the training window, driven in a real browser, with a real run behind it."""

from __future__ import annotations

import io
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from neatq_trainers.folder import load_run
from neatq_trainers.train import train

pytest.importorskip("starlette", reason="the extra live is not installed")
sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
)
FLAGS = ["--no-sandbox", "--disable-gpu", "--disable-background-networking", "--disable-sync"]
PICTURES = Path(__file__).parents[2] / "docs" / "live"
"""Of the docs; NEATQ_PICTURES=1 takes them anew, which takes some minutes."""
TAKEN = bool(os.environ.get("NEATQ_PICTURES"))
pytestmark = pytest.mark.skipif(
    CHROMIUM is None,
    reason="no Chromium on this machine, so the page is not driven (apt install chromium)",
)


class Played:
    """A `neatq play` in a process of its own.

    Attributes:
        url: Where its page is.
        folder: Of its run.
    """

    def __init__(self, here: Path, *arguments: str) -> None:
        self.folder = here / "runs" / "play-1"
        command = [sys.executable, "-m", "neatq_trainers", "play", "--no-browser", "--port", "8700"]
        self.process = subprocess.Popen(
            [*command, *arguments],
            cwd=here,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            env={**os.environ, "OMP_NUM_THREADS": "1"},
        )
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        found = re.search(r"http://\S+", line)
        assert found is not None, line
        self.url = found[0]

    def stop(self, how: signal.Signals = signal.SIGINT) -> int:
        """End it; returns the exit status."""
        self.process.send_signal(how)
        self.process.communicate(timeout=60)
        return self.process.returncode


class Reader:
    """Somebody who looks at a page; errors of the console are kept."""

    def __init__(self, browser: Any, address: str, **settings: Any) -> None:
        # Playwright evaluates texts in the page, which its policy forbids: a test looks at that.
        settings = {"viewport": {"width": 1400, "height": 900}, "bypass_csp": True} | settings
        context = browser.new_context(**settings)
        self.page, self.errors = context.new_page(), list[str]()
        self.page.set_default_timeout(60_000)
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.on("console", self._note)
        self.page.goto(address)

    def _note(self, message: Any) -> None:
        if message.type == "error":
            self.errors.append(message.text)

    def wait_for(self, condition: str) -> None:
        """Wait until an expression of JavaScript holds."""
        self.page.wait_for_function(condition)

    def get(self, expression: str) -> Any:
        """The value of an expression of JavaScript."""
        return self.page.evaluate(expression)

    def drag(self, start: tuple[float, float], end: tuple[float, float]) -> None:
        """Drag from one place of the field to another."""
        self.page.mouse.move(*self.get(f"neatq.toScreen({start[0]}, {start[1]})"))
        self.page.mouse.down()
        self.page.mouse.move(*self.get(f"neatq.toScreen({end[0]}, {end[1]})"), steps=5)
        self.page.mouse.up()

    def slide(self, slider: str, value: float) -> None:
        """Move a slider and let it go."""
        self.page.locator(slider).evaluate(
            """(slider, value) => {
                slider.value = value;
                for (const name of ["input", "change"])
                    slider.dispatchEvent(new Event(name, {bubbles: true}));
            }""",
            value,
        )

    def close(self) -> None:
        """Close the page; it has told no error."""
        self.page.context.close()
        assert self.errors == []


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with sync_api.sync_playwright() as playwright:
        opened = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield opened
        opened.close()


@pytest.fixture(scope="module")
def here(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("played")


@pytest.fixture(scope="module")
def played(here: Path) -> Iterator[Played]:
    robots = ["--env-kwargs", "robots=20", "lifetime_ticks=200"]
    run = Played(here, "--task", "wall", "--arm", "replay", *robots, "--speed", "600")
    yield run
    run.stop(signal.SIGKILL)


@pytest.fixture(scope="module")
def reader(browser: Any, played: Played) -> Iterator[Reader]:
    opened = Reader(browser, played.url)
    opened.wait_for("window.neatq?.state && neatq.stats.clips_received > 3")
    yield opened
    opened.close()


def recorded(played: Played, kind: str) -> list[dict[str, Any]]:
    """The changes of a kind that a run has written down."""
    path = played.folder / "changes.jsonl"
    lines = path.read_text().splitlines() if path.exists() else []
    changes = [json.loads(line)["change"] for line in lines]
    return [one for one in changes if one["kind"] == kind]


def until(condition: Callable[[], Any], seconds: float = 30.0) -> Any:
    """Wait for something to hold."""
    end = time.monotonic() + seconds
    while not (found := condition()):
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.1)
    return found


def test_robots_are_seen_to_move(reader: Reader) -> None:
    first = reader.get("[0, 1, 2, 3].map((slot) => neatq.placeOf(slot))")
    reader.wait_for(
        f"JSON.stringify([0, 1, 2, 3].map((s) => neatq.placeOf(s))) !== '{json.dumps(first)}'"
    )
    tick = int(reader.page.locator("#tick").get_attribute("data-tick"))
    reader.wait_for(f"Number(document.querySelector('#tick').dataset.tick) > {tick}")
    assert reader.get("neatq.hello.robots") == 20


def test_a_wall_that_is_dragged_is_found_in_the_scenario(reader: Reader, played: Played) -> None:
    reader.page.click("#edit")
    reader.drag((400, 400), (500, 450))
    change = until(lambda: recorded(played, "scenario"))[0]
    wall = change["scenario"]["walls"][0]
    assert (wall["x"], wall["y"]) == pytest.approx((500, 450), abs=4)
    reader.wait_for("Math.abs(neatq.state.scenario.walls[0].x - 500) < 4")


def test_what_cannot_be_is_told_and_goes_back(reader: Reader) -> None:
    wall = reader.get("neatq.state.scenario.walls[0]")
    reader.drag((wall["x"], wall["y"]), (400, 266))  # onto the spawn
    reader.wait_for("document.querySelector('#message').textContent.includes('begin inside')")
    assert reader.get("neatq.state.scenario.walls[0]") == wall
    reader.page.click("#edit")


def test_undo_takes_the_last_change_back(reader: Reader) -> None:
    reader.page.click("#undo")
    reader.wait_for("neatq.state.scenario.walls[0].x === 400 && neatq.state.undo === 0")


def test_a_slider_changes_what_it_says(reader: Reader, played: Played) -> None:
    reader.slide("#exploration-epsilon", 0.2)
    until(lambda: recorded(played, "exploration"))
    value = recorded(played, "exploration")[-1]["epsilon"]
    assert value == pytest.approx(0.2, abs=0.01)
    reader.wait_for(f"Math.abs(neatq.state.exploration.epsilon - {value}) < 1e-6")  # told later
    reader.slide("#lifetime", 300)
    until(
        lambda: [one for one in recorded(played, "scenario") if "lifetime_ticks" in one["scenario"]]
    )
    reader.wait_for("neatq.state.scenario.lifetime_ticks === 300")


def test_a_robot_that_is_clicked_shows_its_network(reader: Reader) -> None:
    reader.page.click("#pause")
    reader.wait_for("neatq.state.paused")
    reader.page.locator("#robots-table tbody tr").nth(4).click()
    reader.wait_for("neatq.robot?.network?.links.length > 0")
    robot = reader.get("neatq.robot")
    inputs = [node for node in robot["network"]["nodes"] if node["kind"] == "input"]
    assert [node["name"] for node in inputs] == reader.get("neatq.hello.observations")
    by_id = robot["activations"]
    seen = [by_id[str(node["id"])] for node in inputs]
    assert seen == pytest.approx(robot["observation"], abs=1e-3)
    values = [one["value"] for one in robot["candidates"]]
    assert len(values) == 5
    assert values[1:] == sorted(values[1:], reverse=True)
    assert reader.page.locator("#network").is_visible()


def test_paused_it_stands_and_a_step_is_one_stride(reader: Reader) -> None:
    before = reader.get("neatq.state.tick")
    time.sleep(0.5)
    assert reader.get("neatq.state.tick") == before
    reader.page.click("#step")
    reader.wait_for(f"neatq.state.tick > {before} && neatq.state.paused")
    assert reader.get("neatq.state.tick") == before + 40


def test_a_team_is_kept_and_taken_again(reader: Reader, played: Played) -> None:
    reader.page.fill("#save-name", "before lunch")
    reader.page.click("#save")
    until((played.folder / "teams" / "before lunch.json").exists)
    reader.page.click("#pause")
    reader.wait_for("!neatq.state.paused")
    reader.page.select_option("#load-name", "before lunch")
    reader.page.click("#load")
    team = until(lambda: recorded(played, "team"))[0]
    assert len(team["genomes"]) == 20


def test_a_good_robot_is_marked_protected_and_bred(reader: Reader, played: Played) -> None:
    slot = reader.get("neatq.chosen")
    reader.page.click("#prefer")
    reader.page.click("#protect")
    reader.wait_for(
        f"neatq.state.protected.includes({slot}) && neatq.state.preferred.includes({slot})"
    )
    reader.page.click("#breed")
    reader.page.locator("#robots-table tbody tr").nth(9).click()
    until(lambda: recorded(played, "breed"))
    reader.page.click("#replace")
    until(lambda: recorded(played, "replace"))


def test_two_pages_look_at_one_run_and_a_phone_is_one(
    browser: Any, played: Played, reader: Reader
) -> None:
    phone = Reader(browser, played.url, viewport={"width": 390, "height": 844}, color_scheme="dark")
    phone.wait_for("window.neatq?.stats.clips_received > 3")
    wide = phone.get("document.documentElement.scrollWidth")
    assert wide <= 390
    phone.page.click("#pause")
    reader.wait_for("neatq.state.paused")
    phone.page.click("#pause")
    phone.close()


def test_it_is_drawn_at_the_rate_of_the_screen(reader: Reader) -> None:
    """What the page measures of itself is told; machines differ too much for more than a floor."""
    stats = reader.get("neatq.stats")
    print(f"frames a second {stats['fps']:.0f}, input to picture {stats['latency_ms']} ms")
    assert stats["fps"] > 5


def test_the_policy_forbids_scripts_of_others(browser: Any, played: Played) -> None:
    strict = Reader(browser, played.url, bypass_csp=False)
    strict.page.wait_for_selector("#field")
    with pytest.raises(sync_api.Error, match="Content Security Policy"):
        strict.page.add_script_tag(content="window.taken = 1")
    strict.page.context.close()


def test_a_run_that_was_steered_and_killed_goes_on_as_one_that_was_not(
    played: Played, reader: Reader, here: Path
) -> None:
    reader.page.context.close()
    played.stop(signal.SIGKILL)
    record = played.folder / "changes.jsonl"
    last = json.loads(record.read_text().splitlines()[-1])["tick"]
    ticks = str(max(last, load_run(played.folder).read()["done"]["ticks"]) + 200)
    robots = ["--env-kwargs", "robots=20", "lifetime_ticks=200"]
    command = [sys.executable, "-m", "neatq_trainers"]
    subprocess.run([*command, "resume", "runs/play-1", "--ticks", ticks], cwd=here, check=True)
    again = ["train", "--task", "wall", "--arm", "replay", *robots, "--ticks", ticks]
    again += ["--changes", str(record), "--out", "runs/again"]
    subprocess.run([*command, *again], cwd=here, check=True)
    one, two = played.folder, here / "runs" / "again"
    for name in ("metrics.csv", "champion.json"):
        assert (one / name).read_bytes() == (two / name).read_bytes(), name


def test_a_page_in_one_file_plays_without_anybody(played: Played, here: Path, browser: Any) -> None:
    command = [sys.executable, "-m", "neatq_trainers", "export", "runs/play-1"]
    subprocess.run([*command, "--html", "life.html", "--ticks", "400"], cwd=here, check=True)
    page = here / "life.html"
    assert page.stat().st_size < 5_000_000
    asked: list[str] = []
    reader = Reader(browser, "about:blank")
    reader.page.on("request", lambda request: asked.append(request.url))
    reader.page.goto(page.as_uri())
    reader.wait_for("neatq.placeOf(3) !== null")
    reader.page.locator("#robots-table tbody tr").nth(3).click()
    reader.wait_for("neatq.robot?.network?.links.length > 0")
    assert [one for one in asked if not one.startswith(("file:", "data:", "blob:"))] == []
    reader.close()


def test_a_gymnasium_run_shows_its_curves_and_an_episode_of_its_champion(
    browser: Any, tmp_path: Path
) -> None:
    few = ["--world.slots", "8", "--world.every", "1", "--world.episodes", "2"]
    run = Played(tmp_path, "--task", "gym:CartPole-v1", "--arm", "neat", *few, "--speed", "0",
                 "--generations", "500", "--checkpoint-seconds", "0.2")  # fmt: skip
    reader = Reader(browser, run.url)
    reader.wait_for("window.neatq?.hello")
    until((run.folder / "champion.json").exists)
    assert not reader.page.locator("#field").is_visible()
    reader.page.click("#watch")
    reader.wait_for("document.querySelector('#film').naturalWidth > 50")
    reader.close()
    run.stop(signal.SIGKILL)


def test_a_team_fights_another_and_turrets_come_and_go(browser: Any, tmp_path: Path) -> None:
    few = {"robots": 10, "lifetime_ticks": 200}
    train("nero", "rtneat", env_kwargs=few, ticks=200, out=tmp_path / "runs" / "others")
    robots = ["--env-kwargs", *(f"{name}={value}" for name, value in few.items())]
    run = Played(tmp_path, "--task", "nero", "--arm", "rtneat", *robots, "--speed", "600")
    reader = Reader(browser, run.url)
    reader.wait_for("window.neatq?.state && neatq.stats.clips_received > 3")
    reader.slide("#weight-avoid_fire", 0.5)
    reader.wait_for("Math.abs(neatq.state.weights.avoid_fire - 0.5) < 0.02")
    reader.page.click("#edit")
    reader.page.click("#add-turret")
    reader.wait_for("neatq.state.scenario.turrets.length === 2")
    reader.page.click("#undo")
    reader.wait_for("neatq.state.scenario.turrets.length === 1")
    reader.page.select_option("#opponent", "runs/others")
    reader.page.click("#battle")
    reader.page.wait_for_selector("#timeline-back", state="visible")
    assert "this team against others" in reader.page.locator("#timeline-what").inner_text()
    reader.page.click("#timeline-back")
    reader.page.wait_for_selector("#timeline-back", state="hidden")
    reader.close()
    run.stop(signal.SIGKILL)


# ------------------------------------------------------------------------------------ pictures


def neatq(here: Path, *words: str) -> None:
    subprocess.run([sys.executable, "-m", "neatq_trainers", *words], cwd=here, check=True)


WIDE = {"width": 1340, "height": 830}


def stand(reader: Reader, share: float) -> None:
    """Pause when a share of a life is over, or a stride later."""
    tick = "Number(document.querySelector('#tick').dataset.tick) % 1000"
    reader.wait_for(f"{tick} >= {1000 * share} && {tick} < {1000 * share + 100}")
    reader.page.click("#pause")
    reader.wait_for("neatq.state.paused")
    time.sleep(2)  # for what is still to be drawn


def picture(reader: Reader, name: str, **part: Any) -> None:
    """What a page shows, as small as it can be."""
    PICTURES.mkdir(exist_ok=True)
    content = Image.open(io.BytesIO(reader.page.screenshot(**part)))
    content.convert("RGB").save(PICTURES / f"{name}.png", optimize=True)


@pytest.mark.skipif(not TAKEN, reason="NEATQ_PICTURES=1 takes the pictures of the docs")
def test_pictures_of_a_team_at_a_wall(browser: Any, tmp_path: Path) -> None:
    neatq(tmp_path, "train", "--task", "wall", "--ticks", "12000", "--out", "runs/play-1")
    run = Played(tmp_path, "runs/play-1", "--ticks", "1000000", "--speed", "120")
    reader = Reader(browser, run.url, viewport=WIDE)
    reader.wait_for("window.neatq?.state && neatq.stats.clips_received > 3")
    stand(reader, 0.3)
    picture(reader, "window")
    reader.page.click("#edit")
    wall = reader.get("neatq.state.scenario.walls[0]")
    reader.drag((wall["x"], wall["y"]), (wall["x"] + 60, wall["y"] + 20))
    reader.wait_for(f"neatq.state.scenario.walls[0].x > {wall['x'] + 50}")
    time.sleep(1)
    picture(reader, "edit")
    reader.page.click("#edit")
    reader.page.click("#undo")
    cells = "[...document.querySelectorAll('#robots-table tbody tr')].map((row) => row.cells[1])"
    fitness = reader.get(f"{cells}.map((cell) => parseFloat(cell.textContent) || 0)")
    reader.page.locator("#robots-table tbody tr").nth(fitness.index(max(fitness))).click()
    reader.page.click("#pause")
    reader.wait_for("!neatq.state.paused && neatq.robot?.network")
    stand(reader, 0.3)
    reader.page.click("#prefer")
    reader.page.click("#protect")
    reader.wait_for("neatq.state.protected.length && neatq.state.preferred.length")
    time.sleep(1)
    picture(reader, "robot")
    reader.close()
    phone = Reader(browser, run.url, viewport={"width": 390, "height": 844}, color_scheme="dark")
    phone.wait_for("window.neatq?.stats.clips_received > 0 || neatq?.state")
    phone.page.click("#pause")
    stand(phone, 0.3)
    picture(phone, "phone")
    phone.close()
    run.stop()
    neatq(tmp_path, "export", "runs/play-1", "--html", "life.html")
    file = Reader(browser, (tmp_path / "life.html").as_uri(), viewport=WIDE)
    file.wait_for("neatq.placeOf(3) !== null")
    time.sleep(5)
    picture(file, "file", clip={"x": 0, "y": 0, "width": 1340, "height": 640})
    file.close()


@pytest.mark.skipif(not TAKEN, reason="NEATQ_PICTURES=1 takes the pictures of the docs")
def test_pictures_of_a_team_that_fights(browser: Any, tmp_path: Path) -> None:
    reward = ["--reward", "approach_enemy=0.5", "hit_target=1"]
    task = ["--task", "nero", *reward]
    neatq(tmp_path, "train", *task, "--ticks", "10000", "--out", "runs/play-1")
    neatq(tmp_path, "train", *task, "--ticks", "2000", "--out", "runs/beginners")
    run = Played(tmp_path, "runs/play-1", "--ticks", "1000000", "--speed", "120")
    reader = Reader(browser, run.url, viewport=WIDE)
    reader.wait_for("window.neatq?.state && neatq.stats.clips_received > 3")
    reader.page.select_option("#opponent", "runs/beginners")
    reader.page.click("#battle")
    reader.page.wait_for_selector("#timeline-back", state="visible")
    time.sleep(6)
    picture(reader, "battle")
    reader.close()
    run.stop()
