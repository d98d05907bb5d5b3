"""How far a hanging sheet is from hanging still when iterations end too early: formulas, nothing is simulated.

In each substep of h seconds every particle falls by g·h², and red-black sweeps over the springs take that back. On a
sheet of N rows below its pins, with springs of k [N/m] and particles of m [kg], what a sweep leaves of an error is

    ρ = (2w/(2w + α))² = 1/(1 + m/(2kh²))²,    w = 1/m, α = 1/(kh²)

and where falling and sweeping are in balance, i sweeps leave κ·(1 − ρ)·ρ^(i−1)/(1 − ρ^i) of the elastic elongation,
with κ = kh²/m. Stiff springs have ρ → 1, and it becomes κ/i: the stretch ½·N²·g·h²/i, whatever the fabric (Müller's
position-based dynamics has nothing else). Both are for springs along the threads; diagonals carry a third of it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..mesh.topology import Topology
from ..scene.model import Scene

GRAVITY = 9.81  # [m/s²] the default of a scene


def unfinished_share(constant: float, mass: float, h: float, iterations: int) -> float:
    """How much longer a sheet hangs than its springs [N/m] and masses [kg] say, over the elongation that they say."""
    ratio = constant * h * h / mass
    left = 1 / (1 + 1 / (2 * ratio)) ** 2
    if left > 1 - 1e-9:
        return ratio / iterations
    return float(ratio * (1 - left) * left ** (iterations - 1) / (1 - left**iterations))


def artificial_stretch(rows: int, h: float, iterations: int, gravity: float = GRAVITY) -> float:
    """How much longer [m] a sheet hangs whose springs cannot be stretched: ½·N²·g·h²/i."""
    return 0.5 * rows**2 * gravity * h * h / iterations


DIAGONALS_TAKE = 2 / 3  # of the stretch that is left without them: ⅓·N²·g·h²/i
MOST_SEEN = 2048  # particles, and pins, between which distances are looked at
TOLD_STRETCH, TOLD_SHARE = 1e-3, 1e-2  # of the length that hangs; of its elastic elongation


def rows_below(topology: Topology) -> int:
    """Springs between the particle that is farthest from all pins and the nearest one; 0 without pins."""
    threads = topology.rest[topology.family("structural")]
    if not topology.pinned.any() or not len(threads):
        return 0
    pins, others = (every(topology.flat[which]) for which in (topology.pinned, ~topology.pinned))
    if not len(others):
        return 0
    nearest = np.full(len(others), np.inf)
    for pin in pins:
        nearest = np.minimum(nearest, ((others - pin) ** 2).sum(axis=1))
    return round(float(np.sqrt(nearest.max()) / np.median(threads)))


def every(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """No more of them than are looked at, evenly; the first and the last one too."""
    some = np.linspace(0, len(points) - 1, min(len(points), MOST_SEEN)).astype(int)
    seen: NDArray[np.float64] = points[np.unique(some)]
    return seen


def unfinished(scene: Scene, topology: Topology, h: float, iterations: int) -> str:
    """One line where iterations end before hanging cloth hangs still, else nothing. `h`: of a substep [s]."""
    rows, gravity = rows_below(topology), abs(scene.forces.gravity)
    if not rows or not gravity:
        return ""
    took = DIAGONALS_TAKE if len(topology.family("shear")) else 1.0
    if scene.solver.name == "verlet":
        rest = float(np.median(topology.rest[topology.family("structural")]))
        stretch = took * artificial_stretch(rows, h, iterations, gravity) / (rows * rest)
        return f"unfinished: stretches {100 * stretch:.1f} % beyond its constants" if stretch >= TOLD_STRETCH else ""
    if scene.solver.name == "xpbd":
        mass = float(np.median(topology.mass))
        share = took * unfinished_share(max(scene.fabric.warp, scene.fabric.weft), mass, h, iterations)
        return (
            f"unfinished: its elongation is {100 * share:.0f} % more than its constants say"
            if share >= TOLD_SHARE
            else ""
        )
    return ""
