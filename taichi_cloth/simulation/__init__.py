"""A running simulation: stepping, events, runtime parameters, grabs, recordings and checkpoints."""
