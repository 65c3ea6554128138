"""Networks as ONNX files, for ONNX Runtime and whatever reads such files."""

from __future__ import annotations

import copy
import logging
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from neatq_torch.atomic import write_atomic
from neatq_torch.interop.extras import refuse_missing
from neatq_torch.network.stateful import Stepping


class _Call(nn.Module):
    """One call of a network, with the state in and out where there is one."""

    def __init__(self, network: Stepping) -> None:
        super().__init__()
        self.network = network

    def forward(self, observation: Tensor, state: Tensor | None = None) -> tuple[Tensor, ...]:
        if state is None:
            empty = self.network.initial_state(observation.shape[:1])
            return self.network.step(observation, empty)[:1]
        return self.network.step(observation, state)


def to_onnx(
    network: Stepping,
    path: Path | str,
    *,
    output_name: str = "output",
    metadata: Mapping[str, str] | None = None,
) -> None:
    """Write a network as an ONNX file, by torch's exporter ("dynamo").

    The file takes `observation` [batch, inputs] and gives `output` [batch, outputs], in the
    precision of the network's weights, for any batch. A network with recurrent links, or one that
    is evaluated synchronously, takes `state` [batch, state_size], too, and gives `next_state`:
    zeros where an episode begins, then what the call before gave.

    Args:
        network: A `GenomeNetwork`, or another module with its `inputs`, `state_size`,
            `initial_state` and `step`. It stays as it is.
        path: The file to write, whole or not at all.
        output_name: What the file calls the output.
        metadata: Texts that the file carries with it.

    Raises:
        ModuleNotFoundError: onnx or onnxscript are not installed.
        TypeError: The network lacks what it must have; networks of a whole population are written
            one by one.

    Example:
        >>> to_onnx(GenomeNetwork(genome), "champion.onnx")
        >>> session = onnxruntime.InferenceSession("champion.onnx")
        >>> (output,) = session.run(None, {"observation": observations})
    """
    refuse_missing("to_onnx", onnx="neatq_torch[onnx]", onnxscript="neatq_torch[onnx]")
    fits = isinstance(network, Stepping) and hasattr(network, "inputs")
    if not fits or network.initial_state().ndim != 1:
        raise TypeError(
            f"to_onnx: expected the network of one genome, such as GenomeNetwork(genome); got "
            f"{type(network).__name__}."
        )
    own: Any = copy.deepcopy(network)
    state = own.cpu().eval().initial_state((2,))
    tensors, names = (state.new_zeros(2, own.inputs),), ["observation"]
    if own.state_size:
        tensors, names = (*tensors, state), [*names, "state"]
    outputs = [output_name, "next_state"][: len(names)]
    program = _exported(_Call(own).eval(), tensors, names, outputs)
    model = program.model_proto
    for key, text in (metadata or {}).items():
        model.metadata_props.add(key=key, value=text)
    write_atomic(Path(path), model.SerializeToString())


def _exported(
    module: nn.Module, tensors: tuple[Tensor, ...], inputs: list[str], outputs: list[str]
) -> Any:
    """What torch's exporter makes, without its words on other people's packages."""
    log = logging.getLogger("torch.onnx")
    level = log.level
    log.setLevel(logging.ERROR)
    shapes = ({0: torch.export.Dim("batch")},) * len(tensors)
    try:
        with warnings.catch_warnings(), torch.no_grad():
            warnings.simplefilter("ignore")
            # Not left to torch.onnx, which falls back to a single size of batch without a word.
            program = torch.export.export(module, tensors, dynamic_shapes=shapes)
            return torch.onnx.export(
                program,
                dynamo=True,
                verbose=False,
                external_data=False,
                input_names=inputs,
                output_names=outputs,
            )
    finally:
        log.setLevel(level)
