"""What is done to springs, by hand numbers: slack ones in the middle of an iteration, sweeps that treat each once, and
the strain limit.
"""

from collections.abc import Iterator
from math import exp
from typing import Any

import numpy as np
import pytest
import taichi as ti
from serially import run_serially

from taichi_cloth import state
from taichi_cloth.kernels import controls as c
from taichi_cloth.kernels import springs
from taichi_cloth.kernels.strips import Treatment
from taichi_cloth.mesh.topology import Topology, sheet
from taichi_cloth.solvers import Stages
from taichi_cloth.solvers.launches import run_part
from taichi_cloth.state.gather import gathering

NONE = np.zeros((1, c.BODY_COLUMNS), np.float32)  # no collider
ALL = [True] * 6
ROWS_ONLY = [True, *[False] * 5]


def flat(rows: int, columns: int, directions: list[bool]) -> Topology:
    """Cells of a metre; a kilogram for each particle."""
    return sheet(
        rows=rows,
        columns=columns,
        width=columns - 1.0,
        height=rows - 1.0,
        center=(0.0, 0.0, 0.0),
        rotation=(0.0, 0.0, 0.0),
        area_density=1.0,
        lumping="equal",
        pins=(),
        directions=directions,
    )


@pytest.fixture
def cloth() -> Iterator[tuple[state.ClothState, Topology]]:
    """Two bars of a metre, beside each other."""
    topology = flat(2, 2, ROWS_ONLY)
    taken = state.take(topology)
    taken.upload(topology, np.ones(topology.spring_count))
    yield taken, topology
    state.give_back(taken)


@ti.func
def relax_all(cloth: ti.template(), stages: ti.template(), now: ti.template()):
    springs.for_springs(cloth, stages, springs.RELAX_COMPLIANT, now.controls, now.h)


@pytest.mark.parametrize(
    ("length", "gathered", "expected"),
    [
        # With k·h² of 1 kg and 1 kg at each end: λ grows by −(error + λ)/3, and each end goes by that.
        (0.99, -0.05, -0.03),  # shorter than at rest, but only by its own pull of 0.1 m: it is still taut
        (0.99, 0.0, 0.0),  # slack: no push
        (0.85, -0.05, 0.0),  # slack without its pull too: all of that is given back
        (1.30, 0.0, -0.1),  # a third of the error of 0.3 m
    ],
)
def test_whether_a_thread_is_slack_is_told_without_the_pull_it_has_gathered(
    cloth: tuple[state.ClothState, Topology], length: float, gathered: float, expected: float
) -> None:
    fields, topology = cloth
    x = topology.start * [length, 1.0, 1.0]
    fields.put(x, x, state.inverse_mass(topology))
    multipliers = np.zeros(fields.multiplier.shape[0], np.float32)
    multipliers[: topology.spring_count] = gathered
    fields.multiplier.from_numpy(multipliers)
    controls = np.zeros(c.COUNT, np.float32)
    controls[c.STIFFNESS] = 1.0
    run_serially(relax_all, fields, Stages(slack=True), 0, 1, 1.0, -1, controls, NONE)
    assert fields.multiplier.to_numpy()[: topology.spring_count] == pytest.approx(expected, abs=1e-6)
    gap = np.ptp(fields.taken(fields.x)[:2, 0])
    assert gap == pytest.approx(length + 2 * (expected - gathered), abs=1e-6)


# -- every spring once ---------------------------------------------------------------------------------------------


@ti.func
def count(cloth: ti.template(), stages: ti.template(), a, b, e, stiffness, controls: ti.template(), h):
    cloth.multiplier[e] = cloth.multiplier[e] + 1.0


COUNT = Treatment(count)
COLOURS = 11  # two in each direction, but for the one of bend springs down four rows


@ti.func
def count_all(cloth: ti.template(), stages: ti.template(), now: ti.template()):
    springs.for_springs(cloth, stages, COUNT, now.controls, now.h)


@ti.func
def count_from_the_third(cloth: ti.template(), stages: ti.template(), now: ti.template()):
    springs.for_springs_from(cloth, stages, 2, COLOURS - 2, COUNT, now.controls, now.h)


@pytest.mark.parametrize("run", [run_serially, run_part])
def test_a_sweep_treats_every_spring_once_and_one_of_the_last_colours_those_alone(run: Any) -> None:
    """`run_part` is for threads side by side: one loop for each colour that there may be, some empty."""
    topology = flat(4, 5, ALL)
    counts = {}
    for part in (count_all, count_from_the_third):
        taken = state.take(topology)
        taken.upload(topology, np.ones(topology.spring_count))
        work = gathering(taken, topology) if run is run_part else taken
        springs_of = taken.multiplier.to_numpy()
        springs_of[:] = 0.0
        taken.multiplier.from_numpy(springs_of)
        assert springs.most_batches(work) > len(topology.batches) == COLOURS
        run(part, work, Stages(), 0, 1, 1.0, -1, np.zeros(c.COUNT, np.float32), NONE)
        counts[part] = taken.multiplier.to_numpy()
        state.give_back(taken)
    first = sum(batch.count for batch in topology.batches[:2])
    numbers = np.arange(len(counts[count_all]))
    assert (counts[count_all] == (numbers < topology.spring_count)).all()
    assert (counts[count_from_the_third] == ((numbers >= first) & (numbers < topology.spring_count))).all()


# -- the strain limit ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("sweeps", [8, 33, 160, 480])
def test_what_is_too_much_has_died_away_at_the_end_of_the_sweeps(sweeps: int) -> None:
    """Over-relaxation by a factor f leaves (f − 1) of it a sweep: about e⁻⁴ at the end, however many there are."""
    assert (springs.over_relaxation(sweeps) - 1) ** sweeps == pytest.approx(exp(-4.0), rel=0.5)
    assert 1 < springs.over_relaxation(sweeps) < 2
