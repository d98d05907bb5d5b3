"""Draws triangles without window, display or Vulkan: a z-buffer rasteriser in Taichi.

Two kernels make a picture. `cover` walks the triangles and leaves in every sample the nearest of them;
`resolve` walks the pixels and shades each triangle it meets there once. A pixel has one sample, or four on
a rotated grid: edges near the horizontal or the vertical then get five grey levels (a square grid: three).
Shading is that of Taichi's own window (GGUI), so a scene looks the same in both.

Spaces: a *homogeneous pixel* is (x w, y w, w), with x and y in pixels from the top left corner of the
picture and w the distance from the eye along the view axis in metres. *Nearness* is 1/w: unlike w it is
affine in x and y, so a plane on the screen, and zero is as far as can be. The *grid* is 1/256 of a pixel:
corners and samples sit on it, so that coverage is decided in integers, without rounding.
"""

import numpy as np
import taichi as ti
import taichi.math as tm

from .draw_mesh import DrawMesh, Lighting

NEAR = 0.05  # [m] a triangle with a corner nearer than this is left out
FAR_OUT = 2.0**20  # [pixels] so is one that reaches this far out, lest products of grid lengths overflow

TINY = 1e-30  # under a root, so that a normal without length divides by no 0

GRID = 256  # steps in a pixel
# How far the samples of a pixel are from its left edge, in grid steps, from the topmost sample to the lowest.
# There is one for every 1/n of the pixel's height, in the middle of its stripe.
SAMPLE_X = {1: (128,), 4: (96, 224, 32, 160)}

HomogeneousPixels = ti.types.matrix(3, 4, ti.f32)
GridPoint = ti.types.vector(2, ti.i64)
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
        # One row for each row of *samples*, so that what a triangle covers of it lies side by side in memory.
        self._nearest = np.zeros((height * samples, width), np.int64)
        self._weights = np.empty((0, 3, 3), np.float32)

    def draw(self, triangles: DrawMesh, view_projection: np.ndarray, lighting: Lighting) -> np.ndarray:
        """The picture as uint8 of shape (height, width, 3), row 0 on top.

        `view_projection`, shape (4, 4), acts on columns: clip = view_projection @ (x, y, z, 1). Clip w must be
        the distance along the view axis in metres; x/w and y/w run from -1 to 1 across the picture, y up; z is
        not used. Raises ValueError for another shape.
        """
        if np.shape(view_projection) != (4, 4):
            raise ValueError(f"view_projection must have shape (4, 4), not {np.shape(view_projection)}")
        x, y, _, w = np.asarray(view_projection, np.float64)
        camera = HomogeneousPixels(np.stack([(w + x) * (self.width / 2), (w - y) * (self.height / 2), w]))
        count = triangles.corners // 3
        if len(self._weights) < count:
            self._weights = np.empty((triangles.position.shape[0] // 3, 3, 3), np.float32)
        lights = np.array([(light.position, light.colour) for light in lighting.lights], np.float32).reshape(-1, 2, 3)
        picture = np.empty((self.height, self.width, 3), np.uint8)

        self._nearest.fill(0)
        cover(triangles.position, count, camera, self._sample_x, self._weights, self._nearest)
        resolve(
            triangles.position,
            triangles.normal,
            triangles.colour,
            triangles.two_sided_from // 3,
            self._weights,
            self._nearest,
            self._sample_x,
            lights,
            tm.vec3(lighting.ambient),
            tm.vec3(lighting.background),
            picture,
        )
        return picture

    def depth(self) -> np.ndarray:
        """Distance along the view axis of the nearest sample in each pixel of the last picture.

        In metres, float32 of shape (height, width); infinity where all is background.
        """
        nearness = (self._nearest >> 32).astype(np.int32).view(np.float32)
        with np.errstate(divide="ignore"):
            return 1 / nearness.reshape(self.height, self.samples, self.width).max(axis=1)


@ti.kernel
def cover(
    position: ti.template(),
    count: ti.i32,
    camera: HomogeneousPixels,
    sample_x: ti.types.ndarray(dtype=ti.i32, ndim=1),
    weights: ti.types.ndarray(dtype=tm.vec3, ndim=2),
    nearest: ti.types.ndarray(dtype=ti.i64, ndim=2),
):
    """Leaves in every sample of `nearest` the key of the nearest of `count` triangles, 0 where there is none.

    A key is the bits of the nearness, which are in the order of the (positive) numbers, and below them the
    triangle + 1. The largest key wins: whatever the order of threads, the result is the same to the bit.
    """
    for t in range(count):
        p = camera @ tm.vec4(position[3 * t], 1.0)
        q = camera @ tm.vec4(position[3 * t + 1], 1.0)
        r = camera @ tm.vec4(position[3 * t + 2], 1.0)
        # Clipping at the near plane would make new corners. What is drawn is cut fine, the floor into tiles,
        # so a triangle that reaches behind the plane is left out instead.
        if p.z > NEAR and q.z > NEAR and r.z > NEAR:
            a, b, c = p.xy / p.z, q.xy / q.z, r.xy / r.z
            if is_within_reach(a) and is_within_reach(b) and is_within_reach(c):
                near = 1.0 / tm.vec3(p.z, q.z, r.z)
                cover_triangle(t, on_grid(a), on_grid(b), on_grid(c), near, sample_x, weights, nearest)


@ti.func
def cover_triangle(
    t: ti.i32,
    a: GridPoint,
    b: GridPoint,
    c: GridPoint,
    near: tm.vec3,
    sample_x: ti.template(),
    weights: ti.template(),
    nearest: ti.template(),
):
    """Covers the samples in triangle `t`, whose corners a, b, c have the nearnesses `near`.

    Leaves in weights[t, k] a vector whose product with (x, y, 1) is the barycentric coordinate of corner k on
    the screen times the corner's nearness: what perspective asks for, up to a factor common to the three.
    """
    ab, ac = b - a, c - a
    area = ab.x * ac.y - ab.y * ac.x
    if area != 0:
        # Gradients of the barycentric coordinates of b and c, per pixel, and of the nearness.
        scale = GRID / ti.cast(area, ti.f32)
        to_b, to_c = scale * tm.vec2(ac.y, -ac.x), scale * tm.vec2(-ab.y, ab.x)
        slope = to_b * (near[1] - near[0]) + to_c * (near[2] - near[0])
        origin = a / GRID
        weights[t, 0] = near[0] * tm.vec3(-to_b - to_c, 1.0 + tm.dot(to_b + to_c, origin))
        weights[t, 1] = near[1] * tm.vec3(to_b, -tm.dot(to_b, origin))
        weights[t, 2] = near[2] * tm.vec3(to_c, -tm.dot(to_c, origin))

        samples, columns = sample_x.shape[0], nearest.shape[1]
        stripe = GRID // samples
        top, middle, bottom = by_height(a, b, c)
        first = ti.max(ceil_div(top.y - stripe // 2, stripe), 0)
        end = ti.min(ceil_div(bottom.y - stripe // 2, stripe), nearest.shape[0])
        for row in range(ti.cast(first, ti.i32), ti.cast(end, ti.i32)):
            x, y = sample_x[row % samples], row * stripe + stripe // 2
            upper, lower = top, middle
            if y >= middle.y:
                upper, lower = middle, bottom
            one, other = crossing(top, bottom, x, y), crossing(upper, lower, x, y)
            begin = ti.cast(ti.max(ti.min(one, other), 0), ti.i32)
            stop = ti.cast(ti.min(ti.max(one, other), columns), ti.i32)
            at_begin = near[0] + tm.dot(slope, tm.vec2(begin + x / GRID, y / GRID) - origin)
            for column in range(begin, stop):
                # No sample is nearer or farther than all corners, however steep the plane of a sliver.
                nearness = tm.clamp(at_begin + (column - begin) * slope.x, near.min(), near.max())
                key = ti.cast(ti.bit_cast(nearness, ti.i32), ti.i64) << 32 | t + 1
                ti.atomic_max(nearest[row, column], key)


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
def crossing(a: GridPoint, b: GridPoint, x: ti.i64, y: ti.i64):
    """First column whose sample, `x` into the pixel, is on or right of the edge from a down to b, at height y.

    Exact, so that two triangles agree on it at the edge they share: no sample there is left out or taken twice.
    """
    return ceil_div((a.x - x) * (b.y - a.y) + (b.x - a.x) * (y - a.y), GRID * (b.y - a.y))


@ti.kernel
def resolve(
    position: ti.template(),
    normal: ti.template(),
    colour: ti.template(),
    two_sided_from: ti.i32,
    weights: ti.types.ndarray(dtype=tm.vec3, ndim=2),
    nearest: ti.types.ndarray(dtype=ti.i64, ndim=2),
    sample_x: ti.types.ndarray(dtype=ti.i32, ndim=1),
    lights: ti.types.ndarray(dtype=tm.vec3, ndim=2),
    ambient: tm.vec3,
    background: tm.vec3,
    picture: ti.types.ndarray(dtype=Rgb, ndim=2),
):
    """Writes each pixel's mean colour over its samples. Triangles from `two_sided_from` on are two-sided."""
    samples = sample_x.shape[0]
    for row, column in picture:
        total = tm.vec3(0.0)
        done = 0  # one bit a sample
        for j in range(samples):
            if not done >> j & 1:
                # Shade at the middle of the samples that show this triangle: it lies inside the triangle even
                # where the pixel's own middle does not, and is the pixel's middle where all samples agree.
                owner = ti.cast(nearest[row * samples + j, column], ti.i32)
                share, x, y = 0, 0.0, 0.0
                for k in range(j, samples):
                    if ti.cast(nearest[row * samples + k, column], ti.i32) == owner:
                        done |= 1 << k
                        share += 1
                        x += sample_x[k] / GRID
                        y += (k + 0.5) / samples
                shade = background
                if owner > 0:
                    t = owner - 1
                    place = tm.vec3(column + x / share, row + y / share, 1.0)
                    w = tm.vec3(weights[t, 0].dot(place), weights[t, 1].dot(place), weights[t, 2].dot(place))
                    w /= w.sum()
                    at, facing, albedo = mixed(position, t, w), mixed(normal, t, w), mixed(colour, t, w)
                    shade = tm.clamp(albedo * light_at(at, facing, t >= two_sided_from, ambient, lights), 0.0, 1.0)
                total += share * shade
        picture[row, column] = ti.cast(total * (255 / samples) + 0.5, ti.u8)


@ti.func
def mixed(corners: ti.template(), t: ti.i32, w: tm.vec3):
    return w[0] * corners[3 * t] + w[1] * corners[3 * t + 1] + w[2] * corners[3 * t + 2]


@ti.func
def light_at(at: tm.vec3, normal: tm.vec3, two_sided: ti.i32, ambient: tm.vec3, lights: ti.template()):
    """Ambient and diffuse light on a surface; `normal` of any length, without light for length 0."""
    light = ambient
    for k in range(lights.shape[0]):
        to_light = lights[k, 0] - at
        cosine = to_light.dot(normal) * ti.rsqrt(to_light.norm_sqr() * normal.norm_sqr() + TINY)
        if two_sided:
            cosine = abs(cosine)
        light += tm.max(cosine, 0.0) * lights[k, 1]
    return light
