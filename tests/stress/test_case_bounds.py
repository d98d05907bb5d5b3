"""Every bound of a case is violated where it should be: hand-made strains, speeds, gaps and rates."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest
from walks import CELLS, SETTING, STATIC, Walk, breaks, small, walk

from taichi_cloth.collision.colliders import pose
from taichi_cloth.evaluation.stress import case_catalog, changes, contact, extremes, layered_cloth, loads
from taichi_cloth.evaluation.stress.invariants import Violation
from taichi_cloth.evaluation.stress.loads import alternation
from taichi_cloth.evaluation.stress.setup import sheet
from taichi_cloth.evaluation.stress.trial import Trial, close
from taichi_cloth.scene import SceneError
from taichi_cloth.scene.collider_schema import Plane
from taichi_cloth.scene.schema import FRAME_SECONDS
from taichi_cloth.simulation.frame_clock import FrameClock
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.viewer.session import Session

WALL_TIME = "simulated time beside the wall's [s]"
VARIANTS = {(case.number, one.name): one.run for case in case_catalog.CASES for one in case.variants}


@pytest.fixture(autouse=True)
def few_cells(serial_layout: None, monkeypatch: pytest.MonkeyPatch) -> None:
    small(monkeypatch)


def move_particle(simulation: Simulation, particle: int, y: float) -> None:
    """Raise one particle by `y` [m], or by one bit if `y` is 0.

    At a height of 0, one bit is lost when float32 adds numbers of a meter.
    """
    x, v = simulation.positions(), simulation.velocities()
    x[particle, 1] = x[particle, 1] + y if y else np.nextafter(np.float32(x[particle, 1]), np.float32(9))
    simulation.set_state(x, v)


class SettlingWalk(Walk):
    """A walk that calls `at_rest` each time the cloth comes to rest, and then what the case calls after a frame."""

    at_rest: Callable[[Walk], object]

    def settle(self, after_frame: Callable[[], object] | None = None, **how: object) -> None:
        super().settle(**how)
        self.at_rest()  # type: ignore[call-arg]
        if after_frame is not None:
            after_frame()


def settling(run: Callable[[Trial], object], at_rest: Callable[[Walk], object]) -> Walk:
    """Return the walk through a case, with `at_rest` called each time the cloth comes to rest."""
    trial = SettlingWalk()
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
def test_the_largest_speed_is_bounded_in_every_frame(run: Callable[[Trial], None], most: float, what: str) -> None:
    """In a single frame, near the end of those that are checked. In a walk, a case settles in one frame."""
    frames = walk(run).frames
    late = (
        max(min(frames, 300) - 5, 0) if what == "speed [m/s]" else frames - 5
    )  # nothing is checked once the ball is gone
    assert walk(run, speeds=[*[0.0] * late, 0.999 * most, 0.0]).broken == []
    assert walk(run, speeds=[*[0.0] * late, 1.001 * most, 0.0]).broken == [what]


@pytest.mark.parametrize("name", ["n·v = 0", "crossing zero"])
def test_velocities_edge_on_may_not_change_their_sign_from_frame_to_frame(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(frames: int, speed: float, sign: int) -> list[str]:
        """Give one particle a speed in these frames, with the same sign or another in each."""

        def velocities(simulation: Simulation) -> np.ndarray:
            v = np.zeros((simulation.topology.particle_count, 3))
            v[-2, 2] = speed * sign**simulation.frame if simulation.frame >= frames else 0.0
            return v

        monkeypatch.setattr(Simulation, "velocities", velocities)
        return walk(VARIANTS[28, name]).broken

    assert broken(0, 0.999e-3, -1) == []
    assert set(broken(118, 1.001e-3, -1)) == {"change of sign edge-on [m/s]"}  # three of the 120 frames
    assert broken(0, 1.0, 1) == []
    assert alternation(*np.full((3, 1, 3), 1.0)) == 0.0
    assert alternation(*(np.array([[3.0, 0.0, 4.0]]) * (-1) ** k for k in range(3))) == 5.0


@pytest.mark.parametrize(("name", "cap"), [("1 %", 0.01), ("0.1 %", 0.001)])
@pytest.mark.parametrize("frame", [0, 150, 299])
def test_the_strain_limit_is_checked_in_every_frame(name: str, cap: float, frame: int) -> None:
    run = VARIANTS[38, name]
    assert walk(run, strains=[*[0.0] * frame, cap, 0.0]).broken == []
    assert walk(run, strains=[*[0.0] * frame, cap + 3e-5, 0.0], speeds=[0.0] * (frame + 2)).broken == [
        "strain above the cap"
    ]
    assert loads.CAP_ROUNDING < 2e-5


def test_the_strain_limit_is_checked_while_the_sheet_comes_to_rest() -> None:
    def stretch(one: Walk) -> None:
        one.watch.strain = 0.02

    assert settling(VARIANTS[38, "1 %"], stretch).broken == ["strain above the cap"]


def test_a_stretched_sheet_returns_to_its_static_strain_within_a_thousandth() -> None:
    for times in ("×2", "×5", "×10"):
        for strain, broken in ((STATIC, []), (STATIC + 9e-4, []), (STATIC + 1.1e-3, [1]), (STATIC - 1.1e-3, [1])):
            assert len(walk(VARIANTS[7, times], strains=[strain]).broken) == len(broken)


@pytest.mark.parametrize(("number", "name", "bound"), [(11, "uniform", 0.05), (29, "10 m", 0.05)])
def test_strain_bounds_of_the_list_of_cases(number: int, name: str, bound: float) -> None:
    assert walk(VARIANTS[number, name]).rest == [bound]


def test_geometry_stretches_the_springs_from_a_pin_inside_a_ball() -> None:
    """Two neighbors lie on the ball, as close to the pin as possible."""
    cell, radius = 1 / 32, 0.15
    strain = layered_cloth.beside_pin(radius, 0.05, cell)
    pin = np.array([0.0, radius - 0.05])
    aside = cell / np.sqrt(2)
    neighbor = np.array([aside, np.sqrt(radius**2 - aside**2)])
    assert strain == pytest.approx(np.linalg.norm(neighbor - pin) / cell - 1)
    assert 0.6 < strain < 0.8
    [rest] = walk(VARIANTS[22, "5 cm"]).rest
    assert rest == pytest.approx(STATIC + 0.01 + layered_cloth.beside_pin(radius, 0.05, 1 / CELLS))


@pytest.mark.parametrize(("particle", "broken"), [(0, []), (1, []), (80, ["strain off the ball"])])
def test_only_springs_on_the_ball_may_be_stretched_by_it(particle: int, broken: list[str]) -> None:
    """The pin inside the ball is 0, the top left corner; 80 is the opposite corner."""
    assert walk(layered_cloth.ball_on_pin).broken == []
    found = settling(layered_cloth.ball_on_pin, lambda one: move_particle(one.simulation, particle, 0.05))
    assert found.broken == broken


def test_the_rest_strain_with_gravity_up_is_that_of_the_mirror_image(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[float] = []
    monkeypatch.setattr(
        "taichi_cloth.evaluation.stress.trial.static_strain", lambda scene: seen.append(scene.forces.gravity) or STATIC
    )
    assert [one.forces.gravity for one in walk(VARIANTS[26, "upwards"]).scenes] == [-9.81]
    assert seen == [9.81]


@pytest.mark.parametrize("pin", [0, 30, 80])
def test_a_pin_that_moves_by_one_bit_is_a_violation(pin: int) -> None:
    assert walk(loads.all_pins).broken == []
    found = settling(loads.all_pins, lambda one: move_particle(one.simulation, pin, 0.0))
    assert found.broken == ["way of a pin [m]"]


# -- balls ---------------------------------------------------------------------------------------------


def test_particles_that_pass_through_a_ball_are_counted() -> None:
    radius = 0.1
    for beside, through in ((0.0, 1), (0.06, 1), (0.099, 1), (0.101, 0)):
        before, after = np.array([[beside, 0.0, 1.0]]), np.array([[beside, 0.0, -3.0]])
        assert contact.went_through(before, after, radius) == through
        assert contact.went_through(after, before, radius) == through
        assert contact.went_through(before, 0.9 * before, radius) == 0
    slanting = np.array([[0.5, 0.0, 1.0]]), np.array([[-0.5, 0.0, -1.0]])
    assert contact.went_through(*slanting, radius) == 1
    assert contact.went_through(slanting[0] + [0.11, 0, 0], slanting[1] + [0.11, 0, 0], radius) == 0


@pytest.mark.parametrize("against", ["particles", "triangles"])
def test_a_distant_sheet_does_not_count_as_behind_the_small_ball(against: str) -> None:
    class Leaving(Walk):
        def one_frame(self, **how: object) -> None:
            super().one_frame(**how)
            if self.frames == 1:
                self.simulation.set_state(self.simulation.positions() + [3.0, 0.0, 3.0], np.zeros(3))

    trial = Leaving()
    try:
        VARIANTS[18, f"against {against}"](trial)
        [figure] = trial.figures
        assert (figure.what, figure.value) == ("whether the ball went through", 0.0)
    finally:
        close()


@pytest.mark.parametrize("name", ["5 m/s", "20 m/s", "50 m/s", "100 m/s"])
def test_the_fast_ball_is_checked_in_every_frame(name: str) -> None:
    """Nothing moves in a walk but the ball, so the ball passes through the sheet.

    The check is made slightly before the end of each frame: the center of the ball is then never exactly in the plane
    of the sheet.
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
    """Return a trial of a free sheet that moves at `velocity` toward a ball, which lets particles through."""
    trial = Trial(SETTING, 0)
    ball = replace(contact.shot(1e-9, radius), center=(0.0, 0.0, 0.5), keyframes=(), margin=0.0, continuous=False)
    trial.open(sheet(CELLS, pins=(), spheres=(ball,), damping=0.0))
    trial.start(velocity=velocity)
    return trial


def test_particles_that_pass_through_the_ball_are_a_violation() -> None:
    try:
        with pytest.raises(Violation, match="particles that went through the ball"):
            contact.run_past(hung((0.0, 0.0, 500.0)), 0.1)
    finally:
        close()


def test_no_particle_may_be_faster_than_at_the_start() -> None:
    try:
        contact.run_past(hung((0.0, 0.0, -3.0)), FRAME_SECONDS, 4.0)
        with pytest.raises(Violation, match="speed"):
            contact.run_past(hung((0.0, 0.0, -3.0)), FRAME_SECONDS, 2.9)
    finally:
        close()
    [bound] = [figure.bound for figure in walk(contact.fast_cloth).figures if figure.what == "speed [m/s]"]
    assert bound == pytest.approx(100.0, abs=0.05)


# -- layers --------------------------------------------------------------------------------------------


def stacked(heights: list[float], cells: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """Return the positions of level sheets of 1 m at these heights, and the triangles of one."""
    across = np.linspace(-0.5, 0.5, cells + 1)
    x, z = np.meshgrid(across, across)
    sheets = [np.stack([x, np.full_like(x, y), z], axis=-1).reshape(-1, 3) for y in heights]
    n = cells + 1
    triangles = []
    for row, column in product(range(cells), range(cells)):
        a = row * n + column
        triangles += [(a, a + 1, a + n), (a + 1, a + n + 1, a + n)]
    return np.concatenate(sheets), np.array(triangles, np.int32)


def test_the_smallest_gap_between_layers() -> None:
    x, triangles = stacked([0.0, 0.1, 0.17])
    assert layered_cloth.smallest_gap(x, triangles, 3, 1.0) == pytest.approx(0.07)
    assert layered_cloth.smallest_gap(x, triangles, 3, 0.05) == 0.05  # at most the reach
    x[5, 1] += 0.08  # one particle of the lowest
    assert layered_cloth.smallest_gap(x, triangles, 3, 1.0) == pytest.approx(0.02)
    x[5, 1] += 0.02
    assert layered_cloth.smallest_gap(x, triangles, 3, 1.0) == pytest.approx(0.0, abs=1e-12)


def test_gaps_are_measured_to_triangles() -> None:
    """The distances between particles are larger."""
    x, triangles = stacked([0.0, 0.01])
    x[16:, [0, 2]] += 1 / 9
    assert layered_cloth.smallest_gap(x, triangles, 2, 1.0) == pytest.approx(0.01)


def test_distances_to_triangles() -> None:
    random = np.random.default_rng(0)
    p, a, b, c = random.uniform(-1, 1, (4, 50, 3))
    shares = random.dirichlet([0.3, 0.3, 0.3], 20_000)
    sampled = np.array(
        [np.linalg.norm(p[k] - shares @ np.stack([a[k], b[k], c[k]]), axis=1).min() for k in range(len(p))]
    )
    found = layered_cloth.to_triangles(p, a, b, c)
    assert (found <= sampled + 1e-12).all()
    assert found == pytest.approx(sampled, abs=0.02)


def test_distances_between_segments() -> None:
    random = np.random.default_rng(0)
    p, q, r, s = random.uniform(-1, 1, (4, 60, 3))
    r[:10], s[:10] = p[:10] + [0.1, 0.2, 0.3], q[:10] + [0.1, 0.2, 0.3]  # parallel
    s[10] = r[10]  # a point
    shares = np.linspace(0, 1, 201)[:, None]
    sampled = []
    for k in range(len(p)):
        on_first, on_other = p[k] + shares * (q[k] - p[k]), r[k] + shares * (s[k] - r[k])
        sampled.append(np.linalg.norm(on_first[:, None] - on_other[None], axis=2).min())
    found = layered_cloth.between_segments(p, q, r, s)
    assert (found <= np.array(sampled) + 1e-12).all()
    assert found == pytest.approx(np.array(sampled), abs=0.01)


def test_gaps_are_measured_between_edges() -> None:
    """An edge of each of two triangles crosses one of the other; their particles are far from the other triangle."""
    triangle = np.array([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    other = np.array([[0.0, -0.12, -1.0], [0.0, -0.12, 1.0], [0.0, -1.0, 0.0]])
    triangles = np.array([[0, 1, 2]], np.int32)
    assert layered_cloth.nearest(triangle, other, triangles, 1.0) > 0.5
    assert layered_cloth.nearest(other, triangle, triangles, 1.0) > 0.5
    assert layered_cloth.smallest_gap(np.concatenate([triangle, other]), triangles, 2, 1.0) == pytest.approx(0.12)


def test_swapped_layers_are_out_of_order() -> None:
    assert layered_cloth.is_stacked(stacked([0.0, 0.1, 0.2])[0], 3)
    assert not layered_cloth.is_stacked(stacked([0.0, 0.2, 0.1])[0], 3)


class Still:
    """Has what `Stack` reads of a trial, for a cloth that does not move."""

    def __init__(self, heights: list[float], intersections: int = 0) -> None:
        x, triangles = stacked(heights)
        topology = SimpleNamespace(triangles=np.tile(triangles, (len(heights), 1)))
        self.simulation = SimpleNamespace(topology=topology, positions=lambda: x, intersections=lambda: intersections)
        self.broken: list[str] = []

    def record(self, what: str, value: float, bound: float) -> None:
        self.broken += [what] * (value > bound)


@pytest.mark.parametrize(
    ("heights", "intersections", "broken"),
    [
        ([0.0, 0.01, 0.02], 0, []),
        ([0.0, 0.01, 0.0151], 0, []),
        ([0.0, 0.01, 0.0149], 0, ["gap missing, of half a thickness"]),
        ([0.0, 0.02, 0.01], 0, ["stacks out of order"]),
        ([0.0, 0.01, 0.02], 1, ["intersections at the end"]),
    ],
)
def test_gaps_intersections_and_order_are_checked_at_the_end(
    heights: list[float], intersections: int, broken: list[str]
) -> None:
    still = Still(heights, intersections)
    layered_cloth.Stack(still, 3, 0.01).end()  # type: ignore[arg-type]
    assert still.broken == broken


def test_a_twisted_sheet_must_return_to_its_shape(monkeypatch: pytest.MonkeyPatch) -> None:
    one = walk(layered_cloth.twist)
    assert one.broken == []
    bounds = {figure.what: figure.bound for figure in one.figures}
    assert bounds == {
        "intersections in the worst frame": None,
        "intersections at the end": 0,
        "distance from the shape before [m]": 0.01,
    }
    monkeypatch.setattr(layered_cloth, "SHAPE", -1.0)
    assert walk(layered_cloth.twist).broken == ["distance from the shape before [m]"]


def untwisted(y: float, intersections: int) -> Walk:
    """Return a walk through the twist: untwisted, one particle is `y` [m] higher, with this many intersections."""

    def at_rest(one: Walk) -> None:
        if one.settled == 2:
            move_particle(one.simulation, CELLS * (CELLS + 1) // 2, y)
            one.simulation.intersections = lambda: intersections  # type: ignore[method-assign]

    return settling(layered_cloth.twist, at_rest)


@pytest.mark.parametrize(
    ("y", "intersections", "broken"),
    [
        (0.0099, 0, []),
        (0.0101, 0, ["distance from the shape before [m]"]),
        (0.0, 1, ["intersections at the end"]),
    ],
)
def test_an_untwisted_sheet_has_its_shape_and_no_intersections(y: float, intersections: int, broken: list[str]) -> None:
    assert untwisted(y, intersections).broken == broken


def test_intersections_of_a_twisted_sheet_are_only_recorded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Simulation, "intersections", lambda simulation: int(0 < simulation.frame < 1000))
    one = walk(layered_cloth.twist)
    assert one.broken == []
    assert {figure.what: figure.value for figure in one.figures}["intersections in the worst frame"] == 1


def test_swapped_columns_must_untangle() -> None:
    def at_rest(one: Walk) -> None:
        one.simulation.intersections = lambda: 1  # type: ignore[method-assign]

    assert walk(loads.inverted).broken == []
    assert settling(loads.inverted, at_rest).broken == ["intersections at the end"]


PILE = "10 sheets of 13×13"


@pytest.mark.parametrize("what", ["intersections at the end", "stacks out of order"])
def test_a_pile_is_checked_at_the_end(what: str) -> None:
    """The ten layers do not move. Once the pile is at rest, an edge intersects a triangle, or the pile is inverted."""

    def at_rest(one: Walk) -> None:
        if what == "intersections at the end":
            one.simulation.intersections = lambda: 1  # type: ignore[method-assign]
        else:
            one.simulation.set_state(one.simulation.positions() * [1.0, -1.0, 1.0])

    assert what not in walk(VARIANTS[15, PILE]).broken
    found = settling(VARIANTS[15, PILE], at_rest)
    assert what in found.broken
    assert [figure.bound for figure in found.figures if figure.what == what] == [0]


def test_a_pile_is_checked_while_it_settles() -> None:
    """The layers are closer in one of the frames, and apart again in the end."""
    what = "gap missing, of half a thickness"

    def missing(trial: Walk) -> float:
        return next(figure.value for figure in trial.figures if figure.what == what)

    class Closing(Walk):
        def settle(self, *, after_frame: Callable[[], object], **how: object) -> None:
            x = self.simulation.positions()
            self.simulation.set_state(x * [1.0, 0.001, 1.0])
            for _ in range(layered_cloth.LOOK_EVERY):
                after_frame()
            self.simulation.set_state(x)
            super().settle(**how)

    assert missing(walk(VARIANTS[15, PILE])) < 0.9
    trial = Closing()
    try:
        VARIANTS[15, PILE](trial)
        assert what in trial.broken
        assert missing(trial) > 0.99
    finally:
        close()


# -- friction ------------------------------------------------------------------------------------------


def test_creep_is_a_violation(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(contact, "REST_SECONDS", 0.5)
    monkeypatch.setattr(contact, "Plane", lambda **keys: Plane(**(keys | {"friction": 0.0})))
    breaks(partial(contact.slope, how=(1.0, 30.0)), "creep")


def test_a_sheet_held_by_friction_is_checked_for_a_minute() -> None:
    for mu, slope in ((1, 30), (10, 30), (1e6, 30), (1e6, 89)):
        one = walk(VARIANTS[35, f"μ = {mu:g}, {slope}°"])
        assert one.frames == 3600
        assert [figure.bound for figure in one.figures] == [1e-3]
    assert "creep [m]" not in [figure.what for figure in walk(VARIANTS[35, "μ = 10, 89°"]).figures]


def test_a_sliding_sheet_may_exceed_the_speed_of_a_block_by_the_speed_allowed_at_rest() -> None:
    for mu, slope in ((0, 30), (0, 89), (1, 89), (10, 89)):
        angle = np.radians(slope)
        block = 9.81 * (np.sin(angle) - mu * np.cos(angle)) / 2.0  # [m/s] damped at 2/s
        assert walk(VARIANTS[35, f"μ = {mu:g}, {slope}°"]).rest_speeds == [pytest.approx(block + 0.1)]


@pytest.mark.parametrize(("speed", "broken"), [(4.9 / 2, False), (4.9 / 2 - 0.11, True), (0.0, True)])
def test_a_sheet_without_friction_must_slide(speed: float, broken: bool) -> None:
    class Sliding(Walk):
        def settle(self, **how: object) -> None:
            super().settle(**how)
            down = np.array([np.cos(np.pi / 6), -0.5, 0.0])
            x = self.simulation.positions()
            self.simulation.set_state(x, speed * down + np.zeros_like(x))

    trial = Sliding()
    try:
        VARIANTS[35, "μ = 0, 30°"](trial)
        assert trial.broken == (["slower than a sliding block by [m/s]"] if broken else [])
    finally:
        close()


@pytest.mark.parametrize("slope", [30.0, 89.0])
def test_a_sheet_on_a_slope_starts_with_velocities_along_it(slope: float, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[np.ndarray] = []
    plain = Walk.settle

    def settle(one: Walk, **how: float) -> None:
        seen.append(one.simulation.velocities())
        plain(one, **how)

    monkeypatch.setattr(Walk, "settle", settle)
    walk(partial(contact.slope, how=(1e6, slope)))
    up = np.array([np.sin(np.radians(slope)), np.cos(np.radians(slope)), 0.0])
    assert np.abs(seen[0] @ up).max() < 1e-6
    assert 0.01 < np.abs(seen[0]).max() < 0.04


def test_the_angular_velocity_of_a_cloth() -> None:
    x = np.random.default_rng(1).normal(size=(20, 3))
    v = np.cross([0.0, 3.0, 0.0], x)
    assert contact.turns_of(x, v, np.linspace(1, 2, 20)) == pytest.approx(3.0)
    assert contact.turns_of(x, 0 * v, np.ones(20)) == 0.0


@pytest.mark.parametrize(
    ("share", "broken"),
    [
        (1.0009, ""),
        (1.0011, "rate of the sheet, of the ball's"),
        (0.51, ""),
        (0.49, "rate that the sheet lacks, of the ball's"),
    ],
)
def test_a_sheet_turns_with_its_ball_and_not_faster(share: float, broken: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(contact, "turns_of", lambda *_: share * np.radians(180.0))
    assert set(walk(contact.rotating_ball).broken) == ({broken} if broken else set())


def test_the_ball_on_the_layers_must_end_beside_them(monkeypatch: pytest.MonkeyPatch) -> None:
    what = "distance of the ball from the pile [m]"
    thickness = layered_cloth.particle_self_collision(1.0 / layered_cloth.CELLS).thickness

    def broken(away: float) -> bool:
        """With the nearest particle at this distance from the ball and its margin [m]."""

        def move(one: Walk) -> None:
            x = one.simulation.positions()
            beside = one.simulation.colliders()[0].center + [0.3 + contact.MARGIN + away, 0.0, 0.0]
            one.simulation.set_state(x - x[x[:, 0].argmin()] + beside, np.zeros_like(x))

        return what in settling(VARIANTS[15, "10 sheets"], move).broken

    assert not broken(0.99 * thickness)
    assert broken(1.01 * thickness)


@pytest.mark.parametrize(("down", "fallen"), [(0.0, 0), (2.0, 50)])
def test_no_layer_may_fall_off_the_bar(down: float, fallen: int) -> None:
    def move(one: Walk) -> None:
        x = one.simulation.positions()
        one.simulation.set_state(x - [0.0, 50 * layered_cloth.MANY_SPACING * (down > 0) + down, 0.0], np.zeros_like(x))

    one = settling(VARIANTS[16, "50 sheets"], move)
    what = "layers that fell off the bar"
    assert [f.value for f in one.figures if f.what == what] == [fallen]
    assert (what in one.broken) == (fallen > 0)


@pytest.mark.parametrize(("frames", "broken"), [(4, []), (3, [WALL_TIME]), (9, [WALL_TIME])])
def test_a_clock_that_loses_or_adds_time_is_a_violation(
    frames: int, broken: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """After a stall of a second the clock keeps four frames; another number is too few or too many."""

    class Clock(FrameClock):
        def due(self, now: float) -> int:
            due = super().due(now)
            return due if due < 4 else frames

    monkeypatch.setattr(extremes, "FrameClock", Clock)
    assert walk(VARIANTS[5, "1/144 and 1/20 s"]).broken == broken
    assert set(walk(VARIANTS[4, "display"]).broken) == set(broken)


@pytest.mark.parametrize(("times", "broken"), [(1.009, False), (1.011, True)])
@pytest.mark.parametrize("mu", [0.3, 0.03])
def test_friction_on_a_loose_sheet_is_measured(
    mu: float, times: float, broken: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The sheet accelerates by `times` μ·g, in the direction in which the other is pulled, by 1 m in a second."""

    def start(trial: Trial) -> None:
        one, x = type(trial.simulation).velocities, trial.simulation.positions()
        pull, lower = times * mu * 9.81, slice(None, len(x) // 2)

        def positions() -> np.ndarray:
            moved = x.copy()
            moved[lower, 0] += max(trial.simulation.frame * FRAME_SECONDS - 1.0, 0.0)  # it lies still for a second
            return moved

        def velocities() -> np.ndarray:
            v = one(trial.simulation)
            v[:, 0] = pull * trial.simulation.frame * FRAME_SECONDS
            return v

        monkeypatch.setattr(trial.simulation, "velocities", velocities)
        monkeypatch.setattr(trial.simulation, "positions", positions)

    def run(trial: Trial) -> None:
        plain = trial.start

        def started() -> None:
            plain()
            start(trial)

        trial.start = started  # type: ignore[method-assign, assignment]
        contact.tablecloth(trial, mu)

    one = walk(run)
    assert bool(one.broken) == broken
    friction, mean, gone = one.figures
    assert friction.value == pytest.approx(times, rel=1e-3)
    assert (mean.bound, gone.bound) == (None, None)
    assert gone.value == 1
    # With μ = 0.3 it is faster than the pull before that begins, so nothing slides. With 0.03 the force stays while the
    # share of the sheet that lies on the other falls to 0 in 60 frames.
    assert mean.value == (0.0 if mu == 0.3 else pytest.approx(times * 60 / 29.5, rel=1e-2))


def test_a_loose_sheet_without_friction_has_none(monkeypatch: pytest.MonkeyPatch) -> None:
    """An upper bound alone does not tell: the mean is 0, not 1."""
    one = walk(VARIANTS[39, "1 m/s, μ = 0.03"])
    found = {figure.what: figure.value for figure in one.figures}
    assert abs(found["mean friction while the layers slide, of μ times the weight"]) < 0.01
    assert found["whether the tablecloth is gone"] == 0
    assert one.frames == 60 * (1 + 1.5)


# -- time, positions and sizes ----------------------------------------------------------------------------


def test_a_fast_clock_is_a_violation(monkeypatch: pytest.MonkeyPatch) -> None:
    assert walk(VARIANTS[4, "display"]).broken == []
    plain = extremes.FrameClock.due
    monkeypatch.setattr(extremes.FrameClock, "due", lambda self, now: 2 * plain(self, now))
    assert "simulated time beside the wall's [s]" in walk(VARIANTS[4, "display"]).broken


@pytest.mark.parametrize("variant", ["display", "time step"])
@pytest.mark.parametrize(("height", "broken"), [(1.01, []), (1.03, [extremes.BETWEEN_RATES])])
def test_the_sags_at_two_rates_are_compared(
    variant: str, height: float, broken: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The third sheet sags 1 % or 3 % more than the others, which start 5 cm below a sheet of 1 m."""
    opened = []
    plain = extremes.sheet

    def longer(cells: int) -> object:
        opened.append(cells)
        return plain(cells, size=(1.0, 1.0 + 2 * 0.05 * (1.0 if len(opened) != 3 else height)))

    monkeypatch.setattr(extremes, "sheet", longer)
    assert sorted(set(walk(VARIANTS[4, variant]).broken)) == broken
    assert len(opened) == 5


def test_a_sag_is_the_way_of_the_lower_edge_from_where_it_is_without_load() -> None:
    trial = Walk()
    try:
        trial.open(sheet(CELLS, center=(0.0, 3.0, 0.0)))
        x = trial.simulation.positions()
        assert extremes.sag_of(trial, height=3.0) == pytest.approx(0.0, abs=1e-6)
        x[-1, 1] -= 0.25
        trial.simulation.set_state(x)
        assert extremes.sag_of(trial, height=3.0) == pytest.approx(0.25, abs=1e-6)
        trial.skip_rest_check("a test")
    finally:
        close()
    assert extremes.difference([0.04, 0.05, 0.045]) == pytest.approx(0.2)
    assert extremes.difference([0.0, 0.0]) == 0.0
    assert extremes.difference([0.05, -0.05]) == 2.0


def test_the_time_step_is_that_of_each_rate(monkeypatch: pytest.MonkeyPatch) -> None:
    taken = []

    class Counting(Walk):
        def settle(self, **how: object) -> None:
            super().settle(**how)
            taken.append(self.simulation.params["substeps"])

    trial = Counting()
    trial.setting = replace(SETTING, solver=replace(SETTING.solver, substeps=5))
    try:
        extremes.time_steps(trial)
    finally:
        close()
    assert taken == [20, 10, 5, 2, 1]


def test_an_explicit_solver_has_its_longest_stable_step_at_the_lowest_rate(monkeypatch: pytest.MonkeyPatch) -> None:
    """Here it is a quarter of a frame; 240 frames per second would have 24 times as many substeps."""
    monkeypatch.setattr(extremes, "MAX_SUBSTEPS", 50)
    monkeypatch.setattr(Simulation, "min_stable_substeps", property(lambda simulation: 4))
    trial = Walk()
    trial.setting = replace(SETTING, solver=replace(SETTING.solver, name="explicit"))
    try:
        extremes.time_steps(trial)
    finally:
        close()
    set_to = [value for name, value in trial.sets if name == "substeps"]
    assert set_to[::2] == [50, 48, 24, 12, 4]  # between them, the next scene has the usual number


def run_paused() -> Trial:
    """Run case 6 with enough substeps to conserve energy, and without the check at rest."""
    trial = Trial(replace(SETTING, solver=replace(SETTING.solver, substeps=20, iterations=4)), 0)
    trial.settle = lambda: None  # type: ignore[method-assign, misc, assignment]
    try:
        extremes.paused(trial)
    finally:
        close()
    return trial


def test_a_session_that_advances_while_paused_is_a_violation(monkeypatch: pytest.MonkeyPatch) -> None:
    plain = Session.advance
    monkeypatch.setattr(Session, "advance", lambda self, frames: plain(self, max(frames, 1)))
    with pytest.raises(Violation, match="while paused"):
        run_paused()


def test_a_position_that_changes_while_paused_is_a_violation(monkeypatch: pytest.MonkeyPatch) -> None:
    plain = Session.measure

    def measure(session: Session) -> object:
        x, v = session.simulation.positions(), session.simulation.velocities()
        x[-1, 1] = np.nextafter(np.float32(x[-1, 1]), np.float32(1))
        session.simulation.set_state(x, v)
        return plain(session)

    monkeypatch.setattr(Session, "measure", measure)
    with pytest.raises(Violation, match="numbers that changed while paused"):
        run_paused()


def test_frames_that_pass_while_paused_are_a_violation(monkeypatch: pytest.MonkeyPatch) -> None:
    """They count even if the cloth does not move in them."""
    plain = Session.advance

    def advance(session: Session, frames: int) -> None:
        plain(session, frames)
        session.simulation.set_frame(session.simulation.frame + (frames == 0))

    monkeypatch.setattr(Session, "advance", advance)
    with pytest.raises(Violation, match="frames that passed while paused") as found:
        run_paused()
    assert (found.value.value, found.value.bound) == (extremes.PAUSED_REFRESHES, 0)


def test_a_later_change_by_a_pause_is_a_violation(monkeypatch: pytest.MonkeyPatch) -> None:
    """In the last of the 60 frames after the pause."""
    plain, later = Session.advance, []

    def advance(session: Session, frames: int) -> None:
        plain(session, frames)
        later.extend([True] * frames)
        if len(later) == 60:
            move_particle(session.simulation, session.simulation.topology.particle_count - 1, 0.0)

    monkeypatch.setattr(Session, "advance", advance)
    with pytest.raises(Violation, match="numbers that a pause changed later"):
        run_paused()


def test_a_pause_changes_nothing() -> None:
    trial = run_paused()
    assert [figure.value for figure in trial.figures] == [0, 0, 0]


def test_drift_is_a_violation(monkeypatch: pytest.MonkeyPatch) -> None:
    assert walk(partial(extremes.hanging, frames=10)).broken == []
    monkeypatch.setattr(extremes, "DRIFT", -1.0)
    assert walk(partial(extremes.hanging, frames=10)).broken == ["drift [m]"]
    assert [figure.bound for figure in walk(VARIANTS[32, "hanging"]).figures] == [-1.0]


@pytest.mark.parametrize(("distance", "broken"), [(0.9e-4, []), (1.1e-4, ["drift [m]"])])
def test_a_hanging_sheet_may_drift_by_a_ten_thousandth_of_its_side(distance: float, broken: list[str]) -> None:
    class Drifting(Walk):
        def one_frame(self, **how: object) -> None:
            super().one_frame(**how)
            if self.frames == 15 * 60 + 5:  # the fifth of those that are checked
                move_particle(self.simulation, CELLS, distance)

    trial = Drifting()
    try:
        extremes.hanging(trial, 10)
        assert trial.broken == broken
    finally:
        close()


def test_a_drift_that_is_undone_is_a_violation(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(extremes, "DRIFT_EVERY", 5)

    class Drifting(Walk):
        def one_frame(self, **how: object) -> None:
            super().one_frame(**how)
            if self.frames in (15 * 60 + 3, 15 * 60 + 8):
                move_particle(self.simulation, CELLS, 0.01 if self.frames < 15 * 60 + 8 else -0.01)

    trial = Drifting()
    try:
        extremes.hanging(trial, 20)
        assert trial.broken == ["drift [m]"]
    finally:
        close()


class Falling(Walk):
    """Falls by `share` times ½gt² in the first run of every sheet without pins."""

    share = 1.0

    def run(self, seconds: float, **how: bool) -> None:
        first = not self.simulation.topology.pinned.any() and self.fallen != len(self.scenes)
        super().run(seconds, **how)
        if first:
            self.fallen = len(self.scenes)
            x, v = self.simulation.positions(), self.simulation.velocities()
            x[:, 1] += v[:, 1].mean() * seconds - self.share * 9.81 * seconds**2 / 2
            self.simulation.set_state(x, v)

    fallen = 0  # number of scenes opened at the last fall


@pytest.mark.parametrize(
    ("number", "name", "seconds", "what"),
    [
        (33, "100 m", 0.4, "fall beside ½gt², share"),
        (37, "damping time 1 s", 1.0, "fall in 1 s beside ½gt², share"),
    ],
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
def test_a_distant_sheet_has_the_same_sag_within_a_hundredth(share: float, broken: bool) -> None:
    """Both sheets are one meter high and sag by 5 cm, the second by more or less."""

    def at_rest(one: Walk) -> None:
        if one.settled <= 2:
            x = one.simulation.positions()
            x[:, 1] -= 0.05 * (1 + share * (one.settled == 2)) * (x[:, 1].max() - x[:, 1])
            one.simulation.set_state(x)

    found = settling(VARIANTS[33, "100 m"], at_rest)
    assert ("sag beside that near the origin, share" in found.broken) == broken


STARTS_ONLY = [(1, "1e3 N/m"), (4, "time step"), (22, "5 cm"), (24, "doubled points"), (24, "particles together")]
STARTS_ONLY += [(25, "2×2"), (26, "upwards"), (33, "100 m"), (37, "1e6")]


@pytest.mark.parametrize(
    ("number", "name", "seconds"),
    [(*variant, 0.0) for variant in STARTS_ONLY]
    + [(21, "teleported", 6.5), (21, "0 to 0.5 m", 6.5), (31, "mass ×100", 1.0), (32, "swinging", 60.0)]
    + [(34, "none", 0.6), (36, "180°/s", 8.0), (37, "0", 5.0), (37, "damping time 1 s", 1.6), (39, "1 m/s, 5×5", 2.5)],
)
def test_rest_is_judged_five_seconds_after_the_last_disturbance(number: int, name: str, seconds: float) -> None:
    """`settle` runs these five seconds: it is called when the last disturbance ends."""
    frames: list[int] = []
    settling(VARIANTS[number, name], lambda one: frames.append(one.frames))
    assert frames[0] == pytest.approx(seconds / FRAME_SECONDS, abs=1)


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf])
def test_a_position_of_a_large_sheet_that_is_not_finite_is_a_violation(
    wrong: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(extremes, "sheet", lambda cells, **keys: sheet(CELLS, pins=keys["pins"]))
    assert walk(extremes.large).broken == []
    plain = Simulation.positions

    def positions(simulation: Simulation) -> np.ndarray:
        x = plain(simulation)
        x[-1, 2] = wrong if simulation.frame else x[-1, 2]
        return x

    monkeypatch.setattr(Simulation, "positions", positions)
    assert walk(extremes.large).broken == ["places that are not finite"]


# -- changes during a run, and repeated runs -------------------------------------------------------------


@pytest.mark.parametrize("refusal", [1, 15, 41])
def test_a_number_that_a_refused_input_changes_is_a_violation(refusal: int) -> None:
    class Careless(Walk):
        refused = 0

        def expect_error(self, what: str, attempt: Callable[[], object]) -> None:
            super().expect_error(what, attempt)
            self.refused += 1
            if self.refused == refusal:
                move_particle(self.simulation, 30, 0.0)

    trial = Careless()
    try:
        VARIANTS[30, "nan"](trial)
        assert trial.refused == 41
        assert trial.broken == ["numbers that a refused input changed"]
    finally:
        close()


@pytest.mark.parametrize(
    ("solver", "needed", "set_to", "notes"),
    [
        ("xpbd", 1, [20, 1], []),
        ("xpbd", 2, [20, 1], ["2 substeps instead of 1, which would be unstable"]),
        ("explicit", 30, [500, 30], []),
    ],
)
def test_substeps_change_to_the_fewest_that_are_stable(
    solver: str, needed: int, set_to: list[int], notes: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(changes, "MAX_SUBSTEPS", 500)
    monkeypatch.setattr(Simulation, "min_stable_substeps", property(lambda simulation: needed))
    monkeypatch.setattr(
        Simulation, "substeps", property(lambda simulation: max(int(simulation.params["substeps"]), needed))
    )
    trial = Walk()
    trial.setting = replace(SETTING, solver=replace(SETTING.solver, name=solver))
    try:
        VARIANTS[31, "substeps 20 to 1"](trial)
    finally:
        close()
    assert [value for name, value in trial.sets if name == "substeps"] == set_to
    assert trial.notes == notes


def violated_by(change: Callable[[Simulation], object]) -> list[str]:
    """Return the violated bounds if `change` is all that a change during a run does to the cloth."""
    trial = Walk()
    try:
        trial.open(sheet(CELLS, pins=("top",)))
        trial.start()
        changes.without_a_jump(trial, partial(change, trial.simulation))
        return trial.broken
    finally:
        close()


def test_a_position_may_not_jump() -> None:
    """Not even by one bit."""
    assert violated_by(lambda simulation: None) == []
    assert violated_by(lambda simulation: move_particle(simulation, 30, 0.0)) == ["jump of a place [m]"]


@pytest.mark.parametrize(("times", "broken"), [(0.95, []), (1.05, ["jump of a velocity [m/s]"])])
def test_a_velocity_may_jump_by_float32_rounding(times: float, broken: list[str]) -> None:
    """By 1 mm/s, and by two roundings of a position of 1 m over a substep."""
    bound = 1e-3 + 2 * 2.0**-23 * 60 * SETTING.solver.substeps

    def accelerate(simulation: Simulation) -> None:
        v = simulation.velocities()
        v[40, 2] += times * bound
        simulation.set_state(simulation.positions(), v)

    assert violated_by(accelerate) == broken


@pytest.mark.parametrize(("times", "broken"), [(0.99, False), (1.01, True), (float("nan"), True)])
def test_an_ejection_in_the_frame_after_a_ball_is_toggled_is_bounded(times: float, broken: bool) -> None:
    """By 2 m/s and a frame of free fall, for a sheet that was still."""
    far = times * (2.0 + 9.81 / 60) / 60

    class Thrown(Walk):
        def one_frame(self, **how: object) -> None:
            super().one_frame(**how)
            x = self.simulation.positions()
            x[40, 2] += far
            self.simulation.positions = lambda: x  # type: ignore[method-assign]

    trial = Thrown()
    try:
        trial.open(sheet(CELLS, pins=("top",)))
        trial.start(shake=0.0)
        changes.without_an_ejection(trial, lambda: None)
        assert trial.broken == (["displacement in the next frame, of its bound"] if broken else [])
    finally:
        close()


def test_the_frame_after_each_toggle_of_a_ball_is_looked_at() -> None:
    what = "displacement in the next frame, of its bound"
    one = walk(VARIANTS[31, "ball toggled"])
    assert [figure.bound for figure in one.figures if figure.what == what] == [1]
    assert one.frames == 60 * (1 + 3)


@pytest.mark.parametrize("name", ["one point", "1 µm", "1 mm"])
def test_a_collapsed_sheet_must_end_alike_in_the_second_run(name: str) -> None:
    run = VARIANTS[9, name]
    assert walk(run).broken == []

    def at_rest(one: Walk) -> None:
        if one.settled == 4:
            move_particle(one.simulation, 30, 0.0)

    assert settling(run, at_rest).broken == ["numbers that are others the second time"]


def test_a_sheet_that_does_not_fall_is_a_violation() -> None:
    """Nothing moves in a walk, so it does not fall by ½gt²."""
    assert walk(VARIANTS[33, "100 m"]).broken == ["fall beside ½gt², share"]
    assert walk(VARIANTS[37, "damping time 1 s"]).broken == ["fall in 1 s beside ½gt², share"]


@pytest.mark.parametrize(
    "text", ["mesh.obj: line 3: no", "it takes 4000 substeps", "xpbd needs a grid", "explicit needs a grid", "no"]
)
def test_a_refusal_must_name_its_reason(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object, **__: object) -> None:
        raise SceneError("scene", "cloth.file", text)

    monkeypatch.setattr(Trial, "open", refused)
    trial = Trial(SETTING, 0)
    if text in ("no", "explicit needs a grid"):  # the solver of SETTING is `xpbd`
        with pytest.raises(Violation, match="name nothing"):
            extremes.open_or_refused(trial, sheet(2), "mesh.obj", None)
    else:
        extremes.open_or_refused(trial, sheet(2), "mesh.obj", None)
        [note] = trial.notes
        assert note.startswith("refused: ")
        assert text in note


def test_the_stretch_by_a_heavy_corner_is_recorded() -> None:
    assert [(f.what, f.value) for f in walk(partial(extremes.mass_ratio, times=10.0), strains=[0.3]).figures] == [
        ("strain", 0.3)
    ]


@pytest.mark.parametrize("speed", [5.0, 20.0, 50.0, 100.0])
def test_a_ball_flies_at_its_full_speed_in_each_frame_until_it_stops(speed: float) -> None:
    """A collider moves straight between its poses at the ends of a frame, so the path must not end within one."""
    ball = contact.shot(speed, 0.1)
    positions = [pose(ball, k * FRAME_SECONDS)[0][2] for k in range(30)]
    assert positions[0] == -contact.BEFORE
    moved = np.diff(positions)
    flying = int((moved > 0).sum())
    assert flying == round(contact.shot_seconds(speed) / FRAME_SECONDS)
    assert moved[:flying] == pytest.approx(speed * FRAME_SECONDS)
    assert moved[flying:] == pytest.approx(0.0, abs=1e-9)
    assert positions[flying] >= contact.BEHIND
