"""rtNEAT on CartPole from public parts, a script to copy: `python examples/rtneat_cartpole.py`.

Fifty poles are balanced side by side and nobody waits: whoever is judged worst gives way to a
newborn while the others live on. `nq.train("gym:CartPole-v1", "rtneat")` does the same and more.
"""

import gymnasium
import numpy as np
import torch
import tyro
from gymnasium.vector import AutoresetMode

import neatq_torch as nq


@torch.no_grad()
def main(slots: int = 50, ticks: int = 5_000, seed: int = 0) -> float:
    """Evolve; returns the ticks for which the champion balances, of at most 500."""
    by_hand = {"autoreset_mode": AutoresetMode.DISABLED}
    env = gymnasium.make_vec("CartPole-v1", slots, "sync", vector_kwargs=by_hand)
    # A genome is judged after two episodes; outputs say which action is best.
    config = nq.RtNEATConfig(minimum_life_episodes=2)
    shape = {"slots": slots, "inputs": 4, "outputs": 2, "activation": "identity"}
    population = nq.RtNEAT.start(config, rng=seed, **shape)
    network = nq.PopulationNetwork(population.genomes)
    acting = network.stateful()  # links may be recurrent: networks remember
    seen, _ = env.reset(seed=seed)
    for tick in range(1, ticks + 1):
        action = acting(seen).argmax(-1).numpy()
        seen, reward, terminated, truncated, _ = env.step(action)
        over = terminated | truncated
        population.record(reward[:, None, None], over[:, None])
        for replacement in population.advance():
            network.replace(replacement.slot, replacement.genome)
            over[replacement.slot] = True  # a newborn begins an episode of its own
        acting.reset(torch.from_numpy(over))
        if over.any():
            seen, _ = env.reset(options={"reset_mask": over})
        if tick % 1_000 == 0:
            lasts = np.nanmean(population.returns)  # of the last life of each
            print(f"tick {tick}: {population.births} births, an episode lasts {lasts:.0f} ticks")
    env.close()
    return balanced(population.genomes[population.champion or 0])


def balanced(genome: nq.Genome) -> float:
    """Return of an episode that nobody has seen."""
    env, acting = gymnasium.make("CartPole-v1"), nq.GenomeNetwork(genome).stateful()
    total, over = 0.0, False
    seen, _ = env.reset(seed=1_000)
    while not over:
        action = int(acting(seen).argmax())
        seen, reward, terminated, truncated, _ = env.step(action)
        total, over = total + float(reward), terminated or truncated
    return total


if __name__ == "__main__":
    print(f"the champion balances for {tyro.cli(main):.0f} ticks")
