"""Counts, lengths, masses and colours of a sheet. No Taichi."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taichi_cloth.mesh import grid
from taichi_cloth.mesh.from_scene import topology_of
from taichi_cloth.mesh.topology import Topology, lumped_mass, sheet
from taichi_cloth.scene.model import CORNERS, Cloth, Scene

ALL = (True,) * 6


def make(rows: int = 5, columns: int = 7, **changes: object) -> Topology:
    arguments = {
        "rows": rows,
        "columns": columns,
        "width": (columns - 1) * 0.5,
        "height": (rows - 1) * 0.5,
        "center": (0.0, 0.0, 0.0),
        "rotation": (0.0, 0.0, 0.0),
        "area_density": 0.2,
        "pins": (),
        "directions": ALL,
    }
    return sheet(**{**arguments, **changes})


sides = st.integers(2, 9)


@given(sides, sides)
def test_family_counts(r: int, c: int) -> None:
    counts = make(r, c).family_counts
    assert counts["structural"] == r * (c - 1) + c * (r - 1)
    assert counts["shear"] == 2 * (r - 1) * (c - 1)
    assert counts.get("bend", 0) == r * (c - 2) + c * (r - 2)


def test_a_family_of_no_stiffness_is_left_out() -> None:
    topology = make(directions=(True, True, False, False, False, False))
    assert list(topology.family_counts) == ["structural"]
    assert len(topology.family("shear")) == 0


@given(sides, sides)
def test_springs_are_the_right_ones_each_once(r: int, c: int) -> None:
    topology = make(r, c)
    place = np.stack(np.unravel_index(topology.ends, (r, c)), axis=-1)
    step = np.sort(np.abs(place[:, 1] - place[:, 0]), axis=1)
    for family, allowed in (("structural", {(0, 1)}), ("shear", {(1, 1)}), ("bend", {(0, 2)})):
        assert {tuple(s) for s in step[topology.family(family)]} <= allowed
    assert len({frozenset(pair) for pair in topology.ends.tolist()}) == topology.spring_count


@given(sides, sides)
def test_no_two_springs_of_a_batch_share_a_particle(r: int, c: int) -> None:
    topology = make(r, c)
    for batch in topology.batches:
        ends = topology.ends[batch.first : batch.first + batch.count]
        assert len(np.unique(ends)) == ends.size
    assert sum(batch.count for batch in topology.batches) == topology.spring_count


def test_rest_lengths_are_those_of_the_grid_but_for_float32() -> None:
    level, turned = make(), make(rotation=(-90.0, 30.0, 7.0), center=(1.0, 1.0, 2.0))
    assert turned.rest == pytest.approx(level.rest, rel=1e-6)
    assert level.rest[level.family("structural")] == pytest.approx(0.5)
    assert level.rest[level.family("shear")] == pytest.approx(0.5 * np.sqrt(2))
    assert level.rest[level.family("bend")] == pytest.approx(1.0)


def test_the_start_is_at_rest_to_the_last_bit_of_float32() -> None:
    topology = make(rotation=(20.0, 30.0, 7.0), center=(3.0, 1.0, 2.0))
    assert (topology.start.astype(np.float32) == topology.start).all()
    lengths = np.linalg.norm(topology.start[topology.ends[:, 0]] - topology.start[topology.ends[:, 1]], axis=1)
    assert topology.rest == pytest.approx(lengths, rel=2e-7)
    assert (topology.rest.astype(np.float32) == topology.rest).all()  # as kernels find it: tests/solvers


def test_a_quarter_turn_is_exact() -> None:
    topology = make(rotation=(-90.0, 0.0, 0.0), center=(0.0, 3.0, 0.0))
    assert (topology.start[:, 1] == 3.0).all()
    assert topology.start[0].tolist() == [-1.5, 3.0, -1.0]  # the top edge lies at the far side


def test_the_sheet_stands_where_it_is_put() -> None:
    topology = make(center=(1.0, 2.0, 3.0))
    assert topology.start[0].tolist() == [-0.5, 3.0, 3.0]  # top left
    assert topology.start[-1].tolist() == [2.5, 1.0, 3.0]  # bottom right


def test_mass_is_area_times_density_and_least_at_corners() -> None:
    topology = make()
    assert topology.mass.sum() == pytest.approx(0.2 * 3.0 * 2.0)
    inner = 0.2 * 0.25
    assert topology.mass[8] == pytest.approx(inner * (4 / 6 if 8 % 2 else 8 / 6), rel=0.5)
    assert topology.mass.min() >= inner / 6 * 0.999


@pytest.mark.parametrize("lumping", ["area", "equal"])
def test_a_weight_is_sewn_to_each_corner(lumping: str) -> None:
    more = make(3, 4, weight=0.5, lumping=lumping).mass - make(3, 4, lumping=lumping).mass
    assert np.flatnonzero(more).tolist() == [0, 3, 8, 11]
    assert more[[0, 3, 8, 11]] == pytest.approx(0.5)


@pytest.mark.parametrize(("corner", "particle"), list(zip(CORNERS, (0, 3, 8, 11), strict=True)))
def test_a_weight_is_sewn_to_one_corner(corner: str, particle: int) -> None:
    more = make(3, 4, weight=0.5, weight_at=corner).mass - make(3, 4).mass
    assert np.flatnonzero(more).tolist() == [particle]
    assert more[particle] == pytest.approx(0.5)


def test_a_scene_says_which_corner_carries_the_weight() -> None:
    scene = Scene(cloth=Cloth(rows=3, columns=4, weight=5.0, weight_at="bottom-right"))
    assert topology_of(scene, "fabric").mass.argmax() == 11


def test_one_triangle_gives_each_corner_a_third() -> None:
    corners = np.array([[0, 0, 0], [2, 0, 0], [0, 3, 0]], float)
    assert lumped_mass(corners, np.array([[0, 1, 2]], np.int32), 0.5).tolist() == pytest.approx([0.5, 0.5, 0.5])


def test_triangles_cover_the_sheet_once_and_face_one_way() -> None:
    topology = make()
    a, b, c = (topology.start[topology.triangles[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a) / 2
    assert np.allclose(normal, [0, 0, 0.125])
    assert topology.triangle_count == 2 * 4 * 6
    assert topology.cells.max(axis=0).tolist() == [3, 5]


@pytest.mark.parametrize(
    ("pins", "held"),
    [
        (("top",), [0, 1, 2]),
        (("bottom",), [6, 7, 8]),
        (("left",), [0, 3, 6]),
        (("right",), [2, 5, 8]),
        (("top-left", "bottom-right"), [0, 8]),
        (("top-right", "bottom-left", 4, 4), [2, 4, 6]),
        ((), []),
    ],
)
def test_pins(pins: tuple, held: list) -> None:
    assert np.flatnonzero(grid.pinned(3, 3, pins)).tolist() == held


@pytest.mark.parametrize("pin", [9, -1, "middle"])
def test_a_pin_that_is_no_particle_is_refused(pin: object) -> None:
    with pytest.raises(ValueError, match=str(pin)):
        grid.pinned(3, 3, [pin])
