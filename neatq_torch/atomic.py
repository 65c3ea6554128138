"""Files that are either the old one or the new one, never half of each."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path


def write_atomic(path: Path | str, content: bytes | str) -> None:
    """Write `content` to `path` so that a crash at any moment leaves no broken file.

    The content goes to a temporary file in the same folder, is flushed to the disk and then
    renamed over `path`, which POSIX and Windows do in one step.

    Args:
        path: The file to write. Its folder must exist.
        content: The whole content; text is written as UTF-8.

    Raises:
        OSError: If the folder is missing or read-only or the disk is full. `path` is unchanged.
    """
    path = Path(path)
    data = content.encode() if isinstance(content, str) else content
    handle, temporary = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise
