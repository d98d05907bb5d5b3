"""Write docs/pictures/parameters: for one scene key an image with a row of panels, one panel per value.

`make screenshots` runs it; `python screenshots/parameters.py wind damping` draws only these strips.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from math import radians
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

import taichi_cloth as tc
from taichi_cloth.render.image_files import contact_sheet
from taichi_cloth.scene.fabric_schema import PRESET_NAMES
from taichi_cloth.scene.solver_catalog import SOLVER_CATALOG

FOLDER = Path(__file__).parents[1] / "docs" / "pictures" / "parameters"
WIDTH = 1200  # [pixels] of a strip
HEIGHT = 270  # [pixels] of a panel
GAP = 4  # [pixels] between panels


@dataclass(frozen=True)
class Strip:
    """A key at several values, or a few keys that change together."""

    name: str
    says: str
    """What the panels show, in Markdown, without a period at the end."""
    panels: dict[str, dict[str, Any]]
    """Overrides of the scene for each panel, by its caption."""
    scene: str
    frame: int
    """Frame that the panels show."""
    common: dict[str, Any] = field(default_factory=dict)
    """Overrides of all panels."""
    view: str = "shaded"
    columns: int = 0
    """Panels per row; 0 puts all in one row."""


def values(key: str, *numbers: Any, unit: str = "") -> dict[str, dict[str, Any]]:
    """Return a panel for each value of one key."""
    return {f"{number}{' ' + unit if unit else ''}": {key: number} for number in numbers}


def with_defaults(name: str) -> dict[str, Any]:
    """Return the overrides for a solver with its default substeps and iterations."""
    return dict(zip(("solver", "substeps", "iterations"), (name, *SOLVER_CATALOG[name].defaults), strict=True))


# A sheet of 25 × 25 particles that hangs by two corners; at the start it leans forward.
HANGING: dict[str, Any] = {
    "rows": 25,
    "columns": 25,
    "wind_x": 0.0,
    "wind_z": 0.0,
    "camera_eye": (1.6, 1.5, 3.6),
    "camera_target": (0.0, 1.25, -0.2),
}
FROM_THE_SIDE = {"camera_eye": (4.2, 1.5, 1.2), "camera_target": (0.0, 1.35, 0.3)}
TABLE: dict[str, Any] = {"camera_eye": (1.2, 1.25, 1.7), "camera_target": (0.0, 0.55, 0.0)}
EXPLICIT: dict[str, Any] = {**TABLE, "solver": "explicit", "rows": 31, "columns": 31}

COTTON = "royal-target"


def straight_curves(preset: str) -> dict[str, Any]:
    """Return the overrides for a weave whose curves are straight, with the constants of a measured fabric."""
    fabric = tc.load_scene("table", preset=preset, model="membrane").fabric
    return {
        "model": "weave",
        "weave_warp": [[0.1, 0.1 * fabric.c11]],  # strain, tension [N/m]
        "weave_weft": [[0.1, 0.1 * fabric.c22]],
        "weave_shear": [[10.0, radians(10.0) * fabric.c66]],  # angle [degrees], moment per area [N/m]
    }


MODELS = {name: {"model": name} for name in ("springs", "membrane")} | {"weave": straight_curves(COTTON)}

STRIPS = (
    Strip(
        "iterations",
        "`[solver] iterations` of `verlet`, with one substep per frame. Red springs are stretched by 10 % or more",
        values("iterations", 2, 5, 12, 40),
        "drape15",
        150,
        {**HANGING, "substeps": 1},
        view="strain",
    ),
    Strip(
        "substeps",
        "`[solver] substeps` of `verlet`, with five iterations per substep",
        values("substeps", 1, 2, 5, 20),
        "drape15",
        150,
        {**HANGING, "iterations": 5},
        view="strain",
    ),
    Strip(
        "grid",
        "`[cloth] rows` and `columns`, `verlet` 5×12. A finer grid is softer, unless the iterations grow too",
        {f"{n} × {n}": {"rows": n, "columns": n} for n in (15, 30, 60, 120)},
        "drape15",
        150,
        {**HANGING, "substeps": 5, "iterations": 12},
        view="strain",
    ),
    Strip(
        "stiffness",
        "`[solver] stiffness`, which multiplies the stiffness values of `[verlet]`; `verlet` 1×12",
        values("solver_stiffness", 0.1, 0.2, 0.5, 1.0),
        "drape15",
        150,
        {**HANGING, "substeps": 1, "iterations": 12},
        view="strain",
    ),
    Strip(
        "solver",
        "`[solver] name`: denim of 41 × 41 particles, each solver with its default substeps and iterations",
        {name: with_defaults(name) for name in SOLVER_CATALOG},
        "drape15",
        90,
        {**HANGING, "rows": 41, "columns": 41, "preset": "denim"},
        view="strain",
        columns=3,
    ),
    Strip(
        "diagonals",
        "shear springs: none, one diagonal per cell, two of half the stiffness. One or two makes little difference",
        {
            "none": {"fabric_shear": 0.0},
            "one": {"diagonals": 1, "fabric_shear": 2000.0},
            "two": {"diagonals": 2, "fabric_shear": 1000.0},
        },
        "drape15",
        150,
        {**HANGING, "solver": "explicit"},
    ),
    Strip(
        "bend",
        "`[verlet] bend`, the stiffness of springs between particles two apart",
        values("verlet_bend", 0.0, 0.02, 0.2, 1.0),
        "table",
        120,
        TABLE,
    ),
    Strip(
        "bending",
        "`[fabric] bending_stiffness`, with `explicit`",
        {f"{value} N·m": {"bending_stiffness": float(value)} for value in ("0", "1e-4", "1e-3", "1e-2")},
        "table",
        120,
        {**EXPLICIT, "warp": 500.0, "weft": 500.0, "fabric_shear": 50.0, "bend_spring": 0.0},
    ),
    Strip(
        "fabric",
        "`[fabric] preset`, with `explicit`",
        values("preset", *PRESET_NAMES[:6]),
        "table",
        200,
        EXPLICIT,
        columns=3,
    ),
    Strip(
        "measured_fabric",
        "`[fabric] preset`: the ten measured fabrics as membranes, with `explicit`",
        values("preset", *PRESET_NAMES[6:]),
        "table",
        200,
        {**EXPLICIT, "model": "membrane"},
        columns=5,
    ),
    Strip(
        "model",
        "`[fabric] model`: the same measured fabric, a cotton with polyester, as springs, as a membrane, and as a weave"
        " with straight curves of its constants; `explicit`",
        MODELS,
        "sphere",
        150,
        {"solver": "explicit", "preset": COTTON, "camera_eye": (0.75, 1.15, 1.4), "camera_target": (0.0, 0.72, 0.0)},
    ),
    Strip(
        "wind",
        "`[wind] z`, seen from the side: the wind blows from the left",
        values("wind_z", 0.0, 1.0, 2.0, 4.0, unit="m/s"),
        "drape15",
        180,
        {**HANGING, **FROM_THE_SIDE, "pins": ["top"], "substeps": 5, "iterations": 12, "turbulence": 0.3},
    ),
    Strip(
        "damping",
        "`[solver] damping`, 0.8 s after the release of the sheet",
        values("damping", 0.0, 1.5, 5.0, 20.0, unit="1/s"),
        "drape15",
        48,
        {**HANGING, **FROM_THE_SIDE, "substeps": 5, "iterations": 12},
    ),
    Strip(
        "strain_limit",
        "`[strain_limit] strain`: weak springs, and a sphere that presses into the cloth",
        {"none": {"strain_limit_strain": 10.0}, **values("strain_limit_strain", 0.3, 0.1, 0.02)},
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
        {**HANGING, "substeps": 1, "iterations": 2},
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
        "`[self_collision] thickness`: a sheet that fell on its edge",
        {
            "0.0001 m": {"self_collision_thickness": 1e-4},
            **values("self_collision_thickness", 0.025, 0.05, unit="m"),
        },
        "fold",
        60,
        {"camera_eye": (0.9, 0.75, 1.2), "camera_target": (0.0, 0.12, 0.0)},
    ),
    Strip(
        "continuous",
        "`continuous` of a sphere that moves 0.4 m per frame",
        values("sphere_continuous", False, True),
        "fast-ball",
        57,
        {"camera_eye": (2.6, 1.6, 2.3), "camera_target": (0.0, 1.25, 0.0)},
    ),
)


def panel(strip: Strip, overrides: dict[str, Any], width: int) -> np.ndarray:
    with tc.Simulation(tc.load_scene(strip.scene, **{**strip.common, **overrides})) as simulation:
        simulation.step(strip.frame)
        return tc.render_image(simulation, (width, HEIGHT), strip.view).pixels


def draw(strip: Strip) -> None:
    columns = strip.columns or len(strip.panels)
    width = (WIDTH - GAP * (columns + 1)) // columns
    panels = [panel(strip, overrides, width) for overrides in strip.panels.values()]
    write(FOLDER / f"{strip.name}.png", contact_sheet(panels, columns, gap=GAP))


def write(path: Path, pixels: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    indexed = Image.fromarray(pixels).quantize(256, kmeans=3, dither=Image.Dither.NONE)  # half the file size
    indexed.save(path, optimize=True)
    print(f"{path.parent.name}/{path.name}, {path.stat().st_size / 1e3:.0f} kB", flush=True)


def main(names: list[str]) -> None:
    for strip in STRIPS:
        if not names or strip.name in names:
            draw(strip)


if __name__ == "__main__":
    main(sys.argv[1:])
