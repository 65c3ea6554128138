"""A learner of one's own, a script to copy: `python examples/own_learner.py`.

Expected Sarsa (van Seijen et al. 2009): the value of a state is not that of its best candidate,
but the mean over what the robot will do there, explorations included. It has less reason to be
bold at the edge of a cliff.
"""

# TorchRL declares `forward` as what its decorator makes of it.
# pyright: reportIncompatibleVariableOverride=false, reportFunctionMemberAccess=false

from dataclasses import dataclass
from typing import Any, Literal

import tyro
from tensordict import TensorDictBase

import neatq_torch as nq


@dataclass(frozen=True, kw_only=True)
class ExpectedSarsaConfig(nq.StepConfig):
    """The settings of every learner that follows a gradient, with defaults of its own."""

    learning_rate: float = 0.01
    optimizer: Literal["sgd", "adam"] = "adam"
    discount: float = 0.9
    epsilon: float = 0.05


class ExpectedValue(nq.CandidateValue):
    """Values of candidates; that of a state is their mean over an epsilon-greedy choice."""

    epsilon = 0.0

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        values = super().forward(tensordict).get("action_value")
        best, mean = values.amax(-1, keepdim=True), values.mean(-1, keepdim=True)
        expected = (1 - self.epsilon) * best + self.epsilon * mean
        return tensordict.set("chosen_action_value", expected)


def make(config: ExpectedSarsaConfig, parts: Any) -> nq.TDLearner:
    """What the trainer calls with the networks of all robots and how their outputs are read."""
    network = parts.networks()
    value = ExpectedValue(network, parts.heads)
    value.epsilon = config.epsilon
    loss = nq.CandidateTDLoss(
        value,
        delay_value=config.target_tau is not None,
        normalize_return=config.normalize_return,
    )
    loss.make_value_estimator(gamma=config.discount)
    return nq.TDLearner(network, loss, config)


nq.register_learner("expected-sarsa", ExpectedSarsaConfig, make)


def main(task: str = "wall", ticks: int = 20_000, seed: int = 0, out: str | None = None) -> float:
    """Train; returns the mean distance of the team to the flag at the end, in units."""
    run = nq.train(task, "neatq", learner="expected-sarsa", ticks=ticks, seed=seed, out=out)
    return float(run.metrics()["mean_distance"][-10:].mean())


if __name__ == "__main__":
    print(f"mean distance to the flag: {tyro.cli(main):.1f}")
