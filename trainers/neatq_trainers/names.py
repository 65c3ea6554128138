"""Names of files, made of names that users give."""

from __future__ import annotations

import hashlib
import re
import sys

_MOST_BYTES = 100
"""File systems allow 255; there are affixes, and names of folders around it count on Windows."""
_RESERVED = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?", re.IGNORECASE)
"""Devices of Windows, whatever the ending."""


def file_name(text: str) -> str:
    """What something is called in names of files: one part of a path, on every system.

    What is no letter, digit, "_", ".", "+" or "-" becomes "-"; there is no dot or "-" at either
    end. A long name is cut, and ends with eight digits of its SHA-256 then.
    """
    known = sys.getfilesystemencoding()  # a plain locale knows ASCII only
    text = text.encode(known, "replace").decode(known)
    name = re.sub(r"[^\w.+-]+", "-", text).strip(".-") or "unnamed"
    if _RESERVED.fullmatch(name):
        name = f"_{name}"
    data = name.encode()
    if len(data) <= _MOST_BYTES:
        return name
    kept = data[: _MOST_BYTES - 9].decode(errors="ignore")
    return f"{kept}-{hashlib.sha256(data).hexdigest()[:8]}"
