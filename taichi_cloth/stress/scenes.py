"""The base sheet of the hard cases: one square metre of 0.2 kg/m², 1000 N/m, around the origin."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from ..scene.model import Camera, Cloth, Fabric, Scene, SelfCollision, Solver, Springs, Vec3

SIDE = 1.0  # [m]
DENSITY = 0.2  # [kg/m²]
CONSTANT = 1000.0  # [N/m]
BENDING = 1.57e-5  # [N·m] a strip of 2 cm stands out by itself: B = ρ·g·c³
DAMPING = 2.0  # [1/s]
CORNERS = ("top-left", "top-right")
CAMERA = Camera(eye=(1.9, 0.6, 2.9), target=(0.0, -0.15, 0.0))
FLAT = (-90.0, 0.0, 0.0)  # [degrees] turns a hanging sheet level, its front upwards

THICKNESS = 0.9  # cells: what contact between particles needs, so that no particle slips through between four others


def off_itself(cell: float) -> SelfCollision:
    """Self-collision by particles of a cloth whose cells have sides of so many metres."""
    return SelfCollision(thickness=THICKNESS * cell)


THIN = 0.01  # [m] thickness of a cloth whose triangles and edges keep off each other


def thin() -> SelfCollision:
    """Self-collision by triangles and edges, which keeps a thickness that has nothing to do with the cells."""
    return SelfCollision(thickness=THIN, contacts="triangles")


def sheet(
    cells: int | tuple[int, int],
    *,
    pins: tuple[str | int, ...] = CORNERS,
    size: tuple[float, float] = (SIDE, SIDE),
    rotation: Vec3 = (0.0, 0.0, 0.0),
    center: Vec3 = (0.0, 0.0, 0.0),
    constant: float = CONSTANT,
    share: float = 1.0,
    weight: float = 0.0,
    weight_at: str = "corners",
    damping: float = DAMPING,
    **sections: Any,
) -> Scene:
    """A sheet of so many cells down and along, hanging in the plane z = 0.

    `constant` is that of all springs [N/m], and `share` (0…1) stands for it where springs have no constant. Other
    sections as in `Scene`.
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
        weight=weight,
        weight_at=weight_at,
        pins=pins,
    )
    fabric = Fabric(warp=constant, weft=constant, shear=constant, bend=0.0, bending=BENDING)
    springs = Springs(structural=share, shear=share, bend=0.2 * share)
    keys: dict[str, Any] = {"cloth": cloth, "fabric": fabric, "springs": springs, "camera": CAMERA}
    return Scene(**(keys | {"solver": Solver(damping=damping)} | sections))


def pile(scene: Scene, sheets: int, gap: float, turn: float = 0.0) -> Scene:
    """So many sheets like that of the scene, `gap` [m] apart, each turned by `turn` [degrees] against the last."""
    return replace(scene, cloth=replace(scene.cloth, sheets=sheets, gap=gap, turn=turn))


def of_fabric(scene: Scene, *, constant: float | None = None, density: float | None = None) -> Scene:
    """The same scene with springs of another constant [N/m], or of another mass [kg/m²]."""
    if constant is not None:
        scene = replace(scene, fabric=replace(scene.fabric, warp=constant, weft=constant, shear=constant))
    if density is not None:
        scene = replace(scene, cloth=replace(scene.cloth, area_density=density))
    return scene
