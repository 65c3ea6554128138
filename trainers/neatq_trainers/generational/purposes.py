"""What random numbers are for: each purpose has a stream of its own for every seed."""

TRAINING = 0
"""Starts of the episodes in which genomes live."""
EVALUATION = 1
"""Starts of the episodes that choose the champion."""
TEST = 2
"""Starts of the episodes in which the champion is tested after the run."""
SCOUTING = 3
"""Random play before the run."""
EVOLUTION = 4
"""Founders, mutation, mating."""
EXPLORATION = 5
"""Exploration of each genome."""
RECORDING = 6
"""Which of its transitions a life leaves to the next generation."""
PRETRAINING = 7
"""Minibatches of the transitions that the generation before has left."""
