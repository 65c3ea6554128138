"""Networks that travel: out of the library and into it."""
