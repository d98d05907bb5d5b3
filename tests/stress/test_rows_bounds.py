"""Each row's own bound breaks where it should: hand-made strains, speeds, gaps and rates."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest
from walks import CELLS, SETTING, STATIC, Walk, breaks, small, walk

from taichi_cloth.scene import SceneError
from taichi_cloth.scene.model import FRAME_SECONDS, Plane
from taichi_cloth.simulation import Simulation
from taichi_cloth.stress import (
    catalogue,
    changes,
    friction,
    gaps,
    layers,
    loads,
    overlaps,
    rates,
    shots,
    sizes,
    springs,
)
from taichi_cloth.stress.scenes import sheet
from taichi_cloth.stress.trial import Trial, close
from taichi_cloth.stress.watch import Broken
from taichi_cloth.view.session import Session

VARIANTS = {(case.number, one.name): one.run for case in catalogue.CASES for one in case.variants}


@pytest.fixture(autouse=True)
def few_cells(on_lists: None, monkeypatch: pytest.MonkeyPatch) -> None:
    small(monkeypatch)


def moved(simulation: Simulation, particle: int, y: float) -> None:
    """One particle is higher by y [m], or by one bit if y is 0.

    At a height of 0 one bit is less than what float32 keeps beside numbers of a metre: it would be lost.
    """
    x, v = simulation.positions(), simulation.velocities()
    x[particle, 1] = x[particle, 1] + y if y else np.nextafter(np.float32(x[particle, 1]), np.float32(9))
    simulation.place(x, v)


class Settling(Walk):
    """A walk in which something happens each time that the cloth comes to rest."""

    at_rest: Callable[[Walk], object]

    def settle(self, **how: object) -> None:
        super().settle(**how)
        self.at_rest()  # type: ignore[call-arg]


def settling(run: Callable[[Trial], object], at_rest: Callable[[Walk], object]) -> Walk:
    """The walk through a case whose cloth does this whenever it comes to rest."""
    trial = Settling()
    trial.at_rest = partial(at_rest, trial)  # type: ignore[assignment]
    try:
        run(trial)
    finally:
        close()
    return trial


# -- strains and speeds --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("run", "most", "what"),
    [
        (VARIANTS[1, "1e8 N/m"], 20.0, "speed [m/s]"),
        (VARIANTS[20, "1 m"], 2.0, "speed [m/s]"),
        (VARIANTS[21, "teleported"], 2.0, "speed [m/s]"),
        (VARIANTS[21, "0 to 0.5 m"], 2.0, "speed [m/s]"),
        (VARIANTS[28, "n·v = 0"], 1e-3, "speed edge-on [m/s]"),
        (VARIANTS[28, "crossing zero"], 1e-3, "speed edge-on [m/s]"),
    ],
)
def test_the_most_speed(run: object, most: float, what: str) -> None:
    """In one frame alone, near the end of those that are looked at."""
    frames = walk(run).frames  # type: ignore[arg-type]
    late = min(frames, 300) - 5 if what == "speed [m/s]" else frames - 5  # once a ball is gone nothing is watched
    assert walk(run, speeds=[*[0.0] * late, 0.999 * most, 0.0]).broken == []  # type: ignore[arg-type]
    assert walk(run, speeds=[*[0.0] * late, 1.001 * most, 0.0]).broken == [what]  # type: ignore[arg-type]


@pytest.mark.parametrize(("name", "cap"), [("1 %", 0.01), ("0.1 %", 0.001)])
@pytest.mark.parametrize("frame", [0, 150, 299])
def test_a_cap_is_held_in_every_frame(name: str, cap: float, frame: int) -> None:
    run = VARIANTS[38, name]
    assert walk(run, strains=[*[0.0] * frame, cap, 0.0]).broken == []
    assert walk(run, strains=[*[0.0] * frame, cap + 3e-5, 0.0], speeds=[0.0] * (frame + 2)).broken == [
        "strain above the cap"
    ]
    assert loads.CAP_ROUNDING < 2e-5


def test_what_was_pulled_apart_is_within_a_thousandth_of_its_static_strain() -> None:
    for times in ("×2", "×5", "×10"):
        for strain, broken in ((STATIC, []), (STATIC + 9e-4, []), (STATIC + 1.1e-3, [1]), (STATIC - 1.1e-3, [1])):
            assert len(walk(VARIANTS[7, times], strains=[strain]).broken) == len(broken)


@pytest.mark.parametrize(("number", "name", "bound"), [(11, "uniform", 0.05), (29, "10 m", 0.05)])
def test_strains_that_the_list_has(number: int, name: str, bound: float) -> None:
    assert walk(VARIANTS[number, name]).rest == [bound]


def test_a_pin_in_a_ball_stretches_its_threads_by_geometry() -> None:
    """Two neighbours on the ball, as near to the pin as they can be."""
    cell, radius = 1 / 32, 0.15
    strain = overlaps.beside_pin(radius, 0.05, cell)
    pin = np.array([0.0, radius - 0.05])
    aside = cell / np.sqrt(2)
    place = np.array([aside, np.sqrt(radius**2 - aside**2)])
    assert strain == pytest.approx(np.linalg.norm(place - pin) / cell - 1)
    assert 0.6 < strain < 0.8
    [rest] = walk(VARIANTS[22, "5 cm"]).rest
    assert rest == pytest.approx(STATIC + 0.01 + overlaps.beside_pin(radius, 0.05, 1 / CELLS))


@pytest.mark.parametrize(("particle", "broken"), [(0, []), (1, []), (80, ["strain off the ball"])])
def test_only_what_lies_on_the_ball_may_be_stretched_by_it(particle: int, broken: list[str]) -> None:
    """The pin of the ball is 0, at the upper left; 80 is the corner across."""
    assert walk(overlaps.ball_on_pin).broken == []
    assert settling(overlaps.ball_on_pin, lambda one: moved(one.simulation, particle, 0.05)).broken == broken


def test_upwards_a_sheet_is_held_against_its_mirror(monkeypatch: pytest.MonkeyPatch) -> None:
    """The static strain is found from a sheet that hangs."""
    seen: list[float] = []
    monkeypatch.setattr(
        "taichi_cloth.stress.trial.static_strain", lambda scene: seen.append(scene.forces.gravity) or STATIC
    )
    assert [one.forces.gravity for one in walk(VARIANTS[26, "upwards"]).scenes] == [-9.81]
    assert seen == [9.81]


@pytest.mark.parametrize("pin", [0, 30, 80])
def test_a_pin_that_goes_by_one_bit_is_seen(pin: int) -> None:
    assert walk(loads.all_pins).broken == []
    found = settling(loads.all_pins, lambda one: moved(one.simulation, pin, 0.0))
    assert found.broken == ["way of a pin [m]"]


# -- balls ---------------------------------------------------------------------------------------------


def test_what_goes_through_a_ball() -> None:
    radius = 0.1
    for beside, through in ((0.0, 1), (0.06, 1), (0.099, 1), (0.101, 0)):
        before, after = np.array([[beside, 0.0, 1.0]]), np.array([[beside, 0.0, -3.0]])
        assert shots.went_through(before, after, radius) == through
        assert shots.went_through(after, before, radius) == through
        assert shots.went_through(before, 0.9 * before, radius) == 0
    slanting = np.array([[0.5, 0.0, 1.0]]), np.array([[-0.5, 0.0, -1.0]])
    assert shots.went_through(*slanting, radius) == 1
    assert shots.went_through(slanting[0] + [0.11, 0, 0], slanting[1] + [0.11, 0, 0], radius) == 0


@pytest.mark.parametrize("against", ["particles", "triangles"])
def test_a_sheet_that_is_far_off_is_told_not_to_be_behind_the_small_ball(against: str) -> None:
    class Leaving(Walk):
        def one_frame(self, **how: object) -> None:
            super().one_frame(**how)
            if self.frames == 1:
                self.simulation.place(self.simulation.positions() + [3.0, 0.0, 3.0], np.zeros(3))

    trial = Leaving()
    try:
        VARIANTS[18, f"against {against}"](trial)
        [figure] = trial.figures
        assert (figure.what, figure.value) == ("whether the ball went through", 0.0)
    finally:
        close()


@pytest.mark.parametrize("name", ["5 m/s", "20 m/s", "50 m/s", "100 m/s"])
def test_the_fast_ball_is_looked_at_in_every_frame(name: str) -> None:
    """Nothing moves in a walk but the ball, which so goes through the sheet.

    It is looked at a little before the end of each frame, when its middle is never exactly in the sheet's plane.
    """

    class Looking(Walk):
        def one_frame(self, **how: object) -> None:
            how["look"](0.97)  # type: ignore[operator]
            super().one_frame(**how)

    trial = Looking()
    try:
        VARIANTS[17, name](trial)
        assert set(trial.broken) == {"particles that went through the ball"}
        [bound] = [figure.bound for figure in trial.figures if figure.what in trial.broken]
        assert bound == 0
    finally:
        close()


def hung(velocity: tuple[float, float, float], radius: float = 0.1) -> Trial:
    """A free sheet that goes this way towards a ball in front of it that lets all through."""
    trial = Trial(SETTING, 0)
    ball = replace(shots.shot(1e-9, radius), center=(0.0, 0.0, 0.5), path=(), margin=0.0, swept=False)
    trial.open(sheet(CELLS, pins=(), spheres=(ball,), damping=0.0))
    trial.start(velocity=velocity)
    return trial


def test_a_ball_that_lets_through_is_seen() -> None:
    try:
        with pytest.raises(Broken, match="particles that went through the ball"):
            shots.run_past(hung((0.0, 0.0, 500.0)), 0.1)
    finally:
        close()


def test_nothing_may_be_faster_than_it_was_thrown() -> None:
    try:
        shots.run_past(hung((0.0, 0.0, -3.0)), FRAME_SECONDS, 4.0)
        with pytest.raises(Broken, match="speed"):
            shots.run_past(hung((0.0, 0.0, -3.0)), FRAME_SECONDS, 2.9)
    finally:
        close()
    [bound] = [figure.bound for figure in walk(shots.fast_cloth).figures if figure.what == "speed [m/s]"]
    assert bound == pytest.approx(100.0, abs=0.05)


# -- layers --------------------------------------------------------------------------------------------


def stacked(heights: list[float], cells: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """Level sheets of 1 m at these heights, and the triangles of one."""
    across = np.linspace(-0.5, 0.5, cells + 1)
    x, z = np.meshgrid(across, across)
    layers_ = [np.stack([x, np.full_like(x, y), z], axis=-1).reshape(-1, 3) for y in heights]
    n = cells + 1
    triangles = []
    for row, column in product(range(cells), range(cells)):
        a = row * n + column
        triangles += [(a, a + 1, a + n), (a + 1, a + n + 1, a + n)]
    return np.concatenate(layers_), np.array(triangles, np.int32)


def test_the_gap_between_sheets() -> None:
    x, triangles = stacked([0.0, 0.1, 0.17])
    assert gaps.least_gap(x, triangles, 3, 1.0) == pytest.approx(0.07)
    assert gaps.least_gap(x, triangles, 3, 0.05) == 0.05  # no farther than one asks
    x[5, 1] += 0.08  # one particle of the lowest
    assert gaps.least_gap(x, triangles, 3, 1.0) == pytest.approx(0.02)
    x[5, 1] += 0.02
    assert gaps.least_gap(x, triangles, 3, 1.0) == pytest.approx(0.0, abs=1e-12)


def test_a_particle_over_the_middle_of_a_triangle_is_near() -> None:
    """Particles alone would be farther from each other."""
    x, triangles = stacked([0.0, 0.01])
    x[16:, [0, 2]] += 1 / 9
    assert gaps.least_gap(x, triangles, 2, 1.0) == pytest.approx(0.01)


def test_distances_from_triangles() -> None:
    random = np.random.default_rng(0)
    p, a, b, c = random.uniform(-1, 1, (4, 50, 3))
    shares = random.dirichlet([0.3, 0.3, 0.3], 20_000)
    sampled = np.array(
        [np.linalg.norm(p[k] - shares @ np.stack([a[k], b[k], c[k]]), axis=1).min() for k in range(len(p))]
    )
    found = gaps.to_triangles(p, a, b, c)
    assert (found <= sampled + 1e-12).all()
    assert found == pytest.approx(sampled, abs=0.02)


def test_sheets_that_changed_places_are_out_of_order() -> None:
    assert gaps.is_stacked(stacked([0.0, 0.1, 0.2])[0], 3)
    assert not gaps.is_stacked(stacked([0.0, 0.2, 0.1])[0], 3)


class Still:
    """What a stack sees of a trial whose cloth does not move."""

    def __init__(self, heights: list[float], crossings: int = 0) -> None:
        x, triangles = stacked(heights)
        topology = SimpleNamespace(triangles=np.tile(triangles, (len(heights), 1)))
        self.simulation = SimpleNamespace(topology=topology, positions=lambda: x, crossings=lambda: crossings)
        self.broken: list[str] = []

    def tell(self, what: str, value: float, bound: float) -> None:
        self.broken += [what] * (value > bound)


@pytest.mark.parametrize(
    ("heights", "crossings", "broken"),
    [
        ([0.0, 0.01, 0.02], 0, []),
        ([0.0, 0.01, 0.0151], 0, []),
        ([0.0, 0.01, 0.0149], 0, ["gap missing, of half a thickness"]),
        ([0.0, 0.02, 0.01], 0, ["stacks out of order"]),
        ([0.0, 0.01, 0.02], 1, ["crossings at the end"]),
    ],
)
def test_half_a_thickness_is_left(heights: list[float], crossings: int, broken: list[str]) -> None:
    still = Still(heights, crossings)
    layers.Stack(still, 3, 0.01).end()  # type: ignore[arg-type]
    assert still.broken == broken


def test_a_twisted_sheet_hangs_as_it_did(monkeypatch: pytest.MonkeyPatch) -> None:
    one = walk(layers.twist)
    assert one.broken == []
    bounds = {figure.what: figure.bound for figure in one.figures}
    assert bounds == {
        "crossings in the worst frame": None,
        "crossings at the end": 0,
        "distance from the shape before [m]": 0.01,
    }
    monkeypatch.setattr(layers, "SHAPE", -1.0)
    assert walk(layers.twist).broken == ["distance from the shape before [m]"]


def twisted_back(y: float, crossings: int) -> Walk:
    """A sheet that was twisted: once it is back, one particle is higher by y [m] and so many threads cross."""

    def at_rest(one: Walk) -> None:
        if one.settled == 2:
            moved(one.simulation, CELLS * (CELLS + 1) // 2, y)
            one.simulation.crossings = lambda: crossings  # type: ignore[method-assign]

    return settling(layers.twist, at_rest)


@pytest.mark.parametrize(
    ("y", "crossings", "broken"),
    [
        (0.0099, 0, []),
        (0.0101, 0, ["distance from the shape before [m]"]),
        (0.0, 1, ["crossings at the end"]),
    ],
)
def test_a_sheet_twisted_back_crosses_nothing(y: float, crossings: int, broken: list[str]) -> None:
    assert twisted_back(y, crossings).broken == broken


def test_crossings_while_it_is_twisted_are_told_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Simulation, "crossings", lambda simulation: int(0 < simulation.frame < 1000))
    one = walk(layers.twist)
    assert one.broken == []
    assert {figure.what: figure.value for figure in one.figures}["crossings in the worst frame"] == 1


@pytest.mark.parametrize("what", ["crossings at the end", "stacks out of order"])
def test_a_pile_is_judged_at_its_end(what: str) -> None:
    """Ten sheets that stay where they are; once the pile is at rest two threads cross, or it is upside down."""

    def at_rest(one: Walk) -> None:
        if what == "crossings at the end":
            one.simulation.crossings = lambda: 1  # type: ignore[method-assign]
        else:
            one.simulation.place(one.simulation.positions() * [1.0, -1.0, 1.0])

    assert what not in walk(layers.layers).broken
    found = settling(layers.layers, at_rest)
    assert what in found.broken
    assert [figure.bound for figure in found.figures if figure.what == what] == [0]


# -- friction ------------------------------------------------------------------------------------------


def test_creep_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(friction, "REST_SECONDS", 0.5)
    monkeypatch.setattr(friction, "Plane", lambda **keys: Plane(**(keys | {"friction": 0.0})))
    breaks(partial(friction.slope, how=(1.0, 30.0)), "creep")


def test_a_sheet_that_friction_holds_is_watched_for_a_minute() -> None:
    for mu, slope in ((1, 30), (10, 30), (1e6, 30), (1e6, 89)):
        one = walk(VARIANTS[35, f"μ = {mu:g}, {slope}°"])
        assert one.frames == 3600
        assert [figure.bound for figure in one.figures] == [1e-3]
    assert "creep [m]" not in [figure.what for figure in walk(VARIANTS[35, "μ = 10, 89°"]).figures]


def test_a_sheet_that_slides_may_be_as_much_faster_than_a_block_as_any_cloth_at_rest() -> None:
    for mu, slope in ((0, 30), (0, 89), (1, 89), (10, 89)):
        angle = np.radians(slope)
        block = 9.81 * (np.sin(angle) - mu * np.cos(angle)) / 2.0  # [m/s] damped at 2/s
        assert walk(VARIANTS[35, f"μ = {mu:g}, {slope}°"]).rest_speeds == [pytest.approx(block + 0.1)]


@pytest.mark.parametrize(("speed", "broken"), [(4.9 / 2, False), (4.9 / 2 - 0.11, True), (0.0, True)])
def test_a_sheet_without_friction_slides(speed: float, broken: bool) -> None:
    class Sliding(Walk):
        def settle(self, **how: object) -> None:
            super().settle(**how)
            down = np.array([np.cos(np.pi / 6), -0.5, 0.0])
            x = self.simulation.positions()
            self.simulation.place(x, speed * down + np.zeros_like(x))

    trial = Sliding()
    try:
        VARIANTS[35, "μ = 0, 30°"](trial)
        assert trial.broken == (["slower than a sliding block by [m/s]"] if broken else [])
    finally:
        close()


@pytest.mark.parametrize("slope", [30.0, 89.0])
def test_a_sheet_on_a_slope_starts_along_it(slope: float, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[np.ndarray] = []
    plain = Walk.settle

    def settle(one: Walk, **how: float) -> None:
        seen.append(one.simulation.velocities())
        plain(one, **how)

    monkeypatch.setattr(Walk, "settle", settle)
    walk(partial(friction.slope, how=(1e6, slope)))
    up = np.array([np.sin(np.radians(slope)), np.cos(np.radians(slope)), 0.0])
    assert np.abs(seen[0] @ up).max() < 1e-6
    assert 0.01 < np.abs(seen[0]).max() < 0.04


def test_how_fast_a_cloth_turns() -> None:
    x = np.random.default_rng(1).normal(size=(20, 3))
    v = np.cross([0.0, 3.0, 0.0], x)
    assert friction.turns_of(x, v, np.linspace(1, 2, 20)) == pytest.approx(3.0)
    assert friction.turns_of(x, 0 * v, np.ones(20)) == 0.0


@pytest.mark.parametrize(("share", "broken"), [(1.0, False), (1.01, True)])
def test_a_sheet_may_not_turn_faster_than_its_ball(share: float, broken: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(friction, "turns_of", lambda *_: share * np.radians(180.0))
    assert bool(walk(friction.rotating_ball).broken) == broken


@pytest.mark.parametrize(("times", "broken"), [(0.99, False), (1.05, True)])
def test_friction_on_a_loose_sheet_is_measured(times: float, broken: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """A sheet that gains μ·g each second, or a little more, along the way of the other."""

    def start(trial: Trial) -> None:
        one = type(trial.simulation).velocities
        pull = times * 0.3 * 9.81

        def velocities() -> np.ndarray:
            v = one(trial.simulation)
            v[:, 0] = pull * trial.simulation.frame * FRAME_SECONDS
            return v

        monkeypatch.setattr(trial.simulation, "velocities", velocities)

    def run(trial: Trial) -> None:
        plain = trial.start

        def started() -> None:
            plain()
            start(trial)

        trial.start = started  # type: ignore[method-assign, assignment]
        friction.tablecloth(trial)

    one = walk(run)
    assert bool(one.broken) == broken
    [figure] = one.figures
    assert figure.value == pytest.approx(times, rel=1e-3)


# -- time, places and sizes ----------------------------------------------------------------------------


def test_a_clock_that_runs_fast_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    assert walk(VARIANTS[4, "240 Hz"]).broken == []
    plain = rates.FrameClock.due
    monkeypatch.setattr(rates.FrameClock, "due", lambda self, now: 2 * plain(self, now))
    assert "simulated time beside the wall's [s]" in walk(VARIANTS[4, "240 Hz"]).broken


def test_sags_of_two_rates_are_compared(monkeypatch: pytest.MonkeyPatch) -> None:
    """The second of the sheets hangs 3 % lower."""
    run, opened = VARIANTS[4, "30 Hz"], []
    plain = rates.sheet

    def longer(cells: int) -> object:
        opened.append(cells)
        return plain(cells, size=(1.0, 1.0 if len(opened) == 1 else 1.06))

    monkeypatch.setattr(rates, "sheet", longer)
    assert walk(run).broken == ["sag beside that at 60 a second, share"]


def run_paused() -> Trial:
    """With enough substeps to keep its energy, and without the rest at the end."""
    trial = Trial(replace(SETTING, solver=replace(SETTING.solver, substeps=20, iterations=4)), 0)
    trial.settle = lambda: None  # type: ignore[method-assign, misc, assignment]
    try:
        rates.paused(trial)
    finally:
        close()
    return trial


def test_a_session_that_moves_while_paused_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    plain = Session.advance
    monkeypatch.setattr(Session, "advance", lambda self, frames: plain(self, max(frames, 1)))
    with pytest.raises(Broken, match="while paused"):
        run_paused()


def test_a_bit_that_changes_while_paused_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    plain = Session.measure

    def measure(session: Session) -> object:
        x, v = session.simulation.positions(), session.simulation.velocities()
        x[-1, 1] = np.nextafter(np.float32(x[-1, 1]), np.float32(1))
        session.simulation.place(x, v)
        return plain(session)

    monkeypatch.setattr(Session, "measure", measure)
    with pytest.raises(Broken, match="numbers that changed while paused"):
        run_paused()


def test_frames_that_pass_while_paused_are_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """They are counted, whether or not the cloth moves in them."""
    plain = Session.advance

    def advance(session: Session, frames: int) -> None:
        plain(session, frames)
        session.simulation.frame += frames == 0

    monkeypatch.setattr(Session, "advance", advance)
    with pytest.raises(Broken, match="frames that passed while paused") as found:
        run_paused()
    assert (found.value.value, found.value.bound) == (rates.PAUSED_PICTURES, 0)


def test_a_bit_that_a_pause_changed_later_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """In the last of the sixty frames that follow."""
    plain, followed = Session.advance, []

    def advance(session: Session, frames: int) -> None:
        plain(session, frames)
        followed.extend([True] * frames)
        if len(followed) == 60:
            moved(session.simulation, session.simulation.topology.particle_count - 1, 0.0)

    monkeypatch.setattr(Session, "advance", advance)
    with pytest.raises(Broken, match="numbers that a pause changed later"):
        run_paused()


def test_a_pause_changes_nothing() -> None:
    trial = run_paused()
    assert [figure.value for figure in trial.figures] == [0, 0, 0]


def test_drift_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    assert walk(partial(rates.hanging, frames=10)).broken == []
    monkeypatch.setattr(rates, "DRIFT", -1.0)
    assert walk(partial(rates.hanging, frames=10)).broken == ["drift [m]"]
    assert [figure.bound for figure in walk(VARIANTS[32, "hanging"]).figures] == [-1.0]


@pytest.mark.parametrize(("way", "broken"), [(0.9e-4, []), (1.1e-4, ["drift [m]"])])
def test_a_hanging_sheet_may_drift_by_a_ten_thousandth_of_its_side(way: float, broken: list[str]) -> None:
    class Drifting(Walk):
        def one_frame(self, **how: object) -> None:
            super().one_frame(**how)
            if self.frames == 15 * 60 + 5:  # the fifth of those that are judged
                moved(self.simulation, CELLS, way)

    trial = Drifting()
    try:
        rates.hanging(trial, 10)
        assert trial.broken == broken
    finally:
        close()


class Falling(Walk):
    """Falls by so much of ½gt² in the first run of a sheet that is not pinned."""

    share = 1.0

    def run(self, seconds: float, **how: bool) -> None:
        first = not self.simulation.topology.pinned.any() and self.fallen != len(self.scenes)
        super().run(seconds, **how)
        if first:
            self.fallen = len(self.scenes)
            x, v = self.simulation.positions(), self.simulation.velocities()
            x[:, 1] += v[:, 1].mean() * seconds - self.share * 9.81 * seconds**2 / 2
            self.simulation.place(x, v)

    fallen = 0  # with so many scenes


@pytest.mark.parametrize(
    ("number", "name", "seconds", "what"),
    [(33, "100 m", 0.4, "fall beside ½gt², share"), (37, "dashpots 1 s", 1.0, "fall in 1 s beside ½gt², share")],
)
@pytest.mark.parametrize("times", [-1.05, -0.95, 0.95, 1.05])
def test_a_fall_is_exact_to_a_hundredth_and_a_substep(
    number: int, name: str, seconds: float, what: str, times: float
) -> None:
    substep = 1 / 60 / SETTING.solver.substeps
    trial = Falling()
    trial.share = 1 + times * (0.01 + substep / seconds)
    try:
        VARIANTS[number, name](trial)
        assert trial.broken == ([what] if abs(times) > 1 else [])
    finally:
        close()


@pytest.mark.parametrize(("share", "broken"), [(0.009, False), (-0.009, False), (0.011, True), (-0.011, True)])
def test_a_sheet_far_away_sags_alike_to_a_hundredth(share: float, broken: bool) -> None:
    """The second of the sheets hangs lower; in a walk each is a metre high."""

    def at_rest(one: Walk) -> None:
        if one.settled == 2:
            x = one.simulation.positions()
            x[:, 1] -= share * (x[:, 1].max() - x[:, 1])
            one.simulation.place(x)

    found = settling(VARIANTS[33, "100 m"], at_rest)
    assert ("sag beside that near the origin, share" in found.broken) == broken


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf])
def test_a_place_of_a_large_sheet_that_is_not_finite_is_seen(wrong: float, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sizes, "sheet", lambda cells, **keys: sheet(CELLS, pins=keys["pins"]))
    assert walk(sizes.large).broken == []
    plain = Simulation.positions

    def positions(simulation: Simulation) -> np.ndarray:
        x = plain(simulation)
        x[-1, 2] = wrong if simulation.frame else x[-1, 2]
        return x

    monkeypatch.setattr(Simulation, "positions", positions)
    assert walk(sizes.large).broken == ["places that are not finite"]


# -- changes in mid run, and the same again --------------------------------------------------------------


@pytest.mark.parametrize("refusal", [1, 9, 17])
def test_a_bit_that_a_refused_input_changes_is_seen(refusal: int) -> None:
    class Careless(Walk):
        refused = 0

        def refuses(self, what: str, attempt: Callable[[], object]) -> None:
            super().refuses(what, attempt)
            self.refused += 1
            if self.refused == refusal:
                moved(self.simulation, 30, 0.0)

    trial = Careless()
    try:
        VARIANTS[30, "nan"](trial)
        assert trial.refused == 17
        assert trial.broken == ["numbers that a refused input changed"]
    finally:
        close()


def changed_by(change: Callable[[Simulation], object]) -> list[str]:
    """What breaks where this is all that a change in mid run does to the cloth."""
    trial = Walk()
    try:
        trial.open(sheet(CELLS, pins=("top",)))
        trial.start()
        changes.without_a_jump(trial, partial(change, trial.simulation))
        return trial.broken
    finally:
        close()


def test_a_place_may_not_jump_by_a_bit() -> None:
    assert changed_by(lambda simulation: None) == []
    assert changed_by(lambda simulation: moved(simulation, 30, 0.0)) == ["jump of a place [m]"]


@pytest.mark.parametrize(("times", "broken"), [(0.95, []), (1.05, ["jump of a velocity [m/s]"])])
def test_a_velocity_may_jump_by_what_float32_rounds(times: float, broken: list[str]) -> None:
    """By a millimetre a second, and two roundings of a place of a metre over a substep."""
    bound = 1e-3 + 2 * 2.0**-23 * 60 * SETTING.solver.substeps

    def faster(simulation: Simulation) -> None:
        v = simulation.velocities()
        v[40, 2] += times * bound
        simulation.place(simulation.positions(), v)

    assert changed_by(faster) == broken


@pytest.mark.parametrize("name", ["one point", "1 µm", "1 mm"])
def test_a_collapsed_sheet_that_ends_otherwise_the_second_time_is_seen(name: str) -> None:
    run = VARIANTS[9, name]
    assert walk(run).broken == []

    def at_rest(one: Walk) -> None:
        if one.settled == 2:
            moved(one.simulation, 30, 0.0)

    assert settling(run, at_rest).broken == ["numbers that are others the second time"]


def test_a_sheet_that_does_not_fall_is_seen() -> None:
    """Nothing moves in a walk: it falls by none of ½gt²."""
    assert walk(VARIANTS[33, "100 m"]).broken == ["fall beside ½gt², share"]
    assert walk(VARIANTS[37, "dashpots 1 s"]).broken == ["fall in 1 s beside ½gt², share"]


@pytest.mark.parametrize(
    "text", ["mesh.obj: line 3: no", "it takes 4000 substeps", "xpbd needs a grid", "spring needs a grid", "no"]
)
def test_a_refusal_has_a_name_in_it(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object, **__: object) -> None:
        raise SceneError("scene", "cloth.file", text)

    monkeypatch.setattr(Trial, "open", refused)
    trial = Trial(SETTING, 0)
    if text in ("no", "spring needs a grid"):  # SETTING is of `xpbd`
        with pytest.raises(Broken, match="name nothing"):
            sizes.open_or_refused(trial, sheet(2), "mesh.obj", None)
    else:
        sizes.open_or_refused(trial, sheet(2), "mesh.obj", None)


def test_stretch_by_a_heavy_corner_is_told() -> None:
    assert [(f.what, f.value) for f in walk(partial(springs.mass_ratio, times=10.0), strains=[0.3]).figures] == [
        ("strain", 0.3)
    ]
