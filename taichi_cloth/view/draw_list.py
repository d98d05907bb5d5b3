"""What a picture of a running scene is made of: one triangle soup, lit. Window and rasteriser draw it alike."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from ..mesh.topology import Topology
from ..simulation import Simulation
from ..state.pool import Pool
from . import draw_bodies, fill, lighting, shadow, solids
from .draw_mesh import DrawMesh
from .patterns import pattern_colours, rgb

VIEWS = ("shaded", "strain", "wireframe", "particles")

FLOOR, LINE = (0.925, 0.92, 0.91), (0.845, 0.84, 0.83)
# Lengths in distances from the scene's eye to what it looks at.
REACH, LINED = 2.4, 1.44  # where the floor ends, and where its lines do
SPACING, WIDTH = 1 / 8, 2e-3  # of the lines: so far apart or somewhat less, and their width
SHADOWED = 0.95  # half the side of the shadow's grid
GLOSS = 0.35  # of bodies; a cloth has its own
READ = 0.45  # share of light and shade that is left in the colours of strain
MARK = 0.008  # radius of a bead, in sides of the cloth, where cells are small
PINNED, HELD = (0.85, 0.45, 0.10), (1.0, 0.80, 0.20)
FAMILY_COLOURS = {"structural": (0.16, 0.33, 0.55), "shear": (0.62, 0.44, 0.24), "bend": (0.5, 0.5, 0.5)}

Floats = NDArray[np.float32]


@dataclass(eq=False)
class ParticleLook:
    """What the views need at every particle, shape (N,)."""

    normal: Any  # vec3
    strain: Any


def _allocate_mesh(corners: int) -> DrawMesh:
    return DrawMesh(*(ti.Vector.field(3, ti.f32, corners) for _ in range(4)))


def _allocate_look(particles: int) -> ParticleLook:
    return ParticleLook(ti.Vector.field(3, ti.f32, particles), ti.field(ti.f32, particles))


_meshes = Pool(_allocate_mesh)
_looks = Pool(_allocate_look)
_shadows: Pool[Any] = Pool(lambda: ti.field(ti.i32, (shadow.SIDE, shadow.SIDE)))


class DrawList:
    """The draw mesh of one simulation; `update(view)` brings it up to date. Close it before the simulation.

    Corners in order: the floor, what stands still, what moves, balls, the cloth.
    """

    def __init__(self, simulation: Simulation) -> None:
        self.simulation = simulation
        scene, topology = simulation.scene, simulation.topology
        distance = float(np.linalg.norm(np.subtract(scene.camera.eye, scene.camera.target)))
        self._ball, self._bead = (solids.unit_sphere(rings).astype(np.float32) for rings in (24, 8))
        self._pins = simulation.added_pins
        self._grain = grain(topology)
        self._mark = bead_radius(topology)
        self._shadow_frame = ti.math.vec4(*scene.camera.target, SHADOWED * distance)
        self._reach = REACH * distance  # [m] where the floor ends

        bodies = simulation.bodies()
        standing, self._moving = draw_bodies.split(bodies)
        self._soups = [draw_bodies.soup(bodies[k]) for k in self._moving]
        pole = [draw_bodies.pole(scene, topology.start)] if scene.look.pole else []
        still = [*pole, *(draw_bodies.posed(body, draw_bodies.soup(body)) for body in standing)]
        floor = self._floor(distance)
        self._first_solid = sum(len(p) for p, _, _ in floor)
        self._first_moving = self._first_solid + sum(len(p) for p, _, _ in still)
        self._first_ball = self._first_moving + sum(len(p) for p, _, _ in self._soups)
        round_ones = len(scene.spheres) * len(self._ball) + (1 + len(self._pins)) * len(self._bead)
        self._first_cloth = self._first_ball + round_ones
        self._weave()
        self.mesh = _meshes.take(self._first_cloth + max(self._cloth_corners.values()))
        self.mesh.solids_from, self.mesh.cloth_from = self._first_solid, self._first_cloth
        self._look = _looks.take(topology.particle_count)
        self._shadow = _shadows.take()
        self._fill_bodies(0, floor)
        self._fill_bodies(self._first_solid, still)

    def close(self) -> None:
        """Gives the fields back for the next draw list."""
        _meshes.give_back(self.mesh)
        _looks.give_back(self._look)
        _shadows.give_back(self._shadow)

    def update(self, view: str, eye: tuple[float, float, float]) -> DrawMesh:
        """Writes the scene as it is now, seen from `eye` [m], in one of `VIEWS`."""
        simulation, mesh, cloth = self.simulation, self.mesh, self.simulation.cloth
        if simulation.topology is not self._woven:  # it tore: there is less of it
            self._weave()
        self._update_balls()
        bodies = simulation.bodies() if self._moving else []
        moved = [draw_bodies.posed(bodies[k], soup) for k, soup in zip(self._moving, self._soups, strict=True)]
        self._fill_bodies(self._first_moving, moved)
        first = self._first_cloth
        mesh.corners = first + self._cloth_corners[view]
        fill.particle_normals(cloth, self._look.normal)
        if view == "shaded":
            fill.fill_weave(cloth, mesh, self._look.normal, first, self._triangle_colours)
        elif view == "strain":
            springs = self._structural or simulation.topology.spring_count
            fill.particle_strains(cloth, self._look.strain, springs)
            fill.fill_strain(cloth, mesh, self._look.normal, self._look.strain, first)
        elif view == "wireframe":
            width = 0.06 * self._grain
            fill.fill_springs(cloth, mesh, first, ti.math.vec3(*eye), width, self._drawn_springs, self._spring_colours)
        else:
            free = ti.math.vec3(*rgb(simulation.scene.look.cloth))
            fill.fill_particles(cloth, mesh, first, 0.22 * self._grain, free, ti.math.vec3(*PINNED))
        self._light(view, ti.math.vec3(*eye))
        return mesh

    def _light(self, view: str, eye: Any) -> None:
        """Casts the lamp's shadow and lights every corner."""
        mesh, dark, frame = self.mesh, self._shadow, self._shadow_frame
        shadow.clear(dark)
        shadow.cast(mesh, self._first_solid, mesh.corners, dark, frame)
        middle = ti.math.vec3(*self._floor_middle())
        lighting.light_floor(mesh, self._first_solid, dark, frame, middle, self._reach)
        lighting.light_solids(mesh, self._first_solid, self._first_cloth, GLOSS, eye, dark, frame)
        if view in ("shaded", "strain"):
            gloss, contrast = (self.simulation.scene.look.sheen, 1.0) if view == "shaded" else (0.0, READ)
            lighting.light_cloth(mesh, self._first_cloth, mesh.corners, gloss, contrast, eye, dark, frame)
        else:
            lighting.light_solids(mesh, self._first_cloth, mesh.corners, 0.0, eye, dark, frame)

    def _update_balls(self) -> None:
        """Spheres of the scene, and beads on what is held (without size while the hand is empty) and on new pins."""
        simulation = self.simulation
        spheres = simulation.bodies()[: len(simulation.scene.spheres)]
        first = self._first_ball
        if spheres:
            centers, radii = zip(*((body.center, body.size[0]) for body in spheres), strict=True)
            first = self._fill_balls(first, self._ball, centers, radii, [draw_bodies.BALL] * len(spheres))
        held = simulation.grabbed
        beads = simulation.positions()[[held or 0, *self._pins]]
        sizes = [0.0 if held is None else self._mark, *[self._mark] * len(self._pins)]
        self._fill_balls(first, self._bead, beads, sizes, [HELD, *[PINNED] * len(self._pins)])

    def _fill_balls(self, first: int, unit: Floats, centers: Any, radii: Any, colours: Any) -> int:
        """Balls of one fineness; where the next begin."""
        places, sizes, tints = (np.array(values, np.float32) for values in (centers, radii, colours))
        fill.fill_balls(self.mesh, first, unit, places, sizes, tints)
        return first + len(places) * len(unit)

    def _fill_bodies(self, first: int, soups: list[draw_bodies.Soup]) -> None:
        """Bodies one after another."""
        for positions, normals, colours in soups:
            fill.fill_body(self.mesh, first, positions, normals, colours)
            first += len(positions)

    # -- what stands still -----------------------------------------------------------------------------

    def _floor(self, distance: float) -> list[draw_bodies.Soup]:
        """The floor, and a faint grid of lines."""
        if self.simulation.scene.ground is None:
            return []
        middle, lift = self._floor_middle(), np.array([0.0, 3e-3 * distance, 0.0])
        spacing = round_length(SPACING * distance)
        parts = (
            (solids.floor(middle, self._reach), FLOOR),
            (solids.floor_lines(middle + lift, LINED * distance, spacing, WIDTH * distance), LINE),
        )
        return [draw_bodies.coloured(c, np.broadcast_to([0.0, 1.0, 0.0], c.shape), colour) for c, colour in parts]

    def _floor_middle(self) -> NDArray[np.float64]:
        """The point of the floor below what the camera looks at."""
        scene = self.simulation.scene
        x, _, z = scene.camera.target
        return np.array([x, scene.ground.height if scene.ground else 0.0, z])

    # -- colours ---------------------------------------------------------------------------------------

    def _weave(self) -> None:
        """Counts and colours what there is of the cloth."""
        self._woven = topology = self.simulation.topology
        counts = topology.family_counts
        self._structural = counts.get("structural", 0)
        self._drawn_springs = self._structural + counts.get("shear", 0)
        self._triangle_colours = pattern_colours(topology, self.simulation.scene.look)
        self._spring_colours = self._family_colours()
        self._cloth_corners = {
            "shaded": 3 * topology.triangle_count,
            "strain": 3 * topology.triangle_count,
            "wireframe": 6 * self._drawn_springs,
            "particles": 24 * topology.particle_count,
        }

    def _family_colours(self) -> Floats:
        """Colour of every spring, (E, 3), by family."""
        topology = self.simulation.topology
        colours = [FAMILY_COLOURS[b.family] for b in topology.batches for _ in range(b.count)]
        return np.array(colours, np.float32).reshape(-1, 3)


def grain(topology: Topology) -> float:
    """[m] a typical spring."""
    return float(topology.rest.mean()) if topology.spring_count else 0.1


def bead_radius(topology: Topology) -> float:
    """[m] of the beads on what is held and on new pins."""
    return max(0.3 * grain(topology), MARK * topology.side)


def round_length(length: float) -> float:
    """The largest of 1, 2 and 5 times a power of ten that is not above `length`."""
    power = 10.0 ** np.floor(np.log10(length))
    return float(max(k * power for k in (1, 2, 5) if k * power <= length))
