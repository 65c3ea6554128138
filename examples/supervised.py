"""Gradients in an evolved network, a script to copy: `python examples/supervised.py`.

NEAT finds a structure that can tell XOR, Adam finds its weights, and these go back into the genome.
A network is an ordinary torch module, so imitation of a teacher is the same with other data.
"""

import torch
import tyro
from torch import nn

import neatq_torch as nq

INPUTS = torch.tensor([[0.0, 0.0], [0.0, 1.0], [1.0, 0.0], [1.0, 1.0]])
WANTED = torch.tensor([[0.0], [1.0], [1.0], [0.0]])


def main(
    generations: int = 100, steps: int = 500, seed: int = 0, out: str = "xor.json"
) -> tuple[float, float]:
    """Evolve, then train; returns the mean squared errors after each."""
    network = nq.GenomeNetwork(evolve(generations, seed))
    before = nn.functional.mse_loss(network(INPUTS), WANTED).item()
    optimizer = torch.optim.Adam(network.parameters(), lr=0.05)
    for _ in range(steps):
        optimizer.zero_grad()
        nn.functional.mse_loss(network(INPUTS), WANTED).backward()
        optimizer.step()
    nq.save_genome(network.genome(), out)  # the same structure, with the weights that were learnt
    again = nq.GenomeNetwork(nq.load_genome(out))
    return before, nn.functional.mse_loss(again(INPUTS), WANTED).item()


@torch.no_grad()
def evolve(generations: int, seed: int) -> nq.Genome:
    """The first genome whose outputs all lie on the right side of 0.5, or the best so far."""
    population = nq.NEAT.start(nq.NEATConfig(), slots=150, inputs=2, outputs=1, rng=seed)
    for generation in range(generations):
        network = nq.PopulationNetwork(population.ask())
        errors = (network(INPUTS.expand(150, 4, 2)) - WANTED).abs()  # [slots, 4, 1]
        best = int(errors.sum((1, 2)).argmin())
        if errors[best].max() < 0.5 or generation == generations - 1:
            return population.genomes[best]
        population.tell((4 - errors.sum((1, 2))).square())
    raise ValueError(f"generations: expected at least 1, got {generations}")


if __name__ == "__main__":
    evolved, learnt = tyro.cli(main)
    print(f"mean squared error: evolved {evolved:.6f}, then trained {learnt:.6f}")
