from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from neatq_torch.genome import Genome, GenomeError, initial_genome, load_genome, save_genome
from neatq_torch.genome.genome import COLUMNS

FLOAT32 = st.floats(width=32, allow_nan=False, allow_infinity=False)


def identical(a: Genome, b: Genome) -> bool:
    """Whether both are equal in every field, weights bit for bit."""
    values = [(a.genome_id, a.observation_schema), (b.genome_id, b.observation_schema)]
    columns = [[getattr(one, name) for name in COLUMNS] for one in (a, b)]
    same = (
        x.dtype == y.dtype and x.tobytes() == y.tobytes() for x, y in zip(*columns, strict=True)
    )
    return values[0] == values[1] and all(same)


def test_inputs_and_outputs_keep_the_order_of_the_node_array(
    make_genome: Callable[..., Genome],
) -> None:
    genome = make_genome(
        [(1, 9, 4, 0.5)],
        node_id=[9, 4, 3, 6, 2],
        node_kind=[0, 2, 1, 2, 0],
        node_activation=[0] * 5,
    )
    assert genome.input_ids.tolist() == [9, 2]
    assert genome.output_ids.tolist() == [4, 6]


def test_link_ends_are_found_in_an_unsorted_node_array(
    make_genome: Callable[..., Genome],
) -> None:
    genome = make_genome(
        [(1, 9, 4, 0.5)], node_id=[9, 4, 3], node_kind=[0, 2, 1], node_activation=[0] * 3
    )
    assert (genome.source_index.tolist(), genome.target_index.tolist()) == ([0], [1])


def test_a_genome_shares_no_writable_memory_with_its_maker(small: Genome) -> None:
    weights = np.zeros(5, dtype=np.float32)
    genome = small.with_weights(weights)
    weights[0] = 9.0
    assert genome.link_weight[0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        genome.link_weight[0] = 1.0


def test_a_read_only_view_of_writable_memory_is_copied(small: Genome) -> None:
    memory = np.zeros(5, dtype=np.float32)
    view = memory[:]
    view.flags.writeable = False
    genome = small.with_weights(view)
    memory[0] = 9.0
    assert genome.link_weight[0] == 0.0


def test_a_recurrent_link_may_close_a_cycle(make_genome: Callable[..., Genome]) -> None:
    genome = make_genome([(1, 1, 4, 0.5), (2, 4, 4, 0.5)], link_recurrent=[False, True])
    assert genome.link_recurrent.tolist() == [False, True]


@given(arrays.arrays(np.float32, 4, elements=FLOAT32))
def test_weights_come_back_bit_for_bit(weights: np.ndarray) -> None:
    genome = initial_genome(1, 2, rng=np.random.default_rng(0)).with_weights(weights)
    assert genome.link_weight.tobytes() == weights.tobytes()
    assert identical(Genome.from_json(genome.to_json()), genome)


def test_json_keeps_every_field(small: Genome) -> None:
    genome = small.replaced(
        observation_schema="radar",
        link_enabled=[True, False, True, True, True],
        link_recurrent=[False, False, False, True, False],
        node_activation=[0, 0, 0, 4, 2],
    )
    copy = Genome.from_json(genome.to_json())
    assert identical(copy, genome)
    assert copy.observation_schema == "radar"
    assert copy.link_enabled.tolist() == [True, False, True, True, True]
    assert copy.node_activation.tolist() == [0, 0, 0, 4, 2]


@pytest.mark.parametrize(
    "change",
    [
        {"genome_id": 8},
        {"observation_schema": "x"},
        {"link_weight": [0.5, -1.0, 0.1, 1.0, 0.31]},
        {"link_weight": [0.5, -1.0, 0.1, 1.0, np.nextafter(np.float32(0.3), np.float32(1))]},
        {"link_enabled": [True, True, True, True, False]},
        {"link_innovation": [1, 2, 3, 4, 6]},
        {"node_activation": [0, 0, 0, 1, 2]},
        {"link_recurrent": [False, False, False, False, True]},
    ],
)
def test_json_shows_a_change_of_any_field(small: Genome, change: dict[str, object]) -> None:
    assert small.to_json() == small.replaced().to_json()
    assert small.to_json() != small.replaced(**change).to_json()


def test_zero_and_minus_zero_are_told_apart(small: Genome) -> None:
    zero, minus = np.zeros(5, dtype=np.float32), -np.zeros(5, dtype=np.float32)
    assert small.with_weights(zero).to_json() != small.with_weights(minus).to_json()


def test_a_saved_genome_is_loaded_bit_for_bit(small: Genome, tmp_path: Path) -> None:
    save_genome(small, tmp_path / "small.json")
    assert identical(load_genome(tmp_path / "small.json"), small)


def test_a_load_error_names_the_file(tmp_path: Path) -> None:
    path = tmp_path / "broken.json"
    path.write_text("{")
    with pytest.raises(GenomeError, match=r"broken\.json: .*not valid JSON"):
        load_genome(path)
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(GenomeError, match=r"broken\.json: .*not valid JSON"):
        load_genome(path)


def test_an_unknown_field_cannot_be_replaced(small: Genome) -> None:
    with pytest.raises(TypeError, match="link_wieght"):
        small.replaced(link_wieght=[0.0] * 5)
