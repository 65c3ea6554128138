"""Stable-Baselines3 beside a champion, a script to copy: `python examples/sb3.py`.

A champion is evolved first. Then PPO learns the same task, and a callback of SB3 evaluates both
with SB3's own `evaluate_policy`, so that the figures are of one kind.
"""

from typing import Any

import gymnasium
import tyro
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor

import neatq_torch as nq


class Beside(BaseCallback):
    """Evaluates the agent and a champion every so many steps, on the same task."""

    def __init__(self, champion: Any, task: str, every: int) -> None:
        super().__init__()
        self.champion, self.every = champion, every
        self.env = Monitor(gymnasium.make(task))
        self.means = list[tuple[float, float]]()

    def _on_step(self) -> bool:
        if self.num_timesteps % self.every == 0:
            agent, champion = (self._mean(one) for one in (self.model, self.champion))
            self.means.append((agent, champion))
            self.logger.record("eval/champion", champion)
            print(f"step {self.num_timesteps:6d}  PPO {agent:5.1f}  champion {champion:5.1f}")
        return True

    def _mean(self, policy: Any) -> float:
        self.env.reset(seed=1)
        returns: Any = evaluate_policy(policy, self.env, n_eval_episodes=5)
        return float(returns[0])


def main(
    task: str = "CartPole-v1", generations: int = 10, steps: int = 20_000, every: int = 2_000
) -> list[tuple[float, float]]:
    """Evolve, then learn; returns the mean returns of PPO and of the champion at each look."""
    run = nq.train(f"gym:{task}", "neat", generations=generations, out="runs/beside-ppo")
    beside = Beside(nq.load_policy(run.folder), task, every)
    PPO("MlpPolicy", task, n_steps=min(2048, every), seed=0).learn(steps, callback=beside)
    return beside.means


if __name__ == "__main__":
    tyro.cli(main)
