"""How often and how strongly genomes mutate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from neatq_torch.genome.vocabulary import activation_index

WeightScheme = Literal["opennero", "uniform"]


@dataclass(frozen=True, kw_only=True)
class MutationConfig:
    """How often and how strongly genomes mutate; the defaults are those of OpenNERO.

    One mutation of a genome is: a new node; else a new link; else each of weights, toggle and
    re-enable. OpenNERO's trait mutations have no effect on behaviour and are left out.

    Attributes:
        add_node_prob: probability of a new node.
        add_link_prob: probability of a new link where there is no new node.
        link_weights_prob: probability of new weights where the structure stays.
        weight_scheme: "opennero", severe or by age of the gene (see `mutated_weights`), as in the
            programs of OpenNERO and of NEAT's authors; "uniform", each weight is perturbed or, with
            `weight_replace_prob`, new, as NEAT's paper says.
        weight_mutation_power: weights change by U(-power, power).
        weight_replace_prob: share of new weights in the scheme "uniform".
        max_link_weight: mutated weights are capped to this size; None for no cap.
        new_link_weight_power: weights of new links are U(-power, power).
        recurrent_link_prob: share of link mutations that must find a recurrent link.
        recurrent_loop_prob: share of those tries that look at a link from a node to itself.
        forward_from_outputs: whether a new link may leave an output and be forward; in OpenNERO
            it may, by a wrong comparison in its code.
        new_link_tries: pairs of nodes looked at before a link mutation gives up.
        split_tries: links looked at before a node mutation gives up.
        split_old_below: a genome with fewer links than this splits the oldest of those that can be
            split, or with probability 0.3 rather the next one, and so on, so that its first hidden
            nodes do not form a chain; 0 for the choice by chance in all genomes.
        split_weight_scale: weight behind a new node, as a share of the split link's weight.
        hidden_activation: activation of new nodes.
        toggle_enable_prob: probability that one link is enabled or disabled.
        reenable_prob: probability that the first disabled link is enabled.
    """

    add_node_prob: float = 0.03
    add_link_prob: float = 0.05
    link_weights_prob: float = 0.9
    weight_scheme: WeightScheme = "opennero"
    weight_mutation_power: float = 0.5
    weight_replace_prob: float = 0.1
    max_link_weight: float | None = 3.0
    new_link_weight_power: float = 1.0
    recurrent_link_prob: float = 0.15
    recurrent_loop_prob: float = 0.5
    forward_from_outputs: bool = True
    new_link_tries: int = 20
    split_tries: int = 20
    split_old_below: int = 0
    split_weight_scale: float = 0.3
    hidden_activation: str = "sigmoid"
    toggle_enable_prob: float = 0.0
    reenable_prob: float = 0.0

    def __post_init__(self) -> None:
        """Check every value."""
        for name, value in vars(self).items():
            if name.endswith("_prob") and not 0.0 <= value <= 1.0:
                raise ValueError(f"{name} must be a probability in [0, 1], not {value}.")
            if name.endswith("_power") and not 0.0 <= value < np.inf:
                raise ValueError(f"{name} must be a finite number >= 0, not {value}.")
            if name.endswith("_tries") and value < 1:
                raise ValueError(f"{name} must be at least 1, not {value}.")
        if self.split_old_below < 0:
            raise ValueError(f"split_old_below must be >= 0, not {self.split_old_below}.")
        if self.max_link_weight is not None and not self.max_link_weight > 0:
            raise ValueError(
                f"max_link_weight must be positive, or None for no cap, not {self.max_link_weight}."
            )
        if self.weight_scheme not in ("opennero", "uniform"):
            raise ValueError(
                f"weight_scheme must be 'opennero' or 'uniform', not {self.weight_scheme!r}."
            )
        if not np.isfinite(self.split_weight_scale):
            raise ValueError(f"split_weight_scale must be finite, not {self.split_weight_scale}.")
        activation_index(self.hidden_activation)
