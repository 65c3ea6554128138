"""A whole run as one file that is data only: loading it executes nothing.

The file is a numpy `.npz` archive: one member for each array, and `manifest`, a JSON text with
the format, its version, the observation schema and the tree of all other values.
"""

from __future__ import annotations

import io
import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from torch import Tensor

from neatq_torch.atomic import write_atomic

FORMAT = "neatq-checkpoint"
VERSION = 1
_ARRAY = "__array__"


class CheckpointError(ValueError):
    """A checkpoint cannot be used; the message names the file and says why."""


def save_checkpoint(path: Path | str, state: dict[str, Any], *, observation_schema: str) -> None:
    """Write `state` to `path`, whole or not at all.

    Args:
        path: The file.
        state: Nested dicts and lists of JSON values, numpy arrays and tensors, kept as arrays.
        observation_schema: Name of the observations that the run's genomes read.

    Raises:
        OSError: If it cannot be written; a file that stood there is unchanged.
        TypeError: If a value is neither JSON nor an array.
    """
    arrays: dict[str, np.ndarray] = {}

    def keep(value: Any) -> dict[str, str]:
        """Move an array to `arrays`; returns the reference that stands for it."""
        if not isinstance(value, np.ndarray | Tensor):
            raise TypeError(f"expected JSON values, arrays and tensors, got {type(value).__name__}")
        name = f"array{len(arrays)}"
        arrays[name] = value if isinstance(value, np.ndarray) else value.detach().cpu().numpy()
        return {_ARRAY: name}

    header = {"format": FORMAT, "version": VERSION, "observation_schema": observation_schema}
    manifest = json.dumps(header | {"state": state}, default=keep)
    arrays["manifest"] = np.frombuffer(manifest.encode(), np.uint8)
    buffer = io.BytesIO()
    np.savez(buffer, allow_pickle=False, **arrays)
    write_atomic(path, buffer.getvalue())


def load_checkpoint(path: Path | str, *, observation_schema: str | None = None) -> dict[str, Any]:
    """Read what `save_checkpoint` wrote.

    Args:
        path: The file.
        observation_schema: The schema that the caller's observations have; None accepts any.

    Returns:
        The state; arrays and tensors come back as numpy arrays, bit for bit.

    Raises:
        CheckpointError: If the file is missing, truncated, altered, of another format or version,
            or its genomes read other observations.
    """
    arrays = _read_arrays(Path(path))

    def put(value: dict[str, Any]) -> Any:
        return arrays[value[_ARRAY]] if value.keys() == {_ARRAY} else value

    try:
        manifest = json.loads(arrays["manifest"].tobytes(), object_hook=put)
        name, version = manifest["format"], manifest["version"]
    except (KeyError, TypeError, AttributeError, ValueError, RecursionError) as error:
        raise CheckpointError(f"{path}: not a neatq checkpoint, or altered ({error!r})") from error
    if (name, version) != (FORMAT, VERSION):
        raise CheckpointError(
            f"{path}: format {name!r} version {version!r}; this version of neatq_torch reads "
            f"{FORMAT!r} version {VERSION}"
        )
    schema, state = manifest.get("observation_schema"), manifest.get("state")
    if schema is None or state is None:
        raise CheckpointError(f"{path}: altered: its manifest lacks a state or its observations")
    if observation_schema is not None and schema != observation_schema:
        raise CheckpointError(
            f"{path}: its genomes read the observations {schema!r}, the environment gives "
            f"{observation_schema!r}; use the sensors that the run was made with"
        )
    return state


def _read_arrays(path: Path) -> dict[str, np.ndarray]:
    try:
        # Read once: what is checked is what is used, even if somebody replaces the file meanwhile.
        content = io.BytesIO(path.read_bytes())
    except FileNotFoundError as error:
        raise CheckpointError(f"{path}: there is no such file") from error
    except IsADirectoryError as error:
        raise CheckpointError(f"{path}: a folder, not a checkpoint") from error
    try:
        with zipfile.ZipFile(content) as archive:
            damaged = archive.testzip()
        content.seek(0)
        with np.load(content, allow_pickle=False) as members:
            arrays = dict(members)
    except Exception as error:  # zipfile and numpy raise a dozen kinds over damaged bytes
        raise CheckpointError(f"{path}: truncated or altered ({error})") from error
    if damaged is not None:
        raise CheckpointError(f"{path}: altered or damaged (member {damaged})")
    return arrays
