"""The reference solution compared with closed forms, for each law of motion, force and contact."""

from dataclasses import replace
from math import exp, sqrt, tanh

import numpy as np
import pytest

from taichi_cloth.evaluation.reference.solution import Motion
from taichi_cloth.geometry.spring_model import Wind as WindModel
from taichi_cloth.geometry.spring_model import parabolic_wave
from taichi_cloth.scene.collider_schema import Attachment, Box, Ground, Plane, Sphere
from taichi_cloth.scene.fabric_schema import Fabric
from taichi_cloth.scene.schema import Cloth, Forces, Maps, Scene, Solver, StrainLimit, Tethers, Wind

FRAME = 1 / 60
PATCH = Cloth(rows=3, columns=3, width=0.2, height=0.2, center=(0.0, 1.0, 0.0), rotation=(-90.0, 0.0, 0.0), pins=())
FREE = Scene(
    cloth=PATCH, fabric=Fabric(warp=100.0, weft=100.0, shear=50.0, bend_spring=1.0), solver=Solver(damping=0.0)
)
THREAD = Fabric(warp=10.0, weft=0.0, shear=0.0, bend_spring=0.0)
PAIR = Scene(cloth=Cloth(rows=2, columns=2, width=1.0, height=1.0), fabric=THREAD, solver=Solver(damping=0.0))


def run(scene: Scene, frames: int, steps: int = 40) -> Motion:
    motion = Motion(scene, steps)
    for _ in range(frames):
        motion.step_frame()
    return motion


def test_a_sheet_falls_freely() -> None:
    moved = run(FREE, 30)
    assert moved.x - moved._model.start == pytest.approx(np.outer([0, -9.81 / 8, 0], np.ones(9)), abs=1e-9)


def test_damping_reduces_velocity_at_its_rate() -> None:
    slowed = run(replace(FREE, solver=Solver(damping=3.0)), 30, 400)
    assert slowed.v[1] == pytest.approx(np.full(9, -9.81 / 3 * (1 - exp(-1.5))), rel=1e-6)


def test_a_spring_oscillates_at_its_frequency() -> None:
    """Each of the lower particles hangs on a spring of half the constant."""
    spring = replace(PAIR, forces=Forces(gravity=0.0))
    motion = Motion(spring, 200)
    mass = motion._model.mass[2:]
    motion.x[1, 2:] -= 0.1
    for _ in range(20):
        motion.step_frame()
    expected = -0.1 * np.cos(np.sqrt(5.0 / mass) * 20 * FRAME)
    assert motion.x[1, 2:] - motion._model.start[1, 2:] == pytest.approx(expected, abs=2e-6)


def test_spring_damping_damps_its_spring() -> None:
    """Amplitude e^(−ζωt) with 2ζω = τ·ω², at ω·√(1 − ζ²)."""
    tau = 0.05
    motion = Motion(replace(PAIR, forces=Forces(gravity=0.0), fabric=replace(THREAD, damping_time=tau)), 200)
    omega = np.sqrt(5.0 / motion._model.mass[2:])
    zeta = tau * omega / 2
    motion.x[1, 2:] -= 0.1
    for _ in range(15):
        motion.step_frame()
    t, slow = 15 * FRAME, omega * np.sqrt(1 - zeta**2)
    expected = -0.1 * np.exp(-zeta * omega * t) * (np.cos(slow * t) + zeta * omega / slow * np.sin(slow * t))
    assert motion.x[1, 2:] - motion._model.start[1, 2:] == pytest.approx(expected, abs=2e-6)


def test_a_pendulum_has_its_period() -> None:
    """A stiff pair of springs released at 30° takes a quarter of 2.040990 s to the lowest point."""
    stiff = replace(PAIR, cloth=replace(PAIR.cloth, rotation=(-30.0, 0.0, 0.0)), fabric=replace(THREAD, warp=4e5))
    motion = Motion(stiff, 200)
    before, frames = motion.x[2, 3] - motion.x[2, 0], 0
    while True:
        motion.step_frame()
        frames += 1
        now = motion.x[2, 3] - motion.x[2, 0]
        if now * before < 0:
            break
        before = now
    assert (frames - now / (now - before)) * FRAME == pytest.approx(2.040990 / 4, rel=2e-4)


def test_shortened_springs_resist_by_their_compression() -> None:
    pushed = Motion(replace(PAIR, fabric=replace(THREAD, compression=0.25), forces=Forces(gravity=0.0)), 1)
    pushed.x[1, 2:] += 0.1
    assert pushed._model.elastic_force(pushed.x)[1, 2:] == pytest.approx([-0.125, -0.125])
    assert pushed._model.elastic_force(pushed.x - np.outer([0, 0.2, 0], [0, 0, 1, 1]))[1, 2:] == pytest.approx(
        [0.5, 0.5]
    )


# -- air ---------------------------------------------------------------------------------------------


def wind_on_a_triangle(**changed: float) -> WindModel:
    """Return wind on one triangle of half a square meter."""
    values = {"gust": 0.0, "density": 1.2, "drag": 1.0, "lift": 1.0, **changed}
    return WindModel(np.array([[0], [1], [2]]), np.array([[3.0], [0.0], [4.0]]), phases=np.zeros(3), **values)


def test_drag_acts_along_the_wind_and_lift_across_it() -> None:
    """Wind of (3, 0, 4) m/s on a triangle normal to z: cos θ = 0.8, ½ρ·A·u² = 7.5 N."""
    x, rest = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]]), np.zeros((3, 3))
    drag = wind_on_a_triangle(lift=0.0).force(x, rest, 0.0)
    assert drag == pytest.approx(np.outer(7.5 * 0.64 * np.array([0.6, 0, 0.8]) / 3, np.ones(3)))
    lift = wind_on_a_triangle(drag=0.0).force(x, rest, 0.0)
    assert lift == pytest.approx(np.outer(7.5 * 0.8 * np.array([-0.8 * 0.6, 0, 1 - 0.64]) / 3, np.ones(3)))
    assert wind_on_a_triangle().force(x[:, ::-1], rest, 0.0) == pytest.approx(
        np.outer([0, 0, 7.5 * 0.8 / 3], np.ones(3))
    )
    assert not wind_on_a_triangle().force(x, np.tile([[3.0], [0.0], [4.0]], 3), 0.0).any()  # it moves with the wind


def test_gusts_are_three_parabolic_waves() -> None:
    assert parabolic_wave(np.array([0.0, 0.125, 0.25, 0.5, 0.75, 1.25])) == pytest.approx([0, -0.75, -1, 0, 1, -1])
    gusty = wind_on_a_triangle(gust=2.0).velocity(np.array([[1.0], [0.0], [0.0]]), 0.5)[:, 0]
    turns = np.array([0.31 - 0.215, 0.13 - 0.385, 0.23 - 0.16])
    assert gusty == pytest.approx([3, 0, 4] + 2.0 * np.array([0.6, 0.3, 1.0]) * parabolic_wave(turns))


def test_a_level_sheet_falls_to_its_terminal_speed() -> None:
    terminal = sqrt(2 * 0.2 * 9.81 / 1.225)
    falling = run(replace(FREE, wind=Wind()), 30, 200)
    mean = float(falling._model.mass @ falling.v[1]) / falling._model.mass.sum()
    assert mean == pytest.approx(-terminal * tanh(9.81 * 0.5 / terminal), rel=2e-3)


# -- contact -----------------------------------------------------------------------------------------


def on_slope(friction: float, **motion: object) -> Scene:
    """Return a sheet that lies on a slope of 30°."""
    slope = Plane(center=(0.0, 0.0, 0.0), rotation=(0.0, 0.0, 30.0), margin=0.02, friction=friction, **motion)  # type: ignore[arg-type]
    up = np.array([-0.5, sqrt(0.75), 0.0]) * 0.02
    cloth = replace(PATCH, center=tuple(up.tolist()), rotation=(-90.0, 0.0, 30.0))
    return replace(FREE, cloth=cloth, planes=(slope,))


@pytest.mark.parametrize("friction", [0.0, 0.2, 0.57])
def test_a_sheet_slides_down_a_slope(friction: float) -> None:
    down, rate = np.array([-sqrt(0.75), -0.5, 0.0]), 9.81 * (0.5 - friction * sqrt(0.75))
    slid = run(on_slope(friction), 30, 200)
    expected = np.outer(down, np.full(9, rate * 0.125))
    assert slid.x - slid._model.start == pytest.approx(expected, abs=2e-3 * rate * 0.125 + 2e-6)


def test_a_sheet_sticks_to_a_slope_and_moves_with_it() -> None:
    stuck = run(on_slope(0.6), 30)
    assert stuck.x == pytest.approx(stuck._model.start, abs=1e-6)
    carried = run(on_slope(5.0, keyframes=((0.0, 0, 0, 0), (10.0, 0, 0, 5.0))), 60)
    assert carried.v == pytest.approx(np.outer([0, 0, 0.5], np.ones(9)), abs=1e-6)


def test_a_sheet_comes_to_rest_on_the_margin() -> None:
    lying = run(replace(FREE, cloth=replace(PATCH, center=(0.0, 0.1, 0.0)), ground=Ground(height=0.05)), 60)
    assert lying.x[1] == pytest.approx(np.full(9, 0.07), abs=1e-9)
    assert np.abs(lying.v).max() < 1e-9


def test_reflection_returns_the_restitution_of_the_speed() -> None:
    """After a fall of 0.5 m, 0.25 of the speed gives 1/16 of the height, after √(2h/g)·1.25."""
    ball = Sphere(
        center=(0.0, -1000.0, 0.0), radius=999.5, margin=0.0, response="reflection", restitution=0.25, friction=0.0
    )
    bounced = Motion(replace(FREE, cloth=replace(PATCH, center=(0.0, 0.0, 0.0)), spheres=(ball,)), 400)
    highest = -1.0
    for frame in range(24):
        bounced.step_frame()
        if frame > 19:
            highest = max(highest, float(bounced.x[1].mean()))
    assert highest == pytest.approx(-0.5 + 0.5 / 16, abs=5e-3)


def test_repulsion_lets_a_sheet_sink_in_by_its_weight() -> None:
    floor = Ground(margin=0.02, response="repulsion", stiffness=1000.0)
    scene = replace(FREE, cloth=replace(PATCH, center=(0.0, 0.02, 0.0)), ground=floor, solver=Solver(damping=20.0))
    assert run(scene, 90).x[1] == pytest.approx(np.full(9, 0.02 - 0.2 * 9.81 / 1000), abs=1e-6)


def test_repulsion_does_not_act_above_the_margin() -> None:
    scene = replace(FREE, cloth=replace(PATCH, center=(0.0, 0.5, 0.0)))
    floor = Ground(margin=0.02, response="repulsion", stiffness=1000.0)
    assert np.array_equal(run(replace(scene, ground=floor), 10).x, run(scene, 10).x)


def test_a_box_pushes_particles_out_of_the_nearest_face() -> None:
    table = Box(center=(0.0, 0.5, 0.0), size=(1.0, 0.2, 1.0), margin=0.01, friction=0.0)
    lying = run(replace(FREE, cloth=replace(PATCH, center=(0.0, 0.65, 0.0)), boxes=(table,)), 40)
    assert lying.x[1] == pytest.approx(np.full(9, 0.61), abs=1e-9)


# -- attachments and tethers -------------------------------------------------------------------------


def test_attachments_move_as_their_keys_say() -> None:
    attachment = Attachment(
        pins=("left",),
        center=(0.0, 1.0, 0.0),
        oscillation=(0.0, 0.3, 0.0),
        period=(8.0, 0.5, 8.0),
        spin=(0.0, 90.0, 0.0),
    )
    held = Motion(replace(FREE, attachments=(attachment,)), 3)
    held.step_frame()
    height, turn = 0.3 * np.sin(4 * np.pi * FRAME), np.radians(1.5)
    start = held._model.start[:, ::3]
    expected = [np.cos(turn) * start[0] + np.sin(turn) * start[2], start[1] + height, None]
    assert held.x[0, ::3] == pytest.approx(expected[0])
    assert held.x[1, ::3] == pytest.approx(expected[1])
    assert held.x[2, ::3] == pytest.approx(np.cos(turn) * start[2] - np.sin(turn) * start[0])


def test_tethers_limit_the_distance_to_the_pin() -> None:
    soft = replace(PAIR, fabric=replace(THREAD, warp=0.01))
    tied = run(replace(soft, tethers=Tethers(slack=1.1)), 60)
    assert tied.x[1, 0] - tied.x[1, 2] == pytest.approx(1.1, abs=1e-9)
    assert abs(tied.v[1, 2]) < 1e-9


def test_the_strain_that_ends_a_comparison_is_measured() -> None:
    soft = replace(PAIR, strain_limit=StrainLimit(strain=0.01))
    assert run(soft, 5).strain > 0.01


def test_a_map_of_largest_distances_keeps_particles_near_their_start(tmp_path) -> None:
    (tmp_path / "reach.csv").write_text("\n".join(["0.5"] * 9))
    maps = Maps(max_distance="reach.csv", max_distance_max=0.2, folder=str(tmp_path))
    hung = run(replace(FREE, maps=maps), 60)
    assert hung.x - hung._model.start == pytest.approx(np.outer([0, -0.1, 0], np.ones(9)), abs=1e-9)


# -- convergence -------------------------------------------------------------------------------------


def test_halving_the_step_quarters_the_error() -> None:
    """With gusts, damping and spring damping."""
    scene = replace(
        FREE,
        cloth=replace(PATCH, pins=("top-left",)),
        fabric=replace(FREE.fabric, damping_time=0.01, bending_stiffness=1e-4),
        solver=Solver(damping=1.5),
        wind=Wind(x=2.0, z=1.0, turbulence=1.0),
    )
    coarse, fine, finest = (run(scene, 8, steps).x for steps in (40, 80, 160))
    assert np.linalg.norm(coarse - fine) / np.linalg.norm(fine - finest) == pytest.approx(4, rel=0.1)
