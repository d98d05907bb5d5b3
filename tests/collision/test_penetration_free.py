"""Penetration-free self-contact: no edge passes through a triangle, counted after each substep with exact signs."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from taichi_cloth.geometry.cloth_builder import attachment_ids
from taichi_cloth.geometry.intersections import find_intersections
from taichi_cloth.geometry.scene_loader import load_scene
from taichi_cloth.geometry.spring_model import Floats
from taichi_cloth.scene import SceneError
from taichi_cloth.scene.collider_schema import Attachment, Ground, Sphere
from taichi_cloth.scene.fabric_schema import Fabric
from taichi_cloth.scene.schema import (
    SOLVER_NAMES,
    Cloth,
    Forces,
    Region,
    Scene,
    SelfCollision,
    Solver,
    Tearing,
    Tethers,
)
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.system.errors import UsageError

THICKNESS = 0.004
GUARD = SelfCollision(thickness=THICKNESS, penetration_free=True)
SHEETS = Scene(
    cloth=Cloth(rows=9, columns=9, width=0.3, height=0.3, center=(0.0, 0.3, 0.0), rotation=(-80.0, 10.0, 0.0), pins=()),
    fabric=Fabric(warp=30.0, weft=30.0, shear=10.0, bend_spring=0.3),
    self_collision=GUARD,
    ground=Ground(),
)
LAYERS = replace(SHEETS, cloth=replace(SHEETS.cloth, layers=2, layer_spacing=0.02, layer_rotation=9.0))


def with_solver(scene: Scene, name: str) -> Scene:
    substeps = {"verlet": 6, "xpbd": 8, "lines": 4, "implicit": 4}.get(name, 1)  # explicit methods take what they need
    return replace(scene, solver=Solver(name=name, substeps=substeps, iterations=4))


def count(simulation: Simulation) -> int:
    topology = simulation.topology
    return len(find_intersections(simulation.positions() - topology.origin, topology.edges, topology.triangles))


def most_intersections(simulation: Simulation, frames: int, act: Callable[[int], object] = lambda _: None) -> int:
    """Return the most intersections after any substep. `act` is called before each frame, with its number."""
    found = []
    for frame in range(frames):
        act(frame)
        simulation.step_by_substep(lambda _: found.append(count(simulation)))
    assert np.isfinite(simulation.positions()).all()
    return max(found)


def yanks(simulation: Simulation, size: float) -> Callable[[int], None]:
    """Return a function that pulls two patches at random, up to `size` [m] a frame along each axis."""
    random, grabs = np.random.default_rng(1), []

    def act(frame: int) -> None:
        if frame % 5 == 0:
            while grabs:
                grabs.pop().release()
            for particle in random.choice(simulation.topology.particle_count, 2, replace=False):
                if particle not in simulation.grabbed:
                    grabs.append(simulation.grab(int(particle), radius=0.03))
        for grab in grabs:
            grab.move_to(simulation.positions()[grab.particles[0]] + random.uniform(-size, size, 3))

    return act


# The contact of all solvers is the same code in a layout, and takes ten seconds to compile for each.
SOLVERS_IN_LAYOUTS = [*((solver, "simd") for solver in SOLVER_NAMES), ("verlet", "serial"), ("implicit", "parallel")]


@pytest.mark.parametrize(("solver", "layout"), SOLVERS_IN_LAYOUTS)
def test_nothing_intersects_while_patches_are_yanked(solver: str, layout: str) -> None:
    scene = SHEETS if layout == "simd" else LAYERS
    with Simulation(with_solver(scene, solver), layout) as simulation:
        assert most_intersections(simulation, 10, yanks(simulation, 0.08)) == 0
        data = simulation.solver.layout.pair_data
        assert data is not None
        assert data.pairs.length[None] > 0


def test_without_the_guarantee_the_same_yanks_do_intersect() -> None:
    triangles = SelfCollision(thickness=THICKNESS, primitives="triangles")
    for contact in (None, triangles):
        scene = replace(with_solver(LAYERS, "verlet"), self_collision=contact)
        with Simulation(scene, "serial") as simulation:
            assert most_intersections(simulation, 10, yanks(simulation, 0.08)) > 0


@pytest.mark.parametrize("solver", ["verlet", "implicit"])
def test_a_sheet_thrown_at_100_meters_per_second_stays_on_its_side(solver: str) -> None:
    """Its corner moves by up to 0.4 m in a substep, towards a pinned sheet 0.1 m away."""
    cloth = replace(LAYERS.cloth, rotation=(0.0, 0.0, 0.0), layer_spacing=0.1, layer_rotation=20.0, pins=("top",))
    scene = replace(with_solver(LAYERS, solver), cloth=cloth, ground=None)
    with Simulation(scene, "serial") as simulation:
        half = simulation.topology.particle_count // 2
        velocities = np.zeros((2 * half, 3))
        velocities[half:, 2] = -100.0
        velocities[simulation.topology.pinned] = 0.0
        simulation.set_state(simulation.positions(), velocities)
        assert most_intersections(simulation, 12) == 0


def test_motion_is_unchanged_to_the_bit_where_nothing_is_near() -> None:
    for layout in ("serial", "simd"):
        scene = with_solver(replace(SHEETS, ground=None, cloth=replace(SHEETS.cloth, pins=("top",))), "xpbd")
        with Simulation(scene, layout) as guarded, Simulation(replace(scene, self_collision=None), layout) as free:
            for simulation in (guarded, free):
                simulation.step(20)
            assert np.array_equal(guarded.positions(), free.positions())
            assert np.array_equal(guarded.velocities(), free.velocities())


def test_attachments_that_are_driven_through_cloth_lag_behind() -> None:
    """The upper sheet hangs by one edge that goes down through the lower sheet, which is held on all sides."""
    cloth = replace(LAYERS.cloth, rotation=(-90.0, 0.0, 0.0), layer_rotation=0.0, layer_spacing=0.03)
    keyframes = ((0.0, 0.0, 0.0, 0.0), (0.3, 0.0, -0.1, 0.0))
    edge = Region(name="edge", min=(-1.0, 0.32, -1.0), max=(1.0, 0.34, -0.14))
    held = [
        Region(name="left", min=(-1.0, 0.29, -1.0), max=(-0.14, 0.31, 1.0)),
        Region(name="right", min=(0.14, 0.29, -1.0), max=(1.0, 0.31, 1.0)),
    ]
    scene = replace(
        with_solver(LAYERS, "xpbd"),
        cloth=replace(cloth, pins=("region:left", "region:right")),
        regions=(edge, *held),
        attachments=(Attachment(pins=("region:edge",), keyframes=keyframes),),
        ground=None,
    )
    with Simulation(scene, "serial") as simulation:
        assert most_intersections(simulation, 24) == 0
        simulation.step(10)
        held_back = (attachment_ids(scene, simulation.topology) >= 0) & (simulation.positions()[:, 1] > 0.29)
        assert held_back.sum() == 4  # the ends of the edge, which is led to 0.23
        speed = np.linalg.norm(simulation.velocities()[held_back], axis=1)
        assert speed.max() < 0.1  # [m/s] of its motion: its lag in a substep would be 30


@pytest.mark.long
def test_a_sheet_that_is_pulled_to_thirty_times_its_length_does_not_intersect() -> None:
    """Its triangles become slivers, whose nearest points float32 does not find."""
    with Simulation(load_scene("towel")) as simulation:
        for name in ("gravity", "stiffness", "damping"):
            simulation.params[name] = 0.0
        simulation.params["self_collision_thickness"] = 0.005
        random = np.random.default_rng(5)
        grab = simulation.grab(47)

        def pull(frame: int) -> None:
            if frame % 3 == 0:
                grab.move_to(random.uniform(-8.0, 8.0, 3))

        for frame in range(18):
            pull(frame)
            simulation.step()
        assert most_intersections(simulation, 6, pull) == 0
        assert simulation.metrics().mean_strain > 30


def test_the_towel_is_folded_in_four_without_an_intersection() -> None:
    with Simulation(load_scene("towel")) as simulation:
        for _ in range(18):
            simulation.step(20)
            assert count(simulation) == 0
        corners = simulation.positions()[[0, 24, 600, 624]]
        assert np.linalg.norm(np.ptp(corners, axis=0)) < 0.1  # the sides of the towel have 0.6 m
        assert simulation.metrics().max_strain < 0.15


def test_the_knot_is_drawn_tight_and_holds() -> None:
    """A ribbon whose knot had come undone would hang 0.4 m below the hands: it is 0.29 m longer than their distance."""
    with Simulation(load_scene("knot")) as simulation:
        hands = simulation.topology.pinned
        for frame in range(320):
            simulation.step()
            if frame % 20 == 0:
                assert count(simulation) == 0
        x = simulation.positions()
        assert count(simulation) == 0
        assert np.ptp(x[hands, 0]) == pytest.approx(1.32, abs=0.01)
        assert x[hands, 1].mean() - x[:, 1].min() < 0.2
        assert simulation.metrics().max_strain < 0.25


def test_tearing_tethers_and_a_moving_sphere() -> None:
    ball = Sphere(
        center=(0.0, 0.6, 0.0),
        radius=0.08,
        keyframes=((0.0, 0, 0, 0), (0.1, 0, -0.45, 0), (0.2, 0, 0, 0)),
        margin=0.15,
        friction=0.0,
    )
    torn = replace(with_solver(LAYERS, "verlet"), tearing=Tearing(strain=0.3), spheres=(ball,))
    limited = replace(with_solver(SHEETS, "xpbd"), tethers=Tethers(), spheres=(ball,))
    limited = replace(limited, cloth=replace(limited.cloth, pins=("top-left",)))
    with Simulation(torn, "serial") as simulation:
        assert most_intersections(simulation, 16, yanks(simulation, 0.1)) == 0
        assert simulation.torn.any()
    with Simulation(limited, "simd") as simulation:
        assert most_intersections(simulation, 12) == 0


# -- the start ---------------------------------------------------------------------------------------------------------


def crossing(positions: Floats, count: int) -> Floats:
    """Return positions of two layers of which the second passes through the first."""
    x = positions.copy()
    x[count // 2 :, 1] += np.linspace(-0.05, 0.05, count - count // 2)
    return x


def test_a_start_that_intersects_is_refused_with_the_places() -> None:
    with Simulation(with_solver(LAYERS, "verlet")) as simulation:
        before = simulation.positions()
        x = crossing(before, len(before))
        with pytest.raises(
            ValueError, match=r"positions with intersections.*: \d+ edges pass through triangles, near \("
        ) as refused:
            simulation.set_state(x)
        places = re.findall(r"\([^)]*\)", str(refused.value))
        assert len(places) == len(set(places)) == 3
        assert np.array_equal(simulation.positions(), before)
        assert simulation.penetration_free_since == 0


def test_untangle_lets_parts_come_apart_and_tells_when() -> None:
    scene = replace(LAYERS, self_collision=replace(GUARD, untangle=True), forces=Forces(gravity=0.0), ground=None)
    with Simulation(with_solver(scene, "verlet"), "serial") as simulation:
        x = simulation.positions()
        mixed = crossing(x, len(x))
        velocities = np.zeros_like(x)
        velocities[len(x) // 2 :, 1] = 2.0
        simulation.set_state(mixed, velocities)
        assert simulation.penetration_free_since is None
        for _ in range(40):
            simulation.step()
        since = simulation.penetration_free_since
        assert since is not None
        assert 0 < since <= 40
        assert count(simulation) == 0


def test_static_friction_of_particles_is_refused() -> None:
    with pytest.raises(SceneError, match="static_friction: does not go with penetration_free"):
        load_scene("fold", self_collision={"penetration_free": True, "static_friction": True})


def test_layers_without_a_distance_are_refused() -> None:
    """Nothing says which of them is above."""
    with pytest.raises(
        SceneError, match=r"cloth\.layer_spacing: must be greater than 0: self_collision\.penetration_free"
    ):
        load_scene("stack", self_collision={"penetration_free": True, "static_friction": False}, layer_spacing=0.0)


def test_a_thickness_much_greater_than_the_cells_is_refused() -> None:
    """The list of near pairs would be full, and nothing could move."""
    side = 0.3 / 15
    held_still = "penetration-free contact holds the cloth still: more pairs are near than it can list"
    sheet = replace(SHEETS, cloth=replace(SHEETS.cloth, rows=16, columns=16))
    with pytest.raises(
        UsageError, match=r"thickness must be at most 1\.5 × the median edge of 0\.02 m .* got 0\.03002"
    ):
        Simulation(replace(sheet, self_collision=replace(GUARD, thickness=1.501 * side)))
    with Simulation(replace(sheet, self_collision=replace(GUARD, thickness=1.499 * side))) as simulation:
        before = simulation.positions()
        simulation.step(2)
        assert held_still not in simulation.warnings
        assert (simulation.positions() != before).any()
        simulation.params["self_collision_thickness"] = 4 * side
        simulation.step(2)
        held = simulation.positions()
        simulation.step()
        assert (simulation.positions() == held).all()
        assert held_still in simulation.warnings


# -- physics of contact ------------------------------------------------------------------------------------------------

SLOPE = np.radians(20.0)


def sheet_on_a_slope(friction: float, solver: str) -> Simulation:
    """Return a free sheet that lies at the thickness on one that is pinned everywhere."""
    cloth = replace(LAYERS.cloth, rotation=(-70.0, 0.0, 0.0), layer_rotation=0.0, layer_spacing=THICKNESS)
    scene = replace(
        LAYERS,
        cloth=replace(cloth, pins=tuple(range(81))),
        solver=Solver(name=solver, substeps=8, iterations=4, damping=0.0),
        self_collision=replace(GUARD, friction=friction),
        ground=None,
    )
    return Simulation(scene, "serial")


@pytest.mark.parametrize("solver", ["xpbd", "verlet"])
def test_a_sheet_slides_down_another_by_coulombs_law(solver: str) -> None:
    """μ = 0.5 is more than tan 20° = 0.36: it sticks. With μ = 0.2 it slides by ½·g·(sin − μ·cos)·t²."""
    down = np.array([0.0, -np.sin(SLOPE), np.cos(SLOPE)])
    upward = np.array([0.0, np.cos(SLOPE), np.sin(SLOPE)])
    slid = {}
    for friction in (0.5, 0.2):
        with sheet_on_a_slope(friction, solver) as simulation:
            start = simulation.positions()
            simulation.step(20)
            motion = (simulation.positions() - start)[81:]
            slid[friction] = float((motion @ down).mean())
            assert np.abs(motion @ upward).max() < 0.05 * THICKNESS or friction == 0.2
    seconds = 20 / 60
    assert slid[0.2] == pytest.approx(0.5 * 9.81 * (np.sin(SLOPE) - 0.2 * np.cos(SLOPE)) * seconds**2, rel=0.03)
    assert slid[0.5] < 0.0005


def test_contact_adds_no_energy_and_nothing_sticks() -> None:
    """A sheet that falls on another loses energy; pulled off, it leaves without a force."""
    with sheet_on_a_slope(0.0, "xpbd") as simulation:
        x = simulation.positions()
        x[81:] += 0.03 * np.array([0.0, np.cos(SLOPE), np.sin(SLOPE)])
        simulation.set_state(x)
        energies = []
        for _ in range(18):
            simulation.step()
            metrics = simulation.metrics()
            energies.append(metrics.kinetic_energy + metrics.potential_energy)
        mass = simulation.topology.mass[81:].sum()
        assert max(energies) - energies[0] < 0.01 * mass * 9.81 * 0.03
        away = 0.5 * np.array([0.0, np.cos(SLOPE), np.sin(SLOPE)])
        velocities = np.zeros_like(x)
        velocities[81:] = away
        simulation.set_state(simulation.positions(), velocities)
        simulation.step()
        expected = away - [0.0, 9.81 / 60, 0.0]
        assert simulation.velocities()[81:].mean(axis=0) == pytest.approx(expected, abs=0.01)


def sliding_between_layers(contact: SelfCollision, speed: float) -> Floats:
    """Return the velocities along a layer that slides on a pinned one, in a frame, (substeps, particles) [m/s]."""
    cloth = Cloth(
        **{"rows": 7, "columns": 7, "width": 0.06, "height": 0.06, "rotation": (-90.0, 0.0, 0.0)},
        **{"pins": tuple(range(49, 98)), "layers": 2, "layer_spacing": 0.95 * THICKNESS},
    )
    scene = Scene(
        cloth=cloth,
        fabric=Fabric(warp=1e-3, weft=1e-3, shear=1e-3, bend_spring=0.0),
        forces=Forces(gravity=0.0),
        solver=Solver(name="explicit", substeps=4, iterations=1, damping=0.0),
        self_collision=replace(contact, friction=0.5),
    )
    with Simulation(scene) as simulation:
        x, v = simulation.positions(), np.zeros((98, 3))
        v[:49, 0] = speed
        v[:49, 1] = 0.02 if x[49, 1] > x[0, 1] else -0.02  # towards the pinned layer
        v[24, 1] *= 10.0
        simulation.set_state(x, v)
        sliding: list[Floats] = []
        simulation.step_by_substep(lambda _: sliding.append(simulation.velocities()[:49, 0]))
    return np.array(sliding)


@pytest.mark.parametrize("speed", [0.01, 0.03, 0.1])
def test_friction_between_layers_stops_sliding_and_never_reverses_it(speed: float) -> None:
    sliding = sliding_between_layers(GUARD, speed)
    assert np.min(sliding) > -0.005 * speed
    assert np.max(sliding) < 0.7 * speed


@pytest.mark.parametrize("speed", [0.003, 0.01])
def test_friction_of_discrete_contact_never_reverses_sliding(speed: float) -> None:
    """A particle has many contacts, most of them less deep than one: each alone could stop it."""
    sliding = sliding_between_layers(SelfCollision(thickness=THICKNESS, primitives="triangles"), speed)
    assert np.min(sliding) > 0.0
    assert np.max(sliding[-1]) < 0.8 * speed


@pytest.mark.parametrize("penetration_free", [True, False])
def test_a_layer_slides_on_another_with_coulomb_friction(penetration_free: bool) -> None:
    """It stops after v/(μg) = 2.4 frames. A substep of 56 µs presses it g·h² = 0.03 µm into the other."""
    contact = replace(GUARD, friction=0.5, primitives="triangles", penetration_free=penetration_free)
    cloth = Cloth(
        **{"rows": 7, "columns": 7, "width": 0.06, "height": 0.06, "rotation": (-90.0, 0.0, 0.0)},
        **{"pins": tuple(range(49)), "layers": 2, "layer_spacing": 1.01 * THICKNESS},
    )
    scene = Scene(
        cloth=cloth, solver=Solver(name="explicit", substeps=300, iterations=1, damping=0.0), self_collision=contact
    )
    with Simulation(scene) as simulation:
        for _ in range(6):
            simulation.step()
        velocities = simulation.velocities()
        velocities[49:, 0] += 0.2
        simulation.set_state(simulation.positions(), velocities)
        sliding = []
        for _ in range(4):
            simulation.step()
            sliding.append(simulation.velocities()[49:, 0].mean())
    assert sliding == pytest.approx([max(0.2 - 0.5 * 9.81 * k / 60, 0.0) for k in range(1, 5)], abs=0.003)
