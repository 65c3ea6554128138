"""Runs in which networks read what is normalised, and learn from a shared critic."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from neatq_envs.random_play import EnvFacts, ObservationScaling
from neatq_torch.genome import ACTIVATIONS
from neatq_torch.kinds import ConfigError
from neatq_trainers.arms import preset
from neatq_trainers.build import build
from neatq_trainers.config import RunConfig
from neatq_trainers.folder import SCALING, load_run
from neatq_trainers.train import resume, start

pytestmark = pytest.mark.usefixtures("without_pictures")
Tiny = Callable[..., RunConfig]
NORMAL = {"network.normalization": "running"}
CRITIC = {
    "learner.kind": "critic",
    "learner.warmup": 50,
    "learner.width": 8,
    "learner.newborn_updates": 3,
    "network.candidates": 1,
}


def same(tmp_path: Path, whole: RunConfig, **length: int) -> None:
    """A run that is interrupted goes on as if nobody had stopped it."""
    start(whole, tmp_path / "whole")
    shorter = {name: value // 2 for name, value in length.items()}
    start(whole.changed(shorter), tmp_path / "parts")
    resume(tmp_path / "parts", ticks=length.get("ticks"), generations=length.get("generations"))
    for name in ("metrics.csv", "champion.json", SCALING):
        files = [tmp_path / run / name for run in ("whole", "parts")]
        one, other = (file.read_text() if file.exists() else None for file in files)
        assert one == other


@pytest.mark.parametrize("changes", [NORMAL, CRITIC, NORMAL | CRITIC])
@pytest.mark.parametrize("arm", ["neat", "rtneat"])
def test_a_run_goes_on_exactly(
    tiny_walk: Tiny, tmp_path: Path, arm: str, changes: dict[str, object]
) -> None:
    same(tmp_path, tiny_walk(arm, generations=4, **changes), generations=4)


def test_the_scaling_of_a_run_is_what_its_champion_read(tiny_walk: Tiny, tmp_path: Path) -> None:
    config = tiny_walk("neat", generations=4, **NORMAL)
    run = start(config, tmp_path / "run")
    begun = run.read()["facts"]["observation"]
    own = json.loads((run.path / SCALING).read_text())["observation"]
    assert not np.allclose(own["offset"], begun["offset"])
    (champion,) = run.read()["runs"][0]["metrics"]["champions"]
    for name in ("offset", "scale"):
        np.testing.assert_array_equal(own[name], champion["scaling"][name])


def test_a_champion_reads_what_it_read_in_life_far_beyond_random_play(tiny_walk: Tiny) -> None:
    """A value that random play saw in [0, 0.2] and that later goes from 0 to 60."""
    facts = EnvFacts(ObservationScaling(np.full(2, 0.1), np.full(2, 0.1)), (0.0, 1.0), False, True)
    run = build(tiny_walk("neat", **NORMAL), facts=facts)
    raw = np.linspace(0, 60, 200).reshape(100, 2)
    given = torch.from_numpy(run.world.env.scaling(raw))
    assert run.normalization is not None
    run.normalization.add(given[None], torch.ones(1, 100, dtype=torch.bool))
    own = run.normalization
    champion = facts.scaling.then(own.mean[0].numpy(), own.deviation[0].numpy())
    assert run.normalization(given[None])[0].numpy() == pytest.approx(champion(raw), abs=1e-4)
    rare = np.full((1, 2), 1e4)  # clipped in both
    given = torch.from_numpy(run.world.env.scaling(rare))
    assert run.normalization(given[None])[0].tolist() == champion(rare).tolist() == [[10, 10]]
    run.world.close()


def test_without_normalisation_the_scaling_is_that_of_random_play(
    tiny_walk: Tiny, tmp_path: Path
) -> None:
    run = start(tiny_walk("neat"), tmp_path / "run")
    own = json.loads((run.path / SCALING).read_text())
    assert own == load_run(run.path).read()["facts"]


def test_where_networks_learn_q_values_of_their_own_nothing_is_normalised() -> None:
    for arm in ("described", "neat+q", "qnetwork"):
        with pytest.raises(ConfigError, match=r"network.normalization: expected None; the learner"):
            preset("gym:CartPole-v1", arm).changed(NORMAL)
    with pytest.raises(ConfigError, match=r"network.normalization: expected None on wall"):
        preset("wall", "rtneat").changed(NORMAL)


def test_a_device_that_is_not_there_is_named(tiny_walk: Tiny, tmp_path: Path) -> None:
    config = tiny_walk("neat", **CRITIC, **{"learner.device": "nowhere"})
    with pytest.raises(ConfigError, match=r"learner.device: expected one of this machine, such as"):
        start(config, tmp_path / "run")


def test_a_critic_teaches_in_the_arena_too(tiny: Tiny, tmp_path: Path) -> None:
    same(tmp_path, tiny("neatq", ticks=400, **CRITIC), ticks=400)


def test_outputs_that_a_critic_teaches_are_steep_in_the_arena_alone(
    tiny: Tiny, tiny_walk: Tiny, tmp_path: Path
) -> None:
    """On Gymnasium tasks steep ones saturate: no gradient comes back, and a run gets stuck."""
    found = {}
    for name, config in {"arena": tiny("neatq"), "walk": tiny_walk("neatq", generations=1)}.items():
        genome = start(config, tmp_path / name).champion()
        outputs = np.isin(genome.node_id, genome.output_ids)
        found[name] = {ACTIVATIONS[one] for one in genome.node_activation[outputs].tolist()}
    assert found == {"arena": {"steep_sigmoid"}, "walk": {"sigmoid"}}
