"""NERO's sliders: does each of the six rewards move what it is about?

Each reward alone at +100 % and at -100 %, the two ends of its slider in NERO, for the same seeds.
A team lives on one field with a turret and a flag, within the turret's range from its first tick
on. What is compared is the team's mean over the last tenth of a run.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from neatq_envs.render import plain_title
from neatq_experiments.compare.statistics import mean_estimate
from neatq_experiments.experiment import Experiment
from neatq_experiments.seeds import Result, Results, SeedTask, run_seeds
from neatq_trainers.arms import preset
from neatq_trainers.folder import load_run
from neatq_trainers.nero.nero_world import NERO


class Slider(NamedTuple):
    """What a reward is about.

    Attributes:
        measure: Column of `metrics.csv`.
        label: What it is called.
        wanted: 1 if the reward wants more of it, -1 if less.
    """

    measure: str
    label: str
    wanted: int


SLIDERS: dict[str, Slider] = {
    "stand_ground": Slider("speed", "speed (units a tick)", -1),
    "stick_together": Slider("friend_distance", "nearest friend (units)", -1),
    "approach_enemy": Slider("enemy_distance", "nearest enemy (units)", -1),
    "approach_flag": Slider("flag_distance", "flag (units)", -1),
    "hit_target": Slider("hits", "hits of a robot in 100 ticks", 1),
    "avoid_fire": Slider("damage", "damage of a robot in 100 ticks", -1),
}
FIELD: Mapping[str, Any] = {"flag": [550.0, 266.0]}
"""What is changed of the field `nero`; its turret is at (400, 450), the spawn at (400, 267)."""
TICKS, QUICK_TICKS = 5_000, 400
SIGNS = {"up": 1.0, "down": -1.0}
COLOURS = {"rtneat": "tab:gray", "neatq": "tab:green"}
"""The arms, and how they are drawn."""
ARM_NAMES = tuple(f"{arm}-{name}-{end}" for name in SLIDERS for arm in COLOURS for end in SIGNS)


def run_slider(task: SeedTask) -> list[Result]:
    """Train the seeds of an arm, which is called ARM-REWARD-up or ARM-REWARD-down."""
    arm, name, end = task.arm.split("-")
    kwargs = {**FIELD, "reward_weights": {name: SIGNS[end]}}
    length = {"ticks": QUICK_TICKS if task.quick else TICKS}
    config = preset(NERO, arm, env_kwargs=kwargs, length=length)
    metrics = load_run(run_seeds(task, config)).metrics()
    last = metrics["tick"] > 0.9 * metrics["tick"].max()
    first = task.seeds[0]
    return [
        {
            slider.measure: float(
                metrics[slider.measure][last & (metrics["arena"] == seed - first)].mean()
            )
            for slider in SLIDERS.values()
        }
        for seed in task.seeds
    ]


def at_both_ends(results: Results, arm: str, name: str) -> np.ndarray:
    """A reward's own measure at +100 % and at -100 %, of seeds that have both: [2, seeds]."""
    up, down = (
        {one["seed"]: one[SLIDERS[name].measure] for one in results.get(f"{arm}-{name}-{end}", [])}
        for end in SIGNS
    )
    both = [seed for seed in up if seed in down]
    return np.array([[end[seed] for seed in both] for end in (up, down)], float)


def sliders_table(results: Results) -> str:
    """A Markdown table: each reward's own measure at both ends of its slider."""
    lines = [
        "| reward | measure | arm | seeds | at +100 % | at -100 % | difference | as it should be |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for name, slider in SLIDERS.items():
        for arm in COLOURS:
            up, down = at_both_ends(results, arm, name)
            if not up.size:
                continue
            found = [mean_estimate(one) for one in (up, down, up - down)]
            cells = " | ".join(f"{one.value:.3g} [{one.low:.3g}, {one.high:.3g}]" for one in found)
            ends = sorted(slider.wanted * end for end in found[2][1:])
            said = (
                "yes" if ends[0] > 0 else "no: the other way" if ends[1] < 0 else "not told apart"
            )
            lines.append(f"| {name} | {slider.label} | {arm} | {up.size} | {cells} | {said} |")
    return "\n".join(lines) + "\n"


def draw_sliders(results: Results) -> Figure:
    """A panel for each reward: its own measure at both ends of the slider, seeds and means."""
    figure = Figure(figsize=(10, 5.4), layout="constrained")
    for axes, (name, slider) in zip(figure.subplots(2, 3).flat, SLIDERS.items(), strict=True):
        for shift, (arm, colour) in zip((-0.12, 0.12), COLOURS.items(), strict=True):
            up, down = at_both_ends(results, arm, name)
            if not up.size:
                continue
            for place, part in enumerate((down, up)):
                axes.plot(np.full(part.size, place + shift), part, "o", c=colour, ms=3, alpha=0.4)
            axes.plot([shift, 1 + shift], [down.mean(), up.mean()], color=colour)
        axes.set_xticks([0, 1], ["-100 %", "+100 %"])
        axes.set_xlim(-0.4, 1.4)
        axes.set_ylabel(slider.label, fontsize=8)
        plain_title(axes, f"{name}: {'more' if slider.wanted > 0 else 'less'} is right")
        axes.grid(alpha=0.3)
    lines = [Line2D([], [], color=colour, label=arm) for arm, colour in COLOURS.items()]
    figure.legend(handles=lines, loc="outside lower center", ncols=2, frameon=False)
    return figure


NERO_SLIDERS = Experiment(
    name="nero-sliders",
    summary="NERO: what each of the six rewards alone makes of a team, at both ends of its slider",
    arms=ARM_NAMES,
    seeds=10,
    quick_seeds=2,
    batch=10,
    run=run_slider,
    table=sliders_table,
    figure=draw_sliders,
)
