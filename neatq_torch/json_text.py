"""JSON that others wrote: read strictly, and never deep enough to stop the reader."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable
from typing import Any

_DEEPEST = 50
"""What is saved is a dozen deep at most."""
_TOO_DEEP = f"lists or objects are nested more than {_DEEPEST} deep"


def parse_json(
    text: str | bytes, put: Callable[[dict[str, Any]], Any] = lambda value: value
) -> Any:
    """The value of a JSON text.

    Args:
        text: The text, or its bytes in UTF-8.
        put: Called with each object; gives what stands in its place.

    Raises:
        ValueError: If it is no JSON, a key is given twice, or it is nested more than 50 deep.
    """

    def once(pairs: list[tuple[str, Any]]) -> Any:
        values = dict(pairs)
        if len(values) < len(pairs):
            twice = Counter(name for name, _ in pairs).most_common(1)[0][0]
            raise ValueError(f"the key {twice[:80]!r} is given twice; keep one of them")
        return put(values)

    try:
        value = json.loads(text, object_pairs_hook=once)
    except RecursionError as error:
        raise ValueError(_TOO_DEEP) from error
    level = [value]
    for _ in range(_DEEPEST):
        level = [one for part in level for one in _below(part)]
    if level:
        raise ValueError(_TOO_DEEP)
    return value


def _below(part: Any) -> Any:
    """What can hold more, within a list or an object."""
    inner = part.values() if isinstance(part, dict) else part if isinstance(part, list) else ()
    return [one for one in inner if isinstance(one, dict | list)]
