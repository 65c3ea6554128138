"""The scripts to copy run, and do what they say."""

from __future__ import annotations

import ast
import sys
from functools import cache
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torchrl.envs.utils import check_env_specs

import neatq_torch as nq
from neatq_envs import TASKS, ArenaEnv
from neatq_torch.evolution import population_kinds
from neatq_torch.learning import LearnerParts, learner_kinds
from neatq_trainers.config import RunConfig

pytestmark = pytest.mark.usefixtures("without_pictures")
EXAMPLES = Path(__file__).resolve().parents[1] / "examples"


@cache  # a name can be registered for one thing only
def example(name: str) -> dict[str, Any]:
    """What a script defines, without what it does when it is called."""
    spec = spec_from_file_location(f"examples_{name}", EXAMPLES / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = sys.modules[spec.name] = module_from_spec(spec)
    spec.loader.exec_module(module)
    return vars(module)


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.py")), ids=lambda path: path.stem)
def test_a_script_fits_on_a_page(path: Path) -> None:
    lines = [line for line in path.read_text(encoding="utf-8").splitlines() if line.strip()]
    assert 15 <= len(lines) <= 60


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.py")), ids=lambda path: path.stem)
def test_a_script_imports_the_public_face_alone(path: Path) -> None:
    nodes = list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
    modules = [one.module or "" for one in nodes if isinstance(one, ast.ImportFrom)]
    modules += [name.name for one in nodes if isinstance(one, ast.Import) for name in one.names]
    ours = {name for name in modules if name.startswith("neatq")}
    assert ours <= {"neatq_torch", "neatq_envs"}


def test_the_minimal_script_runs_to_its_first_births(capsys: pytest.CaptureFixture[str]) -> None:
    distance = example("minimal")["main"](ticks=1200)
    # Standing at the spawn is 267 away; the wall stops those who run straight at 139.
    assert 139 < distance < 300
    assert "tick   1000  mean distance" in capsys.readouterr().out


@pytest.mark.slow
def test_ppo_brings_the_team_to_the_flag(capsys: pytest.CaptureFixture[str]) -> None:
    ppo = example("ppo")
    torch.manual_seed(3)
    env = ArenaEnv(TASKS["flag"], seed=3)
    with torch.no_grad():
        life = env.rollout(1000, ppo["networks"](env)[0], break_when_any_done=False)
    untrained = life["next", "distance"].mean().item()
    assert untrained > 120  # standing at the spawn is 141 away
    ppo["main"](steps=2000, seed=3)
    lives = [float(line.split()[4]) for line in capsys.readouterr().out.splitlines()]
    assert len(lives) == 2
    assert lives[1] < 60 < untrained / 2


def test_ppo_does_the_same_again_with_the_same_seed() -> None:
    main = example("ppo")["main"]
    assert main(steps=200, seed=1) == main(steps=200, seed=1) != main(steps=200, seed=2)


def live(population: Any, lives: int) -> None:
    """Lives of four ticks that end where the first two weights say; near zero is best."""
    for _ in range(4 * lives):
        weights = np.array([genome.link_weight[:2] for genome in population.genomes])
        done = np.full((len(weights), 1), population.ticks % 4 == 3)
        where = (200 * weights + 400).clip(0, 799)[:, None]
        population.record(-np.abs(weights).sum(1)[:, None, None], done, behaviour=where)
        population.ticks += 1
        assert len(population.advance()) in (0, len(weights))


def test_map_elites_improves_fills_its_archive_and_goes_on_exactly() -> None:
    script = example("map_elites")
    config = script["MapElitesConfig"](start_hidden=3)
    one = script["MapElites"].start(config, slots=11, inputs=4, outputs=2, rng=1)
    one.ticks = 0
    live(one, 20)
    stats = one.scheduler.archive.stats
    assert one.births == 20 * 11 and one.generations == 20
    assert stats.num_elites > 60 and stats.obj_max > -1
    other = script["MapElites"].from_state(config, one.state_dict())
    other.ticks = one.ticks
    live(one, 2)
    live(other, 2)
    for mine, theirs in zip(one.genomes, other.genomes, strict=True):
        assert mine.genome_id == theirs.genome_id
        assert np.array_equal(mine.link_weight, theirs.link_weight)


SMALL = {"robots": 9, "lifetime_ticks": 40}


def test_map_elites_is_a_population_that_the_trainer_knows(tmp_path: Path) -> None:
    example("map_elites")
    settings = {"population.start_hidden": 2, "population.emitters": 1}
    asked: Any = {"env_kwargs": SMALL, "population": "map-elites", "settings": settings}
    whole = nq.train("maze", "rtneat", ticks=480, out=tmp_path / "whole", **asked)
    assert population_kinds.name_of(whole.config.population) == "map-elites"
    assert RunConfig.from_dict(whole.config.to_dict()) == whole.config
    assert whole.metrics()["births"][-1] >= 9 * 9  # a generation every 40 ticks
    nq.train("maze", "rtneat", ticks=160, out=tmp_path / "parts", **asked)
    nq.resume(tmp_path / "parts", ticks=480)
    files = [(tmp_path / name / "metrics.csv").read_bytes() for name in ("whole", "parts")]
    assert files[0] == files[1]
    action = whole.policy()(torch.rand(5, whole.champion().input_ids.size))
    assert action.shape[0] == 5


def test_a_world_of_ones_own_is_an_environment_whose_arenas_do_not_meet() -> None:
    make = example("own_world")["Sledges"]
    check_env_specs(make(arenas=2, slots=3))
    both, alone = make(arenas=2, seed=4, slots=3), make(arenas=1, seed=5, slots=3)
    starts = [env.reset()["observation"][-1] for env in (both, alone)]
    assert torch.equal(*starts)
    rows = both.rollout(60, break_when_any_done=False)
    assert rows["next", "done"].squeeze(-1).sum(-1).tolist() == [[1] * 3] * 2  # lives of 50


def test_two_arms_train_in_a_world_of_ones_own(tmp_path: Path) -> None:
    ends = example("own_world")["main"](ticks=300, out=str(tmp_path / "run"))
    assert all(0 < value < 50 for value in ends.values())
    run = nq.load_run(tmp_path / "run-neatq")
    more = nq.resume(run.folder, ticks=400)
    assert more.metrics()["generation"][-1] > run.metrics()["generation"].size - 1
    assert run.policy()(torch.zeros(2)).abs().item() <= 1


def test_a_learner_of_ones_own_learns_what_its_policy_is_worth() -> None:
    script = example("own_learner")
    genome = nq.NEAT.start(nq.NEATConfig(), slots=2, inputs=1, outputs=2, rng=0).genomes[0]
    network, heads = nq.PopulationNetwork([genome], shape=(1, 1)), nq.DiscreteHeads(2)
    config = script["ExpectedSarsaConfig"](epsilon=0.5, discount=0.5, normalize_return=False)
    learner = script["make"](config, LearnerParts(network, heads, (1, 1), [0]))
    value = learner.loss.value_network
    seen = TensorDict({"observation": torch.ones(1, 1, 1, 1)}, [1, 1, 1])
    values = value(seen)["action_value"]
    expected = 0.5 * values.max() + 0.5 * values.mean()
    assert seen["chosen_action_value"].item() == pytest.approx(expected.item())
    assert learner_kinds.name_of(config) == "expected-sarsa"


def test_a_learner_of_ones_own_trains(tmp_path: Path) -> None:
    distance = example("own_learner")["main"](ticks=200, out=str(tmp_path / "run"))
    run = nq.load_run(tmp_path / "run")
    assert 139 < distance < 300
    assert not np.isnan(run.metrics()["td_loss"]).any()


def test_rtneat_balances_poles_from_public_parts() -> None:
    assert example("rtneat_cartpole")["main"](ticks=2_000) > 100  # who does nothing falls after 10


def test_an_evolved_network_goes_on_learning_by_gradients(tmp_path: Path) -> None:
    script = example("supervised")
    before, after = script["main"](steps=100, out=str(tmp_path / "xor.json"))
    assert after < before < 0.25  # 0.25 is to say 0.5 every time
    outputs = nq.GenomeNetwork(nq.load_genome(tmp_path / "xor.json"))(script["INPUTS"])
    assert ((outputs > 0.5) == (script["WANTED"] > 0.5)).all()


def test_sb3_evaluates_a_champion_beside_its_agent(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(gymnasium.spec("CartPole-v1"), "max_episode_steps", 50)  # 500 take long
    means = example("sb3")["main"](generations=2, steps=128, every=64)
    assert len(means) == 2
    champion = nq.load_policy(tmp_path / "runs" / "beside-ppo")
    env = gymnasium.make("CartPole-v1")
    seen, _ = env.reset(seed=1)
    returns = list[float]()
    while len(returns) < 5:
        over = False
        returns.append(0.0)
        while not over:
            seen, reward, terminated, truncated, _ = env.step(champion(seen))
            returns[-1] += float(reward)
            over = terminated or truncated
        seen, _ = env.reset()
    assert means[0][1] == pytest.approx(np.mean(returns))
    assert means[1][1] == means[0][1]  # it does not learn any more


def test_a_gymnasium_task_is_three_lines(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(gymnasium.spec("CartPole-v1"), "max_episode_steps", 50)
    assert example("gymnasium_task")["main"](generations=1) > 9
