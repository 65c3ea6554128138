"""The seven steps, one after the other: the whole idea on one screen."""

from __future__ import annotations

import torch
from torchrl.collectors import Collector

from neatq_envs.scenario import TASKS
from neatq_envs.torchrl import ArenaEnv
from neatq_torch import learning as nl
from neatq_torch.evolution import RtNEAT, RtNEATConfig
from neatq_torch.network import PopulationNetwork


def test_the_seven_steps() -> None:
    env = ArenaEnv(TASKS["flag"].replaced(robots=6, lifetime_ticks=40))
    config = RtNEATConfig(minimum_life_ticks=40, reward_weights=(0.0, 0.0, 1.0))
    heads = nl.CandidateHeads(3, [-1.0, -0.2], [1.0, 0.2])
    population = RtNEAT.start(config, robots=6, inputs=12, outputs=heads.outputs, seed=0)
    # 1 compile: genomes become one network
    network = PopulationNetwork(population.genomes, shape=(1, 6))
    policy = nl.CandidatePolicy(network, heads, nl.EpsilonGreedy((1, 6), seeds=[0]))
    loss = nl.CandidateTDLoss(nl.CandidateValue(network, heads), normalize_return=True)
    learner = nl.TDLearner(network, loss, nl.LearnerConfig(learning_rate=0.1))
    collector = Collector(
        env,
        policy,
        frames_per_batch=6 * 60,
        total_frames=6 * 60,
        auto_register_policy_transforms=False,
        use_buffers=False,
    )
    # 2 act: the collector runs the robots in the arena
    for batch in collector:
        assert batch.shape == (1, 6, 60)
        before = population.genomes[0].link_weight
        assert learner.update(batch).shape == (1, 6)  # 3 learn: one step of each own network
        nl.write_back(network, [population])  # 4 write back
        assert (population.genomes[0].link_weight != before).any()
        population.record(batch.get(("next", "reward_vector"))[0])  # 5 fitness and age
        newborn = torch.zeros(1, 6, dtype=torch.bool)
        for replacement in population.replace():  # 6 rtNEAT replaces the worst
            network.replace(replacement.slot, replacement.genome)  # 7 compile again
            newborn[0, replacement.slot] = True
        learner.reset(newborn)
        policy.reset(newborn)
        assert newborn.sum() == population.births == 1
        assert network.genome_id[newborn].item() == 7
