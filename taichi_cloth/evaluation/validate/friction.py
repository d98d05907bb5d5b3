"""A7 and A8.8: contact and friction."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache, partial
from itertools import islice
from math import atan, degrees, exp, pi, sqrt

import numpy as np

from ...collision.colliders import SURFACE_TOLERANCE, PosedCollider, signed_distance
from ...scene.collider_schema import Capsule, Ground, Plane, Sphere
from ...scene.schema import FRAME_SECONDS, Forces, Scene
from ...simulation.simulation import Simulation
from ..reference.solution import Motion, steps_per_frame
from .check import (
    FAIL,
    SAME_ITERATIONS,
    Check,
    Timed,
    advance,
    at_most,
    base,
    center,
    damped,
    relative,
    run_with_limit,
    strip,
    substep,
)
from .exact import GRAVITY, Floats, scarf_ratio
from .float64_steps import lines_in_float64, swept_in_float64
from .symmetry import ORDER_OF_SPRINGS

FRICTIONS = (0.1, 0.3, 0.5)
SPEED = 1.0  # [m/s]
STOPPING = (0.05, 0.01)  # A7: 5 %, 1 %
CREEP = (1e-3, 1e-5)  # [m] A7: 1 mm, 0.01 mm
CREEP_SECONDS = 10.0  # A7, from the start
KINETIC = (1e-6, 1e-10)  # [J/kg] A7
STILL = (2e-5, 2e-7)  # [m] in a frame, of a particle with those kinetic energies
SWING_DAMPING = 5.0  # [1/s] with it an exact swing of 1 m/s moves less than 1 µm in a frame 4 s later: exp(−½·5·4)
DEPTH = (1e-4, 1e-9)  # [m] in a ground without margin
SCARF = (0.1, 0.03)  # A7: 10 %, 3 %
SLIDING = (0.2, 0.4, 0.57)  # friction coefficients on a slope of 30°
WRAPS = (pi / 2, pi, 2 * pi)  # [rad] wrap angles around a bar
WRAP_FRICTIONS = (0.3, 0.5)
WRAP_RADIUS, WRAP_END, WRAP_LINK = 0.1, 0.3, 0.01  # [m] radius of the bar, length of a free end, length of a link
WRAP_TIGHT = 0.02  # initial strain of the strip
WRAP_SPIN = 180.0  # [degrees/s] of the bar, which slides under the strip
WRAP_SECONDS = 4.0
SPHERE_MARGIN = 0.02  # [m] margin of the ball that cloth rests on
THICKNESS = (0.1, 0.0)  # A7: a tenth of the thickness, nothing
SLOPES = (0.1, 0.3, 0.5, 0.8)  # friction coefficients for which the slope is searched at which a sheet starts to slide
SLIP = 2e-3  # [m] in a second: sliding cloth moves more, 1 % above the angle where it starts, and sticking cloth less
HALVINGS = 9  # bisections of the range from 0.25 to 1.75 of the exact value: to 0.2 %
BAR, SHORT_END, SCARF_LINKS = 0.03, 0.3, 120  # [m] radius of the bar, shorter end of the scarf
LEVEL = (-90.0, 0.0, 0.0)
ON_A_BALL = (1e-3, 1e-6)  # A8: 1e-3·L, 1e-6·L at 2 s
SWEEPING = ("verlet", "lines")  # whose iterations pass over the springs in an order that images do not have
BALL_SECONDS, UNFOLDED_SECONDS = 2.0, 0.2  # A8; rounding has grown little by then
BALL = Sphere(center=(0.0, -0.36, 0.0), radius=0.3, margin=0.05, friction=0.5)
SLIPS_EARLY = f"iterations end too early: {SAME_ITERATIONS} slip as early"
FOLDS = "the exact folds are unstable: in float64 too, rounding to 1e-16 grows to such differences"


def stopping(solver: str) -> Iterator[Check]:
    """Measure how far a sheet slides on the ground until friction has used up its energy: v²/(2μg)."""
    for friction in FRICTIONS:
        ground = Ground(height=0.0, margin=0.0, friction=friction)
        with Timed(replace(base(solver, rotation=LEVEL), ground=ground)) as simulation:
            advance(simulation, 0.2)
            x = simulation.positions()
            simulation.set_state(x, (SPEED, 0.0, 0.0))
            start = center(simulation)[0]
            advance(simulation, SPEED / (friction * GRAVITY) + 0.5)
            exact = SPEED**2 / (2 * friction * GRAVITY)
            yield relative(
                f"way to a stop from 1 m/s, μ = {friction:g} [m]", exact, center(simulation)[0] - start, *STOPPING
            )


def resting(solver: str) -> Iterator[Check]:
    """Measure sheets 5 s after a drop of 5 cm on the ground, and on a ball.

    They must be at rest, on the collider and not in it. With less damping, free corners would still swing.
    """
    scene = replace(base(solver, rotation=LEVEL, center=(0.0, 0.05, 0.0)), ground=Ground(height=0.0, margin=0.0))
    with Timed(scene) as simulation:
        advance(simulation, 5.0)
        yield from still(simulation, "the ground")
        yield at_most("depth in the ground [m]", simulation.metrics().penetration, *DEPTH)
        drift = float(np.linalg.norm(center(simulation)[[0, 2]]))
        yield at_most("creep over the ground [m]", drift, *CREEP)
    ball = Sphere(center=(0.0, -0.35, 0.0), radius=0.3, margin=SPHERE_MARGIN, friction=0.5)
    scene = replace(base(solver, 17, 17, rotation=LEVEL), spheres=(ball,))
    scene = replace(scene, solver=replace(scene.solver, damping=SWING_DAMPING))
    with Timed(scene) as simulation:
        advance(simulation, 5.0)
        yield from still(simulation, f"a ball, damping {SWING_DAMPING:g}/s")
        [posed] = simulation.colliders()
        share = depth_in_margin(posed, simulation.positions()[~simulation.topology.pinned])
        yield at_most("depth in a ball, of the thickness", share, *THICKNESS)


def depth_in_margin(posed: PosedCollider, points: Floats) -> float:
    """Return the depth of the deepest of points (N, 3) in a collider's margin, as a share of it, at least 0.

    The penetration of `metrics` begins below the margin, at the surface as drawn.
    """
    margin = posed.collider.margin
    return float(np.maximum(margin - signed_distance(posed, points).min(), 0.0)) / margin  # NaN stays NaN


def still(simulation: Simulation, on: str) -> Iterator[Check]:
    """Measure the kinetic energy of a sheet at rest, and the motion of its fastest particle."""
    before = simulation.positions()
    simulation.step()
    energy = 0.5 * float(np.average((simulation.velocities() ** 2).sum(axis=1), weights=simulation.topology.mass))
    yield at_most(f"kinetic energy per mass after 5 s on {on} [J/kg]", energy, *KINETIC)
    distance = float(np.linalg.norm(simulation.positions() - before, axis=1).max())
    yield at_most(f"way of the fastest particle in the next frame on {on} [m]", distance, *STILL)


def on_slope(solver: str, tangent: float, friction: float) -> Scene:
    """Return the scene of a sheet that lies on a slope that falls toward −x."""
    angle = degrees(atan(tangent))
    slope = Plane(rotation=(0.0, 0.0, angle), margin=0.0, friction=friction)
    return replace(base(solver, rotation=(-90.0, 0.0, angle)), planes=(slope,))


def incline(solver: str) -> Iterator[Check]:
    """Measure a sheet on an incline.

    It slides if the slope is steeper than the friction, tan θ > μ, with the acceleration g·(sin θ − μ·cos θ). Otherwise
    it stays.
    """
    for friction in SLOPES:

        def slides(share: float, friction: float = friction) -> bool:
            with Timed(on_slope(solver, share * friction, friction)) as simulation:
                advance(simulation, 1.0)
                return float(np.linalg.norm(center(simulation))) > SLIP

        yield relative(
            f"slope where it slides, μ = {friction:g}", friction, friction * find_threshold(slides), *STOPPING
        )
        with Timed(on_slope(solver, 0.9 * friction, friction)) as simulation:
            before = simulation.positions()
            advance(simulation, CREEP_SECONDS)
            creep = float(np.linalg.norm(simulation.positions() - before, axis=1).max())
            yield at_most(f"creep in {CREEP_SECONDS:g} s at 0.9 of that slope, μ = {friction:g} [m]", creep, *CREEP)
    for friction in SLIDING:
        with Timed(on_slope(solver, 1 / sqrt(3), friction)) as simulation:
            advance(simulation, 1.0)
            distance = GRAVITY * (0.5 - friction * sqrt(0.75)) / 2
            measured = float(np.linalg.norm(center(simulation)))
            yield relative(f"way down 30° in 1 s, μ = {friction:g} [m]", distance, measured, *STOPPING)


def scarf(solver: str) -> Iterator[Check]:
    """Measure where a scarf over a round bar slips.

    It slips if its longer end outweighs the friction along half of the bar.
    """
    for friction in FRICTIONS:
        exact = scarf_ratio(friction, BAR / SHORT_END)
        name = f"longer end over shorter where it slips, μ = {friction:g}"
        row = relative(name, exact, scarf_threshold(solver, friction, scarf_after), *SCARF)
        if solver == "verlet":
            row = row.by_law(SLIPS_EARLY, partial(early_slip, friction))
        yield row


def early_slip(friction: float) -> float:
    """Return the error of the ratio at which the scarf slips in the iterations of `verlet` in float64."""
    found = scarf_threshold("verlet", friction, partial(scarf_in_float64, friction))
    return abs(found / scarf_ratio(friction, BAR / SHORT_END) - 1)


def scarf_threshold(solver: str, friction: float, after: Callable[[Scene, Floats], Floats]) -> float:
    """Return the ratio of the ends at which the scarf slips. `after`: its positions a second after such a start."""
    exact = scarf_ratio(friction, BAR / SHORT_END)

    def slips(share: float) -> bool:
        scene, start = hung_scarf(solver, friction, SHORT_END * exact * share)
        return float(start[-2, 1] - after(scene, start)[-2, 1]) > 10 * SLIP

    return exact * find_threshold(slips)


def hung_scarf(solver: str, friction: float, long_end: float) -> tuple[Scene, Floats]:
    """Return the scene of a scarf and its start (N, 3) [m]: bent around the bar, with its ends straight down.

    Its springs start unstretched. Without damping they would bounce, and pull with twice the weight of the ends.
    """
    length = SHORT_END + pi * BAR + long_end
    bar = Capsule(rotation=(90.0, 0.0, 0.0), center=(0.0, 0.0, 0.0), length=1.0, radius=BAR, margin=0.0)
    scene = damped(strip(solver, SCARF_LINKS, constant=2000.0, pins=()))
    cloth = replace(scene.cloth, height=length)
    along = np.linspace(0.0, length, SCARF_LINKS + 1) - SHORT_END
    angle = np.clip(along / BAR, 0.0, pi)
    below = np.minimum(along, 0.0) + np.minimum(length - SHORT_END - along - long_end, 0.0)
    positions = np.stack([-BAR * np.cos(angle), BAR * np.sin(angle) + below, 0.0 * along], axis=1)
    across = np.outer(np.linspace(-0.5, 0.5, 3) * cloth.width, [0.0, 0.0, 1.0])
    start = (positions[:, None] + across).reshape(-1, 3)
    return replace(scene, cloth=cloth, capsules=(replace(bar, friction=friction),)), start


def scarf_after(scene: Scene, start: Floats) -> Floats:
    """Return the positions of the scarf after a second [m], (N, 3)."""
    with Timed(scene) as simulation:
        simulation.set_state(start)
        advance(simulation, 1.0)
        return simulation.positions()


def scarf_in_float64(friction: float, scene: Scene, start: Floats) -> Floats:
    """Return the positions of the scarf after a second with the iterations of `verlet` in float64 [m], (N, 3)."""

    def project(x: Floats, before: Floats) -> None:
        project_round(x, before, x * [1.0, 1.0, 0.0], BAR, friction)

    return swept_in_float64(scene, 1.0, start, project)


def capstan(solver: str) -> Iterator[Check]:
    """Measure a weightless strip around a bar that rotates under it: its tension differs by e^(μφ) between the ends."""
    for friction in WRAP_FRICTIONS:
        for angle in WRAPS:
            what = f"tension over tension round {degrees(angle):g}°, μ = {friction:g}"
            yield run_with_limit(what, *SCARF, partial(measure_wrap, what, solver, friction, angle))


def measure_wrap(what: str, solver: str, friction: float, angle: float) -> Check:
    """Measure one wrap angle.

    Both ends of the strip are pinned, with a straight piece between them and the bar. The strip is slightly too short,
    so that it starts under tension.
    """
    length = 2 * WRAP_END + angle * WRAP_RADIUS
    links = round(length / WRAP_LINK)
    bar = Capsule(rotation=(90.0, 0.0, 0.0), center=(0.0, 0.0, 0.0), length=1.0, radius=WRAP_RADIUS, margin=0.0)
    bar = replace(bar, friction=friction, spin=(0.0, 0.0, WRAP_SPIN))
    scene = damped(strip(solver, links, constant=200.0, pins=("top", "bottom")))
    cloth = replace(scene.cloth, height=length / (1 + WRAP_TIGHT))
    scene = replace(scene, cloth=cloth, capsules=(bar,), forces=Forces(gravity=0.0))
    with Timed(scene) as simulation:
        start = simulation.topology.start.reshape(-1, 3, 3)
        across = start[0, :, 0] - start[0, 1, 0]
        along = np.linspace(0.0, length, links + 1) - WRAP_END
        wrapped_angle = np.clip(along / WRAP_RADIUS, 0.0, angle)
        off = along - wrapped_angle * WRAP_RADIUS  # length off the bar: negative before it, positive behind it
        radial = np.stack([np.cos(wrapped_angle), np.sin(wrapped_angle), 0 * wrapped_angle], axis=1)
        tangent = np.stack([-np.sin(wrapped_angle), np.cos(wrapped_angle), 0 * wrapped_angle], axis=1)
        positions = WRAP_RADIUS * radial + off[:, None] * tangent
        simulation.set_state((positions[:, None] + across[:, None] * np.array([0.0, 0.0, 1.0])).reshape(-1, 3))
        advance(simulation, WRAP_SECONDS)
        x = simulation.positions().reshape(-1, 3, 3)
        straight = round(0.8 * WRAP_END / WRAP_LINK)  # links of an end that never touch the bar
        rest = cloth.height / links
        strains = np.linalg.norm(np.diff(x, axis=0), axis=2).mean(axis=1) / rest - 1
        first, last = float(strains[:straight].mean()), float(strains[-straight:].mean())
        return relative(what, exp(friction * angle), first / last, *SCARF)


def find_threshold(happens: Callable[[float], bool]) -> float:
    """Return the share between 0.25 and 1.75 from which on `happens` is true, by bisection."""
    low, high = 0.25, 1.75
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        low, high = (low, middle) if happens(middle) else (middle, high)
    return (low + high) / 2


# -- a sheet on a ball -------------------------------------------------------------------------------------------------


def on_a_ball(solver: str) -> Iterator[Check]:
    """Compare a square sheet that falls on a ball with its mirror images, before and after it folds."""
    with Timed(sheet_above_ball(solver)) as simulation:
        advance(simulation, UNFOLDED_SECONDS)
        first = ball_row(UNFOLDED_SECONDS, simulation.positions())
        advance(simulation, BALL_SECONDS - UNFOLDED_SECONDS)
        last = ball_row(BALL_SECONDS, simulation.positions())
    yield explain_sweeps(first, solver, UNFOLDED_SECONDS) if solver in SWEEPING else first
    yield explain_sweeps(last, solver, BALL_SECONDS) if solver in SWEEPING else explain_folds(last, first)


def ball_row(seconds: float, positions: Floats) -> Check:
    """Return the row of `on_a_ball` some seconds after the release."""
    what = f"difference to its mirror images {seconds:g} s after it fell on a ball [m]"
    return at_most(what, difference_of_images(positions), *ON_A_BALL)


def explain_sweeps(row: Check, solver: str, seconds: float) -> Check:
    """Return a row after some seconds with its law: the same iterations in float64 are as unsymmetric."""
    if row.verdict != FAIL:
        return row
    return row.by_law(ORDER_OF_SPRINGS, difference_of_images(fallen_in_float64(solver, seconds)))


def fallen_in_float64(solver: str, seconds: float) -> Floats:
    """Return the positions of the sheet some seconds after the release [m], (N, 3), by the solver in float64."""
    scene = sheet_above_ball(solver)
    if solver != "lines":
        return swept_in_float64(scene, seconds, contact=project_from_ball)
    with Simulation(scene) as simulation:
        steps = islice(lines_in_float64(simulation, project_from_ball), round(seconds / substep(simulation)))
        for number, (x, v) in enumerate(steps, 1):
            if number % simulation.substeps == 0:
                stop_on_ball(x, v)
    return x


def project_from_ball(x: Floats, before: Floats | None) -> None:
    """Project positions (N, 3) [m] to the margin of `BALL`, with friction if there are those `before` the step."""
    offset, friction = x - np.asarray(BALL.center), 0.0 if before is None else BALL.friction
    project_round(x, x if before is None else before, offset, BALL.radius + BALL.margin, friction)


def stop_on_ball(x: Floats, v: Floats) -> None:
    """Stop the approach of particles on `BALL`, as `collision/response.py` does at the end of a frame."""
    offset = x - np.asarray(BALL.center)
    distance = np.linalg.norm(offset, axis=1)
    near = distance < BALL.radius + BALL.margin + SURFACE_TOLERANCE
    normal = offset[near] / distance[near, None]
    stopped = np.maximum(-(v[near] * normal).sum(axis=1, keepdims=True), 0.0)
    slide = v[near] + stopped * normal
    slide -= normal * (slide * normal).sum(axis=1, keepdims=True)
    length = np.maximum(np.linalg.norm(slide, axis=1, keepdims=True), 1e-12)
    v[near] += stopped * normal - slide * np.minimum(1.0, BALL.friction * stopped / length)


def project_round(x: Floats, before: Floats, offset: Floats, radius: float, friction: float) -> None:
    """Project positions (N, 3) out of a ball or a bar, with Coulomb friction, as `collision/response.py` does.

    `before` has the positions at the start of the substep, `offset` the vectors from the nearest points of the axis;
    all are in meters.
    """
    distance = np.linalg.norm(offset, axis=1, keepdims=True)
    normal, depth = offset / distance, np.maximum(radius - distance, 0.0)
    x += depth * normal
    slide = x - before
    slide -= normal * (slide * normal).sum(axis=1, keepdims=True)
    x -= slide * np.minimum(1.0, friction * depth / np.maximum(np.linalg.norm(slide, axis=1, keepdims=True), 1e-12))


def explain_folds(row: Check, first: Check) -> Check:
    """Return the last row of `on_a_ball` with its law. Two unsymmetric folds differ by up to twice as much as one.

    The law explains no sheet that was unsymmetric before it folded (`first`).
    """
    if first.verdict == FAIL or row.verdict != FAIL:
        return row
    return row.by_law(FOLDS, exact_difference(), exact_difference())


def sheet_above_ball(solver: str) -> Scene:
    """Return the scene of a level square sheet above a ball."""
    return replace(base(solver, 17, 17, rotation=(-90.0, 0.0, 0.0), mass_lumping="uniform"), spheres=(BALL,))


def difference_of_images(positions: Floats) -> float:
    """Return the largest coordinate difference of a sheet, (N, 3) [m], from its three mirror images."""
    x = positions.reshape(17, 17, 3)
    images = (x[:, ::-1] * [-1.0, 1.0, 1.0], x[::-1] * [1.0, 1.0, -1.0], x.transpose(1, 0, 2)[:, :, [2, 1, 0]])
    return max(float(np.abs(image - x).max()) for image in images)


@cache
def exact_difference() -> float:
    """Return the difference from the mirror images [m] in the float64 reference solution of the same fall."""
    scene = sheet_above_ball("rk4")
    motion = Motion(scene, steps_per_frame(scene))
    for _ in range(round(BALL_SECONDS / FRAME_SECONDS)):
        positions = motion.step_frame()
    return difference_of_images(positions)
