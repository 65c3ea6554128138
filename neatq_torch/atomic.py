"""Files that are either the old one or the new one, never half of each."""

from __future__ import annotations

import os
import re
import secrets
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path


def write_atomic(path: Path | str, content: bytes | str) -> None:
    """Write `content` to `path` so that a crash at any moment leaves no broken file.

    The content goes to a temporary file in the same folder, is flushed to the disk and then
    renamed over `path`, which POSIX and Windows do in one step. The file's mode is that of any
    new file (the umask's).

    Args:
        path: The file to write. Its folder must exist.
        content: The whole content; text is written as UTF-8.

    Raises:
        OSError: If the folder is missing or read-only or the disk is full; its `filename` is
            `path`, which is unchanged.
    """
    path = Path(path)
    data = content.encode() if isinstance(content, str) else content
    # Not tempfile: its files are for their owner's eyes alone, and stay so when renamed.
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(4)}")
    try:
        with open(temporary, "xb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except BaseException as error:
        with suppress(OSError):  # the first error is the one to tell
            temporary.unlink(missing_ok=True)
        if isinstance(error, OSError):
            error.filename, error.filename2 = str(path), None
        raise


def leftovers(folder: Path | str, names: Iterable[str]) -> list[Path]:
    """Temporary files of writes to files of these names that were killed.

    Only for a folder in which nobody writes now.
    """
    known = "|".join(map(re.escape, names))
    temporary = re.compile(rf"\.({known})\.[0-9a-f]{{8}}")
    return [one for one in sorted(Path(folder).iterdir()) if temporary.fullmatch(one.name)]
