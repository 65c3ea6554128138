from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from neatq_torch.genome import (
    Genome,
    GenomeError,
    InnovationLedger,
    MutationConfig,
    NodeKind,
    initial_genome,
    mutate,
)
from neatq_torch.genome.mutation import mutated_weights

PLAIN = MutationConfig()
NOTHING: dict[str, Any] = {
    "add_node_prob": 0.0,
    "add_link_prob": 0.0,
    "link_weights_prob": 0.0,
}
START = 10.0  # far from U(-0.5, 0.5), so that new weights and moved ones cannot be confused


def add_node(
    genome: Genome, config: MutationConfig, ledger: InnovationLedger, rng: np.random.Generator
) -> Genome:
    return mutate(genome, replace(config, add_node_prob=1.0), ledger, rng)


def add_link(
    genome: Genome, config: MutationConfig, ledger: InnovationLedger, rng: np.random.Generator
) -> Genome:
    return mutate(genome, replace(config, add_node_prob=0.0, add_link_prob=1.0), ledger, rng)


def changed(genome: Genome, rng: np.random.Generator, **config: Any) -> Genome:
    """The genome after one mutation of the only kind that happens."""
    return mutate(genome, MutationConfig(**(NOTHING | config)), InnovationLedger(), rng)


def toggle_enable(genome: Genome, rng: np.random.Generator) -> Genome:
    return changed(genome, rng, toggle_enable_prob=1.0)


def reenable(genome: Genome) -> Genome:
    return changed(genome, np.random.default_rng(0), reenable_prob=1.0)


def remove_link(genome: Genome, rng: np.random.Generator) -> Genome:
    return changed(genome, rng, remove_link_prob=1.0)


def shares(config: MutationConfig, links: int) -> np.ndarray:
    """[mutations, links] of 0 kept, 1 moved, 2 new."""
    rng = np.random.default_rng(0)
    weights = np.full(links, START, dtype=np.float32)
    new = np.array([mutated_weights(weights, config, rng) for _ in range(4000)])
    return np.where(new == START, 0, np.where(np.abs(new) < 1, 2, 1))


def rates(kinds: np.ndarray) -> list[float]:
    return [float((kinds == kind).mean()) for kind in (0, 1, 2)]


def test_half_of_openneros_weight_mutations_are_severe_and_the_tail_is_shaken() -> None:
    kinds = shares(MutationConfig(max_link_weight=None), 20)
    old, young = kinds[:, :17], kinds[:, 17:]  # genes beyond 0.8 * 20 = 16 are young
    # Old genes: half 10 / 70 / 20, half 0 / 100 / 0. Young: half of the same, half 30 / 50 / 20.
    assert rates(old) == pytest.approx([0.05, 0.85, 0.10], abs=0.02)
    assert rates(young) == pytest.approx([0.20, 0.60, 0.20], abs=0.02)
    gentle = (old == 1).all(axis=1)
    assert gentle.mean() == pytest.approx(0.5, abs=0.03)


def test_a_genome_of_less_than_ten_genes_has_no_tail() -> None:
    kinds = shares(MutationConfig(max_link_weight=None), 9)
    assert rates(kinds[:, 8:]) == pytest.approx([0.05, 0.85, 0.10], abs=0.02)


def test_neat_2002_moves_90_percent_and_renews_10_percent() -> None:
    config = MutationConfig(weight_scheme="uniform", max_link_weight=None)
    assert rates(shares(config, 20)) == pytest.approx([0.0, 0.9, 0.1], abs=0.01)


def test_weights_move_uniformly_within_the_power_and_are_capped() -> None:
    config = MutationConfig(weight_scheme="uniform", weight_replace_prob=0.0)
    rng = np.random.default_rng(0)
    moved = mutated_weights(np.zeros(20_000, dtype=np.float32), config, rng)
    assert np.abs(moved).max() <= 0.5
    assert moved.std() == pytest.approx(0.5 / np.sqrt(3), rel=0.02)
    capped = mutated_weights(np.full(1000, 9.0, dtype=np.float32), PLAIN, rng)
    assert capped.max() == 3.0
    assert mutated_weights(np.full(1000, -9.0, dtype=np.float32), PLAIN, rng).min() == -3.0


def test_a_new_node_splits_a_link(small: Genome) -> None:
    ledger, rng = InnovationLedger.for_genomes([small]), np.random.default_rng(0)
    only = small.replaced(link_enabled=[False, True, False, False, False])
    child = add_node(only, PLAIN, ledger, rng)
    assert child.link_enabled.tolist() == [False, False, False, False, False, True, True]
    assert child.node_id.tolist() == [1, 2, 3, 4, 5, 6]
    assert child.node_kind[5] == NodeKind.HIDDEN
    assert child.link_source[5:].tolist() == [2, 6]
    assert child.link_target[5:].tolist() == [6, 4]
    assert child.link_weight[5:].tolist() == [1.0, pytest.approx(-0.3)]
    neat = MutationConfig(split_weight_scale=1.0, hidden_activation="steep_sigmoid")
    child = add_node(only, neat, ledger, rng)
    assert child.link_weight[6] == -1.0
    assert child.node_activation[5] == 2


def test_a_link_of_the_bias_is_never_split(small: Genome) -> None:
    only = small.replaced(link_enabled=[False, False, True, False, False])
    ledger = InnovationLedger.for_genomes([small])
    assert add_node(only, PLAIN, ledger, np.random.default_rng(0)) is only


def test_a_small_genome_splits_its_oldest_link_or_with_30_percent_each_next_one() -> None:
    genome = initial_genome(3, 1, rng=np.random.default_rng(0))
    # Links of inputs 1, 2 and 3 and of the bias; the first is switched off.
    genome = genome.replaced(link_enabled=[False, True, True, True])
    config = MutationConfig(split_old_below=5)
    rng, counts = np.random.default_rng(0), {None: 0, 2: 0, 3: 0}
    for _ in range(4000):
        child = add_node(genome, config, InnovationLedger.for_genomes([genome]), rng)
        split = None if child is genome else int(child.link_source[-2])
        counts[split] += 1
    shares = [counts[2] / 4000, counts[3] / 4000, counts[None] / 4000]
    assert shares == pytest.approx([0.7, 0.3 * 0.7, 0.3 * 0.3], abs=0.02)


def test_a_large_genome_splits_any_link() -> None:
    genome = initial_genome(3, 1, rng=np.random.default_rng(0))
    config = MutationConfig(split_old_below=4)
    rng, sources = np.random.default_rng(0), []
    for _ in range(3000):
        child = add_node(genome, config, InnovationLedger.for_genomes([genome]), rng)
        sources.append(int(child.link_source[-2]))
    assert np.bincount(sources)[1:] == pytest.approx([1000] * 3, abs=90)


def test_splitting_a_recurrent_link_keeps_the_delay_in_front_of_the_node(
    make_genome: Callable[..., Genome],
) -> None:
    genome = make_genome([(1, 4, 4, 2.0)], link_recurrent=[True])
    ledger = InnovationLedger.for_genomes([genome])
    child = add_node(genome, PLAIN, ledger, np.random.default_rng(0))
    assert child.link_recurrent.tolist() == [True, True, False]


def test_the_same_structural_mutation_gets_the_same_number_and_weight(
    make_genome: Callable[..., Genome],
) -> None:
    # The only forward place is 2 -> 4; the second genome finds it with another random weight.
    genome = make_genome([(1, 1, 4, 0.5), (2, 3, 4, 0.5)])
    config = MutationConfig(recurrent_link_prob=0.0, new_link_tries=200)
    ledger = InnovationLedger.for_genomes([genome])
    first = add_link(genome, config, ledger, np.random.default_rng(1))
    second = add_link(genome, config, ledger, np.random.default_rng(2))
    assert first.link_innovation.tolist() == [1, 2, 3]
    assert (first.link_source[2], first.link_target[2]) == (2, 4)
    assert first.to_json() == second.to_json()
    fresh = InnovationLedger.for_genomes([genome])
    alone = add_link(genome, config, fresh, np.random.default_rng(2))
    assert alone.link_weight[2] != second.link_weight[2]


def test_two_genomes_that_split_the_same_link_share_the_node(small: Genome) -> None:
    ledger = InnovationLedger.for_genomes([small])
    only = small.replaced(link_enabled=[False, True, False, False, False])
    children = [add_node(only, PLAIN, ledger, np.random.default_rng(i)) for i in (1, 2)]
    assert children[0].to_json() == children[1].to_json()
    again = children[0].replaced(link_enabled=[False, True] + [False] * 5)
    assert add_node(again, PLAIN, ledger, np.random.default_rng(3)).node_id[-1] == 7


def test_a_ledger_that_does_not_know_the_genome_is_found_out(small: Genome) -> None:
    config = MutationConfig(recurrent_link_prob=0.0, new_link_tries=200)
    for mutation in (add_node, add_link):
        ledger = InnovationLedger(next_innovation=3, next_node_id=9)
        with pytest.raises(GenomeError, match="innovation 3 occurs more than once"):
            mutation(small, config, ledger, np.random.default_rng(0))


def test_a_genome_without_free_place_stays_as_it_is() -> None:
    rng = np.random.default_rng(0)
    genome = initial_genome(3, 2, rng=rng)
    config = MutationConfig(recurrent_link_prob=0.0, new_link_tries=500, forward_from_outputs=False)
    assert add_link(genome, config, InnovationLedger.for_genomes([genome]), rng) is genome


def test_links_out_of_outputs_are_recurrent_and_half_of_the_tries_look_at_loops() -> None:
    rng = np.random.default_rng(0)
    genome = initial_genome(1, 20, rng=rng)
    config = MutationConfig(recurrent_link_prob=1.0, new_link_tries=100, forward_from_outputs=False)
    ledger = InnovationLedger.for_genomes([genome])
    children = [add_link(genome, config, ledger, rng) for _ in range(600)]
    assert all(child.link_recurrent[-1] for child in children)
    assert all(child.link_source[-1] > 2 for child in children)
    loops = np.mean([child.link_source[-1] == child.link_target[-1] for child in children])
    # Of 22 nodes the 20 outputs can be the source: a loop by chance in 1 of 22 other tries.
    by_kind = 0.5, 0.5 * 20 / 22
    assert loops == pytest.approx((by_kind[0] + by_kind[1] / 20) / sum(by_kind), abs=0.05)


def test_outputs_may_feed_outputs_forward_as_in_opennero_but_never_in_a_circle() -> None:
    rng = np.random.default_rng(0)
    genome = initial_genome(1, 3, rng=rng)
    ledger = InnovationLedger.for_genomes([genome])
    config = MutationConfig(recurrent_link_prob=0.0, new_link_tries=200)
    for links in range(7, 10):  # three outputs have room for three forward links
        genome = add_link(genome, config, ledger, rng)
        assert genome.link_weight.size == links and not genome.link_recurrent.any()
    assert add_link(genome, config, ledger, rng) is genome


def test_a_link_against_the_stream_is_recurrent(make_genome: Callable[..., Genome]) -> None:
    links = [(1, 1, 5, 1.0), (2, 5, 6, 1.0), (3, 6, 4, 1.0)]
    genome = make_genome(links, hidden=(5, 6), link_enabled=[True, False, True])
    rng = np.random.default_rng(0)
    seen: set[tuple[int, int, bool]] = set()
    for prob in (0.0, 1.0):
        config = MutationConfig(recurrent_link_prob=prob, new_link_tries=50)
        for _ in range(300):
            child = add_link(genome, config, InnovationLedger.for_genomes([genome]), rng)
            last = int(child.link_source[-1]), int(child.link_target[-1])
            seen.add((*last, bool(child.link_recurrent[-1])))
    recurrent = {(source, target) for source, target, flag in seen if flag}
    assert recurrent == {(4, 4), (4, 5), (4, 6), (5, 5), (6, 5), (6, 6)}
    forward = {(source, target) for source, target, flag in seen if not flag}
    sensors = {(source, target) for source in (1, 2, 3) for target in (4, 5, 6)}
    assert forward == (sensors | {(5, 4)}) - {(1, 5)}


@pytest.mark.parametrize(
    ("config", "expected"),
    [
        ({"add_node_prob": 1.0}, "node"),
        ({"add_node_prob": 0.0, "add_link_prob": 1.0, "recurrent_link_prob": 1.0}, "link"),
        ({"add_node_prob": 0.0, "add_link_prob": 0.0, "link_weights_prob": 1.0}, "weights"),
        ({"add_node_prob": 0.0, "add_link_prob": 0.0, "link_weights_prob": 0.0}, "nothing"),
    ],
)
def test_a_structural_mutation_is_the_only_one(
    small: Genome, config: dict[str, Any], expected: str
) -> None:
    config = {"new_link_tries": 100, "split_tries": 100} | config
    ledger = InnovationLedger.for_genomes([small])
    child = mutate(small, MutationConfig(**config), ledger, np.random.default_rng(0))
    kept = np.isin(child.link_innovation, small.link_innovation)
    same_weights = np.array_equal(child.link_weight[kept], small.link_weight)
    grown = child.node_id.size - 5, child.link_innovation.size - 5
    found = {(1, 2): "node", (0, 1): "link", (0, 0): "weights"}[grown]
    assert (found if not (same_weights and grown == (0, 0)) else "nothing") == expected
    assert same_weights == (expected != "weights")


def test_mutations_happen_as_often_as_configured(small: Genome) -> None:
    ledger, rng = InnovationLedger.for_genomes([small]), np.random.default_rng(0)
    config = MutationConfig(add_node_prob=0.2, add_link_prob=0.5, recurrent_link_prob=1.0)
    children = [mutate(small, config, ledger, rng) for _ in range(2000)]
    nodes = np.array([child.node_id.size - 5 for child in children])
    links = np.array([child.link_innovation.size - 5 for child in children]) - 2 * nodes
    assert nodes.mean() == pytest.approx(0.2, abs=0.03)
    assert links.mean() == pytest.approx(0.8 * 0.5, abs=0.04)


def test_disabling_never_cuts_off_the_last_link_of_a_node(small: Genome) -> None:
    rng = np.random.default_rng(0)
    seen = {tuple(toggle_enable(small, rng).link_enabled.tolist()) for _ in range(200)}
    # Only node 1 has two enabled links, 1 and 4.
    assert seen == {
        (True,) * 5,
        (False, True, True, True, True),
        (True, True, True, False, True),
    }


def test_a_disabled_link_can_be_toggled_back(small: Genome) -> None:
    off, rng = small.replaced(link_enabled=[False] * 5), np.random.default_rng(0)
    assert toggle_enable(off, rng).link_enabled.sum() == 1


def test_reenable_switches_the_first_disabled_link_on(small: Genome) -> None:
    off = small.replaced(link_enabled=[True, False, True, False, True])
    assert reenable(off).link_enabled.tolist() == [True, True, True, False, True]
    assert reenable(small).link_enabled.all()


def test_toggling_and_reenabling_happen_if_asked_for(small: Genome) -> None:
    quiet = MutationConfig(add_node_prob=0.0, add_link_prob=0.0, link_weights_prob=0.0)
    ledger = InnovationLedger.for_genomes([small])
    off = small.replaced(link_enabled=[False] * 5)
    for extra in ("toggle_enable_prob", "reenable_prob"):
        config = replace(quiet, **{extra: 1.0})
        child = mutate(off, config, ledger, np.random.default_rng(0))
        assert child.link_enabled.sum() == 1


def test_removing_takes_each_enabled_link_as_often(small: Genome) -> None:
    rng = np.random.default_rng(0)
    off = small.replaced(link_enabled=[True, False, True, True, True])
    gone = [
        tuple(sorted(set(off.link_innovation) - set(remove_link(off, rng).link_innovation)))
        for _ in range(2000)
    ]
    # With link 5 the hidden node goes, whose only link it is, and link 4 into it.
    shares = {links: gone.count(links) / 2000 for links in set(gone)}
    assert shares == pytest.approx(dict.fromkeys([(1,), (3,), (4,), (4, 5)], 0.25), abs=0.04)


def test_hidden_nodes_that_no_link_leaves_go_one_after_the_other(
    make_genome: Callable[..., Genome],
) -> None:
    chain = [(1, 1, 6, 1.0), (2, 6, 7, 1.0), (3, 7, 4, 1.0), (4, 2, 6, 1.0), (5, 7, 7, 1.0)]
    loop = {"link_recurrent": [False] * 4 + [True]}
    genome = make_genome(chain, hidden=(6, 7), **loop)
    only = genome.replaced(link_enabled=[False, False, True, False, False])
    child = remove_link(only, np.random.default_rng(0))
    assert (child.link_innovation.size, child.node_id.tolist()) == (0, [1, 2, 3, 4])
    assert Genome.from_json(child.to_json()).to_json() == child.to_json()
    # Disabled links still lead somewhere: they may be enabled again.
    first = genome.replaced(link_enabled=[True, False, False, False, False])
    child = remove_link(first, np.random.default_rng(0))
    assert child.link_innovation.tolist() == [2, 3, 4, 5]
    assert child.node_id.tolist() == genome.node_id.tolist()


def test_a_genome_loses_its_last_link_and_then_stays_as_it_is(small: Genome) -> None:
    rng, genome = np.random.default_rng(0), small
    while genome.link_innovation.size:
        genome = remove_link(genome, rng)
    assert genome.node_id.tolist() == [1, 2, 3, 4]
    assert remove_link(genome, rng) is genome


def test_a_removed_link_comes_back_with_its_number(small: Genome) -> None:
    ledger, rng = InnovationLedger.for_genomes([small]), np.random.default_rng(0)
    config = MutationConfig(recurrent_link_prob=0.0, forward_from_outputs=False, new_link_tries=99)
    gone = small.replaced(
        **{name: getattr(small, name)[1:] for name in vars(small) if name.startswith("link_")}
    )
    seen = [add_link(gone, config, ledger, rng) for _ in range(20)]
    (back, *_) = [one for one in seen if 1 in one.link_innovation]
    assert (back.link_source[0], back.link_target[0], back.link_weight[0]) == (1, 4, 0.5)


def test_removing_happens_as_often_as_configured(small: Genome) -> None:
    ledger, rng = InnovationLedger.for_genomes([small]), np.random.default_rng(0)
    config = MutationConfig(add_node_prob=0.0, add_link_prob=0.5, remove_link_prob=0.4)
    children = [mutate(small, config, ledger, rng) for _ in range(2000)]
    shrunk = np.array([child.link_innovation.size < 5 for child in children])
    assert shrunk.mean() == pytest.approx(0.5 * 0.4, abs=0.03)


@pytest.mark.parametrize("never", [None, 0.0])
def test_where_nothing_is_removed_no_chance_is_drawn_for_it(
    small: Genome, never: float | None
) -> None:
    ledger, rng = InnovationLedger.for_genomes([small]), np.random.default_rng(0)
    mutate(small, MutationConfig(link_weights_prob=0.0, remove_link_prob=never), ledger, rng)
    other = np.random.default_rng(0)
    other.random(5)  # node, link, weights, toggle, re-enable
    assert rng.random() == other.random()


def test_mutation_leaves_the_parent_as_it_was(small: Genome) -> None:
    before = small.to_json()
    ledger, rng = InnovationLedger.for_genomes([small]), np.random.default_rng(0)
    for _ in range(50):
        mutate(small, MutationConfig(add_node_prob=0.3, add_link_prob=0.3), ledger, rng)
    assert small.to_json() == before


def test_genomes_without_links_can_mutate(make_genome: Callable[..., Genome]) -> None:
    empty, rng = make_genome([]), np.random.default_rng(0)
    ledger = InnovationLedger.for_genomes([empty])
    assert add_node(empty, PLAIN, ledger, rng) is empty
    assert toggle_enable(empty, rng).to_json() == empty.to_json()
    assert reenable(empty).to_json() == empty.to_json()
    assert changed(empty, rng, link_weights_prob=1.0).to_json() == empty.to_json()
    config = MutationConfig(recurrent_link_prob=0.0, new_link_tries=50)
    assert add_link(empty, config, ledger, rng).link_innovation.tolist() == [1]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"add_node_prob": 1.2}, r"add_node_prob: expected \[0, 1\], got 1.2"),
        ({"weight_mutation_power": -1.0}, r"weight_mutation_power: expected \[0, inf\)"),
        ({"new_link_tries": 0}, "new_link_tries: expected at least 1"),
        ({"max_link_weight": 0.0}, r"max_link_weight: expected \(0, inf\] or None"),
        ({"weight_scheme": "neat"}, "weight_scheme: expected 'opennero' or 'uniform'"),
        (
            {"split_weight_scale": float("nan")},
            r"split_weight_scale: expected \(-inf, inf\), got nan",
        ),
        ({"hidden_activation": "sin"}, "activation 'sin' is unknown"),
    ],
)
def test_a_config_out_of_range_is_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        MutationConfig(**change)
