"""What newborns learn from the generation before them, and what wire fitting learns in a life."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest
import torch

from neatq_torch.genome import Genome, identical, pack_genomes
from neatq_torch.learning import CandidateHeads, wire_fit
from neatq_torch.network import GenomeNetwork
from neatq_trainers.generational.config import GenerationalConfig, PretrainingConfig
from neatq_trainers.generational.lives import LifeWorker, Lives, Outcome
from neatq_trainers.generational.loop import train_generation
from neatq_trainers.generational.recording import Lessons, Transitions
from neatq_trainers.generational.run import Run, begin_run
from neatq_trainers.generational.scout import scout
from neatq_trainers.generational.team import Team, open_team

Tiny = Callable[..., GenerationalConfig]
PRETRAINING = PretrainingConfig(steps=200, batch=16, learning_rate=0.03, transitions=80)


def run_of(config: GenerationalConfig) -> Run:
    surroundings = scout(config.environment, config.learning.step.discount)
    return begin_run(config, surroundings, LifeWorker(config, surroundings).interface)


def idle(config: GenerationalConfig, **learning: object) -> GenerationalConfig:
    """Without learning during life."""
    step = replace(config.learning.step, learning_rate=0.0)
    return replace(config, learning=replace(config.learning, step=step, **learning))  # type: ignore[arg-type]


def live(run: Run, lessons: Lessons | None) -> Outcome:
    """One episode of every genome."""
    genomes = run.populations[0].genomes
    chance = np.arange(len(genomes))
    lives = Lives(pack_genomes(genomes), np.zeros((len(genomes), 1), np.int64), chance, lessons)
    return LifeWorker(run.config, run.surroundings).live(lives)


def lessons_of(memory: Transitions, lives: int) -> Lessons:
    return Lessons([memory], np.array([3]), np.zeros(lives, np.int64))


def test_a_generation_leaves_the_same_share_of_every_life(tiny: Tiny) -> None:
    """In the walk x' - x = 0.2 a; observations are scaled by some factor."""
    run = run_of(tiny("neatq", pretraining=PRETRAINING))
    with open_team(run.config, run.surroundings, 1) as team:
        (row,) = train_generation(run, team)
        assert row.steps > 80
    (memory,) = run.memories
    assert {len(rows) for rows in memory.values()} == {80}
    moved = (memory["next_observation"] - memory["observation"])[:, 0]
    factor = moved @ memory["action"][:, 0] / (memory["action"] ** 2).sum()
    np.testing.assert_allclose(moved, factor * memory["action"][:, 0], atol=1e-5)


def test_only_what_pretrains_remembers(tiny: Tiny) -> None:
    run = run_of(tiny("neatq"))
    with open_team(run.config, run.surroundings, 1) as team:
        train_generation(run, team)
    assert run.memories == []
    assert run.state()["memories"] == []


def errors(genomes: Sequence[Genome], memory: Transitions, low: float, high: float) -> np.ndarray:
    """Mean squared TD error of each genome on all transitions, discount 0.99, by hand."""
    found = []
    for genome in genomes:
        network = GenomeNetwork(genome)
        now, following = (
            low + (high - low) * network(torch.from_numpy(memory[name])).detach().numpy()
            for name in ("observation", "next_observation")
        )
        taken = np.take_along_axis(now, memory["action"].astype(int), 1)
        best = np.where(memory["next_terminated"], 0, following.max(1, keepdims=True))
        found.append(np.mean((memory["next_reward"] + 0.99 * best - taken) ** 2))
    return np.array(found)


@pytest.mark.parametrize("value_range", [(-1.0, 6.0), (-100.0, 600.0)])
def test_newborns_have_learnt_from_the_generation_before(
    tiny: Tiny, value_range: tuple[float, float]
) -> None:
    arguments = ("steps=2", "max_episode_steps=9")  # worth 1.99, then 1
    config = tiny("neatq", "Ends-v0", env_kwargs=arguments, pretraining=PRETRAINING)
    run = run_of(idle(config, value_range=value_range))
    with open_team(run.config, run.surroundings, 1) as team:
        train_generation(run, team)
    born = run.populations[0].genomes
    (memory,) = run.memories
    outcome = live(run, lessons_of(memory, len(born)))
    taught = [one.with_weights(own) for one, own in zip(born, outcome.weights, strict=True)]
    before, after = (errors(genomes, memory, *value_range) for genomes in (born, taught))
    assert after.mean() < 0.2 * before.mean()
    assert (after < before).sum() >= 7


@pytest.mark.parametrize("good", [0, 1])
def test_the_first_step_of_a_life_is_what_others_found_good(tiny: Tiny, good: int) -> None:
    config = tiny("neatq", "Ends-v0", pretraining=PRETRAINING)
    run = run_of(idle(config, value_range=(-1.0, 2.0), epsilon=0.0))
    action = np.arange(80, dtype=np.float32)[:, None] % 2
    observation = np.eye(2, dtype=np.float32)[np.zeros(80, int)]
    memory = {
        "observation": observation,
        "action": action,
        "next_observation": observation,
        "next_reward": (action == good).astype(np.float32),
        "next_terminated": np.ones((80, 1), bool),
    }
    untaught, taught = (
        [int(left["action"][0, 0]) for left in live(run, lessons).transitions]
        for lessons in (None, lessons_of(memory, 8))
    )
    assert set(untaught) == {0, 1}
    assert taught == [good] * 8


@pytest.mark.parametrize("inheritance", ["darwinian", "lamarckian"])
def test_what_was_learnt_from_others_is_inherited_only_by_lamarckian_children(
    tiny: Tiny, inheritance: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = run_of(idle(tiny("pretrained"), inheritance=inheritance))
    population = run.populations[0]
    bred: list[Genome] = []
    with open_team(run.config, run.surroundings, 1) as team:
        train_generation(run, team)
        born = list(population.genomes)
        monkeypatch.setattr(population, "advance", lambda _: bred.extend(population.genomes))
        train_generation(run, team)
    same = [identical(one, two) for one, two in zip(born, bred, strict=True)]
    assert all(same) if inheritance == "darwinian" else not any(same)


def test_minibatches_are_others_in_every_generation_and_arena(
    tiny: Tiny, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = run_of(tiny("pretrained", arenas=2))
    given: list[Lessons | None] = []
    act = Team.live

    def listen(self: Team, *arguments: object) -> Outcome:
        if len(arguments) == 4:
            given.append(arguments[3])  # type: ignore[arg-type]
        return act(self, *arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(Team, "live", listen)
    with open_team(run.config, run.surroundings, 1) as team:
        for _ in range(3):
            train_generation(run, team)
    first, second, third = given
    assert first is None
    assert second is not None
    assert third is not None
    assert len({*second.seeds.tolist(), *third.seeds.tolist()}) == 4
    assert third.memory_of.tolist() == [0] * 8 + [1] * 8
    assert not np.array_equal(third.memories[0]["action"], third.memories[1]["action"])


def values(genome: Genome, heads: CandidateHeads, place: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Candidates in spans of 4 and values, of an observation in one of two places."""
    candidates, values = heads(GenomeNetwork(genome)(torch.eye(2)[place]))
    return candidates.detach() / 4, values.detach()


@pytest.mark.parametrize(("by", "weight_of_next"), [("terminated", 0.0), ("truncated", 0.99)])
def test_wire_fitting_learns_the_value_between_the_candidates(
    tiny: Tiny, by: str, weight_of_next: float
) -> None:
    """One step of reward 1: delta = 1 + w max Q(1) - Q(0, a), Q(0, a) as the wires have it."""
    config = tiny("wires", "EndsInBox-v0", env_kwargs=(f"by={by}", "max_episode_steps=9"))
    learning = replace(config.learning, epsilon=0.0, value_range=(-3.0, 5.0))
    run = run_of(replace(config, learning=learning))
    outcome = live(run, None)
    heads = CandidateHeads(5, [-1.0], [3.0], value_range=(-3.0, 5.0))
    for genome, error in zip(run.populations[0].genomes, outcome.td_error, strict=True):
        wires, now = values(genome, heads, 0)
        before = wire_fit(wires[now.argmax()], wires, now, 0.1 / 8, 1e-4).item()
        after = values(genome, heads, 1)[1].max().item()
        assert error == pytest.approx((1 + weight_of_next * after - before) ** 2, rel=1e-4)


def test_wire_fitting_moves_the_candidates_as_well(tiny: Tiny) -> None:
    moved = {}
    for variant in ("neatq", "wires"):
        run = run_of(tiny(variant, "EndsInBox-v0"))
        genomes, learnt = run.populations[0].genomes, live(run, None).weights
        changed = [
            np.flatnonzero(np.isin(one.link_target, one.output_ids[:5]) & (one.link_weight != own))
            for one, own in zip(genomes, learnt, strict=True)
        ]
        moved[variant] = sum(len(links) > 0 for links in changed)
    assert moved["neatq"] == 0
    assert moved["wires"] == 8


def test_a_step_of_wire_fitting_is_the_same_at_any_range_of_values(tiny: Tiny) -> None:
    """With discount 0 the error of outputs is (1 - low) / span - q: 1 - q for these ranges."""
    learnt = []
    for value_range in ((0.0, 1.0), (-3.0, 1.0), (-99.0, 1.0)):
        config = tiny("wires", "EndsInBox-v0")
        step = replace(config.learning.step, discount=0.0)
        learning = replace(config.learning, step=step, epsilon=0.0, value_range=value_range)
        run = run_of(replace(config, learning=learning))
        learnt.append(np.concatenate(live(run, None).weights))
    born = np.concatenate([one.link_weight for one in run.populations[0].genomes])
    for other in learnt[1:]:
        np.testing.assert_allclose(other - born, learnt[0] - born, atol=1e-5)
    assert np.abs(learnt[0] - born).max() > 1e-3
