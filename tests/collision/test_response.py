"""Contact responses: a sheet that bounces, one supported by a force, one that lies on the margin."""

from dataclasses import replace

import numpy as np
import pytest

from taichi_cloth.collision.colliders import collider_counts, collider_table
from taichi_cloth.geometry.scene_loader import load_scene
from taichi_cloth.geometry.stability_bounds import repulsion_frequency
from taichi_cloth.kernels import step_params as c
from taichi_cloth.scene.collider_schema import (
    PROJECTION,
    REFLECTION,
    REPULSION,
    Box,
    Collider,
    Ground,
    Mesh,
    Plane,
    Sphere,
)
from taichi_cloth.scene.fabric_schema import Fabric
from taichi_cloth.scene.schema import Cloth, Scene, Solver
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.solvers import SOLVERS
from taichi_cloth.system.errors import SceneError

GRAVITY, MARGIN, DENSITY = 9.81, 0.02, 0.2


def falling(solver: str, plane: Plane, drop: float, damping: float = 0.0) -> Scene:
    """Return a horizontal sheet of equal particles, `drop` [m] above the margin of a horizontal plane."""
    cloth = Cloth(
        rows=9,
        columns=10,
        width=0.45,
        height=0.4,
        center=(0.0, MARGIN + drop, 0.0),
        rotation=(-90.0, 0.0, 0.0),
        area_density=DENSITY,
        mass_lumping="uniform",
        pins=(),
    )
    fabric = Fabric(warp=20.0, weft=20.0, shear=10.0, bend_spring=0.0)
    return Scene(cloth=cloth, fabric=fabric, planes=(plane,), solver=Solver(solver, 10, 2, damping=damping))


def heights(scene: Scene, frames: int, layout: str | None = None) -> tuple[np.ndarray, float]:
    """Return the mean height above the margin after each frame [m], and the length of a substep [s].

    The sheet must stay horizontal.
    """
    found = []
    with Simulation(scene, layout) as simulation:
        for _ in range(frames):
            simulation.step()
            y = simulation.positions()[:, 1]
            assert np.ptp(y) < 1e-4
            found.append(float(y.mean()) - MARGIN)
        return np.array(found), 1 / 60 / simulation.substeps


@pytest.mark.parametrize(("solver", "layout"), [("verlet", "simd"), ("verlet", "parallel"), ("explicit", "serial")])
def test_reflected_cloth_bounces_to_the_restitution_squared_times_its_height(solver: str, layout: str) -> None:
    """From the height H it reaches the margin at the speed v, and sinks in by up to v·h within a substep, so it rises
    (1 − e²)·v·h less. Using the velocity of half a substep before changes the height by up to ½·v·h."""
    height, restitution = 0.2, 0.6
    plane = Plane(margin=MARGIN, friction=0.0, response="reflection", restitution=restitution)
    over, h = heights(falling(solver, plane, height), 40, layout)
    speed = (2 * GRAVITY * height) ** 0.5
    low = over[:20].argmin()
    bounce = over[low:].max()
    assert over.min() > -1.1 * speed * h
    between_frames = GRAVITY / 8 / 60**2  # by which the maximum between two frames exceeds both
    assert bounce < restitution**2 * height + 0.5 * speed * h
    assert bounce > restitution**2 * height - between_frames - (1.5 - restitution**2) * speed * h


def test_reflection_without_restitution_sinks_in_and_projection_does_not() -> None:
    """Reflection does not move cloth out, so it sinks into a collider under its weight."""
    reflected = falling("verlet", Plane(margin=MARGIN, response="reflection", restitution=0.0), 0.05)
    over, _ = heights(reflected, 120)
    assert over[-1] < over[30] < -1e-3
    out, _ = heights(falling("verlet", Plane(margin=MARGIN), 0.05), 60)
    assert out[-1] == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize(
    ("solver", "layout"),
    [("verlet", "simd"), ("verlet", "parallel"), ("explicit", "serial"), ("lines", "simd"), ("rk4", "serial")],
)
def test_repelled_cloth_rests_where_the_pressure_carries_its_weight(solver: str, layout: str) -> None:
    """κ·depth = ρ·g."""
    stiffness = 500.0
    plane = Plane(margin=MARGIN, friction=0.0, response="repulsion", stiffness=stiffness)
    over, _ = heights(falling(solver, plane, 0.0, damping=12.0), 90, layout)
    assert over[-1] == pytest.approx(-DENSITY * GRAVITY / stiffness, rel=2e-3)


def test_a_stiff_repulsion_takes_the_substeps_it_needs() -> None:
    plane = Plane(response="repulsion", stiffness=1e6)
    assert repulsion_frequency([plane, Sphere(stiffness=9.0, margin=0.15, friction=0.0)], 0.25) == pytest.approx(2000)
    scene = falling("verlet", replace(plane, margin=MARGIN), 0.05)
    with Simulation(scene) as simulation:
        assert simulation.substeps > 40
        assert "fewer are unstable" in simulation.warnings
        for _ in range(60):
            simulation.step()
        assert simulation.metrics().penetration == 0


@pytest.mark.parametrize("response", ["reflection", "repulsion"])
def test_friction_drags_cloth_along(response: str) -> None:
    """A plate that moves at 0.3 m/s accelerates the sheet on it to its speed."""
    keyframes = ((0.0, 0.0, 0.0, 0.0), (10.0, 3.0, 0.0, 0.0))
    plate = Plane(margin=MARGIN, friction=0.5, response=response, restitution=0.2, keyframes=keyframes)
    for friction, speed in ((0.5, 0.3), (0.0, 0.0)):
        with Simulation(falling("verlet", replace(plate, friction=friction), 0.0)) as simulation:
            for _ in range(40):
                simulation.step()
            assert simulation.velocities()[:, 0] == pytest.approx(speed, abs=0.02)


def test_the_table_is_ordered_by_response() -> None:
    colliders: list[Collider | Ground] = [
        Sphere(radius=0.1, response="repulsion", margin=0.15, friction=0.0),
        Sphere(radius=0.2, margin=0.15, friction=0.0),
        Box(response="reflection", restitution=0.25),
        Plane(response="repulsion", stiffness=7.0),
        Ground(),
        Mesh(response="reflection"),
        Mesh(),
    ]
    assert collider_counts(colliders)[PROJECTION] == (1, 0, 0, 1, 1)
    assert collider_counts(colliders)[REFLECTION] == (0, 0, 1, 0, 1)
    assert collider_counts(colliders)[REPULSION] == (1, 0, 0, 1, 0)
    table = collider_table(colliders, 0.0, 1 / 60)
    assert table[:, c.COLLIDER_SIZE] == pytest.approx(
        [0.2, 0, 1, 0.5, 0, 0.1, 0]
    )  # the mesh with projection is the second
    assert table[3, c.COLLIDER_RESTITUTION] == 0.25
    assert table[6, c.COLLIDER_STIFFNESS] == 7


@pytest.mark.parametrize(
    ("override", "line"),
    [
        ({"sphere_response": "reflect"}, "spheres[0].response: 'reflect' is not one of: projection, reflection"),
        (
            {"sphere_response": "reflection", "sphere_continuous": True},
            "spheres[0].continuous: requires projection, got",
        ),
        (
            {"sphere_response": "repulsion", "sphere_collide_with": "triangles"},
            "spheres[0].collide_with: triangles require projection, got repulsion",
        ),
        ({"ground_response": "repulsion", "ground_continuous": True}, "ground.continuous: requires projection"),
    ],
)
def test_unsupported_combinations_are_rejected_in_one_line(override: dict[str, object], line: str) -> None:
    with pytest.raises(SceneError) as caught:
        load_scene("curtain", **override)
    assert str(caught.value).startswith(f"curtain (override): {line}")


HELD = Scene(
    cloth=Cloth(rows=9, columns=9, width=0.4, height=0.4, center=(0.0, 0.0, 0.0), rotation=(-90.0, 0.0, 20.0), pins=()),
    solver=Solver(damping=0.0),
    planes=(Plane(rotation=(0.0, 0.0, 20.0), margin=0.0, friction=0.6),),
)


@pytest.mark.parametrize("solver", SOLVERS)
def test_cloth_that_friction_holds_is_reported_at_rest(solver: str) -> None:
    """Gravity moves it within a substep, and contact stops it before the end of the frame."""
    with Simulation(replace(HELD, solver=replace(HELD.solver, name=solver, substeps=4, iterations=2))) as simulation:
        simulation.step(30)
        before = simulation.positions()
        simulation.step()
        assert np.abs(simulation.positions() - before).max() < 1e-5
        assert np.linalg.norm(simulation.velocities(), axis=1).max() < 2e-4  # half a substep of gravity adds 2e-3
