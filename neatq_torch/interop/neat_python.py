"""Networks of neat-python: from its JSON export, its objects, its pickles and its checkpoints."""

from __future__ import annotations

import gzip
import io
import pickle
from pathlib import Path
from typing import Any, Literal

import msgspec

from neatq_torch.genome import GenomeError
from neatq_torch.interop.extras import refuse_missing
from neatq_torch.interop.neat_python_network import NeatPythonNetwork, NeatPythonNode

GZIP, PICKLE = b"\x1f\x8b", b"\x80"
PLAIN = {
    *(("builtins", name) for name in ("bool", "dict", "float", "int", "list", "set", "str")),
    ("itertools", "count"),
}
"""What a pickle of neat-python's may hold beside its own classes."""


class ExportedFunction(msgspec.Struct):
    """An activation or aggregation in neat-python's JSON export."""

    name: str
    custom: bool = False


class ExportedNode(msgspec.Struct):
    """A node there. Other keys are left alone, here and below."""

    id: int
    type: Literal["input", "hidden", "output"]
    activation: ExportedFunction
    aggregation: ExportedFunction
    bias: float
    response: float


class ExportedLink(msgspec.Struct, rename={"source": "from", "target": "to"}):
    """A connection there."""

    source: int
    target: int
    weight: float
    enabled: bool


class ExportedTopology(msgspec.Struct):
    """Which nodes are inputs and outputs there."""

    input_keys: list[int]
    output_keys: list[int]


class ExportedNetwork(msgspec.Struct):
    """The whole file."""

    format_version: str
    network_type: str
    topology: ExportedTopology
    nodes: list[ExportedNode]
    connections: list[ExportedLink]


def load_neat_python(source: Any, *, config: Any = None) -> NeatPythonNetwork:
    """A network of neat-python as a torch module that computes the same.

    Args:
        source: The path of a file: neat-python's JSON export (`neat.export`), or, where neat-python
            is installed, a pickled genome or network or a checkpoint, of which the fittest genome
            is taken. Or one of neat-python's objects: a genome, a `FeedForwardNetwork` or a
            `RecurrentNetwork`. Nothing but neat-python's own classes is loaded from a pickle.
        config: For a genome: neat-python's `Config` or the path of its file, whose `feed_forward`
            says as which of the two networks the genome is read. A checkpoint has its own.

    Returns:
        The network; its `genome()` is a genome of ours that does the same, where there is one.

    Raises:
        GenomeError: The file is damaged or something else; or the network has what cannot be
            carried (a function of yours, continuous time, spikes), which the message names.
        ModuleNotFoundError: neat-python is needed and not installed.
        OSError: The file cannot be read.

    Example:
        >>> network = load_neat_python("winner.json")
        >>> genome = load_neat_python("winner.pickle", config="config-feedforward").genome()
    """
    if isinstance(source, str | Path):
        path = Path(source)
        data = path.read_bytes()
        try:
            if not data.startswith((GZIP, PICKLE)):
                return _from_export(data)
            refuse_missing(f"{path}: a pickle of neat-python", neat="neat-python")
            found, own = _unpickled(data)
            return _from_object(found, own if config is None else config)
        except GenomeError as error:
            raise GenomeError(f"{path}: {error}") from error
    return _from_object(source, config)


def _from_export(data: bytes) -> NeatPythonNetwork:
    try:
        file = msgspec.json.decode(data, type=ExportedNetwork)
    except (msgspec.MsgspecError, RecursionError, UnicodeDecodeError) as error:
        raise GenomeError(
            f"expected a JSON export, a pickle or a checkpoint of neat-python: {error}."
        ) from error
    if file.network_type not in ("feedforward", "recurrent"):
        raise GenomeError(
            f"a network of the type {file.network_type!r} cannot be carried: networks here have "
            "neither continuous time nor spikes; expected 'feedforward' or 'recurrent'."
        )
    if not file.format_version.startswith("1."):
        raise GenomeError(f"expected version 1 of the format, got {file.format_version!r}.")
    links: dict[int, list[tuple[int, float]]] = {node.id: [] for node in file.nodes}
    for link in file.connections:
        if link.target not in links:
            raise GenomeError(f"the link from {link.source} to {link.target} leads nowhere.")
        if link.enabled:
            links[link.target].append((link.source, link.weight))
    nodes = [
        NeatPythonNode(
            node.id,
            _word(node.activation),
            _word(node.aggregation),
            node.bias,
            node.response,
            tuple(links[node.id]),
        )
        for node in file.nodes
        if node.type != "input"
    ]
    keys = file.topology.input_keys, file.topology.output_keys
    return NeatPythonNetwork(*keys, nodes, recurrent=file.network_type == "recurrent")


def _word(function: ExportedFunction) -> str:
    return f"{function.name} (custom)" if function.custom else function.name


def _from_object(found: Any, config: Any) -> NeatPythonNetwork:
    refuse_missing("a genome or network of neat-python", neat="neat-python")
    import neat

    if isinstance(found, neat.DefaultGenome):
        if isinstance(config, str | Path):
            parts = neat.DefaultGenome, neat.DefaultReproduction, neat.DefaultSpeciesSet
            config = neat.Config(*parts, neat.DefaultStagnation, str(config))
        if not isinstance(config, neat.Config):
            raise GenomeError(
                "a genome of neat-python is read with its configuration: expected config=, a "
                f"neat.Config or the path of its file; got {config!r}."
            )
        forward = config.genome_config.feed_forward
        kind = neat.nn.FeedForwardNetwork if forward else neat.nn.RecurrentNetwork
        found = kind.create(found, config)
    if not isinstance(found, neat.nn.FeedForwardNetwork | neat.nn.RecurrentNetwork):
        raise GenomeError(
            "expected the path of a file, or a genome, FeedForwardNetwork or RecurrentNetwork of "
            f"neat-python; got {type(found).__name__}."
        )
    nodes = [
        NeatPythonNode(
            key,
            _name_of(activation, "activation"),
            _name_of(aggregation, "aggregation"),
            bias,
            response,
            tuple(links),
        )
        for key, activation, aggregation, bias, response, links in found.node_evals
    ]
    recurrent = isinstance(found, neat.nn.RecurrentNetwork)
    return NeatPythonNetwork(found.input_nodes, found.output_nodes, nodes, recurrent=recurrent)


def _name_of(function: Any, kind: str) -> str:
    """What neat-python calls one of its functions; others keep their own name."""
    own = function.__module__ == f"neat.{kind}s"
    name = function.__qualname__
    return name.removesuffix(f"_{kind}") if own else f"{function.__module__}.{name}"


class _NeatUnpickler(pickle.Unpickler):
    """Loads what is neat-python's own, and plain values: a pickle could run anything else."""

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) in PLAIN:
            return super().find_class(module, name)
        if module.partition(".")[0] == "neat" and "." not in name:
            value = super().find_class(module, name)
            if getattr(value, "__module__", "").partition(".")[0] == "neat":
                return value
        raise GenomeError(
            f"the pickle holds {module}.{name}, which is not neat-python's; load it yourself with "
            "pickle.load if you trust it, and give its genome and config."
        )


def _unpickled(data: bytes) -> tuple[Any, Any]:
    """What a pickle or a checkpoint holds: a genome or network, and the config of a checkpoint."""
    checkpoint = data.startswith(GZIP)
    try:
        found = _NeatUnpickler(io.BytesIO(gzip.decompress(data) if checkpoint else data)).load()
        if not checkpoint:
            return found, None
        _, config, population, *_ = found
    except GenomeError:
        raise
    except Exception as error:  # a damaged pickle can raise anything
        words = f"{type(error).__name__}: {error}"
        raise GenomeError(f"damaged, or no pickle of neat-python: {words}.") from error
    judged = [genome for genome in population.values() if genome.fitness is not None]
    if not judged:
        raise GenomeError(
            "no genome in the checkpoint has a fitness: neat-python saves before it judges; "
            "restore it with neat.Checkpointer.restore_checkpoint, and give one of its genomes."
        )
    return max(judged, key=lambda genome: genome.fitness), config
