"""Measurement of the simulator: benchmarks, validation, stability tests, and float64 reference solutions."""
