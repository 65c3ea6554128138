"""A population of one's own, a script to copy: CMA-ME of pyribs (`python examples/map_elites.py`).

The archive holds the best network for every part of the field in which a life ended; CMA-ES looks
for weights that improve it (Fontaine et al. 2020). The trainer knows the population by its name.
"""

from __future__ import annotations

import pickle
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import tyro
from ribs.archives import GridArchive
from ribs.emitters import EvolutionStrategyEmitter as Emitter
from ribs.schedulers import Scheduler

import neatq_torch as nq


@dataclass(frozen=True, kw_only=True)
class MapElitesConfig(nq.FixedConfig):
    """Networks of fixed structure; cells of the archive; spread of the first weights."""

    cells: tuple[int, int] = (40, 40)
    ranges: tuple[tuple[float, float], ...] = ((0.0, 800.0), (0.0, 800.0))  # of x and y, units
    emitters: int = 2
    sigma: float = 0.5


class MapElites(nq.FixedPopulation):
    """Genomes that differ in their weights only, which pyribs asks for and is told about."""

    scheduler: Scheduler
    ends: np.ndarray  # [slots, 2], where the last episode of each ended

    @classmethod
    def start(cls, config: MapElitesConfig, **settings: Any) -> Self:
        population = super().start(config, **settings)
        slots, links = len(population.genomes), population.genomes[0].link_weight.size
        sizes = [part.size for part in np.array_split(np.arange(slots), config.emitters)]
        es = {"x0": np.zeros(links), "sigma0": config.sigma}
        key = int(population.rng.integers(2**31))
        settings = {"dims": config.cells, "ranges": config.ranges, "seed": key}
        archive = GridArchive(solution_dim=links, **settings)
        emitters = [Emitter(archive, batch_size=n, seed=key + i, **es) for i, n in enumerate(sizes)]
        population.scheduler, population.ends = Scheduler(archive, emitters), np.zeros((slots, 2))
        population._ask()
        return population

    def record(self, rewards: Any, done: Any = None, *, behaviour: Any = None, **_: Any) -> None:
        rewards, over, where = np.asarray(rewards), np.asarray(done), np.asarray(behaviour)
        for tick in range(rewards.shape[1]):
            ending = over[:, tick] & ~self.eligible
            self.ends[ending] = where[ending, tick]
            super().record(rewards[:, tick : tick + 1], over[:, tick : tick + 1])

    def advance(self) -> list[nq.Replacement]:
        if not self.due():
            return []
        self.scheduler.tell(self.fitness, self.ends)
        removed = [genome.genome_id for genome in self.genomes]
        self.births += len(removed)
        super().advance()
        self._ask()
        return [nq.Replacement(i, self.genomes[i], old, ()) for i, old in enumerate(removed)]

    def _ask(self) -> None:
        for slot, (old, weights) in enumerate(zip(self.genomes, self.scheduler.ask(), strict=True)):
            self.genomes[slot] = old.replaced(genome_id=self.next_genome_id, link_weight=weights)
            self.next_genome_id += 1

    def state_dict(self) -> dict[str, Any]:
        kept = np.frombuffer(pickle.dumps((self.scheduler, self.ends)), np.uint8)
        return super().state_dict() | {"search": kept}

    def load_state(self, state: Any) -> None:
        super().load_state(state)
        self.scheduler, self.ends = pickle.loads(state["search"].tobytes())  # your own run's


nq.register_population("map-elites", MapElitesConfig, MapElites)


def main(task: str = "maze", ticks: int = 70_000, seed: int = 0) -> None:
    nq.train(task, arm="rtneat", population="map-elites", ticks=ticks, seed=seed)


if __name__ == "__main__":
    tyro.cli(main)
