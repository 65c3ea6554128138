"""Names of users never leave the folder that they name something in."""

from __future__ import annotations

from pathlib import Path

import pytest

from neatq_experiments.compare.variants import Variant, register_variants
from neatq_torch.kinds import ConfigError
from neatq_trainers.arms import preset
from neatq_trainers.names import file_name
from neatq_trainers.train import default_folder

NAMES = {
    "wall": "wall",
    "ALE/Pong-v5": "ALE-Pong-v5",
    "my_module:MyEnv-v0": "my_module-MyEnv-v0",
    "../../../escaped/x": "escaped-x",
    "/etc/passwd": "etc-passwd",
    "..\\..\\x": "x",
    "C:\\x": "C-x",
    ".hidden": "hidden",
    "..": "unnamed",
    "": "unnamed",
    "  ": "unnamed",
    "a\0b\nc": "a-b-c",
    "ends. ": "ends",
    "CON": "_CON",
    "nul.json": "_nul.json",
    "com1": "_com1",
    "console": "console",
    "Wände": "Wände",
    "\ud800": "unnamed",
    'a<b>:"c"|?*': "a-b-c",
    "x" * 100: "x" * 100,
    # The end is that of: printf xxx... | sha256sum
    "x" * 101: "x" * 91 + "-c675a2e6",
}


@pytest.mark.parametrize(("text", "name"), NAMES.items(), ids=range(len(NAMES)))
def test_a_name_becomes_one_part_of_a_path(text: str, name: str) -> None:
    assert file_name(text) == name
    assert (Path("runs") / name).parent == Path("runs")


def test_long_names_stay_apart_and_fit_into_any_file_system() -> None:
    one, two = (file_name("ü" * 300 + end) for end in "ab")
    assert one != two and max(len(one.encode()), len(two.encode())) <= 100


@pytest.mark.parametrize("name", ["../../../escaped/x", "/tmp/x", "..", "con", "x" * 100])
def test_the_folder_of_a_run_is_in_runs_whatever_its_world_is_called(name: str) -> None:
    folder = default_folder(preset("wall", "rtneat", env_kwargs={"name": name}))
    assert folder == Path("runs") / f"{file_name(name)}-rtneat-seed0"
    assert ".." not in folder.parts and len(folder.parts) == 2


def test_the_folder_of_a_variant_is_where_its_study_is() -> None:
    with pytest.raises(ConfigError, match=r"variants: .* got '\.\./mine'; call it mine"):
        register_variants("own", {"../mine": Variant(base="rtneat", summary="", changes={})})
