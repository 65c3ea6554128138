"""neat-python's configuration files: what each key becomes, and what is lost."""

from __future__ import annotations

import re
from pathlib import Path

import neat
import numpy as np
import pytest

from neatq_torch.evolution import NEAT
from neatq_torch.interop import load_neat_python_config
from neatq_torch.kinds import ConfigError

ROOT = Path(__file__).resolve().parents[2]
CONFIG = ROOT / "benchmarks" / "neat_python.cfg"
WIDE = 3**0.5
"""A uniform distribution of this half width has standard deviation 1."""


def changed(folder: Path, **values: str) -> Path:
    """The configuration with other values."""
    text = CONFIG.read_text()
    for name, value in values.items():
        text, found = re.subn(rf"(?m)^({name}\s*=).*$", rf"\g<1> {value}", text)
        assert found == 1, name
    path = folder / "config"
    path.write_text(text)
    return path


def test_each_key_has_its_counterpart() -> None:
    found = load_neat_python_config(CONFIG)
    assert (found.slots, found.inputs, found.outputs, found.seed) == (1000, 20, 3, None)
    assert (found.activation, found.evaluation) == ("steep_sigmoid", "settle")
    config = found.config
    assert (config.start, config.survival_share) == ("minimal", 0.5)
    assert config.stagnation_generations == 100_000
    assert config.elite_members >= found.slots  # elitism is 0
    assert (config.species.threshold, config.species.step) == (3.0, 0.0)
    distance = config.reproduction.distance
    assert (distance.disjoint, distance.excess, distance.weight) == (1.0, 1.0, 0.4)
    mutation = config.reproduction.mutation
    assert (mutation.add_node_prob, mutation.add_link_prob) == (0.03, 0.05)
    assert (mutation.link_weights_prob, mutation.weight_replace_prob) == (1.0, 0.1)
    assert mutation.weight_mutation_power == pytest.approx(0.3 * WIDE)
    assert mutation.new_link_weight_power == pytest.approx(0.6 * WIDE)
    assert (mutation.max_link_weight, mutation.recurrent_link_prob) == (3.0, 0.0)


def test_what_is_lost_is_named_and_what_asks_for_our_way_is_not() -> None:
    lost = load_neat_python_config(CONFIG).left_out
    genes = {key for key in lost if re.match(r"DefaultGenome\.(bias|response|time_constant)_", key)}
    assert len(genes) == 24
    assert set(lost) - genes == {
        "NEAT.fitness_criterion",
        "NEAT.fitness_threshold",
        "NEAT.reset_on_extinction",
        "DefaultGenome.structural_mutation_surer",
        "DefaultGenome.weight_init_type",
        "DefaultStagnation.species_fitness_func",
        "DefaultStagnation.species_elitism",
        "DefaultReproduction.min_species_size",
    }
    assert all(len(why) > 10 for why in lost.values())


def test_every_key_of_neat_python_is_known(tmp_path: Path) -> None:
    """A key that neat-python knows is either taken or has a reason of its own."""
    parts = neat.DefaultGenome, neat.DefaultReproduction, neat.DefaultSpeciesSet
    saved = tmp_path / "saved"
    neat.Config(*parts, neat.DefaultStagnation, str(CONFIG)).save(str(saved))
    text = re.sub(r"(?m)^seed .*$", "seed = 7", saved.read_text())
    saved.write_text(text)
    found = load_neat_python_config(saved)
    assert found.seed == 7
    assert "unknown to neat-python 2" not in found.left_out.values()
    # A made-up value, with which nothing is harmless.
    everything = re.sub(r"(?m)^(\w*(?:type|func|surer|criterion)\s*=).*$", r"\1 other", text)
    saved.write_text(everything)
    assert "unknown to neat-python 2" not in load_neat_python_config(saved).left_out.values()


def test_unknown_keys_and_sections_are_named(tmp_path: Path) -> None:
    path = tmp_path / "config"
    path.write_text(f"{CONFIG.read_text()}\nmutation_sauce = 3\n[MyGenome]\nnum_inputs = 4\n")
    lost = load_neat_python_config(path).left_out
    unknown = {key for key, why in lost.items() if why == "unknown to neat-python 2"}
    assert unknown == {"DefaultReproduction.mutation_sauce", "MyGenome.num_inputs"}


def test_other_values_find_their_counterparts(tmp_path: Path) -> None:
    path = changed(
        tmp_path,
        feed_forward="False",
        num_hidden="4",
        initial_connection="full_nodirect",
        activation_default="tanh",
        activation_options="tanh",
        weight_mutate_rate="0.3",
        weight_replace_rate="0.1",
        elitism="1",
        compatibility_threshold="0.2",
    )
    found = load_neat_python_config(path)
    assert (found.activation, found.evaluation) == ("tanh", "synchronous")
    assert (found.config.start, found.config.start_hidden) == ("layered", 4)
    assert found.config.elite_members == 0
    assert found.config.species.threshold == 0.2
    mutation = found.config.reproduction.mutation
    assert mutation.hidden_activation == "tanh"
    assert mutation.recurrent_link_prob > 0
    assert mutation.link_weights_prob == pytest.approx(0.4)
    assert mutation.weight_replace_prob == pytest.approx(0.25)


@pytest.mark.parametrize(
    ("name", "value", "key"),
    [
        ("activation_default", "gauss", "activation_default"),
        ("activation_options", "sigmoid gauss", "activation_options"),
        ("activation_mutate_rate", "0.1", "activation_mutate_rate"),
        ("aggregation_default", "max", "aggregation_default"),
        ("aggregation_options", "sum max", "aggregation_options"),
        ("conn_delete_prob", "0.1", "conn_delete_prob"),
        ("node_delete_prob", "0.1", "node_delete_prob"),
        ("enabled_mutate_rate", "0.01", "enabled_mutate_rate"),
        ("enabled_default", "False", "enabled_default"),
        ("initial_connection", "partial_direct 0.5", "initial_connection"),
        ("num_hidden", "2", "num_hidden"),
        ("weight_min_value", "-2.0", "weight_min_value"),
        ("single_structural_mutation", "False", "single_structural_mutation"),
    ],
)
def test_a_value_without_counterpart_is_named(
    name: str, value: str, key: str, tmp_path: Path
) -> None:
    assert f"DefaultGenome.{key}" not in load_neat_python_config(CONFIG).left_out
    lost = load_neat_python_config(changed(tmp_path, **{name: value})).left_out
    assert f"DefaultGenome.{key}" in lost


def test_a_population_starts_and_breeds_with_it(tmp_path: Path) -> None:
    found = load_neat_python_config(changed(tmp_path, pop_size="20"))
    population = NEAT.start(
        found.config,
        slots=found.slots,
        inputs=found.inputs,
        outputs=found.outputs,
        activation=found.activation,
        rng=np.random.default_rng(0),
    )
    for _ in range(3):
        population.tell([float(genome.link_weight.sum()) for genome in population.genomes])
    assert len(population.genomes) == 20


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "NEAT.pop_size: expected a number, got nothing"),
        ("[NEAT]\npop_size = many\n", "NEAT.pop_size: expected a number, got 'many'"),
        ("[NEAT]\npop_size = 1.5\n", "NEAT.pop_size: expected a whole number, got 1.5"),
        ("[NEAT]\npop_size = inf\n", "NEAT.pop_size: expected a number, got 'inf'"),
        (
            "pop_size = 3\n",
            "expected a configuration file of neat-python: File contains no section",
        ),
        ("[NEAT]\npop_size = 3\npop_size = 4\n", "option 'pop_size' in section 'NEAT' already"),
        ("[NEAT]\npop_size = %(nothing)s\n", "expected a configuration file of neat-python"),
        ("\x00\xff", "expected a configuration file of neat-python"),
    ],
)
def test_another_file_is_refused_with_its_name(text: str, words: str, tmp_path: Path) -> None:
    path = tmp_path / "config"
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(ConfigError, match=f"config: .*{words}"):
        load_neat_python_config(path)


def test_a_value_out_of_range_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"config: survival_share: expected \[0, 1\], got 1.5"):
        load_neat_python_config(changed(tmp_path, survival_threshold="1.5"))
