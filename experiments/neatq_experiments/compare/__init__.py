"""Arms beside each other on the tasks of the arena: `neatq compare`."""
