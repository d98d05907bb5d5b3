"""B5 and B6: stiff strands at one substep, against the same steps solved by Newton's method."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from math import cos, radians

import numpy as np

from ..mesh.from_scene import stiffness_of
from ..scene.model import FRAME_SECONDS, Fabric, Forces, Scene, Solver, Springs
from ..simulation import Simulation
from . import newton
from .exact import GRAVITY, Floats
from .newton import Chain
from .row import Row, at_most, relative
from .setups import SETTLING, Timed, advance, base

CONSTANT = 1e8  # [N/m]
SWEEPS = ((50, 6e-2), (100, 2e-2), (1000, 5e-3))  # iterations, and how wrong the force may be (Macklin 2016, 6.2)
FORCE_FRAMES = (75, 100)  # those that are judged: at first there is hardly any force

# The strand of TinyVBD (A. Chen, `main.cpp`): 20 particles of 1 kg, the last one 1000 times as heavy, 100 iterations.
LINKS = 19
LINK = 0.05 / cos(radians(30))  # [m]
HEAVY = 1000.0  # [kg]
SKIP = 100.0  # [N/m] of springs to the particle after the next
STRAND_GRAVITY = 10.0  # [m/s²]
STRAND_ITERATIONS = 100
BELOW = 30.0  # [degrees] under level, where it starts; pushed together, as above, it could fold in many ways
STRAND_FRAMES = 60
STRAND = (2e-2, 1e-3)
RESIDUAL = (10.0, 2.0)  # weights of a particle


def strands(solver: str, links: int, link: float, iterations: int, below: float) -> Scene:
    """Two chains of particles of 1 kg side by side, not joined, held at their upper ends, `below` [degrees] level."""
    scene = base(
        solver,
        links + 1,
        2,
        width=link,
        height=links * link,
        lumping="equal",
        area_density=1 / link**2,
        pins=("top",),
        rotation=(below - 90.0, 0.0, 0.0),
    )
    return replace(
        scene,
        springs=Springs(shear=0.0, bend=0.0),
        fabric=Fabric(warp=CONSTANT, weft=0.0, shear=0.0, bend=0.0),
        solver=Solver(solver, 1, iterations, damping=0.0),
    )


def heavy_strand(solver: str, below: float, skip: float) -> Scene:
    """TinyVBD's strand, with its last link as long as the others."""
    scene = strands(solver, LINKS, LINK, STRAND_ITERATIONS, below)
    return replace(
        scene,
        cloth=replace(scene.cloth, weight=HEAVY - 1.0),
        springs=replace(scene.springs, bend=float(skip > 0)),
        fabric=replace(scene.fabric, bend=skip),
        forces=Forces(gravity=STRAND_GRAVITY),
    )


def chain_of(simulation: Simulation) -> Chain:
    """The left one of two strands."""
    topology, scene = simulation.topology, simulation.scene
    own = (topology.ends % 2 == 0).all(axis=1)
    constant = stiffness_of(scene, simulation.solver.springs, topology)
    return Chain(topology.mass[::2], topology.ends[own] // 2, topology.rest[own], constant[own], scene.forces.gravity)


def left(vectors: Floats) -> Floats:
    """Of the left strand, (forward, up)."""
    found: Floats = vectors[::2, [2, 1]]
    return found


def force(solver: str) -> Iterator[Row]:
    """What holds a chain of 20 particles that is let go level: what its momentum does not gain of its weight."""
    for iterations, most in SWEEPS:
        with Timed(strands(solver, 20, 1.0, iterations, 0.0)) as simulation:
            chain = chain_of(simulation)
            x = left(simulation.positions())
            v = before = left(simulation.velocities())
            held, exact = [], []
            for _ in range(FORCE_FRAMES[1]):
                simulation.advance_frame()
                after = left(simulation.velocities())
                gained = chain.mass[1:] @ (after - before)[1:] / FRAME_SECONDS
                held.append(float(np.hypot(gained[0], gained[1] + chain.mass[1:].sum() * GRAVITY)))
                before = after
                x, v, tension = newton.euler(chain, x, v, FRAME_SECONDS)
                exact.append(float(tension[0]))
        judged = slice(FORCE_FRAMES[0] - 1, None)
        wrong = np.abs(np.array(held) / np.array(exact) - 1)[judged]
        k = FORCE_FRAMES[0] - 1 + int(wrong.argmax())
        name = f"{iterations} iterations: force on the pin at frame {k + 1} [N]"
        yield relative(name, exact[k], held[k], most, most / 10)


def at_rest(solver: str) -> Iterator[Row]:
    """How much longer it hangs."""
    scene = heavy_strand(solver, 90.0, 0.0)
    with Timed(replace(scene, solver=replace(scene.solver, damping=SETTLING))) as simulation:
        chain = chain_of(simulation)
        start = left(simulation.positions())
        advance(simulation, 10.0)
        carried = chain.mass[::-1].cumsum()[-2::-1] * STRAND_GRAVITY  # [N] by each link, from the top
        exact = float((carried / CONSTANT).sum())
        yield relative("longer by [m]", exact, float((start - left(simulation.positions()))[-1, 1]), *STRAND)


def residual(solver: str) -> Iterator[Row]:
    """How far from solved its steps are, in weights of a particle: of 1000 that it carries, float32 leaves about 2."""
    with Timed(heavy_strand(solver, BELOW, SKIP)) as simulation:
        chain = chain_of(simulation)
        x, v = left(simulation.positions()), left(simulation.velocities())
        residuals = []
        for _ in range(STRAND_FRAMES):
            simulation.advance_frame()
            x_new, v_new = left(simulation.positions()), left(simulation.velocities())
            h, y = FRAME_SECONDS, newton.without_springs(chain, x, v, FRAME_SECONDS)
            if solver == "lines":
                h, y = second_stage(chain, x, v, x_new, v_new)
            residuals.append(float(newton.residual(chain, y, x_new, h).max()))
            x, v = x_new, v_new
        yield at_most(f"residual of a step, over {STRAND_GRAVITY:g} N", max(residuals) / STRAND_GRAVITY, *RESIDUAL)


def second_stage(chain: Chain, x: Floats, v: Floats, x_new: Floats, v_new: Floats) -> tuple[float, Floats]:
    """(length [s], y) of the second stage of a substep of `lines`, from what is seen before and after."""
    h = newton.GAMMA * FRAME_SECONDS
    middle = x_new - h * v_new
    first = (middle - x) / ((1 - newton.GAMMA) * FRAME_SECONDS)  # velocity after the first stage
    jumped = v + (first - v) * (1 - newton.GAMMA) / newton.GAMMA
    return h, newton.without_springs(chain, middle, jumped, h)


def strains(solver: str) -> Iterator[Row]:
    """Its links stretch as in the same steps, solved to the end."""
    step = newton.two_stages if solver == "lines" else newton.euler
    with Timed(heavy_strand(solver, BELOW, SKIP)) as simulation:
        chain = chain_of(simulation)
        links = chain.constant == CONSTANT
        x, v = left(simulation.positions()), left(simulation.velocities())
        errors, exact = [], []
        for _ in range(STRAND_FRAMES):
            simulation.advance_frame()
            x, v, _ = step(chain, x, v, FRAME_SECONDS)
            exact.append(chain.strains(x)[links])
            errors.append(np.abs(chain.strains(left(simulation.positions()))[links] - exact[-1]).max())
        largest = float(np.abs(exact).max())
        yield Row("largest error of a strain", largest, largest + max(errors), max(errors) / largest, *STRAND)
