"""Builds a simulation: the features of a scene, its topology, state and solver, and the parameter row of a frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from functools import lru_cache
from math import exp, hypot, sqrt
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .. import state
from ..collision.colliders import (
    collider_counts,
    colliders_of,
    collides_with_triangles,
    in_first_pose,
    is_deforming,
    pose_colliders,
    signed_distance,
)
from ..geometry.cloth_builder import (
    attachment_ids,
    build_topology,
    reason_not_a_grid,
    spring_stiffness,
    too_many_particles,
)
from ..geometry.grid import NO_GRID, cell_aspect
from ..geometry.membrane_model import Membrane
from ..geometry.signed_distance import collider_sdf, collider_surface
from ..geometry.stability_bounds import repulsion_frequency, too_many_substeps
from ..geometry.topology import MIN_SHARE, Topology
from ..geometry.weave_model import WeaveModel
from ..kernels import step_params as c
from ..scene import Scene
from ..scene.fabric_schema import Fabric, VerletSprings
from ..scene.keys import keys_of
from ..scene.parameters import parameters_of
from ..scene.schema import sections
from ..scene.solver_catalog import SOLVER_CATALOG
from ..solvers import SOLVERS, Features, Solver, Unsupported, choose_layout
from ..state.constraint_data import attach_attachments
from ..state.contact_data import acquire_sdf, release_sdf
from ..state.surface_data import acquire_surfaces, release_surfaces
from ..system.errors import UsageError
from .convergence import cell_size
from .frame_contact import describe_intersections
from .grabbing import Grab

if TYPE_CHECKING:
    from .running_cloth import RunningCloth

MAX_SIDES = 1.5  # thickness with penetration_free, over the side of a cell: at 1.6 the list of near pairs is full
MAX_PARALLEL_COLORS = 64  # spring colors in the parallel layout, which compiles each by itself; a grid has at most 12
# Features that are listed beside spring families and colliders: field of `Features`, and name for the user.
FEATURE_NAMES = {
    "membrane": "membrane",
    "weave": "weave",
    "bending": "bending",
    "strain_limit": "strain limit",
    "tethers": "tethers",
    "max_distances": "max distances",
    "attachments": "attachments",
    "wind": "wind",
    "self_collision": "self-collision",
    "penetration_free": "penetration-free",
    "continuous": "continuous",
    "triangles": "triangles",
}


def features_of(scene: Scene) -> Features:
    """Return the features of a scene. Acquires `sdf` and `surfaces` of meshes; `release_solver` releases them."""
    colliders = colliders_of(scene)
    contact = scene.self_collision
    return Features(
        wind=scene.wind is not None,
        colliders=collider_counts(colliders),
        sdf=acquire_sdf([collider_sdf(mesh) for mesh in scene.meshes if not is_deforming(mesh)]),
        surfaces=acquire_surfaces([collider_surface(mesh) for mesh in scene.meshes if is_deforming(mesh)]),
        triangles=any(collides_with_triangles(collider) for collider in colliders),
        continuous=any(collider.continuous for collider in colliders),
        soft_compression=scene.fabric.compression < 1,
        spring_damping=scene.fabric.damping_time > 0,
        strain_limit=0 if scene.strain_limit is None else scene.strain_limit.iterations,
        tethers=scene.tethers is not None,
        max_distances=scene.maps is not None and bool(scene.maps.max_distance),
        attachments=bool(scene.attachments),
        self_collision=contact is not None,
        untangle=contact is not None and contact.untangle and not contact.penetration_free,
        static_friction=contact is not None and contact.static_friction,
        penetration_free=contact is not None and contact.penetration_free,
        self_triangles=contact is not None and contact.primitives == "triangles",
    )


def feature_names(features: Features) -> list[str]:
    """Return the names of the features in use."""
    used = [name for field, name in FEATURE_NAMES.items() if getattr(features, field)]
    return [name for name in used if name != "membrane" or not features.weave]


def unsupported_by(scene: Scene, topology: Topology) -> Unsupported:
    """Return the layouts and solvers that do not support the cloth of a scene, with reasons."""
    grid_only = simd = reason_not_a_grid(scene)
    parallel = ""
    colors = len(topology.batches)
    if colors > MAX_PARALLEL_COLORS:
        parallel = f"the springs have {colors} colors, more than {MAX_PARALLEL_COLORS}: a particle has too many edges"
    if scene.cloth.layers > 1:
        simd = f"cloth.layers is {scene.cloth.layers}"
    if scene.maps is not None and scene.maps.stiffness:
        simd = "maps.stiffness makes springs differ"
    if any(collides_with_triangles(collider) for collider in colliders_of(scene)):
        simd = 'a collider has collide_with = "triangles"'
        parallel = 'collide_with = "triangles" does not work on a mesh file' if scene.cloth.file else parallel
    if isinstance(topology.membrane, WeaveModel) and len(topology.membrane.bends.width):
        simd = "threads of a weave bend by weave.bending_warp and weave.bending_weft"
    if topology.membrane is not None and scene.solver.name == "xpbd":
        parallel = "xpbd solves a membrane triangle by triangle"
    if topology.membrane is not None and scene.fabric.warp_angle and scene.fabric.compression < 1:
        simd = "fabric.compression acts along fabric.warp_angle"
    return Unsupported(scene.fabric.model, grid_only, simd, parallel)


class BuiltSimulation(NamedTuple):
    """Properties of a simulation that was built. The solver is not among them: it must not outlive `close`."""

    topology: Topology
    pin_changes: NDArray[np.bool_]
    """Particles whose pin differs from the scene, (N,)."""
    damping_time: float
    """Damping time of the springs in use [s]."""
    min_stable_substeps: int
    """Fewest substeps of a frame at which the solver is stable."""


def penetration_free_obstacle(scene: Scene, topology: Topology) -> str:
    """Return why `self_collision.penetration_free` is not possible with this cloth, or "" if it is."""
    contact = scene.self_collision
    if contact is None or not contact.penetration_free:
        return ""
    side = float(np.median(np.linalg.norm(np.diff(topology.flat[topology.edges], axis=1), axis=2)))
    if contact.thickness > MAX_SIDES * side:
        limit = f"at most {MAX_SIDES:g} × the median edge of {side:.3g} m with penetration_free"
        return f"self_collision.thickness must be {limit}, got {contact.thickness:g}"
    found = "" if contact.untangle else describe_intersections(topology, topology.start)
    hint = "self_collision.untangle lets them come apart first"
    return f"self_collision.penetration_free: at the start {found}; {hint}" if found else ""


def build(
    scene: Scene, layout: str | None, pin_changes: NDArray[np.bool_] | None, *, reduces_damping: bool = True
) -> tuple[Solver, BuiltSimulation]:
    """Build the simulation of a scene at its start. `release_solver` releases the solver.

    `layout`: one of `LAYOUTS`; chosen by the cloth if None. `pin_changes`: particles that are pinned although the scene
    does not pin them, or the reverse, (N,). `reduces_damping`: whether the solver may shorten the damping time of
    springs to take fewer substeps.

    Raises UsageError for a layout that is not supported, and for springs that need too many substeps.
    """
    solver_type = SOLVERS[scene.solver.name]
    if reason := too_many_particles(scene):
        raise UsageError(f"{scene.name}: {reason}")
    topology = build_topology(scene, solver_type.info.stiffness_section)
    pin_changes = np.zeros(topology.particle_count, bool) if pin_changes is None else pin_changes
    topology = replace(topology, pinned=topology.pinned ^ pin_changes)
    chosen_layout = choose_layout(solver_type, topology.shape, layout, unsupported_by(scene, topology))
    stiffness = spring_stiffness(scene, solver_type.info.stiffness_section, topology)
    cloth = state.acquire_state(topology)
    cloth.upload(topology, stiffness)
    solver = solver_type(cloth, topology, stiffness, features_of(scene), chosen_layout)
    if reason := penetration_free_obstacle(scene, topology):
        release_solver(solver)
        raise UsageError(f"{scene.name}: {reason}")
    if scene.attachments:
        ids, local = attachment_ids(scene, topology), np.zeros_like(topology.start)
        for k, attachment in enumerate(scene.attachments):
            local[ids == k] = in_first_pose(attachment, topology.start[ids == k])
        attach_attachments(solver.layout, topology, np.where(pin_changes, -1, ids), local)
    repulsion = repulsion_frequency(colliders_of(scene), scene.cloth.area_density)
    solver.frequency = hypot(solver.frequency, repulsion)
    wanted = scene.fabric.damping_time
    damping_time = solver.damping_time(wanted) if reduces_damping else wanted
    min_substeps = solver.min_stable_substeps(damping_time)
    if reason := too_many_substeps(solver_type.name, min_substeps):
        release_solver(solver)
        raise UsageError(f"{scene.name}: {reason}")
    return solver, BuiltSimulation(topology, pin_changes, damping_time, min_substeps)


def release_solver(solver: Solver) -> None:
    """Release the fields of a solver and its cloth, so that the next scene can use them."""
    solver.close()
    state.release_state(solver.cloth)
    release_sdf(solver.features.sdf)
    release_surfaces(solver.features.surfaces)


Floats = NDArray[np.float64]


class StepRow:
    """Builds the parameter row of every frame of one scene.

    Columns that hold a scene key (`Key.param`) are filled from the scene and its runtime parameters; the others are
    computed here.
    """

    def __init__(self, scene: Scene, topology: Topology, damping_time: float) -> None:
        """`damping_time` [s]: of the springs."""
        membrane = topology.membrane
        self._scene = scene
        self._gust_phase = np.random.default_rng(scene.seed).random(3).tolist()  # [turns]
        self._constants = np.zeros(c.PARAM_COUNT, np.float32)
        self._constants[c.DAMPING_TIME] = damping_time
        if scene.wind is not None:
            self._constants[c.HALF_AIR_DENSITY] = scene.wind.air_density / 2
        for part in sections().values():
            section = getattr(scene, part.name)
            if section is not None and not part.is_array:
                for name, key in keys_of(part.cls).items():
                    if key.param:
                        self._constants[getattr(c, key.param)] = getattr(section, name)
        if isinstance(membrane, Membrane):
            self._constants[c.C11 : c.C66 + 1] = membrane.tensor[[0, 1, 0, 0, 1, 2], [0, 1, 1, 2, 2, 2]]
        if isinstance(membrane, WeaveModel):
            self._constants[c.WEAVE : c.PARAM_COUNT] = membrane.table.reshape(-1)
        if membrane is not None and topology.shape != NO_GRID:
            self._constants[c.CELL_ROWS : c.CELL_AREA + 1] = *membrane.cells_per_meter, membrane.area[0]
        columns = {name: getattr(c, one.key.param) for name, one in parameters_of(scene).items() if one.key.param}
        self._names, self._columns = list(columns), np.array(list(columns.values()), int)

    def at(
        self,
        values: Mapping[str, float],
        *,
        wind_on: bool,
        grabs: Mapping[int, Grab],
        origin: Floats,
        seconds: float,
        h: float,
    ) -> NDArray[np.float32]:
        """Return the row of the frame that begins at `seconds` [s], in substeps of `h` [s], (PARAM_COUNT,).

        `values`: of the runtime parameters by name. `origin`: what positions are relative to [m], (3,). With `wind_on`
        False the air is at rest, and still slows the cloth.
        """
        row = self._constants.copy()
        row[self._columns] = [values[name] for name in self._names]
        row[c.VELOCITY_FACTOR] = exp(-values["damping"] * h)
        wind = self._scene.wind
        if wind is not None:
            x, z = (values["wind_x"], values["wind_z"]) if wind_on else (0.0, 0.0)
            row[c.WIND_X], row[c.WIND_Z] = x, z
            row[c.GUST_SPEED] = wind.turbulence * hypot(x, z)
            # Reduced to one turn in float64: float32 would lose the phase in a long run.
            shifts = (np.asarray(c.GUST_WAVEVECTORS) @ origin).tolist()  # [turns]
            waves = zip(self._gust_phase, c.GUST_FREQUENCIES, shifts, strict=True)
            phases = [(phase + frequency * seconds - shift) % 1 for phase, frequency, shift in waves]
            row[c.GUST_PHASE : c.GUST_PHASE + 3] = phases
        for number, grab in grabs.items():
            first = c.GRABS + 6 * number
            row[first : first + 3] = grab.start - grab.rest_positions[0]
            row[first + 3 : first + 6] = grab.target - grab.rest_positions[0]
        return row


MIN_EXCESS = 0.005  # of the stiffness: the smallest that is reported
HEAVY = 10.0  # [kg/m²] area density above which it may be meant in g/m²
LONG = 20.0  # [m] side of a cloth above which it may be meant in cm or mm
# Thickness over the side of a cell. Particles: below the first one layers can come nearer than 0.6 of it, and above the
# second a smaller one keeps them apart as well. Triangles: beyond it those of one layer touch, and a frame takes
# six to fifty times as long (measured with 21×21 particles).
THIN, THICK, SLOW_THICKNESS = 0.9, 1.5, 0.6


def warnings_of(simulation: RunningCloth) -> list[str]:
    """Return what a running cloth does not do as requested: substeps, damping, springs, bending, contact."""
    lines = list(filter(None, [keys_without_effect(simulation.scene)]))
    requested, name = int(simulation.params["substeps"]), simulation.solver.name
    if requested < simulation.built.min_stable_substeps:
        why = "fewer are unstable" + ("" if simulation.params["stiffness"] == 1 else " at stiffness 1")
        lines.append(f"{name} takes {simulation.built.min_stable_substeps} substeps, not {requested}: {why}")
    wanted, used = simulation.scene.fabric.damping_time, simulation.built.damping_time
    if used == 0 < wanted:
        lines.append(f"{name} leaves out the damping of springs, fabric.damping_time")
    elif used < wanted:
        reduced = f"from {1e3 * wanted:.3g} ms to {1e3 * used:.3g} ms"
        lines.append(f"{name} reduces the damping time {reduced}, also with more substeps")
    if simulation.topology.membrane is None and SOLVER_CATALOG[name].stiffness_section == "fabric":
        lines += filter(None, [stiffer_by_long_cells(simulation.scene)])
    if simulation.scene.tearing is not None and simulation.scene.fabric.preset:
        lines.append(f"tearing leaves out the bending stiffness of {simulation.scene.fabric.preset}")
    lines += unusual(simulation.scene, simulation.topology)
    if simulation.is_held_still:
        lines.append("penetration-free contact holds the cloth still: more pairs are near than it can list")
    return lines


@lru_cache(maxsize=4)
def unusual(scene: Scene, topology: Topology) -> tuple[str, ...]:
    """Return lines about values of a scene that are valid but often mistakes: of a unit, a sign, a position."""
    lines = [*unusual_values(scene), inside_at_start(scene, topology), unusual_thickness(scene, topology)]
    size = np.ptp(topology.start, axis=0).max() if scene.cloth.file else 0.0
    if size > LONG:
        lines.append(f"the cloth is {size:.3g} m long: cloth.scale is the length of one unit of its file in meters")
    if scene.tethers is not None and not topology.pinned.any():
        lines.append("tethers have no effect: they tie particles to pins, and the cloth has none")
    return tuple(filter(None, lines))


def unusual_values(scene: Scene) -> list[str]:
    """Return lines about single values of a scene that are often mistakes. They need no topology."""
    cloth, solver, lines = scene.cloth, scene.solver.name, []
    if not cloth.file and max(cloth.width, cloth.height) > LONG:
        lines.append(f"a side of more than {LONG:g} m: lengths are in meters")
    if cloth.area_density > HEAVY:
        lines.append(f"cloth.area_density is {cloth.area_density:g} kg/m²: fabrics have 0.02 to 2")
    if scene.forces.gravity < 0:
        lines.append("gravity points up: forces.gravity is positive downward")
    if not all(attachment.pins for attachment in scene.attachments):
        lines.append("an attachment without pins moves nothing")
    if SOLVER_CATALOG[solver].is_explicit and scene.solver.iterations > 1:
        lines.append(f"{solver} does not iterate: solver.iterations has no effect")
    if solver == "verlet" and scene.maps is not None and scene.maps.stiffness and scene.maps.stiffness_max > 1:
        lines.append("verlet corrects at most the whole error: a stiffness over 1 of a map acts as 1")
    return lines


def inside_at_start(scene: Scene, topology: Topology) -> str:
    """Return how many particles start inside a collider, which lets them out slowly; empty if none does."""
    free = topology.start[~topology.pinned]
    distances = [signed_distance(posed, free) for posed in pose_colliders(colliders_of(scene), 0.0)]
    inside = sum(int((distance < 0).sum()) for distance in distances)
    return f"{inside} particle{'s' * (inside != 1)} inside a collider at the start" if inside else ""


def unusual_thickness(scene: Scene, topology: Topology) -> str:
    """Return a line if the thickness of self-contact does not suit the cells, otherwise an empty text.

    Particles of one layer can lie over the middle of a cell of the other, a/√2 from its corners for cells of side a:
    spheres of a thickness t are then √(t² − a²/2) high.
    """
    contact = scene.self_collision
    if contact is None or not len(topology.edges):
        return ""
    cell, thickness = cell_size(topology), contact.thickness
    share, mm = thickness / cell, f"{1e3 * thickness:.3g} mm"
    words = f"self_collision.thickness of {mm} is {share:.2g} cells"
    if contact.penetration_free or contact.primitives == "triangles":
        return f"{words}: with triangles up to {SLOW_THICKNESS:g} are fast" if share > SLOW_THICKNESS else ""
    if share < THIN:
        nearest = 1e3 * sqrt(max(thickness**2 - cell**2 / 2, 0.0))
        return f'{words}: layers can come as near as {nearest:.2g} mm; primitives = "triangles" keeps them apart'
    return f"{words}: layers stay {mm} apart, and one cell is enough" if share > THICK else ""


def stiffer_by_long_cells(scene: Scene) -> str:
    """Return how much stiffer than its fabric a grid of springs is; empty where springs can be the fabric.

    With cells of height a times their width, diagonals alone have shear/a² of the weft + shear along the weft, and
    shear·a² of the warp + shear along the warp.
    """
    cloth, fabric = scene.cloth, scene.fabric
    shear = fabric.shear * cloth.diagonals / 2
    if cloth.file or shear == 0:
        return ""
    aspect, words = cell_aspect(cloth.rows, cloth.columns, cloth.width, cloth.height), ""
    for name, constant, ratio in (("weft", fabric.weft, aspect**-2), ("warp", fabric.warp, aspect**2)):
        beside = max(constant - shear * (ratio - 1), MIN_SHARE * constant)
        excess = (beside + shear * ratio) / (constant + shear) - 1
        if excess > MIN_EXCESS:
            words = f"cells are {max(aspect, 1 / aspect):.2g}:1: springs are {excess:.0%} stiffer than the fabric "
            words += f'along the {name}; model = "membrane" is not'
    return words


def keys_without_effect(scene: Scene) -> str:
    """Return the keys of the other solvers' springs that a scene sets, in `[fabric]` for `verlet`; empty without any.

    A preset sets the keys of all solvers.
    """
    section = SOLVER_CATALOG[scene.solver.name].stiffness_section
    other, default = ("fabric", Fabric()) if section == "verlet" else ("verlet", VerletSprings())
    table = getattr(scene, other)
    names = [f"{other}.{one.name}" for one in fields(table) if getattr(table, one.name) != getattr(default, one.name)]
    if not names or scene.fabric.preset:
        return ""
    return f"{scene.solver.name} uses [{section}], not {', '.join(names)}"
