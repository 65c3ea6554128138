"""What is to be seen of a run: its field in clips, its robots one by one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase
from torch import Tensor

from neatq_envs.nero.scenario import NERO_ACTIONS, REWARD_NAMES, NeroScenario
from neatq_envs.scenario import REWARD_DIMENSIONS
from neatq_envs.sensors import (
    FRIEND_RANGE,
    RADAR_RANGE,
    RADAR_REAR_DEG,
    RADAR_SECTORS_DEG,
    RAY_ANGLES_RAD,
    RAY_LENGTH,
)
from neatq_envs.torchrl_env import FieldEnv
from neatq_torch.evolution import RtNEAT
from neatq_torch.genome import Genome, NodeKind
from neatq_torch.interop.graphs import graph_links, graph_nodes
from neatq_torch.learning import CriticConfig, Teacher
from neatq_torch.network import GenomeNetwork
from neatq_trainers.genome_figure import candidate_names, node_columns, node_names
from neatq_trainers.live.messages import CHANNELS, Clip
from neatq_trainers.nero.nero_world import NeroConfig
from neatq_trainers.run import Run
from neatq_trainers.worlds import ArenaConfig, EnvConfig

FRAMES_PER_SECOND = 30
MOST_ANCESTORS = 60
_COLOURS = {
    "fitness": "fitness",
    "age": "age_ticks",
    "species": "species",
    "Q-value": "value",
    "TD error": "td_error",
    "hit points": "hit_points",
}


class Scene:
    """Looks at the first arena of a run, and remembers what a run forgets.

    Args:
        run: What to look at.
    """

    def __init__(self, run: Run) -> None:
        self.run = run
        self._born: dict[int, Genome] = {}
        self._lineage: dict[int, tuple[tuple[int, ...], int]] = {}
        self._batch: TensorDictBase | None = None
        self._error = np.full(run.shape[1], np.nan)
        self._past: list[tuple[np.ndarray, np.ndarray]] = []

    @property
    def has_field(self) -> bool:
        """Whether there are robots on a field."""
        return isinstance(self.run.world.env, FieldEnv)

    @property
    def field(self) -> Any:
        """The field: an `Arena` or a `TrainingField`."""
        return self.run.world.env.arena

    def see(self, batch: TensorDictBase, error: Tensor) -> None:
        """Look at a batch [arenas, slots, ticks] and its errors [arenas, slots]."""
        self._batch, self._error = batch, error[0].numpy()
        if isinstance(self.run.config.world, NeroConfig):
            self._past = self.field.trail or []
        self.look()

    @property
    def seen(self) -> bool:
        """Whether there was a batch to look at."""
        return self._batch is not None

    def look(self) -> None:
        """Keep what happens in each tick from now on, where a batch does not hold it."""
        if isinstance(self.run.config.world, NeroConfig):
            self.field.trail = []

    def look_away(self) -> None:
        """Keep nothing of what happens until the next look."""
        if isinstance(self.run.config.world, NeroConfig):
            self.field.trail = None

    def note_births(self) -> None:
        """Remember how those who were born last were before they learnt, and of whom."""
        for one in self.run.replacements[0] if self.run.replacements else ():
            self._born[one.slot] = one.genome
            self._lineage[one.genome.genome_id] = one.parents, self.run.tick

    # ------------------------------------------------------------------------ the field
    def clip(self, seconds: float, step: int) -> Clip:
        """The batch that was seen last, a frame for every so many ticks, to be played in a time."""
        assert self._batch is not None
        pose = self._batch.get("next").get("pose")[0].numpy().swapaxes(0, 1)
        ticks = len(pose)
        frames = np.arange(ticks - 1, -1, -step)[::-1]  # the last one is always there
        poses, robots = pose[frames], self._robots()
        shots = np.zeros((0, 6), np.float32)
        if isinstance(self.field.scenario, NeroScenario):
            poses, robots, shots = self._with_enemies(poses, robots, frames)
        return Clip(
            tick=self.run.tick - ticks + 1 + int(frames[0]),
            ticks_per_frame=step,
            seconds=seconds,
            poses=poses,
            robots=robots,
            flags=np.broadcast_to(self._flags(), (len(frames), *self._flags().shape)),
            shots=shots,
        )

    def _robots(self) -> np.ndarray:
        """`CHANNELS` of the learners, float32 [robots, channels]."""
        run, batch = self.run, self._batch
        assert batch is not None
        values = np.full((run.shape[1], len(CHANNELS)), np.nan, np.float32)
        columns = dict(zip(CHANNELS, values.T, strict=True))
        if run.populations:
            population = run.populations[0]
            judged = population.eligible
            columns["fitness"][judged] = np.asarray(population.merit)[judged]
            for one in population.species:
                columns["species"][one.members] = one.species_id
        columns["age_ticks"][:] = self._ages()
        if self.tells_values:
            columns["value"][:] = batch.get("chosen_action_value")[0, :, -1, 0].numpy()
        columns["td_error"][:] = self._error
        columns["team"][:], columns["alive"][:] = 0, 1
        return values

    def _ages(self) -> np.ndarray:
        population = self.run.populations[0] if self.run.populations else None
        if isinstance(population, RtNEAT):
            return population.age_ticks
        return self.field.age_ticks[0] if self.has_field else np.full(self.run.shape[1], np.nan)

    def _flags(self) -> np.ndarray:
        """Place of each flag and whether it counts, float32 [flags, 3]."""
        if isinstance(self.field.scenario, NeroScenario):
            flag = self.field.scenario.flag
            return np.array([] if flag is None else [(*flag, 1.0)], np.float32).reshape(-1, 3)
        counting = tuple(self.field.flag[0].tolist())
        flag = self.field.scenario.flag
        others = [at for at in flag.positions if flag.switch_ticks and at != counting]
        rows = [(*counting, 1.0), *((*at, 0.0) for at in others)]
        return np.array(rows, np.float32)

    def _with_enemies(
        self, poses: np.ndarray, robots: np.ndarray, frames: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Poses and channels with all others on NERO's field, and who shot at whom."""
        field, past = self.field.fields[0], self._past[-(int(frames[-1]) + 1) :]
        own, everybody = self.run.shape[1], len(field.team)
        if [len(pose) for pose, _ in past] != [everybody] * (frames[-1] + 1):  # a first look
            past = [(field.pose, np.full(everybody, -1))] * (frames[-1] + 1)
        seen = np.stack([past[frame][0] for frame in frames]).astype(np.float32)
        seen[:, :own] = poses
        shots = [
            (at, *pose[robot, :2], *pose[target, :2], field.team[robot])
            for at, frame in enumerate(frames)
            for pose, shot in (past[frame],)
            for robot, target in enumerate(shot.tolist())
            if target >= 0
        ]
        values = np.full((everybody, len(CHANNELS)), np.nan, np.float32)
        values[:own] = robots
        columns = dict(zip(CHANNELS, values.T, strict=True))
        columns["hit_points"][:] = self.field.scenario.hit_points - field.damage
        columns["team"][:], columns["alive"][:] = field.team, field.alive
        return seen, values, np.array(shots, np.float32).reshape(-1, 6)

    # ------------------------------------------------------------------------ one robot
    def robot(self, slot: int) -> dict[str, Any]:
        """All that is to be seen of the robot in a slot."""
        run, batch = self.run, self._batch
        message: dict[str, Any] = {"type": "robot", "slot": slot, "fitness": None}
        if batch is None:
            return message
        last: Any = batch[0, slot, -1]
        observation = last.get("observation")
        message["observation"] = observation.tolist()
        message["action"] = np.atleast_1d(last.get("action").numpy()).tolist()
        message["rewards"] = self._reward_parts(slot)
        message["candidates"] = self._candidates(last)
        if not run.populations:
            return message | {"age_ticks": int(self._ages()[slot])}
        population, genome = run.populations[0], run.genome(0, slot)
        owner = {member: one.species_id for one in population.species for member in one.members}
        if run.normalization is not None:
            observation = run.normalization(batch.get("observation")[..., -1, :])[0, slot]
        message |= {
            "genome_id": genome.genome_id,
            "born_tick": self._lineage.get(genome.genome_id, ((), None))[1],
            "age_ticks": _known_ticks(self._ages()[slot]),
            "species": owner.get(slot),
            "fitness": float(population.merit[slot]) if population.eligible[slot] else None,
            "teacher": self._teacher(slot),
            "activations": activations(genome, observation, run.config.network.evaluation),
            "ancestors": self._ancestors(genome.genome_id),
            "network": self._network(slot, genome),
        }
        return message

    def table(self) -> list[dict[str, Any]]:
        """A row of words and numbers for each robot."""
        run = self.run
        if not run.populations:
            return [
                {"slot": slot, "age_ticks": _known_ticks(age)}
                for slot, age in enumerate(self._ages())
            ]
        population = run.populations[0]
        owner = {member: one.species_id for one in population.species for member in one.members}
        merit, judged, ages = population.merit, population.eligible, self._ages()
        marks = {name: getattr(population, name, ()) for name in ("protected", "preferred")}
        return [
            {
                "slot": slot,
                "genome_id": genome.genome_id,
                "age_ticks": _known_ticks(ages[slot]),
                "species": owner.get(slot),
                "fitness": float(merit[slot]) if judged[slot] else None,
                "links": int(genome.link_enabled.sum()),
                "teacher": self._teacher(slot),
                **{name: genome.genome_id in marks[name] for name in marks},
            }
            for slot, genome in enumerate(population.genomes)
        ]

    def species(self) -> dict[str, int]:
        """How many robots each species has."""
        populations = self.run.populations
        found = populations[0].species if populations else []
        return {str(one.species_id): len(one.members) for one in found}

    @property
    def tells_values(self) -> bool:
        """Whether networks put out Q-values."""
        config = self.run.config
        return (
            config.learns
            and not isinstance(config.learner, CriticConfig)
            and bool(self.run.populations)
        )

    def _candidates(self, last: TensorDictBase) -> list[dict[str, Any]]:
        """What a robot weighed in its last tick, the one that it took first."""
        action, values = last.get("action"), last.get("action_value", None)
        taken = {"action": np.atleast_1d(action.numpy()).tolist(), "value": None}
        if values is None or not self.tells_values:
            return [taken]
        index = int(last.get("candidate_index"))
        candidates = np.atleast_2d(last.get("candidates").numpy().reshape(len(values), -1))
        known = values.tolist()
        taken["value"] = known[index]
        others = [
            {"action": candidates[i].tolist(), "value": known[i]}
            for i in sorted(range(len(known)), key=lambda i: -known[i])
            if i != index
        ]
        return [taken, *others]

    def _reward_parts(self, slot: int) -> dict[str, float]:
        """Means over the batch: of what is learnt from, and of each part that counts."""
        assert self._batch is not None
        following = self._batch.get("next")
        parts = {"learnt from": float(following.get("reward")[0, slot].mean())}
        vector = following.get("reward_vector", None) if self.has_field else None
        names = REWARD_NAMES if vector is not None and vector.shape[-1] == 6 else REWARD_DIMENSIONS
        if vector is not None:
            weights = self.run.world.present_weights
            for name, weight, mean in zip(names, weights, vector[0, slot].mean(0), strict=False):
                if weight:
                    parts[name] = float(mean)
        return parts

    def _teacher(self, slot: int) -> str | None:
        teachers = self.run.teachers
        return None if teachers is None else Teacher(int(teachers.values[0, slot])).name.lower()

    def _network(self, slot: int, genome: Genome) -> dict[str, Any]:
        """The graph of a genome: nodes in columns, links with what learning made of them."""
        names, columns = node_names(genome, *self.names()), node_columns(genome)
        born = self._born.get(slot)
        same = born is not None and born.genome_id == genome.genome_id
        before = born.link_weight if born is not None and same else genome.link_weight
        nodes = [
            {"id": node, "kind": kind, "activation": activation, "name": name, "column": column}
            for (node, kind, activation), name, column in zip(
                graph_nodes(genome), names, (columns / columns.max()).tolist(), strict=True
            )
        ]
        links = [
            {
                "from": source,
                "to": target,
                **link,
                "born": float(weight) if same else None,
            }
            for (source, target, _, link), weight in zip(graph_links(genome), before, strict=True)
        ]
        return {"nodes": nodes, "links": links}

    def names(self) -> tuple[Sequence[str] | None, Sequence[str] | None]:
        """Names of inputs and outputs; None: those that the genome's schema says."""
        if isinstance(self.run.config.world, NeroConfig):
            actions = NERO_ACTIONS[self.field.scenario.sensors]
            return None, candidate_names(self.run.heads.candidates, actions)
        return None, None

    def _ancestors(self, genome_id: int) -> list[dict[str, Any]]:
        """A robot, its parents and theirs, the latest first, as far as they are known."""
        found: list[dict[str, Any]] = []
        waiting = {genome_id}
        while waiting and len(found) < MOST_ANCESTORS:
            number = max(waiting)
            waiting.remove(number)
            parents, tick = self._lineage.get(number, ((), None))
            if number <= self.run.shape[1]:
                tick = 0  # a founder
            own = sorted({*parents})
            found.append({"genome_id": number, "parents": own, "born_tick": tick})
            waiting |= {*own}
        return found

    # ------------------------------------------------------------------------ once
    def introduction(self) -> dict[str, Any]:
        """What does not change: names, sensors, what colours can mean."""
        run = self.run
        facts: dict[str, Any] = {
            "world": "env",
            "robots": run.shape[1],
            "channels": ["x", "y", "heading_rad", *CHANNELS],
            "colours": self._colours(),
            "observations": self._observations(),
            "actions": [],
            "sensors": None,
        }
        if not self.has_field:
            own = isinstance(run.config.world, EnvConfig)
            return facts | {"world": "env" if own else "gymnasium"}
        space = run.world.env.action_spec.space
        low, high = (bound[0, 0].tolist() for bound in (space.low, space.high))
        facts |= {"action_low": low, "action_high": high}
        if isinstance(run.config.world, ArenaConfig):
            schema = self.field.schema
            return facts | {"world": "arena", "actions": list(schema.actions), "sensors": SENSES}
        return facts | {"world": "nero", "actions": list(NERO_ACTIONS[self.field.scenario.sensors])}

    def _colours(self) -> list[dict[str, Any]]:
        config, found = self.run.config, []
        for name, channel in _COLOURS.items():
            if channel == "value" and not self.tells_values:
                continue
            if channel == "td_error" and not config.learns:
                continue
            if channel in ("fitness", "species") and not self.run.populations:
                continue
            if channel == "hit_points" and isinstance(config.world, ArenaConfig):
                continue
            colour: dict[str, Any] = {"name": name, "channel": 3 + CHANNELS.index(channel)}
            found.append(colour | ({"categorical": True} if name == "species" else {}))
        return found

    def _observations(self) -> list[str]:
        if not self.run.populations:
            return []
        genome = self.run.populations[0].genomes[0]
        names = node_names(genome, *self.names())
        return [names[node] for node in np.flatnonzero(genome.node_kind == NodeKind.INPUT)]


SENSES = {
    "wall_rays_deg": np.degrees(RAY_ANGLES_RAD).round(6).tolist(),
    "wall_ray_length": RAY_LENGTH,
    "flag_sectors_deg": [
        *([low, high] for high, low in RADAR_SECTORS_DEG),
        [RADAR_REAR_DEG, 360 - RADAR_REAR_DEG],
    ],
    "flag_radius": RADAR_RANGE,
    "friend_radius": FRIEND_RANGE,
}
"""The senses of the arena, as a page draws them."""


def activations(genome: Genome, observation: Tensor, evaluation: Any) -> dict[str, float]:
    """What each node of a network is for an observation [inputs], by its id.

    A recurrent network is read as if it had seen nothing before.
    """
    kinds = np.where(genome.node_kind == NodeKind.HIDDEN, NodeKind.OUTPUT, genome.node_kind)
    probe = GenomeNetwork(genome.replaced(node_kind=kinds), evaluation=evaluation)
    with torch.no_grad():
        outputs, _ = probe.step(observation)
    values = dict(zip(genome.input_ids.tolist(), observation.tolist(), strict=True))
    bias = genome.node_id[genome.node_kind == NodeKind.BIAS].tolist()
    values |= dict.fromkeys(bias, 1.0)
    ids = genome.node_id[kinds == NodeKind.OUTPUT].tolist()
    values |= dict(zip(ids, outputs.tolist(), strict=True))
    return {str(node): round(value, 4) for node, value in values.items()}


def _known_ticks(number: float) -> int | None:
    return None if np.isnan(number) else int(number)


def state_words(values: Mapping[str, Any]) -> dict[str, Any]:
    """Values as JSON can have them: NaN and infinities become None."""
    return {
        name: None if isinstance(one, float) and not np.isfinite(one) else one
        for name, one in values.items()
    }
