"""What a run on a Gymnasium task says of itself: one row for each arena and generation."""

from __future__ import annotations

from typing import NamedTuple


class Row(NamedTuple):
    """One row of `metrics.csv`. None is an empty cell.

    Attributes:
        arena: Number of the arena.
        generation: From 1.
        episodes: In which genomes of the arena have lived so far; evaluations do not count.
        steps: Of these episodes.
        best_fitness: Best mean return of a life in this generation, exploration included.
        mean_fitness: Mean over the generation.
        evaluated_return: Best mean return of an evaluated genome, if there was an evaluation.
        champion_return: That of the champion, when it was evaluated.
        species: Species among which the generation was divided.
        mean_nodes: Nodes of a genome.
        mean_links: Enabled links of a genome.
        td_error: Mean squared TD error.
    """

    arena: int
    generation: int
    episodes: int
    steps: int
    best_fitness: float
    mean_fitness: float
    evaluated_return: float | None
    champion_return: float
    species: int
    mean_nodes: float
    mean_links: float
    td_error: float | None


HEADER = ",".join(Row._fields) + "\n"
