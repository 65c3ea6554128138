"""Runs of anchors: equal budgets and tests, the same again with the same seed, and refusals."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import neatq_torch as nq
from neatq_envs.episodes import EVALUATION, TEST, episode_seeds
from neatq_envs.gymnasium_rows import make_rows
from neatq_envs.gymnasium_task import GymnasiumTask
from neatq_experiments.anchors.anchor import EVALUATIONS, AnchorConfig, Trial, anchor_config
from neatq_experiments.anchors.ppo import Choice
from neatq_experiments.anchors.run import trainer_of
from neatq_experiments.anchors.sb3 import TrainingRows
from neatq_experiments.compare.cells import digest, grid, run_cell, runs_of
from neatq_experiments.compare.returns import read_returns, returns_of
from neatq_experiments.compare.tables import read_tables
from neatq_experiments.compare.variants import PAPER_ARMS
from neatq_experiments.forward import forward_us
from neatq_experiments.seeds import SeedTask
from neatq_torch.kinds import ConfigError
from neatq_trainers.arms import ANCHORS, preset
from neatq_trainers.cli import main
from neatq_trainers.worlds import GymnasiumConfig

CARTPOLE = "gym:CartPole-v1"
SHORT = {"max_episode_steps": 50}


def run(task: str, name: str, seed: int = 0, **asked: Any) -> dict[str, Any]:
    """Run an anchor; what it gave but for times."""
    config = anchor_config(task, name, asked.pop("env_kwargs", None)).changed(asked)
    came = trainer_of(config)(config, seed)
    return {name: value for name, value in came.items() if name != "forward_us"}


def no_sb3(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "stable_baselines3", None)


@pytest.mark.parametrize("name", ["sb3-ppo", "sb3-dqn", "ppo"])
def test_a_run_has_its_steps_and_the_same_seed_gives_the_same(name: str) -> None:
    asked: Any = {"steps": 600, "env_kwargs": SHORT}
    one = run(CARTPOLE, name, 3, **asked)
    rollout = {"sb3-ppo": 8 * 32, "sb3-dqn": 256, "ppo": 4 * 128}[name]
    assert one["all_steps"] == one["steps"][-1] == -(-600 // rollout) * rollout
    wide = 5 * 256 + 257 * 256 + 257 * 2
    assert one["parameters"] == (wide if name == "sb3-dqn" else 4610)
    assert 0 < one["test_return"] <= 50
    assert np.diff(one["champion"]).min() >= 0
    assert np.diff(one["steps"]).min() > 0
    assert run(CARTPOLE, name, 3, **asked) == one
    assert run(CARTPOLE, name, 4, **asked)["fitness"] != one["fitness"]


def test_a_run_is_too_short_for_an_episode() -> None:
    with pytest.raises(ConfigError, match="no episode came to its end; expected a longer run than"):
        run("gym:Pendulum-v1", "sb3-td3", steps=20)


def test_ppo_learns_in_boxes_over_time_limits() -> None:
    one = run("gym:Pendulum-v1", "ppo", steps=2048)
    assert one["all_steps"] == 2048
    assert one["episodes"] == 8  # of 200 steps, in each of 8 rows of 256
    assert one["parameters"] == 4 * 64 + 65 * 64 + 65
    assert -2000 < one["test_return"] < -200


class Counter:
    """Goes one way as often as it was looked at, and then the other."""

    def __init__(self) -> None:
        self.network = torch.nn.Linear(4, 2)
        self.looks, self.kept, self.seen = 0, [], []

    def act(self, observation: Any) -> Any:
        self.seen.append(len(observation))
        return np.zeros((len(observation), 1)) + (self.looks % 2)

    def state(self) -> int:
        self.kept.append(self.looks)
        return self.looks

    def load(self, state: int) -> None:
        self.looks = state


def test_the_champion_is_the_best_on_held_out_episodes_and_is_tested_on_others() -> None:
    config = anchor_config(CARTPOLE, "ppo", SHORT).changed({"steps": 4000})
    rows, _ = make_rows(GymnasiumTask(id="CartPole-v1", kwargs=SHORT))
    pupil = Counter()
    trial = Trial(config, 7, rows, pupil)
    asked = list[tuple[int, int]]()
    right = {EVALUATION: [1.0, 5.0, 3.0], TEST: [4.0]}

    def returns(purpose: int, episodes: int) -> Any:
        asked.append((purpose, episodes))
        return np.full(episodes, right[purpose].pop(0))

    trial._returns = returns  # type: ignore[method-assign]
    assert not trial.due(99) and trial.due(100)
    for look in (1, 2, 3):
        pupil.looks = look
        trial.over(10.0 * look)
        trial.look(100 * look)
    assert trial.due(400) and not trial.due(399)
    trial.look(400, changed=False)
    result = trial.result(400, 4)
    assert asked == [(EVALUATION, 20)] * 3 + [(TEST, 100)]
    assert result["champion"] == [1, 5, 5, 5]
    assert result["fitness"] == [10, 15, 20, 20]
    assert (pupil.looks, result["test_return"], result["parameters"]) == (2, 4.0, 10)
    assert result["generation"] == [1, 2, 3, 4]
    assert EVALUATIONS == 40


def test_episodes_of_judgement_have_the_seeds_that_they_have_for_arms(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    config = anchor_config(CARTPOLE, "ppo", SHORT).changed({"steps": 4000})
    rows, _ = make_rows(GymnasiumTask(id="CartPole-v1", kwargs=SHORT))
    begun = list[list[int]]()
    reset = rows.reset

    def noting(mask: Any, given: Any) -> Any:
        begun.append(given.tolist())
        return reset(mask, given)

    monkeypatch.setattr(rows, "reset", noting)
    trial = Trial(config, 7, rows, Counter())
    assert trial._returns(TEST, 100).shape == (100,)
    assert begun[0] == episode_seeds(7, 0, 100, purpose=TEST).tolist()


def test_rows_tell_of_ends_and_go_on_at_once() -> None:
    rows, _ = make_rows(GymnasiumTask(id="CartPole-v1", kwargs={"max_episode_steps": 5}))
    env, told = TrainingRows(rows, 2, 0, "it"), list[float]()
    env.over = told.append
    first = env.reset()
    assert not np.array_equal(first[0], first[1])
    seen, reward, done, infos = [env.step(np.array([n % 2, n % 2])) for n in range(5)][-1]
    assert reward.tolist() == [1, 1]
    assert done.all() and told == [5, 5]
    assert all(info["TimeLimit.truncated"] for info in infos)
    last: Any = infos[0]["terminal_observation"]
    assert not np.array_equal(last, np.asarray(seen)[0])


def test_a_choice_is_a_number_with_the_chance_of_its_logit() -> None:
    chances = torch.tensor([[0.25, 0.75], [0.5, 0.5]])
    choice = Choice(logits=chances.log())
    drawn = choice.sample()
    assert (drawn.shape, drawn.dtype) == ((2, 1), torch.float32)
    assert choice.log_prob(torch.tensor([[1.0], [0.0]])).exp().tolist() == pytest.approx(
        [0.75, 0.5]
    )


def test_in_the_arena_the_team_has_the_tables_of_arms(tmp_path: Path, here: list[str]) -> None:
    asked: Any = {"seeds": 1, "ticks": 500, "env_kwargs": {"robots": 6}}
    found = nq.compare("flag", ["ppo", "qlearning"], out=tmp_path, **asked)
    study = found.study
    assert study is not None
    assert read_tables(tmp_path).arms() == ["ppo", "qlearning"]
    (point,) = (one for one in study.points if one.arm == "ppo")
    assert 100 < point.team < 200 and point.nearest <= point.team
    assert (point.eligible, point.newborn, point.champion, point.births) == (None, None, None, 0)
    assert study.outcomes_of("flag", "ppo")[0].cpu_seconds > 0
    assert "ppo |" in found.report()
    again = nq.compare("flag", ["ppo"], out=tmp_path, **asked)
    assert again.study is not None
    assert again.study.points == (point,)
    assert [name.split("-")[1] for name in here] == ["qlearning", "ppo"]  # each once
    config = anchor_config("flag", "ppo", {"robots": 6}).changed({"ticks": 500})
    metrics = trainer_of(config)(config, 0)
    assert metrics["tick"].tolist() == [100, 200, 300, 400, 500]
    assert metrics["mean_distance"].mean() == pytest.approx(point.team, abs=1e-3)


def test_a_comparison_goes_on_and_its_tables_and_report_know_sizes(
    tmp_path: Path, here: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: Any = {"steps": 300, "env_kwargs": {"max_episode_steps": 20}, "out": tmp_path}
    nq.compare(CARTPOLE, ["sb3-ppo"], seeds=1, **asked)
    found = nq.compare(CARTPOLE, ["neat", "sb3-ppo"], seeds=2, **asked)
    assert [name.split("-")[2] for name in here] == ["sb3", "neat", "neat", "sb3"]
    returns = found.returns
    assert returns is not None
    assert read_returns(tmp_path).outcomes[0].parameters is not None
    neat, _, anchor, _ = returns.outcomes
    assert (neat.parameters, neat.nodes, neat.settings) == (10, 7, "")  # 5 inputs to 2 outputs
    assert (anchor.parameters, anchor.nodes) == (4610, None)
    assert all(1 < (one.forward_us or 0) < 1e5 for one in returns.outcomes)
    assert anchor.cpu_seconds is not None and anchor.cpu_seconds > 0
    text = found.report()
    assert "; RL Zoo 2.9.2: ppo.yml, CartPole-v1 | 2 | 512 |" in text
    assert "| sb3-ppo | 4,610 [4,610, 4,610] | " in text
    assert "| neat | 10 [10, 10] | 7 [7, 7] | " in text and "| 0.22% |" in text


def test_other_settings_are_another_cell() -> None:
    (cell,) = grid([CARTPOLE], ["sb3-ppo"], quick=False, length={"steps": 300})
    assert cell.name.startswith("CartPole-v1-sb3-ppo-300-steps-")
    config = cell.config
    assert isinstance(config, AnchorConfig)
    longer = config.changed({"steps": 400})
    assert digest(longer) == digest(config)
    fewer = AnchorConfig(**{**vars(config), "world": replace(config.world, slots=2)})
    assert digest(fewer) == digest(config)
    other = AnchorConfig(**{**vars(config), "settings": {**config.settings, "gamma": 0.9}})
    assert digest(other) != digest(config)
    assert digest(anchor_config(CARTPOLE, "sb3-dqn")) != digest(anchor_config(CARTPOLE, "ppo"))


def test_old_results_have_no_sizes() -> None:
    (cell,) = grid([CARTPOLE], ["sb3-ppo"], quick=False, length={"steps": 600})
    task = SeedTask(cell.name, (0,), False, Path("unused"))
    (result,) = run_cell(dict(zip(runs_of([cell]).arms, [cell.config], strict=True)), task)
    old = {name: one for name, one in result.items() if name not in ("parameters", "forward_us")}
    (outcome,) = returns_of([cell], {cell.name: [{"seed": 0, **old}]}).outcomes
    assert (outcome.parameters, outcome.forward_us) == (None, None)


@pytest.mark.parametrize(
    ("task", "name", "pattern"),
    [
        (CARTPOLE, "sb3-sac", "sb3-sac does not run on gym:CartPole-v1: it needs a box of actions"),
        (CARTPOLE, "sb3-td3", "needs a box of actions, and there are 2 to choose from"),
        ("gym:Pendulum-v1", "sb3-dqn", "it needs actions to choose from, and there is a box"),
        ("flag", "sb3-ppo", "does not run on flag: it knows Gymnasium tasks .* ppo and sac run"),
        ("flga", "ppo", "task: expected flag"),
    ],
)
def test_what_does_not_fit_is_refused(task: str, name: str, pattern: str) -> None:
    with pytest.raises(ConfigError, match=pattern):
        grid([task], [name], quick=False)


def test_a_task_has_its_arguments_in_its_name() -> None:
    (cell,) = grid(
        ["gym:CartPole-v1:max_episode_steps=9:sutton_barto_reward=true"], ["ppo"], quick=True
    )
    assert isinstance(cell.config.world, GymnasiumConfig)
    assert cell.config.world.id == "CartPole-v1"
    assert cell.config.world.kwargs == {"max_episode_steps": 9, "sutton_barto_reward": True}
    assert cell.name.startswith("CartPole-v1-max_episode_steps-9-sutton_barto_reward-true-ppo-")
    assert preset("gym:my_module:Mine-v0", "neat").world.label == "my_module:Mine-v0"


def test_an_anchor_has_no_generations() -> None:
    with pytest.raises(ConfigError, match="generations: ppo has none; give the length in steps"):
        grid([CARTPOLE], ["ppo"], quick=False, length={"generations": 5})


def test_without_stable_baselines_there_is_a_line_that_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    no_sb3(monkeypatch)
    with pytest.raises(ConfigError, match=r'sb3-ppo needs .*: pip install "stable-baselines3>=2.9'):
        anchor_config(CARTPOLE, "sb3-ppo")
    assert anchor_config(CARTPOLE, "ppo").length[0] == "steps"


def test_anchors_are_listed_and_train_says_who_runs_them(
    capsys: pytest.CaptureFixture[str],
) -> None:
    for command in (["list"], ["compare", "--list"]):
        assert main(command) == 0
        said = capsys.readouterr().out
        assert all(f"  {name} " in said for name in ANCHORS)
    assert main(["train", "--task", CARTPOLE, "--arm", "sb3-sac"]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert (
        "sb3-sac is an anchor, which only neatq compare runs: neatq compare --tasks gym:" in error
    )
    assert not set(ANCHORS) & set(PAPER_ARMS)


def test_a_forward_pass_takes_the_median_of_many(monkeypatch: pytest.MonkeyPatch) -> None:
    moments = iter(np.cumsum(np.tile([1.0, 2e-6], 10_000)))
    monkeypatch.setattr("time.perf_counter", lambda: next(moments))
    calls = list[int]()
    assert forward_us(lambda: calls.append(1)) == pytest.approx(2, rel=1e-3)
    assert len(calls) > 100
