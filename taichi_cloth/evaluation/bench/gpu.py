"""Measures the program on a GPU in five minutes: same motion as on the CPU, frame times, errors, bandwidth (`--gpu`).

Everything runs in worker processes (`worker_pool.Worker`), one of them on the GPU: a case that fails, crashes or hangs
is a row with the reason, and the next one gets a new process. Grids of a solver that would take longer than its share
of the time are left out, the finest first.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from math import sqrt
from pathlib import Path
from typing import Any

import numpy as np
import taichi as ti

from ...geometry.scene_loader import load_scene
from ...scene import Scene
from ...scene.collider_schema import Ground
from ...scene.schema import Cloth, SelfCollision, Solver, Wind
from ...scene.solver_catalog import SOLVER_CATALOG
from ...simulation.copies import time_frames, timed_frame
from ...simulation.simulation import Simulation
from ...system import taichi_runtime as runtime
from ...system.console import steps_progress
from ..worker_pool import TIME, JobFailed, Worker, reason
from .error_sweep import FRAMES, SETTINGS, Curtain, scene_of
from .gpu_kernels import Floats, Swing, converged_swing, copy_bandwidth, curtain_distances
from .gpu_report import Comparison, GpuRun, GridRow, device_name, frame_bytes, print_report, write_json

COMPARED_FRAMES = 5
CPU_CELLS = 256  # finest grid that is timed on the CPU too
CPU_FRAMES = 20
REAL_TIME_SECONDS = 1.5  # enough for all frames of a setting that runs in real time, and their errors [s]


@dataclass(frozen=True)
class Plan:
    """What to measure, and in which time."""

    arch: str
    """One that Taichi has on this machine."""
    seconds: float = 300.0
    """Time of the whole run [s]."""
    cells: tuple[int, ...] = (64, 128, 256, 512, 1024, 2048)
    """Cells along a side of the grids, from coarse to fine."""
    solvers: tuple[str, ...] = tuple(SOLVER_CATALOG)
    copied_bytes: int = 1 << 28
    """Size of the array whose copy is timed [bytes]; larger than any cache."""

    @property
    def coarse(self) -> tuple[int, ...]:
        """The grids that are timed on the CPU too."""
        return tuple(cells for cells in self.cells if cells <= CPU_CELLS)

    @property
    def steps(self) -> int:
        """Number of measurements, for a progress bar."""
        return 2 + len(self.solvers) * (len(SCENES) + len(self.cells) + len(self.coarse))


# -- jobs of the workers -----------------------------------------------------------------------------------------------


def ball_and_wind(solver: str) -> Scene:
    """Return a small curtain with a ball that pushes it from the first frame on, in the wind."""
    scene = load_scene("curtain", rows=12, columns=15, substeps=2, iterations=3, solver=solver)
    ball = replace(scene.spheres[0], center=(0.0, 1.3, -0.7), oscillation=(0.0, 0.0, 0.0))
    return replace(scene, spheres=(ball,))


def layers_on_a_floor(solver: str) -> Scene:
    """Return two layers closer than their thickness, of which an edge meets a floor with friction, in the wind."""
    return Scene(
        name="layers on a floor",
        cloth=Cloth(
            rows=12,
            columns=12,
            width=1.0,
            height=1.0,
            center=(0.0, 0.08, 0.0),
            rotation=(-80.0, 0.0, 0.0),
            pins=(),
            layers=2,
            layer_spacing=0.04,
        ),
        solver=Solver(solver, 2, 3),
        self_collision=SelfCollision(thickness=0.05),
        ground=Ground(friction=0.5),
        wind=Wind(x=0.0, z=5.0),
    )


SCENES = {"ball and wind": ball_and_wind, "layers on a floor": layers_on_a_floor}


def end_positions(name: str, solver: str, layout: str | None) -> Floats:
    """Return the positions of a scene of `SCENES` after `COMPARED_FRAMES` frames [m], (N, 3)."""
    with Simulation(SCENES[name](solver), layout) as simulation:
        simulation.step(COMPARED_FRAMES)
        return simulation.positions()


@contextmanager
def counted_phases(simulation: Simulation) -> Iterator[Counter[str]]:
    """Count the phases that are queued on the GPU within the block, by name."""
    runner = simulation.solver.runner
    run, counts = runner.run, Counter[str]()

    def counting(phases: Sequence[tuple[Any, int]], shared: dict[str, object]) -> None:
        counts.update(phase.__name__ for phase, _ in phases)
        run(phases, shared)

    runner.run = counting  # type: ignore[method-assign]
    try:
        yield counts
    finally:
        runner.run = run  # type: ignore[method-assign]


def measure_setting(simulation: Simulation, row: GridRow, motion: Swing | None, seconds: float) -> GridRow:
    """Run the swing from its start, for about `seconds` [s] and at least two frames. Return `row` with the results.

    The first frame is not timed: it queues the launches of this setting for the first time.
    """
    simulation.reset()
    end = time.perf_counter() + seconds
    ms: list[float] = []
    distances: list[tuple[float, float]] = []
    with counted_phases(simulation) as phases:
        timed_frame(simulation)
    for frame in range(FRAMES):
        if frame:
            if ms and time.perf_counter() > end:
                break
            ms.append(timed_frame(simulation))
        if motion is not None:
            expected = motion.positions[frame]
            distances.append(curtain_distances(simulation.cloth, simulation.origin, expected))
    topology = simulation.topology
    moved = frame_bytes(row.solver, phases, topology.particle_count, topology.spring_count)
    row = replace(
        row,
        frames=len(ms) + 1,
        median_ms=float(np.median(ms)),
        p95_ms=float(np.percentile(ms, 95)),
        phases=phases.total() or None,
        megabytes=None if not moved else moved / 1e6,
    )
    if motion is None:
        return row
    squares, largest = np.array(distances).T
    if not np.isfinite(squares).all():
        return replace(row, error="the cloth blew up")
    return replace(
        row,
        rms_error=sqrt(float(squares.mean())),
        max_error=float(largest.max()),
        reference=f"converged float64 motion of {row.cells} cells",
        rms_uncertainty=motion.rms_uncertainty,
        max_uncertainty=motion.max_uncertainty,
    )


def measure_grid(solver: str, cells: int, motion: Swing | None, seconds: float) -> list[GridRow]:
    """Measure the default setting of a solver on the curtain, and then those of `error_sweep`, in about `seconds` [s].

    A setting that fails is the last: the GPU may be unusable after an error.
    """
    start = time.perf_counter()
    info = SOLVER_CATALOG[solver]
    settings = [info.defaults, *(() if info.is_explicit else SETTINGS[solver])]
    rows: dict[tuple[int, int], GridRow] = {}
    with Simulation(scene_of(Curtain(cells), solver, *info.defaults)) as simulation:
        ti.sync()
        setup_s = time.perf_counter() - start
        compile_s = max(timed_frame(simulation) - timed_frame(simulation), 0.0) / 1e3
        for number, (substeps, iterations) in enumerate(settings):
            simulation.params["substeps"], simulation.params["iterations"] = substeps, iterations
            setting = simulation.substeps, iterations
            if setting in rows:
                continue
            row = GridRow(
                *(solver, cells, *setting, number == 0),
                particles=simulation.topology.particle_count,
                setup_s=setup_s,
                compile_s=compile_s,
            )
            left = seconds - (time.perf_counter() - start)
            if rows and left < predicted_seconds(next(iter(rows.values())), setting):
                rows[setting] = replace(row, error=TIME)
                continue
            try:
                share = max(left / (len(settings) - number), min(left / 2, REAL_TIME_SECONDS))
                rows[setting] = measure_setting(simulation, row, motion, share)
            except Exception as error:
                rows[setting] = replace(row, error=reason(error))
                break
    return list(rows.values())


def predicted_seconds(measured: GridRow, setting: tuple[int, int]) -> float:
    """Return the time of two frames with another setting on the grid of a measured one [s]."""
    work = (setting[0] * (setting[1] + 1)) / (measured.substeps * (measured.iterations + 1))
    return 0.0 if measured.median_ms is None else 2e-3 * measured.median_ms * work


def cpu_frame(solver: str, cells: int, seconds: float) -> tuple[float, str]:
    """Return the median frame time of the default setting on the curtain [ms], and the layout, in about `seconds`."""
    with Simulation(scene_of(Curtain(cells), solver, *SOLVER_CATALOG[solver].defaults)) as simulation:
        timed_frame(simulation)  # compiles
        (ms,) = time_frames([simulation], CPU_FRAMES, seconds)
        return float(np.median(ms)), simulation.solver.layout_name


# -- the run -----------------------------------------------------------------------------------------------------------

SCENES_END, GRIDS_END = 0.35, 0.8  # shares of the time after which no scene, and no grid, is begun
SENDING_SECONDS = 10.0  # enough to receive a motion that is ready
SPARE_SECONDS = 30.0  # a job may take so much longer than planned before its process is ended


def measure_and_report(arch: str, path: Path | None) -> None:
    """Measure and print. The results are written to `path` after each measurement: a driver may end the program."""

    def save(run: GpuRun) -> None:
        if path is not None:
            write_json(path, run)

    plan = Plan(arch)
    with steps_progress(plan.steps) as on_step:
        run = measure(plan, on_step, save)
    print_report(run)


def measure(plan: Plan, on_step: Callable[[str], None], save: Callable[[GpuRun], None]) -> GpuRun:
    """Measure all that the plan has. `save` is called with the unfinished run after each measurement."""
    start = time.perf_counter()
    run = GpuRun(plan.arch, device_name(plan.arch))

    def left(share: float) -> float:
        """Return the time left until this share of the whole [s]."""
        return plan.seconds * share - (time.perf_counter() - start)

    def update(what: str) -> None:
        run.seconds = time.perf_counter() - start
        save(run)
        on_step(what)

    # Without a kernel cache, so that the time to compile is that of a first run.
    gpu = Worker(partial(runtime.start, plan.arch, offline_cache=False))
    cpu, motions = Worker(partial(runtime.start, "cpu")), Worker(partial(runtime.start, "cpu", cpu_max_num_threads=1))
    try:
        on_step("bandwidth")
        measure_bandwidth(run, gpu, plan.copied_bytes)
        for cells in plan.cells:
            motions.start(converged_swing, cells)
        for name in SCENES:
            for solver in plan.solvers:
                update(f"{name}, {solver}")
                run.comparisons.append(compare(name, solver, cpu, gpu, left(SCENES_END)))
        update("converged motions")
        found = collect_motions(motions, plan.cells, lambda: left(SCENES_END), run.missing)
        for number, solver in enumerate(plan.solvers):

            def on_grid(cells: int, seconds: float, solver: str = solver) -> list[GridRow]:
                update(f"{solver}, {cells} cells")
                rows = grid_rows(gpu, solver, cells, found.get(cells), seconds)
                run.rows += [row.over(run.bandwidth) for row in rows]
                return rows

            share = left(GRIDS_END) / (len(plan.solvers) - number)
            run.rows += sweep(solver, plan.cells, share, on_grid)
        gpu.close()
        for cells in plan.coarse:
            for solver in plan.solvers:
                update(f"{solver}, {cells} cells on the CPU")
                add_cpu_time(run, cpu, solver, cells, left(1.0))
        update("done")
    finally:
        for worker in (gpu, cpu, motions):
            worker.close()
    return run


def measure_bandwidth(run: GpuRun, gpu: Worker, size: int) -> None:
    """Set the bandwidth of a copy of `size` bytes; of a smaller one where that is refused, or takes too long."""
    for copied in (size, size // 16):
        try:
            run.bandwidth = gpu.run(copy_bandwidth, copied, seconds=SPARE_SECONDS)
            run.missing.pop("bandwidth", None)
            return
        except JobFailed as error:
            run.missing["bandwidth"] = str(error)
            gpu.close()


def compare(name: str, solver: str, cpu: Worker, gpu: Worker, seconds: float) -> Comparison:
    """Run a scene on the CPU and on the GPU at once, and compare the ends."""
    found = Comparison(name, solver, COMPARED_FRAMES)
    if seconds <= 0:
        return replace(found, error=TIME)
    cpu.start(end_positions, name, solver, "serial")
    gpu.start(end_positions, name, solver, None)
    ends: list[Floats] = []
    errors = []
    for where, worker in (("CPU", cpu), ("GPU", gpu)):
        try:
            ends.append(worker.result(seconds + SPARE_SECONDS))
        except JobFailed as error:
            errors.append(TIME if str(error) == TIME else f"{where}: {error}")
            worker.close()
    if errors:
        return replace(found, error=errors[0])
    if not np.isfinite(ends[1]).all():
        return replace(found, error="positions on the GPU are not finite")
    distance = np.linalg.norm(ends[1] - ends[0], axis=1)
    cloth = SCENES[name](solver).cloth
    side = max(cloth.width, cloth.height)
    return replace(
        found,
        rms_difference=sqrt(float((distance**2).mean())) / side,
        max_difference=float(distance.max()) / side,
        max_meters=float(distance.max()),
    )


def collect_motions(
    worker: Worker, grids: Sequence[int], left: Callable[[], float], missing: dict[str, str]
) -> dict[int, Swing]:
    """Return the converged motions that are ready in time, by cells; `missing` gets the others."""
    found = {}
    for position, cells in enumerate(grids):
        try:
            found[cells] = worker.result(max(left(), SENDING_SECONDS))
        except JobFailed as error:
            missing |= {f"errors on {n} cells": str(error) for n in grids[position:]}
            break
    worker.close()
    return found


def grid_rows(gpu: Worker, solver: str, cells: int, motion: Swing | None, seconds: float) -> list[GridRow]:
    """Return the rows of one grid; after an error the next grid gets a new process."""
    try:
        rows: list[GridRow] = gpu.run(
            measure_grid, solver, cells, motion, seconds, seconds=1.5 * seconds + SPARE_SECONDS
        )
    except JobFailed as error:
        rows = [GridRow.failed(solver, cells, str(error))]
    if any(row.error not in (None, TIME) for row in rows):
        gpu.close()
    return rows


def sweep(
    solver: str, grids: Sequence[int], seconds: float, on_grid: Callable[[int, float], list[GridRow]]
) -> list[GridRow]:
    """Measure a solver on all grids, from coarse to fine, in `seconds` [s]. Return rows for the grids left out.

    `on_grid(cells, seconds)` measures one, and returns its rows. Each finer grid gets more of the time.
    """
    end = time.perf_counter() + seconds
    last: GridRow | None = None
    for position, cells in enumerate(grids):
        left = end - time.perf_counter()
        if left <= 0 or (last is not None and grid_seconds(last, cells) > left):
            return [GridRow.failed(solver, n, TIME) for n in grids[position:]]
        rows = on_grid(cells, left * 2 / (len(grids) - position + 1))
        last = rows[0] if rows[0].error is None else None
    return []


def grid_seconds(coarser: GridRow, cells: int) -> float:
    """Return the time that a finer grid takes at least [s]: to build, to compile, and for three frames.

    A frame takes longer by the number of particles, and by that of substeps or of products in a search.
    """
    finer = cells / coarser.cells
    ms = coarser.median_ms or 0.0
    return (coarser.setup_s or 0.0) * finer**2 + (coarser.compile_s or 0.0) + 3e-3 * ms * finer**3


def add_cpu_time(run: GpuRun, cpu: Worker, solver: str, cells: int, seconds: float) -> None:
    """Add the time on the CPU to the row of the default setting, if there is time left."""
    at = [n for n, row in enumerate(run.rows) if (row.solver, row.cells, row.is_default) == (solver, cells, True)]
    try:
        if seconds <= 0:
            raise JobFailed(TIME)
        ms, layout = cpu.run(cpu_frame, solver, cells, min(1.0, seconds), seconds=seconds + SPARE_SECONDS)
        for n in at:
            run.rows[n] = replace(run.rows[n], cpu_ms=ms, cpu_layout=layout)
    except JobFailed as error:
        run.missing[f"{solver}, {cells} cells on the CPU"] = str(error)
