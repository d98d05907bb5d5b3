"""Cases 1 to 6, 24, 25, 32, 33 and 40: extreme stiffness, masses, sizes, positions and durations, and time steps.

The simulation advances in frames of 1/60 s, independent of the display. `FrameClock` computes how many frames are due
at each refresh of the display, so the refresh rate changes the number of frames per refresh, never the time step. The
number of substeps changes that.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import partial
from math import log10
from os import sep
from pathlib import Path

import numpy as np

from ...geometry.mesh_reader import ObjError
from ...geometry.scene_loader import load_scene
from ...scene import Scene, SceneError
from ...scene.collider_schema import Ground
from ...scene.schema import FRAME_SECONDS, Maps
from ...simulation.frame_clock import FrameClock
from ...system.errors import UsageError, one_line
from ...viewer.session import Session
from .changes import MESHES, SLIVERS, folder, half_map, plain
from .loads import LANDING_SECONDS, grid_of
from .setup import CELLS, CONSTANT, CORNERS, DAMPING, DENSITY, FLAT, MAX_SUBSTEPS, SIDE, sheet
from .trial import CALM_SECONDS, SLOW_MS, STILL_SECONDS, Trial

GRAVITY = 9.81  # [m/s²]
WEIGHT = DENSITY * GRAVITY  # [N] of the sheet of 1 m²
PARTICLE = DENSITY / CELLS**2  # [kg] of a particle inside the sheet
MAX_SPEED = 20.0  # [m/s] bound that the engine Newton sets itself for a stiff sheet
WALL_SECONDS = 10.0
KEPT_SECONDS = 4 * FRAME_SECONDS  # of wall time between two refreshes that the clock keeps; it drops the rest by design
PAUSED_REFRESHES = 100  # display refreshes
RATES = 240.0, 120.0, 60.0, 30.0, 10.0  # [Hz]
SAG_BETWEEN_RATES = 0.02  # relative difference of the sag between two rates
BETWEEN_RATES = "difference of the sag between rates, share"


def stiffness_sweep(trial: Trial, constant: float) -> None:
    """Hang a sheet by two corners with one constant [N/m] for all springs. Nothing else is tuned.

    `verlet` has no spring constants: its shares go from 0.1 to 1 with the decades, and its bound is that of the sheet
    with 1000 N/m.
    """
    share = (round(log10(constant)) + 1) / 10
    rest = sheet(CELLS) if trial.setting.solver.name == "verlet" else None
    trial.open(sheet(CELLS, constant=constant, share=share), far=8 * WEIGHT / constant, rest=rest)
    trial.start()
    trial.settle(after_frame=lambda: trial.record("speed [m/s]", trial.watch.speed, MAX_SPEED))


def stiffness_ratio(trial: Trial, ratio: float) -> None:
    """Hang a sheet whose springs in the left half are `ratio` times as stiff as the others, which have 1000 N/m.

    Springs across the center line have the mean of both. In `verlet` the shares of the halves have this ratio.
    """
    maps = Maps(stiffness=half_map(CELLS), stiffness_min=1 / ratio, stiffness_max=1.0, folder=str(folder()))
    trial.open(replace(sheet(CELLS, constant=CONSTANT * ratio), maps=maps))
    trial.start()
    trial.settle()


def mass_ratio(trial: Trial, times: float) -> None:
    """Sew a mass to one free corner: `times` the mass of a particle inside the sheet."""
    load = times * PARTICLE * GRAVITY  # [N]
    trial.open(sheet(CELLS, corner_mass=times * PARTICLE, corner_mass_at="bottom-right"), far=4 * load / CONSTANT)
    trial.start()
    trial.settle()
    trial.record("strain", trial.watch.strain)


CELL = 1 / CELLS  # [m]
SAG = 0.01  # relative difference of the sag far from the origin
FALL_SECONDS, FALL = 0.4, 0.01  # [s], and relative difference of the fall far from the origin


def run_refreshes(trial: Trial, times: Iterable[float]) -> int:
    """Run the frames of a window that refreshes at these wall times [s]. Returns the number of frames."""
    clock, frames = FrameClock(0.0), 0
    for now in times:
        due = clock.due(now)
        frames += due
        for _ in range(due):
            trial.one_frame()
    return frames


def at_rate(rate: float) -> list[float]:
    """Return the wall times of the refreshes [s], at `rate` [Hz]."""
    return [float(k) / rate for k in range(1, round(WALL_SECONDS * rate) + 1)]


def lost_seconds(rate: float) -> float:
    """Return the time that the clock drops by design [s]."""
    return WALL_SECONDS * max(0.0, 1 - KEPT_SECONDS * rate)


def run_all_but(trial: Trial, lost: float, times: Sequence[float]) -> None:
    """Run the frames of these refreshes [s]. They must simulate the wall time but `lost` [s], to within a frame."""
    simulated = run_refreshes(trial, times) * FRAME_SECONDS
    difference = abs(times[-1] - lost - simulated)
    trial.record("simulated time beside the wall's [s]", difference, 1.01 * FRAME_SECONDS)


def frame_rates(trial: Trial) -> None:
    """Run ten seconds of wall time at each refresh rate of a display. The sag of the sheet must be equal.

    Simulated time must match wall time, minus the time that the clock drops by design.
    """
    sags = []
    for rate in RATES:
        trial.open(sheet(CELLS))
        trial.start()
        run_all_but(trial, lost_seconds(rate), at_rate(rate))
        trial.settle()
        sags.append(sag_of(trial))
        trial.record("time dropped by the clock [s]", lost_seconds(rate))
        trial.record(BETWEEN_RATES, difference(sags), SAG_BETWEEN_RATES)


def time_steps(trial: Trial) -> None:
    """Run with the time steps that a frame of each rate would have. The sag of the sheet must be equal.

    At 10 Hz a substep is six times as long as at 60 Hz: the setting's substeps are divided by six, or are one. An
    explicit solver would raise so few; it has its longest stable substep at 10 Hz, and as much shorter ones at others,
    as far as a frame may have so many.
    """
    sags = []
    for rate in RATES:
        trial.open(sheet(CELLS))
        trial.start()
        simulation, usual = trial.simulation, float(trial.setting.solver.substeps)
        if simulation.solver.info.is_explicit:
            usual = simulation.min_stable_substeps / (min(RATES) * FRAME_SECONDS)
        simulation.params["substeps"] = min(max(1, round(usual * rate * FRAME_SECONDS)), MAX_SUBSTEPS)
        slower = max(1.0, rate * FRAME_SECONDS)
        trial.frame_limit_ms(slower * SLOW_MS, f"up to {max(RATES) * FRAME_SECONDS:g} times the substeps")
        trial.settle()
        sags.append(sag_of(trial))
        trial.record(BETWEEN_RATES, difference(sags), SAG_BETWEEN_RATES)


def sag_of(trial: Trial, height: float = 0.0) -> float:
    """Return how far a sheet with its center at `height` [m] hangs below its lower edge without load [m]."""
    return height - SIDE / 2 - float(trial.simulation.positions()[:, 1].min())


def difference(sags: Sequence[float]) -> float:
    """Return the difference of the largest and the smallest sag, as a share of the largest."""
    return (max(sags) - min(sags)) / abs(max(sags)) if max(sags) != min(sags) else 0.0


def uneven_rates(trial: Trial) -> None:
    """Alternate intervals of 1/144 s and 1/20 s between refreshes, with one of a full second."""
    trial.open(sheet(CELLS))
    trial.start()
    stall = 1.0
    intervals = [1 / 144, 1 / 20] * 90
    intervals[60] = stall
    run_all_but(trial, stall - KEPT_SECONDS, np.cumsum(intervals).tolist())
    trial.settle()


def paused(trial: Trial) -> None:
    """Refresh 100 times at one wall time while the cloth swings, as the window does: clock, session and drawing.

    The state of the cloth must stay the same to the last bit, and so must the next second, compared with a sheet that
    was not paused.
    """
    x = trial.open(sheet(CELLS))
    trial.start(x * [1, 0, 0] - x[:, [0, 2, 1]] * [0, 0, 1])
    trial.run(0.5)
    simulation = trial.simulation
    session = Session(simulation.scene)
    try:
        session.simulation.set_state(simulation.positions(), simulation.velocities())
        simulation.set_state(simulation.positions(), simulation.velocities())
        before = session.simulation.positions(), session.simulation.velocities()
        clock = FrameClock(0.0)
        for _ in range(PAUSED_REFRESHES):
            session.advance(clock.due(0.0))
            session.measure()
            session.draw_list.update(session.view, session.camera.eye)
        trial.record("numbers that changed while paused", changed(before, session), 0)
        trial.record("frames that passed while paused", session.simulation.frame, 0)
        for _ in range(60):
            session.advance(1)
            trial.one_frame()
        after = simulation.positions(), simulation.velocities()
        trial.record("numbers that a pause changed later", changed(after, session), 0)
    finally:
        session.close()
    trial.settle()


def changed(before: tuple[np.ndarray, np.ndarray], session: Session) -> int:
    """Return how many components of positions and velocities differ from those of the session."""
    now = session.simulation.positions(), session.simulation.velocities()
    return sum(int((a != b).sum()) for a, b in zip(before, now, strict=True))


def coincident_particles(trial: Trial) -> None:
    """Start single particles and parts of rows at the positions of others, so that springs have length 0."""
    x = trial.open(sheet(CELLS))
    positions, middle = grid_of(trial, x.copy()), CELLS // 2
    positions[middle, middle] = positions[middle, middle + 1]
    positions[middle - 2, middle] = positions[middle - 1, middle + 1]
    positions[middle + 3 : middle + 6] = positions[middle + 3]
    trial.start(positions.reshape(-1, 3))
    trial.settle()


def degenerate(trial: Trial, kind: str) -> None:
    """Open a mesh file with a defect. It must be rejected with the file's name, or survive."""
    path = MESHES[kind](CELLS)
    # No float64 solver brings a mesh of slivers to rest, so the bound is the static strain of the mesh without them.
    rest = of_mesh(plain(CELLS)) if kind == SLIVERS else None
    open_or_refused(trial, of_mesh(path), path.name, rest)


def of_mesh(path: Path) -> Scene:
    """Return the base sheet with the points and faces of a file."""
    scene = sheet(CELLS)
    keys = type(scene.cloth)()  # mesh files do not support the keys of a grid
    cloth = replace(keys, file=path.name, folder=str(path.parent), center=(0.0, 0.0, 0.0), pins=(0, CELLS))
    return replace(scene, cloth=replace(cloth, area_density=scene.cloth.area_density))


def open_or_refused(trial: Trial, scene: Scene, name: str, rest: Scene | None) -> None:
    """Open a scene, which must survive or be rejected.

    The message of a rejection must contain `name`, the substeps that the springs would need, or that the solver needs
    other cloth. The result has it as a note.
    """
    try:
        trial.open(scene, rest=rest)
    except (SceneError, ObjError, UsageError) as error:
        reasons = name, "substeps", f"{trial.setting.solver.name} needs"
        named = any(reason in str(error) for reason in reasons)
        trial.check("refusals that name nothing", not named, 0)
        trial.record("refused", 1)
        message = str(error).replace(f"{folder()}{sep}", "")  # the folder is another one in each run
        trial.note(f"refused: {one_line(message)}")
        return
    trial.start()
    trial.settle()


def flat_cells(trial: Trial) -> None:
    """Open a sheet of cells ten thousand times as wide as high. Sides of length 0 must be rejected by name.

    Its strain at rest is a few millionths, σ·g·height/k. The bound is that of a sheet 1 m high, which is larger.
    """
    for key in ("width", "height"):
        trial.expect_error(key, partial(load_scene, "curtain", **{key: 0.0}))
    flat = sheet(CELLS, pins=("top",), size=(10.0, 1e-3))
    open_or_refused(trial, flat, "width", rest=sheet(CELLS, pins=("top",)))


def tiny(trial: Trial, shape: tuple[int, int]) -> None:
    """Hang a grid of `shape` (rows, columns) particles by its top edge, with cells of the usual size."""
    rows, columns = shape
    size = (CELL * (columns - 1), CELL * (rows - 1))
    trial.open(sheet((rows - 1, columns - 1), pins=("top",), size=size), far=2.0)
    trial.start()
    trial.settle()


def too_small(trial: Trial, shape: tuple[int, int]) -> None:
    """Open a grid with fewer than two particles along a side. It must be rejected by name."""
    rows, columns = shape
    short = "rows" if rows < 2 else "columns"
    trial.expect_error(short, lambda: load_scene("curtain", rows=rows, columns=columns))
    trial.record("refused", 1)


def far_away(trial: Trial, away: float) -> None:
    """Compare a sheet `away` [m] from the origin along x and y with one near it: sag and fall must be equal."""
    sags = []
    for x in (0.0, away):
        scene = sheet(CELLS, center=(x, x, 0.0))
        trial.open(scene)
        trial.start()
        trial.settle()
        sags.append(sag_of(trial, height=x))
    trial.record("sag beside that near the origin, share", difference(sags), SAG)

    ground = Ground(height=away - 2.0)
    trial.open(sheet(CELLS, pins=(), damping=0.0, rotation=FLAT, center=(away, away, 0.0), ground=ground))
    trial.start()
    simulation = trial.simulation
    start, speed = (values[:, 1].mean() for values in (simulation.positions(), simulation.velocities()))
    trial.run(FALL_SECONDS)
    fall = start + speed * FALL_SECONDS - float(simulation.positions()[:, 1].mean())
    first = FRAME_SECONDS / simulation.substeps / FALL_SECONDS  # share of the fall in one substep
    trial.record("fall beside ½gt², share", abs(fall / (GRAVITY * FALL_SECONDS**2 / 2) - 1), FALL + first)
    simulation.params["damping"] = DAMPING
    trial.run(LANDING_SECONDS)
    trial.settle()


def large(trial: Trial) -> None:
    """Run one frame of a million particles."""
    side = 1024
    size = CELL * (side - 1)
    trial.open(sheet(side - 1, pins=CORNERS, size=(size, size)), rest_strain=1.0)
    trial.start()
    trial.one_frame()  # not timed: the first frame may compile kernels
    trial.record("stretch in the first frame", trial.watch.strain)
    trial.check("places that are not finite", int((~np.isfinite(trial.simulation.positions())).sum()), 0)
    trial.skip_rest_check("one frame is all that the list asks for")


HANGING_FRAMES, SWINGING_FRAMES = 3_600, 3_600  # of the long run without `--soak`
LONG_HANGING, LONG_SWINGING = 1_000_000, 100_000
DRIFT = 1e-4  # share of the side, against the positions 20 s after the start
DRIFT_EVERY = 600  # frames between two looks at the drift


def hanging(trial: Trial, frames: int) -> None:
    """Run a sheet at rest. It may not drift."""
    trial.open(sheet(CELLS))
    trial.start()
    trial.settle()
    trial.run(STILL_SECONDS - CALM_SECONDS)
    before = trial.simulation.positions()
    for done in range(1, frames + 1):
        trial.one_frame()
        if done % DRIFT_EVERY == 0 or done == frames:
            trial.record("drift [m]", float(np.abs(trial.simulation.positions() - before).max()), DRIFT * SIDE)
    trial.settle()


def swinging(trial: Trial, frames: int) -> None:
    """Swing a sheet without damping, which may not gain energy; then with damping, until it comes to rest."""
    trial.open(sheet(CELLS, pins=("top",), damping=0.0, rotation=(30.0, 0.0, 0.0)))
    trial.start()
    for _ in range(frames):
        trial.one_frame()
    trial.simulation.params["damping"] = DAMPING
    trial.settle()
