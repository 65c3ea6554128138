"""Networks of neat-python in torch operations, number for number."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from neatq_torch.genome import ACTIVATIONS, Genome, GenomeError, NodeKind


def _selu(z: Tensor) -> Tensor:
    rate, alpha = 1.0507009873554804934193349852946, 1.6732632423543772848170429916717
    return rate * torch.where(z > 0, z, alpha * torch.expm1(z.clamp(max=0)))


def _inv(z: Tensor) -> Tensor:
    zero = z == 0
    return torch.where(zero, 0, 1 / torch.where(zero, 1, z))


NEAT_PYTHON_ACTIVATIONS: dict[str, Callable[[Tensor], Tensor]] = {
    "sigmoid": lambda z: torch.sigmoid((5 * z).clamp(-60, 60)),
    "tanh": lambda z: torch.tanh((2.5 * z).clamp(-60, 60)),
    "sin": lambda z: torch.sin((5 * z).clamp(-60, 60)),
    "gauss": lambda z: torch.exp(-5 * z.clamp(-3.4, 3.4).square()),
    "relu": torch.relu,
    "elu": lambda z: torch.where(z > 0, z, torch.expm1(z.clamp(max=0))),
    "lelu": lambda z: torch.where(z > 0, z, 0.005 * z),
    "selu": _selu,
    "softplus": lambda z: 0.2 * torch.log1p(torch.exp((5 * z).clamp(-60, 60))),
    "identity": lambda z: z,
    "clamped": lambda z: z.clamp(-1, 1),
    "inv": _inv,
    "log": lambda z: torch.log(z.clamp(min=1e-7)),
    "exp": lambda z: torch.exp(z.clamp(-60, 60)),
    "abs": torch.abs,
    "hat": lambda z: (1 - z.abs()).clamp(min=0),
    "square": torch.square,
    "cube": lambda z: z**3,
}
"""Of a sum; neat-python has slopes of 5 and 2.5 in some, and limits against overflow."""


def _middle(x: Tensor) -> Tensor:
    ordered, links = x.sort(-1).values, x.shape[-1]
    return (ordered[..., (links - 1) // 2] + ordered[..., links // 2]) / 2


NEAT_PYTHON_AGGREGATIONS: dict[str, Callable[[Tensor], Tensor]] = {
    "sum": lambda x: x.sum(-1),
    "product": lambda x: x.prod(-1),
    "max": lambda x: x.amax(-1),
    "min": lambda x: x.amin(-1),
    "maxabs": lambda x: x.gather(-1, x.abs().argmax(-1, keepdim=True)).squeeze(-1),
    "median": _middle,
    "mean": lambda x: x.mean(-1),
}
"""Of weighted values [..., links], of which there is at least one."""

_SLOPES = {"sigmoid": 5.0, "tanh": 2.5, "relu": 1.0, "identity": 1.0}
"""Activations that our genomes have, too, and how much steeper neat-python's are."""


class NeatPythonNode(NamedTuple):
    """A node as neat-python evaluates it: activation(bias + response * aggregation(links))."""

    key: int
    activation: str
    aggregation: str
    bias: float
    response: float
    links: tuple[tuple[int, float], ...]

    @property
    def empty(self) -> float:
        """What neat-python's aggregation makes of no links."""
        return 1.0 if self.aggregation == "product" else 0.0


class NeatPythonNetwork(nn.Module):
    """A network of neat-python as a module: `[..., inputs] -> [..., outputs]`.

    It evaluates every node as neat-python does, in double precision, with all its activations and
    aggregations, and is differentiable in weights, biases and responses. Its `step` and state are
    those of `GenomeNetwork`, so it can be trained, exported and written by `to_onnx`. Where numbers
    grow beyond double precision it gives infinity; neat-python raises an OverflowError.

    Where a network of our own can say the same, `genome` gives its genome, which can evolve.

    Args:
        input_keys: neat-python's keys of the inputs, in the order of the observations.
        output_keys: Those of the outputs.
        nodes: In the order in which they are evaluated. A key that is none of them reads as 0, as
            in neat-python.
        recurrent: Whether links read the values of the call before (neat-python's
            `RecurrentNetwork`) or those of this one (`FeedForwardNetwork`).

    Attributes:
        inputs: Numbers of an observation.
        outputs: Numbers of an output.
        weight: Weights of all links, in the order of the nodes, float64 [links].
        bias: float64 [nodes].
        response: float64 [nodes].

    Raises:
        GenomeError: A node has an activation or aggregation that is not neat-python's own, or reads
            one that is not evaluated before it.

    Example:
        >>> network = load_neat_python("winner.json")
        >>> output = network(torch.rand(32, network.inputs))
    """

    def __init__(
        self,
        input_keys: Sequence[int],
        output_keys: Sequence[int],
        nodes: Sequence[NeatPythonNode],
        *,
        recurrent: bool,
    ) -> None:
        super().__init__()
        self.input_keys, self.output_keys = tuple(input_keys), tuple(output_keys)
        self.inputs, self.outputs = len(self.input_keys), len(self.output_keys)
        self.nodes, self.recurrent = tuple(nodes), recurrent
        self._check()
        weights = [weight for node in nodes for _, weight in node.links]
        columns = weights, [node.bias for node in nodes], [node.response for node in nodes]
        self.weight, self.bias, self.response = (
            nn.Parameter(torch.tensor(column, dtype=torch.float64)) for column in columns
        )

    @property
    def state_size(self) -> int:
        """Values that are kept from call to call: one for each node of a recurrent network."""
        return len(self.nodes) if self.recurrent else 0

    def initial_state(self, batch: Sequence[int] = ()) -> Tensor:
        """The state of a network that has seen nothing: zeros [*batch, state_size]."""
        return self.weight.new_zeros(*batch, self.state_size)

    def forward(self, observation: Tensor, state: Tensor | None = None) -> Tensor:
        """Outputs [*batch, outputs] for observations [*batch, inputs]; see `step`."""
        if state is None:
            state = self.initial_state(observation.shape[:-1])
        return self.step(observation, state)[0]

    def step(self, observation: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """One call, neat-python's `activate`.

        Args:
            observation: [*batch, inputs].
            state: [*batch, state_size], from `initial_state` or from the call before.

        Returns:
            Outputs [*batch, outputs] of the observation's dtype, if that is one of fractions, and
            the state for the next call.

        Raises:
            ValueError: A shape does not fit.
        """
        batch = observation.shape[:-1]
        for noun, tensor, width in (
            ("an observation", observation, self.inputs),
            ("a state", state, self.state_size),
        ):
            if tensor.shape != (*batch, width):
                expected = f"{noun} of shape [*batch, {width}]"
                raise ValueError(f"expected {expected}, got {list(tensor.shape)}")
        seen = observation.to(self.weight.dtype)
        now = dict(zip(self.input_keys, seen.unbind(-1), strict=True))
        before = now
        if self.recurrent:
            keys = (node.key for node in self.nodes)
            before = now | dict(zip(keys, state.unbind(-1), strict=True))
        zero, link = seen.new_zeros(batch), 0
        for number, node in enumerate(self.nodes):
            weight, link = self.weight[link : link + len(node.links)], link + len(node.links)
            total = zero + node.empty
            if node.links:
                read = [before.get(source, zero) for source, _ in node.links]
                passed = torch.stack(read, -1) * weight
                total = NEAT_PYTHON_AGGREGATIONS[node.aggregation](passed)
            total = self.bias[number] + self.response[number] * total
            now[node.key] = NEAT_PYTHON_ACTIVATIONS[node.activation](total)
        output = torch.stack([now.get(key, zero) for key in self.output_keys], -1)
        if self.recurrent and self.nodes:
            state = torch.stack([now[node.key] for node in self.nodes], -1)
        return output.to(observation.dtype) if observation.is_floating_point() else output, state

    def genome(self, *, genome_id: int = 0, observation_schema: str = "") -> Genome:
        """The same network as a genome of ours, with the parameters that it has now.

        Slopes, responses and means are part of the weights, biases are links from a bias node,
        which every node gets, and nodes that read the call before have recurrent links, so that
        `settle` and `synchronous` evaluate it alike. Weights are rounded to single precision.

        Raises:
            GenomeError: A node aggregates or activates as no genome of ours can; the message names
                it. The network itself can be used nevertheless.
        """
        places = {key: number for number, key in enumerate(self.input_keys, 1)}
        first = self.inputs + 2  # behind the bias
        hidden = [node.key for node in self.nodes if node.key not in self.output_keys]
        places |= {key: number for number, key in enumerate((*self.output_keys, *hidden), first)}
        links, activations = [], dict.fromkeys(places, 0)
        weights, biases, responses = (
            one.tolist() for one in (self.weight, self.bias, self.response)
        )
        for node, bias, response in zip(self.nodes, biases, responses, strict=True):
            slope, share = _folded(node)
            activations[node.key] = ACTIVATIONS.index(node.activation)
            own, weights = weights[: len(node.links)], weights[len(node.links) :]
            bias += response * node.empty if not node.links else 0.0
            links.append((self.inputs + 1, places[node.key], slope * bias, False))
            for (source, _), weight in zip(node.links, own, strict=True):
                if source in places:
                    late = self.recurrent and source not in self.input_keys
                    folded = slope * response * share * weight
                    links.append((places[source], places[node.key], folded, late))
        sources, targets, weights, late = zip(*links, strict=True) if links else [()] * 4
        kinds = [NodeKind.INPUT] * self.inputs + [NodeKind.BIAS]
        kinds += [NodeKind.OUTPUT] * self.outputs + [NodeKind.HIDDEN] * len(hidden)
        codes = list(activations.values())
        columns: dict[str, Any] = {
            "node_id": range(1, len(kinds) + 1),
            "node_kind": kinds,
            "node_activation": [*codes[: self.inputs], 0, *codes[self.inputs :]],
            "link_innovation": range(1, len(links) + 1),
            "link_source": sources,
            "link_target": targets,
            "link_weight": weights,
            "link_enabled": [True] * len(links),
            "link_recurrent": late,
        }
        return Genome(genome_id=genome_id, observation_schema=observation_schema, **columns)

    def extra_repr(self) -> str:
        """What `print` shows."""
        form = "recurrent" if self.recurrent else "feed-forward"
        links = self.weight.numel()
        return f"{form}, {self.inputs} inputs, {self.outputs} outputs, {links} links"

    def _check(self) -> None:
        seen: set[int] = set(self.input_keys)
        for node in self.nodes:
            _check_node(node)
            if node.key in seen:
                raise GenomeError(f"node {node.key} occurs more than once.")
            sources = [source for source, _ in node.links]
            for source in sources:
                if sources.count(source) > 1:
                    raise GenomeError(f"two links lead from {source} to {node.key}.")
                if not self.recurrent and source not in seen:
                    raise GenomeError(
                        f"node {node.key} reads node {source}, which is not evaluated before it; "
                        "a network with cycles is read as a recurrent one."
                    )
            seen.add(node.key)


def _check_node(node: NeatPythonNode) -> None:
    tables = NEAT_PYTHON_ACTIVATIONS, NEAT_PYTHON_AGGREGATIONS
    for noun, table in zip(("activation", "aggregation"), tables, strict=True):
        word = getattr(node, noun)
        if word not in table:
            raise GenomeError(
                f"node {node.key}: the {noun} {word!r} is none of neat-python's own, and what a "
                f"function of yours computes is not in its file; known are {', '.join(table)}."
            )


def _folded(node: NeatPythonNode) -> tuple[float, float]:
    """Slope of the activation and share of each link, by which weights are multiplied."""
    if node.activation not in _SLOPES:
        raise GenomeError(
            f"node {node.key}: the activation {node.activation!r} is none of a genome's "
            f"({', '.join(_SLOPES)}); use the network itself."
        )
    links = len(node.links)
    if node.aggregation == "mean" or (node.aggregation == "median" and links == 2):
        return _SLOPES[node.activation], 1 / max(links, 1)
    if node.aggregation != "sum" and links > 1:
        raise GenomeError(
            f"node {node.key}: the aggregation {node.aggregation!r} of {links} links is no sum, "
            "and nodes of a genome add up; use the network itself."
        )
    return _SLOPES[node.activation], 1.0
