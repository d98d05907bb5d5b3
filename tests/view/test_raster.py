"""The rasteriser against areas, planes and spheres that are known in closed form."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import taichi as ti

from taichi_cloth.scene.model import Vec3
from taichi_cloth.view.draw_mesh import DrawMesh
from taichi_cloth.view.raster import FAR_OUT, GRID, NEAR, GridPoint, Raster, crossing, edge

CAPACITY = 3 * 16_000
BLACK = (0.0, 0.0, 0.0)
WHITE = (1.0, 1.0, 1.0)

Soup = Callable[..., DrawMesh]


@pytest.fixture(scope="module")
def soup() -> Soup:
    """Fills the module's one mesh (kernels compile anew for each) with triangles of shape (T, 3, 3)."""
    mesh = DrawMesh(*(ti.Vector.field(3, ti.f32, CAPACITY) for _ in range(4)))

    def fill(position: Any, colour: Any = WHITE) -> DrawMesh:
        corners = np.asarray(position, np.float32).reshape(-1, 3)
        for field, values in ((mesh.position, corners), (mesh.colour, colour)):
            all_values = np.full((CAPACITY, 3), 0.5, np.float32)
            rows = np.asarray(values, np.float32)
            all_values[: len(corners)] = rows.reshape(-1, 3) if rows.size > 3 else rows
            field.from_numpy(all_values)
        mesh.corners = len(corners)
        return mesh

    return fill


def pixel_camera(width: int, height: int) -> np.ndarray:
    """Makes world space that of homogeneous pixels: (x w, y w, w) is seen at pixel (x, y), w metres away."""
    return np.array([[2 / width, 0, -1, 0], [0, -2 / height, 1, 0], [0, 0, 0, 0], [0, 0, 1, 0]])


def at(x: Any, y: Any, w: Any = 1.0) -> np.ndarray:
    return np.stack(np.broadcast_arrays(np.multiply(x, w), np.multiply(y, w), w), axis=-1)


def seen(mesh: DrawMesh, width: int, height: int, samples: int = 1, background: Vec3 = BLACK) -> np.ndarray:
    return Raster(width, height, samples).draw(mesh, pixel_camera(width, height), background)


def samples_covered(mesh: DrawMesh, width: int, height: int, samples: int) -> np.ndarray:
    """Count in each pixel, told from the grey of a white mesh before black."""
    return np.rint(seen(mesh, width, height, samples)[:, :, 0] / 255 * samples).astype(int)


def pixel_centers(width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    return x, y


# -- coverage ------------------------------------------------------------------------------------------------


def test_pixels_of_a_small_triangle(soup: Soup) -> None:
    # Centres on the slanted edge, x + y = 7, are on its right end: they belong to the other half of the square.
    covered = samples_covered(soup(at([1, 6, 1], [1, 1, 6])), 8, 7, samples=1)
    assert ["".join(".#"[n] for n in row) for row in covered] == [
        "........",
        ".####...",
        ".###....",
        ".##.....",
        ".#......",
        "........",
        "........",
    ]
    other_half = samples_covered(soup(at([6, 6, 1], [1, 6, 6])), 8, 7, samples=1)
    square = np.zeros((7, 8), int)
    square[1:6, 1:6] = 1
    np.testing.assert_array_equal(covered + other_half, square)


@pytest.mark.parametrize("samples", [1, 4])
def test_area_of_triangles(soup: Soup, samples: int) -> None:
    rng = np.random.default_rng(0)
    errors = []
    for corners in rng.uniform((5, 5), (155, 115), (50, 3, 2)):
        (ux, uy), (vx, vy) = corners[1] - corners[0], corners[2] - corners[0]
        area = abs(ux * vy - uy * vx) / 2
        perimeter = np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1).sum()
        found = samples_covered(soup(at(*corners.T)), 160, 120, samples).sum() / samples
        errors.append(found - area)
        # An upright edge between two columns of samples, 1/samples apart, is off by half that along its length.
        assert abs(errors[-1]) < 0.5 / samples * perimeter
    assert abs(np.mean(errors)) < 0.5  # pixels, of 1700 on average: errors have either sign


@pytest.mark.parametrize("samples", [1, 4])
@pytest.mark.parametrize("step", [1 / 8, 1e-4], ids=["edges through samples", "edges anywhere"])
def test_every_sample_of_a_surface_belongs_to_one_triangle(soup: Soup, samples: int, step: float) -> None:
    rng = np.random.default_rng(1)
    width, height, cell = 24, 18, 6.0
    x, y = np.meshgrid(np.arange(-cell, width + 2 * cell, cell), np.arange(-cell, height + 2 * cell, cell))
    x, y = (step * np.rint((v + rng.uniform(-0.4 * cell, 0.4 * cell, v.shape)) / step) for v in (x, y))
    points = at(x, y, rng.uniform(1, 3, x.shape))
    a, b, c, d = points[:-1, :-1], points[:-1, 1:], points[1:, 1:], points[1:, :-1]
    triangles = np.concatenate([np.stack(t, axis=2).reshape(-1, 3, 3) for t in ((a, b, c), (d, a, c))])
    alone = sum(samples_covered(soup(t), width, height, samples) for t in triangles)
    together = samples_covered(soup(triangles), width, height, samples)
    np.testing.assert_array_equal(alone, samples)  # none twice
    np.testing.assert_array_equal(together, samples)  # none left out


@pytest.mark.parametrize("quarters", [1, 2, 3])
@pytest.mark.parametrize("upright", [True, False], ids=["upright", "level"])
def test_pixel_at_an_edge_shows_the_share_covered(soup: Soup, quarters: int, upright: bool) -> None:
    end = 3 + quarters / 4
    x, y = [-9, end, end, -9, end, -9], [-9, -9, 20, -9, 20, 20]  # a rectangle that ends in pixel 3
    mesh = soup(at(x, y) if upright else at(y, x), colour=(0.8, 0.4, 0.2))
    picture = seen(mesh, 7, 7, samples=4, background=(0.0, 0.92, 0.2))
    line = picture[2] if upright else picture[:, 2]
    mixed = np.array([0.0, 0.92, 0.2]) + quarters / 4 * np.array([0.8, -0.52, 0.0])
    np.testing.assert_array_equal(line[2], np.rint(255 * np.array([0.8, 0.4, 0.2])))
    np.testing.assert_array_equal(line[3], np.rint(255 * mixed))
    np.testing.assert_array_equal(line[4], [0, 235, 51])


@ti.kernel
def columns_crossed(
    ends: ti.types.ndarray(dtype=GridPoint, ndim=2), at: ti.types.ndarray(dtype=GridPoint, ndim=1), columns: ti.i32
):
    for k in range(at.shape[0]):
        at[k].x = crossing(edge(ends[k, 0], ends[k, 1]), at[k].x, at[k].y, columns)


def test_an_edge_is_crossed_where_integers_say() -> None:
    rng, columns = np.random.default_rng(3), 1920
    ends = rng.integers(-300 * GRID, 2200 * GRID, (20_000, 2, 2))
    ends[:5000] = 2 * GRID * (ends[:5000] // (2 * GRID))  # their middles are where samples may be: on whole pixels
    ends = np.take_along_axis(ends, np.argsort(ends[:, :, 1:], axis=1), axis=1)
    ends = ends[ends[:, 0, 1] < ends[:, 1, 1]]
    (ax, ay), (bx, by) = ends[:, 0].T, ends[:, 1].T
    x, y = rng.choice([32, 96, 128, 160, 224], len(ends)), rng.integers(ay, by)
    x[:4900], y[:4900] = 0, (ay + by)[:4900] // 2
    above, below = (ax - x) * (by - ay) + (bx - ax) * (y - ay), GRID * (by - ay)
    assert (above % below == 0).sum() > 4000
    found = np.ascontiguousarray(np.stack([x, y], axis=1))
    columns_crossed(np.ascontiguousarray(ends), found, columns)
    np.testing.assert_array_equal(found[:, 0], np.clip(-(-above // below), 0, columns))


# -- depth ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("near_first", [True, False])
@pytest.mark.parametrize("samples", [1, 4])
def test_nearer_triangle_wins_whatever_the_order(soup: Soup, near_first: bool, samples: int) -> None:
    near, far = at([-9, 40, -9], [-9, -9, 40], 2.0), at([-9, 40, -9], [-9, -9, 40], 2.001)
    red, blue = np.array([1, 0, 0]), np.array([0, 0, 1])
    order = [0, 1] if near_first else [1, 0]
    colours = np.repeat(np.array([red, blue])[order], 3, axis=0)
    picture = seen(soup(np.array([near, far])[order], colour=colours), 8, 8, samples)
    np.testing.assert_array_equal(picture, np.broadcast_to(255 * red, (8, 8, 3)))


def test_depth_of_a_tilted_triangle(soup: Soup) -> None:
    width, height = 60, 40
    x, y, w = np.array([3.0, 55.0, 20.0]), np.array([2.0, 10.0, 38.0]), np.array([1.0, 4.0, 2.0])
    raster = Raster(width, height, samples=1)
    raster.draw(soup(at(x, y, w)), pixel_camera(width, height), BLACK)
    depth = raster.depth()
    # The nearness is a plane over the screen: alpha x + beta y + gamma = 1/w.
    plane = np.linalg.solve(np.stack([x, y, np.ones(3)], axis=1), 1 / w)
    px, py = pixel_centers(width, height)
    expected = 1 / (plane[0] * px + plane[1] * py + plane[2])
    covered = np.isfinite(depth)
    assert covered.sum() > 700
    np.testing.assert_allclose(depth[covered], expected[covered], rtol=1e-5)
    assert depth.dtype == np.float32


def test_sphere(soup: Soup) -> None:
    width, height, focal, distance, radius = 240, 200, 300.0, 5.0, 1.0
    u, v = np.meshgrid(np.linspace(0, np.pi, 61), np.linspace(0, 2 * np.pi, 121), indexing="ij")
    unit = np.stack([np.sin(u) * np.cos(v), np.cos(u), np.sin(u) * np.sin(v)], axis=-1)
    a, b, c, d = (s.reshape(-1, 3) for s in (unit[:-1, :-1], unit[:-1, 1:], unit[1:, 1:], unit[1:, :-1]))
    faces = np.concatenate([np.stack(t, axis=1) for t in ((a, b, c), (a, c, d))])
    eye_space = radius * faces + (0, 0, distance)
    camera = np.array([[focal / (width / 2), 0, 0, 0], [0, focal / (height / 2), 0, 0], [0, 0, 0, 0], [0, 0, 1, 0]])
    raster = Raster(width, height, samples=4)
    picture = raster.draw(soup(eye_space), camera, BLACK)

    silhouette = focal * radius / np.sqrt(distance**2 - radius**2)  # the cone of tangents, cut by the screen
    assert picture[:, :, 0].sum() / 255 == pytest.approx(np.pi * silhouette**2, rel=3e-3)

    raster = Raster(width, height, samples=1)
    raster.draw(soup(eye_space), camera, BLACK)
    x, y = pixel_centers(width, height)
    ray = np.stack([(x - width / 2) / focal, (height / 2 - y) / focal, np.ones_like(x)], axis=-1)  # w = 1
    square, middle = (ray**2).sum(axis=-1), distance * ray[..., 2]
    inner = np.hypot(x - width / 2, y - height / 2) < 0.9 * silhouette
    expected = (middle - np.sqrt(np.where(inner, middle**2 - square * (distance**2 - radius**2), 0))) / square
    # Chords of 3 degrees lie at most 0.0005 under the sphere, more along a slanted ray.
    np.testing.assert_allclose(raster.depth()[inner], expected[inner], atol=2e-3)
    assert np.isinf(raster.depth()[0, 0])


# -- camera and attributes -----------------------------------------------------------------------------------


def test_row_0_is_on_top_and_y_points_up(soup: Soup) -> None:
    looking_down_minus_z = np.array([[1.0, 0, 0, 0], [0, 1.0, 0, 0], [0, 0, -1.0, -0.2], [0, 0, -1.0, 0]])
    upper_left = np.array([[-2, 2, -2], [0, 2, -2], [-2, 0, -2]])
    picture = Raster(10, 6, samples=1).draw(soup(upper_left), looking_down_minus_z, BLACK)
    assert picture.shape == (6, 10, 3)
    assert picture[0, 0, 0] == 255
    assert picture[-1].max() == picture[:, -1].max() == 0


def test_colours_are_interpolated_in_perspective(soup: Soup) -> None:
    width, height = 60, 40
    x, y, w = np.array([-5.0, 140.0, -5.0]), np.array([-5.0, -5.0, 120.0]), np.array([1.0, 6.0, 2.5])
    colours = np.array([[1.0, 0.0, 0.2], [0.0, 1.0, 0.4], [0.3, 0.1, 0.9]])
    picture = seen(soup(at(x, y, w), colour=colours), width, height)
    px, py = pixel_centers(width, height)
    flat = np.linalg.solve(np.stack([x, y, np.ones(3)]), np.stack([px, py, np.ones_like(px)]).reshape(3, -1))
    weights = flat / w[:, None]
    expected = (colours.T @ (weights / weights.sum(axis=0))).T.reshape(height, width, 3)
    np.testing.assert_allclose(picture / 255, expected, atol=1.0 / 255)


def test_a_surface_is_not_coloured_beyond_its_edge(soup: Soup) -> None:
    # Colour falls from 1 at x = 2.2 to 0 at the right edge, x = 3.2, and would be below 0 in the middle of pixel 3.
    mesh = soup(at([2.2, 3.2, 3.2], [4, -96, 104]), colour=[[1, 1, 1], [0, 0, 0], [0, 0, 0]])
    pixel = seen(mesh, 8, 8, samples=4)[4, 3, 0]
    assert pixel == round(255 * (3.2 - 3.125) / 4) > 0  # the one sample covered is at x = 3.125


# -- what is not there, and not fine -------------------------------------------------------------------------


def test_without_triangles_there_is_background(soup: Soup) -> None:
    raster = Raster(5, 3)
    picture = raster.draw(soup(np.zeros((0, 3, 3))), pixel_camera(5, 3), (0.2, 0.4, 0.6))
    np.testing.assert_array_equal(picture, np.broadcast_to([51, 102, 153], (3, 5, 3)))
    assert np.isinf(raster.depth()).all()


def test_only_corners_in_use_are_drawn(soup: Soup) -> None:
    mesh = soup([at([0, 4, 0], [0, 0, 4]), at([-9, 40, -9], [-9, -9, 40])])
    mesh.corners = 3
    assert samples_covered(mesh, 8, 8, samples=1).sum() == 6


@pytest.mark.parametrize(
    "triangle",
    [
        at([-9, 40, -9], [-9, -9, 40], -1.0),
        at([-9, 40, -9], [-9, -9, 40], [1.0, 1.0, 0.9 * NEAR]),
        at([1, 7, 4], [1, 7, 4]),
        at([3, 3, 3], [3, 3, 3]),
        at([-9, np.nan, -9], [-9, -9, 40]),
        at([-9, 40, -9], [-9, -9, 40], [1.0, 1.0, np.nan]),
        at([-9, np.inf, -9], [-9, -9, 40]),
        at([-9, 40, -9], [-9, -9, 1e30]),
        at([-9, 3 * FAR_OUT, -9], [-9, -9, 40]),
        np.full((3, 3), np.nan),
    ],
    ids=["behind", "corner too near", "line", "point", "NaN x", "NaN w", "infinite", "huge", "far out", "NaN"],
)
def test_no_trace_of_triangles_that_cannot_be_drawn(soup: Soup, triangle: np.ndarray) -> None:
    fine = at([2, 6, 2], [2, 2, 6])
    alone = seen(soup(fine), 8, 8, samples=4)
    np.testing.assert_array_equal(seen(soup([triangle, fine, triangle]), 8, 8, samples=4), alone)
    assert alone.any()


def test_same_bytes_twice(soup: Soup) -> None:
    rng = np.random.default_rng(2)
    centers = rng.uniform((0, 0, 1), (120, 90, 2), (5000, 1, 3))
    x, y, w = np.moveaxis(centers + rng.normal(0, (8, 8, 0.02), (5000, 3, 3)), -1, 0)
    mesh = soup(at(x, y, w), colour=rng.uniform(0, 1, (15000, 3)))
    raster = Raster(120, 90)
    first = raster.draw(mesh, pixel_camera(120, 90), BLACK)
    for again in (raster, raster, Raster(120, 90)):
        assert again.draw(mesh, pixel_camera(120, 90), BLACK).tobytes() == first.tobytes()


def test_rasters_come_and_go(soup: Soup) -> None:
    # Had each a field of its own, the 513th would end the process.
    mesh = soup(at([0, 4, 0], [0, 0, 4]))
    for k in range(600):
        assert seen(mesh, 1 + k % 7, 1 + k % 5)[0, 0, 0] == 255


@pytest.mark.parametrize("arguments", [(0, 5), (5, 0), (-1, 5), (5, 5, 2), (5, 5, 0)])
def test_impossible_pictures_are_refused(arguments: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="not"):
        Raster(*arguments)


def test_a_matrix_of_another_shape_is_refused(soup: Soup) -> None:
    with pytest.raises(ValueError, match=r"\(4, 4\), not \(3, 4\)"):
        Raster(5, 5).draw(soup(at([0, 4, 0], [0, 0, 4])), np.zeros((3, 4)), BLACK)
