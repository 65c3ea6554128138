"""What a world of one's own can, and what it is told that it cannot."""

from __future__ import annotations

import pytest

import neatq_torch as nq


@pytest.fixture(scope="module")
def corridor() -> str:
    nq.register_world("test-corridor", dict)  # type: ignore[arg-type]  (it is never made)
    return "test-corridor"


def test_generations_of_several_arenas_are_refused_as_nobody_would_stand_idle(
    corridor: str,
) -> None:
    with pytest.raises(nq.ConfigError, match=r"arenas: expected 1, got 2; .* nobody stands idle"):
        nq.preset(corridor, "neat").changed({"arenas": 2})
    assert nq.preset(corridor, "neat").arenas == 1


def test_genomes_that_are_replaced_one_at_a_time_may_have_several_arenas(corridor: str) -> None:
    assert nq.preset(corridor, "rtneat").changed({"arenas": 2}).arenas == 2


def test_a_world_of_a_module_that_is_not_there_is_refused_with_the_remedy() -> None:
    with pytest.raises(nq.ConfigError, match=r"task: nowhere:corridor: .* PYTHONPATH"):
        nq.preset("nowhere:corridor", "rtneat")
