"""The pictures of a run on a Gymnasium task, drawn from its folder alone."""

from __future__ import annotations

import math

import gymnasium
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from PIL import Image

from neatq_envs.gymnasium_task import TaskError
from neatq_envs.render import animation
from neatq_envs.torchrl_rows import episode_seeds
from neatq_torch.atomic import write_atomic
from neatq_trainers.generational.folder import ANIMATION, PICTURE, GenerationalFolder
from neatq_trainers.generational.policy import ChampionPolicy, make_policy
from neatq_trainers.generational.purposes import TEST
from neatq_trainers.generational.run import Champion, Run
from neatq_trainers.genome_figure import draw_genome
from neatq_trainers.report import Metrics, read_metrics, save_figure
from neatq_trainers.run_files import CURVES

MOST_FRAMES = 150
WIDEST = 300
"""Pixels of a frame of the animation."""


def write_report(folder: GenerationalFolder) -> list[str]:
    """Write `curves.png`, `champion.png` and `champion.gif` into the folder of a run.

    Returns:
        What was left out, and why.
    """
    run = folder.read()
    champion = run.best
    if champion is None:
        return []
    title = f"{run.config.arm} on {run.config.environment.id}"
    save_figure(draw_curves(read_metrics(folder.path), title), folder.path / CURVES)
    policy = make_policy(run.config, run.surroundings, champion.genome)
    picture = draw_genome(
        champion.genome,
        input_names=[f"observation {i}" for i in range(policy.network.inputs)],
        output_names=output_names(run, policy),
    )
    save_figure(picture, folder.path / PICTURE)
    try:
        frames = film(run, policy, champion)
    except TaskError as error:
        return [f"{ANIMATION}: {error}"]
    if frames:
        write_atomic(folder.path / ANIMATION, animation(frames))
    return []


def draw_curves(metrics: Metrics, title: str) -> Figure:
    """Return over episodes: that of the champion, and the fitness of the generations.

    With several arenas the lines are means over arenas, the bands cover all of them.

    Args:
        metrics: Columns as `read_metrics` gives them.
        title: What ran.
    """
    figure = Figure(figsize=(8, 5.2), layout="tight")
    axes = figure.add_subplot()
    arenas = len(np.unique(metrics["arena"]))
    _draw_curve(axes, metrics, "mean_fitness", "tab:green", "mean of the generation")
    _draw_curve(axes, metrics, "best_fitness", "0.6", "best of the generation, in its own life")
    _draw_curve(axes, metrics, "champion_return", "tab:blue", "champion, in held-out episodes")
    axes.set_xlabel("episodes lived in an arena")
    axes.set_ylabel("return of an episode")
    axes.set_title(title if arenas == 1 else f"{title}: mean and range of {arenas} arenas")
    axes.set_xlim(0, metrics["episodes"].max())
    axes.grid(alpha=0.3)
    axes.legend(frameon=False)
    return figure


def _draw_curve(axes: Axes, metrics: Metrics, name: str, colour: str, label: str) -> None:
    moments = np.unique(metrics["episodes"])
    values = np.stack([metrics[name][metrics["episodes"] == moment] for moment in moments])
    marker = "o" if len(moments) == 1 else None
    # A champion stays until another one is better.
    steps = "post" if name == "champion_return" else None
    style = f"steps-{steps}" if steps else "default"
    axes.plot(
        moments, values.mean(1), color=colour, lw=1.6, label=label, marker=marker, drawstyle=style
    )
    if values.shape[1] > 1:
        low, high = values.min(1), values.max(1)
        axes.fill_between(moments, low, high, color=colour, alpha=0.15, lw=0, step=steps)


def output_names(run: Run, policy: ChampionPolicy) -> list[str]:
    """What the outputs of a network mean."""
    outputs, choices = policy.network.outputs, policy.interface.choices
    if choices is not None:
        value = "value of action" if run.config.learning.rule != "none" else "action"
        return [f"{value} {action}" for action in range(choices)]
    actions, candidates = len(policy.interface.bounds[0]), run.config.network.candidates
    if candidates == 1:
        return [f"action {action}" for action in range(actions)]
    names = [f"candidate {c} action {a}" for c in range(candidates) for a in range(actions)]
    return names + [f"value of candidate {c}" for c in range(outputs - len(names))]


def film(run: Run, policy: ChampionPolicy, champion: Champion) -> list[np.ndarray]:
    """Frames, uint8 [height, width, 3], of the champion's first test episode.

    None if the environment draws nothing.

    Raises:
        TaskError: If something is missing that it needs to draw.
    """
    task = run.config.environment
    plain = task.make()
    modes = plain.metadata.get("render_modes") or ()
    plain.close()
    if "rgb_array" not in modes:
        return []
    arena = next(i for i, one in enumerate(run.champions) if one is champion)
    seed = int(episode_seeds(run.config.seeds[arena], 0, 1, purpose=TEST)[0])
    env = task.make(render_mode="rgb_array")
    frames = []
    try:
        policy.reset()
        observation, _ = env.reset(seed=seed)
        done = False
        while not done:
            frames.append(_small(np.asarray(env.render())))
            observation, _, terminated, truncated, _ = env.step(policy(observation))
            done = terminated or truncated
    except gymnasium.error.DependencyNotInstalled as error:
        raise TaskError(f"left out: {error}") from error
    finally:
        env.close()
    return frames[:: math.ceil(len(frames) / MOST_FRAMES)]


def _small(frame: np.ndarray) -> np.ndarray:
    image = Image.fromarray(frame)
    image.thumbnail((WIDEST, WIDEST))
    return np.asarray(image)
