"""Any Gymnasium task in three lines: train, load, act (`python examples/gymnasium_task.py`)."""

import gymnasium
import tyro

import neatq_torch as nq


def main(
    task: str = "CartPole-v1", arm: str = "neat", generations: int = 10, seed: int = 0
) -> float:
    """Train and act for one episode; returns its return."""
    run = nq.train(f"gym:{task}", arm, generations=generations, seed=seed)
    policy = nq.load_policy(run.folder)

    env, total, over = gymnasium.make(task), 0.0, False
    observation, _ = env.reset(seed=1)
    while not over:
        observation, reward, terminated, truncated, _ = env.step(policy(observation))
        total, over = total + float(reward), terminated or truncated
    env.close()
    return total


if __name__ == "__main__":
    print(f"return of an episode: {tyro.cli(main):.1f}")
