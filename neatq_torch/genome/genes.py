"""Genes and settings as compiled code takes them: tuples of arrays and of numbers."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

NodeIndices = NDArray[np.integer]
GeneNumbers = NDArray[np.int64]

Means = tuple[Any, ...]
"""A `ReproductionConfig` for compiled code."""


class Genes(NamedTuple):
    """What breeding reads of a genome, as compiled code takes it.

    The columns of `Genome`; `source` and `target` are indices into its nodes, not their ids.
    """

    innovation: NDArray[np.int64]
    weight: NDArray[np.float32]
    enabled: NDArray[np.bool_]
    recurrent: NDArray[np.bool_]
    source: NDArray[np.int64]
    target: NDArray[np.int64]
    node_id: NDArray[np.int32]
    kind: NDArray[np.uint8]


class Rates(NamedTuple):
    """The settings of `MutationConfig` as compiled code takes them."""

    add_node_prob: float
    add_link_prob: float
    remove_link_prob: float
    link_weights_prob: float
    toggle_enable_prob: float
    reenable_prob: float
    uniform: float
    weight_mutation_power: float
    weight_replace_prob: float
    max_link_weight: float
    split_old_below: float
    split_tries: float
    recurrent_link_prob: float
    recurrent_loop_prob: float
    forward_from_outputs: float
    new_link_tries: float
    new_link_weight_power: float
