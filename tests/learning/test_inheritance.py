"""What of a robot's learning its genes take over."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from neatq_torch.evolution import RtNEAT, RtNEATConfig
from neatq_torch.learning import PartialInheritance, write_back
from neatq_torch.network import PopulationNetwork


def population_of(seed: int = 0) -> tuple[RtNEAT, PopulationNetwork]:
    population = RtNEAT.start(RtNEATConfig(), robots=3, inputs=2, outputs=1, seed=seed)
    return population, PopulationNetwork(population.genomes)


def learn(network: PopulationNetwork, step: float) -> None:
    with torch.no_grad():
        network.weight.add_(step)


def genes(population: RtNEAT) -> np.ndarray:
    return np.array([genome.link_weight for genome in population.genomes])


def test_a_quarter_of_what_was_learnt_is_inherited_however_often_it_is_written() -> None:
    population, network = population_of()
    born, heritage = genes(population), PartialInheritance(0.25, [population])
    for _ in range(3):
        learn(network, 0.5)
        heritage.write_back(network, [population])
    assert genes(population) == pytest.approx(born + 0.25 * 1.5, abs=1e-6)
    (learnt, *_) = network.link_weights()
    assert learnt == pytest.approx(born[0] + 1.5, abs=1e-6)


def test_all_of_it_is_what_write_back_gives_and_nothing_learnt_changes_no_bit() -> None:
    whole, network = population_of()
    shared, _ = population_of()
    heritage, before = PartialInheritance(1.0, [shared]), genes(shared)
    PartialInheritance(0.3, [shared]).write_back(network, [shared])
    assert genes(shared).tobytes() == before.tobytes()
    learn(network, 1 / 3)
    write_back(network, [whole])
    heritage.write_back(network, [shared])
    assert genes(shared).tobytes() == genes(whole).tobytes()


def test_a_newborn_inherits_from_its_own_birth_on() -> None:
    population, network = population_of()
    heritage = PartialInheritance(0.5, [population])
    newborn = population.genomes[0].with_weights(np.full(3, 2.0, np.float32))
    population.genomes[1] = newborn
    network.replace(1, newborn)
    heritage.reset(1, newborn)
    learn(network, 1.0)
    heritage.write_back(network, [population])
    assert population.genomes[1].link_weight.tolist() == [2.5, 2.5, 2.5]


@pytest.mark.parametrize("share", [0.0, 1.5, float("nan")])
def test_a_share_out_of_range_is_refused(share: float) -> None:
    with pytest.raises(ValueError, match=r"share: expected within \(0, 1\]"):
        PartialInheritance(share, [])
