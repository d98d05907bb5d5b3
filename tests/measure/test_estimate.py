"""Errors foretold: against the rows they come from, and what is picked by them."""

from dataclasses import replace

import pytest

from taichi_cloth import cli, load_scene
from taichi_cloth.accuracy import sweep
from taichi_cloth.accuracy.truth import Curtain
from taichi_cloth.cli_options import chosen_scene
from taichi_cloth.errors import WrongUse
from taichi_cloth.measure.estimate import FINEST, NEEDED, aim, estimate, law, measured, rows_near
from taichi_cloth.scene.model import SOLVER_NAMES, Cloth, Scene, Solver


def square(cells: int) -> Scene:
    return Scene(cloth=Cloth(rows=cells + 1, columns=cells + 1, width=1.0, height=1.0))


def test_every_solver_was_measured() -> None:
    assert {row.solver for row in measured()} == set(SOLVER_NAMES)


LAWFUL = [row for row in measured() if row.substeps <= FINEST.get(row.solver, 0)]


@pytest.mark.parametrize("row", LAWFUL, ids=lambda row: f"{row.cells}-{row.setting}")
def test_the_law_holds_where_it_is_used(row) -> None:
    foretold = law(row.cells, row.substeps, row.iterations, 9.81, 1.0)
    assert row.error / 1.6 < foretold < row.error * 1.6


@pytest.mark.parametrize("row", rows_near(64), ids=lambda row: row.setting)
def test_what_was_measured_is_what_is_said(row) -> None:
    error = estimate(square(64), row.solver, row.substeps, row.iterations, 9.81)
    same = [r.error for r in rows_near(64) if r.solver == row.solver]
    assert error == (same[0] if row.solver in NEEDED else row.error)


# Of every method a row of the smallest grid.
SIMULATED = [
    ("verlet", 5, 12),
    ("xpbd", 20, 1),
    ("lines", 5, 1),
    ("spring", 28, 1),
    ("rk4", 20, 1),
    ("projective", 5, 10),
]


@pytest.mark.parametrize(("solver", "substeps", "iterations"), SIMULATED, ids=[solver for solver, *_ in SIMULATED])
def test_what_is_shipped_is_what_is_measured_now(
    solver: str, substeps: int, iterations: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The curtain swings again: a method that has become worse, or better, has another error than its row."""
    monkeypatch.setattr(sweep, "kept", lambda *setting: None)  # of another scene, whose kernel would be compiled
    grid = min(row.cells for row in measured())
    setting = (solver, grid, substeps, iterations)
    row = next(r for r in measured() if (r.solver, r.cells, r.substeps, r.iterations) == setting)
    factor = 1 if solver in NEEDED else substeps  # times what it needs
    found = sweep.measure(Curtain(grid), solver, factor, iterations)
    assert found.substeps == substeps
    assert found.rms_error == pytest.approx(row.error, rel=0.02, abs=2e-6)  # of float32 at a metre


def test_the_law_is_for_what_was_not_measured_and_ends_where_rounding_begins() -> None:
    curtain = load_scene("curtain")
    coarse, fine = (estimate(curtain, "verlet", n, 12, 9.81) for n in (3, 30))
    assert coarse is not None
    assert fine is not None
    assert coarse > 10 * fine
    assert estimate(curtain, "verlet", 3, 12, 0.0) == 0.0
    assert estimate(curtain, "verlet", 1000, 12, 9.81) is None
    assert estimate(curtain, "projective", 7, 3, 9.81) is None


def test_between_two_rows_of_lines_the_error_is_between_theirs() -> None:
    rows = [row for row in rows_near(64) if row.solver == "lines"]
    low, high = rows[1], rows[2]
    found = estimate(square(64), "lines", (low.substeps + high.substeps) // 2, 1, 9.81)
    assert found is not None
    assert high.error < found < low.error
    assert estimate(square(64), "lines", 1, 1, 9.81) is None


def test_the_fastest_good_enough_is_taken() -> None:
    scene, why = aim(square(64), 0.02)
    rows = rows_near(64)
    taken = next(r for r in rows if (r.solver, r.substeps) == (scene.solver.name, scene.solver.substeps))
    assert taken.error <= 0.02
    assert all(row.ms >= taken.ms for row in rows if row.error <= 0.02)
    assert why.startswith("target 2 %: ")
    assert "measured on a swinging curtain of 64 cells" in why
    exact, _ = aim(square(64), 1e-5)
    assert exact.solver.name == "spring"
    assert aim(square(64), 0.02, "xpbd")[0].solver.name == "xpbd"


def test_a_stiff_fabric_asks_an_explicit_method_for_more_substeps() -> None:
    soft = aim(square(64), 1e-5, "spring")[0]
    stiff = aim(replace(square(64), fabric=replace(soft.fabric, warp=4 * soft.fabric.warp)), 1e-5, "spring")[0]
    assert stiff.solver.substeps > 1.3 * soft.solver.substeps


def test_what_nothing_reaches_is_refused() -> None:
    with pytest.raises(WrongUse, match=r"an error of 1e-12 % was never measured: rk4 \d+ has .*e-0. %"):
        aim(square(64), 1e-14, "rk4")


def test_the_option(capsys: pytest.CaptureFixture[str]) -> None:
    for words in (["0"], ["x"], ["nan"], ["101"]):
        with pytest.raises(SystemExit) as ended:
            cli.main(["run", "curtain", "--target-error", *words])
        assert ended.value.code == 2
        assert "above 0 and up to 100" in capsys.readouterr().err
    assert cli.main(["render", "curtain", "--target-error", "1e-12"]) == 2
    assert "was never measured" in capsys.readouterr().err
    args = cli.build_parser().parse_args(["render", "curtain", "--target-error", "0.5"])
    scene = chosen_scene(args)
    assert scene.solver != Solver()
    assert capsys.readouterr().out.startswith("target 0.5 %: ")
