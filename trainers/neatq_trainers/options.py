"""The options of `neatq train`: those that have an effect for an arm on a task."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import Field, field, fields, is_dataclass, make_dataclass, replace
from inspect import cleandoc
from pathlib import Path
from typing import Any, get_type_hints

import tyro

from neatq_envs.scenario import Scenario
from neatq_torch.evolution import population_kinds
from neatq_torch.kinds import ConfigError
from neatq_torch.learning import learner_kinds
from neatq_trainers.config import PARTS, RunConfig, named
from neatq_trainers.effects import without_effect
from neatq_trainers.worlds import ArenaConfig, GymnasiumConfig

_HELP = """Train a population and write a run folder.

    These choose the defaults of all other options, which this help shows:
    --task NAME (wall): a built-in task, the path of a scenario file, gym:ID for a Gymnasium
    environment, or a world of your own (module:name)
    --arm NAME (neatq): a preset of population, learner and network
    --population NAME, --learner NAME: other kinds than the arm's; module:name for your own
    --env-kwargs NAME=VALUE ...: keys of the scenario (robots=30 lifetime_ticks=500), or arguments
    of the Gymnasium environment (continuous=true); values are JSON
    --reward NAME=WEIGHT ...: what counts on --task nero, of stand_ground, stick_together,
    approach_enemy, approach_flag, hit_target and avoid_fire
    --enemy turrets, none, or a team, which is a file of OpenNERO or a run folder (FOLDER:N for its
    arena N): against whom, on --task nero
    --against league, present or teams: opponents that change from round to round, on
    --task nero; league: a second population that learns, too, and what both once were; present:
    that population alone; a round has 1,000 ticks (--env-kwargs round_ticks=N)
    --held-out TEAM ...: teams that no learner meets, by which progress is measured every
    10 rounds, on --task nero
    --islands N: so many arenas of robots that exchange genomes, --migrate-every TICKS (2000),
    --migrate-to ring, random or all, --emigrants N (1) of each, --emigrants-are best or random
    --field nero, battle, drill (a curriculum) or FILE.json: where, on --task nero

    neatq list says which tasks, arms, populations and learners there are. The rarest settings of
    population.reproduction in config.json are not shown, but have options named like the others."""
_MORE = """
    out: The run folder; new or empty. Default: runs/TASK-ARM-seedSEED.
    workers: Processes; the results do not depend on it. Default: those that fit this machine.
    cluster: A Ray cluster on which these live: auto (that of this machine), ray://HOST:10001, or
        local, which begins one. If one is lost with its machine, the run goes on without it.
    changes: The changes.jsonl of a run that somebody has steered, to be repeated in this one.
    live: Open the training window; see neatq play --help for its options."""
_RARE = """interspecies_mate_prob multipoint_prob mutation.new_link_tries mutation.split_tries
    mutation.split_old_below mutation.split_weight_scale mutation.hidden_activation
    mutation.forward_from_outputs mutation.recurrent_loop_prob mutation.new_link_weight_power
    mutation.toggle_enable_prob mutation.reenable_prob crossover.copy_disabled
    crossover.inherit_disabled_prob distance.normalised"""
# Of reproduction: the help does not show them, but whoever gives them is heard.
_SCALARS = ("arenas", "seed", "batch_ticks", "checkpoint_seconds", "logger")


def chosen_names(arguments: Sequence[str]) -> list[str]:
    """The options that somebody gave, by dotted path: "learner.epsilon"."""
    given = [one[2:].partition("=")[0] for one in arguments if one.startswith("--")]
    return [name.replace("-", "_").replace(".no_", ".") for name in given]


def options_of(default: RunConfig, given: Sequence[str]) -> type:
    """A class of options whose defaults are those of a configuration.

    Those `given` are accepted even without effect, as another one may give them one.
    """
    rare = {f"population.reproduction.{name}" for name in _RARE.split()}
    hidden = {*without_effect(default), *rare, "world.id", "world.kwargs"} - {*given}
    types = get_type_hints(RunConfig)
    columns: list[Any] = [
        (name, int | None, field(default=getattr(default, name))) for name in default.world.lengths
    ]
    evaluated = isinstance(default.world, GymnasiumConfig) or "until" in given
    scalars = ("until", *_SCALARS) if evaluated else _SCALARS
    columns += [(name, types[name], field(default=getattr(default, name))) for name in scalars]
    for part in PARTS:
        own = getattr(default, part)
        shown = part != "world" or isinstance(own, GymnasiumConfig)
        if shown and any(name not in hidden for name in _names(own, part)):
            kind = _twin(own, part, hidden)
            columns.append((part, kind, field(default=kind())))
    columns += [("out", Path | None, None), ("workers", int | None, None)]
    columns += [("cluster", str | None, None)]
    columns += [("changes", Path | None, None), ("live", bool, False)]
    kind = make_dataclass("TrainOptions", columns, frozen=True, kw_only=True)
    settings = cleandoc(RunConfig.__doc__ or "").partition("\n\n")[2]
    kind.__doc__ = f"{cleandoc(_HELP)}\n\n{settings}{_MORE}"
    return kind


def with_options(default: RunConfig, options: Any) -> RunConfig:
    """A configuration with the values of parsed options.

    Raises:
        ConfigError: If one is impossible; it is called as on the command line.
    """
    values = {
        one.name: getattr(options, one.name)
        for one in fields(options)
        if one.name not in ("out", "workers", "cluster", "changes", "live")
    }
    parts = {
        name: _made(getattr(default, name), values[name], name) for name in PARTS if name in values
    }
    return replace(default, **values | parts)


def _names(part: Any, path: str) -> list[str]:
    return [] if part is None else [f"{path}.{one.name}" for one in fields(part)]


def _twin(part: Any, path: str, hidden: Iterable[str]) -> type:
    """A class with the texts of a configuration, and its values as defaults, that checks nothing.

    What it is parsed to is checked when the configuration is made of it: then the error can name
    the option.
    """
    kind, columns = type(part), []
    types = get_type_hints(kind, include_extras=True)
    for one in fields(part):
        value, name, of = getattr(part, one.name), f"{path}.{one.name}", types[one.name]
        if is_dataclass(value):
            of = _twin(value, name, hidden)
            value = of()
        column: Field[Any] = field(default=value)
        if value.__hash__ is None:
            column = field(default_factory=lambda value=value: value)
        columns.append((one.name, tyro.conf.Suppress[of] if name in hidden else of, column))
    unchecked = {"__post_init__": lambda _: None}
    return make_dataclass(
        kind.__name__, columns, bases=(kind,), namespace=unchecked, frozen=True, kw_only=True
    )


def _made(default: Any, twin: Any, path: str) -> Any:
    """The configuration of which `twin` holds the values."""
    values = {}
    for one in fields(default):
        before, now = getattr(default, one.name), getattr(twin, one.name)
        values[one.name] = _made(before, now, f"{path}.{one.name}") if is_dataclass(before) else now
    try:
        return type(default)(**values)
    except ValueError as error:
        raise ConfigError(named(path, error)) from error


def refuse_strangers(config: RunConfig, given: Sequence[str]) -> None:
    """Say why an option of another kind of part or world is not known here.

    Raises:
        ConfigError: Naming the option, and where it is known.
    """
    keys = {one.name for one in fields(Scenario)}
    for name in given:
        part, _, rest = name.partition(".")
        if part in ("population", "learner"):
            _refuse_stranger(config, part, rest)
        elif name.removeprefix("scenario.") in keys and isinstance(config.world, ArenaConfig):
            key = name.removeprefix("scenario.")
            raise ConfigError(f"{name}: a key of the scenario; expected --env-kwargs {key}=VALUE")


def _refuse_stranger(config: RunConfig, part: str, rest: str) -> None:
    kinds = population_kinds if part == "population" else learner_kinds
    own, name = getattr(config, part), rest.partition(".")[0]
    if f"{part}.{name}" in _names(own, part):
        return
    others = [kind for kind in kinds if name in {one.name for one in fields(kinds.config(kind))}]
    if others:
        mine = "none" if own is None else kinds.name_of(own)
        raise ConfigError(
            f"{part}.{rest}: it has no effect here: the {part} of the arm {config.arm} on "
            f"{config.task} is {mine}; known to {', '.join(others)} (--{part} NAME takes another)"
        )
