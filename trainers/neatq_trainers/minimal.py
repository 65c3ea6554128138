"""rtNEAT+Q from the public parts alone, as a script to copy: `python -m neatq_trainers.minimal`.

Fifty robots, a wall and a flag. `neatq train` adds the run folder, checkpoints and exactness.
"""

from __future__ import annotations

import torch
from torchrl.collectors import Collector

from neatq_envs.scenario import TASKS
from neatq_envs.torchrl import ArenaEnv
from neatq_torch.evolution import RtNEAT, RtNEATConfig
from neatq_torch.learning import (
    CandidateHeads,
    CandidatePolicy,
    CandidateTDLoss,
    CandidateValue,
    EpsilonGreedy,
    LearnerConfig,
    TDLearner,
    write_back,
)
from neatq_torch.network import PopulationNetwork

BATCH_TICKS = 40  # rtNEAT replaces one robot every 40 ticks


def main(ticks: int = 20_000, seed: int = 0) -> float:
    """Train; returns the mean distance of the team to the flag over the last batch, in units."""
    scenario = TASKS["wall"].replaced(reward="progress")
    env = ArenaEnv(scenario, arenas=1, seed=seed)
    low, high = env.arena.schema.action_bounds(scenario)
    heads = CandidateHeads(5, low.tolist(), high.tolist())

    population = RtNEAT.start(
        RtNEATConfig(reward_weights=tuple(scenario.weights())),
        robots=scenario.robots,
        inputs=env.observation_spec["observation"].shape[-1],
        outputs=heads.outputs,
        seed=seed,
    )
    shape = env.batch_size
    network = PopulationNetwork(population.genomes, shape=shape)
    policy = CandidatePolicy(network, heads, EpsilonGreedy(shape, seeds=[seed], epsilon=0.01))
    loss = CandidateTDLoss(CandidateValue(network, heads), normalize_return=True)
    loss.make_value_estimator(gamma=0.9)
    learner = TDLearner(network, loss, LearnerConfig(learning_rate=0.01, optimizer="adam"))

    collector = Collector(
        env,
        policy,
        frames_per_batch=scenario.robots * BATCH_TICKS,
        total_frames=scenario.robots * ticks,
        auto_register_policy_transforms=False,
        use_buffers=False,
    )
    distance = float("nan")
    for number, batch in enumerate(collector, 1):
        learner.update(batch)
        population.record(batch["next", "reward_vector"][0].numpy())
        write_back(network, [population])
        newborn = torch.zeros(shape, dtype=torch.bool)
        for replacement in population.replace():
            network.replace(replacement.slot, replacement.genome)
            newborn[0, replacement.slot] = True
        if newborn.any():
            learner.reset(newborn)
            policy.reset(newborn)
            collector.reset(index=newborn)
        distance = batch["next", "distance"].mean().item()
        if number % 25 == 0:
            print(f"tick {number * BATCH_TICKS:6d}  mean distance {distance:5.1f}")
    collector.shutdown()
    return distance


if __name__ == "__main__":
    torch.set_num_threads(1)
    main()
