"""rtNEAT+Q from the public parts alone, a script to copy: `python examples/minimal.py`.

Fifty robots, a wall and a flag. `nq.train` adds the run folder, checkpoints and exactness.
"""

import torch
from torchrl.collectors import Collector

import neatq_torch as nq
from neatq_envs import TASKS, ArenaEnv

BATCH_TICKS = 40  # rtNEAT replaces one robot every 40 ticks


def main(ticks: int = 20_000, seed: int = 0) -> float:
    """Train; returns the mean distance of the team to the flag over the last batch, in units."""
    scenario = TASKS["wall"].replaced(reward="progress")
    env = ArenaEnv(scenario, arenas=1, seed=seed)
    shape, robots = env.batch_size, scenario.robots
    low, high = env.arena.schema.action_bounds(scenario)
    heads = nq.CandidateHeads(5, low.tolist(), high.tolist())
    population = nq.RtNEAT.start(
        nq.RtNEATConfig(),
        slots=robots,
        inputs=env.observation_spec["observation"].shape[-1],
        outputs=heads.outputs,
        rng=seed,
        reward_weights=tuple(scenario.weights()),
    )
    network = nq.PopulationNetwork(population.genomes, shape=shape)  # 1 compile
    policy = nq.CandidatePolicy(network, heads, nq.EpsilonGreedy(shape, seeds=[seed], epsilon=0.01))
    loss = nq.CandidateTDLoss(nq.CandidateValue(network, heads), normalize_return=True)
    loss.make_value_estimator(gamma=0.9)
    learner = nq.TDLearner(network, loss, nq.TDConfig(learning_rate=0.01, optimizer="adam"))
    collector = Collector(
        env,
        policy,
        frames_per_batch=robots * BATCH_TICKS,
        total_frames=robots * ticks,
        auto_register_policy_transforms=False,
        use_buffers=False,
    )
    distance = float("nan")
    for number, batch in enumerate(collector, 1):  # 2 act, 3 collect
        learner.update(batch)  # 4 learn
        population.record(batch["next", "reward_vector"][0].numpy())  # 5 judge
        nq.write_back(network, [population])  # 6 write back
        newborn = torch.zeros(shape, dtype=torch.bool)
        for replacement in population.advance():  # 7 replace
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
