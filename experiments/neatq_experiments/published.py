"""The curves of Robertson & Wu (2014), one run each, read off their figures."""

from __future__ import annotations

import csv
from importlib.resources import files

import numpy as np

PAPER_NAMES = {"rtneat": "rtneat", "committed": "rtneat+q", "qlearning": "qlearning"}
"""What the paper calls what an arm of ours runs again."""


def published_curves() -> dict[tuple[str, str], np.ndarray]:
    """Mean distance over figure ticks of each published run, (task, algorithm): [points, 2]."""
    text = (files("neatq_experiments") / "data" / "paper_curves.csv").read_text()
    points: dict[tuple[str, str], list[tuple[float, float]]] = {}
    for row in csv.DictReader(text.splitlines()):
        if row["statistic"] == "mean":
            point = float(row["figure_tick"]), float(row["distance"])
            points.setdefault((row["task"], row["algorithm"]), []).append(point)
    return {key: np.array(value) for key, value in points.items()}


def curves_behind() -> dict[str, dict[str, np.ndarray]]:
    """The published curves as the figures of `neatq compare` draw them behind ours."""
    behind: dict[str, dict[str, np.ndarray]] = {}
    for (task, algorithm), curve in published_curves().items():
        behind.setdefault(task, {})[f"{algorithm} in the paper (one run)"] = curve
    return behind
