"""Counts, lengths, masses and colors of a sheet. No Taichi."""

import re
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taichi_cloth.geometry import grid
from taichi_cloth.geometry.cloth_builder import build_topology, spring_stiffness
from taichi_cloth.geometry.topology import Topology, build_sheet, lumped_mass
from taichi_cloth.scene.fabric_schema import Fabric
from taichi_cloth.scene.keys import CORNERS
from taichi_cloth.scene.schema import Cloth, Scene

ALL = (True,) * 6


def make(rows: int = 5, columns: int = 7, **changes: Any) -> Topology:
    arguments: dict[str, Any] = {
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
    return build_sheet(**{**arguments, **changes})


sides = st.integers(2, 9)


@given(sides, sides)
def test_family_counts(r: int, c: int) -> None:
    counts = make(r, c).family_counts
    assert counts["structural"] == r * (c - 1) + c * (r - 1)
    assert counts["shear"] == 2 * (r - 1) * (c - 1)
    assert counts.get("bend", 0) == r * (c - 2) + c * (r - 2)


def test_unused_families_are_left_out() -> None:
    topology = make(directions=(True, True, False, False, False, False))
    assert list(topology.family_counts) == ["structural"]
    assert len(topology.family("shear")) == 0


@given(sides, sides)
def test_every_spring_exists_once(r: int, c: int) -> None:
    topology = make(r, c)
    cell = np.stack(np.unravel_index(topology.ends, (r, c)), axis=-1)
    step = np.sort(np.abs(cell[:, 1] - cell[:, 0]), axis=1)
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


def test_rest_lengths_are_those_of_the_grid_up_to_float32() -> None:
    level, rotated = make(), make(rotation=(-90.0, 30.0, 7.0), center=(1.0, 1.0, 2.0))
    assert rotated.rest == pytest.approx(level.rest, rel=1e-6)
    assert level.rest[level.family("structural")] == pytest.approx(0.5)
    assert level.rest[level.family("shear")] == pytest.approx(0.5 * np.sqrt(2))
    assert level.rest[level.family("bend")] == pytest.approx(1.0)


def test_the_start_is_at_rest_to_the_last_bit_of_float32() -> None:
    topology = make(rotation=(20.0, 30.0, 7.0), center=(3.0, 1.0, 2.0))
    start = topology.start - topology.origin
    assert (start.astype(np.float32) == start).all()
    lengths = np.linalg.norm(start[topology.ends[:, 0]] - start[topology.ends[:, 1]], axis=1)
    assert topology.rest == pytest.approx(lengths, rel=2e-7)
    assert (topology.rest.astype(np.float32) == topology.rest).all()  # kernels compute the same lengths: tests/solvers


def test_a_rotation_by_90_degrees_is_exact() -> None:
    topology = make(rotation=(-90.0, 0.0, 0.0), center=(0.0, 3.0, 0.0))
    assert (topology.start[:, 1] == 3.0).all()
    assert topology.start[0].tolist() == [-1.5, 3.0, -1.0]  # the top edge lies at the far side


def test_the_sheet_is_at_its_center() -> None:
    topology = make(center=(1.0, 2.0, 3.0))
    assert topology.start[0].tolist() == [-0.5, 3.0, 3.0]  # top left
    assert topology.start[-1].tolist() == [2.5, 1.0, 3.0]  # bottom right


def test_mass_is_area_times_density_and_smallest_at_corners() -> None:
    topology = make()
    assert topology.mass.sum() == pytest.approx(0.2 * 3.0 * 2.0)
    inner = 0.2 * 0.25
    assert topology.mass[8] == pytest.approx(inner * (4 / 6 if 8 % 2 else 8 / 6), rel=0.5)
    assert topology.mass.min() >= inner / 6 * 0.999


@pytest.mark.parametrize("mass_lumping", ["area", "uniform"])
def test_a_corner_mass_is_added_to_each_corner(mass_lumping: str) -> None:
    more = make(3, 4, corner_mass=0.5, mass_lumping=mass_lumping).mass - make(3, 4, mass_lumping=mass_lumping).mass
    assert np.flatnonzero(more).tolist() == [0, 3, 8, 11]
    assert more[[0, 3, 8, 11]] == pytest.approx(0.5)


@pytest.mark.parametrize(("corner", "particle"), list(zip(CORNERS, (0, 3, 8, 11), strict=True)))
def test_a_corner_mass_may_be_added_to_one_corner(corner: str, particle: int) -> None:
    more = make(3, 4, corner_mass=0.5, corner_mass_at=corner).mass - make(3, 4).mass
    assert np.flatnonzero(more).tolist() == [particle]
    assert more[particle] == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("key", "value", "reason"),
    [
        ("mass_lumping", "uniforms", "'uniforms' is not one of: area, uniform (did you mean 'uniform'?)"),
        ("mass_lumping", 1, "must be a string, got 1"),
        ("corner_mass", -0.5, "-0.5 is out of range: 0 to 1000 kg"),
        ("corner_mass", float("nan"), "must be a finite number, got nan"),
        (
            "corner_mass_at",
            "top",
            "'top' is not one of: corners, top-left, top-right, bottom-left, bottom-right",
        ),
    ],
)
def test_mass_values_that_a_scene_does_not_allow_are_errors(key: str, value: object, reason: str) -> None:
    with pytest.raises(ValueError, match=f"^{key}: {re.escape(reason)}"):
        make(3, 4, **{key: value})


def test_a_scene_sets_the_corner_with_the_mass() -> None:
    scene = Scene(cloth=Cloth(rows=3, columns=4, corner_mass=5.0, corner_mass_at="bottom-right"))
    assert build_topology(scene, "fabric").mass.argmax() == 11


def test_each_corner_gets_a_third_of_the_mass_of_a_triangle() -> None:
    corners = np.array([[0, 0, 0], [2, 0, 0], [0, 3, 0]], float)
    assert lumped_mass(corners, np.array([[0, 1, 2]], np.int32), 0.5).tolist() == pytest.approx([0.5, 0.5, 0.5])


def test_triangles_cover_the_sheet_once_with_the_same_orientation() -> None:
    topology = make()
    a, b, c = (topology.start[topology.triangles[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a) / 2
    assert np.allclose(normal, [0, 0, 0.125])
    assert topology.triangle_count == 2 * 4 * 6
    assert topology.cells.max(axis=0).tolist() == [3, 5]


@pytest.mark.parametrize(
    ("pins", "pinned_particles"),
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
def test_pins(pins: tuple[str | int, ...], pinned_particles: list[int]) -> None:
    assert np.flatnonzero(grid.pinned_mask(3, 3, pins)).tolist() == pinned_particles


@pytest.mark.parametrize("pin", [9, -1, "middle"])
def test_an_invalid_pin_is_refused(pin: str | int) -> None:
    with pytest.raises(ValueError, match=str(pin)):
        grid.pinned_mask(3, 3, [pin])


def tensor(topology: Topology, stiffness: Any) -> Any:
    """Return the tensor C of a sheet in its plane, by Hooke's law of springs in uniform strain [N/m], (3, 3)."""
    along = np.diff(topology.flat[topology.ends], axis=1)[:, 0, :2]
    strains = np.stack([along[:, 0] ** 2, along[:, 1] ** 2, along[:, 0] * along[:, 1]])  # times rest², (3, E)
    area = np.prod(np.ptp(topology.flat[:, :2], axis=0))
    return strains * (stiffness / topology.rest**2) @ strains.T / area


def sheet_of(columns: int, fabric: Fabric, **cloth: Any) -> tuple[Scene, Topology, Any]:
    """Return a sheet of seven rows with cells of 0.1 m by 0.6 m / (columns − 1), and the stiffness of its springs."""
    given = {"pins": (), "rotation": (0.0, 0.0, 0.0), **cloth}
    scene = Scene(cloth=Cloth(rows=7, columns=columns, width=0.6, height=0.6, **given), fabric=fabric)
    topology = build_topology(scene, "fabric")
    return scene, topology, spring_stiffness(scene, "fabric", topology)


@pytest.mark.parametrize("diagonals", [1, 2])
@pytest.mark.parametrize(("columns", "aspect"), [(7, 1.0), (10, 1.5), (13, 2.0), (4, 0.5), (11, 5 / 3)])
def test_a_fabric_is_the_same_on_all_cells(columns: int, aspect: float, diagonals: int) -> None:
    """Along the weft, x, C is weft + shear, along the warp warp + shear; C12 = C66 = shear, half with one diagonal."""
    fabric = Fabric(weft=2000.0, warp=1800.0, shear=500.0, bend_spring=0.0)
    _, topology, stiffness = sheet_of(columns, fabric, diagonals=diagonals)
    shear = 250.0 * diagonals
    expected = [[2000.0 + shear, shear, 0.0], [shear, 1800.0 + shear, 0.0], [0.0, 0.0, shear]]
    assert (columns - 1) / 6 == pytest.approx(aspect)
    found = tensor(topology, stiffness)
    assert found[:2, :2] == pytest.approx(np.array(expected)[:2, :2], abs=1e-3)
    assert found[2, 2] == pytest.approx(shear, abs=1e-3)


@pytest.mark.parametrize(("columns", "weft", "warp"), [(13, 0.0, 2000.0), (4, 2000.0, 0.0)])
def test_shear_alone_has_the_springs_that_cells_need(columns: int, weft: float, warp: float) -> None:
    """The short sides of cells; the springs beside the long ones would push, and the fabric has none there."""
    _, topology, stiffness = sheet_of(columns, Fabric(weft=weft, warp=warp, shear=400.0, bend_spring=0.0))
    expected = [[weft + 400.0, 400.0, 0.0], [400.0, warp + 400.0, 0.0], [0.0, 0.0, 400.0]]
    assert tensor(topology, stiffness) == pytest.approx(np.array(expected), abs=1e-3)


def test_square_cells_without_a_yarn_have_no_springs_of_it() -> None:
    _, topology, _ = sheet_of(7, Fabric(weft=0.0, warp=2000.0, shear=400.0, bend_spring=0.0))
    assert topology.family_counts["structural"] == 6 * 7


@pytest.mark.parametrize("diagonals", [1, 2])
@pytest.mark.parametrize("columns", [3, 4, 19])
def test_long_cells_have_no_free_motion_in_their_plane(columns: int, diagonals: int) -> None:
    """Diagonals alone connect only particles of even row + column, and of odd: they would slide along each other."""
    fabric = Fabric(weft=600.0, warp=600.0, shear=600.0, bend_spring=0.0)
    _, topology, stiffness = sheet_of(columns, fabric, pins=("top-left", "top-right"), diagonals=diagonals)
    matrix = np.zeros((topology.particle_count, 2) * 2)
    for (i, j), k in zip(topology.ends, stiffness, strict=True):
        n = (topology.flat[j] - topology.flat[i])[:2]
        block = k * np.outer(n, n) / (n @ n)
        matrix[i, :, i] += block
        matrix[j, :, j] += block
        matrix[i, :, j] -= block
        matrix[j, :, i] -= block
    free = ~topology.pinned
    stiffest, softest = (np.linalg.eigvalsh(matrix[free][:, :, free].reshape(2 * free.sum(), -1))[k] for k in (-1, 0))
    assert softest > 1e-4 * stiffest


def test_the_springs_of_long_cells_keep_a_tenth_of_their_yarn() -> None:
    """Diagonals alone have shear/a² = 2400 N/m along the weft, of 1200 N/m."""
    _, topology, stiffness = sheet_of(4, Fabric(weft=600.0, warp=600.0, shear=600.0, bend_spring=0.0))
    expected = [[2460.0, 600.0, 0.0], [600.0, 1200.0, 0.0], [0.0, 0.0, 600.0]]
    assert tensor(topology, stiffness) == pytest.approx(np.array(expected), abs=1e-3)


@pytest.mark.parametrize("columns", [4, 13])
def test_equal_masses_leave_the_shear_of_all_cells_as_it_is(columns: int) -> None:
    """With `mass_lumping = "uniform"` a spring along an edge of the sheet is like those inside: half a cell more."""
    fabric = Fabric(weft=2000.0, warp=1500.0, shear=400.0, bend_spring=0.0)
    _, topology, stiffness = sheet_of(columns, fabric, mass_lumping="uniform")
    expected = [[400.0 + 2000.0 * 7 / 6, 400.0], [400.0, 400.0 + 1500.0 * columns / (columns - 1)]]
    assert tensor(topology, stiffness)[:2, :2] == pytest.approx(np.array(expected), abs=1e-3)
