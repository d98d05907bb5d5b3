"""Laws of iterations that end too early and of rounding, compared with stored rows and other laws, and exceeded."""

from functools import partial
from math import log2
from pathlib import Path

import numpy as np
import pytest

from taichi_cloth.evaluation.bench.error_sweep import Curtain, curtain_solution
from taichi_cloth.evaluation.validate import check, exact, hanging, membrane, strand, swing, symmetry
from taichi_cloth.evaluation.validate import validation_report as report
from taichi_cloth.evaluation.validate.check import FAIL, Check, Result, at_most
from taichi_cloth.scene.schema import FRAME_SECONDS
from taichi_cloth.scene.solver_catalog import SOLVER_CATALOG
from taichi_cloth.simulation import error_estimate

RESULTS = Path(__file__).parents[2] / "benchmarks" / "results"
AREA_DENSITY = 0.2  # [kg/m²]
CURTAIN_FRAMES = [round(seconds / FRAME_SECONDS) - 1 for seconds in swing.CURTAIN_SECONDS]


def substep_of(solver: str) -> float:
    return FRAME_SECONDS / SOLVER_CATALOG[solver].substeps


def stored(number: str, solver: str, what: str) -> Check:
    results: list[Result] = list(report.read_json(RESULTS / "validation.json").results)
    [row] = [one.row for one in results if (one.number, one.solver) == (number, solver) and one.row.what == what]
    assert row.verdict == FAIL
    return row


def sag_of_square(cells: int) -> float:
    mass = AREA_DENSITY * membrane.SLACK**2 / (cells + 1) ** 2
    pull = membrane.tension(cells, membrane.CONSTANT)
    iterations = SOLVER_CATALOG["xpbd"].iterations
    return check.unconverged_sag(cells, pull, membrane.CONSTANT, mass, substep_of("xpbd"), iterations)


def every_row(cells: int) -> float:
    return swing.unconverged_curtain(cells, curtain_solution(Curtain(cells))[CURTAIN_FRAMES])


def verlet_mode(links: int, mode: int) -> float:
    h = substep_of("verlet")
    return swing.unconverged_mode(links, mode - 1, SOLVER_CATALOG["verlet"].iterations / h**2, h)


BOUNDED = [
    *(
        ("A2.5", "xpbd", f"sag of a taut square of {n} cells under its weight [m]", partial(sag_of_square, n))
        for n in (64, 128)
    ),
    *(
        (
            "A8.7",
            "verlet",
            f"sag with {2 * n} links, against {n} [m]",
            partial(hanging.exact_sag_change, "verlet", n, 2 * n),
        )
        for n in (32, 64)
    ),
    ("A8.7", "xpbd", "sag with 128 links, against 64 [m]", partial(hanging.exact_sag_change, "xpbd", 64, 128)),
    ("B1", "verlet", "16 cells: every row, error of the side after 1 s", partial(every_row, 16)),
    ("B1", "verlet", "32 cells: every row, error of the side after 0.5 s", partial(every_row, 32)),
]
SLOW = [
    ("B1", "verlet", "64 cells: every row, error of the side after 0.5 s", partial(every_row, 64)),
    *(
        ("A2.3", "verlet", f"mode {m} of a hanging strip of {n} links [rad/s]", partial(verlet_mode, n, m))
        for n, m in ((50, 3), (100, 1), (100, 2), (100, 3))
    ),
    (
        "A8.9",
        "verlet",
        "bottom row of 64 cells after 1 s, against 32, of the side",
        partial(strand.exact_change, "verlet", 32, 64),
    ),
]


@pytest.mark.parametrize(
    ("number", "solver", "what", "law"), [*BOUNDED, *(pytest.param(*one, marks=pytest.mark.long) for one in SLOW)]
)
def test_the_law_explains_the_stored_row_and_nothing_much_worse(
    number: str, solver: str, what: str, law: partial
) -> None:
    row = stored(number, solver, what)
    error = law()
    judged = row.by_law("law", lambda: error)
    assert judged.explained
    worse = Check(
        what, row.exact, row.measured, error + 1.01 * row.tolerance, row.tolerance, row.tight_tolerance
    ).by_law("law", lambda: error)
    assert worse.broken
    assert error > row.tolerance  # a row with this error alone would not pass


def test_iterations_without_compliance_are_springs_with_the_artificial_stretch() -> None:
    rows, h, iterations = 32, 1 / 300, 12
    soft = check.effective_stiffness("verlet", 0.0, 0.01, h, iterations)
    longer = exact.hanging_drop(rows, 0.01, soft) * rows / (rows + 1)
    assert longer == pytest.approx(error_estimate.artificial_stretch(rows, h, iterations), rel=1e-12)
    assert check.effective_stiffness("xpbd", 1e12, 0.01, h, iterations) == pytest.approx(soft, rel=1e-3)
    assert check.effective_stiffness("xpbd", 10.0, 0.01, 1e-5, iterations) == pytest.approx(10.0, rel=1e-6)


def test_the_curtain_of_the_law_converges_to_the_exact_one() -> None:
    cells, frames = 4, 15
    curtain = Curtain(cells)
    squared = curtain.stiffness / curtain.mass
    exact_positions = curtain_solution(curtain, frames)[-1]
    errors = [
        float(np.abs(strand.euler_curtain(cells, squared, FRAME_SECONDS / n, frames)[-1] - exact_positions).max())
        for n in (40, 80)
    ]
    assert errors[0] / errors[1] == pytest.approx(2, rel=0.15)  # first order
    assert errors[1] < 2e-3


def test_the_law_of_rounding_bounds_the_error_of_float32() -> None:
    """Points whose speed changes from step to step, in float32 and in float64."""
    steps, h, random = 400, np.float32(1e-3), np.random.default_rng(3)
    x = random.uniform(0.5, 1.0, 2000).astype(np.float32)
    x64 = x.astype(np.float64)
    for _ in range(steps):
        v = random.uniform(0.1, 1.0, 2000).astype(np.float32)
        x = x + h * v
        x64 += np.float64(h) * v
    error = float(np.sqrt(((x - x64) ** 2).mean()))
    bound = check.rounding_error(steps, 0.4, 1.4, 1.0)
    assert 0.05 * bound < error < bound


def test_only_rounding_explains_a_lower_order() -> None:
    """Errors of fourth order above a floor are explained. Errors of second order far above the floor are not."""
    positions, steps = np.array([[1.0, -0.9]]), [30, 60, 120, 240]
    floor = check.rounding_error(240, symmetry.SHORT_SECONDS, 1.0, 4.43)
    floored = symmetry.order_row(4.0, [9.1e-5, 6.1e-6, 3.7e-7, 1.6e-7], steps, positions)
    assert floored.explained
    assert check.order_lost(4.0, 3.7e-7, floor) == pytest.approx(4 - log2(3.7e-7 / (3.7e-7 / 16 + floor)))
    second = symmetry.order_row(4.0, [4e-3, 1e-3, 2.5e-4, 6.25e-5], steps, positions)
    assert second.measured == pytest.approx(2.0)
    assert second.unexplained
    both = symmetry.order_row(4.0, [4e-3, 1e-3, 1e-6, 1e-6], steps, positions)
    assert both.unexplained
    assert symmetry.order_row(4.0, [1.6e-1, 1e-2, 6.25e-4, 3.9e-5], steps, positions).limit is None


def test_a_law_within_the_tolerance_explains_nothing() -> None:
    row = at_most("", 0.15, 0.1, 0.01)
    assert row.by_law("law", 0.1).unexplained
    assert row.by_law("law", lambda: 0.1).unexplained
    assert row.by_law("law", 0.101).explained
    assert row.by_law("law", 0.1, 0.06).explained
    assert row.by_law("law", 0.1, 0.04).broken


def test_a_law_that_is_a_function_is_not_computed_if_the_row_passes() -> None:
    def slow() -> float:
        raise AssertionError

    assert at_most("", 0.05, 0.1, 0.01).by_law("law", slow).limit is None


def test_the_exact_bottoms_of_the_curtain_differ_by_more_than_a_thousandth_past_64_cells() -> None:
    """docs/accuracy.md says so: no solver can pass this row without an error of its own."""
    change = strand.exact_change("explicit", 64, 128)
    assert change == pytest.approx(1.97e-3, rel=0.01)
    assert change > check.FINER[64, 128][0]
