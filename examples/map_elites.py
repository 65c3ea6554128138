"""A population of one's own, a script to copy: CMA-ME of pyribs (`python examples/map_elites.py`).

The archive holds the best network for every part of the field in which a life ended; CMA-ES looks
for weights that improve it (Fontaine et al. 2020). The trainer knows the population by its name.
"""

import pickle
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from ribs.archives import GridArchive
from ribs.emitters import EvolutionStrategyEmitter as Emitter
from ribs.schedulers import Scheduler

import neatq_torch as nq


@dataclass(frozen=True, kw_only=True)
class MapElitesConfig(nq.FixedConfig):
    """Networks of fixed structure; cells and ranges (units) of the archive."""

    cells: tuple[int, int] = (40, 40)
    ranges: tuple[tuple[float, float], ...] = ((0.0, 800.0), (0.0, 800.0))
    emitters: int = 2


class MapElites(nq.FixedPopulation):
    """Genomes that differ in their weights only, which pyribs asks for and is told about."""

    scheduler: Scheduler
    ends: np.ndarray  # [slots, 2], where each was last

    @classmethod
    def start(cls, config: MapElitesConfig, **settings: Any) -> Self:
        one = super().start(config, **settings)
        slots, links = len(one.genomes), one.genomes[0].link_weight.size
        key = int(one.rng.integers(2**31))
        archive = GridArchive(solution_dim=links, dims=config.cells, ranges=config.ranges, seed=key)
        sizes = np.bincount(np.arange(slots) * config.emitters // slots).tolist()
        es = {"x0": np.zeros(links), "sigma0": 0.5}
        emitters = [Emitter(archive, batch_size=n, seed=key + i, **es) for i, n in enumerate(sizes)]
        one.scheduler, one.ends = Scheduler(archive, emitters), np.zeros((slots, 2))
        one._ask()
        return one

    def record(self, rewards: Any, done: Any = None, *, behaviour: Any = None) -> None:
        for tick in range(np.shape(rewards)[1]):
            self.ends = np.where(self.eligible[:, None], self.ends, behaviour[:, tick])
            super().record(rewards[:, tick : tick + 1], done[:, tick : tick + 1])

    def advance(self) -> list[nq.Replacement]:
        if not self.due():
            return []
        self.scheduler.tell(self.fitness, self.ends)
        self.births += len(self.genomes)
        before = super().advance()  # all as they were
        self._ask()
        return [one._replace(genome=self.genomes[one.slot], parents=()) for one in before]

    def _ask(self) -> None:
        for slot, weights in enumerate(self.scheduler.ask()):
            new = {"genome_id": self.next_genome_id + slot, "link_weight": weights}
            self.genomes[slot] = self.genomes[slot].replaced(**new)
        self.next_genome_id += len(self.genomes)

    def state_dict(self) -> dict[str, Any]:
        search = np.frombuffer(pickle.dumps((self.scheduler, self.ends)), np.uint8)
        return super().state_dict() | {"search": search}

    def load_state(self, state: Any) -> None:
        super().load_state(state)
        self.scheduler, self.ends = pickle.loads(state["search"].tobytes())  # your own run's


nq.register_population("map-elites", MapElitesConfig, MapElites)


if __name__ == "__main__":
    nq.train("maze", arm="rtneat", population="map-elites", ticks=70_000)
