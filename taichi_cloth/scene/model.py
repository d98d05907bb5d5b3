"""What a scene is: frozen dataclasses. Every key carries its unit, range, default and a line of help.

The reader (`reader.py`) checks a TOML file against exactly this; overrides, sliders, the writer and the
table of keys walk over the same metadata, so a name or a range is written once.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields, is_dataclass
from functools import cache
from typing import Any, NamedTuple, get_args, get_origin, get_type_hints

Vec3 = tuple[float, float, float]
Keyframes = tuple[tuple[float, ...], ...]
Pins = tuple[str | int, ...]

FRAME_SECONDS = 1 / 60  # one frame, the unit in which everything else advances

EDGES = ("top", "bottom", "left", "right")  # a pin is one of these, one of those, a particle's index, or a text
CORNERS = ("top-left", "top-right", "bottom-left", "bottom-right")
GROUP, REGION = "group:", "region:"  # such a text begins so: points of a mesh file, and of [[regions]], by name

# The methods by name, here because importing a solver would import Taichi. With each its usual substeps and iterations,
# which run where a scene names only the method. `verlet`: those of the browser demos. `xpbd`, `lines` and `projective`:
# the cheapest at which sheets up to 33×33 of `taichi-cloth validate` reach the solution of a substep.
# `spring`: what a soft dashpot needs, whose force is half a substep late; like `rk4` it takes more where stability asks
# for them.
USUAL = {
    "verlet": (5, 12),
    "xpbd": (60, 4),
    "spring": (10, 1),
    "lines": (10, 2),
    "rk4": (1, 1),
    "projective": (20, 20),
}
SOLVER_NAMES = tuple(USUAL)
PATTERN_NAMES = ("plain", "check", "stripe", "gingham", "twill", "ring")  # view/patterns.py
PRESET_NAMES = ("silk", "cotton", "denim", "leather", "rubber", "chainmail")  # assets/presets, from light to heavy


@dataclass(frozen=True)
class Key:
    """What one scene key may hold; `slider` is set for keys that may change while running."""

    help: str
    unit: str = ""
    low: float | None = None
    high: float | None = None
    above_low: bool = False  # True: the value must be greater than `low`, not equal to it
    slider: tuple[float, float] | None = None
    choices: tuple[str, ...] = ()
    colour: bool = False  # True: the text must be #rrggbb


def _key(default: Any, help: str, unit: str = "", **bounds: Any) -> Any:
    return field(default=default, metadata={"key": Key(help, unit, **bounds)})


@dataclass(frozen=True)
class Cloth:
    """A rectangular sheet, or what a mesh `file` holds.

    Row 0 of a sheet is its top; before `rotation` columns run along +x and rows down −y. A file's axes are these, too.
    """

    rows: int = _key(24, "particles from top to bottom", low=2, high=2048)
    columns: int = _key(30, "particles from left to right", low=2, high=2048)
    width: float = _key(4.35, "length of the top edge", "m", low=0.001, high=1000.0)
    height: float = _key(3.45, "length of the left edge", "m", low=0.001, high=1000.0)
    file: str = _key(
        "", "instead of a sheet, a shipped mesh by name or an OBJ file: its path from the folder of the scene file"
    )
    scale: float = _key(1.0, "how many metres one unit of the file is", "m", low=0.0, high=1e6, above_low=True)
    center: Vec3 = _key((0.0, 2.2, 0.0), "middle of the sheet, or of the file's box", "m", low=-1e5, high=1e5)
    rotation: Vec3 = _key((0.0, 0.0, 0.0), "turned about x, then y, then z", "degrees", low=-360.0, high=360.0)
    area_density: float = _key(0.2, "mass of a square metre", "kg/m²", low=0.001, high=1000.0)
    diagonals: int = _key(2, "shear springs in a cell: 2 cross, 1 alternates with the triangles", low=1, high=2)
    lumping: str = _key(
        "area",
        "area: a particle on an edge has half the mass and an edge's springs half the constant; equal: as those inside",
        choices=("area", "equal"),
    )
    weight: float = _key(0.0, "sewn to each corner, or to the one of weight_at", "kg", low=0.0, high=1000.0)
    weight_at: str = _key("corners", "where a weight is sewn: to all corners, or to one", choices=("corners", *CORNERS))
    pins: Pins = _key(
        ("top",),
        "held in place: edges (top, bottom, left, right), corners (top-left, …), particle indices, region:NAME; of a"
        " file, where the default is none, group:NAME instead of edges",
    )
    sheets: int = _key(1, "how many such sheets there are, the rows of one after those of another", low=1, high=100)
    gap: float = _key(0.1, "from sheet to sheet, the first at center, the next in front of it", "m", low=-1e3, high=1e3)
    turn: float = _key(0.0, "each is turned in its plane against the one before", "degrees", low=-360.0, high=360.0)
    folder: str = field(default="", metadata={"derived": "of the scene file, for a mesh that is not shipped"})


# Keys of [cloth] that a mesh file has no use for.
GRID_KEYS = ("rows", "columns", "width", "height", "lumping", "weight", "weight_at", "sheets", "gap", "turn")


@dataclass(frozen=True)
class Region:
    """A block of space with its sides along x, y and z: `region:NAME` is a pin for the particles that start in it."""

    name: str = _key("", "what pins call it")
    low: Vec3 = _key((0.0, 0.0, 0.0), "its corner with the lowest x, y and z", "m", low=-1e5, high=1e5)
    high: Vec3 = _key((0.0, 0.0, 0.0), "its corner with the highest", "m", low=-1e5, high=1e5)


MAP_NAMES = ("pin", "stiffness", "max_distance")


@dataclass(frozen=True)
class Maps:
    """Numbers 0…1 for every particle: a picture laid over the cloth, black 0 and white 1, or a list of numbers.

    A picture is laid across a sheet, its top along the sheet's; on a mesh file as its texture points say. Numbers are
    those of the particles in order, one a line (.csv), or a NumPy array (.npy).
    """

    pin: str = _key("", "picture or numbers by path from the scene file's folder, or a shipped map: held from 0.5 on")
    stiffness: str = _key("", "the same: a spring's constant is times the factor that the mean of its two ends gives")
    stiffness_lo: float = _key(0.0, "that factor at 0", low=0.0, high=1000.0)
    stiffness_hi: float = _key(1.0, "that factor at 1", low=0.0, high=1000.0)
    max_distance: str = _key("", "the same: how far a particle may go from where it is at the start")
    max_distance_lo: float = _key(0.0, "that distance at 0", "m", low=0.0, high=1000.0)
    max_distance_hi: float = _key(1.0, "that distance at 1", "m", low=0.0, high=1000.0)
    folder: str = field(default="", metadata={"derived": "of the scene file"})


@dataclass(frozen=True)
class Springs:
    """Distance constraints by family, for `verlet`. A family set to 0 is left out of the cloth."""

    structural: float = _key(1.0, "share of a neighbour's length error put right in one iteration", low=0.0, high=1.0)
    shear: float = _key(1.0, "the same for both diagonals of each cell", low=0.0, high=1.0)
    bend: float = _key(0.2, "the same for particles two apart", low=0.0, high=1.0)


@dataclass(frozen=True)
class Fabric:
    """Spring constants for the solvers that take them in SI; one set to 0 leaves its springs out.

    On square cells `warp` and `weft` are forces per strain and metre of width, whatever the grid; on others
    they are scaled by the cell's sides so that they still are. A `preset` gives all of them, the cloth's
    `area_density` and the shares in `springs`; what a scene says itself wins (`presets.py`).
    """

    warp: float = _key(2000.0, "constant of a spring down a column", "N/m", low=0.0, high=1e9)
    weft: float = _key(2000.0, "the same along a row", "N/m", low=0.0, high=1e9)
    shear: float = _key(1000.0, "the same along the diagonals of each cell", "N/m", low=0.0, high=1e9)
    bend: float = _key(20.0, "the same for particles two apart: no linear bending", "N/m", low=0.0, high=1e9)
    bending: float = _key(0.0, "resistance of the sheet to bending, whatever the grid", "N·m", low=0.0, high=1e6)
    compression: float = _key(
        1.0,
        "share of its constant with which a spring resists being shortened: 0 for threads that go slack",
        low=0.0,
        high=1.0,
    )
    damping_time: float = _key(0.0, "a spring's dashpot is this times its constant", "s", low=0.0, high=1.0)
    preset: str = _key(
        "",
        "measured fabric that fills in what is not written here, in springs and as area_density",
        choices=(*PRESET_NAMES, ""),
    )


@dataclass(frozen=True)
class Solver:
    """The method and its knobs. A file without substeps or iterations gets those that are usual for its method."""

    name: str = _key("verlet", "method that advances the cloth", choices=SOLVER_NAMES)
    substeps: int = _key(
        USUAL["verlet"][0],
        "steps in a frame of 1/60 s (default: the method's usual)",
        low=1,
        high=1000,
        slider=(1, 60),
    )
    iterations: int = _key(
        USUAL["verlet"][1], "sweeps over all constraints in a substep (the same)", low=1, high=1000, slider=(1, 40)
    )
    stiffness: float = _key(1.0, "multiplies every family's stiffness", low=0.0, high=1.0, slider=(0.0, 1.0))
    damping: float = _key(1.5, "rate at which velocity is lost", "1/s", low=0.0, high=1e6, slider=(0.0, 10.0))


@dataclass(frozen=True)
class Limit:
    """A limit of strain (Provot 1995): after each substep every spring that is longer is shortened."""

    strain: float = _key(0.1, "largest length/rest − 1 that is left alone", low=0.0, high=10.0, slider=(0.0, 0.5))
    sweeps: int = _key(1, "how often all springs are, in a substep", low=1, high=1000)


@dataclass(frozen=True)
class Tethers:
    """Ties to the pins (Kim et al. 2012): no particle gets farther from one than on the flat sheet, times `slack`.

    Each substep ends with them, whatever the solver. Obstacles between a particle and its pin
    are not seen, and a cloth without pins has no tethers.
    """

    slack: float = _key(
        1.01, "longest distance to a pin, in distances on the flat sheet", low=1.0, high=2.0, slider=(1.0, 1.2)
    )


@dataclass(frozen=True)
class Tear:
    """Threads that are stretched too far give way, with the triangles beside them. Not with `fabric.bending`."""

    strain: float = _key(0.5, "largest length/rest − 1 that a thread bears", low=0.01, high=100.0, slider=(0.05, 2.0))


@dataclass(frozen=True)
class Forces:
    """Forces on every particle."""

    gravity: float = _key(9.81, "downward acceleration", "m/s²", low=-1e5, high=1e5, slider=(0.0, 20.0))


@dataclass(frozen=True)
class Wind:
    """Air that moves: drag along it and lift across it on every triangle."""

    x: float = _key(0.0, "wind along x", "m/s", low=-100.0, high=100.0, slider=(-12.0, 12.0))
    z: float = _key(0.0, "wind along z", "m/s", low=-100.0, high=100.0, slider=(-12.0, 12.0))
    turbulence: float = _key(0.5, "size of the gusts as a share of the wind speed", low=0.0, high=2.0)
    drag: float = _key(1.0, "drag coefficient of a sheet face-on", low=0.0, high=10.0)
    lift: float = _key(1.0, "lift coefficient", low=0.0, high=10.0)
    air_density: float = _key(1.225, "density of the air", "kg/m³", low=0.0, high=100.0)


# What a body does to cloth within its margin: moves it out, turns its velocity round, or pushes with a force.
RESPONSES = ("projection", "reflection", "repulsion")
PROJECTION, REFLECTION, REPULSION = range(3)


@dataclass(frozen=True)
class Contact:
    """How a body keeps cloth away. `swept` and triangles are for projection."""

    margin: float = _key(0.02, "cloth is kept this far off the surface", "m", low=0.0, high=10.0)
    friction: float = _key(0.4, "Coulomb coefficient", low=0.0, high=1e6)
    swept: bool = _key(False, "stops what would be through it or past it within a substep")
    response: str = _key(
        "projection",
        "projection moves cloth out to the margin, reflection turns its velocity round, repulsion pushes with a force",
        choices=RESPONSES,
    )
    restitution: float = _key(0.5, "of reflection: share of the speed that is left", low=0.0, high=1.0)
    stiffness: float = _key(
        2000.0, "of repulsion: pressure for each metre within the margin", "N/m³", low=0.0, high=1e9
    )


@dataclass(frozen=True)
class Motion:
    """How a body goes: its middle is at center + sway·sin(2π·t/period + phase), and where `path` leads.

    It rocks in time with that about x, y and z, is turned as `path` says, then at the rate `spin`: about its middle.
    """

    center: Vec3 = _key((0.0, 1.0, 0.0), "middle of its path", "m", low=-1e5, high=1e5)
    sway: Vec3 = _key((0.0, 0.0, 0.0), "reach of its path along x, y, z", "m", low=-1000.0, high=1000.0)
    period: Vec3 = _key((8.0, 8.0, 8.0), "time of one sway along x, y, z", "s", low=0.01, high=1e6)
    phase: Vec3 = _key((0.0, 0.0, 0.0), "where on its path it starts", "degrees", low=-360.0, high=360.0)
    rock: Vec3 = _key(
        (0.0, 0.0, 0.0), "reach of its turning to and fro about x, y, z", "degrees", low=-360.0, high=360.0
    )
    # Two poses a frame apart tell of less than half a turn, 10,800 degrees/s (`contact/bodies.turn_between`). Along all
    # three axes at once, 6000 degrees/s are 10,392.
    spin: Vec3 = _key((0.0, 0.0, 0.0), "how fast it turns, about which axis", "degrees/s", low=-6000.0, high=6000.0)
    path: Keyframes = _key(
        (), "rows of [seconds, x, y, z] or with three angles: moved by [m] and turned by [degrees]", low=-1e5, high=1e5
    )


@dataclass(frozen=True)
class Grip(Motion):
    """Pins that go as one body does, from where they are at the start: a bar that the cloth hangs from, a hand."""

    pins: Pins = _key((), "edges, corners, particle indices, regions or groups that it holds, as in [cloth]")


@dataclass(frozen=True)
class Collider(Motion, Contact):
    """A body the cloth cannot enter; before all else it is turned by `rotation`."""

    rotation: Vec3 = _key((0.0, 0.0, 0.0), "turned about x, then y, then z", "degrees", low=-360.0, high=360.0)


@dataclass(frozen=True)
class Round(Collider):
    """A body whose surface is everywhere as far from a point or a line."""

    against: str = _key(
        "particles", "what it keeps out; triangles: a body smaller than a cell too", choices=("particles", "triangles")
    )


@dataclass(frozen=True)
class Sphere(Round):
    """A ball."""

    radius: float = _key(0.5, "radius as drawn", "m", low=0.0, high=1000.0, above_low=True, slider=(0.05, 1.5))
    margin: float = _key(0.15, "cloth is kept this far off the surface", "m", low=0.0, high=10.0)
    friction: float = _key(0.0, "Coulomb coefficient", low=0.0, high=1e6)


@dataclass(frozen=True)
class Capsule(Round):
    """A round bar with round ends, upright unless it is turned."""

    length: float = _key(1.0, "between the middles of its round ends", "m", low=0.0, high=1000.0)
    radius: float = _key(0.1, "radius as drawn", "m", low=0.0, high=1000.0, above_low=True)


@dataclass(frozen=True)
class Box(Collider):
    """A solid block with its sides along x, y and z unless it is turned: a table top."""

    center: Vec3 = _key((0.0, 0.5, 0.0), "middle of the block", "m", low=-1e5, high=1e5)
    size: Vec3 = _key((1.0, 1.0, 1.0), "whole length along x, y, z", "m", low=0.001, high=1000.0)


@dataclass(frozen=True)
class Plane(Collider):
    """A slope without end: level, and solid below, unless it is turned."""

    center: Vec3 = _key((0.0, 0.0, 0.0), "a point of it", "m", low=-1e5, high=1e5)
    drawn: float = _key(4.0, "side of the square that is drawn around its center", "m", low=0.001, high=1000.0)


@dataclass(frozen=True)
class Mesh(Collider):
    """A solid with a closed surface of triangles, around the middle of the box that holds it."""

    file: str = _key("bust", "a shipped mesh by name, or an OBJ file: its path from the folder of the scene file")
    scale: float = _key(1.0, "how many metres one unit of the file is", "m", low=0.0, high=1e6, above_low=True)
    resolution: int = _key(64, "cells along its longest side in which distances to it are kept", low=4, high=256)
    folder: str = field(default="", metadata={"derived": "of the scene file, for a mesh that is not shipped"})


@dataclass(frozen=True)
class Ground(Contact):
    """A level floor."""

    height: float = _key(0.0, "where the floor lies", "m", low=-1e5, high=1e5)


@dataclass(frozen=True)
class SelfCollision:
    """The cloth cannot pass through itself. What comes nearer by two thicknesses in one substep may."""

    thickness: float = _key(
        0.05, "how far the cloth keeps off itself", "m", low=0.0, high=10.0, above_low=True, slider=(0.005, 0.2)
    )
    friction: float = _key(0.3, "Coulomb coefficient of cloth on cloth", low=0.0, high=1e6)
    untangle: bool = _key(False, "lets go what is through itself already, until it is not any more")
    stick: bool = _key(False, "friction of particles holds them where they met: stacks stand, and heaps hardly creep")
    contacts: str = _key(
        "particles",
        "particles keep off particles (for a thickness like a cell's side), or triangles off particles and edges off"
        " edges (for a thin cloth; takes five times as long)",
        choices=("particles", "triangles"),
    )


@dataclass(frozen=True)
class Camera:
    """Where the picture is taken from."""

    eye: Vec3 = _key((3.5, 2.6, 6.5), "place of the eye", "m", low=-1e5, high=1e5)
    target: Vec3 = _key((0.0, 1.9, 0.0), "point it looks at", "m", low=-1e5, high=1e5)
    fov: float = _key(40.0, "height of the picture as an angle", "degrees", low=1.0, high=120.0)


@dataclass(frozen=True)
class Look:
    """Colours; nothing here changes the motion. A fabric preset brings its own."""

    cloth: str = _key("#b5303c", "first colour of the pattern", colour=True)
    check: str = _key("#e9dcc3", "second colour of the pattern", colour=True)
    check_cells: int = _key(
        3,
        "cells to a check, a stripe or half a twill's repeat; on a mesh file rings of so many edges",
        low=1,
        high=2048,
    )
    pattern: str = _key("check", "how both colours are woven", choices=PATTERN_NAMES)
    sheen: float = _key(0.08, "how brightly the cloth gleams where it reflects the lamp", low=0.0, high=1.0)
    pole: bool = _key(False, "draw a pole along the top edge")


@dataclass(frozen=True)
class Scene:
    """Everything a run needs to know; it cannot be changed afterwards.

    Build one with `load_scene`, or in Python: then `Simulation` checks it as a file is checked (`check_scene`).
    """

    title: str = _key("", "one line that tells what the scene shows")
    seed: int = _key(0, "seed of the gusts", low=0, high=2**31 - 1)
    cloth: Cloth = field(default_factory=Cloth)
    regions: tuple[Region, ...] = ()
    maps: Maps | None = None
    springs: Springs = field(default_factory=Springs)
    fabric: Fabric = field(default_factory=Fabric)
    solver: Solver = field(default_factory=Solver)
    limit: Limit | None = None
    tethers: Tethers | None = None
    tear: Tear | None = None
    forces: Forces = field(default_factory=Forces)
    wind: Wind | None = None
    grips: tuple[Grip, ...] = ()
    spheres: tuple[Sphere, ...] = ()
    capsules: tuple[Capsule, ...] = ()
    boxes: tuple[Box, ...] = ()
    planes: tuple[Plane, ...] = ()
    meshes: tuple[Mesh, ...] = ()
    ground: Ground | None = None
    self_collision: SelfCollision | None = None
    camera: Camera = field(default_factory=Camera)
    look: Look = field(default_factory=Look)
    name: str = field(default="scene", metadata={"derived": "the file's stem"})


# Sections of `Scene`, in the order of the kernels' table.
COLLIDERS = ("spheres", "capsules", "boxes", "planes", "meshes")


class Part(NamedTuple):
    """One section of a scene: its table in a file, and its class."""

    name: str  # the table's name: "wind", "spheres"
    section: type
    many: bool  # an array of tables, [[spheres]]
    optional: bool  # a scene may be without

    @property
    def one(self) -> str:
        """The name of a single one: "wind", "sphere"."""
        return self.section.__name__.lower() if self.many else self.name


@cache
def parts() -> dict[str, Part]:
    """The sections by name, read off the annotations of `Scene`: `Cloth`, `Wind | None`, `tuple[Box, ...]`."""
    found = {}
    for name, hint in hints_of(Scene).items():
        for section in get_args(hint) or (hint,):
            if isinstance(section, type) and is_dataclass(section):
                found[name] = Part(name, section, many=get_origin(hint) is tuple, optional=hint is not section)
    return found


def keys_of(section: type) -> dict[str, Key]:
    """The declared keys of a section by name: `keys_of(Wind)["x"].unit`."""
    return {f.name: f.metadata["key"] for f in fields(section) if "key" in f.metadata}


@cache
def hints_of(section: type) -> dict[str, Any]:
    """The types of a section's keys by name."""
    return get_type_hints(section)
