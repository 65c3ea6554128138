"""One network as Python that needs nothing installed, MicroPython included."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import Any

from neatq_torch.genome import ACTIVATIONS, Genome
from neatq_torch.interop.recipe import Recipe, Scaling, described, scaling_columns
from neatq_torch.network import Evaluation

PYTHON_FORMULAS = {
    "identity": "x",
    "sigmoid": "0.5 + 0.5 * math.tanh(0.5 * x)",
    "steep_sigmoid": "0.5 + 0.5 * math.tanh(2.45 * x)",
    "tanh": "math.tanh(x)",
    "relu": "0.0 if x <= 0.0 else x",
}

_STEP_FUNCTION = '''

def step(observation, state=(0.0,) * STATE):
    """Outputs for an observation, and the state for the next call."""
    if len(observation) != INPUTS or len(state) != STATE:
        raise ValueError("expected %d inputs and a state of %d" % (INPUTS, STATE))
    value = [{read}]
    value += [1.0, *state]
    for activate, links in NODES:
        total = 0.0
        for weight, source in links:
            total += weight * value[source]
        value.append(activate(total))
    return [value[i] for i in RESULT], [value[i] for i in KEPT]
'''


def to_python(
    genome: Genome,
    *,
    evaluation: Evaluation = "settle",
    scaling: Scaling | None = None,
    comment: Sequence[str] = (),
) -> str:
    """The network of a genome as plain Python: numbers and loops, `math.tanh` and no library.

    It defines `step(observation, state) -> (output, state)` on lists of numbers, where the state of
    the first call may be left out, and `INPUTS`, `OUTPUTS` and `STATE`. It computes in the
    precision of Python's numbers, with the weights that the genome has, to the last bit.

    Args:
        genome: The network; disabled links are left out.
        evaluation: As `GenomeNetwork` has it.
        scaling: See `to_c`.
        comment: Lines more at the top of the file, such as what the outputs mean.

    Returns:
        The source.

    Raises:
        ConfigError: The scaling does not fit the inputs.

    Example:
        >>> Path("champion.py").write_text(to_python(genome))
    """
    recipe = Recipe.of(genome, evaluation)
    used = sorted({node.activation for node in recipe.nodes}, key=ACTIVATIONS.index)
    about = "step(observation, state) -> (output, state): lists of INPUTS, STATE, OUTPUTS numbers."
    read = "float(x) for x in observation"
    numbers: dict[str, Any] = {}
    if scaling is not None:
        offset, scale = scaling_columns(scaling, recipe.inputs)
        numbers = {"OFFSET": tuple(offset.tolist()), "SCALE": tuple(scale.tolist())}
        largest = float(scaling[2])
        read = f"min(max((x - o) / s, -{largest}), {largest})"
        read += " for x, o, s in zip(observation, OFFSET, SCALE)"
    lines = [f"# {line}".rstrip() for line in (*described(genome, recipe, comment), about)]
    lines += ["import math", ""]
    sizes = {"INPUTS": recipe.inputs, "OUTPUTS": len(recipe.outputs), "STATE": recipe.state}
    lines += [f"{name} = {size}" for name, size in sizes.items()]
    lines += [_tuple_text(f"{name} = ", values) for name, values in numbers.items()]
    for one in used:
        lines += ["", "", f"def {one}(x):", f"    return {PYTHON_FORMULAS[one]}"]
    lines += ["", "", "# Values stand in this order: inputs, 1 for the bias, state, nodes."]
    lines += ["NODES = (  # activation, and (weight, value that it weighs) of each link"]
    for node in recipe.nodes:
        links = tuple(zip(map(float, node.weights), node.sources, strict=True))
        lines += [textwrap.indent(f"({node.activation}, {_tuple_text('', links)}),", "    ")]
    lines += [")", f"RESULT = {recipe.outputs}", f"KEPT = {recipe.kept}", ""]
    return "\n".join(lines) + _STEP_FUNCTION.format(read=read)


def _tuple_text(name: str, values: tuple[Any, ...]) -> str:
    return "\n".join(textwrap.wrap(f"{name}{values}", 92, subsequent_indent="    "))
