"""The watch finds each kind of failure when it is fed one, and none where all is well."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from math import inf

import numpy as np
import pytest

from taichi_cloth.scene.model import Forces, Solver, Sphere
from taichi_cloth.stress.scenes import sheet
from taichi_cloth.stress.setting import Setting
from taichi_cloth.stress.trial import OutOfTime, Trial, close
from taichi_cloth.stress.watch import Broken

SETTING = Setting("xpbd", Solver("xpbd", 10, 1), cells=8)


@pytest.fixture(autouse=True)
def given_back() -> Iterator[None]:
    yield
    close()


def running(**sections: object) -> Trial:
    """A sheet that hangs, ten frames after its start."""
    trial = Trial(SETTING, 0)
    trial.open(sheet(8, **sections), rest=inf)
    trial.start()
    trial.run(1 / 6)
    return trial


def without_telling(trial: Trial, change: Callable[[np.ndarray, np.ndarray], None]) -> None:
    """Changes places [m] or velocities [m/s] behind the watch's back."""
    x, v = trial.simulation.positions(), trial.simulation.velocities()
    change(x, v)
    trial.simulation.place(x, v)


def test_a_cloth_that_hangs_is_alive() -> None:
    trial = running()
    trial.settle()
    assert trial.frame == 310
    assert trial.worst.energy <= 0.001
    assert 0 < trial.worst.speed < 5
    assert 0 < trial.worst.strain < 0.1


def test_energy_out_of_nothing() -> None:
    trial = running()

    def faster(x: np.ndarray, v: np.ndarray) -> None:
        v += [0.0, 0.0, 1.0]  # ½·0.2 kg·(1 m/s)² = 0.1 J, of 3.9 at hand

    without_telling(trial, faster)
    with pytest.raises(Broken, match="energy") as found:
        trial.one_frame()
    assert found.value.bound == pytest.approx(0.01 * 2 * 0.2 * 9.81, rel=0.01)
    assert 0.04 < found.value.value < 0.1


def test_energy_that_was_given_is_none_out_of_nothing() -> None:
    trial = running()
    x, v = trial.simulation.positions(), trial.simulation.velocities()
    before = trial.energy()
    trial.act(lambda: trial.simulation.place(x, v + [0.0, 0.0, 1.0]))
    assert trial.energy() - before == pytest.approx(0.1, rel=0.1)
    trial.run(0.1)


def test_energy_of_a_stretched_spring_is_known() -> None:
    """Stretched to twice its width a sheet of 8 × 8 cells has 8·8 springs along its rows of 1000 N/m and more."""
    trial = Trial(SETTING, 0)
    x = trial.open(sheet(8, forces=Forces(gravity=0.0), constant=1000.0), rest=inf)
    trial.start(x * [2.0, 1.0, 1.0], shake=0.0)
    along, cell = 8 * 8, 1 / 8
    diagonal = cell * (np.sqrt(5) - np.sqrt(2))
    expected = 500 * (along * cell**2 + 2 * 8 * 8 * diagonal**2)
    assert trial.energy() == pytest.approx(expected, rel=1e-4)


def test_slack_threads_have_no_energy_where_they_are_short() -> None:
    """Along its rows half as wide, along its columns twice as high: only springs down the columns are stretched."""
    for compression in (0.0, 0.25, 1.0):
        trial = Trial(replace(SETTING, compression=compression), 0)
        x = trial.open(sheet(8, forces=Forces(gravity=0.0), constant=1000.0), rest=inf)
        trial.start(x * [0.5, 2.0, 1.0], shake=0.0)
        cell = 1 / 8
        diagonal = cell * (np.sqrt(4.25) - np.sqrt(2))
        expected = 500 * (8 * 8 * cell**2 + 2 * 8 * 8 * diagonal**2 + compression * 8 * 8 * (cell / 2) ** 2)
        assert trial.energy() == pytest.approx(expected, rel=1e-4)
        close()


def test_what_is_nowhere() -> None:
    trial = running()
    trial.simulation.cloth.x[40] = [np.nan, 0.0, 0.0]
    with pytest.raises(Broken, match="nowhere"):
        trial.watch.look()


def test_a_pin_that_moves() -> None:
    trial = running()
    trial.simulation.cloth.x[0] = [-0.5, 0.5, 1e-6]
    with pytest.raises(Broken, match="pin"):
        trial.watch.look()


def test_a_particle_that_is_away() -> None:
    trial = running()
    x, v = trial.simulation.positions(), trial.simulation.velocities()
    x[44] += [0.0, 0.0, 4.0]
    trial.act(lambda: trial.simulation.place(x, v))  # what it takes to go there was given
    with pytest.raises(Broken, match="away"):
        trial.watch.look()


def test_a_cloth_that_does_not_come_to_rest() -> None:
    trial = Trial(SETTING, 0)
    trial.open(sheet(8, pins=("top",), damping=0.0), rest=inf)
    trial.start(velocity=(0.0, 0.0, 2.0))
    with pytest.raises(Broken, match="speed 5 s after"):
        trial.settle()
    trial = Trial(SETTING, 0)
    trial.open(sheet(8), rest=1e-4)
    trial.start()
    with pytest.raises(Broken, match="strain 5 s after"):
        trial.settle()


def test_penetration_and_what_a_still_ball_may_give() -> None:
    """A ball around a part of the cloth works on it; what is in it is told."""
    trial = Trial(SETTING, 0)
    trial.open(sheet(8, spheres=(Sphere(center=(0.0, -0.2, 0.05), radius=0.3, margin=0.01),)), rest=inf)
    trial.start()
    trial.run(0.1)
    assert trial.worst.penetration > 0.2


def test_a_run_that_would_last_too_long_is_cut(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("taichi_cloth.stress.trial.MOST_STEPS", 81 * 10 * 7)
    with pytest.raises(OutOfTime):
        running()


def test_what_is_told_and_refused() -> None:
    trial = Trial(SETTING, 0)
    trial.tell("way", 1.0, 2.0)
    trial.tell("way", 0.5, 2.0)
    assert [(f.what, f.value, f.bound) for f in trial.figures] == [("way", 1.0, 2.0)]
    with pytest.raises(Broken, match="way"):
        trial.tell("way", 2.1, 2.0)
    with pytest.raises(Broken, match="way"):
        trial.tell("way", np.nan, 2.0)
    trial.refuses("seven", lambda: [].index("seven"))  # type: ignore[func-returns-value]
    with pytest.raises(Broken, match="is not refused"):
        trial.refuses("seven", lambda: 7)
    with pytest.raises(Broken, match="do not name it"):
        trial.refuses("eight", lambda: [].index("seven"))  # type: ignore[func-returns-value]
