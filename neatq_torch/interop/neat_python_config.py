"""Configuration files of neat-python as settings of ours, and what gets lost on the way."""

from __future__ import annotations

import configparser
import math
from dataclasses import dataclass, field, replace
from pathlib import Path

from neatq_torch.evolution import NEAT_2002, NEATConfig, ReproductionConfig, SpeciesConfig
from neatq_torch.genome import DistanceConfig, MutationConfig
from neatq_torch.kinds import ConfigError
from neatq_torch.network import Evaluation

Key = tuple[str, str]
"""Section and name."""

GENOME, SPECIES = "DefaultGenome", "DefaultSpeciesSet"
STAGNATION, REPRODUCTION = "DefaultStagnation", "DefaultReproduction"
NEVER = 10**9
"""Generations that no run has."""

_NO_GENES = {
    "bias": "biases are the weights of links from the bias node, and mutate like all weights",
    "response": "there are no responses: weights do what they do",
    "time_constant": "networks here have no continuous time",
}
_FLOAT_KEYS = ("init_mean", "init_stdev", "init_type", "max_value", "min_value")
_FLOAT_KEYS += ("mutate_power", "mutate_rate", "replace_rate")

_LOST: dict[Key, tuple[str, tuple[str, ...]]] = {
    ("NEAT", "fitness_criterion"): ("a callback says when a run ends", ()),
    ("NEAT", "fitness_threshold"): ("a callback says when a run ends", ()),
    ("NEAT", "no_fitness_termination"): ("a callback says when a run ends", ("true",)),
    ("NEAT", "reset_on_extinction"): ("populations here do not die out", ()),
    (GENOME, "activation_mutate_rate"): ("activations do not mutate here", ("0",)),
    (GENOME, "aggregation_default"): ("nodes here add up", ("sum",)),
    (GENOME, "aggregation_mutate_rate"): ("nodes here add up", ("0",)),
    (GENOME, "aggregation_options"): ("nodes here add up", ("sum",)),
    (GENOME, "conn_delete_prob"): ("links are disabled here, never deleted", ("0",)),
    (GENOME, "enabled_default"): ("new links are enabled here", ("true", "1", "yes", "on")),
    (GENOME, "enabled_mutate_rate"): ("toggle_enable_prob counts genomes, not links", ("0",)),
    (GENOME, "enabled_rate_to_false_add"): ("toggles have one probability here", ("0",)),
    (GENOME, "enabled_rate_to_true_add"): ("toggles have one probability here", ("0",)),
    (GENOME, "node_delete_prob"): ("nodes are never deleted here", ("0",)),
    (GENOME, "single_structural_mutation"): ("a mutation here adds one thing at most", ("true",)),
    (GENOME, "structural_mutation_surer"): ("a mutation here tries several times", ()),
    (GENOME, "weight_init_mean"): ("new weights here are as often below 0 as above", ("0",)),
    (GENOME, "weight_init_type"): ("new weights here are uniform", ("uniform",)),
    (STAGNATION, "species_elitism"): (
        "two stagnating species are spared here, and only if all are",
        ("0",),
    ),
    (STAGNATION, "species_fitness_func"): ("a species is as fit as its best here", ("max",)),
    **{
        (GENOME, f"{gene}_{key}"): (why, ())
        for gene, why in _NO_GENES.items()
        for key in _FLOAT_KEYS
    },
    (REPRODUCTION, "min_species_size"): ("a species may have a single member here", ("0", "1")),
}
"""Keys without a counterpart: why, and the values with which nothing is lost."""

_ACTIVATIONS = {"sigmoid": "steep_sigmoid", "tanh": "tanh", "relu": "relu", "identity": "identity"}
"""The nearest of ours: slopes of 4.9 for 5, and of 1 for the 2.5 of neat-python's tanh."""


@dataclass(frozen=True, kw_only=True)
class NeatPythonSettings:
    """What a configuration file of neat-python says, in our words.

    Attributes:
        config: How generations follow each other.
        slots: Genomes of the population.
        inputs: Numbers of an observation.
        outputs: Numbers of an output.
        activation: Of the outputs of the first genomes; hidden nodes get it by `config`.
        evaluation: "synchronous" where `feed_forward` is false: neat-python's recurrent networks
            read the values of the call before.
        seed: The seed, if there is one.
        left_out: Why each key that has no counterpart was left out, by "section.key"; keys whose
            value asks for what happens here anyway are not among them.
    """

    config: NEATConfig
    slots: int
    inputs: int
    outputs: int
    activation: str = "steep_sigmoid"
    evaluation: Evaluation = "settle"
    seed: int | None = None
    left_out: dict[str, str] = field(default_factory=dict)


def load_neat_python_config(path: Path | str) -> NeatPythonSettings:
    """A configuration file of neat-python as settings for `NEAT`.

    Counterparts, where they are not the same number: neat-python draws changes and new weights from
    a normal distribution, we from a uniform one of the same standard deviation (sqrt(3) times as
    wide); where each of its weights mutates with its own probability, all weights of a genome
    mutate here with that probability; genes are counted in the distance by the share of them that
    differ, as there, but those of nodes are not, and genomes below 20 links count each. Founders of
    `full_nodirect` with hidden nodes are "layered", all others have a link from each input to each
    output. All offspring have two parents of one species and mutate, a species keeps its champion
    if `elitism` is above 0, and the population is never refocused on its two best species.

    Args:
        path: The file, of neat-python 0.92 to 2; keys that it lacks have our defaults.

    Raises:
        ConfigError: It is no such file, `pop_size`, `num_inputs` or `num_outputs` are missing, or a
            value is out of range; the message names the key.
        OSError: It cannot be read.

    Example:
        >>> found = load_neat_python_config("config-feedforward")
        >>> print(found.left_out)
        >>> sizes = {"slots": found.slots, "inputs": found.inputs, "outputs": found.outputs}
        >>> population = NEAT.start(found.config, rng=rng, activation=found.activation, **sizes)
    """
    try:
        keys = _Keys(path)
        return _settings(keys)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error


class _Keys:
    """The values of a file, each of which is taken once, and what is left out of it."""

    def __init__(self, path: Path | str) -> None:
        parser = configparser.ConfigParser()
        try:
            parser.read_string(Path(path).read_text(encoding="utf-8"))
            self.texts: dict[Key, str] = {
                (section, name): text.strip()
                for section in parser.sections()
                for name, text in parser.items(section)
            }
        except (configparser.Error, UnicodeDecodeError) as error:
            words = " ".join(str(error).split())
            raise ConfigError(f"expected a configuration file of neat-python: {words}") from error
        self.left_out: dict[str, str] = {}

    def leave(self, key: Key, why: str) -> None:
        """Say that a key has no counterpart, or its value has none."""
        self.left_out[".".join(key)] = why

    def word(self, section: str, name: str, default: str = "") -> str:
        """A text, in lower case."""
        return self.texts.pop((section, name), default).lower()

    def number(self, section: str, name: str, default: float | None = None) -> float:
        """A number; ConfigError if it is none, or missing without a default."""
        text = self.texts.pop((section, name), None)
        if text is None and default is not None:
            return default
        try:
            value = float(text or "")
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            got = "nothing" if text is None else repr(text)
            raise ConfigError(f"{section}.{name}: expected a number, got {got}")
        return value

    def count(self, section: str, name: str, default: int | None = None) -> int:
        """A whole number of at least 0."""
        value = self.number(section, name, default)
        if value < 0 or value != int(value):
            raise ConfigError(f"{section}.{name}: expected a whole number, got {value:g}")
        return int(value)

    def leave_the_rest(self) -> None:
        """Name all keys that nobody has taken."""
        for key, text in self.texts.items():
            why, harmless = _LOST.get(key, ("unknown to neat-python 2", ()))
            if text.lower() not in harmless and not (_is_zero(text) and "0" in harmless):
                self.leave(key, why)


def _is_zero(text: str) -> bool:
    try:
        return float(text) == 0
    except ValueError:
        return False


def _settings(keys: _Keys) -> NeatPythonSettings:
    sizes = {
        "slots": keys.count("NEAT", "pop_size"),
        "inputs": keys.count(GENOME, "num_inputs"),
        "outputs": keys.count(GENOME, "num_outputs"),
    }
    seed = keys.count("NEAT", "seed") if ("NEAT", "seed") in keys.texts else None
    forward = keys.word(GENOME, "feed_forward", "true") in ("true", "1", "yes", "on")
    activation = _activation(keys)
    config = NEATConfig(
        reproduction=_reproduction(keys, activation, forward=forward),
        species=_species(keys),
        survival_share=keys.number(REPRODUCTION, "survival_threshold", 0.2),
        stagnation_generations=keys.count(STAGNATION, "max_stagnation", 15),
        refocus_generations=NEVER,
        elite_members=0 if _elite(keys) else NEVER,
    )
    config = _with_founders(config, keys)
    keys.leave_the_rest()
    return NeatPythonSettings(
        config=config,
        **sizes,
        activation=activation,
        evaluation="settle" if forward else "synchronous",
        seed=seed,
        left_out=keys.left_out,
    )


def _activation(keys: _Keys) -> str:
    default = keys.word(GENOME, "activation_default", "sigmoid")
    options = keys.word(GENOME, "activation_options", default).split()
    if default not in _ACTIVATIONS:
        why = f"genomes here have {', '.join(_ACTIVATIONS)}; sigmoid is taken"
        keys.leave((GENOME, "activation_default"), why)
    if set(options) - {default}:
        keys.leave((GENOME, "activation_options"), "all hidden nodes have one activation here")
    return _ACTIVATIONS.get(default, "steep_sigmoid")


def _species(keys: _Keys) -> SpeciesConfig:
    threshold = keys.number(SPECIES, "compatibility_threshold", 3.0)
    return SpeciesConfig(threshold=threshold, step=0.0, floor=min(0.3, threshold))


def _elite(keys: _Keys) -> int:
    elite = keys.count(REPRODUCTION, "elitism", 0)
    if elite > 1:
        why = "a species keeps one champion here"
        keys.leave((REPRODUCTION, "elitism"), why)
    return elite


def _reproduction(keys: _Keys, activation: str, *, forward: bool) -> ReproductionConfig:
    changed = keys.number(GENOME, "weight_mutate_rate", 0.8)
    renewed = keys.number(GENOME, "weight_replace_rate", 0.1)
    low = keys.number(GENOME, "weight_min_value", -30.0)
    high = keys.number(GENOME, "weight_max_value", 30.0)
    if low != -high:
        keys.leave((GENOME, "weight_min_value"), "one size caps weights above and below 0 here")
    wide, default = math.sqrt(3), NEAT_2002.mutation
    mutation = replace(
        default,
        add_node_prob=keys.number(GENOME, "node_add_prob", default.add_node_prob),
        add_link_prob=keys.number(GENOME, "conn_add_prob", default.add_link_prob),
        link_weights_prob=min(changed + renewed, 1.0),
        weight_scheme="uniform",
        weight_replace_prob=renewed / (changed + renewed) if renewed else 0.0,
        weight_mutation_power=wide * keys.number(GENOME, "weight_mutate_power", 0.5),
        new_link_weight_power=wide * keys.number(GENOME, "weight_init_stdev", 1.0),
        max_link_weight=max(abs(low), abs(high)),
        recurrent_link_prob=0.0 if forward else MutationConfig().recurrent_link_prob,
        split_old_below=0,
        hidden_activation=activation,
    )
    disjoint = keys.number(GENOME, "compatibility_disjoint_coefficient", 1.0)
    distance = DistanceConfig(
        disjoint=disjoint,
        excess=disjoint,
        weight=keys.number(GENOME, "compatibility_weight_coefficient", 0.5),
        normalised=True,
    )
    return replace(
        NEAT_2002,
        mutation=mutation,
        distance=distance,
        mutate_only_prob=0.0,
        mate_only_prob=0.0,
        multipoint_prob=1.0,
        interspecies_mate_prob=0.0,
    )


def _with_founders(config: NEATConfig, keys: _Keys) -> NEATConfig:
    key = GENOME, "initial_connection"
    hidden = keys.count(GENOME, "num_hidden", 0)
    connection = keys.word(*key, "full").split()[0]
    if hidden and connection in ("full", "full_nodirect"):
        return replace(config, start="layered", start_hidden=hidden)
    if hidden:
        why = "only founders of full_nodirect have hidden nodes here"
        keys.leave((GENOME, "num_hidden"), why)
    if not connection.startswith("full"):
        keys.leave(key, "founders here have a link from each input to each output")
    return config
