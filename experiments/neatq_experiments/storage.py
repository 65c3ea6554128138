"""A folder of work, mirrored where other machines find it."""

from __future__ import annotations

import shutil
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import fsspec

from neatq_trainers.folder import CHECKPOINT

MIRROR_SECONDS = 30.0
"""Time between two looks at what has changed: so much work is lost with a machine."""


@contextmanager
def mirrored(folder: Path, storage: str | None) -> Iterator[Path]:
    """A folder to work in, with what somebody else has left there who was interrupted.

    Args:
        folder: ARM/WORK in the folder of the results; made if there is no storage.
        storage: URL of fsspec under which ARM/WORK is mirrored, until the work is over; then it is
            removed there. The work is done in a temporary folder. None: in the folder itself.

    Raises:
        OSError: If the storage cannot be read or written.
    """
    if storage is None:
        folder.mkdir(parents=True, exist_ok=True)
        yield folder
        return
    with TemporaryDirectory(prefix="neatq-") as scratch:
        mirror = Mirror(Path(scratch), f"{storage.rstrip('/')}/{folder.parent.name}/{folder.name}")
        mirror.fetch()
        over = threading.Event()
        pushing = threading.Thread(target=mirror.push_until, args=(over,), daemon=True)
        pushing.start()
        try:
            yield mirror.folder
        finally:
            over.set()
            pushing.join()
        with suppress(Exception):  # the work is done: what stays there harms nobody
            mirror.remove()


class Mirror:
    """A folder and its copy at a URL."""

    def __init__(self, folder: Path, url: str) -> None:
        self.folder = folder
        self._there: Any
        self._there, self._path = fsspec.url_to_fs(url)
        self._pushed: dict[Path, int] = {}

    def fetch(self) -> None:
        """Copy what is there."""
        # Not `get` of the whole: it takes a path for a pattern where it has "[", "*" or "?".
        for there in self._there.find(self._path):
            here = self.folder / there.removeprefix(self._path).lstrip("/")
            here.parent.mkdir(parents=True, exist_ok=True)
            self._there.get_file(there, str(here))

    def push(self) -> None:
        """Copy what has changed, and checkpoints, as they were before that, last.

        So at any moment what lies there beside a checkpoint is as new, or newer, as after a process
        was killed.
        """
        with TemporaryDirectory(prefix="neatq-") as aside:
            files = [path for path in self.folder.rglob("*") if path.is_file()]
            for path in sorted(files, key=lambda path: path.name != CHECKPOINT):
                with suppress(FileNotFoundError):  # a temporary one, gone by now
                    changed = path.stat().st_mtime_ns
                    if self._pushed.get(path) != changed:
                        copy = Path(aside, path.relative_to(self.folder))
                        copy.parent.mkdir(parents=True, exist_ok=True)
                        shutil.copyfile(path, copy)
                        self._pushed[path] = changed
            copies = [path for path in Path(aside).rglob("*") if path.is_file()]
            for copy in sorted(copies, key=lambda path: path.name == CHECKPOINT):
                self._put(copy, f"{self._path}/{copy.relative_to(aside).as_posix()}")

    def _put(self, copy: Path, there: str) -> None:
        """Copy a file, whole or not at all where a storage can rename."""
        self._there.makedirs(there.rpartition("/")[0], exist_ok=True)
        self._there.put_file(str(copy), f"{there}.part")
        self._there.mv(f"{there}.part", there)

    def push_until(self, over: threading.Event) -> None:
        """Copy what has changed now and then; a storage that is away is tried again."""
        while not over.wait(MIRROR_SECONDS):
            try:
                self.push()
            except Exception:  # each kind of storage has errors of its own
                self._pushed.clear()

    def remove(self) -> None:
        """Remove the copy."""
        if self._there.exists(self._path):
            self._there.rm(self._path, recursive=True)
