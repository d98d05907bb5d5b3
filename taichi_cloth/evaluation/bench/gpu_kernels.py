"""Kernels of `bench --gpu`: a copy, the error of the swinging curtain, and its converged motion on fine grids."""

import time
from typing import NamedTuple

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from ...kernels.tensor_fields import f32_matrix
from ...scene.schema import FRAME_SECONDS
from ...state import ClothState
from ...system.files import cached
from ...system.taichi_compat import DeviceArray
from .error_sweep import FRAMES, GRAVITY, Curtain

Floats = NDArray[np.float64]

f32_list = ti.types.ndarray(dtype=ti.f32, ndim=1)
f64_matrix = ti.types.ndarray(dtype=ti.f64, ndim=2)

COPY_SECONDS = 1.0  # most time of `copy_bandwidth`
COPIES = 20  # launches between two synchronizations: the time of a launch must not count
# h·ω of the highest frequency in the coarser of two runs. The method is stable below 2; grids of up to 256 cells take
# the step of 256 cells, since it costs nothing.
MAX_PHASE, FREE_CELLS = 1.0, 256


@ti.kernel
def copy(source: f32_list, target: f32_list):
    for i in range(source.shape[0]):
        target[i] = source[i]


def copy_bandwidth(size: int) -> float:
    """Return the bytes that a copy of `size` bytes reads and writes in a second: the best of several rounds."""
    source, target = DeviceArray((size // 4,)), DeviceArray((size // 4,))
    rates, count, end = [], 1, time.perf_counter() + COPY_SECONDS
    copy(source, target)  # compiles
    ti.sync()
    while len(rates) < 2 or (time.perf_counter() < end and len(rates) < 20):
        start = time.perf_counter()
        for _ in range(count):
            copy(source, target)
        ti.sync()
        seconds = time.perf_counter() - start
        rates.append(count * 2 * size / seconds)
        count = max(1, min(COPIES, int(COPY_SECONDS / 10 / seconds * count)))
    source.free()
    target.free()
    return max(rates)


@ti.kernel
def sum_distances(x: ti.template(), expected: f32_matrix, columns: int, result: f32_matrix):
    """Set the sum of squared distances [m²] and the largest distance [m] of each row of particles, (rows, 2).

    `expected`: position of each row, forward and up. One thread sums a row, so the sums are equal every time.
    """
    for row in range(expected.shape[0]):
        squares, largest = 0.0, 0.0
        for column in range(columns):
            at = x[row * columns + column]
            forward, up = at.z - expected[row, 0], at.y - expected[row, 1]
            square = forward * forward + up * up
            squares += square
            largest = ti.max(largest, square)
        result[row, 0], result[row, 1] = squares, ti.sqrt(largest)


def curtain_distances(cloth: ClothState, origin: Floats, expected: Floats) -> tuple[float, float]:
    """Return the mean squared distance [m²] and the largest distance [m] of a curtain's particles from its rows.

    `expected`: position of every row, forward and up [m], (rows, 2). `origin` [m]: of the cloth's positions. The result
    is not finite if a position is not.
    """
    rows = len(expected)
    result = np.zeros((rows, 2), np.float32)
    sum_distances(cloth.x, (expected - origin[[2, 1]]).astype(np.float32), rows, result)
    squares = result[:, 0].astype(np.float64)
    return float(squares.mean() / rows), float(result[:, 1].max())


@ti.kernel
def swing_frame(
    x: f64_matrix, v: f64_matrix, steps: int, h: ti.f64, rest: ti.f64, stiffness_over_mass: ti.f64, gravity: ti.f64
):
    """Advance the chain of `error_sweep` by `steps` steps of velocity Verlet on one thread, in float64."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        last = x.shape[0] - 1
        for s in range(steps + 1):
            kick = h
            if s == 0 or s == steps:
                kick = h / 2
            above_forward, above_up = h * 0, h * 0  # acceleration by the spring above, of type float64
            for i in range(last):
                forward, up = x[i + 1, 0] - x[i, 0], x[i + 1, 1] - x[i, 1]
                factor = stiffness_over_mass * (1 - rest / ti.sqrt(forward * forward + up * up))
                forward, up = forward * factor, up * factor
                if i > 0:  # the first particle is pinned
                    v[i, 0] += kick * (forward - above_forward)
                    v[i, 1] += kick * (up - above_up - gravity)
                above_forward, above_up = forward, up
            v[last, 0] -= kick * above_forward
            v[last, 1] -= kick * (above_up + gravity)
            if s < steps:
                for i in range(1, last + 1):
                    x[i, 0] += h * v[i, 0]
                    x[i, 1] += h * v[i, 1]


def swing(curtain: Curtain, frames: int, max_phase: float) -> Floats:
    """Return the position of every row after each frame, (frames, cells + 1, 2) [m], with steps of h·ω ≤ `max_phase`.

    It takes seconds where `error_sweep.curtain_solution`, which NumPy computes, takes minutes.
    """
    steps = int(np.ceil(curtain.max_frequency * FRAME_SECONDS / max_phase))
    x, v = curtain.start.copy(), np.zeros((curtain.cells + 1, 2))
    positions = []
    for _ in range(frames):
        swing_frame(x, v, steps, FRAME_SECONDS / steps, curtain.rest, curtain.stiffness / curtain.mass, GRAVITY)
        positions.append(x.copy())
    return np.array(positions)


class Swing(NamedTuple):
    """The motion of the curtain in float64, for one second."""

    positions: Floats
    """Position of every row after each frame, forward and up, (frames, cells + 1, 2) [m]."""
    rms_uncertainty: float
    """Root mean square distance from the motion with twice the step [m]."""
    max_uncertainty: float
    """Largest distance from it [m]: on fine grids that of the free edge, which amplifies every difference."""


def converged_swing(cells: int) -> Swing:
    """Return the motion of the curtain. It is cached on disk."""
    curtain, phase = Curtain(cells), min(MAX_PHASE, MAX_PHASE * cells / FREE_CELLS)
    coarse, fine = cached(
        f"swing {curtain} {FRAMES}",
        lambda: np.stack([swing(curtain, FRAMES, phase), swing(curtain, FRAMES, phase / 2)]),
    )
    distances = np.linalg.norm(fine - coarse, axis=2)
    return Swing(fine, float(np.sqrt((distances**2).mean())), float(distances.max()))
