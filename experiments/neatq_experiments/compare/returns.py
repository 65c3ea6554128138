"""Arms beside each other where the returns of episodes count: Gymnasium tasks, worlds of one's own.

`returns.csv` has a row for each task, arm, seed and generation; `return_seeds.csv` one for each
task, arm and seed. Report and figures are made from them alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from neatq_envs.render import plain_title
from neatq_experiments.anchors.anchor import AnchorConfig
from neatq_experiments.compare import statistics
from neatq_experiments.compare.cells import Cell, digest
from neatq_experiments.compare.figures import colours_of, legend_beside
from neatq_experiments.compare.report import NO_VALUE, estimate_text, markdown_table, reference_of
from neatq_experiments.compare.sizes import size_of_champion, sizes_table
from neatq_experiments.compare.tables import Tables, read_pair, write_table
from neatq_experiments.compare.variants import summary_of
from neatq_experiments.seeds import Result, Results
from neatq_torch.kinds import ConfigError
from neatq_trainers.folder import Columns, RunFolder
from neatq_trainers.names import file_name

RETURNS, RETURN_SEEDS = "returns.csv", "return_seeds.csv"
MOMENTS = 200
"""Points of a line in a figure."""
_FORM = ",.4g"
_RETURN_LEGEND = """\
Returns are sums of rewards of an episode; more is better. Square brackets hold 95 % \
bootstrap intervals over seeds.

- **steps**: of the environment, by all genomes of a run together, or in all environments of an \
anchor, mean over seeds. Evaluations and tests come on top.
- **test return**: of the champion after the run, on episodes that nobody has seen. IQM is the \
interquartile mean over seeds (Agarwal et al. 2021). A world of one's own has no test: there it is \
the mean fitness.
- **mean fitness**: mean return of the lives of all genomes, exploration included, over the last \
tenth of the steps; of an anchor, mean return of the last 100 episodes of training, likewise.
- **CPU s**: seconds of one core for 1,000 steps, evaluations and test included; in a world of \
one's own for 1,000 ticks.
- **difference**: of the test returns, mean over pairs of equal seeds. **probability of \
improvement**: share of all pairs of seeds in which the arm is better than the reference; 0.5 is \
no difference.
- **size and speed of what comes out**: parameters of the network that acts after the run, mean \
[least, most] over seeds; of an evolved network its enabled links, those from the bias included, \
of an anchor all weights and biases of its actor. A forward pass is one observation on one thread, \
the median of many, then over seeds. **of X's**: share of the mean of X's parameters.
"""


class ReturnPoint(NamedTuple):
    """A row of `returns.csv`.

    Attributes:
        task: Where it ran.
        arm: What ran.
        seed: Of worlds and genomes.
        generation: From 1; where genomes are replaced one at a time, as many lives as slots. Of an
            anchor, the number of the evaluation.
        steps: By all genomes since the beginning of the run.
        champion: Return of the champion when it was evaluated; in a world of one's own, of its
            best life.
        mean_fitness: Mean return of the lives of all genomes; of an anchor, of the last 100
            episodes of training.
    """

    task: str
    arm: str
    seed: int
    generation: int
    steps: int
    champion: float
    mean_fitness: float


class SeedReturn(NamedTuple):
    """A row of `return_seeds.csv`.

    Attributes:
        task: Where it ran.
        arm: What ran.
        seed: Of worlds and genomes.
        steps: By all genomes in the whole run.
        episodes: In which they lived, in whole generations.
        test_return: Of the champion, in episodes that nobody has seen; None where there are none.
        mean_fitness: Over the last tenth of the steps.
        cpu_seconds: For 1,000 steps, or ticks in a world of one's own. None if it was not measured.
        digest: Of the configuration; see `cells.digest`.
        parameters: Of the network that acts; of a champion's genome, its enabled links. This and
            the next columns are None where they were not noted.
        nodes: Of the champion's genome; None of an anchor.
        forward_us: Median time of a forward pass for one observation, microseconds.
        settings: Where those of an anchor come from.
    """

    task: str
    arm: str
    seed: int
    steps: int
    episodes: int
    test_return: float | None
    mean_fitness: float
    cpu_seconds: float | None
    digest: str
    parameters: int | None = None
    nodes: int | None = None
    forward_us: float | None = None
    settings: str = ""


@dataclass(frozen=True, kw_only=True)
class Returns(Tables):
    """What a comparison found where returns count.

    Attributes:
        points: The rows of `returns.csv`.
        outcomes: The rows of `return_seeds.csv`.
    """

    points: tuple[ReturnPoint, ...]
    outcomes: tuple[SeedReturn, ...]

    def scores(self, task: str, arm: str) -> dict[int, float]:
        """The return of each seed's champion in the test; without a test, the mean fitness."""
        rows = self.outcomes_of(task, arm)
        return {
            one.seed: one.mean_fitness if one.test_return is None else one.test_return
            for one in rows
        }

    def champions(self, task: str, arm: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The champion's return after so many steps [moments]: [seeds, moments], NaN before any."""
        runs: dict[int, list[ReturnPoint]] = {}
        for one in self.points:
            if (one.task, one.arm) == (task, arm):
                runs.setdefault(one.seed, []).append(one)
        moments = np.linspace(0, min(run[-1].steps for run in runs.values()), MOMENTS)
        curves = np.full((len(runs), MOMENTS), np.nan)
        for curve, run in zip(curves, runs.values(), strict=True):
            last = np.searchsorted([one.steps for one in run], moments, side="right") - 1
            known = last >= 0
            curve[known] = np.array([one.champion for one in run])[last[known]]
        return moments, curves


def returns_of_seed(run: RunFolder, metrics: Columns, arena: int) -> Result:
    """What one seed gave: its rows of metrics, and the test of its champion.

    Raises:
        ConfigError: If the run was too short for a generation.
    """
    own = {name: column[metrics["arena"] == arena] for name, column in metrics.items()}
    if not own["steps"].size:
        raise ConfigError(
            f"{run.path}: nobody has lived a whole life; expected a longer run than "
            f"{run.config.length[1]} {run.config.length[0]}"
        )
    tested, late = run.result(), own["steps"] > 0.9 * own["steps"][-1]
    return {
        "generation": own["generation"].astype(int).tolist(),
        "steps": own["steps"].astype(int).tolist(),
        "champion": own["champion_return"].tolist(),
        "fitness": own["mean_fitness"].tolist(),
        "all_steps": run.read()["done"]["steps"],
        "episodes": int(own["episodes"][-1]),
        "test_return": None if tested is None else tested["arenas"][arena]["mean"],
        "mean_fitness": float(own["mean_fitness"][late].mean()),
        **size_of_champion(run),
    }


def returns_of(cells: Sequence[Cell], results: Results) -> Returns:
    """The tables of the results of cells."""
    points, outcomes = [], []
    for cell in cells:
        for one in results[cell.name]:
            key = cell.task, cell.arm, one["seed"]
            names = "generation", "steps", "champion", "fitness"
            columns = zip(*(one[name] for name in names), strict=True)
            points += [ReturnPoint(*key, *values) for values in columns]
            names = "all_steps", "episodes", "test_return", "mean_fitness", "cpu_seconds"
            values = [*(one[name] for name in names), digest(cell.config)]
            values += [one.get(name) for name in ("parameters", "nodes", "forward_us")]
            config = cell.config
            source = config.source if isinstance(config, AnchorConfig) else ""
            outcomes.append(SeedReturn(*key, *values, settings=source))
    return Returns(points=tuple(points), outcomes=tuple(outcomes))


def write_returns(returns: Returns, folder: Path, *, compress: bool = False) -> None:
    """Write both tables; see `write_tables`."""
    write_table(folder, RETURNS, ReturnPoint, returns.points, compress=compress)
    write_table(folder, RETURN_SEEDS, SeedReturn, returns.outcomes, compress=compress)


def read_returns(folder: Path) -> Returns:
    """Read what `write_returns` wrote; see `read_tables`."""
    points, outcomes = read_pair(folder, (RETURNS, ReturnPoint), (RETURN_SEEDS, SeedReturn))
    return Returns(points=tuple(points), outcomes=tuple(outcomes))


def returns_report(returns: Returns) -> str:
    """The whole report, Markdown."""
    parts = ["# Arms beside each other: returns of episodes\n", _RETURN_LEGEND]
    for task in returns.tasks:
        picture = f"![Return of the champion over steps]({file_name(task)}.png)"
        parts += [f"## {task}\n\n{picture}\n", _arms_table(returns, task)]
        if len(returns.arms(task)) > 1:
            parts.append(_differences_table(returns, task))
        if any(one.parameters is not None for one in returns.outcomes if one.task == task):
            parts.append(sizes_table(returns.outcomes_of, task, returns.arms(task)))
    parts.append(f"Every number and figure is made from `{RETURNS}` and `{RETURN_SEEDS}`.\n")
    return "\n".join(parts)


def _arms_table(returns: Returns, task: str) -> str:
    rows = []
    for arm in returns.arms(task):
        outcomes, scores = returns.outcomes_of(task, arm), _scores(returns, task, arm)
        fitness = np.array([one.mean_fitness for one in outcomes])
        cpu = [one.cpu_seconds for one in outcomes if one.cpu_seconds is not None]
        settings = sorted({one.settings for one in outcomes} - {""})
        cells = [arm, "; ".join([summary_of(arm), *settings]), str(len(outcomes))]
        cells.append(f"{np.mean([one.steps for one in outcomes]):,.0f}")
        for estimate in (statistics.iqm_estimate(scores), statistics.mean_estimate(scores)):
            cells.append(estimate_text(estimate, _FORM))
        cells.append(estimate_text(statistics.mean_estimate(fitness), _FORM))
        cells.append(f"{np.mean(cpu):.2f}" if cpu else NO_VALUE)
        digests = sorted({one.digest for one in outcomes})
        rows.append([*cells, ", ".join(f"`{one}`" for one in digests)])
    heads = "arm, what it is, seeds, steps, test return: IQM, test return: mean, mean fitness, "
    return markdown_table(f"{heads}CPU s, digest".split(", "), rows, numbers=7)


def _scores(returns: Returns, task: str, arm: str) -> NDArray[np.float64]:
    return np.array(list(returns.scores(task, arm).values()))


def _differences_table(returns: Returns, task: str) -> str:
    arms = returns.arms(task)
    reference = reference_of(arms)
    theirs, rows = returns.scores(task, reference), []
    for arm in (one for one in arms if one != reference):
        ours = returns.scores(task, arm)
        apart = np.array([ours[seed] - theirs[seed] for seed in ours if seed in theirs])
        values = -_scores(returns, task, arm), -_scores(returns, task, reference)  # more is better
        better = estimate_text(statistics.probability_of_improvement(*values), ".2f")
        text = NO_VALUE
        if apart.size:
            text = estimate_text(statistics.mean_estimate(apart), f"+{_FORM}")
        rows.append([arm, str(apart.size), text, better])
    heads = ["arm", "pairs", f"difference to {reference}", "probability of improvement"]
    return markdown_table(heads, rows)


def draw_returns(returns: Returns, task: str) -> Figure:
    """Return of the champion over the steps of a run, and in the test after it.

    Means over seeds with 95 % intervals. The lines know the evaluations within a run alone.
    """
    figure = Figure(figsize=(8.5, 5), layout="constrained")
    axes, colours = figure.add_subplot(), colours_of(returns.arms())
    for arm in returns.arms(task):
        moments, curves = returns.champions(task, arm)
        low, high = statistics.band(curves)
        label = f"{arm} ({len(curves)} seed{'s' * (len(curves) > 1)})"
        mean = statistics.mean_of_known(curves)
        axes.plot(moments, mean, color=colours[arm], lw=1.6, label=label)
        axes.fill_between(moments, low, high, color=colours[arm], alpha=0.2, lw=0)
        outcomes = returns.outcomes_of(task, arm)
        if all(one.test_return is not None for one in outcomes):
            steps = np.mean([one.steps for one in outcomes])
            test = statistics.mean_estimate(_scores(returns, task, arm))
            reach = [[test.value - test.low], [test.high - test.value]]
            axes.errorbar(steps, test.value, reach, fmt="o", color=colours[arm], capsize=3)
    axes.set_xlabel("steps of the environment")
    axes.set_ylabel("return of the champion")
    plain_title(axes, f"{task}: what the champion reaches", fontsize=11)
    axes.set_xlim(left=0)
    axes.grid(alpha=0.3)
    legend_beside(
        figure, *axes.get_legend_handles_labels(), line="mean over seeds\ndot: test after the run"
    )
    return figure
