"""Table of all mutations. `run_mutants.py` applies them one at a time; each must make one of its tests fail.

A mutation is a fault that is easy to make in a line: a sign, a factor, a missing term, a bound that is too wide. A
mutation without a visible effect does not belong here. Its tests are the closest and fastest ones. There is a module of
mutations for each folder of the program that they change.
"""

from __future__ import annotations

from collision_mutations import COLLISION
from evaluation_mutations import EVALUATION
from geometry_mutations import GEOMETRY
from interface_mutations import INTERFACES
from kernel_mutations import KERNELS
from mutation import Mutation
from reference_mutations import REFERENCES
from simulation_mutations import SIMULATION
from solver_mutations import SOLVERS

MUTATIONS: list[Mutation] = [
    *KERNELS,
    *COLLISION,
    *SOLVERS,
    *GEOMETRY,
    *SIMULATION,
    *INTERFACES,
    *EVALUATION,
    *REFERENCES,
]
