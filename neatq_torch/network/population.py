"""All networks of a population, or the one of a genome, as a differentiable module."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
import torch
from torch import Tensor, nn

from neatq_torch.genome.genome import Genome
from neatq_torch.network import compiled
from neatq_torch.network.levels import Plan
from neatq_torch.network.plan import Evaluation, GenomePlan, compile_genome


class PopulationNetwork(nn.Module):
    """Networks of many genomes, evaluated together as one sparse graph.

    Every network has its own topology and its own weights; they share the numbers of inputs and
    outputs. The weights of all links are one parameter, so a loss that sums over networks gives
    each network its own gradient.

    Feed-forward use is `forward`. Networks with recurrent links, or evaluated synchronously, read
    values of the call before: `step` takes and returns them, so a network is a pure function
    (observation, state) -> (output, state). Gradients do not flow into the calls before unless the
    caller keeps the state's graph.

    Plain float32 tensors on the CPU are evaluated, and their gradients computed, by compiled code,
    which takes seconds to compile at the first call on a machine. Any other dtype or device,
    transforms (`torch.func`, `torch.export`, `torch.compile`) and gradients of gradients take
    torch operations, which compute the same up to rounding.

    A hidden node or output without an incoming link has the value of its activation at 0.

    Args:
        genomes: One genome for each network, in row-major order of `shape`.
        shape: Leading dimensions of observations and outputs, such as (arenas, robots). Defaults
            to (len(genomes),).
        evaluation: See `Evaluation`.

    Attributes:
        inputs: Observations of each network, without the bias.
        outputs: Outputs of each network.
        weight: The weights of all links [networks, columns]; only `Plan` knows the columns.
            The parameter keeps its identity for ever; it grows when a genome needs more columns.
        genome_id: Whose network stands in each slot [*shape].

    Raises:
        ValueError: If genomes disagree in observations, inputs or outputs, or do not fill `shape`.

    Example:
        >>> network = PopulationNetwork(population.genomes)
        >>> outputs = network(torch.rand(*network.shape, network.inputs))
    """

    weight: nn.Parameter
    genome_id: Tensor

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
        self.plan = Plan(self._plans)
        self.weight = nn.Parameter(torch.zeros(len(genomes), self.plan.layout.columns))
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

    def forward(self, observation: Tensor, state: Tensor | None = None) -> Tensor:
        """Outputs [*shape, *batch, outputs] for observations [*shape, *batch, inputs].

        The batch of observations for each network may have any shape; without a state, see `step`,
        all start from the initial one.
        """
        if state is None:
            batch = observation.shape[len(self.shape) : -1]
            state = self.initial_state(batch) if self.state_size else observation[..., :0]
        return self.step(observation, state)[0]

    def step(self, observation: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """One call of every network.

        Args:
            observation: [*shape, *batch, inputs].
            state: [*shape, *batch, state_size], from `initial_state` or from the call before.

        Returns:
            Outputs [*shape, *batch, outputs] and the state for the next call.

        Raises:
            ValueError: If the observation's shape does not fit.
        """
        weight = self.weight
        self._check_shapes(weight, observation)
        if compiled.accepts(weight, observation, state):
            return compiled.evaluate(self.plan, weight, observation, state)
        return self.plan.levels(weight.device).evaluate(weight, observation, state)

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
        weights[plan.enabled] = row[plan.column]
        return weights

    @torch.no_grad()
    def replace(self, slot: int, genome: Genome) -> None:
        """Put a genome in a slot (flat). The other networks are not touched.

        Costs the size of the genome, unless it needs more room than the plan has: then every
        network gets more (and `weight` more columns, all of them zero).

        Raises:
            ValueError: If its observations, inputs or outputs differ from the population's.
        """
        plan = compile_genome(genome, self.evaluation)
        self._check_interface(genome, plan)
        self._genomes[slot], self._plans[slot] = genome, plan
        self.plan.write(slot, plan)
        missing = self.plan.layout.columns - self.weight.shape[1]
        if missing:
            self.weight.data = nn.functional.pad(self.weight.data, (0, missing))
            self.weight.grad = None
        self.genome_id.view(-1)[slot] = genome.genome_id
        self._load_weights(slot)

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
        row[plan.column] = genome.link_weight[plan.enabled]
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

    def _check_shapes(self, weight: Tensor, observation: Tensor) -> None:
        shape, lead, layout = observation.shape, len(self.shape), self.plan.layout
        if shape[:lead] != self.shape or shape[-1] != layout.inputs:
            raise ValueError(
                f"expected an observation of shape [{', '.join(map(str, self.shape))}, *batch, "
                f"{layout.inputs}], got {list(shape)}"
            )
        if weight.shape != (expected := (len(self._plans), layout.columns)):
            raise ValueError(
                f"expected weights of shape {list(expected)}, got {list(weight.shape)}"
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
    devices, copies, saves (`state_dict`) and exports (`torch.export`) like any other module.

    Args:
        genome: The genome to compile.
        evaluation: `settle` or `synchronous`, see `PopulationNetwork`.

    Example:
        >>> network = GenomeNetwork(load_genome("champion.json"))
        >>> outputs = network(torch.rand(32, network.inputs))
    """

    def __init__(self, genome: Genome, *, evaluation: Evaluation = "settle") -> None:
        super().__init__([genome], shape=(), evaluation=evaluation)
        # Whoever traces (torch.compile, a strict torch.export) must find it made.
        self.plan.levels(self.weight.device)

    def genome(self, slot: int = 0) -> Genome:
        """The genome with the weights that the network has now, bit for bit."""
        return super().genome(slot)
