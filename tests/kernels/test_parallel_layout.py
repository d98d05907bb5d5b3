"""Kernels over fields: forces, relaxation and contact of a whole cloth."""

from dataclasses import replace

import numpy as np
import pytest
import taichi as ti
from serial_kernels import run_serially

from taichi_cloth import state
from taichi_cloth.collision.colliders import collider_counts, collider_table
from taichi_cloth.collision.response import resolve_contacts
from taichi_cloth.geometry.topology import Topology, build_sheet
from taichi_cloth.kernels import distance_limits, springs
from taichi_cloth.kernels import step_params as c
from taichi_cloth.kernels.forces import add_wind, clear_forces, consume_acceleration, wind_at
from taichi_cloth.render.shading import particle_normals
from taichi_cloth.scene.collider_schema import Box, Ground, Sphere
from taichi_cloth.scene.schema import Cloth, Scene, Solver, Wind
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.solvers import Features

CPU_THREADS = 2  # for the parallel layout

pytestmark = pytest.mark.bounds

row = ti.types.ndarray(dtype=ti.f32, ndim=1)

H = 1 / 300
WINDY = Features(wind=True)
CALM = Features()
NONE = np.zeros((0, c.COLLIDER_COLUMNS), np.float32)  # no collider


@ti.func
def gather_into_velocity(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    clear_forces(cloth)
    add_wind(cloth, features, ctx, 0.0)
    for i in range(cloth.packet_count[None]):
        cloth.velocity[i] = consume_acceleration(cloth, i, ctx.params)


@ti.func
def limit_once(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    distance_limits.limit_strain(cloth, features, ctx.params, ctx.h)


@ti.kernel
def gust(x: float, y: float, z: float, params: row, seconds: float) -> ti.math.vec3:
    return wind_at(ti.math.vec3(x, y, z), params, seconds)


@ti.kernel
def relax_once(cloth: ti.template(), params: row):
    ti.loop_config(serialize=True)
    for _ in range(1):
        springs.for_each_spring(cloth, CALM, springs.DISTANCE, params, H)


def relax(cloth: state.ClothState, stiffness: float) -> None:
    params = np.zeros(c.PARAM_COUNT, np.float32)
    params[c.STIFFNESS_FACTOR] = stiffness
    relax_once(cloth, params)


STIFFNESS = (1.0, 1.0, 1.0, 1.0, 0.5, 0.5)  # of each of grid.DIRECTIONS


def gather(cloth: state.ClothState, features: Features, params: np.ndarray, h: float) -> np.ndarray:
    """Return the accelerations by all external forces [m/s²]."""
    run_serially(gather_into_velocity, cloth, features, 0, 1, h, -1, params, NONE)
    return cloth.to_numpy(cloth.velocity)


def flat(pins: tuple = (), stiffness: tuple = STIFFNESS, rows: int = 5, columns: int = 5) -> Topology:
    """Return a sheet of 0.2 kg/m² in the plane z = 0 with 0.25 m between particles: by default 5 × 5, 1 m wide."""
    return build_sheet(
        rows=rows,
        columns=columns,
        width=(columns - 1) / 4,
        height=(rows - 1) / 4,
        center=(0.0, 0.0, 0.0),
        rotation=(0.0, 0.0, 0.0),
        area_density=0.2,
        pins=pins,
        directions=[k > 0 for k in stiffness],
    )


@pytest.fixture
def cloth_of():
    acquired = []

    def make(topology: Topology, stiffness: tuple = STIFFNESS) -> state.ClothState:
        cloth = state.acquire_state(topology)
        cloth.upload(topology, np.array(stiffness)[topology.direction])
        acquired.append(cloth)
        return cloth

    yield make
    for cloth in acquired:
        state.release_state(cloth)


def wind(**values: float) -> np.ndarray:
    params = np.zeros(c.PARAM_COUNT, np.float32)
    params[[c.DRAG, c.LIFT, c.HALF_AIR_DENSITY]] = 1.0, 1.0, 0.6
    for name, value in values.items():
        params[getattr(c, name)] = value
    return params


def test_gravity_accelerates_all_particles_equally(cloth_of) -> None:
    cloth = cloth_of(flat())
    assert gather(cloth, CALM, wind(GRAVITY=9.81), H) == pytest.approx(np.tile([0, -9.81, 0], (25, 1)), rel=1e-6)


def test_the_force_of_perpendicular_wind_is_pressure_times_area(cloth_of) -> None:
    topology = flat()
    cloth = cloth_of(topology)
    acceleration = gather(cloth, WINDY, wind(WIND_Z=3.0), H)
    force = (acceleration * topology.mass[:, None]).sum(axis=0)
    assert force == pytest.approx([0, 0, 0.6 * 9.0], rel=1e-5)
    # Mass and pressure are both lumped by area, so a free sheet stays flat in a steady wind.
    assert np.ptp(acceleration[:, 2]) < 1e-4


def test_parallel_wind_exerts_no_force_on_a_flat_sheet(cloth_of) -> None:
    cloth = cloth_of(flat())
    assert np.abs(gather(cloth, WINDY, wind(WIND_X=30.0), H)).max() < 1e-3


def test_wind_exerts_no_force_on_a_sheet_at_wind_speed(cloth_of) -> None:
    topology = flat()
    cloth = cloth_of(topology)
    cloth.upload_positions(topology.start, topology.start - [0, 0, 3.0 * H], state.inverse_mass(topology))
    assert np.abs(gather(cloth, WINDY, wind(WIND_Z=3.0), H)).max() < 1e-3
    assert (gather(cloth, WINDY, wind(), H)[:, 2] < -10).all()


def test_wind_cannot_accelerate_a_light_sheet_beyond_its_speed(cloth_of) -> None:
    topology = flat()
    cloth = cloth_of(topology)
    for speed in (10.0, 100.0, 1000.0):
        assert gather(cloth, WINDY, wind(WIND_Z=speed), H)[:, 2].max() * H <= speed * 1.01


def test_wind_does_not_accelerate_pins(cloth_of) -> None:
    topology = flat(("top",))
    cloth = cloth_of(topology)
    assert (gather(cloth, WINDY, wind(WIND_Z=3.0), H)[topology.pinned, 2] == 0).all()


def test_gusts_stay_within_their_amplitude_and_travel() -> None:
    params = wind(GUST_SPEED=2.0)
    random = np.random.default_rng(1)
    points = random.uniform(-5, 5, (200, 3))
    gusts = np.array([gust(*point, params, 0.0) for point in points])
    assert np.abs(gusts).max() <= 2.0
    assert np.abs(gusts).max() > 1.0
    assert np.abs(gusts.mean(axis=0)).max() < 0.3
    later = np.array([gust(*point, params, 1.0) for point in points])
    params[c.GUST_PHASE : c.GUST_PHASE + 3] += c.GUST_FREQUENCIES
    assert np.array([gust(*point, params, 0.0) for point in points]) == pytest.approx(later, abs=1e-4)


@pytest.mark.parametrize("layout", ["serial", "simd", "parallel"])
def test_gusts_travel_within_a_frame(layout: str) -> None:
    """In the second half of a frame they act as in the first half of a frame that starts then."""
    cloth = Cloth(rows=4, columns=18, width=4.0, height=1.0, center=(0.0, 0.0, 0.0), pins=())
    scene = Scene(cloth=cloth, wind=Wind(x=1.0, z=4.0, turbulence=0.5), solver=Solver("xpbd", substeps=2, iterations=1))
    with Simulation(scene, layout) as simulation:
        now = simulation._frame_input()
        later = replace(now, params=now.params.copy())
        later.params[c.GUST_PHASE : c.GUST_PHASE + 3] += now.h * np.array(c.GUST_FREQUENCIES)
        gained = []
        for frame, s in ((now, 0), (now, 1), (later, 0)):
            simulation.set_state(simulation.topology.start)
            simulation.solver.step(replace(frame, span=(s, s + 1)))
            gained.append(simulation.velocities())
    assert gained[1] == pytest.approx(gained[2], abs=1e-6)
    assert np.abs(gained[1] - gained[0]).max() > 1e-3


def test_relaxation_does_not_change_a_sheet_at_rest(cloth_of) -> None:
    topology = flat()
    cloth = cloth_of(topology)
    for _ in range(50):
        relax(cloth, 1.0)
    assert cloth.to_numpy(cloth.x) == pytest.approx(topology.start, abs=1e-6)


def test_relaxation_restores_a_stretched_sheet_and_keeps_its_center_of_mass(cloth_of) -> None:
    topology = flat()
    cloth = cloth_of(topology)
    cloth.upload_positions(topology.start * 1.2, topology.start, state.inverse_mass(topology))
    for _ in range(200):
        relax(cloth, 1.0)
    x = cloth.to_numpy(cloth.x)
    lengths = np.linalg.norm(x[topology.ends[:, 0]] - x[topology.ends[:, 1]], axis=1)
    assert lengths == pytest.approx(topology.rest, rel=1e-3)
    assert np.average(x, axis=0, weights=topology.mass) == pytest.approx([0, 0, 0], abs=1e-5)


def test_each_spring_family_has_its_own_stiffness(cloth_of) -> None:
    soft = (0.25, 0.25, 0.0, 0.0, 0.0, 0.0)
    topology = build_sheet(
        rows=2,
        columns=2,
        width=1.0,
        height=1.0,
        center=(0.0, 0.0, 0.0),
        rotation=(0.0, 0.0, 0.0),
        area_density=1.0,
        pins=("left",),
        directions=[k > 0 for k in soft],
    )
    cloth = cloth_of(topology, soft)
    cloth.upload_positions(topology.start * [2, 1, 1], topology.start, state.inverse_mass(topology))
    relax(cloth, 0.5)
    # Twice as wide: 0.25 · 0.5 of the error of 1 m is corrected, all at the free right edge. The spring of the right
    # edge keeps its length.
    assert cloth.to_numpy(cloth.x)[[1, 3], 0] == pytest.approx([0.875, 0.875], abs=1e-6)


def limited(cloth: state.ClothState, topology: Topology, x: np.ndarray, iterations: int, times: int = 1) -> np.ndarray:
    """Return the positions after a strain limit of 0.1."""
    params = wind()
    params[c.STRAIN_LIMIT] = 0.1
    cloth.upload_positions(x, x, state.inverse_mass(topology))
    for _ in range(times):
        run_serially(limit_once, cloth, Features(strain_limit=iterations), 0, 1, H, -1, params, NONE)
    return cloth.to_numpy(cloth.x)


def strains(topology: Topology, x: np.ndarray) -> np.ndarray:
    return np.linalg.norm(x[topology.ends[:, 0]] - x[topology.ends[:, 1]], axis=1) / topology.rest - 1


def test_the_strain_limit_shortens_long_springs_and_ignores_short_ones(cloth_of) -> None:
    topology = flat(("left",))
    cloth = cloth_of(topology)
    within = (topology.start * [1.09, 0.5, 1.0]).astype(np.float32)  # shortened springs are not changed
    pulled = (topology.start + [0.5, 0.0, 0.0] * (topology.start[:, :1] > 0.4)).astype(np.float32)  # the last column
    for iterations, times in ((1, 300), (12, 25)):
        assert (limited(cloth, topology, within, iterations) == within).all()
        x = limited(cloth, topology, pulled, iterations, times)
        assert (x[topology.pinned] == pulled[topology.pinned]).all()
        assert strains(topology, x).max() == pytest.approx(0.1, abs=1e-4)
        assert strains(topology, x).min() < 0.01


def test_the_strain_limit_keeps_the_center_of_mass_and_is_over_relaxed(cloth_of) -> None:
    assert [distance_limits.over_relaxation(n) for n in (1, 5, 37)] == [1.0, 1.5, 1.9]
    assert [distance_limits.final_iterations(n) for n in (1, 2, 4, 40)] == [1, 1, 1, 10]
    free = flat(())
    cloth = cloth_of(free)
    wide = (free.start * [1.5, 1.0, 1.0]).astype(np.float32)
    mass = free.mass[:, None]
    x = limited(cloth, free, wide, 12)
    assert (mass * x).sum(axis=0) == pytest.approx((mass * wide).sum(axis=0), abs=1e-5)

    threads = (0.0, 1.0, 0.0, 0.0, 0.0, 0.0)  # hanging
    hanging = flat(("top",), threads, rows=33, columns=2)
    cloth = cloth_of(hanging, threads)
    # All free particles are lowered, and stretched evenly.
    fallen = hanging.start * [1.0, 1.1, 1.0] - [0.0, 0.05, 0.0] * ~hanging.pinned[:, None]
    one_by_one, at_once = (limited(cloth, hanging, fallen.astype(np.float32), *n) for n in ((1, 40), (40, 1)))
    assert strains(hanging, at_once).max() - 0.1 < (strains(hanging, one_by_one).max() - 0.1) / 4


def test_contact_moves_free_particles_out_but_not_pins(cloth_of) -> None:
    topology = flat((12,))
    cloth = cloth_of(topology)
    sphere = Sphere(
        center=(0.0, 0.0, 0.0),
        radius=0.3,
        margin=0.1,
        keyframes=((0.0, 0.0, 0.0, 0.0), (1 / 60, 0.0, 0.0, 1.0)),
        friction=0.0,
    )
    box = Box(center=(0.5, 0.5, 0.0), size=(0.2, 0.2, 0.2), margin=0.02, friction=0.0)
    colliders = collider_table([sphere, box, Ground(height=-0.4, margin=0.0, friction=0.0)], 0.0, 1 / 60)
    features = Features(colliders=collider_counts([sphere, box, Ground()]))
    run_serially(resolve_contacts, cloth, features, 0, 5, H, -1, wind(), colliders)
    x = cloth.to_numpy(cloth.x)
    assert (x[12] == topology.start[12]).all()
    free = np.delete(x, 12, axis=0)
    assert np.linalg.norm(free - [0, 0, 0.2], axis=1).min() >= 0.4 - 1e-5
    assert x[:, 1].min() == pytest.approx(-0.4)
    assert x[4] == pytest.approx([0.5, 0.38, 0]) or np.abs(x[4] - [0.5, 0.5, 0]).max() == pytest.approx(0.12)
    untouched = np.abs(x - topology.start).max(axis=1) == 0
    assert untouched.sum() >= 8


def test_ground_friction_stops_a_slow_slide(cloth_of) -> None:
    topology = flat()
    cloth = cloth_of(topology)
    lowered = topology.start - [0, 0.01, 0]
    cloth.upload_positions(lowered + [0.002, 0, 0], lowered, state.inverse_mass(topology))
    ground = collider_table([Ground(height=-0.5, margin=0.0, friction=0.5)], 0.0, 1 / 60)
    run_serially(resolve_contacts, cloth, Features(colliders=collider_counts([Ground()])), 4, 5, H, -1, wind(), ground)
    x = cloth.to_numpy(cloth.x)
    assert x[20:, 0] == pytest.approx(lowered[20:, 0], abs=1e-6)  # 0.002 < 0.5 · 0.01: it sticks
    assert x[:5, 0] == pytest.approx(lowered[:5, 0] + 0.002, abs=1e-6)


def test_normals_of_a_flat_and_of_a_folded_sheet(cloth_of) -> None:
    topology = flat()
    cloth = cloth_of(topology)
    normal = ti.Vector.field(3, ti.f32, 32)
    particle_normals(cloth, normal)
    assert normal.to_numpy()[:25] == pytest.approx(np.tile([0, 0, 1.0], (25, 1)), abs=1e-6)
    folded = topology.start.copy()
    right = folded[:, 0] > 0
    folded[right, 2], folded[right, 0] = folded[right, 0], 0.0  # the right half folded toward +z by 90°
    cloth.upload_positions(folded, folded, state.inverse_mass(topology))
    particle_normals(cloth, normal)
    at_the_fold = normal.to_numpy()[12]
    assert at_the_fold == pytest.approx([-np.sqrt(0.5), 0, np.sqrt(0.5)], abs=0.02)
    assert normal.to_numpy()[14] == pytest.approx([-1, 0, 0], abs=1e-6)
