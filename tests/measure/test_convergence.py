"""What the first lines of a run tell of iterations that end too early."""

import numpy as np
import pytest

from taichi_cloth.measure.convergence import MOST_SEEN, every, rows_below, unfinished
from taichi_cloth.mesh.from_scene import topology_of
from taichi_cloth.scene.model import FRAME_SECONDS, Cloth, Fabric, Forces, Scene, Solver, Springs


def line(solver: str, cells: int, substeps: int, iterations: int, **cloth: object) -> str:
    """Of one square metre of threads, pinned along its top."""
    scene = Scene(
        cloth=Cloth(rows=cells + 1, columns=cells + 1, width=1.0, height=1.0, lumping="equal", **cloth),  # type: ignore[arg-type]
        springs=Springs(shear=0.0, bend=0.0),
        fabric=Fabric(warp=1000.0, weft=1000.0, shear=0.0, bend=0.0),
        solver=Solver(solver, substeps, iterations),
    )
    return unfinished(scene, topology_of(scene, "fabric"), FRAME_SECONDS / substeps, iterations)


def test_relaxation_tells_the_stretch_that_it_leaves() -> None:
    """64 rows at 10×1: 5.6 % of a metre, ½·64²·9.81/600²."""
    assert line("verlet", 64, 10, 1) == "unfinished: stretches 5.6 % beyond its constants"
    assert line("verlet", 32, 60, 8) == ""


def test_xpbd_tells_the_share_of_its_elongation() -> None:
    """32 rows at 30×1: 1.58 of it, kh²/m; the usual 60×4 leaves 0.2 %, and 14 % of 64 rows."""
    assert line("xpbd", 32, 30, 1) == "unfinished: its elongation is 158 % more than its constants say"
    assert line("xpbd", 32, 60, 4) == ""
    assert line("xpbd", 64, 60, 4) == "unfinished: its elongation is 14 % more than its constants say"


def test_nothing_is_told_without_pins_and_of_methods_that_finish() -> None:
    assert line("xpbd", 32, 1, 1, pins=()) == ""
    assert [line(solver, 32, 1, 1) for solver in ("lines", "spring", "rk4")] == ["", "", ""]
    scene = Scene(forces=Forces(gravity=0.0), solver=Solver("xpbd", 1, 1))
    assert unfinished(scene, topology_of(scene, "fabric"), FRAME_SECONDS, 1) == ""


@pytest.mark.parametrize(("pins", "rows"), [(("top",), 20), (("top", "bottom"), 10), (("left",), 20)])
def test_rows_are_counted_from_the_nearest_pin(pins: tuple[str, ...], rows: int) -> None:
    scene = Scene(cloth=Cloth(rows=21, columns=21, width=1.0, height=1.0, pins=pins))
    assert rows_below(topology_of(scene, "fabric")) == rows


def test_of_many_points_some_are_looked_at() -> None:
    points = np.arange(30_000.0).reshape(-1, 3)
    seen = every(points)
    assert len(seen) == MOST_SEEN
    assert (seen[[0, -1]] == points[[0, -1]]).all()
    assert (every(points[:10]) == points[:10]).all()
