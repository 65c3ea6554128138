"""What a run has found, as a torch module that acts."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from torch import Tensor, nn

from neatq_envs.gymnasium_task import Interface
from neatq_envs.random_play import LARGEST, EnvFacts, ObservationScaling
from neatq_torch.checkpoint import CheckpointError
from neatq_torch.genome import Genome
from neatq_torch.learning import Heads, TableLearner
from neatq_torch.network import GenomeNetwork
from neatq_trainers.build import build, heads_of
from neatq_trainers.config import RunConfig
from neatq_trainers.folder import SCALING, load_run
from neatq_trainers.worlds import GymnasiumConfig, make_world


class ChampionPolicy(nn.Module):
    """Takes the best action for an observation, as the environment gives and takes them.

    A recurrent network remembers; call `reset` where an episode begins.

    Args:
        network: The champion; reads scaled observations.
        heads: How its outputs are read.
        interface: What is observed and done on a Gymnasium task; None in other worlds, whose
            observations and actions are as they are.
        scaling: Of its observations.
        double_activation: As `CandidatePolicy` has it.

    Attributes:
        network: The champion as a torch module.
    """

    def __init__(
        self,
        network: GenomeNetwork,
        heads: Heads,
        interface: Interface | None = None,
        scaling: ObservationScaling | None = None,
        *,
        double_activation: bool = False,
    ) -> None:
        super().__init__()
        self.network, self.heads, self.interface = network, heads, interface
        self._scaling = None  # no buffers: rounded with the network they would scale otherwise
        if scaling is not None:
            self._scaling = torch.from_numpy(scaling.offset), torch.from_numpy(scaling.scale)
        self._twice = double_activation
        self.reset()

    def reset(self) -> None:
        """Forget the episode before."""
        self._state: Tensor | None = None
        self._previous: Tensor | None = None

    @torch.no_grad()
    def forward(self, observation: Any) -> Any:
        """The best action.

        Args:
            observation: A tensor, an array or a number as the environment gives it, of any batch
                shape [*batch, *observation].

        Returns:
            A tensor for a tensor, else what the environment takes, of the type that its
            `action_space.sample()` gives: the action [*batch, *action].
        """
        seen = self._read(observation)
        if self._state is None or self._state.shape[:-1] != seen.shape[:-1]:
            self._state = self.network.initial_state(seen.shape[:-1])
            self._previous = torch.zeros_like(seen)
        output, self._state = self.network.step(seen, self._state)
        if self._twice and self._previous is not None:
            self._state, self._previous = self.network.step(self._previous, self._state)[1], seen
        return self._act(self.heads.best(output), isinstance(observation, Tensor))

    def _read(self, observation: Any) -> Tensor:
        """Scaled observations [*batch, inputs]."""
        weight = self.network.weight
        space = None if self.interface is None else self.interface.observation
        if self.interface and not isinstance(space, spaces.Box | spaces.Discrete):
            observation, space = self.interface.read(observation), None  # no batch of them
        observation = torch.as_tensor(observation).to(weight.device)
        if isinstance(space, spaces.Discrete):
            number = observation.long() - int(space.start)
            observation = nn.functional.one_hot(number, self.network.inputs)
        elif isinstance(space, spaces.Box) and len(space.shape) != 1:
            batch = observation.shape[: observation.ndim - len(space.shape)]
            observation = observation.reshape(*batch, -1)
        seen = observation.double()
        if self._scaling is not None:
            offset, scale = (one.to(weight.device) for one in self._scaling)
            seen = ((seen - offset) / scale).clamp(-LARGEST, LARGEST)
        return seen.to(weight.dtype)

    def _act(self, action: Tensor, as_tensor: bool) -> Any:
        """The environment's own actions for [*batch, A]."""
        own: Any = action.cpu().numpy()
        if self.interface is not None:
            batch, space = action.shape[:-1], self.interface.action
            own = self.interface.act(own.reshape(-1, action.shape[-1]))
            if isinstance(space, spaces.Dict | spaces.Tuple):
                return own if batch else own[0]
            own = np.stack(own).reshape(*batch, *(space.shape or ())) if batch else own[0]
        return torch.as_tensor(own, device=action.device) if as_tensor else own


class TablePolicy(nn.Module):
    """Takes the best action of one robot's table of Q-values: that of the first robot."""

    def __init__(self, learner: TableLearner) -> None:
        super().__init__()
        self._table = learner

    def reset(self) -> None:
        """A table remembers nothing of an episode."""

    def forward(self, observation: Any) -> Any:
        """The best action [*batch, A] for observations [*batch, sensors], of equal ones the first.

        Robots are told apart by where they stand in an array, so each row is asked as the first.
        """
        seen = np.asarray(observation, np.float32)
        flat = seen.reshape(-1, seen.shape[-1])
        rows = np.concatenate([self._table.rows(one[None]) for one in flat])
        action = self._table.actions[self._table.values[rows].argmax(-1)].astype(np.float32)
        action = action.reshape(*seen.shape[:-1], -1)
        return torch.from_numpy(action) if isinstance(observation, Tensor) else action


def make_policy(config: RunConfig, genome: Genome, facts: EnvFacts | None) -> ChampionPolicy:
    """The policy of a genome in the world of a run."""
    world = make_world(config.world, config.seeds[:1], episodes=1, facts=facts)
    heads, interface = heads_of(config, world), getattr(world, "interface", None)
    world.close()
    network = GenomeNetwork(genome, evaluation=config.network.evaluation)
    scaling, twice = facts and facts.scaling, config.network.double_activation
    return ChampionPolicy(network, heads, interface, scaling, double_activation=twice)


def load_policy(folder: Path | str) -> ChampionPolicy | TablePolicy:
    """The champion of a run, ready to act: a torch module, observation -> action.

    Args:
        folder: The run's folder.

    Raises:
        RunFolderError: If there is no run in it.
        CheckpointError: If a file is missing or altered, or nobody was judged yet.
        GenomeError: If the genome is altered.

    Example:
        >>> env = gymnasium.make("CartPole-v1")
        >>> policy = load_policy("runs/CartPole-v1-neat-seed0")
        >>> observation, _ = env.reset(seed=1)
        >>> observation, reward, terminated, truncated, _ = env.step(policy(observation))
    """
    run = load_run(folder)
    if run.config.population is None:
        state = run.read()
        learner = build(run.config.split(len(state["runs"]))[0], state["runs"][0]).learner
        assert isinstance(learner, TableLearner)
        return TablePolicy(learner)
    facts = None
    if isinstance(run.config.world, GymnasiumConfig):
        facts = _facts(run.path / SCALING)
    return make_policy(run.config, run.champion(), facts)


def _facts(path: Path) -> EnvFacts:
    try:
        return EnvFacts.from_dict(json.loads(path.read_bytes()))
    except FileNotFoundError as error:
        raise CheckpointError(f"{path}: there is no such file") from error
    except (LookupError, TypeError, ValueError) as error:
        raise CheckpointError(f"{path}: altered or damaged: {error}") from error
