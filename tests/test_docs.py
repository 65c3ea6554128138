"""The site builds without a warning, and what stands on its pages is true: all code runs."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
import webbrowser
from collections.abc import Iterator
from contextlib import suppress
from html.parser import HTMLParser
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import unquote

import gymnasium
import matplotlib
import pytest

import neatq_envs
import neatq_experiments.command
import neatq_torch
import neatq_torch.interop
import neatq_trainers.export
import neatq_trainers.info
import neatq_trainers.train
from neatq_trainers import cli

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
PAGES = sorted([ROOT / "README.md", *DOCS.rglob("*.md")])
FENCE = re.compile(
    r"(?:^<!-- not run: (.+?) -->\n)?^``` ?([^\n]*)\n(.*?)^```", re.MULTILINE | re.DOTALL
)
FACES = (neatq_torch, neatq_envs, neatq_torch.interop)
UNDERSTOOD = (
    (neatq_trainers.train, "start"),
    (neatq_trainers.train, "resume"),
    (neatq_trainers.export, "_champion_at"),
    (neatq_trainers.export, "_write_page"),
    (neatq_trainers.info, "version_of"),
    (neatq_experiments.command, "run_comparison"),
    (neatq_experiments.command, "run_experiment"),
)


SCRIPT = "{ .python }"
"""The language of a block that shows a whole script of examples/; these run elsewhere."""


class Block(NamedTuple):
    """Code on a page.

    Attributes:
        reason: Why it is for reading only; empty where it runs.
        language: As the page says.
        code: What stands there.
        line: Of its first line.
    """

    reason: str
    language: str
    code: str
    line: int


def blocks(page: Path, *languages: str) -> list[Block]:
    text = page.read_text(encoding="utf-8")
    found = (
        Block(one[1] or "", one[2], one[3], text[: one.start(3)].count("\n") + 1)
        for one in FENCE.finditer(text)
    )
    return [one for one in found if one.language in languages]


def commands(page: Path) -> Iterator[tuple[int, list[str]]]:
    """The lines of shell blocks, without comments."""
    for block in blocks(page, "sh"):
        for number, line in enumerate(block.code.splitlines(), block.line):
            if not block.reason and (words := shlex.split(line, comments=True)):
                yield number, words


def name_of(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


# ------------------------------------------------------------------------------------ the site


class Links(HTMLParser):
    """Where a page of the site points to, and the anchors that it has."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.links: list[str] = []
        self.anchors: set[str] = set()
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        named = dict(attrs)
        self.anchors |= {value for key in ("id", "name") if (value := named.get(key))}
        key = {"a": "href", "link": "href", "img": "src", "script": "src"}.get(tag, "")
        self.links += [value] if (value := named.get(key)) else []


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> dict[Path, Links]:
    """The pages of the site, built as `make docs` does."""
    out = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(out)]
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(
        command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False
    )
    said = done.stdout + done.stderr
    assert (done.returncode, "WARNING" in said, "ERROR" in said) == (0, False, False), said
    return {path: Links(path) for path in out.rglob("*.html")}


def test_no_page_of_the_site_leads_nowhere(site: dict[Path, Links]) -> None:
    assert len(site) > 30
    broken = []
    for path, page in site.items():
        if path.name == "404.html":  # its links are those of the server's root
            continue
        for link in page.links:
            to, _, anchor = unquote(link).partition("#")
            if ":" in to:  # another server's
                continue
            target = (path.parent / to).resolve() if to else path
            if not target.exists() or (anchor and anchor not in site[target].anchors):
                broken.append(f"{path.name}: {link}")
    assert not broken


def test_the_site_asks_no_other_server_for_anything(site: dict[Path, Links]) -> None:
    for path in site:
        text = path.read_text(encoding="utf-8")
        assert not re.search(r"""<(script|img|link)[^>]+(src|href)=["']?https?:""", text), path


@pytest.mark.parametrize("face", FACES, ids=lambda face: face.__name__)
def test_every_public_name_is_on_a_page(site: dict[Path, Links], face: Any) -> None:
    anchors = {one for page in site.values() for one in page.anchors}
    assert [name for name in face.__all__ if f"{face.__name__}.{name}" not in anchors] == []


def test_every_command_is_on_a_page(site: dict[Path, Links]) -> None:
    (page,) = (links for path, links in site.items() if path.name == "commands.html")
    assert [name for name in cli._COMMANDS if f"neatq-{name}" not in page.anchors] == []


def test_every_option_of_a_command_is_on_its_page(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    text = (DOCS / "api" / "commands.md").read_text(encoding="utf-8")
    sections = {part.split("\n")[0]: part for part in text.split("\n## neatq ")[1:]}
    for name, section in sections.items():
        if name == "list":
            continue
        with suppress(SystemExit):
            cli.main([name, "--help"])
        told = re.findall(r"^\W*(--[a-z][a-z-]*)(?=[ ,])", capsys.readouterr().out, re.MULTILINE)
        assert [one for one in told if one not in section and one != "--help"] == [], name


# ------------------------------------------------------------------------------------ its code


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_block_has_a_language(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    known = {"python", "sh", "text", "json", "c", "ini", "yaml", "docker", SCRIPT}
    assert {one[2] for one in FENCE.finditer(text)} <= known


@pytest.mark.usefixtures("blank_pictures")
@pytest.mark.parametrize("page", [one for one in PAGES if blocks(one, "python")], ids=name_of)
def test_the_python_on_a_page_runs(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One block after the other, as a reader would type them."""
    monkeypatch.chdir(tmp_path)
    matplotlib.use("agg")
    # Nothing on a page depends on the length of an episode, and most of the time would go there.
    monkeypatch.setattr(gymnasium.spec("CartPole-v1"), "max_episode_steps", 50)
    names: dict[str, Any] = {"__name__": "__main__"}
    for block in blocks(page, "python"):
        if "docs/study" in block.code:  # a reader is in the folder of the project
            shutil.copytree(DOCS / "study", "docs/study")
        if not block.reason:
            code = "\n" * (block.line - 1) + block.code
            exec(compile(code, str(page), "exec"), names)


def refuse(*_: object, **__: object) -> None:
    """What a command calls once it has understood its options."""
    raise KeyboardInterrupt


@pytest.mark.parametrize("page", [one for one in PAGES if blocks(one, "sh")], ids=name_of)
def test_the_commands_on_a_page_are_understood(
    page: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for module, name in UNDERSTOOD:
        monkeypatch.setattr(module, name, refuse)
    monkeypatch.setattr(webbrowser, "open", lambda _: True)
    targets = re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
    for number, (program, *arguments) in commands(page):
        where = f"{name_of(page)}:{number}"
        if program == "make":
            assert arguments[0] in targets, where
        elif program == "neatq":
            with suppress(SystemExit):  # of --help
                assert cli.main(arguments) in (0, 130), f"{where}: {capsys.readouterr().err}"
        else:
            assert program in {"pip", "python", "tensorboard", "git"}, where


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_a_page_leads_to_files_that_are_there(page: Path) -> None:
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.M | re.S)
    links = re.findall(r"\]\(([^)#]+?)(?:#[^)]*)?\)", text)
    broken = [one for one in links if ":" not in one and not (page.parent / one).exists()]
    assert not broken


def test_the_readme_is_two_screens() -> None:
    lines = (ROOT / "README.md").read_text(encoding="utf-8").splitlines()
    assert len(lines) <= 110
