"""All networks of a population as one differentiable module."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Self

import numpy as np
import torch
from torch import Tensor, nn

from neatq_torch.genome.genome import ACTIVATIONS, Genome
from neatq_torch.network.plan import Evaluation, GenomePlan, Layout, Plan, compile_genome


def _sigmoid(x: Tensor) -> Tensor:
    """The logistic function, with the same bits wherever a value stands in the tensor.

    `torch.sigmoid` computes whole vectors in one way and the rest of a tensor in another, which
    can differ in the last bit: a network's outputs would depend on what stands beside it.
    """
    return torch.tanh(0.5 * x) * 0.5 + 0.5


_FUNCTIONS = {
    "identity": lambda x: x,
    "sigmoid": _sigmoid,
    "steep_sigmoid": lambda x: _sigmoid(4.9 * x),
    "tanh": torch.tanh,
    "relu": torch.relu,
}


def _product(inputs: Tensor, weight: Tensor) -> Tensor:
    """[networks, batch, outputs] from [networks, batch, inputs] and [networks, outputs, inputs].

    Every network's matrices are padded to begin on a 64-byte border. Matrix products of the CPU
    round differently with the alignment of their operands, so a network's outputs would depend on
    its place in the population.
    """
    outputs, inner, outer = weight.shape[1], -weight.shape[2] % 16, -weight.shape[1] % 16
    weight = nn.functional.pad(weight, (0, inner, 0, outer))
    return torch.bmm(nn.functional.pad(inputs, (0, inner)), weight.mT)[..., :outputs]


class PopulationNetwork(nn.Module):
    """Networks of many genomes, evaluated together as one sparse graph.

    Every network has its own topology and its own weights; they share the numbers of inputs and
    outputs. The weights of all links are one parameter, so a loss that sums over networks gives
    each network its own gradient.

    Feed-forward use is `forward`. Networks with recurrent links, or evaluated synchronously, read
    values of the call before: `step` takes and returns them, so a network is a pure function
    (observation, state) -> (output, state). Gradients do not flow into the calls before unless the
    caller keeps the state's graph.

    A hidden node or output without an incoming link has the value of its activation at 0.

    Args:
        genomes: One genome for each network, in row-major order of `shape`.
        shape: Leading dimensions of observations and outputs, such as (arenas, robots). Defaults
            to (len(genomes),).
        evaluation: `settle` (forward links in order within one call) or `synchronous` (one
            propagation a call, as in OpenNERO).

    Attributes:
        weight: The weights of all links [networks, columns]; only `Plan` knows the columns.
            The parameter keeps its identity for ever; it grows when a genome needs more columns.
        genome_id: Whose network stands in each place [*shape].

    Raises:
        ValueError: If genomes disagree in observations, inputs or outputs, or do not fill `shape`.
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
        for genome, plan in zip(genomes, self._plans, strict=True):
            self._check_interface(genome, plan)
        self.plan = Plan(self._plans, Layout.union([p.need for p in self._plans]).with_slack())
        self.weight = nn.Parameter(torch.zeros(len(genomes), self.plan.layout.columns))
        identities = torch.tensor([g.genome_id for g in genomes], dtype=torch.long)
        self.register_buffer("genome_id", identities.view(self.shape), persistent=False)
        for index in range(len(genomes)):
            self._load_weights(index)

    @property
    def inputs(self) -> int:
        """Observations of each network, without the bias."""
        return self._plans[0].need.inputs

    @property
    def outputs(self) -> int:
        """Outputs of each network."""
        return self._plans[0].need.outputs

    @property
    def state_size(self) -> int:
        """Values that each network keeps from one call to the next; 0 if none is recurrent."""
        return self.plan.layout.state

    def initial_state(self, batch: Sequence[int] = ()) -> Tensor:
        """The state of a network that has seen nothing: zeros [*shape, *batch, state_size]."""
        return self.weight.new_zeros(*self.shape, *batch, self.state_size)

    def forward(self, observation: Tensor) -> Tensor:
        """Evaluate every network on its own observations, from the initial state.

        Args:
            observation: [*shape, *batch, inputs]; any batch of observations for each network.

        Returns:
            Outputs [*shape, *batch, outputs].
        """
        batch = observation.shape[len(self.shape) : -1]
        return self.step(observation, self.initial_state(batch))[0]

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
        self._check_observation(observation)
        batch = observation.shape[len(self.shape) : -1]
        layout, networks = self.plan.layout, len(self._plans)
        rows = observation.reshape(networks, math.prod(batch), layout.inputs)
        inputs = torch.cat([rows, rows.new_ones(*rows.shape[:2], 1)], 2)
        memory = state.reshape(networks, rows.shape[1], layout.state)
        values = self._propagate(inputs, memory)
        nodes = values[:, layout.first_hidden : -1]
        final = self._activate(nodes, self.plan.activation)
        output = (
            final[:, layout.hidden :].transpose(1, 2).reshape(*self.shape, *batch, self.outputs)
        )
        if not layout.state:
            return output, state
        values = torch.cat([values[:, : layout.first_hidden], final, values[:, -1:]], 1)
        kept = values.flatten(0, 1).index_select(0, self.plan.state_row)
        kept = kept.view(networks, layout.state, rows.shape[1]).transpose(1, 2)
        return output, kept.reshape(*self.shape, *batch, layout.state)

    def _propagate(self, inputs: Tensor, memory: Tensor) -> Tensor:
        """Sums of all nodes, those that pass values on within the call activated.

        Args:
            inputs: Observations and bias [networks, batch, inputs + 1].
            memory: State [networks, batch, state].

        Returns:
            Values of all places [networks, rows, batch].
        """
        layout = self.plan.layout
        networks, batch = inputs.shape[:2]
        dense = self.weight[:, : layout.dense] * self.plan.live
        dense = dense.view(networks, layout.outputs, layout.inputs + 1)
        sums = _product(inputs, dense)
        zero = inputs.new_zeros(networks, max(layout.hidden, 1), batch)
        values = torch.cat(
            [
                inputs.transpose(1, 2),
                memory.transpose(1, 2),
                zero[:, : layout.hidden],
                sums.transpose(1, 2),
                zero[:, :1],
            ],
            1,
        )
        flat, weight = values.view(-1, batch), self.weight.view(-1)
        for level in self.plan.levels:
            if len(level.node):
                active = self._activate(flat.index_select(0, level.node), level.activation)
                flat.index_copy_(0, level.node, active)
            passed = flat.index_select(0, level.source)
            passed = passed * weight.index_select(0, level.column).unsqueeze(1)
            flat.index_add_(0, level.target, passed)
        return values

    def _activate(self, sums: Tensor, activation: Tensor) -> Tensor:
        """Apply to each row of `sums` its own activation (`activation` broadcasts)."""
        first, *others = self.plan.activations
        result = _FUNCTIONS[ACTIVATIONS[first]](sums)
        for code in others:
            result = torch.where(activation == code, _FUNCTIONS[ACTIVATIONS[code]](sums), result)
        return result

    def genome(self, index: int) -> Genome:
        """The genome in place `index` (flat), with the weights that its network has now.

        The weights are copied bit for bit; disabled links keep the genome's own.

        Raises:
            GenomeError: If a weight is not finite.
        """
        return self._with_weights(index, self.weight.detach()[index].cpu().numpy())

    def genomes(self) -> list[Genome]:
        """All genomes with the weights that their networks have now, in flat order."""
        rows = self.weight.detach().cpu().numpy()
        return [self._with_weights(index, row) for index, row in enumerate(rows)]

    def _with_weights(self, index: int, row: np.ndarray) -> Genome:
        genome, plan = self._genomes[index], self._plans[index]
        weights = genome.link_weight.copy()
        weights[plan.enabled] = row[plan.column]
        return genome.with_weights(weights)

    @torch.no_grad()
    def replace(self, index: int, genome: Genome) -> None:
        """Put a genome in place `index` (flat). The other networks are not touched.

        Costs the size of the genome, unless it needs more places than the plan has: then the plan
        is laid out again with more room (and `weight` may get more columns, all of them zero).

        Raises:
            ValueError: If its observations, inputs or outputs differ from the population's.
        """
        plan = compile_genome(genome, self.evaluation)
        self._check_interface(genome, plan)
        self._genomes[index], self._plans[index] = genome, plan
        if self.plan.layout.holds(plan.need):
            self.plan.write(index, plan)
        else:
            self._make_room()
        self.genome_id.view(-1)[index] = genome.genome_id
        self._load_weights(index)

    @torch.no_grad()
    def load_weights(self, saved: Tensor | np.ndarray) -> None:
        """Take over all weights from `weight` of another network of the same genomes.

        Args:
            saved: [networks, columns]. The other network may have been made with more or fewer
                spare columns, which hold zeros.
        """
        rows = torch.as_tensor(saved).to(self.weight)
        missing = self.weight.shape[1] - rows.shape[1]
        self.weight.copy_(nn.functional.pad(rows, (0, missing)))

    def _apply(self, fn: Callable[[Tensor], Tensor], recurse: bool = True) -> Self:
        super()._apply(fn, recurse)
        self.plan.apply(fn)
        return self

    def _like_weight(self, tensor: Tensor) -> Tensor:
        return tensor.to(self.weight if tensor.is_floating_point() else self.weight.device)

    def _make_room(self) -> None:
        """Lay the plan out anew. Weights keep their columns; new columns are zero."""
        layout = Layout.union([plan.need for plan in self._plans]).with_slack()
        layout = replace(layout, sparse=max(layout.sparse, self.plan.layout.sparse))
        self.plan = Plan(self._plans, layout)
        self.plan.apply(self._like_weight)
        missing = layout.columns - self.weight.shape[1]
        if missing > 0:
            self.weight.data = nn.functional.pad(self.weight.data, (0, missing))
            self.weight.grad = None

    @torch.no_grad()
    def _load_weights(self, index: int) -> None:
        genome, plan = self._genomes[index], self._plans[index]
        row = np.zeros(self.weight.shape[1], np.float32)
        row[plan.column] = genome.link_weight[plan.enabled]
        self.weight[index] = torch.from_numpy(row).to(self.weight)

    def _check_interface(self, genome: Genome, plan: GenomePlan) -> None:
        expected = (self.inputs, self.outputs)
        if (plan.need.inputs, plan.need.outputs) != expected:
            raise ValueError(
                f"genome {genome.genome_id} has {plan.need.inputs} inputs and "
                f"{plan.need.outputs} outputs; the population's networks have {expected[0]} and "
                f"{expected[1]}"
            )

        schema = self._genomes[0].observation_schema
        if genome.observation_schema != schema:
            raise ValueError(
                f"genome {genome.genome_id} reads the observations "
                f"{genome.observation_schema!r}; the population's networks read {schema!r}"
            )

    def _check_observation(self, observation: Tensor) -> None:
        lead = len(self.shape)
        if observation.shape[:lead] != self.shape or observation.shape[-1] != self.inputs:
            raise ValueError(
                f"expected an observation of shape [{', '.join(map(str, self.shape))}, *batch, "
                f"{self.inputs}], got {list(observation.shape)}"
            )
