"""Agents that look for plants on a torus, and teach each other: all of it compiled.

The world of Tansey, Feasley & Miikkulainen (2012). Nobody hinders anybody: each agent eats its own
copy of every plant. What an agent senses are its eyes, one number for each of eight sectors of the
front half and each kind of plant, and its speed; what it does is a change of heading and one of
speed. How fast an agent may be and how fast that changes was not published: `MOST_SPEED` and
`MOST_PUSH` are ours, and so is that an agent looks for food where it stands after each step, not
on the way.

A lesson is one step of gradient descent with momentum on half the squared distance between what
the student would have done and what the teacher did; see `study`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from neatq_torch.genome import ACTIVATIONS, Genome, NodeKind, node_levels
from neatq_torch.jit import cached_njit

SIGHT = 100.0
"""How far an agent sees, in units."""
BITE = 5.0
"""How near a plant must be to be eaten, in units."""
SECTORS = 8
"""Of the front half, for each kind of plant; the first is on the right."""
MOTIONS = 2
"""Outputs of a network: change of heading and change of speed."""
MOST_TURN_RAD = np.pi / 6
"""Largest change of heading in a step."""
MOST_SPEED = 10.0
"""Units in a step: as long as a mouth is wide, so that no plant straight ahead is stepped over."""
MOST_PUSH = 10.0
"""Largest change of speed in a step."""
LEARNING_RATE, MOMENTUM = 0.1, 0.9

ALONE, EGALITARIAN, STUDENT_TEACHER = range(3)
"""Who teaches: nobody; whoever was just rewarded, all others of its group; in each step the best of
a group so far, the worst."""

Floats64 = NDArray[np.float64]
Integers = NDArray[np.int64]

SIGMOID_SLOPES = {"sigmoid": 1.0, "steep_sigmoid": 4.9}
_HALF_PI, _PI = np.pi / 2, np.pi
_SECTOR_RAD = np.pi / SECTORS


class Meadow(NamedTuple):
    """A torus with plants.

    Attributes:
        size: of its sides, in units.
        x: of plants, in units, float64 [plants].
        y: the same.
        kind: of plants, int64 [plants].
        worth: reward for eating a plant of a kind, float64 [kinds].
    """

    size: float
    x: Floats64
    y: Floats64
    kind: Integers
    worth: Floats64


class Walkers(NamedTuple):
    """Where agents are, and what they have eaten.

    Attributes:
        x: in units, float64 [agents].
        y: the same.
        heading_rad: against the sun from the x axis, float64 [agents].
        speed: in units a step, float64 [agents].
        eaten: bool [agents, plants].
    """

    x: Floats64
    y: Floats64
    heading_rad: Floats64
    speed: Floats64
    eaten: NDArray[np.bool_]


class Brains(NamedTuple):
    """Networks one after the other, their nodes in the order of evaluation.

    Values of a network stand in rows: inputs, bias, then all other nodes.

    Attributes:
        first_node: first of a network's nodes that are no sensors, and the end [networks + 1].
        first_link: first link into a node that is no sensor, and the end [nodes + 1].
        output: rows of the outputs [networks, outputs].
        source: row that a link reads [links].
        gene: position of a link in its genome [links].
        weight: float64 [links].
        momentum: what earlier lessons left behind, float64 [links].
        slope: of the sigmoids.
    """

    first_node: Integers
    first_link: Integers
    output: Integers
    source: Integers
    gene: Integers
    weight: Floats64
    momentum: Floats64
    slope: float


class Moment(NamedTuple):
    """What all agents went through in one step.

    Attributes:
        sensed: float64 [agents, inputs].
        acted: outputs of the networks, float64 [agents, outputs].
        reward: float64 [agents].
    """

    sensed: Floats64
    acted: Floats64
    reward: Floats64


def standing_walkers(agents: int, meadow: Meadow) -> Walkers:
    """Agents that stand in the middle, hungry, and look along the x axis."""
    middle, nothing = np.full(agents, meadow.size / 2), np.zeros(agents)
    eaten = np.zeros((agents, len(meadow.x)), np.bool_)
    return Walkers(middle, middle.copy(), nothing, nothing.copy(), eaten)


def brains_of(genomes: Sequence[Genome]) -> Brains:
    """Lay out feed-forward genomes with a bias and sigmoids of one slope; they had no lessons yet.

    Raises:
        ValueError: a genome is none of these.
    """
    first = genomes[0]
    activation = ACTIVATIONS[first.node_activation[first.node_kind == NodeKind.OUTPUT][0]]
    slope, nodes, links, columns, outputs = SIGMOID_SLOPES.get(activation, 0.0), [0], [0], [], []
    for genome in genomes:
        row, entering, source, gene, output = _laid_out(genome, activation)
        nodes.append(nodes[-1] + len(entering))
        links += (links[-1] + np.cumsum(entering)).tolist()
        columns.append((source, gene, genome.link_weight[gene].astype(np.float64)))
        outputs.append(row[output])
    source, gene, weight = (np.concatenate(parts) for parts in zip(*columns, strict=True))
    ends = np.array(nodes, np.int64), np.array(links, np.int64)
    return Brains(*ends, np.array(outputs), source, gene, weight, np.zeros_like(weight), slope)


def _laid_out(
    genome: Genome, activation: str
) -> tuple[Integers, Integers, Integers, Integers, NDArray[np.bool_]]:
    """Rows of nodes, links into each node that is no sensor, sources, genes; who is an output."""
    kind, on = genome.node_kind, np.flatnonzero(genome.link_enabled)
    thinking = kind >= NodeKind.OUTPUT
    alike = (genome.node_activation[thinking] == ACTIVATIONS.index(activation)).all()
    alike &= activation in SIGMOID_SLOPES
    if genome.link_recurrent[on].any() or not alike or NodeKind.BIAS not in kind:
        expected = "expected a bias, sigmoids of one slope and no recurrent links"
        raise ValueError(f"genome {genome.genome_id}: {expected}.")
    source, target = genome.source_index[on], genome.target_index[on]
    level = node_levels(source, target, len(kind))
    assert level is not None, "a valid genome has no cycle of forward links"
    order = np.lexsort((np.arange(len(kind)), level, np.where(thinking, 2, kind)))
    row = np.empty(len(kind), np.int64)
    row[order] = np.arange(len(kind))
    sorted_links = np.argsort(row[target], kind="stable")
    sensors = int((~thinking).sum())
    entering = np.bincount(row[target] - sensors, minlength=len(kind) - sensors)
    sources, genes = row[source][sorted_links], on[sorted_links]
    return row, entering, sources, genes, kind == NodeKind.OUTPUT


def weights_of(brains: Brains, genomes: Sequence[Genome]) -> list[NDArray[np.float32]]:
    """What each of the genomes' links weighs now, float32 [links] of each; disabled ones rest."""
    ends = brains.first_link[brains.first_node]
    weights = []
    for genome, start, end in zip(genomes, ends[:-1], ends[1:], strict=True):
        weight = genome.link_weight.copy()
        weight[brains.gene[start:end]] = brains.weight[start:end]
        weights.append(weight)
    return weights


@njit(error_model="numpy")
def _shortest(difference: float, size: float) -> Any:
    """The way to a point on a circle, the shorter one of the two."""
    return difference - size * np.floor(difference / size + 0.5)


@cached_njit(error_model="numpy")
def see(walkers: Walkers, meadow: Meadow, agent: int, sensed: Floats64) -> None:
    """Write what an agent senses, float64 [inputs].

    A plant in a sector adds 1 - distance / SIGHT to that sector of its kind. Kinds follow each
    other; the last input is the speed as a share of the highest.
    """
    sensed[:] = 0.0
    for plant in range(len(meadow.x)):
        east = _shortest(meadow.x[plant] - walkers.x[agent], meadow.size)
        if abs(east) > SIGHT or walkers.eaten[agent, plant]:
            continue
        north = _shortest(meadow.y[plant] - walkers.y[agent], meadow.size)
        distance = np.sqrt(east * east + north * north)
        if distance > SIGHT:
            continue
        bearing = _shortest(np.arctan2(north, east) - walkers.heading_rad[agent], 2 * _PI)
        sector = int(np.floor((bearing + _HALF_PI) / _SECTOR_RAD))
        if 0 <= sector < SECTORS:
            sensed[meadow.kind[plant] * SECTORS + sector] += 1.0 - distance / SIGHT
    sensed[-1] = walkers.speed[agent] / MOST_SPEED


@cached_njit(error_model="numpy")
def move(walkers: Walkers, size: float, agent: int, turn: float, push: float) -> None:
    """Turn, then change the speed, then walk; `turn` and `push` are from 0 to 1, 0.5 is none."""
    heading = walkers.heading_rad[agent] + (2.0 * turn - 1.0) * MOST_TURN_RAD
    speed = walkers.speed[agent] + (2.0 * push - 1.0) * MOST_PUSH
    speed = min(max(speed, 0.0), MOST_SPEED)
    walkers.heading_rad[agent], walkers.speed[agent] = heading, speed
    walkers.x[agent] = (walkers.x[agent] + speed * np.cos(heading)) % size
    walkers.y[agent] = (walkers.y[agent] + speed * np.sin(heading)) % size


@cached_njit(error_model="numpy")
def eat(walkers: Walkers, meadow: Meadow, agent: int) -> float:
    """Eat all plants within BITE that this agent has not eaten yet, and return their worth."""
    total = 0.0
    for plant in range(len(meadow.x)):
        east = _shortest(meadow.x[plant] - walkers.x[agent], meadow.size)
        if abs(east) > BITE or walkers.eaten[agent, plant]:
            continue
        north = _shortest(meadow.y[plant] - walkers.y[agent], meadow.size)
        if east * east + north * north <= BITE * BITE:
            walkers.eaten[agent, plant] = True
            total += meadow.worth[int(meadow.kind[plant])]
    return total


@cached_njit(error_model="numpy")
def think(brains: Brains, agent: int, sensed: Floats64, values: Floats64) -> None:
    """Evaluate a network on what was sensed [inputs]: `values` take all its rows."""
    inputs = len(sensed)
    values[:inputs] = sensed
    values[inputs] = 1.0
    first = brains.first_node[agent]
    for node in range(first, brains.first_node[agent + 1]):
        total = 0.0
        for link in range(brains.first_link[node], brains.first_link[node + 1]):
            total += brains.weight[link] * values[brains.source[link]]
        values[inputs + 1 + node - first] = 1.0 / (1.0 + np.exp(-brains.slope * total))


@cached_njit(error_model="numpy")
def study(
    brains: Brains, agent: int, sensed: Floats64, acted: Floats64, values: Floats64, slope: Floats64
) -> None:
    """One step of backpropagation of an agent's network towards another's action.

    The error is half the sum over outputs of (output - acted)^2. Per link, momentum becomes
    MOMENTUM * momentum + gradient, and LEARNING_RATE times that leaves the weight.

    Args:
        brains: Whose weights and momenta are written.
        agent: The student.
        sensed: What the teacher sensed [inputs].
        acted: What the teacher's network had as outputs [outputs].
        values: Room for the values of a network [rows].
        slope: Room for their gradients [rows].
    """
    think(brains, agent, sensed, values)
    slope[:] = 0.0
    for i in range(len(acted)):
        row = brains.output[agent, i]
        slope[row] = values[row] - acted[i]
    first, sensors = brains.first_node[agent], len(sensed) + 1
    for node in range(brains.first_node[agent + 1] - 1, first - 1, -1):
        value = values[sensors + node - first]
        change = slope[sensors + node - first] * brains.slope * value * (1.0 - value)
        for link in range(brains.first_link[node], brains.first_link[node + 1]):
            source = brains.source[link]
            slope[source] += change * brains.weight[link]  # the weight before this lesson
            step = MOMENTUM * brains.momentum[link] + change * values[source]
            brains.momentum[link] = step
            brains.weight[link] -= LEARNING_RATE * step


@njit(error_model="numpy")
def _share(
    brains: Brains,
    group: Integers,
    now: Moment,
    lessons: Integers,
    values: Floats64,
    room: Floats64,
) -> None:
    """Let everybody who was just rewarded teach all others of its group."""
    for teacher in range(len(group)):
        if now.reward[teacher] > 0.0:
            for agent in range(len(group)):
                if agent != teacher and group[agent] == group[teacher]:
                    study(brains, agent, now.sensed[teacher], now.acted[teacher], values, room)
                    lessons[agent] += 1


@njit(error_model="numpy")
def _coach(
    brains: Brains,
    group: Integers,
    now: Moment,
    fitness: Floats64,
    lessons: Integers,
    values: Floats64,
    room: Floats64,
) -> None:
    """Let the fittest of each group teach the least fit, if there is a difference."""
    for one in range(group.max() + 1):
        best = worst = -1
        for agent in range(len(group)):
            if group[agent] == one:
                if best < 0 or fitness[agent] > fitness[best]:
                    best = agent
                if worst < 0 or fitness[agent] < fitness[worst]:
                    worst = agent
        if best >= 0 and fitness[best] > fitness[worst]:
            study(brains, worst, now.sensed[best], now.acted[best], values, room)
            lessons[worst] += 1


@cached_njit(error_model="numpy")
def live(
    brains: Brains, walkers: Walkers, meadow: Meadow, group: Integers, teaching: int, steps: int
) -> tuple[Floats64, Integers]:
    """Let all agents live, and teach each other after each step in which all have acted.

    Args:
        brains: Their networks; written, where there are lessons.
        walkers: Written.
        meadow: Where they live.
        group: That each agent is in, from 0 on, int64 [agents].
        teaching: ALONE, EGALITARIAN or STUDENT_TEACHER.
        steps: Of a life.

    Returns:
        What each agent ate was worth, float64 [agents], and its lessons, int64 [agents].
    """
    agents, inputs = len(group), len(meadow.worth) * SECTORS + 1
    rows = inputs + 1 + np.diff(brains.first_node).max()
    values, room = np.zeros(rows), np.zeros(rows)
    now = Moment(np.zeros((agents, inputs)), np.zeros((agents, MOTIONS)), np.zeros(agents))
    fitness, lessons = np.zeros(agents), np.zeros(agents, np.int64)
    for _ in range(steps):
        for agent in range(agents):
            see(walkers, meadow, agent, now.sensed[agent])
            think(brains, agent, now.sensed[agent], values)
            for i in range(MOTIONS):
                now.acted[agent, i] = values[brains.output[agent, i]]
            move(walkers, meadow.size, agent, now.acted[agent, 0], now.acted[agent, 1])
            now.reward[agent] = eat(walkers, meadow, agent)
            fitness[agent] += now.reward[agent]
        if teaching == EGALITARIAN:
            _share(brains, group, now, lessons, values, room)
        elif teaching == STUDENT_TEACHER:
            _coach(brains, group, now, fitness, lessons, values, room)
    return fitness, lessons
