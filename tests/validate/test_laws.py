"""The laws of sweeps that end too early and of rounding: against stored rows, against other laws, and exceeded."""

from functools import partial
from math import log2
from pathlib import Path

import numpy as np
import pytest

from taichi_cloth.accuracy.truth import Curtain, truth
from taichi_cloth.measure import convergence
from taichi_cloth.scene.model import FRAME_SECONDS, USUAL
from taichi_cloth.validate import exact, hanging, laws, membrane, report, swing, symmetry
from taichi_cloth.validate.row import SHORT, Result, Row, at_most

RESULTS = Path(__file__).parents[2] / "benchmarks" / "results"
SIDE = 0.2  # [kg] of a square metre
MOMENTS = [round(seconds / FRAME_SECONDS) - 1 for seconds in swing.CURTAIN_SECONDS]


def h_of(solver: str) -> float:
    return FRAME_SECONDS / USUAL[solver][0]


def stored(number: str, solver: str, what: str) -> Row:
    results: list[Result] = list(report.read_json(RESULTS / "validation.json").results)
    [row] = [one.row for one in results if (one.number, one.solver) == (number, solver) and one.row.what == what]
    assert row.verdict == SHORT
    return row


def sag_of_square(cells: int) -> float:
    mass = SIDE * membrane.SLACK**2 / (cells + 1) ** 2
    pull = membrane.tension(cells, membrane.CONSTANT)
    return laws.unfinished_sag(cells, pull, membrane.CONSTANT, mass, h_of("xpbd"), USUAL["xpbd"][1])


def every_row(cells: int) -> float:
    return swing.softer_curtain(cells, truth(Curtain(cells))[MOMENTS])


def verlet_mode(links: int, mode: int) -> float:
    h = h_of("verlet")
    return swing.softer_mode(links, mode - 1, USUAL["verlet"][1] / h**2, h)


BOUNDED = [
    *(
        ("A2.5", "xpbd", f"sag of a taut square of {n} cells under its weight [m]", partial(sag_of_square, n))
        for n in (64, 128)
    ),
    *(
        ("A8.7", "verlet", f"sag with {2 * n} links, against {n} [m]", partial(hanging.softer_sags, n, 2 * n))
        for n in (32, 64)
    ),
    ("B1", "verlet", "16 cells: every row, error of the side after 1 s", partial(every_row, 16)),
    ("B1", "verlet", "32 cells: every row, error of the side after 0.5 s", partial(every_row, 32)),
]
SLOW = [
    ("B1", "verlet", "64 cells: every row, error of the side after 0.5 s", partial(every_row, 64)),
    *(
        ("A2.3", "verlet", f"mode {m} of a hanging strip of {n} links [rad/s]", partial(verlet_mode, n, m))
        for n, m in ((50, 3), (100, 1), (100, 2), (100, 3))
    ),
    *(
        (
            "A8.9",
            solver,
            f"bottom row of {2 * n} cells after 1 s, against {n}, of the side",
            partial(swing.softer_apart, solver, n, 2 * n),
        )
        for solver, n in (("verlet", 32),)
    ),
]


@pytest.mark.parametrize(
    ("number", "solver", "what", "law"), [*BOUNDED, *(pytest.param(*one, marks=pytest.mark.long) for one in SLOW)]
)
def test_the_law_bounds_the_stored_row_and_nothing_much_worse(
    number: str, solver: str, what: str, law: partial
) -> None:
    row = stored(number, solver, what)
    error = law()
    judged = row.by_law("law", lambda: error)
    assert judged.explained
    worse = Row(what, row.exact, row.measured, error + 1.01 * row.good, row.good, row.best).by_law("law", lambda: error)
    assert worse.broken
    assert error > row.good  # by the law alone it would not pass


def test_sweeps_without_compliance_are_springs_that_stretch_by_the_law() -> None:
    rows, h, sweeps = 32, 1 / 300, 12
    soft = laws.softened("verlet", 0.0, 0.01, h, sweeps)
    longer = exact.hanging_drop(rows, 0.01, soft) * rows / (rows + 1)
    assert longer == pytest.approx(convergence.artificial_stretch(rows, h, sweeps), rel=1e-12)
    assert laws.softened("xpbd", 1e12, 0.01, h, sweeps) == pytest.approx(soft, rel=1e-3)
    assert laws.softened("xpbd", 10.0, 0.01, 1e-5, sweeps) == pytest.approx(10.0, rel=1e-6)


def test_the_curtain_of_the_law_is_the_true_one_where_sweeps_suffice() -> None:
    cells, frames = 4, 15
    curtain = Curtain(cells)
    squared = curtain.constant / curtain.mass
    exact_places = truth(curtain, frames)[-1]
    off = [
        float(np.abs(laws.euler_curtain(cells, squared, FRAME_SECONDS / n, frames)[-1] - exact_places).max())
        for n in (40, 80)
    ]
    assert off[0] / off[1] == pytest.approx(2, rel=0.15)  # of first order
    assert off[1] < 2e-3


def test_rounding_adds_up_as_in_float32() -> None:
    """Points whose speed changes from step to step, in float32 and in float64."""
    steps, h, numbers = 400, np.float32(1e-3), np.random.default_rng(3)
    x = numbers.uniform(0.5, 1.0, 2000).astype(np.float32)
    there = x.astype(np.float64)
    for _ in range(steps):
        v = numbers.uniform(0.1, 1.0, 2000).astype(np.float32)
        x = x + h * v
        there += np.float64(h) * v
    off = float(np.sqrt(((x - there) ** 2).mean()))
    bound = laws.rounding(steps, 0.4, 1.4, 1.0)
    assert 0.05 * bound < off < bound


def test_an_order_is_excused_by_rounding_alone() -> None:
    """Errors of fourth order on a floor are excused; those of second order, well above it, are not."""
    place, steps = np.array([[1.0, -0.9]]), [30, 60, 120, 240]
    floor = laws.rounding(240, symmetry.SOON, 1.0, 4.43)
    floored = symmetry.order_row(4.0, [9.1e-5, 6.1e-6, 3.7e-7, 1.6e-7], steps, place)
    assert floored.explained
    assert laws.order_lost(4.0, 3.7e-7, floor) == pytest.approx(4 - log2(3.7e-7 / (3.7e-7 / 16 + floor)))
    second = symmetry.order_row(4.0, [4e-3, 1e-3, 2.5e-4, 6.25e-5], steps, place)
    assert second.measured == pytest.approx(2.0)
    assert second.unexplained
    both = symmetry.order_row(4.0, [4e-3, 1e-3, 1e-6, 1e-6], steps, place)
    assert both.unexplained
    assert symmetry.order_row(4.0, [1.6e-1, 1e-2, 6.25e-4, 3.9e-5], steps, place).limit is None


def test_a_law_that_would_let_the_row_pass_explains_nothing() -> None:
    row = at_most("", 0.15, 0.1, 0.01)
    assert row.by_law("law", 0.1).unexplained
    assert row.by_law("law", lambda: 0.1).unexplained
    assert row.by_law("law", 0.101).explained
    assert row.by_law("law", 0.1, 0.06).explained
    assert row.by_law("law", 0.1, 0.04).broken


def test_a_law_that_takes_seconds_is_not_found_where_a_row_passes() -> None:
    def slow() -> float:
        raise AssertionError

    assert at_most("", 0.05, 0.1, 0.01).by_law("law", slow).limit is None
