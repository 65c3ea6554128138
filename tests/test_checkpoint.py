from __future__ import annotations

import errno
import io
import json
import os
import pickle
import zipfile
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
