"""Two sessions under one hand, without a display."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from taichi_cloth.scene import load_scene
from taichi_cloth.view.pair import Pair

pytestmark = pytest.mark.usefixtures("on_lists")

SIZE = (1200, 500)
ASPECT = SIZE[0] / 2 / SIZE[1]
SMALL = {"rows": 10, "columns": 11}


@pytest.fixture
def pair(tmp_path: Path) -> Iterator[Pair]:
    pair = Pair(load_scene("drape15", **SMALL), load_scene("drape15", iterations=40, **SMALL), ASPECT, tmp_path)
    yield pair
    pair.close()


def point(pair: Pair, at: tuple[float, float], *held: str) -> None:
    pair.point(at, frozenset(held), SIZE, on_panel=False, widget_changed=False)


def on_particle(pair: Pair, side: int, particle: int) -> tuple[float, float]:
    """Where a particle is on the screen of both."""
    place = pair.sides[side].simulation.positions()[particle]
    u, v = pair.left.camera.to_screen(place, ASPECT)[0][0]
    return (float(u) + side) / 2, float(v)


@pytest.mark.parametrize("side", [0, 1])
def test_what_is_held_on_one_side_is_held_on_the_other(pair: Pair, side: int) -> None:
    here, there = (pair.sides[k].simulation for k in (side, 1 - side))
    start = on_particle(pair, side, 60)
    point(pair, start)
    point(pair, start, "left")
    assert here.grabbed == there.grabbed == 60
    point(pair, (start[0] + 0.03, start[1] + 0.1), "left")
    pair.advance(2)
    assert on_particle(pair, side, 60) == pytest.approx((start[0] + 0.03, start[1] + 0.1), abs=5e-3)
    np.testing.assert_allclose(there.positions()[60], here.positions()[60], atol=1e-6)
    point(pair, (1.0 - side, 0.5), "left")  # the drag goes on beyond the seam
    assert here.grabbed == 60
    point(pair, (1.0 - side, 0.5))
    assert (here.grabbed, there.grabbed) == (None, None)


def test_both_do_what_is_done_and_only_one_changes_its_method(pair: Pair) -> None:
    pair.advance(3)
    assert [side.simulation.frame for side in pair.sides] == [3, 3]
    assert pair.apart > 0  # 5 iterations and 40
    pair.act("freeze")
    pair.advance(3)
    pair.act("step")
    assert [side.simulation.frame for side in pair.sides] == [4, 4]
    pair.set("gravity", 3.0)
    assert [side.simulation.get("gravity") for side in pair.sides] == [3.0, 3.0]
    point(pair, (0.9, 0.9))
    pair.act("solver")
    assert pair.left.simulation.solver.name == "verlet"
    assert pair.right.simulation.solver.name != "verlet"
    pair.act("next_scene")  # of one scene only: nothing happens
    pair.act("reset")
    assert [(side.simulation.frame, side.simulation.scene.name) for side in pair.sides] == [(0, "drape15")] * 2
    assert pair.apart < 1e-6
    assert pair.left.camera is pair.right.camera


def test_a_blow_up_on_one_side_freezes_both(pair: Pair) -> None:
    pair.advance(1)
    pair.right.simulation.cloth.x[0] = (np.nan, 0.0, 0.0)
    pair.advance(1)
    assert pair.left.frozen
    assert pair.right.frozen
    assert "blew up" in pair.note


def test_other_grids_are_held_at_the_same_place_of_the_sheet(tmp_path: Path) -> None:
    pair = Pair(load_scene("drape15", **SMALL), load_scene("drape15", rows=19, columns=21), ASPECT, tmp_path)
    start = on_particle(pair, 0, 60)
    point(pair, start)
    point(pair, start, "left")
    row, column = divmod(60, 11)
    assert pair.right.simulation.grabbed == 2 * row * 21 + 2 * column
    pair.close()
