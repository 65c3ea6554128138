"""Teams: genomes from OpenNERO's files or from run folders, with what their networks read."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from neatq_envs.nero.scenario import NERO_ACTIONS, OBSERVATIONS
from neatq_torch.genome import Genome, NodeKind
from neatq_torch.interop.opennero import read_team_file
from neatq_torch.kinds import ConfigError
from neatq_torch.network.plan import Evaluation

if TYPE_CHECKING:
    from neatq_trainers.config import RunConfig
    from neatq_trainers.run import Run

FIRING_OF = {"opennero-2011": "2011", "opennero-2014": "2014", "nero-1": "aimed"}
"""By which law robots shoot that sense so."""
BIAS_2011, BIAS_2014 = 0.3, 1.0
"""What the bias node of an OpenNERO network was: NERO_Battle's of 2011, and NERO's of 2014."""
RUN_BIAS = 1.0
"""What bias nodes of networks are that were trained here."""


@dataclass(frozen=True, kw_only=True)
class Team:
    """Networks that fight together.

    Attributes:
        name: shown in tables; that of the file, or of the run's folder.
        genomes: one for each robot, or fewer, which are cloned.
        sensors: what they read, see `NeroScenario`.
        evaluation: how a network is activated in a tick; "opennero": synchronously, and nodes that
            nothing has reached yet are 0.
        candidates: among how many actions the greatest value chooses.
        bias: of their bias nodes.
        notes: what was left out of a file or mended.
    """

    name: str
    genomes: tuple[Genome, ...]
    sensors: str
    evaluation: Evaluation | Literal["opennero"] = "opennero"
    candidates: int = 1
    bias: float = BIAS_2011
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        actions = len(NERO_ACTIONS[self.sensors])
        outputs = self.candidates * (actions + (self.candidates > 1))
        for genome in self.genomes:
            found = genome.input_ids.size, genome.output_ids.size
            if found != (OBSERVATIONS[self.sensors], outputs):
                raise ConfigError(
                    f"{self.name}: genome {genome.genome_id}: expected "
                    f"{OBSERVATIONS[self.sensors]} inputs and {outputs} outputs, as robots that "
                    f"sense {self.sensors!r} have, got {found[0]} and {found[1]}"
                )
            if not (genome.node_kind == NodeKind.BIAS).any():
                raise ConfigError(f"{self.name}: genome {genome.genome_id}: it has no bias node")


def read_team(path: Path) -> Team:
    """The team of an OpenNERO file.

    Raises:
        TeamFileError: In one sentence, if there is none.
    """
    file = read_team_file(path)
    two = file.genomes[0].output_ids.size == 2
    return Team(
        name=path.name,
        genomes=file.genomes,
        sensors="opennero-2011" if two else "opennero-2014",
        bias=BIAS_2011 if two else BIAS_2014,
        notes=file.notes,
    )


def team_of_run(config: RunConfig, genomes: Iterable[Genome], name: str) -> Team:
    """Genomes of a run in NERO's world as a team."""
    return Team(
        name=name,
        genomes=tuple(genomes),
        sensors=config.world.schema,
        evaluation=config.network.evaluation,
        candidates=config.network.candidates,
        bias=RUN_BIAS,
    )


def present_team(run: Run, arena: int, name: str, slots: Iterable[int] | None = None) -> Team:
    """The robots of an arena, or of some of its slots, with what they have learnt so far."""
    slots = range(run.shape[1]) if slots is None else slots
    return team_of_run(run.config, (run.genome(arena, slot) for slot in slots), name)


def fittest_team(run: Run, count: int, arena: int, name: str) -> Team:
    """The fittest robots of an arena, by the weights of its rewards as they are now."""
    population = run.populations[arena]
    population.weigh(run.world.present_weights)
    best = np.argsort(-population.merit, kind="stable")[:count]
    return present_team(run, arena, name, best.tolist())
