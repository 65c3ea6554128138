"""What the parts cost, measured beside something known: `python -m benchmarks --help`."""
