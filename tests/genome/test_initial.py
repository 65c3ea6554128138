from __future__ import annotations

import numpy as np
import pytest

from neatq_torch.genome import (
    ACTIVATIONS,
    Genome,
    GenomeError,
    InnovationLedger,
    NodeKind,
    initial_genome,
    layered_genome,
    random_genome,
)


def pairs(genome: Genome) -> set[tuple[int, int]]:
    return set(zip(genome.link_source.tolist(), genome.link_target.tolist(), strict=True))


def test_every_input_and_the_bias_are_linked_to_every_output() -> None:
    genome = initial_genome(2, 2, rng=np.random.default_rng(0), activation="tanh", genome_id=3)
    assert genome.input_ids.tolist() == [1, 2]
    assert genome.node_kind.tolist() == [0, 0, NodeKind.BIAS, 2, 2]
    assert genome.output_ids.tolist() == [4, 5]
    assert genome.link_innovation.tolist() == [1, 2, 3, 4, 5, 6]
    assert genome.link_source.tolist() == [1, 2, 3, 1, 2, 3]
    assert genome.link_target.tolist() == [4, 4, 4, 5, 5, 5]
    names = [ACTIVATIONS[index] for index in genome.node_activation]
    assert names == ["identity"] * 3 + ["tanh"] * 2
    assert genome.genome_id == 3


def test_opennero_starts_with_76_and_950_genes() -> None:
    rng = np.random.default_rng(0)
    assert initial_genome(18, 4, rng=rng).link_innovation.size == 76
    assert initial_genome(18, 50, rng=rng).link_innovation.size == 950


def test_there_may_be_no_bias() -> None:
    genome = initial_genome(2, 1, rng=np.random.default_rng(0), bias=False)
    assert NodeKind.BIAS not in genome.node_kind
    assert genome.output_ids.tolist() == [3]


def test_start_weights_are_uniform_within_one_and_some_are_zero() -> None:
    rng = np.random.default_rng(0)
    weights = np.array([initial_genome(18, 4, rng=rng).link_weight for _ in range(1000)])
    assert np.abs(weights).max() <= 1.0
    # Severe in half of the genomes: 10 % stay 0. Else the 15 genes beyond 0.8 * 76: 30 % do.
    expected = 0.5 * 0.1 + 0.5 * 0.3 * 15 / 76
    assert (weights == 0).mean() == pytest.approx(expected, abs=0.01)
    assert weights[weights != 0].std() == pytest.approx(1 / np.sqrt(3), rel=0.02)


def test_the_same_generator_gives_the_same_genome() -> None:
    first, second = (initial_genome(3, 2, rng=np.random.default_rng(5)) for _ in range(2))
    assert first.to_json() == second.to_json()


def test_impossible_shapes_are_refused() -> None:
    with pytest.raises(ValueError, match="at least 1 input and 1 output, not 0 and 2"):
        initial_genome(0, 2, rng=np.random.default_rng(0))
    with pytest.raises(GenomeError, match="activation 'sin' is unknown"):
        initial_genome(1, 2, rng=np.random.default_rng(0), activation="sin")


def test_a_layered_genome_links_sensors_to_hidden_nodes_and_these_to_outputs() -> None:
    genome = layered_genome(2, 1, hidden=2, rng=np.random.default_rng(0), activation="tanh")
    # Inputs 1 and 2, bias 3, output 4, hidden 5 and 6. The bias is linked to the output, too.
    to_hidden = {(sensor, node) for sensor in (1, 2, 3) for node in (5, 6)}
    assert pairs(genome) == to_hidden | {(5, 4), (6, 4), (3, 4)}
    names = [ACTIVATIONS[index] for index in genome.node_activation]
    assert names == ["identity"] * 3 + ["tanh"] * 3
    plain = layered_genome(2, 1, hidden=1, rng=np.random.default_rng(0), bias=False)
    assert pairs(plain) == {(1, 4), (2, 4), (4, 3)}


def test_random_genomes_have_30_percent_of_the_links_that_point_forward() -> None:
    rng = np.random.default_rng(0)
    genomes = [random_genome(3, 2, hidden=4, rng=rng) for _ in range(2000)]
    hidden = np.array([(one.node_kind == NodeKind.HIDDEN).sum() for one in genomes])
    assert np.bincount(hidden)[1:] == pytest.approx([500] * 4, abs=75)
    # 4 sensors; node h reads the h - 1 hidden nodes before it, outputs read all of them.
    possible = np.array([sum(4 + i for i in range(h)) + 2 * (4 + h) for h in hidden])
    links = np.array([one.link_weight.size for one in genomes])
    assert (links / possible).mean() == pytest.approx(0.3, abs=0.01)
    assert not any(one.link_recurrent.any() for one in genomes)
    whole = random_genome(3, 2, hidden=1, rng=rng, link_prob=1.0, activation="tanh", genome_id=7)
    assert whole.link_weight.size == 4 + 2 * 5
    assert whole.genome_id == 7
    assert (whole.node_activation[4:] == ACTIVATIONS.index("tanh")).all()


def test_random_genomes_agree_in_the_numbers_of_links() -> None:
    rng = np.random.default_rng(0)
    genomes = [random_genome(3, 1, hidden=5, rng=rng) for _ in range(100)]
    known: dict[tuple[int, int], int] = {}
    for genome in genomes:
        numbers = zip(sorted(pairs(genome)), range(100), strict=False)
        for pair, _ in numbers:
            at = (genome.link_source == pair[0]) & (genome.link_target == pair[1])
            number = int(genome.link_innovation[at][0])
            assert known.setdefault(pair, number) == number
    assert len(set(known.values())) == len(known)
    ledger = InnovationLedger.for_genomes(genomes)
    assert ledger.link(1, 5, False, 0.0).innovation == known[1, 5]
