"""Independent reference solutions of scenes in float64, in NumPy.

The solvers are compared with them. They share with the solvers the construction of the cloth: masses, rest lengths,
constants, bending links and tethers (`geometry/spring_model.py`, `build_topology`). Forces, steps and contact are their
own.
"""

from .static_solution import rest_strain

__all__ = ["rest_strain"]
