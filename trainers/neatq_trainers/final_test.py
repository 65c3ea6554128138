"""The champions of a Gymnasium task, tested on episodes that nobody has seen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from neatq_envs.episodes import TEST, episode_seeds
from neatq_trainers.build import heads_of
from neatq_trainers.run import Champion
from neatq_trainers.worlds import GymnasiumConfig, GymnasiumWorld, make_world

if TYPE_CHECKING:
    from neatq_trainers.session import Session


def judge_champions(session: Session, champions: Sequence[Champion | None]) -> None:
    """Test the champions of a Gymnasium task on episodes that nobody has seen."""
    config, facts = session.config, session.facts
    if not isinstance(config.world, GymnasiumConfig) or None in champions:
        return
    world = make_world(config.world, config.seeds, episodes=1, facts=facts)
    assert isinstance(world, GymnasiumWorld)
    assert facts is not None
    seeds = [
        episode_seeds(seed, 0, config.world.test_episodes, purpose=TEST) for seed in config.seeds
    ]
    known = [one for one in champions if one is not None]
    returns = world.returns(
        [one.genome for one in known],
        np.stack(seeds),
        heads_of(config, world),
        config.network.evaluation,
        double_activation=config.network.double_activation,
        scalings=[one.scaling for one in known],
    )
    world.close()
    arenas = [
        {
            "arena": arena,
            "seed": config.seeds[arena],
            "generation": champion.generation,
            "evaluated_return": champion.score,
            **summary(returns[arena]),
        }
        for arena, champion in enumerate(known)
    ]
    best = max(range(len(known)), key=lambda arena: known[arena].score)
    session.folder.write_result(
        {
            "task": config.task,
            "arm": config.arm,
            "generations": session.lengths["generations"],
            "champion": arenas[best],
            "arenas": arenas,
            "repeatable": facts.repeatable,
            **_solved(session, best, known[best]),
        }
    )
    if solved := session.folder.solved():
        session.folder.notes.append(f"solved {solved}")
    session.folder.notes.append(_said(arenas[best], arenas))


def _solved(session: Session, arena: int, champion: Champion) -> dict[str, float]:
    """By which return and after how many steps the best champion solved the task, if it did."""
    until, rows = session.config.until, session.folder.metrics()
    if until is None or champion.score < until:
        return {}
    crowned = (rows["arena"] == arena) & (rows["generation"] == champion.generation)
    return {"until": until, "solved_after_steps": int(rows["steps"][crowned][0])}


def _said(best: Mapping[str, Any], arenas: Sequence[Mapping[str, Any]]) -> str:
    """What the test of the champions showed, in a line."""
    text = (
        f"champion of arena {best['arena']}: return {best['mean']:.1f} ± "
        f"{best['standard_error']:.1f} (mean and standard error of {best['episodes']} new episodes)"
    )
    if len(arenas) > 1:
        every = summary(np.array([one["mean"] for one in arenas]))
        text += (
            f"; of all {len(arenas)} arenas: {every['mean']:.1f} ± "
            f"{every['standard_error']:.1f} over arenas"
        )
    return text


def summary(returns: np.ndarray) -> dict[str, float | int]:
    """Mean and standard error over episodes [episodes]."""
    error = float(returns.std(ddof=1) / np.sqrt(returns.size)) if returns.size > 1 else 0.0
    return {"mean": float(returns.mean()), "standard_error": error, "episodes": returns.size}
