"""All networks of a population, or the one of a genome, as a differentiable module."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from neatq_torch.genome.genome import Genome
from neatq_torch.network import compiled
from neatq_torch.network.levels import Plan
from neatq_torch.network.plan import Evaluation, GenomePlan, compile_genome
from neatq_torch.network.separate import SeparateStates
from neatq_torch.network.stateful import StatefulNetwork


class PopulationNetwork(nn.Module):
    """Networks of many genomes, evaluated together as one sparse graph.

    Every network has its own topology and its own weights; they share the numbers of inputs and
    outputs. The weights of all links are one parameter, so a loss that sums over networks gives
    each network its own gradient.

    Feed-forward use is `forward`. Networks with recurrent links, or evaluated synchronously, read
    values of the call before: `step` takes and returns them, so a network is a pure function
    (observation, state) -> (output, state). Gradients do not flow into the calls before unless the
    caller keeps the state's graph. `stateful` gives a module that keeps the state itself.

    Observations may be anything that `torch.as_tensor` takes; they are cast to the dtype of the
    weights, and so are states.

    Plain float32 tensors on the CPU are evaluated, and their gradients computed, by compiled code,
    which takes seconds to compile at the first call on a machine. Any other dtype or device,
    transforms (`torch.func`, `torch.export`, `torch.compile`, `torch.jit.trace`) and gradients of
    gradients take torch operations, which compute the same up to rounding.

    A hidden node or output without an incoming link has the value of its activation at 0.

    Args:
        genomes: One genome for each network, in row-major order of `shape`.
        shape: Leading dimensions of observations and outputs, such as (arenas, robots). Defaults
            to (len(genomes),).
        evaluation: See `Evaluation`.

    Attributes:
        inputs: Observations of each network, without the bias.
        outputs: Outputs of each network.
        weight: The weights of all links [networks, columns]; only `Plan` knows the columns. Those
            that belong to no link of a network are spare: room for genomes to come and for links
            that others have. They are zero, are not read and get no gradient; so count links with
            `repr` or `genomes`, not here. The parameter keeps its identity for ever; it grows when
            a genome needs more columns.
        genome_id: Whose network stands in each slot [*shape].
        births: How often `replace` has put a genome in each slot.

    Raises:
        ValueError: If genomes disagree in observations, inputs or outputs, or do not fill `shape`.

    Example:
        >>> network = PopulationNetwork(population.genomes)
        >>> outputs = network(torch.rand(*network.shape, network.inputs))
    """

    weight: nn.Parameter
    genome_id: Tensor
    _exact = False

    def __init__(
        self,
        genomes: Sequence[Genome],
        *,
        shape: Sequence[int] | None = None,
        evaluation: Evaluation = "settle",
    ) -> None:
        super().__init__()
        self.shape = torch.Size(shape if shape is not None else (len(genomes),))
        if not genomes or math.prod(self.shape) != len(genomes):
            raise ValueError(
                f"expected {math.prod(self.shape)} genomes for shape {tuple(self.shape)}, "
                f"got {len(genomes)}"
            )
        self.evaluation: Evaluation = evaluation
        self._genomes = list(genomes)
        self._plans = [compile_genome(genome, evaluation) for genome in genomes]
        self.inputs, self.outputs = self._plans[0].need.inputs, self._plans[0].need.outputs
        for genome, plan in zip(genomes, self._plans, strict=True):
            self._check_interface(genome, plan)
        self.births = [0] * len(genomes)
        self.plan = Plan(self._plans, exact=self._exact)
        self.weight = nn.Parameter(torch.zeros(len(genomes), self.plan.columns))
        identities = torch.tensor([g.genome_id for g in genomes], dtype=torch.long)
        self.register_buffer("genome_id", identities.view(self.shape), persistent=False)
        for slot in range(len(genomes)):
            self._load_weights(slot)

    @property
    def state_size(self) -> int:
        """Values that each network keeps from one call to the next; 0 if none is recurrent."""
        return self.plan.layout.state

    def initial_state(self, batch: Sequence[int] = ()) -> Tensor:
        """The state of a network that has seen nothing: zeros [*shape, *batch, state_size]."""
        return self.weight.new_zeros(*self.shape, *batch, self.state_size)

    def forward(self, observation: Any, state: Any = None) -> Tensor:
        """Outputs [*shape, *batch, outputs] for observations [*shape, *batch, inputs].

        The batch of observations for each network may have any shape; without a state, see `step`,
        all start from the initial one, and networks that have one warn of it.
        """
        if state is None and self.state_size and not torch.compiler.is_dynamo_compiling():
            warnings.warn(_FORGETS, stacklevel=4)  # at the line that calls the module
        return self.step(observation, state)[0]

    def step(self, observation: Any, state: Any = None) -> tuple[Tensor, Tensor]:
        """One call of every network.

        Args:
            observation: [*shape, *batch, inputs].
            state: [*shape, *batch, state_size], from `initial_state` or from the call before; None
                stands for the initial one.

        Returns:
            Outputs [*shape, *batch, outputs] and the state for the next call.

        Raises:
            ValueError: If a shape or dtype does not fit.
        """
        weight = self.weight  # looked up once: a module's parameters are slow to find
        observation = self._read(weight, observation)
        if state is not None:
            state = self._recall(weight, state, observation)
        elif self.state_size:
            state = self.initial_state(observation.shape[len(self.shape) : -1])
        else:
            state = observation[..., :0]
        if compiled.accepts(weight, observation, state):
            return compiled.evaluate(self.plan, weight, observation, state)
        return self.plan.levels(weight.device).evaluate(weight, observation, state)

    def part(self, slots: Sequence[int], shape: Sequence[int] | None = None) -> PopulationNetwork:
        """Some of the networks (flat slots), in another shape, with copies of their weights."""
        genomes = [self._genomes[slot] for slot in slots]
        part = PopulationNetwork(genomes, shape=shape, evaluation=self.evaluation)
        part.load_weights(self.weight.detach()[list(slots)])
        return part.to(self.weight.device)

    def stateful(self) -> StatefulNetwork:
        """These networks as a module that keeps their state from call to call, until `reset`."""
        return StatefulNetwork(self)

    def genome(self, slot: int) -> Genome:
        """The genome in a slot (flat), with `link_weights`; GenomeError if one is not finite."""
        row = self.weight.detach()[slot].cpu().numpy()
        return self._genomes[slot].with_weights(self._link_weights(slot, row))

    def genomes(self) -> list[Genome]:
        """All genomes with their `link_weights`, in flat order."""
        pairs = zip(self._genomes, self.link_weights(), strict=True)
        return [genome.with_weights(weights) for genome, weights in pairs]

    def link_weights(self) -> Iterator[np.ndarray]:
        """The weights of the links of every genome, float32 [links], in flat order.

        They are those that the networks have now, bit for bit; those of disabled links are the
        genome's own.
        """
        for slot, row in enumerate(self.weight.detach().cpu().numpy()):
            yield self._link_weights(slot, row)

    def _link_weights(self, slot: int, row: np.ndarray) -> np.ndarray:
        plan, weights = self._plans[slot], self._genomes[slot].link_weight.copy()
        weights[plan.enabled] = row[self.plan.place(plan.column)]
        return weights

    @torch.no_grad()
    def replace(self, slot: int, genome: Genome) -> None:
        """Put a genome in a slot (flat). The other networks are not touched.

        Costs the size of the genome, unless it needs more room than the plan has: then every
        network gets more (and `weight` more columns, all of them zero). An optimiser of your own
        goes on with what it knows of the network before, unless `separate` was told of it.

        Raises:
            ValueError: If its observations, inputs or outputs differ from the population's.
        """
        plan = compile_genome(genome, self.evaluation)
        self._check_interface(genome, plan)
        self._genomes[slot], self._plans[slot] = genome, plan
        self.births[slot] += 1
        self.plan.write(slot, plan)
        if self._exact:
            self.plan = Plan([plan], exact=True)
        missing = self.plan.columns - self.weight.shape[1]
        if missing:
            self.weight.data = nn.functional.pad(self.weight.data, (0, missing))
            self.weight.grad = None
        self.genome_id.view(-1)[slot] = genome.genome_id
        self._load_weights(slot)

    def separate(self, optimizer: torch.optim.Optimizer) -> None:
        """Let an optimiser of your own treat each network as a parameter of its own, from now on.

        Without this it has one state for all networks: after `replace` a newborn goes on with the
        moments of the network before, and a shape no longer fits where `weight` grew. With it, a
        newborn begins like any new parameter, and steps equal those of an optimiser for each
        network. Gradients stay in `weight.grad`, and settings and schedules in its group. For
        optimisers that treat parameters one by one, which torch's do, but for LBFGS.

        Args:
            optimizer: Over `parameters()`, before its first step.

        Raises:
            ValueError: If it does not hold `weight`, or made a step already.

        Example:
            >>> optimizer = torch.optim.Adam(network.parameters(), lr=0.01)
            >>> network.separate(optimizer)
        """
        SeparateStates(self, optimizer)

    @torch.no_grad()
    def load_weights(self, saved: Tensor | np.ndarray) -> None:
        """Take over all weights [networks, columns] of another network of the same genomes.

        It may have been made with more or fewer spare columns, which hold zeros.
        """
        self.weight.copy_(fitted(saved, self.weight))

    @torch.no_grad()
    def _load_weights(self, slot: int) -> None:
        genome, plan = self._genomes[slot], self._plans[slot]
        row = np.zeros(self.weight.shape[1], np.float32)
        row[self.plan.place(plan.column)] = genome.link_weight[plan.enabled]
        self.weight[slot] = torch.from_numpy(row).to(self.weight)

    def _check_interface(self, genome: Genome, plan: GenomePlan) -> None:
        need, schema = plan.need, self._genomes[0].observation_schema
        if (need.inputs, need.outputs) != (self.inputs, self.outputs):
            raise ValueError(
                f"genome {genome.genome_id} has {need.inputs} inputs and {need.outputs} outputs; "
                f"the population's networks have {self.inputs} and {self.outputs}"
            )
        if genome.observation_schema != schema:
            raise ValueError(
                f"genome {genome.genome_id} reads the observations "
                f"{genome.observation_schema!r}; the population's networks read {schema!r}"
            )

    def _read(self, weight: Tensor, observation: Any) -> Tensor:
        """The observation as a tensor of the weights' dtype, once its shape is checked."""
        if not isinstance(observation, Tensor):
            observation = torch.as_tensor(observation, device=weight.device)
        if torch._C._get_tracing_state() is None:  # for torch.jit.trace, sizes are no numbers
            self._check_shapes(weight, observation.shape)
        if observation.dtype is weight.dtype:
            return observation
        if observation.is_complex():
            raise ValueError(f"expected an observation of real numbers, got {observation.dtype}")
        return observation.to(weight.dtype)

    def _check_shapes(self, weight: Tensor, shape: torch.Size) -> None:
        lead = len(self.shape)
        if len(shape) <= lead or shape[:lead] != self.shape or shape[-1] != self.inputs:
            expected = ", ".join([*map(str, self.shape), "*batch", str(self.inputs)])
            raise ValueError(f"expected an observation of shape [{expected}], got {list(shape)}")
        if weight.shape != (columns := (len(self._plans), self.plan.columns)):
            raise ValueError(f"expected weights of shape {list(columns)}, got {list(weight.shape)}")

    def _recall(self, weight: Tensor, state: Any, observation: Tensor) -> Tensor:
        """The state as a tensor of the weights' dtype, once its shape is checked."""
        if not isinstance(state, Tensor):
            state = torch.as_tensor(state, device=weight.device)
        expected = (*observation.shape[:-1], self.plan.layout.state)
        if torch._C._get_tracing_state() is not None:
            return state.to(weight.dtype)
        if state.shape == expected and state.dtype is weight.dtype:
            return state
        if state.shape != expected or not state.is_floating_point():
            none = "" if self.state_size else ", as these networks keep none"
            raise ValueError(
                f"expected a state of floats of shape {list(expected)}{none}, for an observation "
                f"of shape {list(observation.shape)}; got {state.dtype} of shape "
                f"{list(state.shape)}. initial_state(batch) gives the first one"
            )
        return state.to(weight.dtype)

    def extra_repr(self) -> str:
        """What `repr` shows."""
        needs = [plan.need for plan in self._plans]
        sizes = {
            "hidden": [need.hidden for need in needs],
            "links": [len(plan.enabled) for plan in self._plans],
        }
        told = {"shape": tuple(self.shape)} if self.shape else {}
        told |= {"inputs": self.inputs, "outputs": self.outputs}
        told |= {name: _range(size) for name, size in sizes.items()}
        recurrent = any(need.state for need in needs)
        told |= {"evaluation": repr(self.evaluation), "recurrent": recurrent}
        return ", ".join(f"{name}={value}" for name, value in told.items())

    def get_extra_state(self) -> Tensor:
        """Digests of the graphs that the weights belong to, for `state_dict` [networks, 16]."""
        digests = b"".join(plan.digest for plan in self._plans)
        return torch.frombuffer(bytearray(digests), dtype=torch.uint8).view(len(self._plans), -1)

    def set_extra_state(self, state: Tensor) -> None:
        """Nothing: `_load_from_state_dict` has compared the digests before."""

    def _load_from_state_dict(
        self, state_dict: dict[str, Any], prefix: str, *others: Any, **more: Any
    ) -> None:
        """Take over the weights of the same graphs, with more or fewer spare columns; no others."""
        name, own = f"{prefix}weight", self.get_extra_state()
        graphs = state_dict.get(f"{prefix}_extra_state")
        if graphs is not None:
            graphs = graphs.cpu()
            if graphs.shape != own.shape or (graphs != own).any():
                errors: list[str] = more.get("error_msgs") or others[-1]
                errors.append(_other_graphs(graphs, own, repr(self)))
                return
            if name in state_dict and state_dict[name].shape != self.weight.shape:
                state_dict[name] = fitted(state_dict[name], self.weight)
        super()._load_from_state_dict(state_dict, prefix, *others, **more)


_FORGETS = (
    "these networks keep a state, and a call without one begins anew: call step(observation, "
    "state), which takes and gives the state, or stateful(), which keeps it"
)


def _range(sizes: Sequence[int]) -> str:
    least, most = min(sizes), max(sizes)
    return str(most) if least == most else f"{least}..{most}"


def _other_graphs(found: Tensor, own: Tensor, network: str) -> str:
    """Why a state cannot be loaded, by the digests of its graphs and of our own."""
    which = f"those of {len(found)} networks"
    if found.shape == own.shape:
        slots = (found != own).any(1).nonzero().flatten().tolist()
        which = "another graph" if len(own) == 1 else f"other graphs in the slots {slots}"
    return (
        f"expected the weights of this graph, {network}; got {which}: other nodes, enabled links "
        "or activations, or another evaluation. Make the network of the genomes whose state it is"
    )


def fitted(values: Tensor | np.ndarray, own: Tensor) -> Tensor:
    """Values [..., old] on the device of `own` [..., columns], cut or padded to as many columns.

    Columns that only one of them has belong to no link or no node, and hold zeros.
    """
    values = torch.as_tensor(values).to(own)
    return nn.functional.pad(values, (0, own.shape[-1] - values.shape[-1]))


class GenomeNetwork(PopulationNetwork):
    """The network of one genome: a drop-in module, `[..., inputs] -> [..., outputs]`.

    It is a `PopulationNetwork` of one without leading dimensions, so it trains, moves between
    devices, copies, saves (`state_dict`) and exports (`torch.export`) like any other module. Its
    parameters are the enabled links: `weight` is [1, links], without spare columns.

    Args:
        genome: The genome to compile.
        evaluation: `settle` or `synchronous`, see `PopulationNetwork`.

    Example:
        >>> network = GenomeNetwork(load_genome("champion.json"))
        >>> outputs = network(torch.rand(32, network.inputs))
    """

    _exact = True

    def __init__(self, genome: Genome, *, evaluation: Evaluation = "settle") -> None:
        super().__init__([genome], shape=(), evaluation=evaluation)
        # Whoever traces (torch.compile, a strict torch.export) must find it made.
        self.plan.levels(self.weight.device)

    def genome(self, slot: int = 0) -> Genome:
        """The genome with the weights that the network has now, bit for bit."""
        return super().genome(slot)
