"""A7: contact and friction."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from math import atan, degrees, exp, pi, sqrt

import numpy as np

from ..scene.model import Capsule, Forces, Ground, Plane, Scene, Sphere
from ..simulation import Simulation
from .exact import GRAVITY, scarf_ratio
from .row import Row, at_most, in_time, relative
from .setups import Timed, advance, base, center, damped, strip, substep

FRICTIONS = (0.1, 0.3, 0.5)
SPEED = 1.0  # [m/s]
STOPPING = (0.05, 0.01)  # A7: 5 %, 1 %
CREEP = (1e-3, 1e-5)  # [m] A7: 1 mm, 0.01 mm
KINETIC = (1e-6, 1e-10)  # [J/kg] A7
STILL = (2e-5, 2e-7)  # [m] in a frame, at those energies
DEPTH = (1e-4, 1e-9)  # [m] in a ground without margin
SCARF = (0.1, 0.03)  # A7: 10 %, 3 %
SLIDING = (0.2, 0.4, 0.57)  # frictions on 30°
WRAPS = (pi / 2, pi, 2 * pi)  # angles round a bar
WRAP_FRICTIONS = (0.3, 0.5)
WRAP_RADIUS, WRAP_END, WRAP_LINK = 0.1, 0.3, 0.01  # [m] of the bar; of the free ends; of a link
WRAP_TIGHT = 0.02  # strain that it begins with
WRAP_SPIN = 180.0  # [degrees/s] of the bar, which slides under it
WRAP_SECONDS = 4.0
SPHERE_MARGIN = 0.02  # [m] of what rests on a ball
THICKNESS = (0.1, 0.0)  # A7: a tenth of it, nothing
HALF_A_STEP = "the velocity that is told has half a substep of weight in it: ½·(½gh)²"
SLOPES = (0.1, 0.3, 0.5, 0.8)  # frictions at which the angle is sought where a sheet begins to slide
SLIP = 2e-3  # [m] in a second: what slides moves more, 1 % above the angle where it begins, and what sticks less
HALVINGS = 9  # of the range from 0.25 to 1.75 of what is sought: to 0.2 %
BAR, SHORT_END, SCARF_LINKS = 0.03, 0.3, 120  # [m] radius of the bar, and the shorter end of the scarf
LEVEL = (-90.0, 0.0, 0.0)


def stopping(solver: str) -> Iterator[Row]:
    """A sheet slides over the ground until friction has used its energy up: v²/(2μg)."""
    for friction in FRICTIONS:
        ground = Ground(height=0.0, margin=0.0, friction=friction)
        with Timed(replace(base(solver, rotation=LEVEL), ground=ground)) as simulation:
            advance(simulation, 0.2)
            x = simulation.positions()
            simulation.place(x, (SPEED, 0.0, 0.0))
            start = center(simulation)[0]
            advance(simulation, SPEED / (friction * GRAVITY) + 0.5)
            exact = SPEED**2 / (2 * friction * GRAVITY)
            yield relative(
                f"way to a stop from 1 m/s, μ = {friction:g} [m]", exact, center(simulation)[0] - start, *STOPPING
            )


def resting(solver: str) -> Iterator[Row]:
    """Dropped from 5 cm on the ground: five seconds later it lies still, on it and not in it. So does one on a ball."""
    scene = replace(base(solver, rotation=LEVEL, center=(0.0, 0.05, 0.0)), ground=Ground(height=0.0, margin=0.0))
    with Timed(scene) as simulation:
        advance(simulation, 5.0)
        yield from still(simulation, "the ground", late_kick(solver, simulation))
        yield at_most("depth in the ground [m]", simulation.measure().penetration, *DEPTH)
        drift = float(np.linalg.norm(center(simulation)[[0, 2]]))
        yield at_most("creep over the ground [m]", drift, *CREEP)
    ball = Sphere(center=(0.0, -0.35, 0.0), radius=0.3, margin=SPHERE_MARGIN, friction=0.5)
    with Timed(damped(replace(base(solver, 17, 17, rotation=LEVEL), spheres=(ball,)))) as simulation:
        advance(simulation, 5.0)
        yield from still(simulation, "a ball")
        depth = simulation.measure().penetration / SPHERE_MARGIN
        yield at_most("depth in a ball, of the thickness", depth, *THICKNESS)


def late_kick(solver: str, simulation: Simulation) -> float | None:
    """Kinetic energy [J/kg] of half a kick of weight, which explicit methods tell of what lies on level ground."""
    return (GRAVITY * substep(simulation) / 2) ** 2 / 2 if solver in ("spring", "rk4") else None


def still(simulation: Simulation, on: str, law: float | None = None) -> Iterator[Row]:
    before = simulation.positions()
    simulation.advance_frame()
    energy = 0.5 * float((simulation.velocities() ** 2).sum(axis=1).max())
    row = at_most(f"kinetic energy of the fastest particle after 5 s on {on} [J/kg]", energy, *KINETIC)
    yield row if law is None else row.by_law(HALF_A_STEP, law)
    way = float(np.linalg.norm(simulation.positions() - before, axis=1).max())
    yield at_most(f"way of the fastest particle in the next frame on {on} [m]", way, *STILL)


def on_slope(solver: str, tangent: float, friction: float) -> Scene:
    """A sheet that lies on a slope that falls towards −x."""
    angle = degrees(atan(tangent))
    slope = Plane(rotation=(0.0, 0.0, angle), margin=0.0, friction=friction)
    return replace(base(solver, rotation=(-90.0, 0.0, angle)), planes=(slope,))


def incline(solver: str) -> Iterator[Row]:
    """A sheet slides where the slope is steeper than the friction, tan θ > μ, at g·(sin θ − μ·cos θ); else it lies."""
    for friction in SLOPES:

        def slides(share: float, friction: float = friction) -> bool:
            with Timed(on_slope(solver, share * friction, friction)) as simulation:
                advance(simulation, 1.0)
                return float(np.linalg.norm(center(simulation))) > SLIP

        yield relative(f"slope where it slides, μ = {friction:g}", friction, friction * where(slides), *STOPPING)
    with Timed(on_slope(solver, 0.9 * 0.5, 0.5)) as simulation:
        advance(simulation, 1.0)  # it has found its place
        before = center(simulation)
        advance(simulation, 10.0)
        creep = float(np.linalg.norm(center(simulation) - before))
        yield at_most("creep in 10 s at 0.9 of that slope, μ = 0.5 [m]", creep, *CREEP)
    for friction in SLIDING:
        with Timed(on_slope(solver, 1 / sqrt(3), friction)) as simulation:
            advance(simulation, 1.0)
            way = GRAVITY * (0.5 - friction * sqrt(0.75)) / 2
            measured = float(np.linalg.norm(center(simulation)))
            yield relative(f"way down 30° in 1 s, μ = {friction:g} [m]", way, measured, *STOPPING)


def scarf(solver: str) -> Iterator[Row]:
    """A scarf over a round bar slips where its longer end outweighs what friction holds along half the bar."""
    for friction in FRICTIONS:
        exact = scarf_ratio(friction, BAR / SHORT_END)

        def slips(share: float, friction: float = friction, exact: float = exact) -> bool:
            long_end = SHORT_END * exact * share
            length = SHORT_END + pi * BAR + long_end
            scene = strip(solver, SCARF_LINKS, constant=2000.0, pins=())
            bar = Capsule(rotation=(90.0, 0.0, 0.0), center=(0.0, 0.0, 0.0), length=1.0, radius=BAR, margin=0.0)
            bar = replace(bar, friction=friction)
            scene = replace(scene, cloth=replace(scene.cloth, height=length), capsules=(bar,))
            with Timed(scene) as simulation:
                along = np.linspace(0.0, length, SCARF_LINKS + 1) - SHORT_END
                angle = np.clip(along / BAR, 0.0, pi)
                below = np.minimum(along, 0.0) + np.minimum(length - SHORT_END - along - long_end, 0.0)
                places = np.stack([-BAR * np.cos(angle), BAR * np.sin(angle) + below, 0.0 * along], axis=1)
                across = simulation.topology.start.reshape(-1, 3, 3)[0, :, 0] - simulation.topology.start[1, 0]
                simulation.place((places[:, None] + across[:, None] * np.array([0.0, 0.0, 1.0])).reshape(-1, 3))
                before = simulation.positions()[-2, 1]
                advance(simulation, 1.0)
                return float(before - simulation.positions()[-2, 1]) > 10 * SLIP

        yield relative(f"longer end over shorter where it slips, μ = {friction:g}", exact, exact * where(slips), *SCARF)


def capstan(solver: str) -> Iterator[Row]:
    """A strip without weight round a bar that turns under it pulls e^(μφ) times as hard at one end as at the other."""
    for friction in WRAP_FRICTIONS:
        for angle in WRAPS:
            what = f"tension over tension round {degrees(angle):g}°, μ = {friction:g}"
            yield in_time(what, *SCARF, partial(wrapped, what, solver, friction, angle))


def wrapped(what: str, solver: str, friction: float, angle: float) -> Row:
    """Both ends are pinned, a straight piece away from the bar, and the strip is a little too short for that."""
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
        turned = np.clip(along / WRAP_RADIUS, 0.0, angle)
        free = along - turned * WRAP_RADIUS  # before the bar less than 0, behind it more
        out = np.stack([np.cos(turned), np.sin(turned), 0 * turned], axis=1)
        tangent = np.stack([-np.sin(turned), np.cos(turned), 0 * turned], axis=1)
        places = WRAP_RADIUS * out + free[:, None] * tangent
        simulation.place((places[:, None] + across[:, None] * np.array([0.0, 0.0, 1.0])).reshape(-1, 3))
        advance(simulation, WRAP_SECONDS)
        x = simulation.positions().reshape(-1, 3, 3)
        straight = round(0.8 * WRAP_END / WRAP_LINK)  # links of an end that are surely off the bar
        rest = cloth.height / links
        strains = np.linalg.norm(np.diff(x, axis=0), axis=2).mean(axis=1) / rest - 1
        first, last = float(strains[:straight].mean()), float(strains[-straight:].mean())
        return relative(what, exp(friction * angle), first / last, *SCARF)


def where(happens: Callable[[float], bool]) -> float:
    """The share between 0.25 and 1.75 from which on something happens."""
    low, high = 0.25, 1.75
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        low, high = (low, middle) if happens(middle) else (middle, high)
    return (low + high) / 2
