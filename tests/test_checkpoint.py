from __future__ import annotations

import errno
import io
import json
import os
import pickle
import struct
import time
import tracemalloc
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from neatq_torch.checkpoint import FORMAT, VERSION, CheckpointError, load_checkpoint
from neatq_torch.checkpoint import save_checkpoint as save

STATE: dict[str, Any] = {
    "tick": 7,
    "share": 0.1,
    "nothing": None,
    "text": "naïve",
    "big": 2**100 + 1,
    "list": [1, [True, "x"], {"deep": np.array([1.5, np.nan, -0.0])}],
    "weight": np.arange(6, dtype=np.float32).reshape(2, 3),
    "empty": np.zeros((0, 4), np.uint8),
}


def equal(a: Any, b: Any) -> bool:
    if isinstance(a, np.ndarray):
        return (a.dtype, a.shape, a.tobytes()) == (b.dtype, b.shape, b.tobytes())
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(equal(a[key], b[key]) for key in a)
    if isinstance(a, list):
        return len(a) == len(b) and all(map(equal, a, b))
    return type(a) is type(b) and a == b


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("checkpoint") / "good.npz"
    save(path, STATE, observation_schema="arena-1")
    return path


def crafted(path: Path, manifest: Any, **arrays: Any) -> Path:
    members: dict[str, Any] = {"manifest": np.frombuffer(json.dumps(manifest).encode(), np.uint8)}
    with path.open("wb") as file:
        np.savez(file, **members, **arrays)
    return path


def test_everything_comes_back_bit_for_bit(saved: Path) -> None:
    assert equal(load_checkpoint(saved), STATE)


def test_tensors_come_back_as_arrays_and_tuples_as_lists(tmp_path: Path) -> None:
    weight = torch.nn.Parameter(torch.tensor([0.1, -0.0]))
    save(tmp_path / "x", {"weight": weight, "pair": (1, 2)}, observation_schema="")
    wanted = {"weight": np.array([0.1, -0.0], np.float32), "pair": [1, 2]}
    assert equal(load_checkpoint(tmp_path / "x"), wanted)


def test_equal_states_make_equal_files_apart_from_the_time(saved: Path, tmp_path: Path) -> None:
    save(tmp_path / "again", STATE, observation_schema="arena-1")
    with zipfile.ZipFile(saved) as one, zipfile.ZipFile(tmp_path / "again") as two:
        assert one.namelist() == two.namelist()
        assert all(one.read(name) == two.read(name) for name in one.namelist())


def test_a_value_that_is_no_data_is_refused_when_it_is_saved(tmp_path: Path) -> None:
    with pytest.raises(TypeError):
        save(tmp_path / "x", {"set": {1, 2}}, observation_schema="")
    with pytest.raises(ValueError, match="allow_pickle"):
        save(tmp_path / "x", {"objects": np.array([{}, None])}, observation_schema="")
    assert not os.listdir(tmp_path)


class Trap:
    """Unpickling it makes a folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def __reduce__(self) -> tuple[Any, tuple[str]]:
        return os.mkdir, (str(self.folder),)


def test_loading_executes_nothing(tmp_path: Path) -> None:
    manifest = {
        "format": FORMAT,
        "version": VERSION,
        "observation_schema": "",
        "state": {"x": {"__array__": "array0"}},
    }
    trap = np.array([Trap(tmp_path / "sprung")], dtype=object)
    path = crafted(tmp_path / "trap.npz", manifest, array0=trap)
    with pytest.raises(CheckpointError, match=r"trap\.npz"):
        load_checkpoint(path)
    assert not (tmp_path / "sprung").exists()
    with np.load(path, allow_pickle=True) as unsafe:
        assert unsafe["array0"].size
    assert (tmp_path / "sprung").exists(), "the trap would have worked"


def test_a_bare_pickle_is_refused(tmp_path: Path) -> None:
    (tmp_path / "trap.npz").write_bytes(pickle.dumps(Trap(tmp_path / "sprung")))
    with pytest.raises(CheckpointError, match=r"trap\.npz"):
        load_checkpoint(tmp_path / "trap.npz")
    assert not (tmp_path / "sprung").exists()


def test_another_version_is_refused_and_both_are_named(tmp_path: Path) -> None:
    manifest = {"format": FORMAT, "version": 99, "observation_schema": "", "state": {}}
    with pytest.raises(CheckpointError, match=rf"x\.npz.*version 99.*reads .* version {VERSION}"):
        load_checkpoint(crafted(tmp_path / "x.npz", manifest))


def test_other_observations_are_refused_and_both_are_named(saved: Path) -> None:
    assert load_checkpoint(saved, observation_schema="arena-1")["tick"] == 7
    with pytest.raises(CheckpointError, match=r"good\.npz.*'arena-1'.*'opennero-2014'"):
        load_checkpoint(saved, observation_schema="opennero-2014")


@pytest.mark.parametrize(
    "manifest",
    [
        [],
        {},
        "text",
        None,
        {"format": FORMAT, "version": VERSION, "state": {}},
        {"format": FORMAT, "version": VERSION, "observation_schema": ""},
        {
            "format": FORMAT,
            "version": VERSION,
            "observation_schema": "",
            "state": {"__array__": "array7"},
        },
        {
            "format": FORMAT,
            "version": VERSION,
            "observation_schema": "",
            "state": {"__array__": [1]},
        },
    ],
)
def test_a_manifest_that_lacks_something_is_refused(tmp_path: Path, manifest: Any) -> None:
    with pytest.raises(CheckpointError, match=r"x\.npz"):
        load_checkpoint(crafted(tmp_path / "x.npz", manifest))


def test_a_missing_file_a_folder_and_other_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(CheckpointError, match=r"none\.npz: there is no such file"):
        load_checkpoint(tmp_path / "none.npz")
    with pytest.raises(CheckpointError, match="folder"):
        load_checkpoint(tmp_path)
    array, archive, manifest = io.BytesIO(), io.BytesIO(), io.BytesIO()
    np.save(array, np.zeros(3))
    np.savez(archive, a=np.zeros(3))
    with zipfile.ZipFile(manifest, "w") as other:
        other.writestr("manifest", "{}")
    for content in (
        b"",
        b"genome",
        b'{"format": 1}',
        array.getvalue(),
        archive.getvalue(),
        manifest.getvalue(),
    ):
        (tmp_path / "other.npz").write_bytes(content)
        with pytest.raises(CheckpointError, match=r"other\.npz"):
            load_checkpoint(tmp_path / "other.npz")


def test_every_truncation_is_refused(saved: Path) -> None:
    content = saved.read_bytes()
    short = saved.with_name("short.npz")
    for length in (*range(0, len(content), 97), len(content) - 22, len(content) - 1):
        short.write_bytes(content[:length])
        with pytest.raises(CheckpointError, match=r"short\.npz"):
            load_checkpoint(short)


@given(data=st.data())
def test_a_changed_byte_is_harmless_or_refused(saved: Path, data: st.DataObject) -> None:
    content = bytearray(saved.read_bytes())
    place = data.draw(st.integers(0, len(content) - 1))
    content[place] ^= data.draw(st.integers(1, 255))
    damaged = saved.with_name("damaged.npz")
    damaged.write_bytes(content)
    try:
        state = load_checkpoint(damaged, observation_schema="arena-1")
    except CheckpointError as error:
        assert "damaged.npz" in str(error)
    else:
        assert equal(state, STATE)


def test_a_changed_byte_of_the_data_is_always_refused(saved: Path) -> None:
    content = saved.read_bytes()
    damaged = saved.with_name("weight.npz")
    place = content.index(STATE["weight"].tobytes())
    for offset in range(STATE["weight"].nbytes):
        changed = bytearray(content)
        changed[place + offset] ^= 1
        damaged.write_bytes(changed)
        with pytest.raises(CheckpointError, match=r"weight\.npz"):
            load_checkpoint(damaged)


def member(array: np.ndarray) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, array)
    return buffer.getvalue()


def rewritten(path: Path, changes: dict[str, bytes | None], compression: int = 0) -> Path:
    """A copy of a checkpoint with other members (None: without), and right checksums."""
    copy = path.with_name("rewritten.npz")
    with zipfile.ZipFile(path) as old, zipfile.ZipFile(copy, "w", compression) as new:
        contents = {name: old.read(name) for name in old.namelist()} | changes
        for name, content in contents.items():
            if content is not None:
                new.writestr(name, content)
    return copy


def state_of(state: Any) -> np.ndarray:
    header = {"format": FORMAT, "version": VERSION, "observation_schema": ""}
    return np.frombuffer(json.dumps(header | {"state": state}).encode(), np.uint8)


@contextmanager
def little() -> Iterator[None]:
    """At most a second and 100 MB."""
    tracemalloc.start()
    began = time.process_time()
    yield
    seconds, (_, peak) = time.process_time() - began, tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert seconds < 1.0 and peak < 100e6


@pytest.mark.parametrize("kept", [True, False], ids=["digest", "no digest"])
@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("array0.npy", None),
        ("array0.npy", member(np.zeros(3))),
        ("array1.npy", member(np.zeros((2, 3), np.float64))),
        ("array1.npy", member(np.zeros((3, 2), np.float32))),
        ("array9.npy", member(np.zeros(3))),
        ("manifest.npy", None),
        ("manifest.npy", member(state_of({"tick": 8}))),
    ],
)
def test_changed_content_with_right_checksums_is_damaged(
    saved: Path, name: str, content: bytes | None, kept: bool
) -> None:
    if not kept and name in ("array0.npy", "array1.npy") and content:
        pytest.skip("files of version 0.2.0 cannot tell")
    digest: dict[str, bytes | None] = {} if kept else {"digest.npy": None}
    with pytest.raises(CheckpointError, match=r"rewritten\.npz: .*(damaged|altered)"):
        load_checkpoint(rewritten(saved, {name: content} | digest))


def test_files_without_a_digest_are_read_as_before(saved: Path) -> None:
    assert equal(load_checkpoint(rewritten(saved, {"digest.npy": None})), STATE)


def header_of(text: str) -> bytes:
    data = text.encode()
    return b"\x93NUMPY\x01\x00" + len(data).to_bytes(2, "little") + data


@pytest.mark.parametrize(
    "content",
    [
        header_of("{'descr': '<f4', 'fortran_order': False, 'shape': (2, 3), "),  # TokenError
        header_of("{'descr': '<f4', 'fortran_order': False, 'shape': (2L, 3L), }") + bytes(24),
        header_of("{'descr': '<f4', 'fortran_order': False, 'shape': (1 << 40,), }"),
        header_of("{'descr': '<f4', 'fortran_order': False, 'shape': (2147483648, 4), }"),
        header_of("{'descr': '<f4', 'fortran_order': False, 'shape': (-1, -1), }") + bytes(4),
        header_of("{'descr': '<f4', 'fortran_order': False, 'shape': (0, 10000000000000000000), }"),
        header_of("{'descr': '|O', 'fortran_order': False, 'shape': (2,), }") + bytes(16),
        header_of("{'descr': [('a', '<f4')] * 9, 'fortran_order': False, 'shape': (1,), }"),
        header_of("(" * 900),
        header_of("9" * 9000),
        header_of("\0" * 100),
        b"\x93NUMPY\x02\x00\xff\xff\xff\xff",
        b"",
    ],
    ids=range(13),
)
def test_a_damaged_header_is_refused_whatever_it_says(saved: Path, content: bytes) -> None:
    changes: dict[str, bytes | None] = {"array1.npy": content, "digest.npy": None}
    with little(), pytest.raises(CheckpointError, match=r"rewritten\.npz: .*damaged"):
        load_checkpoint(rewritten(saved, changes))


def test_what_would_fill_the_memory_is_refused_at_once(saved: Path) -> None:
    zeros = header_of("{'descr': '|u1', 'fortran_order': False, 'shape': (50000000,), }")
    bomb = rewritten(saved, {"array0.npy": zeros + bytes(50_000_000)}, zipfile.ZIP_DEFLATED)
    assert bomb.stat().st_size < 100_000
    with little(), pytest.raises(CheckpointError, match="compressed, which no checkpoint is"):
        load_checkpoint(bomb)


def test_a_file_beyond_the_memory_is_refused(saved: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def too_large(_: Path) -> bytes:
        raise MemoryError

    monkeypatch.setattr(Path, "read_bytes", too_large)
    with pytest.raises(CheckpointError, match=r"good\.npz: too large for the memory"):
        load_checkpoint(saved)


def test_an_archive_of_very_many_members_is_refused_at_once(tmp_path: Path) -> None:
    entry = struct.pack("<4s6H3L5H2L", b"PK\1\2", *[0] * 16)
    end = struct.pack("<4s4H2LH", b"PK\5\6", 0, 0, 65535, 65535, 200_000 * len(entry), 0, 0)
    (tmp_path / "many.npz").write_bytes(entry * 200_000 + end)
    with little(), pytest.raises(CheckpointError, match=r"many\.npz: .*more than 60,000 members"):
        load_checkpoint(tmp_path / "many.npz")


def test_more_arrays_than_can_be_read_again_are_not_saved(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="at most 60,000 arrays, got 60,001"):
        save(tmp_path / "x", {"all": [np.zeros(0)] * 60_001}, observation_schema="")


@pytest.mark.parametrize("depth", [60, 900, 100_000])
def test_a_manifest_nested_too_deep_is_refused(tmp_path: Path, depth: int) -> None:
    text = '{"format": "neatq-checkpoint", "version": 1, "observation_schema": "", "state": '
    text += "[" * depth + "]" * depth + "}"
    with (tmp_path / "deep.npz").open("wb") as file:
        np.savez(file, manifest=np.frombuffer(text.encode(), np.uint8))
    with little(), pytest.raises(CheckpointError, match=r"deep\.npz: .*nested more than 50 deep"):
        load_checkpoint(tmp_path / "deep.npz")


def test_an_array_that_stands_twice_and_a_key_given_twice_are_refused(tmp_path: Path) -> None:
    one = {"__array__": "array0"}
    arrays = {"manifest": state_of({"a": one, "b": one}), "array0": np.zeros(2)}
    np.savez(tmp_path / "twice.npz", allow_pickle=False, **arrays)
    with pytest.raises(CheckpointError, match="altered"):
        load_checkpoint(tmp_path / "twice.npz")
    text = '{"format": "neatq-checkpoint", "version": 1, "version": 1}'
    np.savez(tmp_path / "key.npz", manifest=np.frombuffer(text.encode(), np.uint8))
    with pytest.raises(CheckpointError, match="'version' is given twice"):
        load_checkpoint(tmp_path / "key.npz")


def test_arrays_in_the_order_of_fortran_come_back_so(tmp_path: Path) -> None:
    array = np.asfortranarray(np.arange(6.0).reshape(2, 3))
    save(tmp_path / "x", {"array": array}, observation_schema="")
    again = load_checkpoint(tmp_path / "x")["array"]
    assert again.flags.f_contiguous and again.flags.writeable and equal(again, array)


def test_a_full_disk_leaves_the_checkpoint_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    save(tmp_path / "x.npz", {"tick": 1}, observation_schema="")
    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        with pytest.raises(OSError, match="No space left"):
            save(tmp_path / "x.npz", {"tick": 2}, observation_schema="")
    assert load_checkpoint(tmp_path / "x.npz") == {"tick": 1}
    assert os.listdir(tmp_path) == ["x.npz"]
