"""What a run has found, as a torch module that acts."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from torch import Tensor, nn

from neatq_envs.gymnasium_task import Interface
from neatq_envs.observations import flat_rows
from neatq_envs.random_play import LARGEST, EnvFacts, ObservationScaling
from neatq_torch.genome import Genome, load_genome
from neatq_torch.learning import Heads, TableLearner
from neatq_torch.network import GenomeNetwork
from neatq_trainers.build import build, heads_of
from neatq_trainers.config import RunConfig
from neatq_trainers.folder import RunFolder, RunFolderError, load_run
from neatq_trainers.worlds import make_world


class ChampionPolicy(nn.Module):
    """Takes the best action for an observation, as the environment gives and takes them.

    A recurrent network remembers; call `reset` where an episode begins. Whoever keeps the state
    himself has `step`, as `GenomeNetwork` has it, or `predict`, as policies of Stable-Baselines3.

    Args:
        network: The champion; reads scaled observations.
        heads: How its outputs are read.
        interface: What is observed and done on a Gymnasium task; None in other worlds, whose
            observations and actions are as they are.
        scaling: Of its observations.
        double_activation: As `CandidatePolicy` has it.

    Attributes:
        network: The champion as a torch module.
        twice: Whether it is activated twice; then the state ends with the observation before.
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
        self.scaling, self._columns = scaling, None
        # No buffers: rounded with the network they would scale otherwise.
        if scaling is not None:
            self._columns = torch.from_numpy(scaling.offset), torch.from_numpy(scaling.scale)
        self.twice = double_activation and network.state_size > 0
        self.reset()

    def reset(self) -> None:
        """Forget the episode before."""
        self._state: Tensor | None = None

    @property
    def state_size(self) -> int:
        """Values that the policy keeps from one step to the next; 0 if it is not recurrent."""
        return self.network.state_size + (self.network.inputs if self.twice else 0)

    def initial_state(self, batch: Sequence[int] = ()) -> Tensor:
        """The state where an episode begins [*batch, state_size]."""
        return self.network.weight.new_zeros(*batch, self.state_size)

    @torch.no_grad()
    def forward(self, observation: Any) -> Any:
        """The best action.

        Args:
            observation: A tensor, an array or a number as the environment gives it, of any batch
                shape [*batch, *observation].

        Returns:
            A tensor for a tensor, else what the environment takes, of the type that its
            `action_space.sample()` gives: the action [*batch, *action].

        Raises:
            ValueError: If the shape is not that of observations, or the batch is another than
                before although the policy is recurrent and was not reset.
        """
        seen = self._read(observation)
        if self._state is None or not self.state_size:
            self._state = self.initial_state(seen.shape[:-1])
        if self._state.shape[:-1] != seen.shape[:-1]:
            raise ValueError(
                f"expected a batch {list(self._state.shape[:-1])} of observations, as before, got "
                f"{list(seen.shape[:-1])}; call reset() where other episodes begin"
            )
        best, self._state = self.best(seen, self._state)
        return self._own(best, isinstance(observation, Tensor))

    @torch.no_grad()
    def step(self, observation: Any, state: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """The best action [*batch, *action] and the next state, without any memory of its own.

        Args:
            observation: [*batch, *observation].
            state: [*batch, state_size], from `initial_state` or from the step before; None stands
                for the initial one.
        """
        seen = self._read(observation)
        state = self.initial_state(seen.shape[:-1]) if state is None else state
        best, state = self.best(seen, state)
        return self._own(best, True), state

    @torch.no_grad()
    def predict(
        self,
        observation: Any,
        state: tuple[np.ndarray, ...] | None = None,
        episode_start: np.ndarray | None = None,
        deterministic: bool = True,
    ) -> tuple[Any, tuple[np.ndarray, ...] | None]:
        """The best action, and the state for the next call, as Stable-Baselines3 has it.

        So `evaluate_policy` and whatever else asks models of that library takes a policy, too.

        Args:
            observation: As the environment gives it, or those of n environments.
            state: What the call before returned; None at the beginning.
            episode_start: Where an episode begins [*batch]: the state is not read there.
            deterministic: Has no effect: a champion does not explore.
        """
        seen = self._read(observation)
        first = before = self.initial_state(seen.shape[:-1])
        if state is not None and self.state_size:
            before = torch.as_tensor(state[0]).to(first)
            if episode_start is not None:
                begins = torch.as_tensor(episode_start, device=first.device).bool()
                before = torch.where(begins.reshape(seen.shape[:-1]).unsqueeze(-1), first, before)
        best, after = self.best(seen, before)
        kept = (after.cpu().numpy(),) if self.state_size else None
        return self._own(best, isinstance(observation, Tensor)), kept

    def best(self, seen: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """The best action [*batch, A], as the heads give it, and the next state.

        What is `seen` are scaled observations [*batch, inputs].
        """
        if not self.twice:
            output, state = self.network.step(seen, state)
            return self.heads.best(output), state
        size = self.network.state_size
        output, kept = self.network.step(seen, state[..., :size])
        kept = self.network.step(state[..., size:], kept)[1]
        return self.heads.best(output), torch.cat([kept, seen], -1)

    def scaled(self, observation: Tensor) -> Tensor:
        """What the network reads of flat observations [*batch, inputs]."""
        weight, seen = self.network.weight, observation
        if self._columns is not None:
            offset, scale = (one.to(weight.device) for one in self._columns)
            seen = ((seen.double() - offset) / scale).clamp(-LARGEST, LARGEST)
        return seen.to(weight.dtype)

    def _read(self, observation: Any) -> Tensor:
        """Scaled observations [*batch, inputs]."""
        weight, inputs = self.network.weight, self.network.inputs
        space = None if self.interface is None else self.interface.observation
        if not isinstance(space, spaces.Box | None):
            given = observation.cpu() if isinstance(observation, Tensor) else observation
            observation, space = flat_rows(space, given), None
        observation = torch.as_tensor(observation).to(weight.device)
        if observation.isnan().any():
            raise ValueError("expected an observation of numbers, got NaN")
        shape = (inputs,) if space is None else space.shape
        lead = observation.ndim - len(shape)
        if lead < 0 or observation.shape[lead:] != shape:
            expected = ", ".join(map(str, ("*batch", *shape)))
            raise ValueError(
                f"expected an observation of shape [{expected}], got {list(observation.shape)}"
            )
        observation = observation.reshape(*observation.shape[:lead], inputs)
        return self.scaled(observation)

    def _own(self, action: Tensor, as_tensor: bool) -> Any:
        """The environment's own actions for [*batch, A]."""
        own: Any = action.cpu().numpy()
        if self.interface is not None:
            batch, space = action.shape[:-1], self.interface.action
            own = self.interface.act(own.reshape(-1, action.shape[-1]))
            if isinstance(space, spaces.Dict | spaces.Tuple):
                return own if batch else own[0]
            shape = (*batch, *(space.shape or ()))
            own = np.array(own, space.dtype).reshape(shape) if batch else own[0]
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

    def predict(
        self,
        observation: Any,
        state: None = None,
        episode_start: np.ndarray | None = None,
        deterministic: bool = True,
    ) -> tuple[Any, None]:
        """The best action, as Stable-Baselines3 has it; a table keeps no state."""
        return self(observation), None


def make_policy(config: RunConfig, genome: Genome, facts: EnvFacts | None) -> ChampionPolicy:
    """The policy of a genome in the world of a run."""
    world = make_world(config.world, config.seeds[:1], episodes=1, facts=facts)
    heads, interface = heads_of(config, world), getattr(world, "interface", None)
    world.close()
    network = GenomeNetwork(genome, evaluation=config.network.evaluation)
    scaling, twice = facts and facts.scaling, config.network.double_activation
    return ChampionPolicy(network, heads, interface, scaling, double_activation=twice)


def load_policy(folder: Path | str | RunFolder) -> ChampionPolicy | TablePolicy:
    """The champion of a run, ready to act: a torch module, observation -> action.

    Args:
        folder: The run's folder, or what `train` and `load_run` give; or a genome's file in it.

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
    path = folder.path if isinstance(folder, RunFolder) else Path(folder)
    run = _run_at(path)
    if run.config.population is None:
        state = run.read()
        learner = build(run.config.split(len(state["runs"]))[0], state["runs"][0]).learner
        assert isinstance(learner, TableLearner)
        return TablePolicy(learner)
    schema = run.config.world.schema
    genome = load_genome(path, observation_schema=schema) if path.is_file() else run.champion()
    return make_policy(run.config, genome, run.facts())


def _run_at(path: Path) -> RunFolder:
    """The run in a folder, or in that of a file."""
    if not path.is_file():
        return load_run(path)
    try:
        return load_run(path.parent)
    except RunFolderError as error:
        raise RunFolderError(
            f"{path}: a file outside of the folder of a run, whose world and scaling a policy "
            "needs; give the run's folder, or take the network alone: "
            f"GenomeNetwork(load_genome({str(path)!r}))"
        ) from error
