"""What a run says of itself: rows of numbers for each arena."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from tensordict import TensorDictBase
from torch import Tensor

from neatq_envs.episodes import EVALUATION, episode_seeds
from neatq_envs.nero.training import MEASURES
from neatq_envs.random_play import ObservationScaling
from neatq_torch.evolution import Population
from neatq_torch.evolution.parsimony import lowest_good
from neatq_torch.genome import Genome
from neatq_trainers.config import RunConfig
from neatq_trainers.nero.held_out import HELD_OUT_ROUNDS, share_of_wins
from neatq_trainers.nero.nero_world import NeroConfig, NeroWorld
from neatq_trainers.nero.teams import present_team
from neatq_trainers.rows import ROW_TICKS, DistanceRow, NeroRow, ReturnRow, Row
from neatq_trainers.run import Champion, Run, State
from neatq_trainers.worlds import ArenaConfig, GymnasiumWorld


def metrics_of(
    config: RunConfig, populations: Sequence[Population], shape: tuple[int, int]
) -> DistanceMetrics | NeroMetrics | ReturnMetrics:
    """What watches a run of (arenas, slots)."""
    if isinstance(config.world, NeroConfig):
        return NeroMetrics(shape[0])
    if isinstance(config.world, ArenaConfig):
        return DistanceMetrics(shape[0])
    return ReturnMetrics(populations, shape)


class RobotMetrics:
    """Of robots that live on; sub-classes sum up what is measured, and say what a row has of it."""

    _kind: type[DistanceRow] | type[NeroRow]

    def __init__(self, arenas: int, columns: int) -> None:
        self.champions: list[Champion | None] = [None] * arenas
        # Of the ticks since the last row: what was measured, summed up, and of how many values.
        self._sums, self._counts = np.zeros((2, arenas, columns))

    def add(self, run: Run, batch: TensorDictBase, error: Tensor) -> list[Row]:
        """See `Metrics`. Half of the error is the row's `td_loss`."""
        if run.config.generational:
            self._remember(run)
        return list(self._rows(run, batch, 0.5 * error.mean(-1).numpy()))

    def _rows(self, run: Run, batch: TensorDictBase, loss: np.ndarray) -> Iterator[Row]:
        some = run.populations or [None] * batch.shape[0]
        following, ticks = batch.get("next"), batch.shape[-1]
        first = run.tick - ticks
        ends = range(ROW_TICKS - first % ROW_TICKS, ticks + 1, ROW_TICKS)
        for start, end in pairwise(sorted({0, *ends, ticks})):
            self._sum(following, slice(start, end), some)
            if end not in ends:
                break
            for arena, population in enumerate(some):
                yield self._kind(
                    arena=arena,
                    tick=first + end,
                    **self._measured(following, end - 1, arena),
                    **_of_genomes(population),
                    td_loss=None if np.isnan(loss[arena]) else float(loss[arena]),
                    epsilon=getattr(run.config.learner, "epsilon", 0.0),
                )
            self._sums[:], self._counts[:] = 0, 0

    def _sum(
        self, following: TensorDictBase, ticks: slice, some: Sequence[Population | None]
    ) -> None:
        """Add what ticks of a batch [arenas, slots, ticks] measure to sums and counts."""
        raise NotImplementedError

    def _measured(self, following: TensorDictBase, last: int, arena: int) -> dict[str, Any]:
        """What the row of an arena says, whose last tick has this index in the batch."""
        raise NotImplementedError

    def _means(self, arena: int) -> list[float | None]:
        pairs = zip(self._sums[arena].tolist(), self._counts[arena].tolist(), strict=True)
        return [total / count if count else None for total, count in pairs]

    def _remember(self, run: Run) -> None:
        """Between generations nobody is the fittest: keep the champion of the one before."""
        for arena, population in enumerate(run.populations):
            if population.due():
                slot = int(np.argmax(population.merit))
                genome, score = run.genome(arena, slot), float(population.fitness[slot])
                self.champions[arena] = Champion(genome, score, population.generations)

    def steps(self, run: Run) -> int:
        """Each tick is a step of every robot."""
        return run.tick * run.shape[1]

    def state_dict(self) -> State:
        """The champions, and what belongs to the next row."""
        sums = {"sums": self._sums.copy(), "counts": self._counts.copy()}
        return {"champions": _saved(self.champions)} | sums

    def load_state_dict(self, state: State) -> None:
        """Go on from `state_dict`."""
        self.champions = _loaded(state["champions"])
        self._sums, self._counts = np.array(state["sums"]), np.array(state["counts"])


class DistanceMetrics(RobotMetrics):
    """In the arena: sums of all robots, those who are judged, newborns and the champion."""

    _kind = DistanceRow

    def __init__(self, arenas: int) -> None:
        super().__init__(arenas, 4)

    def _sum(
        self, following: TensorDictBase, ticks: slice, some: Sequence[Population | None]
    ) -> None:
        distance = following.get("distance")[..., ticks, 0].double().numpy()
        groups = np.stack([_groups(population, distance.shape[1]) for population in some])
        self._sums += (groups * distance.sum(-1)[:, None]).sum(-1)
        self._counts += groups.sum(-1) * distance.shape[-1]

    def _measured(self, following: TensorDictBase, last: int, arena: int) -> dict[str, Any]:
        now = following.get("distance")[arena, :, last, 0].double()
        names = "mean_distance", "eligible_mean_distance", "newborn_mean_distance"
        means = dict(zip((*names, "champion_distance"), self._means(arena), strict=True))
        return {"min_distance": float(now.min()), "max_distance": float(now.max()), **means}


class NeroMetrics(RobotMetrics):
    """On NERO's field: sums of `MEASURES` and deaths."""

    _kind = NeroRow

    def __init__(self, arenas: int) -> None:
        super().__init__(arenas, len(MEASURES) + 1)

    def add(self, run: Run, batch: TensorDictBase, error: Tensor) -> list[Row]:
        """See `Metrics`; now and then arenas fight teams that nobody trains against."""
        rows, world = super().add(run, batch, error), run.world
        if not isinstance(world, NeroWorld) or not world.held_out:
            return rows
        due, scenario = HELD_OUT_ROUNDS * world.config.round_ticks, world.config.scenario
        for number, row in enumerate(rows):
            if isinstance(row, NeroRow) and row.tick % due < ROW_TICKS:
                team = present_team(run, row.arena, f"arena {row.arena}")
                wins = share_of_wins(team, world.held_out, scenario)
                rows[number] = row._replace(held_out_wins=wins)
        return rows

    def _sum(
        self, following: TensorDictBase, ticks: slice, some: Sequence[Population | None]
    ) -> None:
        names = "measures", "terminated"
        parts = [following.get(name)[..., ticks, :].double().numpy() for name in names]
        values = np.concatenate(parts, axis=-1).reshape(len(self.champions), -1, len(MEASURES) + 1)
        self._sums += np.nansum(values, axis=1)
        self._counts += np.isfinite(values).sum(1)

    def _measured(self, following: TensorDictBase, last: int, arena: int) -> dict[str, Any]:
        means = dict(zip((*MEASURES, "deaths"), self._means(arena), strict=True))
        for name in ("hits", "damage", "deaths"):
            means[name] = ROW_TICKS * (means[name] or 0.0)
        return means


def _groups(population: Population | None, slots: int) -> np.ndarray:
    """Who counts for the means of a row, bool [4, slots]."""
    groups = np.zeros((4, slots), dtype=bool)
    groups[0] = True
    if population is not None:
        groups[1], groups[2] = population.eligible, ~population.eligible
        if population.champion is not None:
            groups[3, population.champion] = True
    return groups


def _of_genomes(population: Population | None) -> dict[str, Any]:
    """What evolution adds to a row."""
    if population is None:
        return {"births": 0, "species": 0, "mean_nodes": None, "mean_links": None}
    return {"births": population.births, **_sizes(population)}


def _sizes(population: Population) -> dict[str, Any]:
    genomes = population.genomes
    return {
        "species": len(population.species),
        "mean_nodes": float(np.mean([genome.node_id.size for genome in genomes])),
        "mean_links": float(np.mean([genome.link_enabled.sum() for genome in genomes])),
    }


class ReturnMetrics:
    """In worlds of returns: a row when an arena has lived through one more generation.

    On Gymnasium tasks the fittest are now and then evaluated on held-out episodes, and the champion
    is the one that was evaluated best; elsewhere it is the one with the best life. Where the run
    has its length they are looked at once more, which a longer run knows nothing of. With
    `population.parsimony` it is the smallest within that share of the best of all that were so
    judged (not of the champion, lest these get worse step by step). Made of the population of each
    arena and the shape (arenas, slots).
    """

    _counters = ("_steps", "_episodes", "_error", "_counted", "_generations")

    def __init__(self, populations: Sequence[Population], shape: tuple[int, int]) -> None:
        arenas = shape[0]
        self.champions: list[Champion | None] = [None] * arenas
        self._known = list(self.champions)  # as a longer run has them
        self._steps, self._episodes = np.zeros(arenas, np.int64), np.zeros(arenas, np.int64)
        self._error, self._counted = np.zeros(shape), np.zeros(shape, np.int64)
        self._generations = np.array([population.generations for population in populations])
        self._best = np.full(arenas, -np.inf)
        self._share: float | None = getattr(populations[0].config, "parsimony", None)
        if self._share is not None:
            self._counters = (*self._counters, "_best")

    def add(self, run: Run, batch: TensorDictBase, error: Tensor) -> list[ReturnRow]:
        """See `Metrics`."""
        living = batch.get("living", None)
        ticks = np.full(batch.shape[:2], batch.shape[-1])
        if living is not None:
            ticks = living.squeeze(-1).numpy().sum(-1)
        self._steps += ticks.sum(-1)
        self._episodes += batch.get(("next", "done")).flatten(1).sum(1).numpy()
        self._error += error.double().numpy() * ticks
        self._counted += ticks
        if run.config.generational and not all(one.due() for one in run.populations):
            return []  # an evaluation takes the environments, in which some still live
        unit, length = run.config.length
        over = {"steps": self.steps(run), "generations": run.generation}.get(unit, 0) >= length
        over &= run.config.generational or run.tick % run.config.stride_ticks == 0
        over &= isinstance(run.world, GymnasiumWorld)
        rows: list[ReturnRow] = []
        for arena, population in enumerate(run.populations):
            new = population.generations > self._generations[arena]
            evaluated = self._evaluated(run, arena, over) if new or over else None
            rows += [self._row(run, arena, evaluated)] if new else []
        return rows

    def _row(self, run: Run, arena: int, evaluated: float | None) -> ReturnRow:
        population = run.populations[arena]
        self._generations[arena] = population.generations
        champion = self._known[arena]
        assert champion is not None
        counted, total = self._counted[arena], self._error[arena]
        error = float((total[counted > 0] / counted[counted > 0]).mean())
        self._error[arena], self._counted[arena] = 0, 0
        return ReturnRow(
            arena=arena,
            generation=population.generations,
            episodes=int(self._episodes[arena]),
            steps=int(self._steps[arena]),
            best_fitness=float(np.nanmax(population.returns)),
            mean_fitness=float(np.nanmean(population.returns)),
            evaluated_return=evaluated,
            champion_return=champion.score,
            **_sizes(population),
            td_error=None if np.isnan(error) else error,
        )

    def _evaluated(self, run: Run, arena: int, over: bool) -> float | None:
        """Look for a champion, if it is time or the run is over; what the row of it says."""
        population, world = run.populations[arena], run.world
        now, before = population.generations, self._generations[arena]
        if not isinstance(world, GymnasiumWorld):
            lived = np.flatnonzero(~np.isnan(population.returns)).tolist()
            self._crown(run, arena, lived, population.returns)
            self._known[arena] = self.champions[arena]
            return None
        config, self.champions[arena] = world.config, self._known[arena]
        due = now // config.every != before // config.every or self._known[arena] is None
        due &= now > before
        if not (due or over):
            return None
        order = np.argsort(-population.merit, kind="stable")
        best = order[np.argmax(population.fitness[order])]  # says what is good enough
        fittest = np.append(best, order[order != best])[: config.evaluated]
        genomes = [run.genome(arena, slot) for slot in fittest.tolist()]
        seeds = episode_seeds(run.config.seeds[arena], 0, config.episodes, purpose=EVALUATION)
        starts = np.repeat(seeds[None], len(genomes), axis=0)
        scores = np.full(len(population.genomes), np.nan)
        network = run.config.network
        scores[fittest] = world.returns(
            genomes,
            starts,
            run.heads,
            network.evaluation,
            double_activation=network.double_activation,
            scalings=[self._scaling(run, arena)] * len(genomes),
        ).mean(1)
        best_so_far = self._best[arena]
        self._crown(run, arena, fittest.tolist(), scores)
        if not due:
            self._best[arena] = best_so_far
            return None
        self._known[arena] = self.champions[arena]
        return float(np.nanmax(scores))

    def _crown(self, run: Run, arena: int, slots: list[int], scores: np.ndarray) -> None:
        """The best of some slots is the champion, unless the one before is better."""
        genomes, before = run.populations[arena].genomes, self.champions[arena]
        self._best[arena] = max(self._best[arena], scores[slots].max())
        worth = [self._worth(arena, genomes[slot], float(scores[slot])) for slot in slots]
        best = slots[worth.index(max(worth))]
        if before is None or max(worth) >= self._worth(arena, before.genome, before.score):
            generation, genome = run.populations[arena].generations, run.genome(arena, best)
            own = genome, float(scores[best]), generation, self._scaling(run, arena)
            self.champions[arena] = Champion(*own)

    def _worth(self, arena: int, genome: Genome, score: float) -> tuple[float, ...]:
        """By what champions are compared: their return, and with parsimony, of good ones, size."""
        if self._share is None:
            return (score,)
        good = score >= lowest_good(float(self._best[arena]), self._share)
        return good, -int(genome.link_enabled.sum()), score

    def _scaling(self, run: Run, arena: int) -> ObservationScaling | None:
        """By which networks read the world's observations now; None: by that of the world."""
        own, facts = run.normalization, getattr(run.world, "facts", None)
        if own is None or facts is None:
            return None
        return facts.scaling.then(own.mean[arena].numpy(), own.deviation[arena].numpy())

    def steps(self, run: Run) -> int:
        """Steps so far of the arena that has fewest."""
        return int(self._steps.min())

    def state_dict(self) -> State:
        """Counters and champions."""
        state = {name: getattr(self, name).copy() for name in self._counters}
        state["champions"] = _saved(self._known)
        if any(last is not one for last, one in zip(self.champions, self._known, strict=True)):
            state["last"] = _saved(self.champions)
        return state

    def load_state_dict(self, state: State) -> None:
        """Go on from `state_dict`."""
        self._known = _loaded(state["champions"])
        self.champions = _loaded(state["last"]) if "last" in state else list(self._known)
        for name in self._counters:
            setattr(self, name, np.array(state[name]))


def _saved(champions: Sequence[Champion | None]) -> list[State | None]:
    return [one and _saved_one(one) for one in champions]


def _saved_one(champion: Champion) -> State:
    scaling = champion.scaling and vars(champion.scaling)
    return {**champion._asdict(), "genome": champion.genome.to_dict(), "scaling": scaling}


def _loaded(saved: Sequence[State | None]) -> list[Champion | None]:
    return [one if one is None else _champion(**one) for one in saved]


def _champion(
    genome: State, score: float, generation: int, scaling: State | None = None
) -> Champion:
    own = None if scaling is None else ObservationScaling(**scaling)
    return Champion(Genome.from_dict(genome), score, generation, own)
