"""A recurrent champion as a TorchRL module that carries its state through tensordicts."""

from __future__ import annotations

from typing import Any

from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase, dispatch
from torch import Tensor, nn
from torchrl.data import Unbounded
from torchrl.envs import TensorDictPrimer

from neatq_torch.learning.heads import Heads
from neatq_torch.network.stateful import Stepping


class GenomeModule(TensorDictModuleBase):
    """A network or a loaded policy as a TorchRL policy; a recurrent one remembers its episode.

    Reads `observation` [*batch, inputs] and writes `action`. If it is recurrent, it also reads
    `network_state` [*batch, state_size] and `is_init` [*batch, 1] or [*batch] (of TorchRL's
    `InitTracker`), both of which may be missing, and writes `("next", "network_state")`. An
    episode begins with the initial state.

    An environment must know of the state, as of that of an `LSTMModule`: append
    `make_tensordict_primer()` and `InitTracker()` to it; a `Collector` does so by itself
    (`auto_register_policy_transforms=True`). Then a rollout equals a plain loop that calls `step`.
    In a batch that was collected each step has its own state, so the module can be called on whole
    batches [*batch, time]; gradients do not flow from step to step.

    Args:
        module: A `GenomeNetwork`, or what `load_policy` gives of a run with networks.
        heads: How outputs are read as an action: that of the greatest value. None: the action is
            what `module` gives, the plain outputs of a network.
        in_key: Where observations are.
        out_key: Where actions are written.
        state_key: Where the state is.

    Raises:
        TypeError: For a module without `step`, such as a policy with a table.

    Example:
        >>> policy = GenomeModule(load_policy("runs/CartPole-v1-neat-seed0"))
        >>> env = env.append_transform(policy.make_tensordict_primer())  # in a loop of your own
        >>> rows = env.rollout(100, policy)
    """

    def __init__(
        self,
        module: Stepping,
        *,
        heads: Heads | None = None,
        in_key: str = "observation",
        out_key: str = "action",
        state_key: str = "network_state",
    ) -> None:
        super().__init__()
        if not (isinstance(module, nn.Module) and isinstance(module, Stepping)):
            raise TypeError(
                "GenomeModule: expected a GenomeNetwork or the policy of one (load_policy), got "
                f"{type(module).__name__}"
            )
        self.module, self.heads = module, heads
        state: list[Any] = [state_key, "is_init"] if module.state_size else []
        self.in_keys = [in_key, *state]
        after: list[Any] = [("next", one) for one in state[:1]]
        self.out_keys = [out_key, *after]

    @property
    def recurrent(self) -> bool:
        """Whether there is a state."""
        return len(self.out_keys) > 1

    @dispatch(auto_batch_size=False)
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Add the action, and the state for the next step, to `tensordict`."""
        observation = tensordict[self.in_keys[0]]
        output, kept = self.module.step(observation, self._state(tensordict))
        action = output if self.heads is None else self.heads.best(output)
        tensordict.set(self.out_keys[0], action)
        return tensordict.set(self.out_keys[1], kept) if self.recurrent else tensordict

    def _state(self, tensordict: TensorDictBase) -> Tensor | None:
        """What the module shall remember; None for nothing."""
        if not self.recurrent or (state := tensordict.get(self.in_keys[1], None)) is None:
            return None
        begins = tensordict.get("is_init", None)
        return state if begins is None else state.masked_fill(begins.reshape_as(state[..., :1]), 0)

    def make_tensordict_primer(self) -> TensorDictPrimer:
        """The transform by which an environment knows of the state; empty if there is none."""
        if not self.recurrent:
            return TensorDictPrimer({}, expand_specs=True)
        first = self.module.initial_state()
        spec = Unbounded(first.shape, dtype=first.dtype)
        return TensorDictPrimer({self.in_keys[1]: spec}, expand_specs=True)
