"""What the site must know of this project's docstrings: an extension of griffe, see mkdocs.yml."""

from __future__ import annotations

from typing import Any

import griffe


class OneExample(griffe.Extension):
    """Reads `Example:` as code; griffe knows the section under the name `Examples:` only."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Rename the section."""
        if obj.docstring:
            obj.docstring.value = obj.docstring.value.replace("\nExample:\n", "\nExamples:\n")
