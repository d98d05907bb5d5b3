"""`bench --gpu`: no test depends on a time. Real runs need a GPU, or the software Vulkan of Mesa."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import taichi as ti

from taichi_cloth.__main__ import main
from taichi_cloth.evaluation.bench import gpu, gpu_kernels, gpu_report
from taichi_cloth.evaluation.bench.error_sweep import FRAMES, Curtain, curtain_solution, scene_of
from taichi_cloth.evaluation.bench.gpu_report import Comparison, GpuRun, GridRow
from taichi_cloth.evaluation.worker_pool import TIME, JobFailed, Worker
from taichi_cloth.scene.solver_catalog import SOLVER_CATALOG
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.system import taichi_compat
from taichi_cloth.system import taichi_runtime as runtime

AVAILABLE = [a for a in ("cuda", "vulkan", "metal") if ti.lang.misc.is_arch_supported(getattr(ti, a))]

ROW = GridRow(
    *("explicit", 256, 444, 1, True),
    particles=66_049,
    frames=FRAMES,
    median_ms=12.0,
    p95_ms=13.0,
    rms_error=1e-4,
    max_error=4e-3,
    reference="converged float64 motion of 256 cells",
    rms_uncertainty=1e-7,
    max_uncertainty=1e-6,
    phases=889,
    megabytes=8000.0,
    setup_s=1.0,
    compile_s=2.0,
)
RUN = GpuRun(
    "cuda",
    "a GPU",
    2e12,
    [Comparison("ball and wind", "explicit", 5, 1e-8, 2e-8, 1e-7), Comparison("ball and wind", "rk4", 5, error=TIME)],
    [ROW.over(2e12), GridRow.failed("explicit", 512, "out of memory")],
    {"errors on 512 cells": TIME},
    12.0,
)


# -- the command -------------------------------------------------------------------------------------------------------


def test_without_a_gpu_the_command_is_refused_by_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(taichi_compat, "is_arch_available", lambda name: False)
    assert main(["bench", "--gpu"]) == 2
    assert capsys.readouterr().err == "taichi-cloth: arch gpu is not available: this machine has cpu\n"
    assert main(["bench", "--gpu", "--arch", "cuda"]) == 2
    assert capsys.readouterr().err == "taichi-cloth: arch cuda is not available: this machine has cpu\n"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--gpu", "--all"], "cannot be combined with --all"),
        (["--gpu", "--error"], "use only one of"),
        (["--arch", "cuda"], "--arch needs --gpu"),
        (["--gpu", "--error", "--scene", "table"], "--goals or --gpu"),
    ],
)
def test_other_options_are_refused(options: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", *options]) == 2
    assert message in capsys.readouterr().err


def test_the_command_writes_and_prints_what_was_measured(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def measure(plan: gpu.Plan, on_step: object, save: object) -> GpuRun:
        assert callable(save)
        save(RUN)
        return RUN

    monkeypatch.setattr(runtime, "available_arch", lambda arch: "cuda")
    monkeypatch.setattr(gpu, "measure", measure)
    assert main(["bench", "--gpu", "--json", str(tmp_path / "gpu.json")]) == 0
    words = json.loads((tmp_path / "gpu.json").read_text())
    assert {"machine", "date", "commit", "device", "summary"} <= set(words)
    assert gpu_report.read_run(words) == RUN
    out = capsys.readouterr().out
    assert "failed: out of memory" in out
    assert "66,049 particles, explicit 444, 12.0 ms" in out
    assert "Bandwidth of a copy, read and written: 2,000 GB/s" in out
    assert "errors on 512 cells: not measured: time" in out


# -- rows --------------------------------------------------------------------------------------------------------------


def test_verdicts_of_comparisons() -> None:
    assert [row.verdict for row in RUN.comparisons] == ["pass", "not measured: time"]
    assert replace(RUN.comparisons[0], max_meters=2e-4).verdict == "differs"


def test_real_time_needs_a_whole_second_a_short_frame_and_a_small_error() -> None:
    assert ROW.is_real_time
    slow, short = replace(ROW, median_ms=17.0), replace(ROW, frames=FRAMES - 1)
    wrong, unsure = replace(ROW, max_error=0.011), replace(ROW, max_uncertainty=0.007)
    unknown = replace(ROW, max_error=None)
    assert not any(row.is_real_time for row in (slow, short, wrong, unsure, unknown))
    faster, finer = replace(ROW, median_ms=11.0), replace(ROW, cells=512, median_ms=16.0)
    assert gpu_report.largest_real_time([ROW, faster, slow]) == faster
    assert gpu_report.largest_real_time([ROW, finer]) == finer
    assert gpu_report.largest_real_time([slow]) is None


# -- bytes -------------------------------------------------------------------------------------------------------------


def test_bytes_of_a_frame() -> None:
    """Of a cloth with 100 particles and 180 springs; counted by hand."""
    # x, previous x, force and inverse mass are read, the first three written; 16 bytes of a spring, and of both ends x
    # and inverse mass read and x written.
    verlet = 5 * (100 * (40 + 36) + 12 * 180 * (16 + 2 * 28))
    assert gpu_report.frame_bytes("verlet", {"predict": 5, "iterate": 60, "finalize": 5}, 100, 180) == verlet
    # x, force and an index read, force written; then x, velocity, force and inverse mass read, the first three written.
    explicit = 3 * (100 * (28 + 12 + 40 + 36) + 180 * 24)
    assert gpu_report.frame_bytes("explicit", {"predict": 3, "finalize": 2}, 100, 180) == explicit
    assert gpu_report.frame_bytes("explicit", {"another": 1}, 100, 180) is None


@pytest.mark.parametrize("solver", SOLVER_CATALOG)
def test_all_phases_that_a_frame_queues_are_counted(solver: str) -> None:
    substeps, iterations = 2, 3
    with Simulation(scene_of(Curtain(4), solver, substeps, iterations), "parallel") as simulation:
        with gpu.counted_phases(simulation) as phases:
            simulation.step()
        stages = simulation.substeps * (2 if solver in ("lines", "implicit") else 1)
    assert set(phases) <= set(gpu_report.TRAFFIC[solver])
    assert phases["finalize"] == stages
    assert gpu_report.frame_bytes(solver, phases, 25, 40)


# -- time --------------------------------------------------------------------------------------------------------------


def test_finer_grids_are_left_out_where_they_would_take_too_long() -> None:
    grids: list[int] = []

    def on_grid(cells: int, seconds: float) -> list[GridRow]:
        grids.append(cells)
        return [GridRow("explicit", cells, 10, 1, median_ms=cells**3 / 64**3, setup_s=cells**2 / 64**2, compile_s=1.0)]

    left_out = gpu.sweep("explicit", (64, 128, 256, 512), 15.0, on_grid)
    assert grids == [64, 128]  # 256 cells would take 16 s, 1 s, and three frames
    assert [(row.cells, row.error, row.is_default) for row in left_out] == [(256, TIME, True), (512, TIME, True)]


def test_a_grid_that_failed_does_not_end_the_sweep() -> None:
    grids: list[int] = []

    def on_grid(cells: int, seconds: float) -> list[GridRow]:
        grids.append(cells)
        return [GridRow.failed("lines", cells, "out of memory")]

    assert gpu.sweep("lines", (64, 128), 10.0, on_grid) == []
    assert grids == [64, 128]


def test_without_time_nothing_is_measured() -> None:
    worker = Worker(nothing)
    assert gpu.compare("ball and wind", "xpbd", worker, worker, 0.0).error == TIME
    run = GpuRun("cuda", "a GPU")
    gpu.add_cpu_time(run, worker, "xpbd", 64, -1.0)
    assert run.missing == {"xpbd, 64 cells on the CPU": TIME}


# -- workers -----------------------------------------------------------------------------------------------------------


def nothing() -> None:
    """Begin or job of a worker that does nothing."""


def fail() -> None:
    raise ValueError("two\nlines")


def test_a_job_that_fails_crashes_or_hangs_has_a_reason_and_the_next_one_runs() -> None:
    worker = Worker(nothing)
    try:
        with pytest.raises(JobFailed, match=r"^ValueError: two\\nlines$"):
            worker.run(fail, seconds=60)
        with pytest.raises(JobFailed, match=r"^the process ended with exit code 7$"):
            worker.run(os._exit, 7, seconds=60)
        assert worker.run(max, 2, 3, seconds=60) == 3
        with pytest.raises(JobFailed, match=f"^{TIME}$"):
            worker.run(input_of_nobody, seconds=0.2)
        assert worker.run(max, 2, 4, seconds=60) == 4
    finally:
        worker.close()


def input_of_nobody() -> None:
    while True:
        pass


def test_a_worker_that_cannot_begin_fails_every_job() -> None:
    worker = Worker(fail)
    try:
        for _ in range(2):
            with pytest.raises(JobFailed, match="ValueError"):
                worker.run(max, 2, 3, seconds=60)
    finally:
        worker.close()


def test_a_grid_that_crashes_is_a_row() -> None:
    worker = Worker(fail)
    (row,) = gpu.grid_rows(worker, "rk4", 64, None, 1.0)
    assert (row.solver, row.cells, row.error) == ("rk4", 64, "ValueError: two\\nlines")


# -- kernels -----------------------------------------------------------------------------------------------------------


def test_the_converged_motion_is_that_of_the_reference() -> None:
    found = gpu_kernels.converged_swing(16)
    difference = np.linalg.norm(found.positions - curtain_solution(Curtain(16)), axis=2)
    assert difference.max() < found.max_uncertainty < 1e-6
    assert 0 < found.rms_uncertainty < found.max_uncertainty


def test_the_error_on_the_device_is_that_of_the_positions() -> None:
    curtain = Curtain(6)
    with Simulation(scene_of(curtain, "explicit", 1, 1), "serial") as simulation:
        simulation.step(3)
        expected = curtain_solution(curtain, 4)[3]
        x = simulation.positions().reshape(7, 7, 3)[:, :, [2, 1]]
        distance = np.linalg.norm(x - expected[:, None], axis=2)
        square, largest = gpu_kernels.curtain_distances(simulation.cloth, simulation.origin, expected)
        simulation.set_state(np.full((49, 3), 1e6))
        assert gpu_kernels.curtain_distances(simulation.cloth, simulation.origin, expected)[1] > 1e5
    assert square == pytest.approx((distance**2).mean(), rel=1e-4)
    assert largest == pytest.approx(distance.max(), rel=1e-4)


def test_a_copy_has_a_bandwidth() -> None:
    assert gpu_kernels.copy_bandwidth(1 << 16) > 0


# -- a real run --------------------------------------------------------------------------------------------------------


def test_scenes_have_contact_in_the_compared_frames() -> None:
    """Without the ball, and without self-collision, they end elsewhere."""
    for name, without in (("ball and wind", {"spheres": ()}), ("layers on a floor", {"self_collision": None})):
        scene = gpu.SCENES[name]("explicit")
        with Simulation(replace(scene, **without), "serial") as simulation:  # type: ignore[arg-type]
            simulation.step(gpu.COMPARED_FRAMES)
            assert abs(simulation.positions() - gpu.end_positions(name, "explicit", "serial")).max() > 1e-3


@pytest.mark.skipif(not AVAILABLE, reason="no GPU and no Vulkan")
def test_a_small_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gpu, "SCENES", {"ball and wind": gpu.ball_and_wind})
    saved: list[int] = []
    steps: list[str] = []
    plan = gpu.Plan(AVAILABLE[0], 600.0, (8,), ("explicit", "rk4"), 1 << 16)
    run = gpu.measure(plan, steps.append, lambda run: saved.append(len(run.rows)))
    assert len(steps) <= plan.steps + 1
    assert run.bandwidth is not None
    assert run.missing == {}
    assert [(row.solver, row.verdict) for row in run.comparisons] == [("explicit", "pass"), ("rk4", "pass")]
    assert [(row.solver, row.cells, row.error) for row in run.rows] == [("explicit", 8, None), ("rk4", 8, None)]
    for row in run.rows:
        assert row.median_ms is not None
        assert row.cpu_ms is not None
        assert row.max_error is not None
        assert row.max_error < 1e-3
        assert row.bandwidth_share is not None
    assert saved[-1] == 2


def test_the_time_of_the_first_setting_bounds_the_others() -> None:
    rows = gpu.measure_grid("xpbd", 4, None, seconds=0.0)
    assert (rows[0].is_default, rows[0].error, rows[0].frames) == (True, None, 2)
    assert {row.error for row in rows[1:]} == {TIME}
