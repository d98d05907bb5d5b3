"""What was done to a simulation, kept and repeated."""
