"""A z-buffer rasterizer in Taichi: draws triangles without a window, a display or Vulkan.

`project_vertices` projects the triangles and prepares them. `fill_bands` splits the image into bands of pixel rows: in
each, `cover` finds the nearest triangle of every sample, and `resolve` computes the pixels from their colors. The
colors contain the light already, so a scene looks as it does in Taichi's own window (GGUI).

- A pixel has one sample, or four on a rotated grid: edges that are almost horizontal or vertical get five gray levels.
- A homogeneous pixel is (x w, y w, w): x and y in pixels from the top left corner, w the depth along the view axis [m].
- The nearness is 1/w [1/m]: affine in x and y, so a triangle is a plane; 0 is infinitely far.
- Grid steps are 1/256 of a pixel. Corners and samples are on the grid, so that coverage is decided in integers.
"""

import numpy as np
import taichi as ti
import taichi.math as tm

from ..scene.keys import Vec3
from .draw_list import DrawMesh
from .shading import BACKGROUND

NEAR = 0.05  # [m] a triangle with a corner nearer than this is not drawn
MAX_COORDINATE = 2.0**20  # [pixels] nor is one with a coordinate this large: products of grid lengths would overflow

GRID = 256  # grid steps per pixel
BAND = 8  # pixel rows that a thread fills at a time
# On the CPU Taichi 1.7 gives a thread at least 512 iterations of a loop: only every 512th is a band, others cost 2 ns.
MIN_LOOP_CHUNK = 512
RUN_LENGTH = 64  # consecutive triangles that a band skips together if none of them reaches it
# Distances of the samples of a pixel from its left edge [grid steps]. Each is in the middle of a horizontal stripe.
SAMPLE_X = {1: (128,), 4: (96, 224, 32, 160)}

HomogeneousPixels = ti.types.matrix(3, 4, ti.f32)
GridPoint = ti.types.vector(2, ti.i64)
Edge = ti.types.vector(3, ti.f64)  # the result of `edge`
Rgb = ti.types.vector(3, ti.u8)


class Rasterizer:
    """Draws images of one size. It owns only NumPy arrays, so any number of rasterizers can be created and dropped."""

    def __init__(self, width: int, height: int, samples: int = 4) -> None:
        """`width`, `height` in pixels, at least 1; `samples` per pixel, 1 or 4. Raises ValueError for other numbers."""
        if width < 1 or height < 1:
            raise ValueError(f"image size must be at least 1 x 1 pixels, not {width} x {height}")
        if samples not in SAMPLE_X:
            raise ValueError(f"samples per pixel must be 1 or 4, not {samples}")
        self.width, self.height, self.samples = width, height, samples
        self._sample_x = np.array(SAMPLE_X[samples], np.int32)
        # Row by row of samples, not of pixels: the samples that a triangle covers in a row are contiguous in memory.
        self._nearest = np.zeros(height * samples * width, np.int64)
        self._allocate(0)

    def _allocate(self, triangles: int) -> None:
        """Allocate the outputs of `project_vertices` for this number of triangles, rounded up to a multiple of RUN."""
        triangles = -(-triangles // RUN_LENGTH) * RUN_LENGTH
        self._rows = np.empty((triangles, 2), np.int32)
        self._edges = np.empty((triangles, 3, 3), np.float64)
        self._depths = np.empty((triangles, 4, 2), np.float32)
        self._color_planes = np.empty((triangles, 4, 3), np.float32)

    def draw(self, triangles: DrawMesh, view_projection: np.ndarray, background: Vec3 = BACKGROUND) -> np.ndarray:
        """Return an image, uint8 (height, width, 3), top row first.

        `view_projection`, (4, 4), acts on column vectors: clip = view_projection @ (x, y, z, 1). Clip w must be the
        distance along the view axis [m]. x/w and y/w run from −1 to 1 across the image, y up; z is not used.
        `background`, factors 0…1, is the color where there is no triangle. Raises ValueError if `view_projection` has
        another shape.
        """
        if np.shape(view_projection) != (4, 4):
            raise ValueError(f"view_projection must have shape (4, 4), not {np.shape(view_projection)}")
        x, y, _, w = np.asarray(view_projection, np.float64)
        camera = HomogeneousPixels(np.stack([(w + x) * (self.width / 2), (w - y) * (self.height / 2), w]))
        count = triangles.corners // 3
        if len(self._color_planes) < count:
            self._allocate(triangles.position.shape[0] // 3)
        image = np.empty((self.height, self.width, 3), np.uint8)

        project_vertices(
            triangles.position,
            triangles.color,
            count,
            camera,
            self.samples,
            self._rows,
            self._edges,
            self._depths,
            self._color_planes,
        )
        fill_bands(
            self._run_rows(count),
            self._rows,
            self._edges,
            self._depths,
            self._color_planes,
            self.samples,
            self._sample_x,
            tm.vec3(background),
            self._nearest,
            image,
        )
        return image

    def _run_rows(self, count: int) -> np.ndarray:
        """Return the first sample row that each run of RUN triangles may cover, and the end of its rows, (runs, 2)."""
        self._rows[count:] = 0
        first, end = self._rows.reshape(-1, RUN_LENGTH, 2).transpose(2, 0, 1)
        first = np.where(first < end, first, np.iinfo(np.int32).max)
        return np.stack([first.min(axis=1), end.max(axis=1)], axis=1)

    def depth(self) -> np.ndarray:
        """Return the distance along the view axis [m] of the nearest sample in each pixel of the last image.

        float32 (height, width); infinity where all samples show the background.
        """
        nearness = (self._nearest >> 32).astype(np.int32).view(np.float32)
        with np.errstate(divide="ignore"):
            return 1 / nearness.reshape(self.height, self.samples, self.width).max(axis=1)


# -- projection --------------------------------------------------------------------------------------------------------


@ti.kernel
def project_vertices(
    position: ti.template(),
    color: ti.template(),
    count: ti.i32,
    camera: HomogeneousPixels,
    samples: ti.i32,
    rows: ti.types.ndarray(dtype=ti.math.ivec2, ndim=1),
    edges: ti.types.ndarray(dtype=Edge, ndim=2),
    depths: ti.types.ndarray(dtype=tm.vec2, ndim=2),
    color_planes: ti.types.ndarray(dtype=tm.vec3, ndim=2),
):
    """Project `count` triangles to the screen, and write for each triangle t what `fill_bands` needs.

    - rows[t]: the first sample row that it may cover, and the one after the last; equal if it covers none.
    - edges[t]: three edges for `crossing`: top to bottom corner, top to middle corner, middle to bottom corner.
    - depths[t]: an origin [pixels]; the slope of the nearness per pixel; the nearness at the origin, and 0; the
      smallest and the largest nearness of the corners.
    - color_planes[t]: four vectors, for interpolation in perspective. Their dot products with (x, y, 1) are red, green
      and blue at (x, y), each times the nearness there, and this nearness.
    """
    for t in range(count):
        p = camera @ tm.vec4(position[3 * t], 1.0)
        q = camera @ tm.vec4(position[3 * t + 1], 1.0)
        r = camera @ tm.vec4(position[3 * t + 2], 1.0)
        rows[t] = tm.ivec2(0, 0)
        # Comparisons with NaN are false, so triangles that are not finite are dropped here. There is no clipping: a
        # triangle that crosses the near plane is not drawn.
        if p.z > NEAR and q.z > NEAR and r.z > NEAR:
            a, b, c = p.xy / p.z, q.xy / q.z, r.xy / r.z
            if is_within_reach(a) and is_within_reach(b) and is_within_reach(c):
                near = 1.0 / tm.vec3(p.z, q.z, r.z)
                project_triangle(
                    t, on_grid(a), on_grid(b), on_grid(c), near, color, samples, rows, edges, depths, color_planes
                )


@ti.func
def project_triangle(
    t: ti.i32,
    a: GridPoint,
    b: GridPoint,
    c: GridPoint,
    near: tm.vec3,
    color: ti.template(),
    samples: ti.i32,
    rows: ti.template(),
    edges: ti.template(),
    depths: ti.template(),
    color_planes: ti.template(),
):
    """Write the data of one triangle with corners a, b, c and their nearnesses; see `project_vertices`."""
    ab, ac = b - a, c - a
    area = ab.x * ac.y - ab.y * ac.x
    if area != 0:
        # Gradients per pixel of the barycentric coordinates of b and c, and of the nearness.
        scale = GRID / ti.cast(area, ti.f32)
        to_b, to_c = scale * tm.vec2(ac.y, -ac.x), scale * tm.vec2(-ab.y, ab.x)
        slope = to_b * (near[1] - near[0]) + to_c * (near[2] - near[0])
        origin = a / GRID
        # Dot products with (x, y, 1) are the barycentric coordinates of the corners times their nearnesses.
        at_a = near[0] * tm.vec3(-to_b - to_c, 1.0 + tm.dot(to_b + to_c, origin))
        at_b, at_c = near[1] * tm.vec3(to_b, -tm.dot(to_b, origin)), near[2] * tm.vec3(to_c, -tm.dot(to_c, origin))
        for k in ti.static(range(3)):
            color_planes[t, k] = color[3 * t][k] * at_a + color[3 * t + 1][k] * at_b + color[3 * t + 2][k] * at_c
        color_planes[t, 3] = at_a + at_b + at_c
        depths[t, 0], depths[t, 1] = tm.vec2(origin), slope
        depths[t, 2], depths[t, 3] = tm.vec2(near[0], 0.0), tm.vec2(near.min(), near.max())

        top, middle, bottom = sort_by_y(a, b, c)
        edges[t, 0], edges[t, 1], edges[t, 2] = edge(top, bottom), edge(top, middle), edge(middle, bottom)
        stripe = GRID // samples
        first, end = ceil_div(top.y - stripe // 2, stripe), ceil_div(bottom.y - stripe // 2, stripe)
        rows[t] = tm.ivec2(ti.cast(first, ti.i32), ti.cast(end, ti.i32))


# -- coverage ----------------------------------------------------------------------------------------------------------


@ti.kernel
def fill_bands(
    runs: ti.types.ndarray(dtype=ti.math.ivec2, ndim=1),
    rows: ti.types.ndarray(dtype=ti.math.ivec2, ndim=1),
    edges: ti.types.ndarray(dtype=Edge, ndim=2),
    depths: ti.types.ndarray(dtype=tm.vec2, ndim=2),
    color_planes: ti.types.ndarray(dtype=tm.vec3, ndim=2),
    samples: ti.template(),
    sample_x: ti.types.ndarray(dtype=ti.i32, ndim=1),
    background: tm.vec3,
    nearest: ti.types.ndarray(dtype=ti.i64, ndim=1),
    image: ti.types.ndarray(dtype=Rgb, ndim=2),
):
    """Draw the projected triangles. Each band of BAND pixel rows belongs to one thread, which writes nothing else."""
    height = image.shape[0]
    for k in range((height + BAND - 1) // BAND * MIN_LOOP_CHUNK):
        if k % MIN_LOOP_CHUNK == 0:
            low = k // MIN_LOOP_CHUNK * BAND
            high = ti.min(low + BAND, height)
            cover(low * samples, high * samples, runs, rows, edges, depths, samples, image.shape[1], sample_x, nearest)
            resolve(low, high, color_planes, samples, background, nearest, image)


@ti.func
def cover(
    low: ti.i32,
    high: ti.i32,
    runs: ti.template(),
    rows: ti.template(),
    edges: ti.template(),
    depths: ti.template(),
    samples: ti.template(),
    columns: ti.i32,
    sample_x: ti.template(),
    nearest: ti.template(),
):
    """Write the key of the nearest triangle, or 0, to `nearest` for every sample in sample rows `low` … `high` − 1.

    The upper 32 bits of a key are the bits of the nearness, which sort like the positive numbers they encode. The lower
    32 bits are the index of the triangle + 1. The largest key is that of the nearest triangle.
    """
    stripe = ti.static(GRID // samples)
    for k in range(low * columns, high * columns):
        nearest[k] = 0
    for run in range(runs.shape[0]):
        if runs[run].x < high and runs[run].y > low:
            for t in range(run * RUN_LENGTH, (run + 1) * RUN_LENGTH):
                first, end = ti.max(rows[t].x, low), ti.min(rows[t].y, high)
                if first < end:
                    origin, slope, limits = depths[t, 0], depths[t, 1], depths[t, 3]
                    near, middle = depths[t, 2].x, edges[t, 2].z
                    for row in range(first, end):
                        x, y = sample_x[row & (samples - 1)], row * stripe + stripe // 2
                        half = 1 + ti.cast(y >= middle, ti.i32)
                        one, other = crossing(edges[t, 0], x, y, columns), crossing(edges[t, half], x, y, columns)
                        begin, stop = ti.min(one, other), ti.max(one, other)
                        at_begin = near + tm.dot(slope, tm.vec2(begin + x / GRID, y / GRID) - origin)
                        row_start = row * columns
                        for column in range(begin, stop):
                            # Clamped to the range of the corners, which the steep plane of a sliver can leave.
                            nearness = clamp(at_begin + (column - begin) * slope.x, limits.x, limits.y)
                            key = ti.cast(ti.bit_cast(nearness, ti.i32), ti.i64) << 32 | t + 1
                            if key > nearest[row_start + column]:
                                nearest[row_start + column] = key


@ti.func
def clamp(x: ti.template(), low: ti.template(), high: ti.template()):
    """Return x clamped to low … high, in two instructions; `tm.clamp` takes ten, because it handles NaN."""
    raised = ti.select(x < low, low, x)
    return ti.select(raised > high, high, raised)


@ti.func
def is_within_reach(pixel: tm.vec2):
    """Return whether the magnitudes of both coordinates are below FAR_OUT; false for NaN.

    It compares bits: with fast-math the compiler may assume that no operand of a float comparison is NaN.
    """
    size = ti.bit_cast(pixel, ti.i32) & 0x7FFFFFFF
    return size.max() < ti.bit_cast(ti.cast(MAX_COORDINATE, ti.f32), ti.i32)


@ti.func
def on_grid(pixel: tm.vec2):
    """Return the grid point nearest to a position [pixels]."""
    return ti.cast(ti.floor(pixel * GRID + 0.5), ti.i64)


@ti.func
def sort_by_y(a: GridPoint, b: GridPoint, c: GridPoint):
    """Return the three points from top to bottom."""
    if b.y < a.y:
        a, b = b, a
    if c.y < a.y:
        a, c = c, a
    if c.y < b.y:
        b, c = c, b
    return a, b, c


@ti.func
def ceil_div(n: ti.i64, d: ti.i64):
    """Return n / d rounded up."""
    return -(-n // d)


@ti.func
def edge(a: GridPoint, b: GridPoint) -> Edge:
    """Return the edge from a down to b: x at a [pixels], change of x per grid step down [pixels], y of a [grid steps].

    x is reduced by 1/(2 (b.y − a.y)) grid steps; `crossing` explains why.
    """
    drop = ti.cast(ti.max(b.y - a.y, 1), ti.f64)
    return Edge((a.x - 0.5 / drop) / GRID, (b.x - a.x) / (GRID * drop), a.y)


@ti.func
def crossing(e: Edge, x: ti.f64, y: ti.f64, columns: ti.i32) -> ti.i32:
    """Return the first column whose sample is on the edge or to its right, at height y [grid steps].

    `x`: distance of the samples from the left edges of their pixels [grid steps]. Two triangles compute the same column
    for an edge that they share, from the same numbers, so that no sample there is missed or covered twice. It is exact:
    for integers n and d, n / d and (n − 1/2) / d round up to the same integer. The latter is at least 1/(2 d) away from
    every integer, which is more than the rounding error of a double.
    """
    position = clamp(e.x + e.y * (y - e.z) - x / GRID, 0.0, ti.cast(columns, ti.f64))
    column = ti.cast(position, ti.i32)
    return column + ti.cast(column < position, ti.i32)


# -- colors ------------------------------------------------------------------------------------------------------------


@ti.func
def resolve(
    low: ti.i32,
    high: ti.i32,
    color_planes: ti.template(),
    samples: ti.template(),
    background: tm.vec3,
    nearest: ti.template(),
    image: ti.template(),
):
    """Write the mean color of the samples of every pixel in pixel rows `low` … `high` − 1."""
    columns = image.shape[1]
    for row in range(low, high):
        for column in range(columns):
            owner = ti.cast(nearest[row * samples * columns + column], ti.i32)  # triangle + 1, or 0
            uniform = True
            for k in ti.static(range(1, samples)):
                uniform &= ti.cast(nearest[(row * samples + k) * columns + column], ti.i32) == owner
            total = background
            if uniform:
                if owner > 0:
                    total = color_at(owner - 1, column + 0.5, row + 0.5, color_planes)
            else:
                total = mean_color(row, column, color_planes, samples, background, columns, nearest)
            image[row, column] = ti.cast(total * 255 + 0.5, ti.u8)


@ti.func
def mean_color(
    row: ti.i32,
    column: ti.i32,
    color_planes: ti.template(),
    samples: ti.template(),
    background: tm.vec3,
    columns: ti.i32,
    nearest: ti.template(),
) -> tm.vec3:
    """Return the mean color of a pixel whose samples show different triangles."""
    total = tm.vec3(0.0)
    done = 0  # one bit per sample
    for j in range(samples):
        if not done >> j & 1:
            # The color at the mean position of the samples that show this triangle. This point is inside the triangle;
            # the center of the pixel may not be.
            owner = ti.cast(nearest[(row * samples + j) * columns + column], ti.i32)
            count, x, y = 0, 0.0, 0.0
            for k in ti.static(range(samples)):
                if ti.cast(nearest[(row * samples + k) * columns + column], ti.i32) == owner:
                    done |= 1 << k
                    count += 1
                    x += ti.static(SAMPLE_X[samples][k] / GRID)
                    y += ti.static((k + 0.5) / samples)
            color = background
            if owner > 0:
                color = color_at(owner - 1, column + x / count, row + y / count, color_planes)
            total += count / samples * color
    return total


@ti.func
def color_at(t: ti.i32, x: float, y: float, color_planes: ti.template()) -> tm.vec3:
    """Return the color of triangle t at a point [pixels]."""
    at = tm.vec3(x, y, 1.0)
    weighted = tm.vec3(color_planes[t, 0].dot(at), color_planes[t, 1].dot(at), color_planes[t, 2].dot(at))
    return clamp(weighted / color_planes[t, 3].dot(at), tm.vec3(0.0), tm.vec3(1.0))
