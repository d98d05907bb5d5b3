"""Draws triangles without window, display or Vulkan: a z-buffer rasteriser in Taichi.

Two kernels make a picture. `place` projects the triangles; `fill_bands` takes the picture in bands of rows: `cover`
leaves in every sample the nearest triangle, `resolve` walks the pixels and mixes the colours of each triangle it meets
there. A pixel has one sample, or four on a rotated grid: edges near the horizontal or the vertical then get five grey
levels (a square grid: three).
Colours come with their light, as in Taichi's own window (GGUI), so a scene looks the same in both.

Spaces: a *homogeneous pixel* is (x w, y w, w), with x and y in pixels from the top left corner of the
picture and w the distance from the eye along the view axis in metres. *Nearness* is 1/w: unlike w it is
affine in x and y, so a plane on the screen, and zero is as far as can be. The *grid* is 1/256 of a pixel:
corners and samples sit on it, so that coverage is decided in integers, without rounding.
"""

import numpy as np
import taichi as ti
import taichi.math as tm

from ..scene.model import Vec3
from .draw_mesh import DrawMesh
from .lighting import BACKGROUND

NEAR = 0.05  # [m] a triangle with a corner nearer than this is left out
FAR_OUT = 2.0**20  # [pixels] so is one that reaches this far out, lest products of grid lengths overflow

GRID = 256  # steps in a pixel
BAND = 8  # rows of pixels that a thread fills at a time
# Taichi 1.7 gives a thread of the CPU 512 iterations of a loop at least, whatever `block_dim` says: a loop over 135
# bands would be one thread's alone. So only each 512th iteration is a band; the others cost 2 ns.
TASK = 512
RUN = 64  # triangles after each other, which a band passes over at once where none of them reaches it
# How far the samples of a pixel are from its left edge, in grid steps, from the topmost sample to the lowest.
# There is one for every 1/n of the pixel's height, in the middle of its stripe.
SAMPLE_X = {1: (128,), 4: (96, 224, 32, 160)}

HomogeneousPixels = ti.types.matrix(3, 4, ti.f32)
GridPoint = ti.types.vector(2, ti.i64)
Edge = ti.types.vector(3, ti.f64)  # as `edge` makes it
Rgb = ti.types.vector(3, ti.u8)


class Raster:
    """A picture of fixed size to draw into, again and again. Owns NumPy arrays only: any number may come and go."""

    def __init__(self, width: int, height: int, samples: int = 4) -> None:
        """Size in pixels; `samples` a pixel, 1 or 4. Raises ValueError for anything else."""
        if width < 1 or height < 1:
            raise ValueError(f"a picture has at least 1 x 1 pixels, not {width} x {height}")
        if samples not in SAMPLE_X:
            raise ValueError(f"samples per pixel must be 1 or 4, not {samples}")
        self.width, self.height, self.samples = width, height, samples
        self._sample_x = np.array(SAMPLE_X[samples], np.int32)
        # Row by row of *samples*, so that what a triangle covers of one lies side by side in memory.
        self._nearest = np.zeros(height * samples * width, np.int64)
        self._make_room(0)

    def _make_room(self, triangles: int) -> None:
        """Arrays for so many triangles, as `place` fills them."""
        triangles = -(-triangles // RUN) * RUN
        self._rows = np.empty((triangles, 2), np.int32)
        self._edges = np.empty((triangles, 3, 3), np.float64)
        self._depths = np.empty((triangles, 4, 2), np.float32)
        self._paint = np.empty((triangles, 4, 3), np.float32)

    def draw(self, triangles: DrawMesh, view_projection: np.ndarray, background: Vec3 = BACKGROUND) -> np.ndarray:
        """The picture as uint8 of shape (height, width, 3), row 0 on top.

        `view_projection`, shape (4, 4), acts on columns: clip = view_projection @ (x, y, z, 1). Clip w must be
        the distance along the view axis in metres; x/w and y/w run from -1 to 1 across the picture, y up; z is
        not used. `background`, factors 0…1, is where no triangle is. Raises ValueError for another shape.
        """
        if np.shape(view_projection) != (4, 4):
            raise ValueError(f"view_projection must have shape (4, 4), not {np.shape(view_projection)}")
        x, y, _, w = np.asarray(view_projection, np.float64)
        camera = HomogeneousPixels(np.stack([(w + x) * (self.width / 2), (w - y) * (self.height / 2), w]))
        count = triangles.corners // 3
        if len(self._paint) < count:
            self._make_room(triangles.position.shape[0] // 3)
        picture = np.empty((self.height, self.width, 3), np.uint8)

        place(
            triangles.position,
            triangles.colour,
            count,
            camera,
            self.samples,
            self._rows,
            self._edges,
            self._depths,
            self._paint,
        )
        fill_bands(
            self._runs_of(count),
            self._rows,
            self._edges,
            self._depths,
            self._paint,
            self.samples,
            self._sample_x,
            tm.vec3(background),
            self._nearest,
            picture,
        )
        return picture

    def _runs_of(self, count: int) -> np.ndarray:
        """The first and last row of samples that any of RUN triangles after each other may cover."""
        self._rows[count:] = 0
        first, end = self._rows.reshape(-1, RUN, 2).transpose(2, 0, 1)
        first = np.where(first < end, first, np.iinfo(np.int32).max)
        return np.stack([first.min(axis=1), end.max(axis=1)], axis=1)

    def depth(self) -> np.ndarray:
        """Distance along the view axis of the nearest sample in each pixel of the last picture.

        In metres, float32 of shape (height, width); infinity where all is background.
        """
        nearness = (self._nearest >> 32).astype(np.int32).view(np.float32)
        with np.errstate(divide="ignore"):
            return 1 / nearness.reshape(self.height, self.samples, self.width).max(axis=1)


@ti.kernel
def place(
    position: ti.template(),
    colour: ti.template(),
    count: ti.i32,
    camera: HomogeneousPixels,
    samples: ti.i32,
    rows: ti.types.ndarray(dtype=ti.math.ivec2, ndim=1),
    edges: ti.types.ndarray(dtype=Edge, ndim=2),
    depths: ti.types.ndarray(dtype=tm.vec2, ndim=2),
    paint: ti.types.ndarray(dtype=tm.vec3, ndim=2),
):
    """Where on the screen each of `count` triangles is.

    rows[t]: the first row of samples that it may cover, and the one after the last; equal where it covers none.
    edges[t]: from its topmost corner to its lowest, and by way of the third, as `crossing` takes them.
    depths[t]: a point [pixels], the nearness there and the largest, its slope a pixel, and the least nearness.
    paint[t]: vectors whose products with (x, y, 1) are red, green and blue there, each times a common factor that
    perspective asks for; the last is that factor's.
    """
    for t in range(count):
        p = camera @ tm.vec4(position[3 * t], 1.0)
        q = camera @ tm.vec4(position[3 * t + 1], 1.0)
        r = camera @ tm.vec4(position[3 * t + 2], 1.0)
        rows[t] = tm.ivec2(0, 0)
        # NaN is not greater, so what is not finite ends here. No clipping: a triangle that reaches behind the plane is
        # left out instead.
        if p.z > NEAR and q.z > NEAR and r.z > NEAR:
            a, b, c = p.xy / p.z, q.xy / q.z, r.xy / r.z
            if is_within_reach(a) and is_within_reach(b) and is_within_reach(c):
                near = 1.0 / tm.vec3(p.z, q.z, r.z)
                place_triangle(t, on_grid(a), on_grid(b), on_grid(c), near, colour, samples, rows, edges, depths, paint)


@ti.func
def place_triangle(
    t: ti.i32,
    a: GridPoint,
    b: GridPoint,
    c: GridPoint,
    near: tm.vec3,
    colour: ti.template(),
    samples: ti.i32,
    rows: ti.template(),
    edges: ti.template(),
    depths: ti.template(),
    paint: ti.template(),
):
    """Writes what `place` leaves of a triangle with the corners a, b, c and their nearnesses."""
    ab, ac = b - a, c - a
    area = ab.x * ac.y - ab.y * ac.x
    if area != 0:
        # Gradients of the barycentric coordinates of b and c, per pixel, and of the nearness.
        scale = GRID / ti.cast(area, ti.f32)
        to_b, to_c = scale * tm.vec2(ac.y, -ac.x), scale * tm.vec2(-ab.y, ab.x)
        slope = to_b * (near[1] - near[0]) + to_c * (near[2] - near[0])
        origin = a / GRID
        # A vector whose product with (x, y, 1) is the barycentric coordinate of a corner times its nearness.
        at_a = near[0] * tm.vec3(-to_b - to_c, 1.0 + tm.dot(to_b + to_c, origin))
        at_b, at_c = near[1] * tm.vec3(to_b, -tm.dot(to_b, origin)), near[2] * tm.vec3(to_c, -tm.dot(to_c, origin))
        for k in ti.static(range(3)):
            paint[t, k] = colour[3 * t][k] * at_a + colour[3 * t + 1][k] * at_b + colour[3 * t + 2][k] * at_c
        paint[t, 3] = at_a + at_b + at_c
        depths[t, 0], depths[t, 1] = tm.vec2(origin), slope
        depths[t, 2], depths[t, 3] = tm.vec2(near[0], 0.0), tm.vec2(near.min(), near.max())

        top, middle, bottom = by_height(a, b, c)
        edges[t, 0], edges[t, 1], edges[t, 2] = edge(top, bottom), edge(top, middle), edge(middle, bottom)
        stripe = GRID // samples
        first, end = ceil_div(top.y - stripe // 2, stripe), ceil_div(bottom.y - stripe // 2, stripe)
        rows[t] = tm.ivec2(ti.cast(first, ti.i32), ti.cast(end, ti.i32))


@ti.kernel
def fill_bands(
    runs: ti.types.ndarray(dtype=ti.math.ivec2, ndim=1),
    rows: ti.types.ndarray(dtype=ti.math.ivec2, ndim=1),
    edges: ti.types.ndarray(dtype=Edge, ndim=2),
    depths: ti.types.ndarray(dtype=tm.vec2, ndim=2),
    paint: ti.types.ndarray(dtype=tm.vec3, ndim=2),
    samples: ti.template(),
    sample_x: ti.types.ndarray(dtype=ti.i32, ndim=1),
    background: tm.vec3,
    nearest: ti.types.ndarray(dtype=ti.i64, ndim=1),
    picture: ti.types.ndarray(dtype=Rgb, ndim=2),
):
    """Draws what `place` has placed, in bands of BAND rows of pixels, each by one thread, which writes nothing else."""
    height = picture.shape[0]
    for k in range((height + BAND - 1) // BAND * TASK):
        if k % TASK == 0:
            low = k // TASK * BAND
            high = ti.min(low + BAND, height)
            cover(
                low * samples, high * samples, runs, rows, edges, depths, samples, picture.shape[1], sample_x, nearest
            )
            resolve(low, high, paint, samples, background, nearest, picture)


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
    """Leaves in every sample of rows low … high of `nearest` the key of the nearest triangle, 0 where there is none.

    A key is the bits of the nearness, which are in the order of the (positive) numbers, and below them the
    triangle + 1; the largest wins.
    """
    stripe = ti.static(GRID // samples)
    for k in range(low * columns, high * columns):
        nearest[k] = 0
    for run in range(runs.shape[0]):
        if runs[run].x < high and runs[run].y > low:
            for t in range(run * RUN, (run + 1) * RUN):
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
                        here = row * columns
                        for column in range(begin, stop):
                            # No sample is nearer or farther than all corners, however steep the plane of a sliver.
                            nearness = within(at_begin + (column - begin) * slope.x, limits.x, limits.y)
                            key = ti.cast(ti.bit_cast(nearness, ti.i32), ti.i64) << 32 | t + 1
                            if key > nearest[here + column]:
                                nearest[here + column] = key


@ti.func
def within(x: ti.template(), low: ti.template(), high: ti.template()):
    """x, or the limit it is beyond: two instructions, where `tm.clamp` of a NaN takes ten."""
    raised = ti.select(x < low, low, x)
    return ti.select(raised > high, high, raised)


@ti.func
def is_within_reach(pixel: tm.vec2):
    """Whether both coordinates are within FAR_OUT of 0; false for NaN.

    Compares bits, since fast-math lets the compiler take it that no NaN gets into a comparison of floats.
    """
    size = ti.bit_cast(pixel, ti.i32) & 0x7FFFFFFF
    return size.max() < ti.bit_cast(ti.cast(FAR_OUT, ti.f32), ti.i32)


@ti.func
def on_grid(pixel: tm.vec2):
    """The grid point nearest to a position in pixels."""
    return ti.cast(ti.floor(pixel * GRID + 0.5), ti.i64)


@ti.func
def by_height(a: GridPoint, b: GridPoint, c: GridPoint):
    """The three points from the top down."""
    if b.y < a.y:
        a, b = b, a
    if c.y < a.y:
        a, c = c, a
    if c.y < b.y:
        b, c = c, b
    return a, b, c


@ti.func
def ceil_div(n: ti.i64, d: ti.i64):
    return -(-n // d)


@ti.func
def edge(a: GridPoint, b: GridPoint) -> Edge:
    """For `crossing`: where [pixels] an edge from a down to b is, how much more a grid step down, and its top."""
    drop = ti.cast(ti.max(b.y - a.y, 1), ti.f64)
    return Edge((a.x - 0.5 / drop) / GRID, (b.x - a.x) / (GRID * drop), a.y)


@ti.func
def crossing(e: Edge, x: ti.f64, y: ti.f64, columns: ti.i32) -> ti.i32:
    """First column whose sample, `x` into the pixel, is on or right of an edge, at height y.

    Two triangles find the same at the edge they share, from the same numbers: no sample there is left out or taken
    twice. The quotient of integers n / d rounded up is that of n - 1/2, too, which is never nearer to an integer than
    1/(2 d): doubles are as exact.
    """
    at = within(e.x + e.y * (y - e.z) - x / GRID, 0.0, ti.cast(columns, ti.f64))
    column = ti.cast(at, ti.i32)
    return column + ti.cast(column < at, ti.i32)


@ti.func
def resolve(
    low: ti.i32,
    high: ti.i32,
    paint: ti.template(),
    samples: ti.template(),
    background: tm.vec3,
    nearest: ti.template(),
    picture: ti.template(),
):
    """Writes the mean colour over the samples of each pixel in rows low … high."""
    columns = picture.shape[1]
    for row in range(low, high):
        for column in range(columns):
            owner = ti.cast(nearest[row * samples * columns + column], ti.i32)
            alone = True
            for k in ti.static(range(1, samples)):
                alone &= ti.cast(nearest[(row * samples + k) * columns + column], ti.i32) == owner
            total = background
            if alone:
                if owner > 0:
                    total = colour_at(owner - 1, column + 0.5, row + 0.5, paint)
            else:
                total = mixed(row, column, paint, samples, background, columns, nearest)
            picture[row, column] = ti.cast(total * 255 + 0.5, ti.u8)


@ti.func
def mixed(
    row: ti.i32,
    column: ti.i32,
    paint: ti.template(),
    samples: ti.template(),
    background: tm.vec3,
    columns: ti.i32,
    nearest: ti.template(),
) -> tm.vec3:
    """Mean colour of a pixel that several triangles share."""
    total = tm.vec3(0.0)
    done = 0  # one bit a sample
    for j in range(samples):
        if not done >> j & 1:
            # Colour at the middle of the samples that show this triangle: it lies inside the triangle even
            # where the pixel's own middle does not.
            owner = ti.cast(nearest[(row * samples + j) * columns + column], ti.i32)
            share, x, y = 0, 0.0, 0.0
            for k in ti.static(range(samples)):
                if ti.cast(nearest[(row * samples + k) * columns + column], ti.i32) == owner:
                    done |= 1 << k
                    share += 1
                    x += ti.static(SAMPLE_X[samples][k] / GRID)
                    y += ti.static((k + 0.5) / samples)
            shade = background
            if owner > 0:
                shade = colour_at(owner - 1, column + x / share, row + y / share, paint)
            total += share / samples * shade
    return total


@ti.func
def colour_at(t: ti.i32, x: float, y: float, paint: ti.template()) -> tm.vec3:
    """Colour of triangle t at a point [pixels]."""
    at = tm.vec3(x, y, 1.0)
    mixed = tm.vec3(paint[t, 0].dot(at), paint[t, 1].dot(at), paint[t, 2].dot(at))
    return within(mixed / paint[t, 3].dot(at), tm.vec3(0.0), tm.vec3(1.0))
