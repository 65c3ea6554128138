"""One process at a time trains in a run folder."""

from __future__ import annotations

import errno
import os
import platform
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from filelock import FileLock, Timeout

from neatq_torch.kinds import ConfigError

LOCK, HOLDER = ".lock", ".lock.holder"
"""What lies in a folder while somebody trains there; after a kill they may stay and do no harm."""
_WITHOUT_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP)


class RunFolderError(ConfigError):
    """A folder cannot be used for a run."""


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Keep other processes from training in a folder, with a lock of the operating system.

    The lock ends with this process, however it ends. Where the file system has no locks, a line on
    stderr says so.

    Raises:
        RunFolderError: If another process has the lock; the message names it.
        OSError: If the folder cannot be written; its `filename` is the folder.
    """
    lock = FileLock(folder / LOCK, timeout=0)
    try:
        lock.acquire()
        (folder / HOLDER).write_text(f"process {os.getpid()} on {platform.node()}", "utf-8")
    except Timeout as error:
        raise RunFolderError(
            f"{folder}: {_holder(folder)} is training in it; wait until it has ended, or stop it"
        ) from error
    except OSError as error:
        lock.release()
        if error.errno not in _WITHOUT_LOCKS:
            error.filename = str(folder)
            raise
        print(
            f"neatq: {folder}: its file system has no locks; see to it that no other process "
            "trains in it",
            file=sys.stderr,
        )
    try:
        yield
    finally:
        for name in (HOLDER, LOCK):  # while it is held: whoever waits for the old file sees that
            with suppress(OSError):  # Windows removes no open file
                (folder / name).unlink(missing_ok=True)
        lock.release()


def _holder(folder: Path) -> str:
    with suppress(OSError, UnicodeDecodeError):
        return (folder / HOLDER).read_text("utf-8") or "another process"
    return "another process"
