"""`lines`: XPBD in which every row, every column and every diagonal of springs is solved exactly as a chain.

A pull then passes through the whole sheet in one iteration and not from neighbour to neighbour, so that one iteration
in a substep is enough however stiff and fine the cloth is. Bend springs take one pass of plain XPBD. With `tethers` it
is the method for pinned sheets that are to be stiff at few substeps.
"""

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from ..contact.push_out import push_out
from ..kernels.chains import begin_frame, forget_chains, solve_chains
from ..kernels.controls import KEPT
from ..kernels.forces import add_air
from ..kernels.grab import lead_held
from ..kernels.motion import move_freely, take_up_corrections
from ..kernels.springs import RELAX_COMPLIANT, add_bending, for_springs_from, limit_strain
from ..kernels.tethers import pull_tethers
from ..mesh.grid import MOST_BENDS
from ..mesh.topology import Topology
from ..state import ClothState
from ..state.chains import list_chains, strip_chains
from .base import Solver, Stages


@ti.func
def before(cloth: ti.template(), stages: ti.template(), now: ti.template()):
    if now.s == 0:
        begin_frame(cloth)
    add_air(cloth, stages, now, now.s)
    add_bending(cloth, stages, now.controls, now.h)
    move_freely(cloth, stages, now.controls, now.h, now.controls[KEPT], now.h)
    lead_held(cloth, stages, now, now.s + 1.0)
    forget_chains(cloth)


@ti.func
def sweep(cloth: ti.template(), stages: ti.template(), now: ti.template()):
    solve_chains(cloth, stages, now.controls, now.h)
    first = cloth.chains.first_bend[None]
    for_springs_from(cloth, stages, first, MOST_BENDS, RELAX_COMPLIANT, now.controls, now.h)


@ti.func
def after(cloth: ti.template(), stages: ti.template(), now: ti.template()):
    pull_tethers(cloth, stages, now)
    push_out(cloth, stages, now)
    limit_strain(cloth, stages, now.controls, now.h)
    take_up_corrections(cloth, stages, now.h)


class Lines(Solver):
    """Advances a cloth by XPBD on chains."""

    name = "lines"
    springs = "fabric"
    before = staticmethod(before)
    sweep = staticmethod(sweep)
    after = staticmethod(after)

    def __init__(
        self, cloth: ClothState, topology: Topology, stiffness: NDArray[np.float64], stages: Stages, path: str
    ) -> None:
        super().__init__(cloth, topology, stiffness, stages, path)
        if self.work.in_lanes:
            strip_chains(self.work, topology, stiffness)
        else:
            list_chains(self.work, topology)
