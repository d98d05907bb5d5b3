"""Cases 7 to 13, 26 to 29, 34, 37 and 38: pins, gravity, start positions, wind, grabs, damping, strain limit."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from ...geometry.scene_loader import load_scene
from ...scene.collider_schema import Ground
from ...scene.schema import FRAME_SECONDS, Forces, StrainLimit, Wind
from .invariants import ROUNDING, Floats
from .setup import CELLS, CONSTANT, DAMPING, DENSITY, FLAT, sheet, static_strain, taut_strain
from .trial import CALM_STRAIN, CASE_SECONDS, INTERSECTIONS, Trial

GRAVITY = 9.81  # [m/s²]
PULL_SECONDS, HOLD_SECONDS = 0.1, 1.0
RECOVERED = 1e-3  # difference of the strain of a sheet that was stretched from the static strain
CHATTER = 1e-3  # [m/s] speed of a sheet in edge-on wind
YANKED_STRAIN = 0.05
CAP_ROUNDING = 4 * ROUNDING * CELLS  # of a strain: float32 rounding of positions of 1 m, over a spring of one cell
LANDING_SECONDS = 0.6  # in which cloth has landed that falls 1 m with damping, or is already falling
FALLS = 0.01  # relative error of the fall ½gt² of a cloth with spring damping


def pins_apart(trial: Trial, times: float) -> None:
    """Move both corners apart to `times` their distance within 0.1 s, hold them, and move them back as fast."""
    scene = sheet(CELLS)
    x = trial.open(scene, far=2 * times)
    trial.start()
    start = x[trial.simulation.topology.pinned]
    trial.move_pins(start * [times, 1, 1], PULL_SECONDS)
    trial.run(HOLD_SECONDS)
    trial.move_pins(start, PULL_SECONDS)
    trial.settle()
    static = static_strain(trial.setting.of(scene))
    trial.record("strain beside the static one", abs(trial.watch.strain - static), RECOVERED)


def pins_together(trial: Trial, span: float) -> None:
    """Move both corners to the share `span` of their distance, and back. If it is negative they pass each other."""
    x = trial.open(sheet(CELLS))
    trial.start()
    start = x[trial.simulation.topology.pinned]
    trial.move_pins(start * [span, 1, 1], 0.5)
    trial.run(HOLD_SECONDS)
    trial.move_pins(start, 0.5)
    trial.settle()


def gravity(trial: Trial, size: float) -> None:
    """Run with a constant gravity [m/s²]. If it points up, the cloth rests in the mirror image of its hanging shape."""
    scene, hanging = (sheet(CELLS, pins=("top",), forces=Forces(gravity=g)) for g in (size, abs(size)))
    trial.open(scene, far=4 * DENSITY * abs(size) / CONSTANT, rest=hanging)
    trial.start()
    trial.settle()


def gravity_flips(trial: Trial) -> None:
    """Reverse gravity in every frame for two seconds. At the end it points down."""
    trial.open(sheet(CELLS, pins=("top",)))
    trial.start()
    for k in range(121):
        trial.change(partial(trial.simulation.params.update, gravity=GRAVITY * (-1) ** k))
        trial.one_frame()
    trial.settle()


def gusts(trial: Trial) -> None:
    """Turn on a wind of 100 m/s for half a second, and off for half a second, five times."""
    still = sheet(CELLS, pins=("top",))
    trial.open(replace(still, wind=Wind(z=100.0, turbulence=0.0)), far=15.0, rest=still)
    trial.start()
    for k in range(10):
        trial.simulation.params["wind"] = k % 2 == 0
        trial.run(0.5)
    trial.simulation.params["wind"] = False
    trial.settle()


def edge_on_wind(trial: Trial, cross: float) -> None:
    """Blow at 2 m/s in the plane of a taut sheet, with a small component across it that changes sign.

    `cross` is the amplitude of that component, as a share of the speed: if it is 0, n·v is 0 on every triangle. The
    sheet is stretched by 1 % between two edges, a tension of some 15 N/m. Below a tension of σU² (0.8 N/m here) it
    would flutter like a flag. A hanging sheet has free edges, which flutter in any wind: that is motion, not chatter.

    Chatter is the part of a velocity that changes its sign from frame to frame. The wind across moves the sheet too,
    but slowly, which adds 1e-5 m/s to that part. It begins when the sheet is at rest after its disturbed start.
    """
    speed, stretch = 2.0, 0.01  # [m/s], strain
    scene = sheet(CELLS, pins=("left", "right"), forces=Forces(gravity=0.0), wind=Wind(x=speed, turbulence=0.0))
    x = trial.open(scene, rest_strain=taut_strain(trial.setting.of(scene), stretch) + CALM_STRAIN)
    trial.start(x * [1 + stretch, 1, 1])
    trial.settle()
    last = [trial.simulation.velocities()] * 2
    for k in range(120):
        trial.simulation.params["wind_z"] = cross * speed * np.sin(k / 10)
        trial.one_frame()
        last = [*last[-2:], trial.simulation.velocities()]
        trial.record("change of sign edge-on [m/s]", alternation(*last), CHATTER)
    trial.simulation.params["wind_z"] = 0.0
    trial.settle()
    for _ in range(60):
        trial.one_frame()
        trial.record("speed edge-on [m/s]", trial.watch.speed, CHATTER)


def alternation(first: Floats, second: Floats, third: Floats) -> float:
    """Return the largest part of the velocities (N, 3) of three frames that changes its sign from frame to frame."""
    return float(np.linalg.norm(first - 2.0 * second + third, axis=1).max()) / 4


def yank(trial: Trial, distance: float) -> None:
    """Grab a particle in the middle, move it by `distance` [m] in one frame, and back in the next."""
    trial.open(sheet(CELLS, pins=("top",)), far=distance, rest_strain=YANKED_STRAIN)
    trial.start()
    middle = trial.simulation.topology.particle_count // 2
    grab = trial.simulation.grab(middle)
    for z in (0.0, distance, 0.0):
        target = trial.simulation.topology.start[middle] + [0.0, 0.0, z]
        trial.change(partial(grab.move_to, target))
        trial.one_frame(driven=True)
    trial.change(grab.release)
    trial.settle()


def no_pins(trial: Trial) -> None:
    """Drop a level sheet without pins on the ground."""
    trial.open(sheet(CELLS, pins=(), ground=Ground(height=-1.0), rotation=FLAT))
    trial.start()
    trial.run(LANDING_SECONDS)
    trial.settle()


def all_pins(trial: Trial) -> None:
    """Pin every particle. None may move."""
    count = (CELLS + 1) ** 2
    x = trial.open(sheet(CELLS, pins=tuple(range(count))))
    trial.start()
    trial.settle()
    trial.record("way of a pin [m]", float(np.abs(trial.simulation.positions() - np.float32(x)).max()), 0)


def toggled_pin(trial: Trial) -> None:
    """Pin a free corner where it is in one frame and unpin it in the next, for two seconds."""
    trial.open(sheet(CELLS))
    trial.start()
    corner = trial.simulation.topology.particle_count - 1
    for k in range(120):
        trial.change(partial(trial.simulation.unpin if k % 2 else trial.simulation.pin, corner))
        trial.watch.set_pin_positions(trial.simulation.positions()[trial.simulation.topology.pinned])
        trial.one_frame()
    trial.settle()


def refuses_negative(trial: Trial) -> None:
    """Try negative damping rates and times. They must be rejected by name, in a scene and at run time."""
    for key in ("damping", "damping_time"):
        trial.expect_error(key, partial(load_scene, "curtain", **{key: -1.0}))
    trial.open(sheet(CELLS))
    trial.start()
    trial.expect_error("damping", partial(trial.simulation.params.update, damping=-1.0))
    trial.settle()


def undamped(trial: Trial) -> None:
    """Run five seconds without damping, then with damping, so that the sheet comes to rest."""
    trial.open(sheet(CELLS, damping=0.0))
    trial.start()
    trial.run(5.0)
    trial.simulation.params["damping"] = DAMPING
    trial.settle()


def overdamped(trial: Trial, rate: float) -> None:
    """Run with a damping rate [1/s] so high that nothing can move."""
    trial.open(sheet(CELLS, damping=rate))
    trial.start()
    trial.settle()


def falls_with_spring_damping(trial: Trial, damping_time: float) -> None:
    """Drop a sheet with spring damping [s], which must not slow its fall; then it lands.

    The fall is ½gt², to within 1 % and the first substep.
    """
    scene = sheet(CELLS, pins=(), damping=0.0, rotation=FLAT, ground=Ground(height=-6.0))
    trial.open(replace(scene, fabric=replace(scene.fabric, damping_time=damping_time)))
    trial.start()
    start, speed = (values[:, 1].mean() for values in (trial.simulation.positions(), trial.simulation.velocities()))
    trial.run(1.0)
    h = FRAME_SECONDS / trial.simulation.substeps
    fall = start + speed - trial.simulation.positions()[:, 1].mean()
    trial.record("fall in 1 s beside ½gt², share", abs(fall / (GRAVITY / 2) - 1), FALLS + h)
    trial.simulation.params["damping"] = DAMPING
    trial.run(LANDING_SECONDS)
    trial.settle()


def strain_cap(trial: Trial, cap: float) -> None:
    """Hang a sheet under ten times its weight. No structural spring may exceed the strain limit `cap` in any frame."""
    scene = sheet(CELLS, pins=("top",), forces=Forces(gravity=10 * GRAVITY), strain_limit=StrainLimit(strain=cap))
    trial.open(scene, rest_strain=cap + CAP_ROUNDING)
    trial.start()

    def check_limit() -> None:
        trial.record("strain above the cap", trial.watch.strain - cap, CAP_ROUNDING)

    for _ in range(round(CASE_SECONDS / 2 / FRAME_SECONDS)):
        trial.one_frame()
        check_limit()
    trial.settle(after_frame=check_limit)


# Cases 9 to 13: degenerate start positions, from which the cloth must recover its shape.

RANDOM_STRAIN = 0.05  # specified bound on the final strain after a random start


def grid_of(trial: Trial, positions: Floats) -> Floats:
    """Return a view of positions (N, 3) by rows and columns, (rows, columns, 3)."""
    return positions.reshape(*trial.simulation.topology.shape, 3)


def with_pins_kept(trial: Trial, positions: Floats, before: Floats) -> Floats:
    """Return `positions`, with those of the pins replaced by `before`."""
    pinned = trial.simulation.topology.pinned
    return np.where(pinned[:, None], before, positions)


def collapsed(trial: Trial, spread: float) -> None:
    """Start with all free particles at one point, or near it with standard deviation `spread` [m].

    Runs twice, ten seconds each, which must give the same bits.
    """
    final_positions = []
    shape = trial.open(sheet(CELLS)).shape
    point = trial.random.uniform(-0.3, 0.3, 3) + trial.random.normal(0.0, spread, shape)
    for again in range(2):
        if again:
            trial.open(sheet(CELLS))
        trial.start(with_pins_kept(trial, point, trial.simulation.topology.start), shake=0.0)
        trial.settle()
        trial.settle()  # and still at rest after ten seconds
        final_positions.append(trial.simulation.positions())
    trial.record("numbers that are others the second time", int((final_positions[0] != final_positions[1]).sum()), 0)


def in_line(x: Floats) -> Floats:
    """Return all positions projected onto the x axis: y = z = 0."""
    return x * [1.0, 0.0, 0.0]


def mirrored(x: Floats) -> Floats:
    """Return positions with the left half mirrored onto the right."""
    return np.where(x[:, :1] < 0, x * [-1.0, 1.0, 1.0], x)


def flattened(trial: Trial, lie: str) -> None:
    """Start with all particles on a line ("in line"), or with one half on the other ("mirrored")."""
    x = trial.open(sheet(CELLS))
    trial.start(with_pins_kept(trial, {"in line": in_line, "mirrored": mirrored}[lie](x), x))
    trial.settle()


def random_start(trial: Trial) -> None:
    """Start with random positions in a cube with a side of 1 m."""
    x = trial.open(sheet(CELLS, pins=("top",)), rest_strain=RANDOM_STRAIN)
    trial.start(with_pins_kept(trial, trial.random.uniform(-0.5, 0.5, x.shape), x))
    trial.settle()


def noise(trial: Trial, size: float) -> None:
    """Displace every free particle by random noise with standard deviation `size` [m]."""
    x = trial.open(sheet(CELLS))
    trial.start(with_pins_kept(trial, x + trial.random.normal(0.0, size, x.shape), x))
    trial.settle()


def swapped(x: Floats) -> Floats:
    """Return positions (rows, columns, 3) with every second column swapped with the next."""
    order = np.arange(x.shape[1])
    pairs = order[: len(order) // 2 * 2].reshape(-1, 2)
    order[: pairs.size] = pairs[:, ::-1].ravel()
    return x[:, order]


def inverted(trial: Trial) -> None:
    """Start with every second column swapped with the next. Without self-collision the sheet must untangle."""
    x = trial.open(sheet(CELLS))
    trial.start(with_pins_kept(trial, swapped(grid_of(trial, x)).reshape(-1, 3), x))
    trial.settle()
    trial.record(INTERSECTIONS, trial.simulation.intersections(), 0)
