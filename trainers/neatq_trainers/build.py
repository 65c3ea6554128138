"""A run, made from its configuration and, to go on, from a saved state."""

from __future__ import annotations

import numpy as np

from neatq_envs.machines import Crew
from neatq_envs.random_play import LARGEST, EnvFacts
from neatq_torch.evolution import Population, RtNEAT, population_kinds
from neatq_torch.kinds import ConfigError
from neatq_torch.learning import (
    ActionNoise,
    CandidateHeads,
    CandidatePolicy,
    CriticConfig,
    CriticLearner,
    EpsilonGreedy,
    Heads,
    Learner,
    LearnerParts,
    ReplayConfig,
    RunningNormalization,
    TDConfig,
    Teachers,
    TraceConfig,
    learner_kinds,
)
from neatq_torch.network import PopulationNetwork
from neatq_trainers.config import RunConfig, named
from neatq_trainers.metrics import DistanceMetrics, metrics_of
from neatq_trainers.migration import MOST_ISLANDS
from neatq_trainers.nero.nero_world import NeroConfig
from neatq_trainers.run import Run, State
from neatq_trainers.saved import check_form, restoring
from neatq_trainers.worlds import EnvConfig, GymnasiumConfig, World, make_world

TEACHERS_STREAM = 3
"""Of the random numbers of teachers: [seed, stream]."""


def build(
    config: RunConfig,
    state: State | None = None,
    *,
    facts: EnvFacts | None = None,
    crew: Crew | None = None,
) -> Run:
    """Make a run.

    Args:
        config: What to make.
        state: What `Run.state_dict` gave, to go on from there; None to begin. A run that had no
            tick yet begins, as its worlds are drawn then.
        facts: What `facts_of` has found of a Gymnasium task.
        crew: Among whom its environments are dealt; None: this process has them all.
    """
    if state is not None and not state["tick"]:
        state = None
    episodes = config.population.episodes if config.generational else None
    world = make_world(
        config.world,
        config.seeds,
        episodes=episodes,
        facts=facts,
        crew=crew,
        normalized=config.network.normalization is not None,
    )
    try:
        return _in_world(config, world, state, episodes)
    except BaseException:
        world.close()  # no process may outlive what cannot be built
        raise


def _in_world(config: RunConfig, world: World, state: State | None, episodes: int | None) -> Run:
    heads = heads_of(config, world)
    populations = _populations(config, world, heads, state)
    network = _network(config, world, populations, state)
    shape = world.shape
    normalization = None
    if config.network.normalization is not None:
        normalization = RunningNormalization(shape[0], world.inputs, largest=LARGEST)
    parts = LearnerParts(network, heads, shape, config.seeds, episodes, normalization)
    try:
        learner = learner_kinds.maker_of(config.learner)(config.learner, parts)
    except ValueError as error:
        raise ConfigError(named("learner", error)) from error
    policy = getattr(learner, "policy", None) or _policy(config, network, heads, normalization)
    run = Run(
        config=config,
        world=world,
        heads=heads,
        policy=policy,
        learner=learner,
        network=network,
        populations=populations,
        teachers=_teachers(config, learner, populations),
        normalization=normalization,
        metrics=metrics_of(config, populations, shape),
    )
    world.join(run)
    run.begin_generation()
    if state is not None:
        with restoring():
            _restore(run, state)
    return run


def _restore(run: Run, state: State) -> None:
    parts = {"policy": run.policy, "learner": run.learner, "metrics": run.metrics}
    # A user's own parts know best what they have saved.
    own = {name for name, part in parts.items() if type(part).__module__.startswith("neatq_")}
    # The fields of a curriculum have other turrets, and NERO checks what it loads.
    own |= set() if isinstance(run.config.world, EnvConfig | NeroConfig) else {"world"}
    if isinstance(run.metrics, DistanceMetrics) and set(state["metrics"]) == {"champions"}:
        # Of 0.2.0, where a row was a single tick: the next one begins here.
        state = {**state, "metrics": run.metrics.state_dict() | state["metrics"]}
    for name, fresh in run.state_dict().items():
        if name in own:
            columns = name in ("policy", "learner")
            fresh.pop("scenario", None)  # the world reads it, as it may have become another one
            check_form(state[name], fresh, columns=columns, where=f".{name}")
    run.tick, run.migrations = state["tick"], state.get("migrations", 0)
    run.policy.load_state_dict(state["policy"])
    run.learner.load_state_dict(state["learner"])
    run.metrics.load_state_dict(state["metrics"])
    if "world" in state:
        run.world.env.load_world_state(state["world"])
    for population in run.populations:
        population.weigh(run.world.present_weights)  # of the stage that goes on
    if run.teachers is not None:
        run.teachers.load_state_dict(state["teachers"])
    if run.normalization is not None:
        run.normalization.load_state_dict(state["normalization"])


def _learns_values(config: RunConfig) -> bool:
    """Whether networks put out Q-values; where a critic has them, they only act."""
    return config.learns and not isinstance(config.learner, CriticConfig)


def heads_of(config: RunConfig, world: World) -> Heads:
    """How outputs are read; without learning they are no values and keep their own range."""
    network, learner = config.network, config.learner
    values = network.value_range or (0.0, 1.0)
    if _learns_values(config) and network.value_range is None:
        normalized = getattr(learner, "normalize_return", False)
        values = world.default_range(learner.discount, normalized=normalized)
    heads = world.heads(network.candidates, values)
    if heads.candidates < 2 and isinstance(learner, TDConfig | ReplayConfig | TraceConfig):
        raise ConfigError(
            "network.candidates: expected at least 2, got 1; a single action has no Q-value that "
            "could be learnt"
        )
    return heads


def _populations(
    config: RunConfig, world: World, heads: Heads, state: State | None
) -> list[Population]:
    if config.population is None:
        return []
    kind, own = population_kinds.maker_of(config.population), config.population
    weights = world.reward_weights
    if state is not None:
        with restoring():
            saved = state["populations"]
            return [kind.from_state(own, one, reward_weights=weights) for one in saved]
    steep = isinstance(config.learner, CriticConfig) and config.world.lasting
    usual = "steep_sigmoid" if steep else "sigmoid"
    ranks = not _learns_values(config) and isinstance(config.world, GymnasiumConfig)
    if ranks and heads.outputs == heads.candidates > 1:
        usual = "identity"
    try:
        founded = [
            kind.start(
                own,
                slots=world.shape[1],
                inputs=world.inputs,
                outputs=heads.outputs,
                rng=np.random.default_rng([seed, world.stream]),
                reward_weights=weights,
                activation=config.network.activation or usual,
                observation_schema=config.world.schema,
            )
            for seed in config.seeds
        ]
    except ValueError as error:
        raise ConfigError(named("population", error)) from error
    if config.migration is not None:
        for seed, population in zip(config.seeds, founded, strict=True):
            population.ledger.number_apart(seed % MOST_ISLANDS, MOST_ISLANDS)
    return founded


def _network(
    config: RunConfig, world: World, populations: list[Population], state: State | None
) -> PopulationNetwork | None:
    if not populations:
        return None
    genomes = [genome for population in populations for genome in population.genomes]
    shape, evaluation = world.shape, config.network.evaluation
    network = PopulationNetwork(genomes, shape=shape, evaluation=evaluation)
    if state is not None:
        with restoring():
            network.load_weights(state["weight"])
    return network


def _policy(
    config: RunConfig,
    network: PopulationNetwork | None,
    heads: Heads,
    normalization: RunningNormalization | None,
) -> CandidatePolicy:
    assert network is not None  # else the learner has a policy of its own
    learner = config.learner
    exploration = EpsilonGreedy(
        network.shape,
        seeds=config.seeds,
        epsilon=getattr(learner, "epsilon", 0.0),
        max_hold_ticks=getattr(learner, "max_hold_ticks", 1),
    )
    noise = None
    if getattr(learner, "noise", 0.0) and isinstance(heads, CandidateHeads):
        noise = ActionNoise(
            network.shape,
            heads.actions,
            seeds=config.seeds,
            scale=learner.noise,
            persistence=learner.persistence,
        )
    return CandidatePolicy(
        network,
        heads,
        exploration,
        double_activation=config.network.double_activation,
        forgets=isinstance(config.world, GymnasiumConfig),
        noise=noise,
        normalization=normalization,
    )


def _teachers(
    config: RunConfig, learner: Learner, populations: list[Population]
) -> Teachers | None:
    if getattr(config.learner, "teacher_mutation", None) is None:
        return None
    assert isinstance(learner, CriticLearner)
    lasting = [one for one in populations if isinstance(one, RtNEAT)]
    return Teachers(learner, lasting, [(seed, TEACHERS_STREAM) for seed in config.seeds])
