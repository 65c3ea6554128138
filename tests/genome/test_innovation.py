from __future__ import annotations

import json

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from neatq_torch.genome import Genome, InnovationLedger
from neatq_torch.genome.heredity import matching
from neatq_torch.genome.innovation import Split


def test_the_same_link_gets_the_same_number_and_the_weight_of_its_first_occurrence() -> None:
    ledger = InnovationLedger(next_innovation=10)
    assert ledger.link(1, 4, False, 0.25) == (10, 0.25)
    assert ledger.link(2, 4, False, 0.5) == (11, 0.5)
    assert ledger.link(1, 4, False, -0.75) == (10, 0.25)


def test_a_recurrent_link_is_another_link_than_a_forward_one() -> None:
    ledger = InnovationLedger()
    assert ledger.link(1, 4, False, 0.25).innovation == 1
    assert ledger.link(1, 4, True, 0.25).innovation == 2
    assert ledger.link(4, 1, False, 0.25).innovation == 3


def test_the_same_split_gets_the_same_node() -> None:
    ledger = InnovationLedger(next_innovation=20, next_node_id=6)
    assert ledger.split(3, [1, 2]) == Split(6, 20, 21)
    assert ledger.split(4, [1, 2]) == Split(7, 22, 23)
    assert ledger.split(3, [1, 2]) == Split(6, 20, 21)


def test_a_second_split_in_one_genome_gets_the_next_node_and_shares_it() -> None:
    ledger = InnovationLedger(next_innovation=20, next_node_id=6)
    ledger.split(3, [])
    assert ledger.split(3, [6]) == Split(7, 22, 23)
    assert ledger.split(3, [1, 6]) == Split(7, 22, 23)
    assert ledger.split(3, [6, 7]) == Split(8, 24, 25)


def test_a_ledger_for_genomes_knows_their_links_and_numbers_beyond_them(small: Genome) -> None:
    ledger = InnovationLedger.for_genomes([small, small.replaced(link_weight=[0.0] * 5)])
    assert ledger.link(2, 4, False, 9.0) == (2, -1.0)
    assert ledger.link(4, 4, True, 9.0) == (6, 9.0)
    assert ledger.split(6, []) == Split(6, 7, 8)


def test_a_ledger_continues_from_its_state_as_json() -> None:
    ledger = InnovationLedger(next_innovation=20, next_node_id=6)
    ledger.link(1, 4, True, float(np.float32(0.1)))
    ledger.split(3, [])
    ledger.split(3, [6])
    state = json.loads(json.dumps(ledger.state_dict()))
    copy = InnovationLedger.from_state(state)
    assert copy.state_dict() == ledger.state_dict()
    assert copy.link(1, 4, True, 5.0) == (20, float(np.float32(0.1)))
    assert copy.split(3, [6]) == ledger.split(3, [6])
    assert copy.link(2, 4, True, 5.0) == ledger.link(2, 4, True, 5.0)


NUMBERS = st.lists(st.integers(0, 40) | st.integers(10**6, 10**12), unique=True).map(sorted)


@given(NUMBERS, NUMBERS)
def test_matching_finds_what_both_have(first: list[int], second: list[int]) -> None:
    in_first, in_second = matching(np.array(first, np.int64), np.array(second, np.int64))
    both = sorted(set(first) & set(second))
    assert [first[at] for at in in_first] == [second[at] for at in in_second] == both


def test_what_is_forgotten_gets_a_new_number_and_no_number_twice() -> None:
    ledger = InnovationLedger(10, 5)
    first, split = ledger.link(1, 4, False, 0.5), ledger.split(1, [])
    assert ledger.link(1, 4, False, 0.75) == first
    ledger.forget()
    again = ledger.link(1, 4, False, 0.75)
    assert (again.innovation, again.weight) == (13, 0.75)
    assert ledger.split(1, []).node_id == split.node_id + 1
