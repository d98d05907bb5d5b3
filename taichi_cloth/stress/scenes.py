"""The sheet that all cases are about: one square metre of 0.2 kg/m², 1000 N/m, around the origin."""

from __future__ import annotations

from typing import Any

from ..scene.model import Camera, Cloth, Fabric, Scene, SelfCollision, Solver, Springs, Vec3

SIDE = 1.0  # [m]
DENSITY = 0.2  # [kg/m²]
CONSTANT = 1000.0  # [N/m]
BENDING = 1.57e-5  # [N·m] a strip of 2 cm stands out by itself: B = ρ·g·c³
DAMPING = 2.0  # [1/s]
CORNERS = ("top-left", "top-right")
CAMERA = Camera(eye=(1.9, 0.6, 2.9), target=(0.0, -0.15, 0.0))

THICKNESS = 0.9  # cells, of a cloth that keeps off itself by its particles


def off_itself(cell: float) -> SelfCollision:
    """What keeps the layers of a cloth apart whose cells have sides of so many metres."""
    return SelfCollision(thickness=THICKNESS * cell)


def sheet(
    cells: int | tuple[int, int],
    *,
    pins: tuple[str | int, ...] = CORNERS,
    size: tuple[float, float] = (SIDE, SIDE),
    rotation: Vec3 = (0.0, 0.0, 0.0),
    center: Vec3 = (0.0, 0.0, 0.0),
    constant: float = CONSTANT,
    warp: float | None = None,
    share: float = 1.0,
    weight: float = 0.0,
    damping: float = DAMPING,
    **sections: Any,
) -> Scene:
    """A sheet of so many cells down and along, hanging in the plane z = 0.

    `constant` is that of all springs [N/m], `warp` of those down the columns, and `share` (0…1) stands for it where
    springs have no constant. Other sections as in `Scene`.
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
        pins=pins,
    )
    fabric = Fabric(warp=warp or constant, weft=constant, shear=constant, bend=0.0, bending=BENDING)
    springs = Springs(structural=share, shear=share, bend=0.2 * share)
    keys: dict[str, Any] = {"cloth": cloth, "fabric": fabric, "springs": springs, "camera": CAMERA}
    return Scene(**(keys | {"solver": Solver(damping=damping)} | sections))
