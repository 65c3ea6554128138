"""A champion, to act in a plain Gymnasium environment."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import torch

from neatq_envs.gymnasium_task import Interface
from neatq_envs.observation_scaling import ObservationScaling
from neatq_torch.checkpoint import CheckpointError
from neatq_torch.genome import Genome, load_genome
from neatq_torch.learning import CandidateHeads, DiscreteHeads
from neatq_torch.network import GenomeNetwork
from neatq_trainers.generational.config import GenerationalConfig
from neatq_trainers.generational.folder import SCALING
from neatq_trainers.generational.lives import make_heads
from neatq_trainers.generational.run import observation_schema
from neatq_trainers.generational.scout import Surroundings
from neatq_trainers.run_files import CHAMPION, CONFIG


class ChampionPolicy:
    """Takes the best action for an observation, as the environment gives and takes them.

    A recurrent network remembers; call `reset` where an episode begins.

    Attributes:
        network: The champion as a torch module; reads scaled observations.
        scaling: Of the observations.
        interface: What is observed and done.
    """

    def __init__(
        self,
        network: GenomeNetwork,
        heads: CandidateHeads | DiscreteHeads,
        interface: Interface,
        scaling: ObservationScaling,
    ) -> None:
        self.network, self.scaling = network, scaling
        self.interface, self._heads = interface, heads
        self.reset()

    def reset(self) -> None:
        """Forget the episode before."""
        self._state = self.network.initial_state()

    @torch.no_grad()
    def __call__(self, observation: Any) -> Any:
        """The action for an observation."""
        read = torch.from_numpy(self.scaling(self.interface.read(observation)))
        output, self._state = self.network.step(read, self._state)
        candidates, values = self._heads(output)
        action = candidates[values.argmax(-1)].numpy()
        return self.interface.act(action[np.newaxis])[0]


def make_policy(
    config: GenerationalConfig, surroundings: Surroundings, genome: Genome
) -> ChampionPolicy:
    """The policy of a genome in the environment of a run."""
    env = config.environment.make()
    interface = Interface.of(env, config.environment.id)
    env.close()
    heads = make_heads(config, interface, surroundings.value_range)
    network = GenomeNetwork(genome, evaluation=config.network.evaluation)
    return ChampionPolicy(network, heads, interface, surroundings.scaling)


def load_policy(folder: Path | str) -> ChampionPolicy:
    """The champion of a run, ready to act.

    It needs `config.json`, `scaling.json` and `champion.json` of the run's folder.

    Args:
        folder: The run's folder.

    Raises:
        CheckpointError: If one of the files is missing or altered.
        GenomeError: If the genome is.

    Example:
        >>> env = gymnasium.make("CartPole-v1")
        >>> policy = load_policy("runs/CartPole-v1-neat-seed0")
        >>> observation, _ = env.reset(seed=1)
        >>> observation, reward, terminated, truncated, _ = env.step(policy(observation))
    """
    folder = Path(folder)
    config = GenerationalConfig.from_dict(_read(folder / CONFIG))
    try:
        surroundings = Surroundings.from_dict(_read(folder / SCALING))
    except (KeyError, TypeError, ValueError) as error:
        if isinstance(error, CheckpointError):
            raise
        raise CheckpointError(f"{folder / SCALING}: altered or damaged: {error}") from error
    path = folder / CHAMPION
    if not path.is_file():
        raise CheckpointError(f"{path}: there is no such file; the run had no generation yet")
    genome = load_genome(path, observation_schema=observation_schema(config))
    return make_policy(config, surroundings, genome)


def _read(path: Path) -> Any:
    try:
        return json.loads(path.read_bytes())
    except FileNotFoundError as error:
        raise CheckpointError(f"{path}: there is no such file") from error
    except ValueError as error:
        raise CheckpointError(f"{path}: altered or damaged: {error}") from error
