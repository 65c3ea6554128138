"""NEAT and rtNEAT whose networks learn while they live, on PyTorch and TorchRL."""
