"""The parts of a substep that all solvers share: preparation of contact, external forces, contact and distance limits.

Solvers call these functions and none of the features behind them, so a feature that is added to one of these functions
reaches all six. `begin_substep` comes first. `add_external_forces` comes before forces are integrated, for `rk4` in
each of its four stages. The projections come in the order of the method:

    explicit, rk4     once, at the end of a substep: distance bounds, self-contact, colliders, strain limit
    verlet            colliders in each iteration; then self-contact, distance bounds, strain limit
    xpbd              self-contact and colliders in each iteration; then distance bounds, strain limit
    lines, implicit   in each of two stages, after its iterations: as explicit, then positions only, where the
                      extrapolation led: distance bounds, colliders

At the end of a frame, all but `verlet` and `xpbd` call `stop_at_colliders`, which changes velocities only.

A projection may undo a part of those before it: a collider of `explicit` may stretch a tether, a tether of `verlet` may
pull a particle into a collider.
"""

import taichi as ti

from ..collision.deforming_meshes import find_surface_contacts, project_surface_contacts
from ..collision.layer_contact import ROUNDS, find_layer_contacts, resolve_layer_contacts
from ..collision.response import add_repulsion, resolve_contacts, stop_in_contact
from ..collision.self_collision import find_intersections, resolve_self_contacts
from ..collision.static_friction import clear_anchors_each_frame, clear_friction_sums
from ..collision.truncation import TRUNCATION_PHASES, truncate_motion
from ..kernels.distance_limits import limit_strain, project_max_distances, project_tethers
from ..kernels.forces import add_wind


@ti.func
def begin_substep(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    """Prepare contact. It comes first in a substep, from the positions of the one before."""
    find_surface_contacts(cloth, features, ctx)
    find_intersections(cloth, features, ctx)
    clear_anchors_each_frame(cloth, features, ctx)
    clear_friction_sums(cloth, features)


@ti.func
def add_external_forces(
    cloth: ti.template(), features: ti.template(), ctx: ti.template(), time: float, stages: ti.template()
):
    """Add wind and the repulsion of colliders to the forces [N]. Gravity is part of `consume_acceleration`.

    `stages`: in a substep, 1 but for `lines`, which calls this once a stage. `ctx` is that of the stage, and `time` is
    in stages since the start of the frame.
    """
    add_wind(cloth, features, ti.static(ctx._replace(h=stages * ctx.h)), time / stages)
    add_repulsion(cloth, features, ctx, time)


@ti.func
def project_colliders(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    """Resolve contact with colliders."""
    resolve_contacts(cloth, features, ctx)
    project_surface_contacts(cloth, features, ctx)


@ti.func
def stop_at_colliders(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    """Stop particles on rigid colliders at the end of a frame, for solvers that project contact once a substep."""
    stop_in_contact(cloth, features, ctx)


@ti.func
def project_self_contacts(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    """Resolve contact of the cloth with itself."""
    find_self_contacts(cloth, features, ctx)
    if ti.static(features.penetration_free):
        if ti.static(cloth.is_parallel):
            for _ in ti.static(range(ROUNDS)):
                resolve_layer_contacts(cloth, features, ctx)
        else:
            for _ in range(ROUNDS):
                resolve_layer_contacts(cloth, features, ctx)
    else:
        resolve_self_contacts(cloth, features, ctx)


@ti.func
def find_self_contacts(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    """Find what may touch in this substep. A solver that iterates calls it once, after its prediction, and then
    `iterate_self_contacts`."""
    if ti.static(features.penetration_free):
        find_layer_contacts(cloth, features, ctx)


@ti.func
def iterate_self_contacts(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    """Resolve contact of the cloth with itself once."""
    if ti.static(features.penetration_free):
        resolve_layer_contacts(cloth, features, ctx)
    else:
        resolve_self_contacts(cloth, features, ctx)


@ti.func
def end_substep(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    """Hold back what would pass through cloth. It comes last in a substep: nothing may move a particle after it.

    In the parallel layout `final_phases` do this.
    """
    if ti.static(features.penetration_free and not cloth.is_parallel):
        truncate_motion(cloth, features, ctx)


def final_phases(penetration_free: bool) -> tuple[object, ...]:
    """Return the phases that follow `finalize` in the parallel layout."""
    return TRUNCATION_PHASES if penetration_free else ()


@ti.func
def project_distance_bounds(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    """Project tethers and max distances."""
    project_tethers(cloth, features, ctx)
    project_max_distances(cloth, features, ctx)


@ti.func
def project_strain_limit(cloth: ti.template(), features: ti.template(), ctx: ti.template(), h: float):
    """Project the strain limit, last in a substep of length `h` [s]."""
    limit_strain(cloth, features, ctx.params, h)


@ti.func
def project_constraints(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    """Project all four once, at the end of a substep: for solvers that do not iterate over constraints."""
    project_distance_bounds(cloth, features, ctx)
    project_self_contacts(cloth, features, ctx)
    project_colliders(cloth, features, ctx)
    project_strain_limit(cloth, features, ctx, ctx.h)
    end_substep(cloth, features, ctx)
