"""A loaded champion does what it did in its run, bit for bit, and is an ordinary torch module."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from torch import Tensor, nn
from torchrl.collectors import Collector
from torchrl.envs import GymEnv, SerialEnv
from torchrl.envs.utils import ExplorationType, set_exploration_type

from neatq_envs.episodes import TEST, episode_seeds
from neatq_envs.random_play import EnvFacts
from neatq_torch.checkpoint import CheckpointError
from neatq_torch.genome import Genome, GenomeError, load_genome, save_genome
from neatq_torch.learning import GenomeModule, TableLearner
from neatq_trainers.arms import ARMS, preset
from neatq_trainers.build import build
from neatq_trainers.config import RunConfig
from neatq_trainers.folder import CHAMPION, CONFIG, RESULT, SCALING, RunFolderError, load_run
from neatq_trainers.policy import ChampionPolicy, load_policy
from neatq_trainers.train import start

Tiny = Callable[..., RunConfig]
Done = Callable[..., Path]
pytestmark = pytest.mark.usefixtures("without_pictures")


@pytest.fixture(scope="module")
def done(
    tiny: Tiny, tiny_walk: Tiny, tmp_path_factory: pytest.TempPathFactory, without_pictures: None
) -> Done:
    """The folder of a finished tiny run, made once; do not write into it."""
    folder, made = tmp_path_factory.mktemp("policies"), {}

    def run(arm: str, task: str = "wall", **changes: Any) -> Path:
        key = f"{arm} {task} {changes}"
        if key not in made:
            made[key] = folder / str(len(made))
            config = tiny(arm) if task == "wall" else tiny_walk(arm, task, **changes)
            start(config, made[key])
        return made[key]

    return run


def team_of(folder: Path, ticks: int) -> tuple[Tensor, Tensor, int]:
    """Observations and greedy actions [slots, ticks, ..] of the team of a run, and its champion."""
    run = load_run(folder)
    built = build(run.config, run.read()["runs"][0])
    champion = built.populations[0].champion
    remembered = built.metrics.champions[0]
    assert built.network is not None
    best = load_genome(folder / CHAMPION)
    if champion is None:  # between two generations: the genome is not in the team any more
        assert remembered is not None
        champion = 0
        built.network.replace(0, best)
    built.policy.reset(torch.ones(built.shape, dtype=torch.bool))
    seen, done = [], []
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        rows = built.world.env.reset()
        for _ in range(ticks):
            rows = built.policy(rows)
            seen.append(rows.get("observation")[0])
            done.append(rows.get("action")[0])
            _, rows = built.world.env.step_and_maybe_reset(rows)
    return torch.stack(seen, 1), torch.stack(done, 1), champion


@pytest.mark.parametrize("arm", [arm for arm in ARMS if arm != "qlearning"])
def test_in_the_arena_it_acts_as_the_champion_of_the_team(done: Done, arm: str) -> None:
    seen, acted, champion = team_of(done(arm), 60)
    policy = load_policy(done(arm))
    one_by_one = torch.stack([policy(one) for one in seen[champion]])
    assert torch.equal(one_by_one, acted[champion])
    policy.reset()
    numbers = np.stack([policy(one) for one in seen[champion].numpy()])
    assert numbers.dtype == np.float32
    np.testing.assert_array_equal(numbers, acted[champion].numpy())


def recurrent(genome: Genome) -> Genome:
    """With one recurrent link, from the first output to itself."""
    output, kept = genome.output_ids[0], ~genome.link_recurrent
    new = {
        "link_innovation": np.int64(9_999),
        "link_source": output,
        "link_target": output,
        "link_weight": np.float32(3),
        "link_enabled": True,
        "link_recurrent": True,
    }
    return genome.replaced(
        **{name: np.append(getattr(genome, name)[kept], value) for name, value in new.items()}
    )


@pytest.mark.parametrize("task", ["wall", "Walk-v0"])
def test_a_recurrent_champion_remembers_until_it_is_reset(
    done: Done, tmp_path: Path, task: str
) -> None:
    folder = Path(shutil.copytree(done("neat", task), tmp_path / "run"))
    save_genome(recurrent(load_genome(folder / CHAMPION)), folder / CHAMPION)
    policy = load_policy(folder)
    assert isinstance(policy, ChampionPolicy)
    assert policy.network.state_size
    observation = 0.3 * torch.ones(policy.network.inputs)
    first, second = policy(observation), policy(observation)
    assert not torch.equal(first, second)
    policy.reset()
    assert torch.equal(policy(observation), first)
    assert torch.equal(policy(observation), second)


def test_a_batch_is_as_many_robots(done: Done) -> None:
    seen, _, champion = team_of(done("rtneat"), 20)
    policy = load_policy(done("rtneat"))
    together = torch.stack([policy(one) for one in seen.unbind(1)], 1)
    assert together.shape[:2] == seen.shape[:2]
    for slot in (0, champion):
        policy.reset()
        alone = torch.stack([policy(one) for one in seen[slot]])
        assert torch.equal(together[slot], alone)
    policy.reset()
    assert policy(seen).shape == together.shape


def test_a_table_takes_the_best_action_of_the_first_robot(done: Done) -> None:
    folder = done("qlearning")
    run = load_run(folder)
    table = build(run.config, run.read()["runs"][0]).learner
    assert isinstance(table, TableLearner)
    key = next(key for key, row in table._entries.items() if table.values[row].any())
    mine = [key for key in table._entries if key[:4] == bytes(4)]
    seen = np.stack([np.frombuffer(key[4:], np.uint8) for key in mine]).astype(np.float32) / 4
    best = [table.actions[table.values[table._entries[key]].argmax()] for key in mine]
    policy = load_policy(folder)
    assert key
    np.testing.assert_array_equal(policy(seen), np.array(best, np.float32))
    np.testing.assert_array_equal(policy(seen[0]), np.array(best[0], np.float32))
    acted = policy(torch.from_numpy(seen))
    assert isinstance(acted, Tensor)
    assert acted.shape == (len(seen), table.actions.shape[-1])
    policy.reset()


def returns_in_a_plain_environment(folder: Path) -> list[float]:
    """Returns of the test episodes of a run, played with its policy."""
    config, policy = load_run(folder).config, load_policy(folder)
    assert isinstance(policy, nn.Module)
    env = gymnasium.make(config.world.id, **config.world.kwargs)  # type: ignore[union-attr]
    returns = []
    test_episodes = config.world.test_episodes  # type: ignore[union-attr]
    for seed in episode_seeds(config.seed, 0, test_episodes, purpose=TEST).tolist():
        observation, _ = env.reset(seed=seed)
        policy.reset()
        returns.append(0.0)
        over = False
        while not over:
            action = policy(observation)
            assert env.action_space.contains(action)
            observation, reward, terminated, truncated, _ = env.step(action)
            returns[-1] += float(reward)
            over = terminated or truncated
    env.close()
    return returns


def result_of(folder: Path) -> dict[str, Any]:
    return json.loads((folder / RESULT).read_text())["champion"]


@pytest.mark.parametrize("arm", [arm for arm in ARMS if not ARMS[arm].arena_only])
def test_the_test_episodes_can_be_played_again_in_a_box_of_actions(done: Done, arm: str) -> None:
    folder = done(arm, "Walk-v0")
    assert result_of(folder)["mean"] == np.mean(returns_in_a_plain_environment(folder))


def test_the_test_episodes_of_cart_pole_have_the_returns_of_the_result(tmp_path: Path) -> None:
    config = preset("gym:CartPole-v1", "neatq", length={"generations": 2})
    few = {"world.slots": 12, "world.every": 1, "world.episodes": 3, "world.test_episodes": 8}
    start(config.changed(few), tmp_path / "run")
    returns, result = returns_in_a_plain_environment(tmp_path / "run"), result_of(tmp_path / "run")
    assert result["mean"] == np.mean(returns)
    assert result["standard_error"] == np.std(returns, ddof=1) / np.sqrt(8)


@pytest.mark.parametrize("observes", ["box", "matrix", "choice", "endless box"])
@pytest.mark.parametrize("acts", ["choice", "box", "matrix"])
def test_every_space_is_read_and_acted_in(
    tiny_walk: Tiny, tmp_path: Path, observes: str, acts: str
) -> None:
    kwargs = {"observes": observes, "acts": acts}
    start(tiny_walk("neat", "Spaces-v0", env_kwargs=kwargs, generations=1), tmp_path / "run")
    run = load_run(tmp_path / "run")
    policy = load_policy(run.path)
    assert isinstance(policy, ChampionPolicy)
    interface = policy.interface
    assert interface is not None
    space = interface.observation
    space.seed(3)
    facts = EnvFacts.from_dict(json.loads((run.path / SCALING).read_text()))
    several = np.array([space.sample() for _ in range(5)])
    together, plain = policy(several), []
    for observation in several:
        scaled = torch.from_numpy(facts.scaling(interface.read(observation)))
        policy.reset()
        alone = policy(observation)
        with torch.no_grad():
            candidates, values = policy.heads(
                policy.network.step(scaled, policy.network.initial_state())[0]
            )
        (wanted,) = interface.act(candidates[values.argmax()][None].numpy())
        assert interface.action.contains(alone)
        assert type(alone) is type(interface.action.sample())
        assert alone.dtype == interface.action.dtype
        np.testing.assert_array_equal(alone, wanted)
        plain.append(wanted)
    np.testing.assert_array_equal(together, np.array(plain))


def test_it_is_an_ordinary_module(done: Done) -> None:
    policy = load_policy(done("neatq", "Walk-v0"))
    assert isinstance(policy, ChampionPolicy)
    (weights,) = policy.parameters()
    state = policy.state_dict()
    assert torch.equal(state["network.weight"], weights)
    seen = torch.tensor([0.3, 6.0])
    before = policy(seen)
    with torch.no_grad():
        weights.zero_()
    assert not torch.equal(policy(seen), before)
    policy.load_state_dict(load_policy(done("neatq", "Walk-v0")).state_dict())
    assert torch.equal(policy(seen), before)
    assert policy.to(torch.float64)(seen).dtype == before.dtype  # the environment's own
    assert torch.allclose(policy(seen), before, atol=1e-5)


@pytest.mark.parametrize("name", [CONFIG, SCALING, CHAMPION])
def test_a_champion_without_one_of_its_files_is_refused(
    done: Done, tmp_path: Path, name: str
) -> None:
    run = Path(shutil.copytree(done("neat", "Walk-v0"), tmp_path / "run"))
    (run / name).write_text("{}")
    with pytest.raises((CheckpointError, GenomeError)):
        load_policy(run)
    (run / name).unlink()
    with pytest.raises(CheckpointError, match=f"{name}: there is no such file"):
        load_policy(run)


def test_where_there_is_no_run_there_is_no_policy(done: Done, tmp_path: Path) -> None:
    with pytest.raises(RunFolderError, match="no run"):
        load_policy(tmp_path)
    with pytest.raises(RunFolderError, match="no run"):
        load_policy(tmp_path / "nowhere")
    alone = shutil.copy(done("neat", "Walk-v0") / CHAMPION, tmp_path / "alone.json")
    with pytest.raises(
        RunFolderError, match=r"alone.json: a file outside.*GenomeNetwork\(load_gen"
    ):
        load_policy(alone)


@pytest.mark.parametrize("task", ["wall", "Walk-v0"])
def test_a_run_and_a_genome_in_its_folder_can_be_loaded_too(done: Done, task: str) -> None:
    folder = done("neat", task)
    wanted = load_policy(folder)
    assert isinstance(wanted, ChampionPolicy)
    for what in (str(folder), load_run(folder), folder / CHAMPION):
        policy = load_policy(what)
        assert isinstance(policy, ChampionPolicy)
        assert policy.network.genome().to_json() == wanted.network.genome().to_json()


def remembering(done: Done, tmp_path: Path, remembers: bool = True) -> ChampionPolicy:
    """A policy for `Walk-v0` that is recurrent, or not."""
    folder = Path(shutil.copytree(done("neat", "Walk-v0"), tmp_path / str(remembers)))
    genome = recurrent(load_genome(folder / CHAMPION))
    if not remembers:
        genome = genome.replaced(link_enabled=~genome.link_recurrent)
    save_genome(genome, folder / CHAMPION)
    policy = load_policy(folder)
    assert isinstance(policy, ChampionPolicy)
    assert policy.state_size == remembers
    return policy


@pytest.mark.parametrize("remembers", [False, True])
def test_evaluate_policy_of_stable_baselines3_gives_the_returns_of_a_plain_loop(
    done: Done, tmp_path: Path, remembers: bool
) -> None:
    evaluation = pytest.importorskip("stable_baselines3.common.evaluation")
    vectorised = pytest.importorskip("stable_baselines3.common.env_util")
    policy: Any = remembering(done, tmp_path, remembers)
    config: Any = load_run(done("neat", "Walk-v0")).config
    envs = vectorised.make_vec_env(config.world.id, 3, seed=5, env_kwargs=config.world.kwargs)
    found, _ = evaluation.evaluate_policy(
        policy, envs, n_eval_episodes=6, return_episode_rewards=True
    )
    single = [gymnasium.make(config.world.id, **config.world.kwargs) for _ in range(3)]
    wanted = []
    for number, env in enumerate(single):  # two episodes of each, of which the first has the seed
        for seed in (5 + number, None):
            observation, over = env.reset(seed=seed)[0], False
            policy.reset()
            wanted.append(0.0)
            while not over:
                action = policy(observation)
                observation, reward, terminated, truncated, _ = env.step(action)
                wanted[-1] += float(reward)
                over = terminated or truncated
    assert sorted(found) == pytest.approx(sorted(wanted), rel=1e-6)
    assert len({round(one, 6) for one in wanted}) > 1


def test_predict_begins_anew_where_an_episode_begins_and_leaves_the_memory_alone(
    done: Done, tmp_path: Path
) -> None:
    policy = remembering(done, tmp_path)
    seen = np.full((2, policy.network.inputs), 0.3, np.float32)
    first, state = policy.predict(seen)
    second, state = policy.predict(seen, state, np.array([False, False]))
    mixed, _ = policy.predict(seen, state, np.array([True, False]))
    third, _ = policy.predict(seen, state, deterministic=False)
    assert not np.array_equal(first, second)
    np.testing.assert_array_equal(mixed, np.stack([first[0], third[1]]))
    np.testing.assert_array_equal(policy(seen), first)
    alone, _ = policy.predict(seen[0])
    np.testing.assert_array_equal(alone, first[0])


def test_a_policy_that_remembers_refuses_another_batch_until_it_is_reset(
    done: Done, tmp_path: Path
) -> None:
    policy = remembering(done, tmp_path)
    seen = torch.full((2, policy.network.inputs), 0.3)
    one = policy(seen[0])
    with pytest.raises(ValueError, match=r"a batch \[\] of observations, as before, got \[2\]"):
        policy(seen)
    policy.reset()
    assert torch.equal(policy(seen)[1], one)
    plain = remembering(done, tmp_path, remembers=False)
    assert torch.equal(plain(seen)[0], plain(seen[0]))


@pytest.mark.parametrize("task", ["wall", "Walk-v0"])
def test_an_observation_of_another_shape_is_named(done: Done, task: str) -> None:
    policy = load_policy(done("neat", task))
    assert isinstance(policy, ChampionPolicy)
    inputs = policy.network.inputs
    for shape in ((4, inputs + 1), ()):
        with pytest.raises(ValueError) as error:
            policy(np.zeros(shape))
        wanted = f"expected an observation of shape [*batch, {inputs}], got {list(shape)}"
        assert str(error.value) == wanted


def test_a_policy_steps_as_a_network_does(done: Done) -> None:
    policy = load_policy(done("described"))  # which activates twice
    assert isinstance(policy, ChampionPolicy)
    state = policy.initial_state((2,))
    assert state.shape == (2, policy.state_size)
    chance = torch.Generator().manual_seed(0)
    for _ in range(4):
        seen = torch.rand(2, policy.network.inputs, generator=chance)
        action, state = policy.step(seen, state)
        assert torch.equal(action, policy(seen))


@pytest.mark.parametrize("remembers", [False, True])
def test_a_policy_acts_in_a_collector_of_torchrl_as_it_is(
    done: Done, tmp_path: Path, remembers: bool
) -> None:
    policy = remembering(done, tmp_path, remembers)
    config: Any = load_run(done("neat", "Walk-v0")).config
    env = SerialEnv(2, lambda: GymEnv(config.world.id, **config.world.kwargs))
    settings: Any = {"total_frames": -1, "auto_register_policy_transforms": True}
    collector = Collector(env, GenomeModule(policy), frames_per_batch=200, **settings)
    batch = next(iter(collector))
    collector.shutdown()
    for row in batch:
        for one in row:
            if bool(one["is_init"]):
                policy.reset()
            assert torch.equal(policy(one["observation"]), one["action"])
    assert int(batch["is_init"].sum()) > 2


def test_the_table_is_asked_by_predict_too(done: Done) -> None:
    policy = load_policy(done("qlearning"))
    folder = load_run(done("qlearning"))
    seen = np.zeros(
        (3, len(build(folder.config, folder.read()["runs"][0]).world.env.arena.schema.observations))
    )  # type: ignore[attr-defined]
    action, state = policy.predict(seen, None, np.ones(3, bool))
    np.testing.assert_array_equal(action, policy(seen))
    assert state is None
