"""The report of a comparison, Markdown, made from its tables alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from neatq_experiments.compare import statistics
from neatq_experiments.compare.cells import CONTACT
from neatq_experiments.compare.tables import RESULTS, SEEDS, Curves, Study
from neatq_experiments.compare.variants import summary_of

HALVES_FIGURE, OVERVIEW_FIGURE = "newborn.png", "overview.png"
DIFFERENCES_FIGURE = "differences.png"
NO_VALUE = "–"  # noqa: RUF001
_DISTANCE_LEGEND = f"""\
Distances are to the flag, in units; less is better. Square brackets hold 95 % \
bootstrap intervals over seeds.

- **team**: mean distance of all robots over the last tenth of the run. IQM is the interquartile \
mean over seeds, the mean without the best and the worst quarter (Agarwal et al. 2021).
- **eligible**, **newborn**, **champion**: the same for the robots old enough to be judged, for \
the others, and for the fittest robot; means over seeds.
- **first contact**: first tick at which the nearest robot is within {CONTACT:g} units of the \
flag; looked at every 100 ticks.
- **stable contact**: first such tick from which to the end of the run the nearest robot is within \
{CONTACT:g} units at nine of ten looks or more, for at least ten looks.
- Both are medians over seeds; a seed that never gets there counts as later than all others. In \
parentheses: in how many seeds it happens.
- **champion arrives**: seeds in which the champion is within {CONTACT:g} units, on average over \
100 ticks, in at least a tenth of the last tenth; a life is 1,000 ticks long.
- **births**: over the whole run, mean over seeds. **CPU s**: seconds of one core for 1,000 ticks \
of one arena, which shares its process with the arenas of other seeds.
- **difference**: mean over pairs of equal seeds, which have equal worlds. **probability of \
improvement**: share of all pairs of seeds in which the arm's team is nearer to the flag than the \
reference's (Agarwal et al. 2021); 0.5 is no difference.
"""


def reference_of(arms: Sequence[str]) -> str:
    """The arm that others are compared with: rtneat if it is there, else the first."""
    return "rtneat" if "rtneat" in arms else arms[0]


def report(study: Study) -> str:
    """The whole report."""
    parts = ["# Arms beside each other\n", _DISTANCE_LEGEND]
    if len(study.tasks) > 1:
        parts.append(f"![All tasks side by side]({OVERVIEW_FIGURE})\n")
    if len(study.arms()) > 1:
        parts.append(f"![Differences to {reference_of(study.arms())}]({DIFFERENCES_FIGURE})\n")
    for task in study.tasks:
        parts.append(f"## {task}\n\n![Distance of the team over time]({task}.png)\n")
        parts.append(arms_table(study, task))
        if len(study.arms(task)) > 1:
            parts.append(differences_table(study, task))
    if any(point.newborn is not None for point in study.points):
        parts.append(f"## The newborn\n\n![Eligible and newborn robots]({HALVES_FIGURE})\n")
    parts.append(configurations(study))
    return "\n".join(parts)


def arms_table(study: Study, task: str) -> str:
    """What each arm came to, a row for each."""
    columns = (
        "arm, seeds, team: IQM, team: mean, eligible, newborn, champion, first contact, "
        "stable contact, champion arrives, births, CPU s"
    )
    return markdown_table(
        columns.split(", "), [_arm_row(study, task, arm) for arm in study.arms(task)]
    )


def _arm_row(study: Study, task: str, arm: str) -> list[str]:
    outcomes = study.outcomes_of(task, arm)
    team = study.curves(task, arm, "team").last_tenth()
    parts = ("eligible", "newborn", "champion")
    others = [study.curves(task, arm, name).last_tenth() for name in parts]
    cpu = [one.cpu_seconds for one in outcomes if one.cpu_seconds is not None]
    return [
        arm,
        str(len(outcomes)),
        estimate_text(statistics.iqm_estimate(team)),
        estimate_text(statistics.mean_estimate(team)),
        *(_known_mean(values) for values in others),
        _median([one.first_contact for one in outcomes]),
        _median([one.stable_contact for one in outcomes]),
        f"{sum(one.champion_reaches for one in outcomes)} of {len(outcomes)}",
        f"{study.curves(task, arm, 'births').values[:, -1].mean():,.0f}",
        f"{np.mean(cpu):.2f}" if cpu else NO_VALUE,
    ]


def differences_table(study: Study, task: str) -> str:
    """Each arm against the reference, over the same seeds."""
    arms = study.arms(task)
    reference = reference_of(arms)
    base = study.curves(task, reference, "team")
    rows = []
    for arm in (one for one in arms if one != reference):
        ours = study.curves(task, arm, "team")
        apart = paired_differences(ours, base)
        better = statistics.probability_of_improvement(ours.last_tenth(), base.last_tenth())
        difference = (
            estimate_text(statistics.mean_estimate(apart), "+.1f") if apart.size else NO_VALUE
        )
        rows.append([arm, str(apart.size), difference, estimate_text(better, ".2f")])
    heads = ["arm", "pairs", f"difference to {reference}", "probability of improvement"]
    return markdown_table(heads, rows)


def paired_differences(ours: Curves, theirs: Curves) -> NDArray[np.float64]:
    """Ours less theirs over the last tenth, of the seeds that both have [pairs]."""
    _, own, other = np.intersect1d(ours.seeds, theirs.seeds, return_indices=True)
    return ours.last_tenth()[own] - theirs.last_tenth()[other]


def configurations(study: Study) -> str:
    """Which configuration each arm had."""
    rows = []
    for task in study.tasks:
        for arm in study.arms(task):
            outcomes = study.outcomes_of(task, arm)
            ticks = ", ".join(f"{one:,}" for one in sorted({one.ticks for one in outcomes}))
            digests = ", ".join(f"`{one}`" for one in sorted({one.digest for one in outcomes}))
            rows.append([task, arm, summary_of(arm), ticks, _ranges(study, task, arm), digests])
    heads = ["task", "arm", "what it is", "ticks", "seeds", "digest"]
    text = (
        "## Configurations\n\nThe digest is that of the configuration without seed and length; "
        "another one means that the arm or the task was changed since.\n"
    )
    made = f"\nEvery number and figure is made from `{RESULTS}` and `{SEEDS}`.\n"
    return f"{text}\n{markdown_table(heads, rows, numbers=0)}{made}"


def _ranges(study: Study, task: str, arm: str) -> str:
    """The seeds, as `0-19`, or one by one where some are missing between."""
    seeds = sorted(one.seed for one in study.outcomes_of(task, arm))
    if len(seeds) > 1 and seeds[-1] - seeds[0] == len(seeds) - 1:
        return f"{seeds[0]}-{seeds[-1]}"
    return ", ".join(map(str, seeds))


def markdown_table(
    heads: Sequence[str], rows: Sequence[Sequence[str]], numbers: int | None = None
) -> str:
    """A Markdown table whose last columns are numbers: so many, or all but the first."""
    numbers = len(heads) - 1 if numbers is None else numbers
    rule = ["---"] * (len(heads) - numbers) + ["---:"] * numbers
    return "".join(f"| {' | '.join(cells)} |\n" for cells in (heads, rule, *rows))


def estimate_text(estimate: statistics.Estimate, form: str = ".1f") -> str:
    """A value and its interval."""
    value, low, high = (format(one, form) for one in estimate)
    return f"{value} [{low}, {high}]"


def _known_mean(values: NDArray[np.float64]) -> str:
    known = values[~np.isnan(values)]
    return f"{known.mean():.1f}" if known.size else NO_VALUE


def _median(ticks: Sequence[int | None]) -> str:
    """Median with None as later than everything, and how many there are."""
    there = sum(tick is not None for tick in ticks)
    ordered = sorted(np.inf if tick is None else tick for tick in ticks)
    pair = ordered[(len(ordered) - 1) // 2], ordered[len(ordered) // 2]
    median = NO_VALUE if np.inf in pair else f"{sum(pair) / 2:,.0f}"
    return f"{median} ({there} of {len(ticks)})"
