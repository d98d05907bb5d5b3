"""What the cases start from: solver settings, the base sheet and its static strain."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...geometry.scene_loader import files_of
from ...geometry.spring_model import spring_model
from ...scene.fabric_schema import Fabric, VerletSprings
from ...scene.keys import Vec3, keys_of
from ...scene.schema import COLLIDERS, Camera, Cloth, Forces, Scene, SelfCollision, Solver, Tearing
from ...scene.solver_catalog import SOLVER_CATALOG
from ...system.files import cached
from ..reference.static_solution import rest_positions, rest_strain

CELLS = 32  # along a side of the base sheet, for every setting
MAX_SUBSTEPS = int(keys_of(Solver)["substeps"].max or 0)
# Cost of an iteration relative to one pass over all springs: `implicit` solves a linear system, `rk4` has four
# stages, and solvers may add substeps of their own.
ITERATION_COST = {"implicit": 20, "rk4": 300, "explicit": 60, "lines": 4}


@dataclass(frozen=True)
class Setting:
    """A solver with its parameters. Everything else is that of the scene."""

    name: str
    solver: Solver
    """Its damping [1/s] replaces that of a scene with less, unless the scene has none."""
    strain_limit_iterations: int = 1
    """Iterations of the strain limit."""
    continuous: bool = False
    """Use continuous collision detection for every collider."""
    compression: float = 1.0
    """Upper bound on the compression of the fabric."""
    untangle: bool = False
    """Untangle cloth with self-collision."""
    static_friction: bool = False
    """Use static friction in self-collision between particles."""
    tear: float | None = None
    """Strain at which springs tear."""

    @property
    def cost(self) -> int:
        """Rough relative cost of a frame: iterations, weighted by the solver."""
        return self.solver.substeps * self.solver.iterations * ITERATION_COST.get(self.solver.name, 1)

    def of(self, scene: Scene) -> Scene:
        """Return the scene with this setting."""
        damping = scene.solver.damping and max(scene.solver.damping, self.solver.damping)
        solver = replace(self.solver, damping=damping, stiffness=scene.solver.stiffness)
        limit = scene.strain_limit and replace(scene.strain_limit, iterations=self.strain_limit_iterations)
        fabric = replace(scene.fabric, compression=min(scene.fabric.compression, self.compression))
        self_collision = scene.self_collision
        self_collision = self_collision and replace(
            self_collision,
            untangle=self_collision.untangle or self.untangle,
            static_friction=self_collision.static_friction
            or (self.static_friction and self_collision.primitives == "particles"),
        )
        scene = replace(scene, solver=solver, strain_limit=limit, fabric=fabric, self_collision=self_collision)
        if self.tear is not None:  # tearing does not support bending stiffness
            scene = replace(scene, tearing=Tearing(self.tear), fabric=replace(scene.fabric, bending_stiffness=0.0))
        if not self.continuous:
            return scene
        ground = scene.ground and replace(scene.ground, continuous=True)
        colliders: dict[str, Any] = {
            name: tuple(replace(collider, continuous=True) for collider in getattr(scene, name)) for name in COLLIDERS
        }
        return replace(scene, ground=ground, **colliders)

    def tearing(self, strain: float) -> Setting:
        """Return this setting with springs that tear at a strain."""
        return replace(self, name=f"{self.name} tear {strain:g}", tear=strain)


DEFAULT_SETTINGS = {
    name: Setting(name, Solver(name, *info.defaults, damping=0.0)) for name, info in SOLVER_CATALOG.items()
}
# It keeps the scene's fabric and damping, so the cloth is the same as with other settings.
ROBUST = Setting(
    "robust",
    Solver("xpbd", 60, 8, damping=0.0),
    strain_limit_iterations=24,
    continuous=True,
    untangle=True,
    static_friction=True,
)
# Another material: springs buckle instead of resisting compression. Their energy is convex, with a single minimum.
ROBUST_SLACK = replace(ROBUST, name="robust-slack", solver=replace(ROBUST.solver, damping=4.0), compression=0.0)
SETTINGS = DEFAULT_SETTINGS | {one.name: one for one in (ROBUST, ROBUST_SLACK)}


SIDE = 1.0  # [m]
DENSITY = 0.2  # [kg/m²]
CONSTANT = 1000.0  # [N/m]
BENDING = 1.57e-5  # [N·m] for a bending length c of 2 cm: B = ρ·g·c³
DAMPING = 2.0  # [1/s]
CORNERS = ("top-left", "top-right")
CAMERA = Camera(eye=(1.9, 0.6, 2.9), target=(0.0, -0.15, 0.0))
FLAT = (-90.0, 0.0, 0.0)  # [degrees] rotates a hanging sheet to level, front side up

THICKNESS = 0.9  # [cells] of contacts between particles, so that no particle slips through between four others


def particle_self_collision(cell: float) -> SelfCollision:
    """Return self-collision between particles, for cells with a side of `cell` [m]."""
    return SelfCollision(thickness=THICKNESS * cell)


THIN = 0.01  # [m] thickness for contacts between triangles and edges


def triangle_self_collision() -> SelfCollision:
    """Return self-collision between triangles and edges, whose thickness is independent of the cells."""
    return SelfCollision(thickness=THIN, primitives="triangles")


def sheet(
    cells: int | tuple[int, int],
    *,
    pins: tuple[str | int, ...] = CORNERS,
    size: tuple[float, float] = (SIDE, SIDE),
    rotation: Vec3 = (0.0, 0.0, 0.0),
    center: Vec3 = (0.0, 0.0, 0.0),
    constant: float = CONSTANT,
    share: float = 1.0,
    corner_mass: float = 0.0,
    corner_mass_at: str = "corners",
    damping: float = DAMPING,
    **sections: Any,
) -> Scene:
    """Return a scene of a sheet that hangs in the plane z = 0.

    `cells` is the number of rows and columns of cells. `constant` is the constant of all springs [N/m]; `share` (0…1)
    replaces it in `verlet`. `corner_mass` [kg] is the mass sewn to the corners `corner_mass_at`. `size` and `center`
    are in [m], `rotation` in [degrees], `damping` in [1/s]. Other sections as in `Scene`.
    """
    down, along = (cells, cells) if isinstance(cells, int) else cells
    cloth = Cloth(
        rows=down + 1,
        columns=along + 1,
        width=size[0],
        height=size[1],
        center=center,
        rotation=rotation,
        area_density=DENSITY,
        corner_mass=corner_mass,
        corner_mass_at=corner_mass_at,
        pins=pins,
    )
    fabric = Fabric(warp=constant, weft=constant, shear=constant, bend_spring=0.0, bending_stiffness=BENDING)
    springs = VerletSprings(structural=share, shear=share, bend=0.2 * share)
    keys: dict[str, Any] = {"cloth": cloth, "fabric": fabric, "verlet": springs, "camera": CAMERA}
    return Scene(**(keys | {"solver": Solver(damping=damping)} | sections))


def with_layers(scene: Scene, layers: int, spacing: float, turn: float = 0.0) -> Scene:
    """Return the scene with `layers` layers, `spacing` [m] apart, each rotated by `turn` [degrees] against the last."""
    return replace(scene, cloth=replace(scene.cloth, layers=layers, layer_spacing=spacing, layer_rotation=turn))


def with_fabric(scene: Scene, *, constant: float | None = None, density: float | None = None) -> Scene:
    """Return the scene with another spring constant [N/m] or another area density [kg/m²]."""
    if constant is not None:
        scene = replace(scene, fabric=replace(scene.fabric, warp=constant, weft=constant, shear=constant))
    if density is not None:
        scene = replace(scene, cloth=replace(scene.cloth, area_density=density))
    return scene


HUNG_BY = ("top-left", "top-right")
ALMOST_NONE = 1e-3  # [m/s²] gravity; not 0, because the solution is judged by forces relative to a particle's weight


def static_strain(scene: Scene) -> float:
    """Return the largest strain of a structural spring of this cloth at rest.

    It is computed in float64 with the constants of the fabric and its map of the stiffness. A solver's artificial
    stretch is not part of it.

    Cloth without pins that falls or lies on planes has no static strain. On other colliders, where parts of it hang
    down, it is judged by the strain of a single layer hung from its two top corners. That is an upper bound: cloth that
    lies is supported at more points, and a shorter piece hangs from each.
    """
    if not scene.cloth.pins and not any(getattr(scene, shape) for shape in COLLIDERS if shape != "planes"):
        return 0.0
    cloth = scene.cloth if scene.cloth.pins else replace(scene.cloth, pins=HUNG_BY, layers=1)
    still = Scene(cloth=cloth, regions=scene.regions, maps=scene.maps, fabric=scene.fabric, forces=scene.forces)
    named = replace(still, maps=still.maps and replace(still.maps, folder=""))  # another folder in each run
    return float(cached(f"rest strain {named}", lambda: np.array(rest_strain(still)), files_of(still)))


def taut_strain(scene: Scene, pull: float) -> float:
    """Return the largest strain at rest of a weightless sheet stretched by `pull` between its left and right edges.

    It is more than `pull`: the sheet gets narrower in the middle, which strains the springs at the pinned corners more.
    """
    still = Scene(cloth=scene.cloth, fabric=scene.fabric, forces=Forces(gravity=ALMOST_NONE))

    def strain() -> float:
        model = spring_model(still)
        stretched = replace(model.topology, start=model.topology.start * [1 + pull, 1.0, 1.0])
        model = replace(model, topology=stretched)
        return float(model.strains(rest_positions(model))[stretched.family("structural")].max())

    return float(cached(f"taut strain {pull} {still}", lambda: np.array(strain())))
