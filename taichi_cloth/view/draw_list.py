"""What a picture of a running scene is made of: one triangle soup, one light. Window and rasteriser draw it alike."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from ..simulation import Simulation
from ..state.pool import Pool
from . import draw_bodies, fill, solids
from .draw_mesh import DrawMesh
from .lighting import studio

VIEWS = ("shaded", "strain", "wireframe", "particles")

FLOOR = (0.97, 0.98, 1.0)
MARK = 0.008  # radius of a bead, in sides of the cloth, where cells are small
TILES = 40  # along each side of the floor
TILE_TINTS = np.array([1.0, 0.965])  # a faint chequer
POLE, BALL = (0.42, 0.30, 0.20), (0.30, 0.42, 0.56)
PINNED, HELD = (0.85, 0.45, 0.10), (1.0, 0.80, 0.20)
FAMILY_COLOURS = {"structural": (0.16, 0.33, 0.55), "shear": (0.62, 0.44, 0.24), "bend": (0.5, 0.5, 0.5)}

Floats = NDArray[np.float32]


@dataclass(eq=False)
class ParticleLook:
    """What the views need at every particle, shape (N,)."""

    normal: Any  # vec3
    strain: Any


def _allocate_mesh(corners: int) -> DrawMesh:
    return DrawMesh(*(ti.Vector.field(3, ti.f32, corners) for _ in range(3)))


def _allocate_look(particles: int) -> ParticleLook:
    return ParticleLook(ti.Vector.field(3, ti.f32, particles), ti.field(ti.f32, particles))


_meshes = Pool(_allocate_mesh)
_looks = Pool(_allocate_look)


class DrawList:
    """The draw mesh of one simulation; `update(view)` brings it up to date. Close it before the simulation.

    Corners in order: what stands still, what moves, balls, their shadows, the cloth's shadow, the cloth. All but
    the cloth is lit on one side.
    """

    def __init__(self, simulation: Simulation) -> None:
        self.simulation = simulation
        scene, topology = simulation.scene, simulation.topology
        distance = float(np.linalg.norm(np.subtract(scene.camera.eye, scene.camera.target)))
        self.lighting = studio(scene.camera.target, distance)
        self._ball, self._bead = (solids.unit_sphere(rings).astype(np.float32) for rings in (24, 8))
        self._pins = simulation.added_pins
        self._grain = float(topology.rest.mean()) if topology.spring_count else 0.1  # [m] a typical spring
        self._mark = max(0.3 * self._grain, MARK * max(scene.cloth.width, scene.cloth.height))  # [m] radius of a bead
        self._drawn_springs = len(topology.family("structural")) + len(topology.family("shear"))
        self._weave = self._weave_colours()
        self._spring_colours = self._family_colours()
        self._floor = self._floor_table(distance)

        bodies = simulation.bodies()
        standing, self._moving = draw_bodies.split(bodies)
        self._soups = [draw_bodies.soup(bodies[k]) for k in self._moving]
        still = [*self._pole(), *(draw_bodies.posed(body, draw_bodies.soup(body)) for body in standing)]
        floor = self._floor_corners()
        self._shares = 1 if scene.ground is None else 2  # a body and, on a floor, its shadow
        self._first_moving = len(floor[0]) + self._shares * sum(len(p) for p, _, _ in still)
        self._first_ball = self._first_moving + self._shares * sum(len(p) for p, _, _ in self._soups)
        round_ones = len(scene.spheres) * len(self._ball) + (1 + len(self._pins)) * len(self._bead)
        self._first_shadow = self._first_ball + self._shares * round_ones
        self._cloth_corners = {
            "shaded": 3 * topology.triangle_count,
            "strain": 3 * topology.triangle_count,
            "wireframe": 6 * self._drawn_springs,
            "particles": 24 * topology.particle_count,
        }
        self.mesh = _meshes.take(self._first_shadow + self._shares * max(self._cloth_corners.values()))
        self._look = _looks.take(topology.particle_count)
        fill.fill_floor(self.mesh, 0, *floor, self._floor)
        self._fill_bodies(len(floor[0]), still)

    def close(self) -> None:
        """Gives the fields back for the next draw list."""
        _meshes.give_back(self.mesh)
        _looks.give_back(self._look)

    def update(self, view: str, eye: tuple[float, float, float]) -> DrawMesh:
        """Writes the scene as it is now, seen from `eye` [m], in one of `VIEWS`."""
        simulation, mesh, cloth = self.simulation, self.mesh, self.simulation.cloth
        self._update_balls()
        bodies = simulation.bodies() if self._moving else []
        moved = [draw_bodies.posed(bodies[k], soup) for k, soup in zip(self._moving, self._soups, strict=True)]
        self._fill_bodies(self._first_moving, moved)
        corners = self._cloth_corners[view]
        first = self._first_shadow + (self._shares - 1) * corners
        fill.particle_normals(cloth, self._look.normal)
        if view == "shaded":
            fill.fill_weave(cloth, mesh, self._look.normal, first, self._weave)
        elif view == "strain":
            structural = len(simulation.topology.family("structural"))
            fill.particle_strains(cloth, self._look.strain, structural or simulation.topology.spring_count)
            fill.fill_strain(cloth, mesh, self._look.normal, self._look.strain, first)
        elif view == "wireframe":
            width = 0.06 * self._grain
            fill.fill_springs(cloth, mesh, first, ti.math.vec3(*eye), width, self._drawn_springs, self._spring_colours)
        else:
            free = ti.math.vec3(*_rgb(simulation.scene.look.cloth))
            fill.fill_particles(cloth, mesh, first, 0.22 * self._grain, free, ti.math.vec3(*PINNED))
        self._shadow(self._first_shadow, first, corners)
        mesh.two_sided_from = first
        mesh.corners = first + corners
        return mesh

    def _update_balls(self) -> None:
        """Spheres of the scene, and beads on what is held (without size while the hand is empty) and on new pins."""
        simulation = self.simulation
        spheres = simulation.bodies()[: len(simulation.scene.spheres)]
        first = self._first_ball
        if spheres:
            centers, radii = zip(*((body.center, body.size[0]) for body in spheres), strict=True)
            first = self._fill_balls(first, self._ball, centers, radii, [BALL] * len(spheres))
        held = simulation.grabbed
        beads = simulation.positions()[[held or 0, *self._pins]]
        sizes = [0.0 if held is None else self._mark, *[self._mark] * len(self._pins)]
        self._fill_balls(first, self._bead, beads, sizes, [HELD, *[PINNED] * len(self._pins)])

    def _fill_balls(self, first: int, unit: Floats, centers: Any, radii: Any, colours: Any) -> int:
        """Balls of one fineness, and then their shadows; where the next begin."""
        places, sizes, tints = (np.array(values, np.float32) for values in (centers, radii, colours))
        fill.fill_balls(self.mesh, first, unit, places, sizes, tints)
        corners = len(places) * len(unit)
        self._shadow(first + corners, first, corners)
        return first + self._shares * corners

    def _fill_bodies(self, first: int, soups: list[draw_bodies.Soup]) -> None:
        """Bodies one after another, each with its shadow."""
        for positions, normals, colours in soups:
            fill.fill_body(self.mesh, first, positions, normals, colours)
            self._shadow(first + len(positions), first, len(positions))
            first += self._shares * len(positions)

    def _shadow(self, first: int, source: int, corners: int) -> None:
        """The shadow of a part of the mesh, where there is a floor to take it."""
        if self.simulation.scene.ground is not None:
            fill.fill_shadow(self.mesh, first, source, corners, self._floor)

    # -- what stands still -----------------------------------------------------------------------------

    def _pole(self) -> list[draw_bodies.Soup]:
        scene = self.simulation.scene
        if not scene.look.pole:
            return []
        left, right = self.simulation.topology.start[[0, scene.cloth.columns - 1]]
        overhang, radius = 0.06 * (right - left), 0.012 * scene.cloth.width
        return [draw_bodies.coloured(*solids.cylinder(left - overhang, right + overhang, radius), POLE)]

    def _floor_corners(self) -> tuple[Floats, Floats]:
        if self.simulation.scene.ground is None:
            return np.zeros((0, 3), np.float32), np.zeros(0, np.float32)
        reach, height = float(self._floor[fill.SIZES][fill.REACH]), float(self._floor[fill.CENTER][1])
        x, _, z = self.simulation.scene.camera.target
        corners, parity = solids.floor((x, z), height, 2 * reach / TILES, TILES)
        return corners.astype(np.float32), TILE_TINTS[parity].astype(np.float32)

    def _floor_table(self, distance: float) -> Floats:
        """What the kernels must know of the floor and its light; rows as named in `fill.py`."""
        scene, lighting = self.simulation.scene, self.lighting
        height = scene.ground.height if scene.ground else 0.0
        x, _, z = scene.camera.target
        rows = [FLOOR, lighting.background, lighting.ambient, (x, height, z), (2.2 * distance, 0.72, 1e-3 * distance)]
        for light in lighting.lights:
            rows += [light.position, light.colour]
        return np.array(rows, np.float32)

    # -- colours ---------------------------------------------------------------------------------------

    def _weave_colours(self) -> Floats:
        """Colour of every triangle, (T, 3): a chequer of `check_cells` cells."""
        look = self.simulation.scene.look
        check = (self.simulation.topology.cells // look.check_cells).sum(axis=1) % 2
        colours: Floats = np.array([_rgb(look.cloth), _rgb(look.check)], np.float32)[check]
        return colours

    def _family_colours(self) -> Floats:
        """Colour of every spring, (E, 3), by family."""
        topology = self.simulation.topology
        colours = [FAMILY_COLOURS[b.family] for b in topology.batches for _ in range(b.count)]
        return np.array(colours, np.float32).reshape(-1, 3)


def _rgb(colour: str) -> tuple[float, float, float]:
    """#rrggbb as three factors 0…1."""
    red, green, blue = (int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5))
    return red, green, blue
