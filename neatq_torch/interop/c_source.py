"""One network as a C header for programs and microcontrollers without any library."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterable, Sequence

import numpy as np

from neatq_torch.genome import ACTIVATIONS, Genome
from neatq_torch.interop.recipe import Recipe, Scaling, described, scaling_columns
from neatq_torch.kinds import ConfigError
from neatq_torch.network import Evaluation

C_FORMULAS = {
    "identity": "sum",
    "sigmoid": "0.5f + 0.5f * tanhf(0.5f * sum)",
    "steep_sigmoid": "0.5f + 0.5f * tanhf(2.45f * sum)",
    "tanh": "tanhf(sum)",
    "relu": "sum <= 0.0f ? 0.0f : sum",
}


def to_c(
    genome: Genome,
    *,
    evaluation: Evaluation = "settle",
    name: str = "network",
    scaling: Scaling | None = None,
    comment: Sequence[str] = (),
) -> str:
    """The network of a genome as a header in C99: numbers and loops, no memory from the heap.

    It defines `NAME_step(observation, output)`, with `state` between the two where the network
    keeps something from call to call, and the macros `NAME_INPUTS`, `NAME_OUTPUTS` and
    `NAME_STATE`. It computes in single precision, includes <math.h> alone and can be included from
    several files, and from C++.

    Args:
        genome: The network; disabled links are left out.
        evaluation: As `GenomeNetwork` has it.
        name: What the function and the macros begin with: letters, digits and "_".
        scaling: Offset and scale [inputs] and the largest value, for a network that was trained on
            scaled observations: it reads (observation - offset) / scale within +-largest.
        comment: Lines more at the top of the file, such as what the outputs mean.

    Returns:
        The text of the header.

    Raises:
        ConfigError: The name is no identifier of C, or the scaling does not fit the inputs.

    Example:
        >>> Path("champion.h").write_text(to_c(genome, name="champion"))
    """
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name):
        raise ConfigError(
            f"name: expected letters, digits and '_', a letter first, such as 'champion'; got "
            f"{name!r}."
        )
    recipe = Recipe.of(genome, evaluation)
    macro, state = name.upper(), "float *state, " if recipe.state else ""
    sizes = {"INPUTS": recipe.inputs, "OUTPUTS": len(recipe.outputs), "STATE": recipe.state}
    about = [*described(genome, recipe, comment), "", *_interface(name, macro, recipe)]
    body = [*_tables(recipe, scaling), *_body(recipe, scaling)]
    lines = [f"// {line}".rstrip() for line in about]
    lines += [f"#ifndef {macro}_H", f"#define {macro}_H", "", "#include <math.h>", ""]
    lines += [f"#define {macro}_{size} {number}" for size, number in sizes.items()]
    lines += ["", f"static inline void {name}_step(const float *observation, {state}float *output)"]
    lines += ["{", *(f"    {line}".rstrip() for line in body), "}", "", "#endif", ""]
    return "\n".join(lines)


def _interface(name: str, macro: str, recipe: Recipe) -> list[str]:
    lines = [f"{name}_step reads observation[{macro}_INPUTS] and writes output[{macro}_OUTPUTS]."]
    if recipe.state:
        lines.append(
            f"state[{macro}_STATE] is zeros where an episode begins; every call renews it."
        )
    values = recipe.first_node + len(recipe.nodes)
    return [*lines, f"A call takes {4 * values} bytes of stack."]


def _tables(recipe: Recipe, scaling: Scaling | None) -> list[str]:
    nodes = recipe.nodes
    sources = [source for node in nodes for source in node.sources]
    weights = [weight for node in nodes for weight in node.weights]
    activations = [ACTIVATIONS.index(node.activation) for node in nodes]
    lines = []
    if scaling is not None:
        offset, scale = scaling_columns(scaling, recipe.inputs)
        lines += [*_floats_table("offset", offset), *_floats_table("scale", scale)]
    lines += ["// Weight of each link, and the value that it reads."]
    lines += [*_floats_table("weight", weights), *_integers_table("source", sources)]
    lines += ["// Links into each node."]
    lines += _integers_table("links", [len(node.weights) for node in nodes])
    if any(activations):
        words = ", ".join(f"{code} {ACTIVATIONS[code]}" for code in sorted(set(activations)))
        lines += [f"// Activation of each node: {words}."]
        lines += _integers_table("activation", activations)
    lines += ["// Values that are the outputs, and the state of the next call."]
    lines += _integers_table("result", recipe.outputs)
    return lines + (_integers_table("kept", recipe.kept) if recipe.state else [])


def _floats_table(name: str, values: Iterable[float | np.floating]) -> list[str]:
    numbers = [f"{np.float32(value)!s}f" for value in values]
    return _static_array(f"float {name}", numbers or ["0.0f"])


def _integers_table(name: str, values: Sequence[int]) -> list[str]:
    """A table of the smallest type of integers that holds it."""
    most = max(values, default=0)
    kind = "unsigned char" if most < 256 else "unsigned short" if most < 65536 else "int"
    return _static_array(f"{kind} {name}", [str(value) for value in values] or ["0"])


def _static_array(name: str, numbers: Sequence[str]) -> list[str]:
    text = f"static const {name}[{len(numbers)}] = {{{', '.join(numbers)}}};"
    return textwrap.wrap(text, 94, subsequent_indent="    ")


def _body(recipe: Recipe, scaling: Scaling | None) -> list[str]:
    """What is computed with the tables."""
    read = ["value[i] = observation[i];"]
    if scaling is not None:
        largest = f"{np.float32(scaling[2])!s}f"
        read = [
            "float x = (observation[i] - offset[i]) / scale[i];",
            f"value[i] = x > {largest} ? {largest} : x < -{largest} ? -{largest} : x;",
        ]
    inputs, state, first, nodes = recipe.inputs, recipe.state, recipe.first_node, len(recipe.nodes)
    used = sorted({ACTIVATIONS.index(node.activation) for node in recipe.nodes} - {0})
    cases = [f"    case {one}: sum = {C_FORMULAS[ACTIVATIONS[one]]}; break;" for one in used]
    if cases:
        cases = [
            "    switch (activation[node]) {",
            *cases,
            "    default: break;  // identity",
            "    }",
        ]
    lines = ["", f"float value[{first + nodes}];  // inputs, 1 for the bias, state, nodes", ""]
    lines += [f"for (int i = 0; i < {inputs}; i++) {{", *(f"    {one}" for one in read), "}"]
    lines += [f"value[{inputs}] = 1.0f;"]
    if state:
        lines += [f"for (int i = 0; i < {state}; i++) value[{inputs + 1} + i] = state[i];"]
    lines += [
        f"for (int node = 0, link = 0; node < {nodes}; node++) {{",
        "    float sum = 0.0f;",
        "    for (int i = 0; i < links[node]; i++, link++)",
        "        sum += weight[link] * value[source[link]];",
        *cases,
        f"    value[{first} + node] = sum;",
        "}",
        f"for (int i = 0; i < {len(recipe.outputs)}; i++) output[i] = value[result[i]];",
    ]
    if state:
        lines += [f"for (int i = 0; i < {state}; i++) state[i] = value[kept[i]];"]
    return lines
