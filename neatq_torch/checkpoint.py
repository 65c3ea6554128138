"""A whole run as one file that is data only: loading it executes nothing.

The file is a numpy `.npz` archive: one member for each array, and `manifest`, a JSON text with
the format, its version, the observation schema and the tree of all other values.
"""

from __future__ import annotations

import io
import json
import struct
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from torch import Tensor

from neatq_torch.atomic import write_atomic

FORMAT = "neatq-checkpoint"
VERSION = 1
_ARRAY = "__array__"
_DAMAGE = (  # what zipfile and numpy raise over bytes that are not as they were written
    zipfile.BadZipFile,
    zlib.error,
    struct.error,
    EOFError,
    LookupError,
    MemoryError,
    NotImplementedError,  # another compression
    OverflowError,
    RuntimeError,  # "encrypted"
    SyntaxError,
    TypeError,
    ValueError,
)

State = dict[str, Any]
"""Nested dicts and lists of JSON values, numpy arrays and tensors."""


class CheckpointError(ValueError):
    """A checkpoint cannot be used; the message names the file and says why."""


def save_checkpoint(path: Path | str, state: State, *, observation_schema: str) -> None:
    """Write `state` to `path`, whole or not at all.

    Args:
        path: The file.
        state: What to keep. Tensors are kept as arrays.
        observation_schema: Name of the observations that the run's genomes read.

    Raises:
        OSError: If it cannot be written; a file that stood there is unchanged.
        TypeError: If a value is neither JSON nor an array.
    """
    arrays: dict[str, np.ndarray] = {}
    manifest = {
        "format": FORMAT,
        "version": VERSION,
        "observation_schema": observation_schema,
        "state": _take_arrays(state, arrays),
    }
    arrays["manifest"] = np.frombuffer(json.dumps(manifest).encode(), np.uint8)
    buffer = io.BytesIO()
    np.savez(buffer, allow_pickle=False, **arrays)
    write_atomic(path, buffer.getvalue())


def load_checkpoint(path: Path | str, *, observation_schema: str | None = None) -> State:
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
    try:
        manifest = json.loads(arrays["manifest"].tobytes())
        found = (manifest["format"], manifest["version"])
    except (KeyError, TypeError, AttributeError, ValueError, RecursionError) as error:
        raise CheckpointError(f"{path}: not a neatq checkpoint (no manifest)") from error
    if found != (FORMAT, VERSION):
        raise CheckpointError(
            f"{path}: format {found[0]!r} version {found[1]!r}; this version of neatq_torch reads "
            f"{FORMAT!r} version {VERSION}"
        )
    try:
        schema, state = manifest["observation_schema"], _put_arrays(manifest["state"], arrays)
    except (KeyError, TypeError) as error:
        raise CheckpointError(f"{path}: altered: its manifest lacks {error}") from error
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
        with zipfile.ZipFile(content) as archive:
            damaged = archive.testzip()
            if damaged is not None:
                raise CheckpointError(f"{path}: altered or damaged (member {damaged})")
        content.seek(0)
        with np.load(content, allow_pickle=False) as members:
            return dict(members)
    except FileNotFoundError as error:
        raise CheckpointError(f"{path}: there is no such file") from error
    except IsADirectoryError as error:
        raise CheckpointError(f"{path}: a folder, not a checkpoint") from error
    except _DAMAGE as error:
        if isinstance(error, CheckpointError):
            raise
        raise CheckpointError(f"{path}: truncated or altered ({error})") from error


def _take_arrays(value: Any, arrays: dict[str, np.ndarray]) -> Any:
    """The tree with each array moved to `arrays` and a reference in its place."""
    if isinstance(value, Tensor):
        value = value.detach().cpu().numpy()
    if isinstance(value, np.ndarray):
        name = f"array{len(arrays)}"
        arrays[name] = value
        return {_ARRAY: name}
    if isinstance(value, dict):
        return {key: _take_arrays(item, arrays) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_take_arrays(item, arrays) for item in value]
    return value


def _put_arrays(value: Any, arrays: dict[str, np.ndarray]) -> Any:
    if isinstance(value, dict):
        if value.keys() == {_ARRAY}:
            return arrays[value[_ARRAY]]
        return {key: _put_arrays(item, arrays) for key, item in value.items()}
    if isinstance(value, list):
        return [_put_arrays(item, arrays) for item in value]
    return value
