"""Cases 17 to 19, 35, 36 and 39: fast balls, fast cloth and friction."""

from __future__ import annotations

from dataclasses import replace
from math import ceil, cos, radians, sin

import numpy as np

from ...collision.colliders import pose
from ...scene.collider_schema import Attachment, Box, Ground, Plane, Sphere
from ...scene.keys import Keyframes
from ...scene.schema import FRAME_SECONDS, Forces, Scene
from .invariants import ROUNDING, Floats
from .setup import CELLS, DAMPING, DENSITY, FLAT, SIDE, sheet, triangle_self_collision, with_layers
from .trial import CALM_SPEED, CALM_STRAIN, SHAKE, SHIFT, Trial

MARGIN = 0.01  # [m] of colliders
BEFORE, BEHIND = 1.0, 0.4  # [m] distances from the sheet at which a ball starts, and that it at least reaches behind it


def hung() -> Scene:
    """Return a sheet hung by its top edge."""
    return sheet(CELLS, pins=("top",))


def shot_seconds(speed: float) -> float:
    """Return how long a ball shot at `speed` [m/s] flies [s]: a whole number of frames.

    A collider moves straight between its poses at the ends of a frame, so a path that ends within a frame would hit the
    sheet more slowly.
    """
    return ceil((BEFORE + BEHIND) / speed / FRAME_SECONDS) * FRAME_SECONDS


def shot(speed: float, radius: float, against: str = "particles", aim: float = 0.0) -> Sphere:
    """Return a ball shot through the sheet at `speed` [m/s]. It stops behind it for 0.5 s, and moves back slowly.

    It is shot at the point x = y = `aim` [m].
    """
    duration = shot_seconds(speed)
    distance = speed * duration
    path: Keyframes = (
        (0.0, 0, 0, 0),
        (duration, 0, 0, distance),
        (duration + 0.5, 0, 0, distance),
        (duration + 2.5, 0, 0, 0),
    )
    return Sphere(
        center=(aim, aim, -BEFORE), radius=radius, margin=MARGIN, keyframes=path, collide_with=against, friction=0.0
    )


def run_past(trial: Trial, seconds: float, max_speed: float | None = None) -> None:
    """Run, and check that no particle passes through the ball or is faster than `max_speed` [m/s].

    Particles are tested after every substep: a straight line over a whole frame may cross a ball that the particle went
    around.
    """
    simulation = trial.simulation
    [ball] = simulation.scene.spheres
    total = 0
    before = simulation.positions() - pose(ball, simulation.seconds)[0]

    def look(share: float) -> None:
        nonlocal total, before
        start, end = (pose(ball, simulation.seconds + s)[0] for s in (0.0, FRAME_SECONDS))
        after = simulation.positions() - (start + share * (end - start))  # the ball moves straight within a frame
        total += went_through(before, after, ball.radius)
        before = after

    for _ in range(round(seconds / FRAME_SECONDS)):
        trial.one_frame(look=look)
        trial.record("speed [m/s]", trial.watch.speed, max_speed)
        trial.record("particles that went through the ball", total, 0)


def went_through(before: Floats, after: Floats, radius: float) -> int:
    """Return how many particles crossed the plane through a ball's center, normal to z, inside the ball.

    `before` and `after` are positions relative to the center [m], (N, 3), before and after a substep.
    """
    share = before[:, 2] / np.where(before[:, 2] == after[:, 2], np.inf, before[:, 2] - after[:, 2])
    distance = np.linalg.norm(before[:, :2] + share[:, None] * (after - before)[:, :2], axis=1)
    return int(((before[:, 2] * after[:, 2] < 0) & (distance < radius)).sum())


def fast_ball(trial: Trial, speed: float) -> None:
    """Shoot a ball of 0.1 m at the sheet at `speed` [m/s]."""
    trial.open(replace(hung(), spheres=(shot(speed, 0.1),)), far=1.0, rest=hung())
    trial.start()
    run_past(trial, shot_seconds(speed) + 2.6)
    trial.settle()


def small_ball(trial: Trial, against: str) -> None:
    """Shoot a ball smaller than a cell at the middle of one. It collides with particles or with triangles.

    Records whether it went through.
    """
    aim = SIDE / CELLS / 2  # the nearest particles are 2.2 cm away, the ball with its margin has 2 cm
    x = trial.open(replace(hung(), spheres=(shot(20.0, 0.01, against, aim),)), far=1.0, rest=hung())
    near = np.linalg.norm(x[:, :2] - aim, axis=1) < 2 / CELLS
    trial.start()
    trial.run(shot_seconds(20.0) + 0.05)
    behind = float(trial.simulation.positions()[near, 2].max()) < trial.simulation.colliders()[0].center[2]
    trial.record("whether the ball went through", float(behind))
    trial.run(2.6)
    trial.settle()


def fast_cloth(trial: Trial) -> None:
    """Throw a free sheet at a ball at 100 m/s. No particle may ever be faster than the fastest at the start."""
    ball = Sphere(center=(0.0, 0.0, 2.0), radius=0.3, margin=MARGIN, friction=0.0)
    trial.open(sheet(CELLS, pins=(), forces=Forces(gravity=0.0), spheres=(ball,)))
    trial.start(velocity=(0.0, 0.0, 100.0))
    thrown = float(np.linalg.norm(trial.simulation.velocities(), axis=1).max())
    run_past(trial, 5.0, thrown * (1 + 4 * ROUNDING))
    trial.settle()


GRAVITY = 9.81  # [m/s²]
CREEP = 1e-3  # [m] in a minute, of a sheet that friction holds
REST_SECONDS, SLIDE_SECONDS = 60.0, 10.0
SPIN, SPIN_SECONDS = 180.0, 8.0  # [degrees/s] of the ball, and for how long [s]
FASTER = 1e-3  # relative excess of the sheet's angular velocity over the ball's
TURNED = 0.5  # share of the ball's angular velocity that friction must give the sheet
PULL_START = 1.0  # [s] in which the layers come to rest on the table
PULL_SPEED, PULL_SECONDS = 1.0, 1.5  # [m/s] of the tablecloth, and for how long [s]
HEAVIER = 0.01  # relative excess of friction over μ times the weight


def slope(trial: Trial, how: tuple[float, float]) -> None:
    """Lay a sheet on a slope; `how` is the coefficient of friction μ and the angle [degrees].

    If μ ≥ tan(angle), the sheet must stay for a minute; else it slides for ten seconds. A sliding sheet is never at
    rest: with damping it reaches g(sin − μ·cos) over the damping rate. No particle may be faster than that by more than
    the speed allowed at rest, and the mean speed of the sheet may not be lower by more.
    """
    mu, degrees = how
    plane = Plane(center=(0.0, 0.0, 0.0), rotation=(0.0, 0.0, -degrees), margin=MARGIN, friction=mu)
    angle = radians(degrees)
    up, down = np.array([sin(angle), cos(angle), 0.0]), np.array([cos(angle), -sin(angle), 0.0])
    middle = MARGIN * up
    scene = sheet(
        CELLS,
        pins=(),
        rotation=(-90.0, 0.0, -degrees),
        planes=(plane,),
        center=(float(middle[0]), float(middle[1]), 0.0),
    )
    x = trial.open(scene)
    along, across = trial.random.uniform(-SHIFT, SHIFT, 2)
    before = x + along * down + across * np.array([0.0, 0.0, 1.0])
    start_there(trial, before, up)
    pull = GRAVITY * (sin(angle) - mu * cos(angle))
    if pull <= 0:
        for _ in range(round(REST_SECONDS / FRAME_SECONDS)):
            trial.one_frame()
            moved = np.linalg.norm(trial.simulation.positions() - before, axis=1).max()
            trial.record("creep [m]", float(moved), CREEP)
        trial.settle()
    else:
        trial.run(SLIDE_SECONDS)
        speed = pull / float(trial.simulation.params["damping"])
        trial.settle(max_speed=speed + CALM_SPEED)
        behind = speed - float((trial.simulation.velocities() @ down).mean())
        trial.record("slower than a sliding block by [m/s]", behind, CALM_SPEED)


def start_there(trial: Trial, positions: Floats, up: Floats) -> None:
    """Start like `Trial.start`, but with random velocities along the slope only.

    Cloth that leaves a slope of 89° at 2 cm/s falls 0.2 m before it is back.
    """
    shake = trial.random.uniform(-SHAKE, SHAKE, positions.shape)
    trial.simulation.set_state(positions, shake - np.outer(shake @ up, up))
    trial.watch.begin()


def turns_of(x: Floats, v: Floats, mass: Floats) -> float:
    """Return the angular velocity of a cloth about the y axis [radians/s], positive for positive `spin`."""
    spin = (x[:, 2] * v[:, 0] - x[:, 0] * v[:, 2]) @ mass
    return float(spin / ((x[:, 0] ** 2 + x[:, 2] ** 2) @ mass))


def rotating_ball(trial: Trial) -> None:
    """Drop a sheet on a ball that spins about the vertical. It may not spin faster than the ball, and stops with it.

    The angular velocity is that of the whole sheet: its angular momentum over its moment of inertia. Friction must
    bring it to at least half of the ball's.
    """
    path: Keyframes = ((0.0, 0, 0, 0, 0, 0, 0), (SPIN_SECONDS, 0, 0, 0, 0, SPIN * SPIN_SECONDS, 0))
    ball = Sphere(center=(0.0, -0.35, 0.0), radius=0.3, margin=MARGIN, friction=0.4, keyframes=path)
    trial.open(sheet(CELLS, pins=(), rotation=FLAT, spheres=(ball,), ground=Ground(height=-1.2)))
    trial.start()
    simulation, share = trial.simulation, 0.0
    for _ in range(round(SPIN_SECONDS / FRAME_SECONDS)):
        trial.one_frame()
        rate = turns_of(simulation.positions(), simulation.velocities(), simulation.topology.mass)
        share = rate / radians(SPIN)
        trial.record("rate of the sheet, of the ball's", share, 1 + FASTER)
    trial.record("rate that the sheet lacks, of the ball's", 1 - share, 1 - TURNED)
    trial.settle()


def tablecloth(trial: Trial, friction: float, cells: int | None = None) -> None:
    """Pull a sheet by an edge at 1 m/s over a frictionless table, from under a loose sheet, with this friction μ.

    Friction takes a loose sheet along after v²/(2μg): 0.17 m with μ = 0.3, from where the two move as one. With
    μ = 0.03 it would be 1.7 m, so that the tablecloth is gone before.

    Colliders are kinematic and weightless, so a loose sheet replaces the ball that the specification puts on the
    tablecloth. Friction is the only force on it along the table, and is measured without damping as the change of its
    momentum. Its mean over any tenth of a second may not exceed μ times the weight of the loose sheet. Its mean while
    the layers slide is recorded, relative to μ times the weight of what lies on the tablecloth.
    """
    mu, cells = friction, cells or CELLS
    contact = replace(triangle_self_collision(), friction=mu)
    table = Box(center=(0.0, -0.1, 0.0), size=(6.0, 0.2, 1.6), margin=MARGIN, friction=0.0)
    edge = tuple((cells + 1) * row + cells for row in range(cells + 1))  # the right edge of layer 1
    path: Keyframes = ((PULL_START, 0, 0, 0), (PULL_START + PULL_SECONDS, PULL_SPEED * PULL_SECONDS, 0, 0))
    hand = Attachment(pins=edge, keyframes=path)  # moves evenly; pins set between frames would shake the cloth
    scene = sheet(cells, pins=(), rotation=FLAT, damping=0.0, boxes=(table,), center=(0.0, MARGIN, 0.0))
    scene = replace(scene, attachments=(hand,))
    scene = replace(with_layers(scene, 2, 1.05 * contact.thickness), self_collision=contact)
    trial.open(scene, rest_strain=CALM_STRAIN)  # both sheets lie on the table, which has no friction
    trial.start()
    trial.simulation.params["damping"] = DAMPING
    trial.run(PULL_START)
    trial.simulation.params["damping"] = 0.0
    upper = slice(trial.simulation.topology.particle_count // 2, None)
    mass = trial.simulation.topology.mass[upper]
    weight = DENSITY * SIDE**2 * GRAVITY
    momentum = [float(trial.simulation.velocities()[upper, 0] @ mass)]
    slid, given, gone = 0.0, 0.0, False  # [N·s] by Coulomb's law while the layers slide, and measured
    for _ in range(round(PULL_SECONDS / FRAME_SECONDS)):
        trial.one_frame()
        momentum.append(float(trial.simulation.velocities()[upper, 0] @ mass))
        x = trial.simulation.positions()[:, 0]
        behind = float(x[: upper.start].mean() - x[upper].mean())  # [m] of the loose sheet
        if momentum[-1] < (PULL_SPEED - CALM_SPEED) * mass.sum() and not gone:
            given += momentum[-1] - momentum[-2]
            slid += mu * weight * (1 - behind / SIDE) * FRAME_SECONDS
        gone = gone or behind >= SIDE
    window = 6  # frames: a tenth of a second
    forces = (np.array(momentum[window:]) - momentum[:-window]) / (window * FRAME_SECONDS)
    trial.record("friction, of μ times the weight", float(np.abs(forces).max()) / (mu * weight), 1 + HEAVIER)
    trial.record("mean friction while the layers slide, of μ times the weight", given / slid if slid else 0.0)
    trial.record("whether the tablecloth is gone", float(gone))
    trial.simulation.params["damping"] = DAMPING
    trial.settle()
