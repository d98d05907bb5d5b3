"""The schema of scenes: frozen dataclasses. Every key has a default, a unit, a range and a line of help.

The reader (`reader.py`) checks a TOML file against this schema. Overrides, sliders, the writer and the table of keys
use the same metadata, so each name and range is defined once.
"""

from __future__ import annotations

from dataclasses import dataclass, field, is_dataclass
from functools import cache
from typing import get_args, get_origin

from ..system.errors import Mistakes
from .collider_schema import Attachment, Box, Capsule, Ground, Mesh, Plane, Sphere
from .fabric_schema import PRESET_NAMES, Fabric, Look, VerletSprings, Weave
from .keys import CORNERS, Pins, Section, Table, Vec3, Weights, check_table, given_table, key_field, keys_of, types_of
from .solver_catalog import SOLVER_CATALOG

FRAME_SECONDS = 1 / 60  # [s] duration of a frame
SOLVER_NAMES = tuple(SOLVER_CATALOG)


@dataclass(frozen=True)
class Cloth(Table):
    """A rectangular grid of particles, or the triangle mesh in `file`.

    Before `rotation` a grid lies in the xy plane. Rows run along +x, columns along −y; row 0 is at the top. A mesh file
    uses the same axes.
    """

    rows: int = key_field(24, "number of particles from top to bottom", min=2, max=2048)
    columns: int = key_field(30, "number of particles from left to right", min=2, max=2048)
    width: float = key_field(4.35, "length of the top edge", "m", min=0.001, max=1000.0)
    height: float = key_field(3.45, "length of the left edge", "m", min=0.001, max=1000.0)
    file: str = key_field(
        "", "triangle mesh instead of a grid: a shipped mesh, or path of an OBJ file relative to the scene file"
    )
    scale: float = key_field(1.0, "length of one unit of the file", "m", min=0.0, max=1e6, exclusive_min=True)
    center: Vec3 = key_field(
        (0.0, 2.2, 0.0), "center of the grid, or of the bounding box of the mesh", "m", min=-1e5, max=1e5
    )
    rotation: Vec3 = key_field((0.0, 0.0, 0.0), "rotation about x, then y, then z", "degrees", min=-360.0, max=360.0)
    area_density: float = key_field(
        0.2, "mass per area: how heavy the cloth is", "kg/m²", min=0.001, max=1000.0, param="AREA_DENSITY"
    )
    diagonals: int = key_field(
        2,
        "shear springs per cell: 2 on both diagonals, or 1 on the common edge of its two triangles, which"
        " alternates from cell to cell",
        min=1,
        max=2,
    )
    mass_lumping: str = key_field(
        "area",
        "area: half the mass and stiffness for particles and springs on edges; uniform: the same as in the interior",
        choices=("area", "uniform"),
    )
    corner_mass: float = key_field(0.0, "mass added to each corner in corner_mass_at", "kg", min=0.0, max=1000.0)
    corner_mass_at: str = key_field(
        "corners", "corners with corner_mass: all four, or one of them", choices=("corners", *CORNERS)
    )
    pins: Pins = key_field(
        ("top",),
        "pinned particles: edges (top, bottom, left, right), corners (top-left, …), particle indices, region:NAME; for"
        " a mesh file group:NAME instead of edges and corners, and no pins by default",
    )
    layers: int = key_field(1, "number of layers; particles are numbered layer by layer", min=1, max=100)
    layer_spacing: float = key_field(
        0.1, "distance between layers: the first is at center, the next in front of it", "m", min=-1e3, max=1e3
    )
    layer_rotation: float = key_field(
        0.0, "rotation of each layer in its plane, relative to the previous layer", "degrees", min=-360.0, max=360.0
    )
    folder: str = field(default="", metadata={"derived": "folder of the scene file, for a mesh that is not shipped"})

    def __post_init__(self) -> None:
        if self.file:
            self._set_defaults(pins=())


# Keys of [cloth] that apply to grids only.
GRID_KEYS = (
    "rows",
    "columns",
    "width",
    "height",
    "mass_lumping",
    "corner_mass",
    "corner_mass_at",
    "layers",
    "layer_spacing",
    "layer_rotation",
)


@dataclass(frozen=True)
class Region(Table):
    """An axis-aligned box. The pin `region:NAME` pins all particles that start inside it."""

    name: str = key_field("", "name that pins refer to")
    min: Vec3 = key_field((0.0, 0.0, 0.0), "corner with the smallest x, y and z", "m", min=-1e5, max=1e5)
    max: Vec3 = key_field((0.0, 0.0, 0.0), "corner with the largest x, y and z", "m", min=-1e5, max=1e5)


MAP_NAMES = ("pin", "stiffness", "max_distance")


@dataclass(frozen=True)
class Maps(Table):
    """Maps assign a number 0…1 to every particle. A map is an image (black is 0, white is 1) or a list of numbers.

    An image covers a grid, with the top of the image at the top edge; on a mesh file it follows the texture
    coordinates. A list has one number per particle, in order. It is a file with one per line (.csv), a NumPy file
    (.npy), or the list itself, in Python also an array. For a grid it may have rows: the first is the top edge.
    """

    pin: Weights = key_field(
        "",
        "map that pins particles where it is at least 0.5: path relative to the scene file, a shipped map, or numbers",
    )
    stiffness: Weights = key_field(
        "", "map that scales the stiffness of each spring, by the mean of its two ends (given as pin)"
    )
    stiffness_min: float = key_field(0.0, "stiffness factor where the map is 0", min=0.0, max=1000.0)
    stiffness_max: float = key_field(1.0, "stiffness factor where the map is 1", min=0.0, max=1000.0)
    max_distance: Weights = key_field(
        "", "map of the maximum distance of a particle from its start position (given as pin)"
    )
    max_distance_min: float = key_field(0.0, "maximum distance where the map is 0", "m", min=0.0, max=1000.0)
    max_distance_max: float = key_field(1.0, "maximum distance where the map is 1", "m", min=0.0, max=1000.0)
    folder: str = field(default="", metadata={"derived": "folder of the scene file"})


@dataclass(frozen=True)
class Solver(Table):
    """The solver and its settings. Substeps and iterations that are not set have the defaults of the solver."""

    name: str = key_field("verlet", "solver that advances the cloth", choices=SOLVER_NAMES)
    substeps: int = key_field(
        SOLVER_CATALOG["verlet"].substeps,
        "substeps per frame of 1/60 s; the default depends on the solver",
        min=1,
        max=1000,
        slider=(1, 60),
    )
    iterations: int = key_field(
        SOLVER_CATALOG["verlet"].iterations,
        "iterations per substep; the default depends on the solver",
        min=1,
        max=1000,
        slider=(1, 40),
    )
    stiffness: float = key_field(
        1.0, "factor on the stiffness of all springs", min=0.0, max=1.0, slider=(0.0, 1.0), param="STIFFNESS_FACTOR"
    )
    damping: float = key_field(1.5, "rate at which velocities decay", "1/s", min=0.0, max=1e6, slider=(0.0, 10.0))

    def __post_init__(self) -> None:
        info = SOLVER_CATALOG.get(self.name) if isinstance(self.name, str) else None  # it is not checked yet
        if info is not None:
            self._set_defaults(substeps=info.substeps, iterations=info.iterations)


@dataclass(frozen=True)
class StrainLimit(Table):
    """Strain limit (Provot 1995): springs stretched beyond it are shortened after each substep."""

    strain: float = key_field(
        0.1,
        "largest strain (length/rest − 1) that is not corrected",
        min=0.0,
        max=10.0,
        slider=(0.0, 0.5),
        slider_name="strain_limit",
        param="STRAIN_LIMIT",
    )
    iterations: int = key_field(1, "strain-limiting iterations per substep", min=1, max=1000)


@dataclass(frozen=True)
class Tethers(Table):
    """Tethers to the pins (Kim et al. 2012) limit the distance of each particle from a pin.

    The limit is `slack` times their distance on the flat sheet. All solvers enforce it at the end of each substep.
    Tethers ignore obstacles between a particle and its pin. Cloth without pins has no tethers.
    """

    slack: float = key_field(
        1.01,
        "maximum distance to a pin over that on the flat sheet",
        min=1,
        max=2,
        slider=(1, 1.2),
        param="TETHER_SLACK",
    )


@dataclass(frozen=True)
class Tearing(Table):
    """Springs that stretch too far break, with the triangles beside them. `fabric.bending_stiffness` must be 0."""

    strain: float = key_field(
        0.5, "strain (length/rest − 1) above which springs break", min=0.01, max=100.0, slider=(0.05, 2.0)
    )


@dataclass(frozen=True)
class Forces(Table):
    """Forces on every particle."""

    gravity: float = key_field(
        9.81, "downward acceleration", "m/s²", min=-1e5, max=1e5, slider=(0.0, 20.0), param="GRAVITY"
    )


@dataclass(frozen=True)
class Wind(Table):
    """Wind: every triangle has drag along the relative air velocity, and lift perpendicular to it."""

    x: float = key_field(0.0, "wind velocity along x", "m/s", min=-100.0, max=100.0, slider=(-12.0, 12.0))
    z: float = key_field(0.0, "wind velocity along z", "m/s", min=-100.0, max=100.0, slider=(-12.0, 12.0))
    turbulence: float = key_field(0.5, "gust speed as a fraction of the wind speed", min=0.0, max=2.0)
    drag: float = key_field(
        1.0, "drag coefficient of a sheet perpendicular to the flow", min=0.0, max=10.0, param="DRAG"
    )
    lift: float = key_field(1.0, "lift coefficient", min=0.0, max=10.0, param="LIFT")
    air_density: float = key_field(1.225, "density of the air", "kg/m³", min=0.0, max=100.0)


@dataclass(frozen=True)
class SelfCollision(Table):
    """Self-collision. Parts of the cloth that approach by more than two thicknesses in one substep may pass through."""

    thickness: float = key_field(
        0.05,
        "minimum distance between parts of the cloth",
        "m",
        min=0.0,
        max=10.0,
        exclusive_min=True,
        slider=(0.005, 0.2),
        param="THICKNESS",
    )
    friction: float = key_field(
        0.3, "Coulomb friction coefficient of cloth on cloth", min=0.0, max=1e6, param="SELF_FRICTION"
    )
    untangle: bool = key_field(False, "no self-contact where the cloth intersects itself, until it no longer does")
    penetration_free: bool = key_field(
        False, "cloth never crosses cloth: triangles and edges meet at the thickness, and other motion is cut off"
    )
    static_friction: bool = key_field(
        False, "static friction between particles, by friction anchors: stacks stand, and piles hardly creep"
    )
    primitives: str = key_field(
        "particles",
        "particles: contact between particles, for a thickness like the side of a cell; triangles: vertex-triangle and"
        " edge-edge contact, for thin cloth (takes five times as long)",
        choices=("particles", "triangles"),
    )


@dataclass(frozen=True)
class Camera(Table):
    """The camera of the window and of images. Without this section it frames the cloth and the colliders near it."""

    eye: Vec3 = key_field((3.5, 2.6, 6.5), "position of the camera", "m", min=-1e5, max=1e5)
    target: Vec3 = key_field((0.0, 1.9, 0.0), "point that the camera looks at", "m", min=-1e5, max=1e5)
    fov: float = key_field(40.0, "vertical field of view", "degrees", min=1.0, max=120.0)


@dataclass(frozen=True)
class Scene(Table):
    """A complete, immutable description of a simulation.

    Load one with `load_scene` or create it in Python. Sections are objects of their classes or dicts with their keys,
    arrays of sections are tuples or lists, and None is no section. Numbers and arrays of NumPy are stored as Python's.
    Each key is checked as in a file. Raises SceneError: one line with scene, key, reason and the nearest valid name.
    """

    title: str = key_field("", "one line that describes the scene")
    seed: int = key_field(0, "random seed of the gusts", min=0, max=2**31 - 1)
    cloth: Cloth = field(default_factory=Cloth)
    regions: tuple[Region, ...] = ()
    maps: Maps | None = None
    verlet: VerletSprings = field(default_factory=VerletSprings)
    fabric: Fabric = field(default_factory=Fabric)
    weave: Weave | None = None
    solver: Solver = field(default_factory=Solver)
    strain_limit: StrainLimit | None = None
    tethers: Tethers | None = None
    tearing: Tearing | None = None
    forces: Forces = field(default_factory=Forces)
    wind: Wind | None = None
    attachments: tuple[Attachment, ...] = ()
    spheres: tuple[Sphere, ...] = ()
    capsules: tuple[Capsule, ...] = ()
    boxes: tuple[Box, ...] = ()
    planes: tuple[Plane, ...] = ()
    meshes: tuple[Mesh, ...] = ()
    ground: Ground | None = None
    self_collision: SelfCollision | None = None
    camera: Camera = field(default_factory=Camera)
    look: Look = field(default_factory=Look)
    name: str = field(default="scene", metadata={"derived": "stem of the scene file"})

    def __post_init__(self) -> None:
        mistakes = Mistakes(self.name)
        fabric = given_table(self.fabric)
        name = self.fabric if isinstance(self.fabric, str) else fabric.get("preset")
        if name and len(fabric) < len(keys_of(Fabric)):  # that of a scene has all keys
            example = f'load_scene(tc.Scene(...), fabric="{PRESET_NAMES[0]}")'
            mistakes.add("fabric.preset", f"is applied by load_scene only, as in tc.{example}")
        values = check_table(Scene, {key: getattr(self, key) for key in keys_of(Scene)}, mistakes)
        for part in sections().values():
            if not mistakes.concern(part.name):
                values[part.name] = part.checked(getattr(self, part.name), mistakes)
        mistakes.raise_first()
        for name, value in values.items():
            object.__setattr__(self, name, value)


# Sections of `Scene` with colliders, in the order of the collider table.
COLLIDERS = ("spheres", "capsules", "boxes", "planes", "meshes")


@cache
def sections() -> dict[str, Section]:
    """Return all sections by name, from the annotations of `Scene`: `Cloth`, `Wind | None`, `tuple[Box, ...]`."""
    by_name = {}
    for name, hint in types_of(Scene).items():
        for section in get_args(hint) or (hint,):
            if isinstance(section, type) and is_dataclass(section):
                by_name[name] = Section(name, section, is_array=get_origin(hint) is tuple, optional=hint is not section)
    return by_name
