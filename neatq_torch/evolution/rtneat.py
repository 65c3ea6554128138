"""rtNEAT: one robot is replaced at a time while the others go on living.

Stanley, Bryant & Miikkulainen 2005, in the form that OpenNERO's source code gives it.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from functools import lru_cache
from math import floor
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from neatq_torch.evolution.parsimony import front_ranks
from neatq_torch.evolution.population import Data, LayeredFounders, Population, Replacement
from neatq_torch.evolution.reproduction import (
    OPENNERO,
    ReproductionConfig,
    choose_breeders,
    choose_parents,
)
from neatq_torch.evolution.species import Speciation, Species, SpeciesConfig
from neatq_torch.evolution.trials import (
    BestStretches,
    TrialAverage,
    Trials,
    TrialWeight,
    relative_fitness,
    weighted,
)
from neatq_torch.genome import Genome
from neatq_torch.kinds import ConfigError, check_fields

PREFERRED_SHARE = 0.5
"""Of all offspring, those of robots that somebody has marked as good ones."""
_MARKS = ("protected", "preferred")


@dataclass(frozen=True, kw_only=True)
class RtNEATConfig:
    """One genome is replaced at a time, the others live on; the defaults are those of OpenNERO.

    Attributes:
        reproduction: how offspring come about.
        species: how genomes are sorted into species.
        minimum_life_ticks: age of a genome, over all lives of its robot, at which it can be judged;
            also the length of a trial.
        minimum_life_episodes: episodes after which a genome can be judged, instead of ticks; also
            the length of a trial. None for ticks.
        trial_average: what a genome is judged by after more than one trial; "recent": half of the
            old average plus half of the new trial. None: OpenNERO's, likewise from s1 + s2/2 on,
            one and a half times a trial, so that where rewards are negative whoever has lived
            through two trials seems to be worse than all others. Episodes: always "recent".
        trial_weight: of rewards within a trial; "growing": from 0 to twice the average, so that
            lives are judged by where they lead: who has found a way late is not below who never
            leaves. None: all weigh the same, as always in episodes.
        ineligible_fraction: share of the population that is too young to be judged, in (0, 1].
        survival_share: share of those who can be judged, the fittest, who may breed, all of them as
            often, in (0, 1]; a mate is of the same species. (That of `NEATConfig` is a share of
            each species.) None: all may, by fitness, as in OpenNERO.
        pioneer_share: share of births, in [0, 1], that are a pioneer's while there is one: the
            robot with the best hundred ticks in its last trial (`BestStretches`), whatever all of
            it was worth, if those of the fittest are worse by more than a standard deviation.
            Nobody replaces it; its offspring are mutants. So a way that was found once is kept
            until somebody walks it well. None: no pioneers.
        founders: what the first genomes look like; None: no hidden nodes.
        parsimony: the champion is the smallest network whose average return is within this share of
            the best one, in [0, 1), and who lives and breeds is decided by return and size; see
            `NEATConfig`. None: size does not matter.

    Example:
        >>> config = RtNEATConfig(minimum_life_ticks=500)
    """

    reproduction: ReproductionConfig = OPENNERO
    species: SpeciesConfig = field(default_factory=SpeciesConfig)
    minimum_life_ticks: int = 1000
    minimum_life_episodes: int | None = None
    trial_average: TrialAverage | None = None
    trial_weight: TrialWeight | None = None
    ineligible_fraction: float = 0.5
    survival_share: float | None = None
    pioneer_share: float | None = None
    founders: LayeredFounders | None = None
    parsimony: float | None = None

    def __post_init__(self) -> None:
        check_fields(self, minimum_life_ticks="[1, inf]", minimum_life_episodes="[1, inf]")
        check_fields(self, ineligible_fraction="(0, 1]", survival_share="(0, 1]")
        check_fields(self, parsimony="[0, 1)", pioneer_share="[0, 1]")
        check_fields(self, trial_average=TrialAverage, trial_weight=TrialWeight)
        if self.pioneer_share is not None and self.survival_share is None:
            raise ConfigError(
                "pioneer_share: expected None without a survival_share, as pioneers breed beside "
                "the fittest; set both"
            )


def interval_ticks(life_ticks: int, slots: int, ineligible_fraction: float) -> float:
    """Ticks between two replacements, below 1 if several fall on one tick: the law of eligibility.

    A share I of the population P is too young to be judged if every n = m / (|P| I) ticks one robot
    is replaced and each is judged at the age of m ticks (Stanley, Bryant & Miikkulainen 2005).
    """
    return float(life_ticks / (slots * _exact(ineligible_fraction)))


def replacements_until(lives: Fraction | int, ineligible_fraction: float) -> int:
    """Replacements that lives, and exact parts of them, make room for: one for every 1 / I of them.

    Said so, the law holds for lives that end with an episode, too, however many ticks each has.
    """
    return floor(lives * _exact(ineligible_fraction))


@lru_cache
def _exact(fraction: float) -> Fraction:
    # In floating point 0.3 is a little less than 3/10: now and then one would be replaced too late.
    return Fraction(fraction).limit_denominator(1_000_000)


class RtNEAT(Population):
    """A population of which members are replaced one by one; see `Population`.

    Attributes:
        tick: ticks recorded so far.
        speciation: species and their threshold.
        trials: ages and rewards.
        stretches: what the best parts of trials were worth; None without pioneers.
        birth_order: int64 [slots], the oldest first.
        settled: replacements that are no longer due.
        pioneering: genome ids of the offspring that pioneers had in the last `advance`.
        protected: genome ids of those whom nobody replaces, until somebody takes them out.
        preferred: genome ids of those who have `PREFERRED_SHARE` of all offspring while they live.

    Example:
        >>> rng = np.random.default_rng(0)
        >>> population = RtNEAT.start(RtNEATConfig(), slots=50, inputs=12, outputs=2, rng=rng)
        >>> population.record(np.ones((50, 40, 1)))  # [slots, ticks, dimensions]
        >>> replacements = population.advance()
    """

    config: RtNEATConfig
    least = 2
    kept = (*Population.kept, "speciation", "trials", "tick", "birth_order", "settled")

    def begin(self) -> None:
        """See `Population`."""
        config, slots, dimensions = self.config, len(self.genomes), self.reward_weights.size
        lives = config.minimum_life_ticks, config.minimum_life_episodes
        judged: dict[str, Any] = {"average": config.trial_average, "weight": config.trial_weight}
        self.tick, self.trials = 0, Trials(slots, dimensions, *lives, **judged)
        self.pioneering, self.protected, self.preferred = set[int](), set[int](), set[int]()
        self.stretches = None if config.pioneer_share is None else BestStretches(slots)
        if self.stretches is not None:
            self.kept = (*self.kept, "stretches")
        self.speciation = Speciation(config.species, config.reproduction.distance)
        for slot in range(slots):
            self.speciation.add(slot, self.genomes)
        # Who came first: the older one goes first where the rules leave the order open.
        self.birth_order = np.arange(slots)
        # The first life of all replaces nobody.
        self.settled = replacements_until(slots, config.ineligible_fraction)

    def state_dict(self) -> dict[str, Any]:
        """See `Population`."""
        marks = {name: sorted(getattr(self, name)) for name in _MARKS}
        return super().state_dict() | marks

    def load_state(self, state: Mapping[str, Any]) -> None:
        """See `Population`; what was saved before there were marks has none."""
        super().load_state(state)
        for name in _MARKS:
            setattr(self, name, set(map(int, state.get(name, ()))))

    @property
    def age_ticks(self) -> NDArray[np.int64]:
        """Int64 [slots], ticks since the genome of each slot was born."""
        return self.trials.age_ticks

    @property
    def eligible(self) -> NDArray[np.bool_]:
        """See `Population`."""
        return self.trials.closed > 0

    @property
    def fitness(self) -> NDArray[np.float64]:
        """Float64 [slots] >= 0; the worst eligible robot and all ineligible ones have 0."""
        return relative_fitness(self.trials.averages, self.eligible, self.reward_weights)

    @property
    def mean_returns(self) -> NDArray[np.float64]:
        """See `Population`; averaged as for the fitness."""
        return weighted(self.trials.averages, self.reward_weights)

    @property
    def returns(self) -> NDArray[np.float64]:
        """See `Population`; that of an episode where a trial has episodes, else of a trial."""
        latest = weighted(self.trials.latest, self.reward_weights)
        return np.where(self.eligible, latest, np.nan)

    @property
    def generations(self) -> int:
        """See `Population`; a life is a closed trial."""
        return self.trials.total // len(self.genomes)

    @property
    def score(self) -> NDArray[np.float64]:
        """Float64 [slots] >= 0, by which robots live and breed: with parsimony `front_ranks`."""
        return self.fitness if self.config.parsimony is None else self.ranked(front_ranks)

    @property
    def species(self) -> list[Species]:
        """See `Population`."""
        return self.speciation.species

    def record(self, rewards: ArrayLike, done: Data = None, *, behaviour: Data = None) -> None:
        """See `Population`; `done` matters to trials of episodes, `behaviour` to nothing."""
        running = self.trials.running.copy()
        closing = self.trials.record(rewards, done)
        if self.stretches is not None:
            earned = weighted(np.asarray(rewards, np.float64), self.reward_weights)
            self.stretches.record(earned, running, closing)
        self.tick += closing.shape[1]

    def due(self) -> int:
        """Replacements that are due since the last call of `advance`.

        One for every 1 / `ineligible_fraction` lives beyond the first life of all: closed trials
        where these are made of episodes, else shares of `minimum_life_ticks`.
        """
        lives = Fraction(self.tick * len(self.genomes), self.config.minimum_life_ticks)
        if self.config.minimum_life_episodes is not None:
            lives = self.trials.total
        return max(0, replacements_until(lives, self.config.ineligible_fraction) - self.settled)

    def tell(self, rewards: ArrayLike, done: ArrayLike | None = None) -> list[Replacement]:
        """`record` and `advance` in one, for a loop of one's own."""
        self.record(rewards, done)
        return self.advance()

    def advance(self) -> list[Replacement]:
        """See `Population`.

        Each time the eligible robot with the lowest score / species size makes room for one
        offspring of age 0. Where nobody is eligible nothing happens and nothing stays due.
        """
        due = self.due()
        self.settled += due
        self.pioneering.clear()
        replacements: list[Replacement] = []
        while len(replacements) < due and self._replaceable.any():
            replacements.append(self.replace())
        return replacements

    @property
    def _replaceable(self) -> NDArray[np.bool_]:
        return self.eligible & ~self.slots_of(self.protected)

    def slots_of(self, genome_ids: Collection[int]) -> NDArray[np.bool_]:
        """Bool [slots], in which of them genomes of these ids live."""
        if not genome_ids:
            return np.zeros(len(self.genomes), bool)
        return np.array([genome.genome_id in genome_ids for genome in self.genomes])

    def replace(self, slot: int | None = None, parents: tuple[int, ...] = ()) -> Replacement:
        """Let an offspring take a slot, whether one is due or not; `advance` does it when it is.

        Args:
            slot: which; None: that of the worst who can be judged, of all while nobody can, but
                of nobody who is protected: somebody must not be.
            parents: slots of one or two; none: they are chosen as always.
        """
        score, eligible = self.score, self.eligible
        if not eligible.any():  # somebody asks before anybody was judged
            eligible = np.ones_like(eligible)
        breeders = self._breeders(score, eligible)
        pioneer = self._pioneer(self.eligible, breeders)
        if slot is None:
            slot = self._worst(score, eligible, pioneer)
        removed = self.genomes[slot].genome_id
        self.speciation.remove(slot)
        mother = None if parents else self._mother(slot, pioneer)
        if mother is not None:
            parents = (mother,)
        interspecies = False
        if not parents:
            parents, interspecies = self._parents(score, eligible, breeders[breeders != slot])
        genome, ids = self.breed(parents, score, interspecies=interspecies)
        if mother is not None and mother == pioneer:
            self.pioneering.add(genome.genome_id)
        self._settle(slot, genome)
        return Replacement(slot, genome, removed, ids)

    def adopt(self, genome: Genome, slot: int | None = None) -> Replacement:
        """Let a genome that was bred before, here or elsewhere, take a slot, by a new number.

        It counts as the child of whoever it replaces.

        Args:
            genome: has the inputs and outputs of this population, and no number of a gene that
                means another one here; see `InnovationLedger.number_apart`.
            slot: which; None: as of `replace`.
        """
        if slot is None:
            slot = self._worst(self.score, self.eligible, self.pioneer)
        removed = self.genomes[slot].genome_id
        self.speciation.remove(slot)
        genome = genome.replaced(genome_id=self.next_genome_id)
        self.next_genome_id += 1
        self._settle(slot, genome)
        return Replacement(slot, genome, removed, (removed,))

    def _settle(self, slot: int, genome: Genome) -> None:
        """Put a genome of age 0 into a slot that is in no species."""
        for marks in (self.protected, self.preferred):
            marks.discard(self.genomes[slot].genome_id)
        self.genomes[slot] = genome
        self.trials.reset(slot)
        if self.stretches is not None:
            self.stretches.reset(slot)
        order = self.birth_order
        order[:-1], order[-1] = order[order != slot], slot
        self.speciation.add(slot, self.genomes)
        self.speciation.count_offspring(self.genomes, self.birth_order)

    def _worst(
        self, score: NDArray[np.float64], eligible: NDArray[np.bool_], pioneer: int | None
    ) -> int:
        """The slot that makes room: of those nobody protects, of equal ones the oldest."""
        free = ~self.slots_of(self.protected)
        room = eligible & free if (eligible & free).any() else free
        adjusted = score / self.speciation.sizes(len(self.genomes))
        if pioneer is not None:
            adjusted[pioneer] = np.inf
        oldest_first = self.birth_order[room[self.birth_order]]
        return int(oldest_first[adjusted[oldest_first].argmin()])

    def _mother(self, slot: int, pioneer: int | None) -> int | None:
        """Who has the next offspring alone, a preferred one or the pioneer; None: the others do."""
        preferred = np.flatnonzero(self.slots_of(self.preferred))
        preferred = preferred[preferred != slot]
        if len(preferred) and self.rng.random() < PREFERRED_SHARE:
            return int(self.rng.choice(preferred))
        share = self.config.pioneer_share or 0
        return None if pioneer in (None, slot) or self.rng.random() >= share else pioneer

    @property
    def pioneer(self) -> int | None:
        """Slot of the pioneer, see `RtNEATConfig.pioneer_share`; None while there is none."""
        return self._pioneer(self.eligible, self._breeders(self.score, self.eligible))

    def _pioneer(self, eligible: NDArray[np.bool_], breeders: NDArray[np.intp]) -> int | None:
        judged = np.flatnonzero(eligible)
        if self.stretches is None or not breeders.size:
            return None
        best = self.stretches.latest
        if not np.isfinite(best[judged]).all():
            return None
        first = int(judged[best[judged].argmax()])
        return first if best[first] - best[breeders].max() > best[judged].std() else None

    def _breeders(
        self, score: NDArray[np.float64], eligible: NDArray[np.bool_]
    ) -> NDArray[np.intp]:
        """Slots of the share that breeds, the fittest first; none where all may."""
        share = self.config.survival_share
        if share is None:
            return np.empty(0, np.intp)
        judged = np.flatnonzero(eligible)
        best_first = judged[np.argsort(-score[judged], kind="stable")]
        return best_first[: max(1, floor(share * judged.size))]

    def _parents(
        self,
        score: NDArray[np.float64],
        eligible: NDArray[np.bool_],
        breeders: NDArray[np.intp],
    ) -> tuple[tuple[int, ...], bool]:
        """See `choose_breeders`, and `choose_parents` where there are none."""
        means = self.config.reproduction, self.rng
        if breeders.size:
            return choose_breeders(self.species, score, breeders, *means)
        return choose_parents(self.species, score, eligible, *means)
