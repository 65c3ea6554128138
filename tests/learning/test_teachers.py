"""Who teaches newborns: inherited, drawn anew, and what each of them has to say."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from neatq_torch.evolution import Replacement
from neatq_torch.genome import Genome, initial_genome, layered_genome
from neatq_torch.learning import (
    CandidateHeads,
    CriticConfig,
    CriticLearner,
    Teacher,
    Teachers,
    compiled_critic,
)
from neatq_torch.learning.memory import TransitionMemory
from neatq_torch.learning.novelty import HALF_LIFE_TICKS, ExplorerReward
from neatq_torch.network import PopulationNetwork

HEADS = CandidateHeads(1, [-2.0], [2.0])
CONFIG = CriticConfig(
    width=16, size=32, policy_size=16, warmup=10, capacity=600, teacher_mutation=1e-12, novelty=0.5
)


class Population:
    champion: int | None = 1

    def __init__(self, robots: int = 4) -> None:
        self.pioneering = set[int]()
        rng = np.random.default_rng(0)
        self.genomes: list[Genome] = [
            initial_genome(1, 1, rng=rng, genome_id=number + 1) for number in range(robots)
        ]


class Pupil:
    config = CONFIG
    teachers: Any = None
    models: Any = None


def teachers_of(mutation: float) -> tuple[Teachers, Pupil, Population]:
    learner, population = Pupil(), Population()
    learner.config = replace(CONFIG, teacher_mutation=mutation)
    own = Teachers(cast(Any, learner), cast(Any, [population]), [3])
    return own, learner, population


def test_a_newborn_has_the_teacher_of_its_fitter_parent_even_if_that_was_born_with_it() -> None:
    own, learner, population = teachers_of(1e-12)
    own.values[0] = [Teacher.CRITIC, Teacher.EXPLORER, Teacher.MODEL, Teacher.CRITIC]
    child, grandchild = (population.genomes[0].unchecked(genome_id=one) for one in (5, 6))
    own.inherit(0, [Replacement(0, child, 1, (3, 2)), Replacement(3, grandchild, 4, (5,))])
    assert own.values[0].tolist() == [2, 1, 2, 2]
    assert own.models.tolist() == [1]
    own.express()
    assert learner.teachers.tolist() == [[2, 1, 2, 2]]
    assert learner.models.tolist() == [1]


def test_offspring_of_an_explorers_pupil_imitate() -> None:
    own, _, population = teachers_of(1e-12)
    own.values[0] = [Teacher.CRITIC, Teacher.EXPLORER, Teacher.CRITIC, Teacher.CRITIC]
    child, grandchild = (population.genomes[0].unchecked(genome_id=one) for one in (5, 6))
    own.inherit(0, [Replacement(0, child, 1, (2, 3)), Replacement(3, grandchild, 4, (5,))])
    assert own.values[0].tolist() == [
        Teacher.MODEL,
        Teacher.EXPLORER,
        Teacher.CRITIC,
        Teacher.MODEL,
    ]


def test_offspring_of_a_pioneer_explore_on_but_for_those_whose_teacher_is_drawn() -> None:
    own, _, population = teachers_of(1e-12)
    child, other = (population.genomes[0].unchecked(genome_id=one) for one in (5, 6))
    own.values[0] = [Teacher.CRITIC, Teacher.MODEL, Teacher.CRITIC, Teacher.CRITIC]
    population.pioneering = {5}
    own.inherit(0, [Replacement(0, child, 1, (2,)), Replacement(3, other, 4, (2,))])
    assert own.values[0].tolist() == [Teacher.EXPLORER, Teacher.MODEL, 0, Teacher.MODEL]
    always, _, population = teachers_of(1.0)
    population.pioneering = {5}
    for _ in range(60):
        always.inherit(0, [Replacement(0, child, 1, (2,))])
        own.values[0, 1] += always.values[0, 0] != Teacher.EXPLORER
    assert own.values[0, 1] > Teacher.MODEL + 20


def test_where_nobody_can_be_judged_there_is_no_model() -> None:
    own, learner, population = teachers_of(1e-12)
    population.champion = None
    own.inherit(0, [])
    own.express()
    assert learner.models.tolist() == [-1]


@pytest.mark.parametrize("model", [-1, 2])
def test_a_model_of_which_nothing_is_remembered_leaves_its_pupils_to_the_critic(model: int) -> None:
    weights = []
    for teacher in (Teacher.CRITIC, Teacher.MODEL):
        learner = CriticLearner(networks(), HEADS, replace(CONFIG, newborn_updates=5), [0])
        batch = lived(learner, 0)
        batch["genome_id"][0, 2] = 99
        learner.update(batch)
        learner.teachers[:], learner.models[:] = teacher, model
        learner.reset(torch.ones(1, 3, dtype=torch.bool))
        weights.append(learner.network.weight.detach().clone())
    assert torch.equal(*weights)


def test_newborns_may_be_left_as_they_are() -> None:
    learner = CriticLearner(networks(), HEADS, replace(CONFIG, newborn_updates=0), [0])
    before = learner.network.weight.detach().clone()
    learner.update(lived(learner, 0))
    learner.reset(torch.ones(1, 3, dtype=torch.bool))
    assert torch.equal(learner.network.weight, before)


def test_a_teacher_is_drawn_anew_as_often_as_the_mutation_says_each_as_likely() -> None:
    own, _, population = teachers_of(0.6)
    for number in range(5, 4005):
        child = population.genomes[0].unchecked(genome_id=number)
        own.inherit(0, [Replacement(0, child, number - 1, (2,))])
        own.values[0, 1] = Teacher.CRITIC
        own.values[0, 2] = 0
        own.values[0, 3] += own.values[0, 0] == Teacher.EXPLORER
    assert own.values[0, 3] / 4000 == pytest.approx(0.2, abs=0.03)


def test_teachers_go_on_exactly() -> None:
    one, other = teachers_of(0.5)[0], teachers_of(0.5)[0]
    genome = Population().genomes[0]
    born = [Replacement(0, genome.unchecked(genome_id=9), 1, (2,))]
    for _ in range(5):
        one.inherit(0, born)
    other.load_state_dict(one.state_dict())
    for teachers in (one, other):
        teachers.inherit(0, [Replacement(1, genome.unchecked(genome_id=12), 2, (3,))] * 20)
    assert one.values.tolist() == other.values.tolist()
    assert one.models.tolist() == other.models.tolist()


def places(*positions: list[list[float]], rewards: Any = 0.0) -> TensorDict:
    """What robots went through at these positions, one list of them a robot."""
    pose = torch.tensor([[[*place, 0.0] for place in robot] for robot in positions])
    shape = pose.shape[:2]
    reward = torch.as_tensor(rewards).float().expand(shape).unsqueeze(-1)
    following = TensorDict({"pose": pose, "reward": reward}, shape)
    genome_id = torch.ones(*shape, 1, dtype=torch.long)
    return TensorDict({"genome_id": genome_id, "next": following}, shape)


def test_a_place_is_worth_less_the_more_often_the_team_was_there() -> None:
    reward = ExplorerReward(1.0)
    worth = reward._visit(np.array([[[3.0, 3.0], [3.0, 3.0]], [[24.0, 1.0], [60.0, 1.0]]]))
    keeps = 0.5 ** (1 / HALF_LIFE_TICKS)
    expected = [[3**-0.5, (2 + 2 * keeps) ** -0.5], [3**-0.5, 2**-0.5]]
    np.testing.assert_allclose(worth[..., 0], expected)
    assert reward.visits.shape == (3, 1)
    again = reward._visit(np.array([[[80.0, 30.0]]]))
    np.testing.assert_allclose(again, [[[2**-0.5]]])
    assert reward.visits.shape == (4, 2)
    np.testing.assert_allclose(reward.visits[0, 0], (2 * keeps + 1) * keeps)


def test_both_parts_of_an_explorers_reward_are_measured_by_how_far_they_spread() -> None:
    batch = places([[3.0, 3.0], [90.0, 3.0], [3.0, 3.0]], rewards=[0.0, 4.0, 8.0])
    position = cast(torch.Tensor, batch["next", "pose"])[..., :2].numpy()
    novelty = ExplorerReward(1.0)._visit(position)[0, :, 0]
    expected = 0.25 * novelty / novelty.std() + 0.75 * np.array([0, 4, 8]) / np.std([0, 4, 8])
    np.testing.assert_allclose(ExplorerReward(0.25).of(batch)[0, :, 0], expected, rtol=1e-6)


def test_explorers_rewards_go_on_exactly() -> None:
    one, other = ExplorerReward(0.5), ExplorerReward(0.5)
    one.of(places([[3.0, 3.0], [90.0, 3.0]], rewards=[0.2, 0.9]))
    other.load_state_dict(one.state_dict())
    batch = places([[30.0, 3.0], [90.0, 93.0]], rewards=[0.1, 0.5])
    assert one.of(batch).tolist() == other.of(batch).tolist()


def test_what_a_genome_did_is_drawn_alone_and_the_same_after_a_restart() -> None:
    memory = TransitionMemory(50, owners=True)
    shape = (70,)
    owner = torch.arange(70).remainder(7).unsqueeze(-1)
    zeros = torch.zeros(70, 1)
    following = {"observation": zeros, "reward": zeros, "terminated": zeros.bool()}
    now = {"observation": torch.arange(70.0).unsqueeze(-1), "action": zeros, "genome_id": owner}
    memory.extend(TensorDict(now | {"next": TensorDict(following, shape)}, shape))
    drawn = memory.draw(200, torch.Generator().manual_seed(0), "observation", owner=3)
    assert sorted(set(drawn["observation"].flatten().tolist())) == [24, 31, 38, 45, 52, 59, 66]
    again = TransitionMemory(50, owners=True)
    again.load_state_dict(memory.state_dict())
    same = again.draw(200, torch.Generator().manual_seed(0), "observation", owner=3)
    assert torch.equal(drawn["observation"], same["observation"])
    with pytest.raises(ValueError, match="got none"):
        memory.draw(1, torch.Generator(), owner=8)


def networks(arenas: int = 1) -> PopulationNetwork:
    rng = np.random.default_rng(0)
    genomes = [
        layered_genome(2, 1, hidden=3, rng=rng, activation="steep_sigmoid", genome_id=number + 1)
        for number in range(3 * arenas)
    ]
    return PopulationNetwork(genomes, shape=(arenas, 3))


def lived(learner: CriticLearner, seed: int) -> TensorDict:
    """Twenty ticks, in which the second genome always does -1.5 and the others whatever."""
    shape, rng = (*learner.network.shape, 20), torch.Generator().manual_seed(seed)
    action = torch.rand(*shape, 1, generator=rng) * 4 - 2
    action[:, 1] = -1.5
    never = torch.zeros(*shape, 1, dtype=torch.bool)
    following = {
        "observation": torch.rand(*shape, 2, generator=rng),
        "reward": 0.5 + action / 4,  # the higher the better
        "pose": torch.rand(*shape, 3, generator=rng) * 100,
        "done": never,
        "terminated": never.clone(),
    }
    now = {
        "observation": torch.rand(*shape, 2, generator=rng),
        "action": action,
        "genome_id": learner.network.genome_id[..., None, None].expand(*shape, 1).clone(),
    }
    return TensorDict(now | {"next": TensorDict(following, shape)}, shape)


def acts(learner: CriticLearner, slot: int) -> float:
    """What a network does on average."""
    seen = torch.rand(64, 2, generator=torch.Generator().manual_seed(5))
    with torch.no_grad():
        outputs = learner.network.step(seen.expand(*learner.network.shape, -1, -1))[0]
    return float(HEADS.best(outputs)[0, slot].mean())


@pytest.mark.parametrize("compiled", [True, False])
def test_pupils_do_what_their_teacher_says(monkeypatch: Any, compiled: bool) -> None:
    if not compiled:
        monkeypatch.setattr(compiled_critic, "accepts", lambda *_: False)
    updates = 300
    learner = CriticLearner(networks(), HEADS, replace(CONFIG, newborn_updates=updates), [0])
    for seed in range(30):
        learner.update(lived(learner, seed))
    learner.teachers[0] = [Teacher.CRITIC, Teacher.EXPLORER, Teacher.MODEL]
    learner.models[0] = 1
    before = acts(learner, 2)
    learner.reset(torch.tensor([[True, False, True]]))
    assert acts(learner, 0) > 1.5
    assert abs(acts(learner, 2) - acts(learner, 1)) < 0.1 < abs(before - acts(learner, 1)) / 2


def test_compiled_code_imitates_as_torch_does(monkeypatch: Any) -> None:
    weights = []
    for compiled in (True, False):
        learner = CriticLearner(networks(), HEADS, replace(CONFIG, newborn_updates=5), [0])
        learner.update(lived(learner, 0))
        learner.teachers[0], learner.models[0] = [2, 1, 0], 1
        with monkeypatch.context() as patch:
            if not compiled:
                patch.setattr(compiled_critic, "accepts", lambda *_: False)
            learner.reset(torch.ones(1, 3, dtype=torch.bool))
        weights.append(learner.network.weight.detach().clone())
    torch.testing.assert_close(*weights, rtol=2e-3, atol=2e-5)


def test_an_explorers_critic_learns_its_own_rewards_from_the_shared_memory() -> None:
    learner = CriticLearner(networks(), HEADS, replace(CONFIG, horizon=1), [0])
    learner.update(lived(learner, 0))
    memory = learner.critics[0].memory
    assert learner.explorers[0].memory is memory
    assert learner.explorers[0].steps == learner.critics[0].steps > 0
    told = memory.state_dict()["next_reward"]
    batch = lived(learner, 0)
    expected = torch.cat([batch["next", "reward"][0], ExplorerReward(0.5).of(batch[0])], -1)
    torch.testing.assert_close(told, expected.flatten(0, 1))


def test_a_learner_with_teachers_goes_on_exactly() -> None:
    one, other = (CriticLearner(networks(), HEADS, CONFIG, [0]) for _ in range(2))
    for seed in range(3):
        one.update(lived(one, seed))
    other.load_state_dict(one.state_dict())
    other.network.load_weights(one.network.weight)
    for learner in (one, other):
        learner.teachers[0], learner.models[0] = [0, 1, 2], 1
        learner.update(lived(learner, 9))
        learner.reset(torch.ones(1, 3, dtype=torch.bool))
    assert torch.equal(one.network.weight, other.network.weight)


def test_an_arena_is_taught_the_same_whatever_stands_beside_it() -> None:
    alone = CriticLearner(networks(), HEADS, CONFIG, [0])
    both = CriticLearner(networks(2), HEADS, CONFIG, [0, 7])
    first = lived(both, 0)
    alone.update(first[:1].clone())
    both.update(first)
    for learner in (alone, both):
        learner.teachers[:], learner.models[:] = [0, 1, 2], 1
        learner.reset(torch.ones(*learner.network.shape, dtype=torch.bool))
    for slot in range(3):
        assert alone.network.genome(slot).to_dict() == both.network.genome(slot).to_dict()


def test_without_novelty_there_are_no_explorers() -> None:
    learner, population = Pupil(), Population()
    learner.config = replace(CONFIG, teacher_mutation=1.0, novelty=None)
    own = Teachers(cast(Any, learner), cast(Any, [population]), [3])
    drawn = set()
    for number in range(5, 55):
        child = population.genomes[0].unchecked(genome_id=number)
        own.inherit(0, [Replacement(0, child, number - 1, (2,))])
        drawn.add(int(own.values[0, 0]))
    assert drawn == {Teacher.CRITIC, Teacher.MODEL}
    assert CriticLearner(networks(), HEADS, learner.config, [0]).explorers == []
