"""Independent reference solutions of scenes in float64, in NumPy.

The solvers are compared with them. They share no code with the solvers.
"""

from .static_solution import rest_strain

__all__ = ["rest_strain"]
