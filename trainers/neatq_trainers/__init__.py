"""What a person runs: the training loop, the arms and the command line."""
