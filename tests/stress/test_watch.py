"""The watch finds each kind of failure when it is fed one, and none where all is well."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from taichi_cloth.scene.model import Forces, Keyframes, Solver, Sphere, Wind
from taichi_cloth.stress.scenes import sheet
from taichi_cloth.stress.setting import Setting
from taichi_cloth.stress.trial import Trial, close
from taichi_cloth.stress.watch import Broken, Watch, Worst

SETTING = Setting("xpbd", Solver("xpbd", 20, 4, damping=0.0))
PUSHED: Keyframes = ((0.0, 0, 0, 0), (1.0, 0, 0, 0.3))


@pytest.fixture(autouse=True)
def given_back() -> Iterator[None]:
    yield
    close()


def running(**sections: object) -> Trial:
    """A sheet that hangs, ten frames after its start."""
    trial = Trial(SETTING, 0)
    trial.open(sheet(8, **sections), rest_strain=0.1)
    trial.start()
    trial.run(1 / 6)
    return trial


def without_telling(trial: Trial, change: Callable[[np.ndarray, np.ndarray], None]) -> None:
    """Changes places [m] or velocities [m/s] behind the watch's back."""
    x, v = trial.simulation.positions(), trial.simulation.velocities()
    change(x, v)
    trial.simulation.place(x, v)


def faster(x: np.ndarray, v: np.ndarray) -> None:
    v += [0.0, 0.0, 1.0]  # ½·0.2 kg·(1 m/s)² = 0.1 J, of 3.9 at hand


def test_a_cloth_that_hangs_is_alive() -> None:
    trial = running()
    trial.settle()
    assert trial.frame == 310
    assert trial.worst.energy <= 0.001
    assert 0 < trial.worst.speed < 5
    assert 0 < trial.worst.strain < 0.1


def test_energy_out_of_nothing() -> None:
    trial = running()
    without_telling(trial, faster)
    with pytest.raises(Broken, match="energy") as found:
        trial.one_frame()
    assert found.value.bound == pytest.approx(0.01 * 2 * 0.2 * 9.81, rel=0.02)
    assert 0.04 < found.value.value < 0.1


def test_energy_out_of_nothing_is_seen_ten_kilometres_away() -> None:
    """Kernels keep places from a point near the sheet, so they are rounded as they are anywhere."""
    trial = running(center=(1e4, 1e4, 0.0))
    without_telling(trial, faster)
    with pytest.raises(Broken, match="energy") as found:
        trial.one_frame()
    assert 0.04 < found.value.value < 0.1


def far_ball() -> Sphere:
    return Sphere(center=(0.0, 0.0, -3.0), radius=0.3, margin=0.01, path=PUSHED)


def slow_ball() -> Sphere:
    """Touches the sheet, and goes on by a millimetre a second."""
    slow: Keyframes = ((0.0, 0, 0, 0), (10.0, 0, 0, 0.01))
    return Sphere(center=(0.0, 0.0, -0.31), radius=0.3, margin=0.01, path=slow)


def ball_around_a_part() -> Sphere:
    return Sphere(center=(0.0, -0.2, 0.2), radius=0.25, margin=0.01)


@pytest.mark.parametrize(
    "sections",
    [
        {"wind": Wind(z=1.0, turbulence=0.0)},
        {"spheres": (far_ball(),)},
        {"spheres": (slow_ball(),)},
        {"spheres": (ball_around_a_part(),)},
    ],
    ids=["wind", "a ball far away", "a ball that touches", "a ball around a part"],
)
def test_what_may_do_work_excuses_no_more_than_it_can_do(sections: dict[str, object]) -> None:
    trial = running(**sections)
    without_telling(trial, lambda x, v: faster(x, v) or faster(x, v) or faster(x, v))
    with pytest.raises(Broken, match="energy"):
        trial.one_frame()


def test_a_hand_that_holds_still_does_no_work() -> None:
    trial = running()
    corner = trial.simulation.topology.particle_count - 1
    trial.act(partial(trial.simulation.grab, corner, trial.simulation.positions()[corner]))
    trial.one_frame(driven=True)
    v = trial.simulation.velocities() + [0.0, 0.0, 2.0]
    trial.simulation.solver.set_velocities(v, trial.simulation._substep)
    with pytest.raises(Broken, match="energy"):
        trial.one_frame(driven=True)


def test_work_of_a_hand_is_force_times_way() -> None:
    """One spring's end that is pulled 1 cm: ½·k·d² and no more than k·d²."""
    trial = Trial(SETTING, 0)
    x = trial.open(sheet((1, 1), pins=("left",), forces=Forces(gravity=0.0), constant=100.0), rest_strain=0.1)
    trial.start(shake=0.0)
    corner = int(np.flatnonzero(~trial.simulation.topology.pinned)[0])
    trial.act(partial(trial.simulation.grab, corner, x[corner]))
    trial.one_frame(driven=True)
    trial.simulation.grab(corner, x[corner] + [0.01, 0.0, 0.0])
    seen: list[float] = []
    trial.one_frame(driven=True, look=lambda share: seen.append(trial.watch._hand_work))
    stored = 0.5 * 100.0 * 0.01**2  # of the spring along the way; others take a part
    assert seen == sorted(seen)
    assert stored < seen[-1] < 6 * stored


def test_a_hand_and_a_ball_that_work_are_no_failure() -> None:
    trial = running()
    middle = trial.simulation.topology.particle_count // 2
    for way in (0.0, 0.2, 0.4, 0.2):
        target = trial.simulation.topology.start[middle] + [0.0, 0.0, way]
        trial.act(partial(trial.simulation.grab, middle, target))
        trial.one_frame(driven=True)
    trial.act(trial.simulation.release)
    trial.settle()
    fast: Keyframes = ((0.2, 0, 0, 0), (0.3, 0, 0, 1.0), (0.4, 0, 0, 0))
    ball = Sphere(center=(0.0, 0.0, -0.7), radius=0.2, margin=0.01, path=fast, swept=True)
    trial = running(spheres=(ball,), damping=0.0)
    trial.run(0.5)
    assert trial.worst.speed > 5
    trial.only_frames("it swings")


def test_energy_that_was_given_is_none_out_of_nothing() -> None:
    trial = running()
    x, v = trial.simulation.positions(), trial.simulation.velocities()
    before = trial.energy()
    trial.act(lambda: trial.simulation.place(x, v + [0.0, 0.0, 1.0]))
    assert trial.energy() - before == pytest.approx(0.1, rel=0.1)
    trial.run(0.1)


def test_energy_that_was_taken_is_not_there_to_be_had_again() -> None:
    """Springs become a thousandth as stiff while they are stretched; then they may not give what they had."""
    trial = Trial(SETTING, 0)
    x = trial.open(sheet(8, forces=Forces(gravity=0.0)), rest_strain=0.1)
    trial.start(x * [1.2, 1.0, 1.0], shake=0.0)
    allowed = trial.watch._allowed
    trial.act(lambda: trial.simulation.set("stiffness", 0.1))
    assert trial.watch._allowed == pytest.approx(0.1 * allowed, rel=0.05)


def test_energy_of_a_stretched_spring_is_that_of_its_fabric() -> None:
    """Stretched to twice its width a sheet of 8 × 8 cells has 8·8 springs along its rows of 1000 N/m and more. The same
    for a method without constants: it is the same cloth.
    """
    for name in ("spring", "verlet"):
        trial = Trial(Setting(name, Solver(name, 400, 1)), 0)
        x = trial.open(sheet(8, forces=Forces(gravity=0.0), constant=1000.0), rest_strain=0.1)
        trial.start(x * [2.0, 1.0, 1.0], shake=0.0)
        along, cell = 8 * 8, 1 / 8
        diagonal = cell * (np.sqrt(5) - np.sqrt(2))
        expected = 500 * (along * cell**2 + 2 * 8 * 8 * diagonal**2)
        assert trial.energy() == pytest.approx(expected, rel=2e-3)
        trial.only_frames("not run")
        close()


def test_an_implicit_method_frees_less_of_what_is_far_too_stiff() -> None:
    """Never less than V / (1 + h²ω²) of the slowest mode along the sheet, and never more than the spring has."""
    trial = Trial(SETTING, 0)
    trial.open(sheet(8, constant=1e9), rest_strain=0.1)
    trial.start()
    h, mass = 1 / 60 / 20, trial.simulation.topology.mass.max()
    kept = trial.watch._constants() / 1e9
    slowest = (np.pi / 16) ** 2 * 1e9 / mass  # ω² of 8 springs in a row, held at one end
    assert kept[np.isfinite(kept)].max() <= 1
    inside = np.isclose(trial.simulation.topology.mass[trial.simulation.topology.ends], mass).all(axis=1)
    assert kept[inside] == pytest.approx(1 / (1 + h**2 * slowest), rel=1e-6)


def test_slack_threads_have_no_energy_where_they_are_short() -> None:
    """Along its rows half as wide, along its columns twice as high: only springs down the columns are stretched."""
    for compression in (0.0, 0.25, 1.0):
        trial = Trial(replace(SETTING, compression=compression, solver=Solver("spring", 1)), 0)
        x = trial.open(sheet(8, forces=Forces(gravity=0.0), constant=1000.0), rest_strain=0.1)
        trial.start(x * [0.5, 2.0, 1.0], shake=0.0)
        cell = 1 / 8
        diagonal = cell * (np.sqrt(4.25) - np.sqrt(2))
        expected = 500 * (8 * 8 * cell**2 + 2 * 8 * 8 * diagonal**2 + compression * 8 * 8 * (cell / 2) ** 2)
        assert trial.energy() == pytest.approx(expected, rel=1e-4)
        close()


def test_numbers_that_are_not_finite() -> None:
    trial = running()
    trial.simulation.cloth.x[40] = [np.nan, 0.0, 0.0]
    with pytest.raises(Broken, match="positions are not finite"):
        trial.watch.look()


def test_velocities_that_are_not_finite(monkeypatch: pytest.MonkeyPatch) -> None:
    trial = running()
    v = trial.simulation.velocities()
    v[40, 2] = np.inf
    monkeypatch.setattr(trial.simulation, "velocities", lambda: v)
    with pytest.raises(Broken, match="velocities are not finite"):
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


def test_no_reach_is_infinite() -> None:
    trial = running()
    with pytest.raises(ValueError, match="finite"):
        Watch(trial.simulation, Worst(), float("inf"))


def test_penetration_and_what_a_still_ball_may_give() -> None:
    """A ball around a part of the cloth works on it; what is in it is told."""
    trial = Trial(SETTING, 0)
    trial.open(sheet(8, spheres=(Sphere(center=(0.0, -0.2, 0.05), radius=0.3, margin=0.01),)), rest_strain=0.1)
    trial.start()
    trial.run(0.1)
    assert trial.worst.penetration > 0.2


def test_a_ball_that_appears_gives_no_more_than_its_ejection() -> None:
    """At once in the middle of the sheet: as for a ball that was there, not as for one that swept through it."""
    leap: Keyframes = ((0.1, 0, 0, 0), (0.100001, 0, 0, 5.0))
    ball = Sphere(center=(0.0, -0.2, -4.9), radius=0.3, margin=0.01, path=leap)
    trial = Trial(SETTING, 0)
    trial.open(sheet(8, spheres=(ball,)), rest_strain=0.1)
    trial.start()
    trial.run(6 / 60)
    without_telling(trial, lambda x, v: v.__iadd__([0.0, 0.0, 5.0]))
    with pytest.raises(Broken, match="energy"):
        trial.one_frame()
