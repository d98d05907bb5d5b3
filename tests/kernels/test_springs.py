"""Springs, against values computed by hand: slack springs within an iteration, loops that visit each spring once, and
the strain limit.
"""

from collections.abc import Iterator
from math import exp
from typing import Any

import numpy as np
import pytest
import taichi as ti
from serial_kernels import run_serially

from taichi_cloth import state
from taichi_cloth.geometry.topology import Topology, build_sheet
from taichi_cloth.kernels import distance_limits, springs
from taichi_cloth.kernels import step_params as c
from taichi_cloth.kernels.simd_sweep import PairConstraint
from taichi_cloth.solvers import Features
from taichi_cloth.solvers.graph_runner import run_phase
from taichi_cloth.state.layouts import acquire_parallel

pytestmark = pytest.mark.bounds

NONE = np.zeros((1, c.COLLIDER_COLUMNS), np.float32)  # no collider
ALL = [True] * 6
ROWS_ONLY = [True, *[False] * 5]


def flat(rows: int, columns: int, directions: list[bool]) -> Topology:
    """Return a sheet with cells of 1 m and 1 kg per particle."""
    return build_sheet(
        rows=rows,
        columns=columns,
        width=columns - 1.0,
        height=rows - 1.0,
        center=(0.0, 0.0, 0.0),
        rotation=(0.0, 0.0, 0.0),
        area_density=1.0,
        mass_lumping="uniform",
        pins=(),
        directions=directions,
    )


@pytest.fixture
def cloth() -> Iterator[tuple[state.ClothState, Topology]]:
    """Two springs of 1 m, side by side."""
    topology = flat(2, 2, ROWS_ONLY)
    acquired = state.acquire_state(topology)
    acquired.upload(topology, np.ones(topology.spring_count))
    yield acquired, topology
    state.release_state(acquired)


@ti.func
def relax_all(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    springs.for_each_spring(cloth, features, springs.DISTANCE_XPBD, ctx.params, ctx.h)


@pytest.mark.parametrize(
    ("length", "accumulated", "expected"),
    [
        # With k·h² = 1 kg and 1 kg at each end, λ changes by −(error + λ)/3, and each end moves by that.
        (0.99, -0.05, -0.03),  # shorter than at rest, but only by its own correction of 0.1 m: still taut
        (0.99, 0.0, 0.0),  # slack: no correction
        (0.85, -0.05, 0.0),  # slack even without its correction, which is undone
        (1.30, 0.0, -0.1),  # a third of the error of 0.3 m
    ],
)
def test_slackness_ignores_the_accumulated_correction(
    cloth: tuple[state.ClothState, Topology], length: float, accumulated: float, expected: float
) -> None:
    fields, topology = cloth
    x = topology.start * [length, 1.0, 1.0]
    fields.upload_positions(x, x, state.inverse_mass(topology))
    multipliers = np.zeros(fields.multiplier.shape[0], np.float32)
    multipliers[: topology.spring_count] = accumulated
    fields.multiplier.from_numpy(multipliers)
    params = np.zeros(c.PARAM_COUNT, np.float32)
    params[c.STIFFNESS_FACTOR] = 1.0
    run_serially(relax_all, fields, Features(soft_compression=True), 0, 1, 1.0, -1, params, NONE)
    assert fields.multiplier.to_numpy()[: topology.spring_count] == pytest.approx(expected, abs=1e-6)
    gap = np.ptp(fields.to_numpy(fields.x)[:2, 0])
    assert gap == pytest.approx(length + 2 * (expected - accumulated), abs=1e-6)


# -- every spring once ---------------------------------------------------------------------------------------------


@ti.func
def count(cloth: ti.template(), features: ti.template(), a, b, e, stiffness, params: ti.template(), h):
    cloth.multiplier[e] = cloth.multiplier[e] + 1.0


COUNT = PairConstraint(count)
COLORS = 11  # two in each direction, but one for bend springs along columns of four rows


@ti.func
def count_all(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    springs.for_each_spring(cloth, features, COUNT, ctx.params, ctx.h)


@ti.func
def count_from_third_color(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    springs.for_each_spring_from(cloth, features, 2, COLORS - 2, COUNT, ctx.params, ctx.h)


@pytest.mark.parametrize("run", [run_serially, run_phase])
def test_each_spring_is_visited_once_and_a_partial_loop_visits_its_colors_only(run: Any) -> None:
    """`run_phase` uses the parallel layout: one loop for each possible color, some empty."""
    topology = flat(4, 5, ALL)
    counts = {}
    for phase in (count_all, count_from_third_color):
        cloth = state.acquire_state(topology)
        cloth.upload(topology, np.ones(topology.spring_count))
        layout = acquire_parallel(cloth, topology) if run is run_phase else cloth
        cloth.multiplier.from_numpy(np.zeros_like(cloth.multiplier.to_numpy()))
        assert springs.max_colors(layout) > len(topology.batches) == COLORS
        run(phase, layout, Features(), 0, 1, 1.0, -1, np.zeros(c.PARAM_COUNT, np.float32), NONE)
        counts[phase] = cloth.multiplier.to_numpy()
        state.release_state(cloth)
    first = sum(batch.count for batch in topology.batches[:2])
    numbers = np.arange(len(counts[count_all]))
    assert (counts[count_all] == (numbers < topology.spring_count)).all()
    assert (counts[count_from_third_color] == ((numbers >= first) & (numbers < topology.spring_count))).all()


# -- the strain limit ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("iterations", [8, 33, 160, 480])
def test_an_error_decays_to_the_same_share_for_any_number_of_iterations(iterations: int) -> None:
    """Over-relaxation by a factor f leaves (f − 1) of an error per iteration: in total about e⁻⁴."""
    assert (distance_limits.over_relaxation(iterations) - 1) ** iterations == pytest.approx(exp(-4.0), rel=0.5)
    assert 1 < distance_limits.over_relaxation(iterations) < 2
