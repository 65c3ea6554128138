"""A drawing of a genome shows its genes, each once and in its place."""

from __future__ import annotations

import io
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from gymnasium import spaces
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.artist import Artist
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import FancyArrowPatch

from neatq_envs.render import ShownFigure
from neatq_torch.genome import (
    Genome,
    InnovationLedger,
    MutationConfig,
    NodeKind,
    initial_genome,
    mutate,
)
from neatq_trainers.genome_figure import NEGATIVE, POSITIVE, candidate_names, draw_genome
from neatq_trainers.report import input_names

GROWING = MutationConfig(add_node_prob=0.3, add_link_prob=0.5, recurrent_link_prob=0.4)


def small_genome(**changes: Any) -> Genome:
    """Inputs 1 and 2, bias 3, output 4, hidden 5 and 6: 1 -> 5 -> 6 -> 4, and others."""
    #        1->5 5->6 6->4 2->4  3->4   5->5  4->6
    links = [(1, 5), (5, 6), (6, 4), (2, 4), (3, 4), (5, 5), (4, 6)]
    genes: dict[str, Any] = {
        "node_id": [1, 2, 3, 4, 5, 6],
        "node_kind": [NodeKind.INPUT] * 2
        + [NodeKind.BIAS, NodeKind.OUTPUT]
        + [NodeKind.HIDDEN] * 2,
        "node_activation": [0, 0, 0, 1, 1, 1],
        "link_innovation": [1, 2, 3, 4, 5, 6, 7],
        "link_source": [source for source, _ in links],
        "link_target": [target for _, target in links],
        "link_weight": [1.0, -2.0, 0.5, -0.1, 0.2, 0.7, -0.3],
        "link_enabled": [True, True, True, True, False, True, True],
        "link_recurrent": [False, False, False, False, False, True, True],
    }
    return Genome(genome_id=9, **(genes | changes))


def grown_genome(seed: int, steps: int) -> Genome:
    rng = np.random.default_rng(seed)
    genome = initial_genome(3, 2, rng=rng)
    ledger = InnovationLedger.for_genomes([genome])
    for _ in range(steps):
        genome = mutate(genome, GROWING, ledger, rng)
    return genome


def drawn(figure: Figure, kind: str) -> dict[int, Artist]:
    """What was drawn for each node or link, by number; fails if one was drawn twice."""
    (axes,) = figure.axes
    gids = [(artist.get_gid() or "", artist) for artist in axes.get_children()]
    found = [(int(gid.split()[1]), artist) for gid, artist in gids if gid.startswith(kind)]
    assert len(dict(found)) == len(found)
    return dict(found)


def place(figure: Figure, node: int) -> tuple[float, float]:
    """Column and row of a node."""
    line = drawn(figure, "node")[node]
    assert isinstance(line, Line2D)
    x, y = np.asarray(line.get_xydata())[0]
    return float(x), float(y)


def link(figure: Figure, innovation: int) -> FancyArrowPatch:
    patch = drawn(figure, "link")[innovation]
    assert isinstance(patch, FancyArrowPatch)
    return patch


def words(figure: Figure) -> set[str]:
    (axes,) = figure.axes
    return {text.get_text() for text in axes.texts}


def rendered(figure: Figure) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=20)
    return buffer.getvalue()


@settings(max_examples=30)
@given(seed=st.integers(0, 10_000), steps=st.integers(0, 25))
def test_every_node_and_every_enabled_link_is_drawn_once(seed: int, steps: int) -> None:
    genome = grown_genome(seed, steps)
    figure = draw_genome(genome)
    assert set(drawn(figure, "node")) == set(genome.node_id.tolist())
    enabled = genome.link_innovation[genome.link_enabled]
    assert set(drawn(figure, "link")) == set(enabled.tolist())


@settings(max_examples=30)
@given(seed=st.integers(0, 10_000), steps=st.integers(0, 25))
def test_no_two_nodes_stand_in_one_place_and_hidden_ones_stand_between(
    seed: int, steps: int
) -> None:
    genome = grown_genome(seed, steps)
    figure = draw_genome(genome)
    places = np.array([place(figure, node) for node in genome.node_id.tolist()])
    apart = np.abs(places[:, None] - places[None]).max(-1) + np.eye(len(places))
    assert apart.min() > 0.99
    kind, columns = genome.node_kind, places[:, 0]
    assert (columns[kind <= NodeKind.BIAS] == 0).all()
    hidden, last = columns[kind == NodeKind.HIDDEN], columns[kind == NodeKind.OUTPUT]
    assert ((hidden > 0) & (hidden < last.min())).all()


def test_a_hidden_node_stands_one_column_behind_the_one_that_it_hears() -> None:
    figure = draw_genome(small_genome())
    assert [place(figure, node)[0] for node in (1, 5, 6, 4)] == [0, 1, 2, 3]


def test_a_hidden_node_that_hears_nothing_stands_in_the_first_hidden_column() -> None:
    genome = small_genome(link_source=[2, 5, 6, 1, 3, 5, 4], link_target=[4, 6, 4, 4, 4, 5, 6])
    figure = draw_genome(genome)
    assert [place(figure, node)[0] for node in (5, 6, 4)] == [1, 2, 3]


def test_a_disabled_link_is_left_out_and_counted() -> None:
    figure = draw_genome(small_genome())
    assert set(drawn(figure, "link")) == {1, 2, 3, 4, 6, 7}
    assert "6 links (and 1 disabled, not drawn)" in figure.axes[0].get_title()


def test_colour_tells_the_sign_and_width_the_size() -> None:
    figure = draw_genome(small_genome())
    assert to_hex(link(figure, 1).get_edgecolor()) == POSITIVE
    assert to_hex(link(figure, 2).get_edgecolor()) == NEGATIVE
    widths = [link(figure, innovation).get_linewidth() for innovation in (2, 1, 3, 4)]
    assert widths == sorted(widths, reverse=True)
    assert widths[0] > 4 * widths[-1]


def test_recurrent_links_are_dashed_and_a_self_loop_leaves_its_node() -> None:
    figure = draw_genome(small_genome())
    dashed = [
        link(figure, innovation).get_linestyle() not in ("-", "solid") for innovation in (2, 6, 7)
    ]
    assert dashed == [False, True, True]
    rendered(figure)
    loop = link(figure, 6).get_path().vertices
    assert np.ptp(np.asarray(loop), axis=0).min() > 0


def test_a_weak_link_of_a_hidden_node_is_easier_to_see_than_one_between_input_and_output() -> None:
    figure = draw_genome(small_genome(link_weight=[0.1, -9.0, 0.1, 0.1, 0.1, 0.1, 0.1]))
    grown, direct = link(figure, 3).get_alpha(), link(figure, 4).get_alpha()
    assert grown is not None and direct is not None
    assert grown >= direct
    crowd = initial_genome(12, 15, rng=np.random.default_rng(0))
    faint = [patch.get_alpha() or 0 for patch in drawn(draw_genome(crowd), "link").values()]
    assert min(faint) < 0.1 < grown


def test_a_genome_of_the_arena_is_named_after_sensors_and_candidates() -> None:
    genome = initial_genome(
        12, 15, rng=np.random.default_rng(0), observation_schema="arena-1", activation="sigmoid"
    )
    shown = words(draw_genome(genome))
    assert {"wall left 90", "flag ahead left", "friend direction", "bias"} <= shown
    assert {"candidate 0 speed", "candidate 4 turn", "Q 0", "Q 4"} <= shown
    assert len(shown) == 12 + 1 + 15


def test_one_candidate_is_the_action_itself() -> None:
    genome = initial_genome(12, 2, rng=np.random.default_rng(0), observation_schema="arena-1")
    assert {"speed", "turn"} <= words(draw_genome(genome))


def test_names_of_candidates_are_in_the_order_of_the_outputs() -> None:
    names = candidate_names(2, ["speed", "turn"])
    assert names == (
        "candidate 0 speed",
        "candidate 0 turn",
        "candidate 1 speed",
        "candidate 1 turn",
        "Q 0",
        "Q 1",
    )


def test_given_names_replace_the_usual_ones() -> None:
    shown = words(draw_genome(small_genome(), input_names=["hot", "cold"], output_names=["move"]))
    assert shown == {"hot", "cold", "bias", "move", "5", "6"}


def test_a_wrong_number_of_names_is_refused() -> None:
    with pytest.raises(ValueError, match=r"input_names: expected .* 2 inputs, got 1"):
        draw_genome(small_genome(), input_names=["hot"])


def test_genomes_without_hidden_nodes_links_or_bias_are_drawn() -> None:
    rng = np.random.default_rng(0)
    plain = initial_genome(2, 1, rng=rng, bias=False)
    for genome in (plain, plain.replaced(link_enabled=[False, False]), plain.with_weights([0, 0])):
        figure = draw_genome(genome)
        assert len(drawn(figure, "node")) == 3
        assert rendered(figure)


def test_a_notebook_shows_a_figure_without_pyplot() -> None:
    figure = draw_genome(small_genome())
    assert isinstance(figure, ShownFigure)
    assert figure._repr_png_().startswith(b"\x89PNG")


def test_inputs_are_called_by_what_they_read() -> None:
    space = spaces.Dict({"place": spaces.Box(-1, 1, (2,)), "side": spaces.Discrete(2)})
    network, interface = SimpleNamespace(inputs=4), SimpleNamespace(observation=space)
    policy: Any = SimpleNamespace(network=network, interface=interface)
    place = ["observation['place'] [0]", "observation['place'] [1]"]
    side = ["observation['side'] [0]", "observation['side'] [1]"]
    assert input_names(policy) == [*place, *side]
    policy.interface = None
    assert input_names(policy)[3] == "observation [3]"


def test_names_are_drawn_as_they_are() -> None:
    figure = draw_genome(small_genome(), input_names=["$x{$", "b"], output_names=["$^$"])
    assert rendered(figure)
