"""Kernels over fields: forces, relaxation and contact of a whole cloth."""

from dataclasses import replace

import numpy as np
import pytest
import taichi as ti
from serially import run_serially

from taichi_cloth import state
from taichi_cloth.contact.bodies import body_table
from taichi_cloth.contact.push_out import push_out
from taichi_cloth.kernels import controls as c
from taichi_cloth.kernels import springs
from taichi_cloth.kernels.forces import add_air, forget_forces, take_acceleration, wind_at
from taichi_cloth.mesh.topology import Topology, sheet
from taichi_cloth.scene.model import Box, Cloth, Ground, Scene, Solver, Sphere, Wind
from taichi_cloth.simulation import Simulation
from taichi_cloth.solvers import Stages
from taichi_cloth.view.fill import particle_normals

row = ti.types.ndarray(dtype=ti.f32, ndim=1)

H = 1 / 300
WINDY = Stages(wind=True)
CALM = Stages()
NONE = np.zeros((0, c.BODY_COLUMNS), np.float32)  # no collider


@ti.func
def gather_into_velocity(cloth: ti.template(), stages: ti.template(), now: ti.template()):
    forget_forces(cloth)
    add_air(cloth, stages, now, 0.0)
    for i in range(cloth.slot_count[None]):
        cloth.velocity[i] = take_acceleration(cloth, i, now.controls)


@ti.func
def limit_once(cloth: ti.template(), stages: ti.template(), now: ti.template()):
    springs.limit_strain(cloth, stages, now.controls, now.h)


@ti.kernel
def gust(x: float, y: float, z: float, controls: row, seconds: float) -> ti.math.vec3:
    return wind_at(ti.math.vec3(x, y, z), controls, seconds)


@ti.kernel
def relax_once(cloth: ti.template(), controls: row):
    ti.loop_config(serialize=True)
    for _ in range(1):
        springs.for_springs(cloth, CALM, springs.RELAX, controls, H)


def relax(cloth: state.ClothState, stiffness: float) -> None:
    controls = np.zeros(c.COUNT, np.float32)
    controls[c.STIFFNESS] = stiffness
    relax_once(cloth, controls)


STIFFNESS = (1.0, 1.0, 1.0, 1.0, 0.5, 0.5)  # of each of grid.DIRECTIONS


def gather(cloth: state.ClothState, stages: Stages, controls: np.ndarray, h: float) -> np.ndarray:
    """Accelerations by all external forces [m/s²]."""
    run_serially(gather_into_velocity, cloth, stages, 0, 1, h, -1, controls, NONE)
    return cloth.taken(cloth.velocity)


def flat(pins: tuple = (), stiffness: tuple = STIFFNESS, rows: int = 5, columns: int = 5) -> Topology:
    """A quarter of a metre between particles in the plane z = 0, 0.2 kg/m²: as a rule a metre square, 5 × 5."""
    return sheet(
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
    taken = []

    def make(topology: Topology, stiffness: tuple = STIFFNESS) -> state.ClothState:
        cloth = state.take(topology)
        cloth.upload(topology, np.array(stiffness)[topology.direction])
        taken.append(cloth)
        return cloth

    yield make
    for cloth in taken:
        state.give_back(cloth)


def wind(**values: float) -> np.ndarray:
    controls = np.zeros(c.COUNT, np.float32)
    controls[[c.DRAG, c.LIFT, c.HALF_AIR_DENSITY]] = 1.0, 1.0, 0.6
    for name, value in values.items():
        controls[getattr(c, name)] = value
    return controls


def test_gravity_pulls_every_particle_alike(cloth_of) -> None:
    cloth = cloth_of(flat())
    assert gather(cloth, CALM, wind(GRAVITY=9.81), H) == pytest.approx(np.tile([0, -9.81, 0], (25, 1)), rel=1e-6)


def test_the_force_of_face_on_wind_is_pressure_times_area(cloth_of) -> None:
    topology = flat()
    cloth = cloth_of(topology)
    acceleration = gather(cloth, WINDY, wind(WIND_Z=3.0), H)
    force = (acceleration * topology.mass[:, None]).sum(axis=0)
    assert force == pytest.approx([0, 0, 0.6 * 9.0], rel=1e-5)
    # Mass and pressure are both lumped by area, so that a free sheet stays flat in a steady wind.
    assert np.ptp(acceleration[:, 2]) < 1e-4


def test_edge_on_wind_does_nothing_to_a_flat_sheet(cloth_of) -> None:
    cloth = cloth_of(flat())
    assert np.abs(gather(cloth, WINDY, wind(WIND_X=30.0), H)).max() < 1e-3


def test_a_sheet_that_moves_with_the_wind_feels_none(cloth_of) -> None:
    topology = flat()
    cloth = cloth_of(topology)
    cloth.put(topology.start, topology.start - [0, 0, 3.0 * H], state.inverse_mass(topology))
    assert np.abs(gather(cloth, WINDY, wind(WIND_Z=3.0), H)).max() < 1e-3
    assert (gather(cloth, WINDY, wind(), H)[:, 2] < -10).all()


def test_a_storm_cannot_throw_a_light_sheet_back_beyond_the_winds_speed(cloth_of) -> None:
    topology = flat()
    cloth = cloth_of(topology)
    for speed in (10.0, 100.0, 1000.0):
        assert gather(cloth, WINDY, wind(WIND_Z=speed), H)[:, 2].max() * H <= speed * 1.01


def test_pins_are_not_pulled_by_wind(cloth_of) -> None:
    topology = flat(("top",))
    cloth = cloth_of(topology)
    assert (gather(cloth, WINDY, wind(WIND_Z=3.0), H)[topology.pinned, 2] == 0).all()


def test_gusts_stay_within_their_height_and_travel() -> None:
    controls = wind(GUST=2.0)
    random = np.random.default_rng(1)
    places = random.uniform(-5, 5, (200, 3))
    gusts = np.array([gust(*place, controls, 0.0) for place in places])
    assert np.abs(gusts).max() <= 2.0
    assert np.abs(gusts).max() > 1.0
    assert np.abs(gusts.mean(axis=0)).max() < 0.3
    later = np.array([gust(*place, controls, 1.0) for place in places])
    controls[c.GUST_TURNS : c.GUST_TURNS + 3] += c.GUST_RATES
    assert np.array([gust(*place, controls, 0.0) for place in places]) == pytest.approx(later, abs=1e-4)


@pytest.mark.parametrize("path", ["list", "lanes", "gather"])
def test_gusts_travel_within_a_frame(path: str) -> None:
    """In the second half of a frame they press as in the first half of a frame that begins then."""
    cloth = Cloth(rows=4, columns=18, width=4.0, height=1.0, center=(0.0, 0.0, 0.0), pins=())
    scene = Scene(cloth=cloth, wind=Wind(x=1.0, z=4.0, turbulence=0.5), solver=Solver("xpbd", substeps=2, iterations=1))
    with Simulation(scene, path) as simulation:
        now = simulation._input()
        later = replace(now, controls=now.controls.copy())
        later.controls[c.GUST_TURNS : c.GUST_TURNS + 3] += now.h * np.array(c.GUST_RATES)
        gained = []
        for frame, s in ((now, 0), (now, 1), (later, 0)):
            simulation.place(simulation.topology.start)
            simulation.solver.advance_frame(replace(frame, span=(s, s + 1)))
            gained.append(simulation.velocities())
    assert gained[1] == pytest.approx(gained[2], abs=1e-6)
    assert np.abs(gained[1] - gained[0]).max() > 1e-3


def test_a_sheet_at_rest_is_not_changed_by_relaxation(cloth_of) -> None:
    topology = flat()
    cloth = cloth_of(topology)
    for _ in range(50):
        relax(cloth, 1.0)
    assert cloth.taken(cloth.x) == pytest.approx(topology.start, abs=1e-6)


def test_relaxation_brings_a_stretched_sheet_back_and_keeps_its_middle(cloth_of) -> None:
    topology = flat()
    cloth = cloth_of(topology)
    cloth.put(topology.start * 1.2, topology.start, state.inverse_mass(topology))
    for _ in range(200):
        relax(cloth, 1.0)
    x = cloth.taken(cloth.x)
    lengths = np.linalg.norm(x[topology.ends[:, 0]] - x[topology.ends[:, 1]], axis=1)
    assert lengths == pytest.approx(topology.rest, rel=1e-3)
    assert np.average(x, axis=0, weights=topology.mass) == pytest.approx([0, 0, 0], abs=1e-5)


def test_a_family_is_relaxed_by_its_own_stiffness(cloth_of) -> None:
    soft = (0.25, 0.25, 0.0, 0.0, 0.0, 0.0)
    topology = sheet(
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
    cloth.put(topology.start * [2, 1, 1], topology.start, state.inverse_mass(topology))
    relax(cloth, 0.5)
    # Twice as wide: the error of 1 m, 0.25 · 0.5 of it put right, all of it at the free right edge.
    # The right edge's own spring keeps its length.
    assert cloth.taken(cloth.x)[[1, 3], 0] == pytest.approx([0.875, 0.875], abs=1e-6)


def limited(cloth: state.ClothState, topology: Topology, x: np.ndarray, sweeps: int, times: int = 1) -> np.ndarray:
    """The places after a limit of a tenth."""
    controls = wind()
    controls[c.MOST_STRAIN] = 0.1
    cloth.put(x, x, state.inverse_mass(topology))
    for _ in range(times):
        run_serially(limit_once, cloth, Stages(strain_limit=sweeps), 0, 1, H, -1, controls, NONE)
    return cloth.taken(cloth.x)


def strains(topology: Topology, x: np.ndarray) -> np.ndarray:
    return np.linalg.norm(x[topology.ends[:, 0]] - x[topology.ends[:, 1]], axis=1) / topology.rest - 1


def test_the_strain_limit_brings_long_springs_back_to_it_and_leaves_short_ones(cloth_of) -> None:
    topology = flat(("left",))
    cloth = cloth_of(topology)
    within = (topology.start * [1.09, 0.5, 1.0]).astype(np.float32)  # short springs are left as they are
    pulled = (topology.start + [0.5, 0.0, 0.0] * (topology.start[:, :1] > 0.4)).astype(np.float32)  # the last column
    for sweeps, times in ((1, 300), (12, 25)):
        assert (limited(cloth, topology, within, sweeps) == within).all()
        x = limited(cloth, topology, pulled, sweeps, times)
        assert (x[topology.pinned] == pulled[topology.pinned]).all()
        assert strains(topology, x).max() == pytest.approx(0.1, abs=1e-4)
        assert strains(topology, x).min() < 0.01


def test_the_strain_limit_in_many_sweeps_keeps_the_middle_and_is_over_relaxed(cloth_of) -> None:
    assert [springs.over_relaxation(n) for n in (1, 5, 37)] == [1.0, 1.5, 1.9]
    assert [springs.last_sweeps(n) for n in (1, 2, 4, 40)] == [1, 1, 1, 10]
    free = flat(())
    cloth = cloth_of(free)
    wide = (free.start * [1.5, 1.0, 1.0]).astype(np.float32)
    mass = free.mass[:, None]
    x = limited(cloth, free, wide, 12)
    assert (mass * x).sum(axis=0) == pytest.approx((mass * wide).sum(axis=0), abs=1e-5)

    threads = (0.0, 1.0, 0.0, 0.0, 0.0, 0.0)  # that hang
    hanging = flat(("top",), threads, rows=33, columns=2)
    cloth = cloth_of(hanging, threads)
    fallen = hanging.start * [1.0, 1.1, 1.0] - [0.0, 0.05, 0.0] * ~hanging.pinned[:, None]  # all of it, as it was
    one_by_one, at_once = (limited(cloth, hanging, fallen.astype(np.float32), *n) for n in ((1, 40), (40, 1)))
    assert strains(hanging, at_once).max() - 0.1 < (strains(hanging, one_by_one).max() - 0.1) / 4


def test_contact_pushes_free_particles_out_and_leaves_pins(cloth_of) -> None:
    topology = flat((12,))
    cloth = cloth_of(topology)
    ball = Sphere(center=(0.0, 0.0, 0.0), radius=0.3, margin=0.1, path=((0.0, 0.0, 0.0, 0.0), (1 / 60, 0.0, 0.0, 1.0)))
    block = Box(center=(0.5, 0.5, 0.0), size=(0.2, 0.2, 0.2), margin=0.02, friction=0.0)
    bodies = body_table([ball, block, Ground(height=-0.4, margin=0.0, friction=0.0)], 0.0, 1 / 60)
    stages = Stages(spheres=1, boxes=1, planes=1)
    run_serially(push_out, cloth, stages, 0, 5, H, -1, wind(), bodies)
    x = cloth.taken(cloth.x)
    assert (x[12] == topology.start[12]).all()
    free = np.delete(x, 12, axis=0)
    assert np.linalg.norm(free - [0, 0, 0.2], axis=1).min() >= 0.4 - 1e-5
    assert x[:, 1].min() == pytest.approx(-0.4)
    assert x[4] == pytest.approx([0.5, 0.38, 0]) or np.abs(x[4] - [0.5, 0.5, 0]).max() == pytest.approx(0.12)
    untouched = np.abs(x - topology.start).max(axis=1) == 0
    assert untouched.sum() >= 8


def test_friction_of_the_ground_holds_a_slow_slide(cloth_of) -> None:
    topology = flat()
    cloth = cloth_of(topology)
    lowered = topology.start - [0, 0.01, 0]
    cloth.put(lowered + [0.002, 0, 0], lowered, state.inverse_mass(topology))
    ground = body_table([Ground(height=-0.5, margin=0.0, friction=0.5)], 0.0, 1 / 60)
    run_serially(push_out, cloth, Stages(planes=1), 4, 5, H, -1, wind(), ground)
    x = cloth.taken(cloth.x)
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
    folded[right, 2], folded[right, 0] = folded[right, 0], 0.0  # the right half turned towards +z by a right angle
    cloth.put(folded, folded, state.inverse_mass(topology))
    particle_normals(cloth, normal)
    at_the_fold = normal.to_numpy()[12]
    assert at_the_fold == pytest.approx([-np.sqrt(0.5), 0, np.sqrt(0.5)], abs=0.02)
    assert normal.to_numpy()[14] == pytest.approx([-1, 0, 0], abs=1e-6)
