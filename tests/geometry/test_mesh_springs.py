"""Springs, bending links and masses of mesh files, compared with those of grids, membranes and plates."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sparse
from meshes import Mesh, irregular, quads, write_obj
from scipy.sparse.linalg import spsolve

from taichi_cloth.geometry.bending import Surface, triangle_bending
from taichi_cloth.geometry.cloth_builder import build_topology, spring_stiffness
from taichi_cloth.geometry.topology import Topology, greedy_coloring
from taichi_cloth.scene.fabric_schema import Fabric
from taichi_cloth.scene.schema import Cloth, Scene

PLAIN = Fabric(warp=2000.0, weft=2000.0, shear=1000.0, bend_spring=0.0)  # isotropic
BENDING = 0.5  # [N·m]


def scene_of(path: Path, fabric: Fabric = PLAIN, **cloth: Any) -> Scene:
    return Scene(
        cloth=Cloth(file=path.name, folder=str(path.parent), center=(0, 0, 0), pins=(), **cloth), fabric=fabric
    )


def made(folder: Path, mesh: Mesh, fabric: Fabric = PLAIN) -> tuple[Topology, np.ndarray]:
    scene = scene_of(write_obj(folder / "mesh.obj", *mesh), fabric)
    topology = build_topology(scene, "fabric")
    return topology, spring_stiffness(scene, "fabric", topology)


def by_pair(ends: np.ndarray, *values: np.ndarray) -> dict[tuple[int, int], tuple[float, ...]]:
    return {(min(pair), max(pair)): row for pair, row in zip(ends.tolist(), zip(*values, strict=True), strict=True)}


@pytest.mark.parametrize("section", ["verlet", "fabric"])
@pytest.mark.parametrize("diagonals", [1, 2])
def test_a_mesh_of_quads_has_the_springs_and_bending_links_of_the_grid(
    tmp_path: Path, section: str, diagonals: int
) -> None:
    fabric = Fabric(300.0, 500.0, 100.0, bend_spring=2.0, bending_stiffness=1e-3, bending_weft=2e-3)
    path = write_obj(tmp_path / "grid.obj", *quads(5, 7, 1.2, 0.6))
    placed: dict[str, Any] = {
        "center": (0.0, 2.0, 0.0),
        "rotation": (-40.0, 10.0, 0.0),
        "diagonals": diagonals,
        "pins": (0, 3),
    }
    grid = Scene(cloth=Cloth(rows=5, columns=7, width=1.2, height=0.6, **placed), fabric=fabric)
    mesh = Scene(cloth=Cloth(file="grid.obj", folder=str(path.parent), **placed), fabric=fabric)
    one, two = build_topology(grid, section), build_topology(mesh, section)
    assert (one.family_counts, one.pinned.tolist()) == (two.family_counts, two.pinned.tolist())
    assert np.abs(one.start - two.start).max() == 0
    assert two.mass == pytest.approx(one.mass, rel=1e-12)
    springs = [by_pair(t.ends, t.rest, spring_stiffness(s, section, t)) for s, t in ((grid, one), (mesh, two))]
    links = [by_pair(t.bending_links.ends, t.bending_links.stiffness) for t in (one, two)]
    for expected, found in (springs, links):
        assert found.keys() == expected.keys()
        assert np.array(list(found.values())) == pytest.approx(np.array([expected[pair] for pair in found]), rel=1e-9)
    assert len(links[0]) == (0 if section == "verlet" else len(springs[0]) + (2 - diagonals) * 24)


def test_no_particle_occurs_twice_in_a_batch(tmp_path: Path) -> None:
    topology, _ = made(tmp_path, irregular(9, 0.3), Fabric())
    assert sum(batch.count for batch in topology.batches) == topology.spring_count
    assert [b.family for b in topology.batches] == sorted((b.family for b in topology.batches), reverse=True)
    for batch in topology.batches:
        ends = topology.ends[batch.first : batch.first + batch.count].reshape(-1)
        assert len(set(ends)) == len(ends)
    color = greedy_coloring(topology.triangles, topology.particle_count)
    for number in range(color.max() + 1):
        corners = topology.triangles[color == number].reshape(-1)
        assert len(set(corners)) == len(corners)


@pytest.mark.parametrize("name", ["round", "bust"])
def test_total_mass_is_area_times_density(name: str) -> None:
    topology = build_topology(Scene(cloth=Cloth(file=name, scale=0.5, area_density=0.3, pins=())), "fabric")
    a, b, c = (topology.flat[topology.triangles[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2
    assert topology.mass.sum() == pytest.approx(0.3 * area, rel=1e-12)
    if name == "round":
        assert area == pytest.approx(np.pi * 0.5**2, rel=2e-3)  # a polygon of 132 corners
    assert (topology.mass > 0).all()


# -- the membrane ------------------------------------------------------------------------------------------------------


def membrane(topology: Topology, stiffness: np.ndarray) -> np.ndarray:
    """Return C11, C22 and C12 [N/m] of a sheet of 1 m², from its strain energies for uniform strains."""
    edge = np.diff(topology.flat[topology.ends], axis=1)[:, 0, :2]
    squared = (edge**2).sum(axis=1)
    x, y = (edge**2 / squared[:, None]).T
    return np.array([(stiffness * squared * p * q).sum() for p, q in ((x, x), (y, y), (x, y))])


@pytest.mark.parametrize("jitter", [0.0, 0.2, 0.3])
def test_a_membrane_of_triangles_is_as_stiff_as_one_of_quads(tmp_path: Path, jitter: float) -> None:
    of_quads, of_triangles = (membrane(*made(tmp_path, mesh)) for mesh in (quads(17, 17), irregular(17, jitter)))
    assert of_quads == pytest.approx([3000, 3000, 1000], rel=1e-9)
    assert of_triangles == pytest.approx(of_quads, rel=0.05)
    assert of_triangles @ [1, 1, 2] == pytest.approx(8000, rel=1e-9)  # exact for any triangles


def sag(topology: Topology, stiffness: np.ndarray) -> float:
    """Return how far the lower edge of a hanging sheet of weight 1 N moves down [m], from a linear solution."""
    flat, (a, b) = topology.flat, topology.ends.T
    edge = (flat[b] - flat[a])[:, :2]
    edge /= np.linalg.norm(edge, axis=1)[:, None]
    matrix = np.zeros((len(flat), 2, len(flat), 2))
    blocks = stiffness[:, None, None] * edge[:, :, None] * edge[:, None, :]
    for p, q, sign in ((a, a, 1), (b, b, 1), (a, b, -1), (b, a, -1)):
        np.add.at(matrix.transpose(0, 2, 1, 3), (p, q), sign * blocks)
    free = np.repeat(flat[:, 1] < 0.5 - 1e-6, 2)
    load = np.zeros((len(flat), 2))
    load[:, 1] = -topology.mass / topology.mass.sum()
    moved = np.zeros(2 * len(flat))
    moved[free] = np.linalg.solve(matrix.reshape(2 * len(flat), -1)[np.ix_(free, free)], load.reshape(-1)[free])
    return -float(moved.reshape(-1, 2)[flat[:, 1] < -0.5 + 1e-6, 1].mean())


def test_a_hanging_square_stretches_equally_on_every_mesh(tmp_path: Path) -> None:
    """Irregular triangles stretch unevenly, and therefore a little more in total."""
    expected = sag(*made(tmp_path, quads(17, 17)))
    assert sag(*made(tmp_path, quads(9, 9))) == pytest.approx(expected, rel=0.01)
    assert sag(*made(tmp_path, irregular(17, 0.0))) == pytest.approx(expected, rel=0.05)
    assert sag(*made(tmp_path, irregular(17, 0.2))) == pytest.approx(expected, rel=0.05)
    assert sag(*made(tmp_path, irregular(17, 0.3))) == pytest.approx(expected, rel=0.10)


# -- bending -----------------------------------------------------------------------------------------------------------


def laplacian(topology: Topology) -> sparse.csr_array:
    (a, b), constant, count = topology.bending_links.ends.T, topology.bending_links.stiffness, topology.particle_count
    values = np.concatenate([-constant, -constant, constant, constant])
    return sparse.coo_array(
        (values, (np.concatenate([a, b, a, b]), np.concatenate([b, a, a, b]))), shape=(count, count)
    ).tocsr()


MESHES = {
    "quads": quads(17, 17),
    "even": irregular(17, 0.0),
    "uneven": irregular(17, 0.2),
    "irregular": irregular(17, 0.3),
}


@pytest.mark.parametrize("name", MESHES)
def test_stretching_in_the_plane_causes_no_bending_force(tmp_path: Path, name: str) -> None:
    topology, _ = made(tmp_path, MESHES[name], Fabric(bending_stiffness=BENDING))
    force = laplacian(topology) @ topology.flat
    assert np.abs(force).max() < 1e-12 * np.abs(topology.bending_links.stiffness).max()


@pytest.mark.parametrize(
    ("name", "tolerance"), [("quads", 0.01), ("even", 0.03), ("uneven", 0.03), ("irregular", 0.03)]
)
def test_a_strip_droops_like_a_plate(tmp_path: Path, name: str, tolerance: float) -> None:
    """The free end of a clamped strip droops by w = q·L⁴/(8·B). Half an edge behind the clamp is free, too."""
    check_droop(made(tmp_path, MESHES[name], Fabric(bending_stiffness=BENDING))[0], tolerance)


@pytest.mark.parametrize(("name", "tolerance"), [("quads", 0.01), ("even", 0.03), ("irregular", 0.04)])
@pytest.mark.parametrize("ratio", [0.5, 2.0])
def test_a_strip_along_the_warp_droops_by_the_stiffness_of_the_warp(
    tmp_path: Path, name: str, tolerance: float, ratio: float
) -> None:
    fabric = Fabric(bending_stiffness=BENDING, bending_weft=ratio * BENDING)
    check_droop(made(tmp_path, MESHES[name], fabric)[0], tolerance)


def check_droop(topology: Topology, tolerance: float) -> None:
    y, matrix = topology.flat[:, 1], laplacian(topology)
    free = y < 0.5 - 0.07
    density = topology.mass.sum()  # [kg/m²], since the sheet has 1 m²
    droop = np.zeros(len(y))
    droop[free] = spsolve(matrix[free][:, free].tocsc(), topology.mass[free] / density)
    length = y[~free].min() + 0.5 + 1 / 32
    assert droop[y < -0.5 + 1e-6].mean() == pytest.approx(length**4 / (8 * BENDING), rel=tolerance)


def cut_quads(side: int, *, rising: bool) -> Mesh:
    """Return a square of right triangles: `side`² quads, all cut along the same diagonal."""
    points, faces = quads(side + 1, side + 1)
    a, b, c, d = np.array(faces).T
    halves = [(a, b, c), (a, c, d)] if rising else [(a, b, d), (b, c, d)]
    return points, np.concatenate([np.stack(half, axis=-1) for half in halves])


@pytest.mark.parametrize("name", ["rising", "falling", "even", "irregular"])
def test_triangles_are_equally_stiff_along_all_directions(tmp_path: Path, name: str) -> None:
    """The energy of a sheet bent to a curvature of 1/m is B/2 per area, but for half a cell at its edges.

    There the second derivative across the edge is left out.
    """
    mesh = cut_quads(16, rising=name == "rising") if "ing" in name else MESHES[name]
    topology, _ = made(tmp_path, mesh, Fabric(bending_stiffness=BENDING))
    matrix = laplacian(topology)
    energies = []
    for angle in np.radians(np.arange(0, 180, 15)):
        w = (topology.flat @ [np.cos(angle), np.sin(angle), 0.0]) ** 2 / 2
        energies.append(0.5 * w @ (matrix @ w))
    assert np.array(energies) == pytest.approx(np.full(12, BENDING / 2), rel=0.07)


def test_second_derivatives_of_a_quadratic_surface_are_exact(tmp_path: Path) -> None:
    """On any triangles, also uneven ones; inside, and on the boundary but for those across it."""
    topology, _ = made(tmp_path, irregular(9, 0.3), Fabric(bending_stiffness=BENDING))
    flat = topology.flat
    corners = flat[topology.triangles]
    vectors = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
    pairs, counts = np.unique(
        np.sort(topology.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0, return_counts=True
    )
    faces = np.c_[topology.triangles, np.full(len(topology.triangles), -1)].astype(np.int64)
    boundary = pairs[counts == 1].astype(np.int64)
    w = 1.5 * flat[:, 0] ** 2 - 0.5 * flat[:, 1] ** 2 + 0.7 * flat[:, 0] * flat[:, 1] + 3 * flat[:, 1] - 2
    forms = list(triangle_bending(Surface(flat, faces, vectors, boundary), 1.0, 1.0))
    edge = np.unique(boundary)
    found = np.full((3, len(flat)), np.nan)
    share = np.bincount(topology.triangles.reshape(-1), np.repeat(np.linalg.norm(vectors, axis=1) / 3, 3))
    for k, form in enumerate(forms):
        # The forms of one vertex are those of w_xx, w_yy and w_xy; the stiffness has its area.
        vertex = np.argmin(np.abs(form.stiffness[:, None] / (1, 1, 2)[k % 3] - share), axis=1)
        found[k % 3, vertex] = (form.factors * w[form.particles]).sum(axis=1)
    inside = np.setdiff1d(np.arange(len(flat)), edge)
    for row, expected in zip(found, (3.0, -1.0, 0.7), strict=True):
        assert row[inside] == pytest.approx(np.full(len(inside), expected), abs=1e-9)
    lower = edge[(flat[edge, 1] < -0.499) & (np.abs(flat[edge, 0]) < 0.49)]  # without corners
    assert len(lower) > 5
    assert found[0, lower] == pytest.approx(np.full(len(lower), 3.0), abs=1e-9)
    assert found[1, lower] == pytest.approx(np.zeros(len(lower)), abs=1e-9)
    assert found[2, lower] == pytest.approx(np.full(len(lower), 0.7), abs=1e-9)


@pytest.mark.parametrize("faces", [[(0, 1, 2)], [(0, 1, 2), (0, 2, 3)], [(0, 1, 2, 3), (1, 4, 2)]])
def test_a_mesh_of_few_vertices_resists_no_motion_of_a_rigid_body(tmp_path: Path, faces: list[tuple[int, ...]]) -> None:
    """And three or more that determine a second derivative resist it: a hinge does, a single triangle does not."""
    points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (2, 0.3, 0)][: max(map(max, faces)) + 1]
    path = tmp_path / "few.obj"
    lines = [f"v {x} {y} {z}" for x, y, z in points]
    lines += ["f " + " ".join(str(corner + 1) for corner in face) for face in faces]
    path.write_text("\n".join(lines))
    topology = build_topology(scene_of(path, Fabric(bending_stiffness=BENDING)), "fabric")
    matrix = laplacian(topology).toarray()
    tilted = np.c_[np.ones(len(points)), topology.flat[:, :2]]
    assert np.abs(matrix @ tilted).max(initial=0.0) < 1e-9
    values = np.linalg.eigvalsh(matrix)
    assert values[0] > -1e-9
    assert (values > 1e-6).sum() == (0 if len(faces) == 1 else len(points) - 3)


def test_a_flat_bag_resists_no_motion_of_a_rigid_body(tmp_path: Path) -> None:
    """Two sheets on each other, sewn along their edges: the normals at the seam cancel each other."""
    points, faces = quads(5, 5)
    seam = (np.abs(points) > 0.5 - 1e-9).any(axis=1)
    other = np.where(seam, np.arange(25), 25 + np.cumsum(~seam) - 1)
    a, b, c, d = np.array(faces).T
    upper = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    lower = other[np.concatenate([np.stack([a, d, b], 1), np.stack([b, d, c], 1)])]
    mesh = np.concatenate([points, points[~seam]]), np.concatenate([upper, lower])
    topology, _ = made(tmp_path, mesh, Fabric(bending_stiffness=BENDING))
    matrix = laplacian(topology).toarray()
    assert np.abs(matrix @ np.c_[np.ones(len(topology.flat)), topology.flat[:, :2]]).max() < 1e-9
    assert np.linalg.eigvalsh(matrix)[0] > -1e-9
    assert np.abs(matrix).max() < 1e4 * BENDING  # [N/m] at a distance of 1/4 m
