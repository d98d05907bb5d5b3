"""All references, in the order of the report, and their measurement in parallel processes."""

from __future__ import annotations

import hashlib
import inspect
import os
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

from ...scene.solver_catalog import SOLVER_CATALOG
from ...system import taichi_runtime as runtime
from ...system.errors import UsageError, nearest_hint
from ..stress.store import PACKAGE, files_behind
from ..worker_pool import run_parallel
from . import continuum, drape, elasticity, flight, friction, hanging, strand, swing, symmetry, woven
from .check import ALL, ELASTIC, Reference, Result, measure

IMPLICIT = ("xpbd", "lines", "implicit")
MESHES = ("xpbd", "explicit", "rk4", "implicit")  # for triangle meshes, without `verlet`, which has no SI stiffness
CONTINUUM = tuple(name for name in ELASTIC if "membrane" in SOLVER_CATALOG[name].models)
WOVEN = tuple(name for name in ELASTIC if "weave" in SOLVER_CATALOG[name].models)
WITH_SPRING_DAMPING = ("xpbd", "explicit", "lines", "rk4")  # solvers with spring damping; `implicit` ignores it


REFERENCES = (
    Reference("A1.1", "free fall", "Newton; Euler's steps summed", flight.free_fall, ALL),
    Reference("A1.2", "free fall, all on", "as A1.1", flight.fall_with_all_features, ALL),
    Reference("A1.3", "free fall in float32", "as A1.1", flight.fall_from_heights, ALL),
    Reference("A1.4", "parabola", "as A1.1", flight.parabola, ALL),
    Reference("A1.5", "spin-down", "recursion of a rigid pair's angle", flight.spin, ALL),
    Reference("A1.6", "momentum", "conservation", flight.momentum, ALL),
    Reference("A1.7", "damping", "e^(−ct)", flight.damping, ALL),
    Reference(
        "A2.1",
        "pendulum",
        "complete elliptic integral",
        swing.pendulum,
        ALL,
    ),
    Reference("A2.2", "one spring", "the method's own discrete law", swing.one_spring, ELASTIC),
    Reference(
        "A2.3",
        "hanging strip",
        "zeros of Laguerre's L20",
        swing.curtain_modes,
        ALL,
    ),
    Reference("A2.4", "taut strip", "2√(T/ma)·sin(jπ/2N)", swing.taut_strip, ELASTIC),
    Reference(
        "A2.5",
        "taut square",
        "Poisson's five points; springs under tension",
        elasticity.drum,
        ELASTIC,
    ),
    Reference("A2.6", "strip along itself", "2√(k/m)·sin((2j−1)π/(4N+2))", swing.longitudinal_swing, ELASTIC),
    Reference("A2.7", "damped spring", "e^(−ζωt)·(cos + sin)", swing.damped_spring, WITH_SPRING_DAMPING),
    Reference(
        "A2.8",
        "pendulum's height",
        "conservation",
        swing.pendulum_height,
        ALL,
    ),
    Reference("A3.1", "hanging sheet", "sum of the weights below", hanging.elongation, ELASTIC),
    Reference("A3.2", "artificial stretch", "fixed point of a red-black sweep", hanging.stretch, ("verlet", "xpbd")),
    Reference("A3.3", "hammock", "equilibrium of its springs", hanging.hammock, ELASTIC),
    Reference("A3.4", "buckling", "Euler's elastica", elasticity.buckling, ELASTIC),
    Reference("A3.5", "reaction forces", "weight; half of it by symmetry", hanging.held, ELASTIC),
    Reference("A4.1", "doubling", "linear bending", elasticity.doubling, ELASTIC),
    Reference(
        "A4.2",
        "doubling, springs",
        "linear bending",
        elasticity.doubling_by_springs,
        ELASTIC,
    ),
    Reference("A4.3", "cantilever", "heavy elastica", elasticity.droop, ELASTIC),
    Reference("A4.4", "pear loop", "elastica", elasticity.loop, ELASTIC),
    Reference("A4.5", "tip load", "elastica with both weights", elasticity.tip_load, ELASTIC),
    Reference(
        "A4.6",
        "drape coefficient",
        "published measurements, by which the bending of all four fabrics was chosen",
        drape.drape,
        MESHES,
    ),
    Reference(
        "A5.1",
        "stiffness of a grid",
        "homogenised springs",
        elasticity.modulus,
        ELASTIC,
    ),
    Reference("A5.2", "shear of a grid", "homogenised springs", elasticity.panel, ELASTIC),
    Reference("A6.1", "fall in air", "½ρC_D·v² = σg; tanh", flight.falling, ALL),
    Reference(
        "A6.2",
        "sail",
        "−b·ln cos(x/b); (H/p)(t + t³/3)",
        flight.sail,
        ALL,
    ),
    Reference("A7.1", "sliding to a stop", "v²/(2μg), Coulomb", friction.stopping, ALL),
    Reference("A7.2", "rest on the ground", "-", friction.resting, ALL),
    Reference("A7.3", "incline", "tan θ = μ; g·(sin θ − μ·cos θ)", friction.incline, ALL),
    Reference(
        "A7.4",
        "scarf over a bar",
        "capstan with weight",
        friction.scarf,
        ALL,
    ),
    Reference("A7.5", "capstan", "e^(μφ)", friction.capstan, ELASTIC),
    Reference("A8.1", "rest shape", "-", symmetry.at_rest, ALL),
    Reference("A8.2", "rotation", "-", symmetry.rotated, ALL),
    Reference("A8.3", "mirror", "-", symmetry.mirrored, ALL),
    Reference("A8.4", "far from the origin", "-", symmetry.far_away, ALL),
    Reference("A8.5", "order", "the same curtain in float64", symmetry.order, ELASTIC),
    Reference(
        "A8.6",
        "energy",
        "conservation",
        symmetry.energy,
        ELASTIC,
    ),
    Reference("A8.7", "mesh, hammock", "-", hanging.finer_hammock, ALL),
    Reference("A8.8", "on a ball", "-", friction.on_a_ball, ALL),
    Reference("A8.9", "mesh, swinging curtain", "-", symmetry.finer_curtain, ALL),
    Reference("A8.10", "transposition", "-", symmetry.transposed, ALL),
    Reference("A9.1", "patch test", "affine deformation; C of the fabric", continuum.patch, CONTINUUM),
    Reference("A9.2", "membrane pulled", "1/E = S11·c⁴ + S22·s⁴ + (2·S12 + S66)·s²c²", continuum.pull, CONTINUUM),
    Reference("A9.3", "picture frame", "sin γ·cos γ/sin(π/4 − γ/2)", continuum.picture_frame, CONTINUUM),
    Reference("A9.4", "bias extension", "π/2 − 2·acos((1 + d/H)/√2)", continuum.bias_extension, CONTINUUM),
    Reference("A9.5", "bending by direction", "heavy elastica", continuum.two_cantilevers, CONTINUUM),
    Reference("A9.7", "strip on five meshes", "heavy elastica; Rayleigh's beam", drape.strip_on_meshes, CONTINUUM),
    Reference("A9.8", "weave", "the curves that were typed in", woven.curves, WOVEN),
    Reference(
        "B1",
        "swinging curtain",
        "float64, converged",
        swing.swinging_curtain,
        ALL,
    ),
    Reference("B3", "iterations", "sum of the weights below", hanging.independence, ("xpbd", "lines")),
    Reference("B4", "substeps or iterations", "the method in float64", hanging.split, ("xpbd",)),
    Reference("B5", "force of a chain", "Newton's method in float64", strand.force, ("xpbd",)),
    Reference("B6.1", "heavy strand at rest", "sum of the weights below", strand.at_rest, IMPLICIT),
    Reference(
        "B6.2",
        "heavy strand: residual",
        "its own equation",
        strand.residual,
        IMPLICIT,
    ),
    Reference(
        "B6.3",
        "heavy strand: strains",
        "Newton's method in float64",
        strand.strains,
        IMPLICIT,
    ),
)


def select_pairs(only: str | None, solver: str | None) -> list[tuple[Reference, str]]:
    """Return pairs of a reference and one of its solvers.

    `only` keeps the references whose number begins with it, `solver` keeps one solver. Raises UsageError if none is
    left.
    """
    pairs = [
        (reference, name)
        for reference in REFERENCES
        for name in reference.solvers
        if reference.number.startswith(only or "") and solver in (None, name)
    ]
    if not pairs:
        numbers = [reference.number for reference in REFERENCES]
        with_solver = f" with {solver}" if solver else ""
        raise UsageError(
            f"no reference {only!r}{with_solver}; choose from {', '.join(numbers)}{nearest_hint(only, numbers)}"
        )
    return pairs


CORES = os.cpu_count() or 1
start_worker = partial(runtime.start, "cpu", cpu_max_num_threads=1)
BY_NUMBER = {reference.number: reference for reference in REFERENCES}
SLOWEST_FIRST = (
    "implicit",
    "rk4",
    "xpbd",
    "lines",
    "explicit",
    "verlet",
)  # slowest first: no core waits long for another


def measure_all(pairs: Sequence[tuple[Reference, str]], on_step: Callable[[str], None]) -> list[Result]:
    """Return the rows of every pair of a reference and a solver, in order.

    One pair runs in this process, more run in as many processes as there are cores.
    """
    if len(pairs) == 1 or CORES == 1:
        return measure_serially(pairs, on_step)
    order = sorted(range(len(pairs)), key=lambda k: SLOWEST_FIRST.index(pairs[k][1]))
    jobs = {k: (pairs[k][0].number, pairs[k][1]) for k in order}
    rows: dict[int, list[Result]] = {}
    with closing(run_parallel(measure_pair, jobs, min(CORES, len(pairs)), start_worker)) as results:
        for k, result in results:
            rows[k] = result
            on_step(name_of(*pairs[k]))
    return [result for k in range(len(pairs)) for result in rows[k]]


def measure_serially(pairs: Sequence[tuple[Reference, str]], on_step: Callable[[str], None]) -> list[Result]:
    """Return the rows of every pair, measured in this process."""
    start_worker()
    results = []
    for reference, solver in pairs:
        on_step(name_of(reference, solver))
        results += with_origin(reference, solver)
    return results


def measure_pair(number: str, solver: str) -> list[Result]:
    """Return the rows of one pair."""
    return with_origin(BY_NUMBER[number], solver)


def with_origin(reference: Reference, solver: str) -> list[Result]:
    """Measure a pair, and return its rows with the digest of its sources."""
    return [replace(result, origin=origin_of(reference.number, solver)) for result in measure(reference, solver)]


@cache
def origin_of(number: str, solver: str) -> str:
    """Return the digest of the sources of a pair, 12 hex digits: of its setup, its solver and all that they import."""
    setup = inspect.getfile(BY_NUMBER[number].run)
    roots = {Path(setup).relative_to(PACKAGE).as_posix(), f"solvers/{solver}.py"}  # a solver is loaded by name
    words = [f"{name} {digest}" for name, digest in sorted(files_behind(frozenset(roots)))]
    return hashlib.sha256("\n".join(words).encode()).hexdigest()[:12]


def earlier_count(results: Sequence[Result]) -> int:
    """Return how many results were measured with other sources than the present ones."""
    present = {(reference.number, solver) for reference, solver in select_pairs(None, None)}
    keys = [(one.number, one.solver) for one in results]
    return sum(key not in present or one.origin != origin_of(*key) for key, one in zip(keys, results, strict=True))


def name_of(reference: Reference, solver: str) -> str:
    """Return the name of a pair for the progress display."""
    return f"{reference.number} {reference.name}, {solver}"
