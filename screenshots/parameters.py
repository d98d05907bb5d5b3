"""Draws docs/pictures/parameters: for one key of a scene a strip of panels, a value each.

`make screenshots` runs it too; `python screenshots/parameters.py wind limit` draws some of them only.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

import taichi_cloth as tc
from taichi_cloth.scene.model import PRESET_NAMES, USUAL
from taichi_cloth.view.contact_sheet import contact_sheet

FOLDER = Path(__file__).parents[1] / "docs" / "pictures" / "parameters"
WIDTH, HEIGHT = 1200, 270  # [pixels] of a strip, and of a panel
GAP = 4


@dataclass(frozen=True)
class Strip:
    """A key at several values, or a few keys that change together; `frame` is the moment shown."""

    name: str
    says: str  # what the panels have in common, in Markdown
    panels: dict[str, dict[str, Any]]  # caption → overrides of the scene
    scene: str
    frame: int
    common: dict[str, Any] = field(default_factory=dict)  # overrides of all panels
    view: str = "shaded"
    columns: int = 0  # 0: all panels in one row


def values(key: str, *numbers: Any, unit: str = "") -> dict[str, dict[str, Any]]:
    """A panel for each value of one key."""
    return {f"{number}{' ' + unit if unit else ''}": {key: number} for number in numbers}


def usual(name: str) -> dict[str, Any]:
    return dict(zip(("substeps", "iterations"), USUAL[name], strict=True))


# Two corners hold a sheet of 25 × 25 particles, which is let go leaning forward.
HUNG: dict[str, Any] = {
    "rows": 25,
    "columns": 25,
    "wind_x": 0.0,
    "wind_z": 0.0,
    "camera_eye": (1.6, 1.5, 3.6),
    "camera_target": (0.0, 1.25, -0.2),
}
BESIDE = {"camera_eye": (4.2, 1.5, 1.2), "camera_target": (0.0, 1.35, 0.3)}  # the same from its side
TABLE: dict[str, Any] = {"camera_eye": (1.2, 1.25, 1.7), "camera_target": (0.0, 0.55, 0.0)}
BY_FORCES: dict[str, Any] = {**TABLE, "solver": "spring", "rows": 31, "columns": 31}

STRIPS = (
    Strip(
        "iterations",
        "`[solver] iterations` of `verlet`, one substep a frame. Red threads are stretched by a tenth and more",
        values("iterations", 2, 5, 12, 40),
        "drape15",
        150,
        {**HUNG, "substeps": 1},
        view="strain",
    ),
    Strip(
        "substeps",
        "`[solver] substeps` of `verlet`, five iterations in each",
        values("substeps", 1, 2, 5, 20),
        "drape15",
        150,
        {**HUNG, "iterations": 5},
        view="strain",
    ),
    Strip(
        "grid",
        "`[cloth] rows` and `columns`, `verlet` 5×12: the finer, the softer, unless iterations grow as well",
        {f"{n} × {n}": {"rows": n, "columns": n} for n in (15, 30, 60, 120)},
        "drape15",
        150,
        {**HUNG, "substeps": 5, "iterations": 12},
        view="strain",
    ),
    Strip(
        "stiffness",
        "`[solver] stiffness`, which multiplies the shares of `verlet`; 1×12",
        values("solver_stiffness", 0.1, 0.2, 0.5, 1.0),
        "drape15",
        150,
        {**HUNG, "substeps": 1, "iterations": 12},
        view="strain",
    ),
    Strip(
        "solver",
        "`[solver] name`: denim of 41 × 41 particles, each method with its usual substeps and iterations",
        {name: {"solver": name, **usual(name)} for name in USUAL},
        "drape15",
        90,
        {**HUNG, "rows": 41, "columns": 41, "preset": "denim"},
        view="strain",
        columns=3,
    ),
    Strip(
        "diagonals",
        "shear springs: none, one diagonal a cell, two that are half as stiff. One or two makes little difference",
        {
            "none": {"fabric_shear": 0.0},
            "one": {"diagonals": 1, "fabric_shear": 2000.0},
            "two": {"diagonals": 2, "fabric_shear": 1000.0},
        },
        "drape15",
        150,
        {**HUNG, "solver": "spring"},
    ),
    Strip(
        "bend",
        "`[springs] bend`, the share of `verlet` for particles two apart",
        values("springs_bend", 0.0, 0.02, 0.2, 1.0),
        "table",
        120,
        TABLE,
    ),
    Strip(
        "bending",
        "`[fabric] bending`, how the sheet itself resists (`spring`)",
        {f"{value} N·m": {"bending": float(value)} for value in ("0", "1e-4", "1e-3", "1e-2")},
        "table",
        120,
        {**BY_FORCES, "warp": 500.0, "weft": 500.0, "fabric_shear": 50.0, "fabric_bend": 0.0},
    ),
    Strip(
        "fabric",
        "`[fabric] preset` (`spring`)",
        values("preset", *PRESET_NAMES),
        "table",
        200,
        BY_FORCES,
        columns=3,
    ),
    Strip(
        "wind",
        "`[wind] z`, from the left, after three seconds",
        values("wind_z", 0.0, 1.0, 2.0, 4.0, unit="m/s"),
        "drape15",
        180,
        {**HUNG, **BESIDE, "pins": ["top"], "substeps": 5, "iterations": 12, "turbulence": 0.3},
    ),
    Strip(
        "damping",
        "`[solver] damping`: 0.8 s after the sheet was let go",
        values("damping", 0.0, 1.5, 5.0, 20.0, unit="1/s"),
        "drape15",
        48,
        {**HUNG, **BESIDE, "substeps": 5, "iterations": 12},
    ),
    Strip(
        "limit",
        "`[limit] strain`: weak springs, and a ball that presses",
        {"none": {"limit_strain": 10.0}, **values("limit_strain", 0.3, 0.1, 0.02)},
        "net",
        100,
        {"camera_eye": (1.8, 1.9, 3.1), "camera_target": (0.0, 1.15, 0.0)},
        view="strain",
    ),
    Strip(
        "tethers",
        "`[tethers] slack`, `verlet` 1×2",
        {"none": {}, **values("tethers_slack", 1.2, 1.05, 1.01)},
        "drape15",
        150,
        {**HUNG, "substeps": 1, "iterations": 2},
        view="strain",
    ),
    Strip(
        "friction",
        "`friction` of a bar that tilts, after four seconds",
        values("capsule_friction", 0.0, 0.2, 0.5, 1.0),
        "slope",
        240,
        {"camera_eye": (2.9, 1.7, 2.2), "camera_target": (0.0, 0.8, 0.3)},
    ),
    Strip(
        "self_collision",
        "`[self_collision] thickness`: what is left of a sheet that fell on its edge",
        {
            "next to nothing": {"self_collision_thickness": 1e-4},
            **values("self_collision_thickness", 0.025, 0.05, unit="m"),
        },
        "fold",
        60,
        {"camera_eye": (0.9, 0.75, 1.2), "camera_target": (0.0, 0.12, 0.0)},
    ),
    Strip(
        "swept",
        "`swept` of a ball that moves 0.4 m in a frame",
        values("sphere_swept", False, True),
        "fast-ball",
        57,
        {"camera_eye": (2.6, 1.6, 2.3), "camera_target": (0.0, 1.25, 0.0)},
    ),
)


def panel(strip: Strip, overrides: dict[str, Any], width: int) -> np.ndarray:
    with tc.Simulation(tc.load_scene(strip.scene, **{**strip.common, **overrides})) as simulation:
        for _ in range(strip.frame):
            simulation.advance_frame()
        return tc.picture(simulation, width, HEIGHT, strip.view).pixels


def draw(strip: Strip) -> None:
    columns = strip.columns or len(strip.panels)
    width = (WIDTH - GAP * (columns + 1)) // columns
    panels = [panel(strip, overrides, width) for overrides in strip.panels.values()]
    write(FOLDER / f"{strip.name}.png", contact_sheet(panels, columns, gap=GAP))


def write(path: Path, pixels: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    few = Image.fromarray(pixels).quantize(256, kmeans=3, dither=Image.Dither.NONE)  # a palette takes half the bytes
    few.save(path, optimize=True)
    print(f"{path.parent.name}/{path.name}, {path.stat().st_size / 1e3:.0f} kB", flush=True)


def main(names: list[str]) -> None:
    for strip in STRIPS:
        if not names or strip.name in names:
            draw(strip)


if __name__ == "__main__":
    main(sys.argv[1:])
