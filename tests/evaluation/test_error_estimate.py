"""Estimated errors, compared with the measured ones, and the settings that are selected by them."""

from dataclasses import replace

import pytest

from taichi_cloth import load_scene
from taichi_cloth.__main__ import main
from taichi_cloth.cli import run
from taichi_cloth.cli.program import build_parser, chosen_scene
from taichi_cloth.evaluation.bench import error_sweep
from taichi_cloth.evaluation.bench.error_sweep import Curtain
from taichi_cloth.scene.collider_schema import Ground, Plane
from taichi_cloth.scene.fabric_schema import Fabric
from taichi_cloth.scene.schema import SOLVER_NAMES, Cloth, Scene, Solver, Tearing
from taichi_cloth.simulation import error_estimate
from taichi_cloth.simulation.error_estimate import (
    MIN_STABLE_SUBSTEPS,
    Candidates,
    cost_of,
    faster_solver,
    measured,
    nearest_setting,
    settings_for_error,
    settings_for_time,
    settings_near,
)
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.system.errors import UsageError


def square(cells: int) -> Scene:
    return Scene(cloth=Cloth(rows=cells + 1, columns=cells + 1, width=1.0, height=1.0))


def test_every_solver_was_measured() -> None:
    assert {row.solver for row in measured()} == set(SOLVER_NAMES)


@pytest.mark.parametrize("cells", sorted({row.cells for row in measured()}))
def test_a_measured_setting_is_nearest_to_itself(cells: int) -> None:
    for row in settings_near(cells):
        assert nearest_setting(cells, row.solver, row.substeps, row.iterations) == row
    assert {nearest_setting(cells, name, 10, 3).solver for name in SOLVER_NAMES} == set(SOLVER_NAMES)


def test_the_time_of_a_setting_that_was_not_measured_is_in_proportion_to_its_work() -> None:
    row = nearest_setting(64, "xpbd", 120, 4)
    measured_row = next(r for r in settings_near(64) if r.setting == "xpbd 60×4")
    assert row.ms == pytest.approx(2 * measured_row.ms)


def test_a_faster_solver_is_the_most_accurate_that_is_fast_enough_or_else_the_fastest() -> None:
    solvers = {
        name: Solver(name=name, substeps=n, iterations=i)
        for name, n, i in (("verlet", 5, 12), ("xpbd", 60, 4), ("lines", 10, 2), ("implicit", 20, 1))
    }

    def faster(name: str, ms: float, limit_ms: float) -> str:
        others = [solver for solver in solvers.values() if solver.name != name]
        return faster_solver(64, solvers[name], others, ms, limit_ms)

    ms = {name: nearest_setting(64, name, s.substeps, s.iterations).ms for name, s in solvers.items()}
    assert ms["verlet"] < ms["lines"] < ms["xpbd"] < ms["implicit"]
    times = {limit: faster("implicit", ms["implicit"], limit) for limit in (100.0, 16.7, ms["xpbd"] - 0.1, 2.0, 1.0)}
    assert [*times.values()] == ["lines", "lines", "lines", "verlet", "verlet"]
    assert faster("xpbd", 10 * ms["xpbd"], 16.7) == "verlet"
    assert faster("verlet", 100.0, 16.7) == ""
    assert faster_solver(64, solvers["xpbd"], [], 100.0, 16.7) == ""


# A row of the smallest grid for every solver.
SIMULATED = [
    ("verlet", 5, 12),
    ("xpbd", 20, 1),
    ("lines", 5, 1),
    ("explicit", 32, 1),
    ("rk4", 20, 1),
    ("implicit", 5, 1),
]


@pytest.mark.parametrize(("solver", "substeps", "iterations"), SIMULATED, ids=[solver for solver, *_ in SIMULATED])
def test_the_shipped_errors_can_be_reproduced(
    solver: str, substeps: int, iterations: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The swinging curtain is simulated again: if a solver has become worse or better, its error differs."""
    monkeypatch.setattr(error_sweep, "remaining_amplitude", lambda *setting: None)  # would compile another scene
    grid = min(row.cells for row in measured())
    setting = (solver, grid, substeps, iterations)
    row = next(r for r in measured() if (r.solver, r.cells, r.substeps, r.iterations) == setting)
    factor = 1 if solver in MIN_STABLE_SUBSTEPS else substeps  # a multiple of the fewest that are stable
    found = error_sweep.measure(Curtain(grid), solver, factor, iterations)
    assert found.substeps == substeps
    assert found.rms_error == pytest.approx(row.error, rel=0.02, abs=2e-6)  # float32 at one meter


def test_the_fastest_setting_that_meets_the_target_is_selected() -> None:
    scene, why = settings_for_error(square(64), 0.02)
    rows = settings_near(64)
    selected = next(r for r in rows if (r.solver, r.substeps) == (scene.solver.name, scene.solver.substeps))
    assert selected.error <= 0.02
    assert all(row.ms >= selected.ms for row in rows if row.error <= 0.02)
    assert why.startswith("verlet 20×1, about ")
    measured_at = f"({100 * selected.error:.2g} % on a swinging curtain of 64 cells)"
    assert f": the fastest setting whose error is at most 2 % {measured_at}; on this scene time and error may" in why
    exact, _ = settings_for_error(square(64), 1e-5)
    assert exact.solver.name in {row.solver for row in rows if row.error <= 1e-5}
    assert exact.solver.name not in ("verlet", "xpbd")  # no setting of theirs was that accurate
    assert settings_for_error(square(64), 0.02, "xpbd")[0].solver.name == "xpbd"


def test_solvers_without_membranes_are_not_selected_for_one() -> None:
    scene = replace(square(64), fabric=Fabric(model="membrane"))
    assert settings_for_error(square(64), 1e-3, "lines")[0].solver.name == "lines"
    assert settings_for_error(scene, 1e-3)[0].solver.name not in ("lines", "verlet")
    with pytest.raises(UsageError, match=r'lines does not support fabric\.model = "membrane"; use xpbd, explicit'):
        settings_for_error(scene, 1e-3, "lines")
    with pytest.raises(UsageError, match="lines does not support"):
        cost_of(replace(scene, solver=Solver("lines")))


def test_a_stiff_fabric_needs_more_substeps_with_an_explicit_solver() -> None:
    soft = settings_for_error(square(64), 1e-5, "explicit")[0]
    stiff, why = settings_for_error(
        replace(square(64), fabric=replace(soft.fabric, warp=4 * soft.fabric.warp)), 1e-5, "explicit"
    )
    assert stiff.solver.substeps > 1.3 * soft.solver.substeps
    [row] = [row for row in settings_near(64) if row.setting in why]  # the error is that of the measured setting
    assert row.solver == "explicit"
    assert row.substeps != stiff.solver.substeps


def test_the_most_accurate_setting_within_a_time_is_selected() -> None:
    rows = Candidates.of(square(64), None).rows
    assert [row.ms for row in rows] == sorted(row.ms for row in rows)
    for limit in (rows[0].ms, 3.0, 1e4):
        scene, why = settings_for_time(square(64), limit)
        affordable = [row for row in rows if row.ms <= limit]
        best = min(affordable, key=lambda row: row.error)
        assert (scene.solver.name, scene.solver.substeps) == (best.solver, best.substeps)
        assert f"the most accurate setting that takes at most {limit:g} ms" in why
        assert ("; the fastest more accurate setting is " in why) == any(row.error < best.error for row in rows)
    with pytest.raises(UsageError, match=r"no measured setting takes at most 0\.001 ms a frame: the fastest, [a-z]+ "):
        settings_for_time(square(64), 0.001)
    assert settings_for_time(square(64), 3.0, "xpbd")[0].solver.name == "xpbd"


def test_times_of_a_target_are_those_that_check_estimates() -> None:
    """Wind and colliders are in neither; springs besides the structural ones are."""
    scene = load_scene("curtain")
    for row in Candidates.of(scene, None).rows:
        solver = Solver(row.solver, row.substeps, row.iterations)
        assert row.ms == pytest.approx(cost_of(replace(scene, solver=solver)).ms)


def test_solvers_that_do_not_support_a_scene_are_no_candidates() -> None:
    tearing = replace(square(8), tearing=Tearing())
    assert "lines" in {row.solver for row in Candidates.of(square(8), None).rows}
    assert "lines" not in {row.solver for row in Candidates.of(tearing, None).rows}
    with pytest.raises(UsageError, match="lines needs a grid with whole rows"):
        settings_for_time(tearing, 10.0, "lines")


def test_an_unreachable_target_is_refused() -> None:
    with pytest.raises(
        UsageError, match=r"no measured setting reaches an error of 1e-12 %: the best, rk4 \d+, has .*e-0. %"
    ):
        settings_for_error(square(64), 1e-14, "rk4")


def test_the_option_target_error(capsys: pytest.CaptureFixture[str]) -> None:
    for words in (["0"], ["x"], ["nan"], ["101"]):
        with pytest.raises(SystemExit) as ended:
            main(["run", "curtain", "--target-error", *words])
        assert ended.value.code == 2
        assert "above 0 and up to 100" in capsys.readouterr().err
    assert main(["render", "curtain", "--target-error", "1e-12"]) == 2
    assert "no measured setting reaches" in capsys.readouterr().err
    args = build_parser([run]).parse_args(["render", "curtain", "--target-error", "0.5"])
    scene = chosen_scene(args)
    assert scene.solver != Solver()
    first, second = capsys.readouterr().out.splitlines()
    assert ": the fastest setting whose error is at most 0.5 % (" in first
    assert second.endswith(
        "RMS errors and times; `taichi-cloth bench --error --scene curtain` measures this scene on this machine"
    )


@pytest.mark.parametrize("words", [["--solver", "xpbd"], ["--set", "solver=xpbd"], ["--set", "solver.name=xpbd"]])
@pytest.mark.parametrize("target", [["--target-error", "5"], ["--target-time", "5"]])
def test_a_target_keeps_the_solver_that_is_given(target: list[str], words: list[str]) -> None:
    args = build_parser([run]).parse_args(["render", "curtain", *target, *words])
    assert chosen_scene(args).solver.name == "xpbd"


@pytest.mark.parametrize("key", ["substeps", "iterations", "solver.substeps", "solver.iterations"])
@pytest.mark.parametrize("option", ["--target-error", "--target-time"])
def test_a_target_beside_a_setting_is_one_line(option: str, key: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["render", "curtain", option, "5", "--set", f"{key}=3"]) == 2
    assert capsys.readouterr().err == (
        f"taichi-cloth: {option} selects substeps and iterations: leave out --set {key}\n"
    )


def test_the_option_target_time(capsys: pytest.CaptureFixture[str]) -> None:
    for word in ("0", "x", "nan", "-1"):
        with pytest.raises(SystemExit) as ended:
            main(["run", "curtain", f"--target-time={word}"])
        assert ended.value.code == 2
        assert "is not a time from 0.001 to 10000 [ms]" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(["run", "curtain", "--target-time", "2", "--target-error", "2"])
    assert "not allowed with argument" in capsys.readouterr().err
    assert main(["render", "curtain", "--target-time", "0.001"]) == 2
    assert "no measured setting takes at most" in capsys.readouterr().err


# -- cost ----------------------------------------------------------------------------------------------------

STIFF = Scene(
    cloth=Cloth(rows=12, columns=14, width=0.3, height=0.3, area_density=0.1),
    fabric=Fabric(bending_stiffness=1e-3, damping_time=0.02),
    planes=(Plane(response="repulsion", stiffness=1e6),),
    ground=Ground(response="repulsion", stiffness=1e6),
)


@pytest.mark.parametrize("solver", SOLVER_NAMES)
@pytest.mark.parametrize("scene", [STIFF, load_scene("curtain"), load_scene("slope")], ids=lambda scene: scene.name)
def test_the_cost_has_the_substeps_and_springs_of_the_simulation(scene: Scene, solver: str) -> None:
    scene = replace(scene, solver=Solver(solver, substeps=2, iterations=3))
    cost = cost_of(scene)
    with Simulation(scene) as simulation:
        topology = simulation.topology
        assert cost.substeps == simulation.substeps
        assert simulation.method.startswith(f"{cost.setting} · ")
        assert cost.particles == topology.particle_count
        assert cost.springs == topology.spring_count
        assert cost.bending_links == len(topology.bending_links.ends)


@pytest.mark.parametrize("solver", SOLVER_NAMES)
def test_a_part_of_a_large_sheet_stands_for_it(monkeypatch: pytest.MonkeyPatch, solver: str) -> None:
    cloth = Cloth(rows=90, columns=150, width=2.0, height=1.0, rotation=(30.0, 0.0, 70.0), pins=("left", 9000))
    bending = 0.0 if solver == "lines" else 1e-4  # transverse waves limit the substeps of `lines`
    scene = Scene(cloth=cloth, fabric=Fabric(bending_stiffness=bending), solver=Solver(solver, substeps=1))
    whole = cost_of(scene)
    monkeypatch.setattr(error_estimate, "SAMPLE", 40)
    part = cost_of(scene)
    assert part.particles == whole.particles
    assert part.springs == pytest.approx(whole.springs, rel=0.03)
    assert part.bending_links == pytest.approx(whole.bending_links, rel=0.03)
    assert part.substeps == pytest.approx(whole.substeps, rel=0.03)
    assert part.ms == pytest.approx(whole.ms, rel=0.06)


@pytest.mark.parametrize("row", settings_near(64), ids=lambda row: row.setting)
def test_the_estimated_time_of_a_measured_setting_is_the_measured_time(row) -> None:
    """The measured sheets have structural springs only, of 1000 N/m."""
    scene = error_sweep.scene_of(Curtain(64), row.solver, row.substeps, row.iterations)
    cost = cost_of(scene)
    assert cost.substeps == row.substeps
    assert cost.ms == pytest.approx(row.ms)
    assert cost.is_measured_size


def test_the_estimated_time_grows_with_everything_that_is_processed() -> None:
    def ms(
        rows: int = 30, substeps: int = 7, iterations: int = 5, tearing: Tearing | None = None, **cloth: int
    ) -> float:
        scene = Scene(
            cloth=Cloth(rows=rows, columns=30, **cloth), solver=Solver("xpbd", substeps, iterations), tearing=tearing
        )
        return cost_of(scene).ms

    assert ms(rows=31) > ms()
    assert ms(substeps=8) > ms()
    assert ms(iterations=6) > ms()
    assert ms(layers=2) > 2 * ms()
    assert ms(tearing=Tearing()) > 2 * ms()
    assert ms(diagonals=1) < ms()


@pytest.mark.parametrize(("solver", "parts"), [("xpbd", 1 / 5), ("explicit", 1.0), ("lines", 0.0)])
def test_the_estimated_time_counts_bending_once_in_a_substep(solver: str, parts: float) -> None:
    stiff, limp = (
        cost_of(Scene(fabric=Fabric(bending_stiffness=b), solver=Solver(solver, substeps=200, iterations=5)))
        for b in (1e-7, 0.0)
    )
    assert stiff.bending_links > limp.bending_links == 0
    added = parts * stiff.bending_links / (limp.particles + limp.springs)
    assert stiff.ms / limp.ms == pytest.approx(1 + added, rel=1e-3)


def test_a_sheet_larger_than_those_measured_is_not_of_measured_size() -> None:
    assert [cost_of(square(cells)).is_measured_size for cells in (500, 600)] == [True, False]


def test_verlet_is_not_selected_for_a_fabric_that_it_ignores() -> None:
    scene = load_scene("curtain", solver="xpbd", fabric_warp=60000.0)
    chosen, why = settings_for_error(scene, 0.005)
    assert chosen.solver.name != "verlet"
    assert why.endswith("; verlet is left out: it does not use [fabric]")
    asked, why = settings_for_error(scene, 0.005, "verlet")
    assert asked.solver.name == "verlet"
    assert "left out" not in why
