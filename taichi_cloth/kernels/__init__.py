"""Taichi functions on particles and springs: forces, constraints, integration, linear solvers."""
