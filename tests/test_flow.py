"""The seven steps, one after the other: the whole idea on one screen."""

from __future__ import annotations

import re
from pathlib import Path

import torch
from torchrl.collectors import Collector

import neatq_torch as nq
from neatq_envs import ArenaEnv, find_scenario
from neatq_trainers import loop

CONCEPTS = Path(__file__).resolve().parents[1] / "docs" / "concepts.md"
STEPS = ["compile", "act", "the world moves", "learn", "judge", "write back", "replace"]


def test_the_seven_steps() -> None:
    scenario = find_scenario("flag", changes={"robots": 6, "lifetime_ticks": 40})
    env, heads = ArenaEnv(scenario), nq.CandidateHeads(3, [-1.0, -0.2], [1.0, 0.2])
    evolution = nq.RtNEATConfig(minimum_life_ticks=40)
    population = nq.RtNEAT.start(
        evolution, slots=6, inputs=12, outputs=9, rng=0, reward_weights=(0.0, 0.0, 1.0)
    )
    # 1 compile: genomes become one network
    network = nq.PopulationNetwork(population.genomes, shape=(1, 6))
    policy = nq.CandidatePolicy(network, heads, nq.EpsilonGreedy((1, 6), seeds=[0]))
    loss = nq.CandidateTDLoss(nq.CandidateValue(network, heads), normalize_return=True)
    learner = nq.TDLearner(network, loss, nq.TDConfig(learning_rate=0.1))
    collector = Collector(
        env,
        policy,
        frames_per_batch=6 * 60,
        total_frames=6 * 60,
        auto_register_policy_transforms=False,
        use_buffers=False,
    )
    # 2 act, 3 the world moves: the collector does both, tick by tick
    for batch in collector:
        assert batch.shape == (1, 6, 60)
        before = population.genomes[0].link_weight
        assert learner.update(batch).shape == (1, 6)  # 4 learn: each slot its own network
        population.record(batch.get(("next", "reward_vector"))[0])  # 5 judge: fitness and age
        nq.write_back(network, [population])  # 6 write back
        assert (population.genomes[0].link_weight != before).any()
        newborn = torch.zeros(1, 6, dtype=torch.bool)
        for replacement in population.advance():  # 7 replace, and 1 compile again
            network.replace(replacement.slot, replacement.genome)
            newborn[0, replacement.slot] = True
        learner.reset(newborn)
        policy.reset(newborn)
        assert newborn.sum() == population.births == 1
        assert network.genome_id[newborn].item() == 7


def test_the_page_and_the_loop_tell_the_same_seven_steps() -> None:
    told = re.findall(r"^\d\. \*\*(.+?)\*\*", CONCEPTS.read_text(encoding="utf-8"), re.MULTILINE)
    numbered = re.findall(r"^(\d) ([a-z ]+?):", loop.__doc__ or "", re.MULTILINE)
    assert [one.lower() for one in told] == STEPS
    assert numbered == [(str(number), step) for number, step in enumerate(STEPS, 1)]
