"""A whole run as one file that is data only: loading it executes nothing.

The file is a numpy `.npz` archive, not compressed: one member for each array; `manifest`, a JSON
text with the format, its version, the observation schema and the tree of all other values; and
`digest`, the SHA-256 of all other members, name and content, in their order (files of version 0.2.0
have none).
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import warnings
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from torch import Tensor

from neatq_torch.atomic import write_atomic
from neatq_torch.json_text import parse_json

FORMAT = "neatq-checkpoint"
VERSION = 1
_ARRAY = "__array__"
_MOST_ARRAYS = 60_000
"""A run has less than forty in each arena."""


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
        ValueError: If there are more than 60,000 arrays, or one of Python objects.
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
    if len(arrays) > _MOST_ARRAYS:
        raise ValueError(f"expected at most {_MOST_ARRAYS:,} arrays, got {len(arrays):,}")
    arrays["manifest"] = np.frombuffer(manifest.encode(), np.uint8)
    arrays["digest"] = np.frombuffer(_content_digest(arrays), np.uint8)
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
        return arrays.pop(value[_ARRAY]) if value.keys() == {_ARRAY} else value

    try:
        manifest = parse_json(arrays.pop("manifest").tobytes(), put)
        name, version = manifest["format"], manifest["version"]
        if arrays:
            raise ValueError(f"nothing refers to {next(iter(arrays))}")
    except (KeyError, TypeError, AttributeError, ValueError) as error:
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
        content = path.read_bytes()
    except FileNotFoundError as error:
        raise CheckpointError(f"{path}: there is no such file") from error
    except IsADirectoryError as error:
        raise CheckpointError(f"{path}: a folder, not a checkpoint") from error
    except MemoryError as error:
        raise CheckpointError(f"{path}: too large for the memory of this machine") from error
    try:
        arrays = {name: _read_array(data) for name, data in _members(content).items()}
        digest = arrays.pop("digest", None)
        if digest is not None and digest.tobytes() != _content_digest(arrays):
            raise ValueError("its content is not that of its digest")
    except Exception as error:  # zipfile and numpy raise a dozen kinds over damaged bytes
        raise CheckpointError(f"{path}: truncated, altered or damaged ({error!r})") from error
    return arrays


def _members(content: bytes) -> dict[str, bytes]:
    """The files of an archive; nothing is read that is larger than the archive itself."""
    # Counted before zipfile lists them: the list of a million would take seconds.
    if content.count(b"PK\x01\x02") > _MOST_ARRAYS + 2:
        raise ValueError(f"more than {_MOST_ARRAYS:,} members")
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        members = archive.infolist()
        if any(one.compress_type != zipfile.ZIP_STORED for one in members):
            raise ValueError("compressed, which no checkpoint is")
        if sum(one.file_size for one in members) > len(content):
            raise ValueError("members overlap")
        names = [one.filename.removesuffix(".npy") for one in members]
        if len(set(names)) < len(names):
            raise ValueError("two members have the same name")
        return {name: archive.read(one) for name, one in zip(names, members, strict=True)}


def _read_array(data: bytes) -> np.ndarray:
    """The array of an `.npy` file of version 1.0, as numpy writes it; without objects."""
    file = io.BytesIO(data)
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # numpy warns about headers that it has to guess
        if np.lib.format.read_magic(file) != (1, 0):
            raise ValueError("an array of another format")
        shape, fortran, dtype = np.lib.format.read_array_header_1_0(file)
    if dtype.hasobject or dtype.itemsize * math.prod(shape) != len(data) - file.tell():
        raise ValueError("the header of an array is not that of its content")
    order = "F" if fortran else "C"
    return np.ndarray(shape, dtype, data, file.tell(), order=order).copy(order)


def _content_digest(arrays: Mapping[str, np.ndarray]) -> bytes:
    sha = hashlib.sha256()
    for name, array in arrays.items():
        sha.update(f"{name} {array.dtype.str} {array.shape} ".encode())
        sha.update(array.tobytes())
    return sha.digest()
