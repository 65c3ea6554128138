"""Generations on any Gymnasium task: NEAT, NEAT+Q and a plain Q-network."""

from neatq_trainers.generational.policy import ChampionPolicy, load_policy

__all__ = ["ChampionPolicy", "load_policy"]
