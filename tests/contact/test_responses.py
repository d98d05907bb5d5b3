"""Answers to contact: a sheet that bounces, one that is held by a force, one that lies on the margin."""

from dataclasses import replace

import numpy as np
import pytest

from taichi_cloth.contact.bodies import body_table, counts_of, repulsion_frequency
from taichi_cloth.kernels import controls as c
from taichi_cloth.scene import SceneError, load_scene
from taichi_cloth.scene.model import (
    PROJECTION,
    REFLECTION,
    REPULSION,
    Box,
    Cloth,
    Fabric,
    Ground,
    Mesh,
    Plane,
    Scene,
    Solver,
    Sphere,
)
from taichi_cloth.simulation import Simulation

GRAVITY, MARGIN, DENSITY = 9.81, 0.02, 0.2


def falling(solver: str, plane: Plane, drop: float, damping: float = 0.0) -> Scene:
    """A level sheet of equal particles, so far over the margin of a level plane."""
    cloth = Cloth(
        rows=9,
        columns=10,
        width=0.45,
        height=0.4,
        center=(0.0, MARGIN + drop, 0.0),
        rotation=(-90.0, 0.0, 0.0),
        area_density=DENSITY,
        lumping="equal",
        pins=(),
    )
    fabric = Fabric(warp=20.0, weft=20.0, shear=10.0, bend=0.0)
    return Scene(cloth=cloth, fabric=fabric, planes=(plane,), solver=Solver(solver, 10, 2, damping=damping))


def heights(scene: Scene, frames: int, path: str | None = None) -> tuple[np.ndarray, float]:
    """Mean height over the margin after each frame [m], and the length of a substep [s]; the sheet stays level."""
    found = []
    with Simulation(scene, path) as simulation:
        for _ in range(frames):
            simulation.advance_frame()
            y = simulation.positions()[:, 1]
            assert np.ptp(y) < 1e-4
            found.append(float(y.mean()) - MARGIN)
        return np.array(found), 1 / 60 / simulation.substeps


@pytest.mark.parametrize(("solver", "path"), [("verlet", "lanes"), ("verlet", "gather"), ("spring", "list")])
def test_what_is_reflected_bounces_to_the_square_of_the_restitution(solver: str, path: str) -> None:
    """From the height H it meets the margin at the speed v, and within a substep is no deeper than v·h: so far it sinks
    in first, and so much less high it gets, (1 − e²)·v·h; a velocity of half a substep ago is worth ½·v·h."""
    height, restitution = 0.2, 0.6
    plane = Plane(margin=MARGIN, friction=0.0, response="reflection", restitution=restitution)
    over, h = heights(falling(solver, plane, height), 40, path)
    speed = (2 * GRAVITY * height) ** 0.5
    low = over[:20].argmin()
    bounce = over[low:].max()
    assert over.min() > -1.1 * speed * h
    seen = GRAVITY / 8 / 60**2  # that a height between two frames is above both of them
    assert bounce < restitution**2 * height + 0.5 * speed * h
    assert bounce > restitution**2 * height - seen - (1.5 - restitution**2) * speed * h


def test_what_is_reflected_without_restitution_sinks_and_what_is_projected_does_not() -> None:
    """Nothing moves it out: the review's *solution one* lets cloth sink into a body, projection does not."""
    lost = replace(falling("verlet", Plane(margin=MARGIN, response="reflection", restitution=0.0), 0.05))
    over, _ = heights(lost, 120)
    assert over[-1] < over[30] < -1e-3
    out, _ = heights(falling("verlet", Plane(margin=MARGIN), 0.05), 60)
    assert out[-1] == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize(
    ("solver", "path"),
    [("verlet", "lanes"), ("verlet", "gather"), ("spring", "list"), ("lines", "lanes"), ("rk4", "list")],
)
def test_what_is_repelled_rests_where_the_pressure_carries_its_weight(solver: str, path: str) -> None:
    """κ·depth = ρ·g."""
    stiffness = 500.0
    plane = Plane(margin=MARGIN, friction=0.0, response="repulsion", stiffness=stiffness)
    over, _ = heights(falling(solver, plane, 0.0, damping=12.0), 90, path)
    assert over[-1] == pytest.approx(-DENSITY * GRAVITY / stiffness, rel=2e-3)


def test_a_stiff_force_takes_the_substeps_that_it_needs() -> None:
    plane = Plane(response="repulsion", stiffness=1e6)
    assert repulsion_frequency([plane, Sphere(stiffness=9.0)], 0.25) == pytest.approx(2000)
    scene = falling("verlet", replace(plane, margin=MARGIN), 0.05)
    with Simulation(scene) as simulation:
        assert simulation.substeps > 40
        assert "fewer are unstable" in simulation.advice
        for _ in range(60):
            simulation.advance_frame()
        assert simulation.measure().penetration == 0


@pytest.mark.parametrize("response", ["reflection", "repulsion"])
def test_friction_takes_cloth_along(response: str) -> None:
    """A plate that goes at 0.3 m/s takes the sheet on it along in the end."""
    path = ((0.0, 0.0, 0.0, 0.0), (10.0, 3.0, 0.0, 0.0))
    plate = Plane(margin=MARGIN, friction=0.5, response=response, restitution=0.2, path=path)
    for friction, speed in ((0.5, 0.3), (0.0, 0.0)):
        with Simulation(falling("verlet", replace(plate, friction=friction), 0.0)) as simulation:
            for _ in range(40):
                simulation.advance_frame()
            assert simulation.velocities()[:, 0] == pytest.approx(speed, abs=0.02)


def test_the_table_puts_bodies_of_one_response_together() -> None:
    colliders = [
        Sphere(radius=0.1, response="repulsion"),
        Sphere(radius=0.2),
        Box(response="reflection", restitution=0.25),
        Plane(response="repulsion", stiffness=7.0),
        Ground(),
        Mesh(response="reflection"),
        Mesh(),
    ]
    assert counts_of(colliders, PROJECTION) == (1, 0, 0, 1, 1)
    assert counts_of(colliders, REFLECTION) == (0, 0, 1, 0, 1)
    assert counts_of(colliders, REPULSION) == (1, 0, 0, 1, 0)
    table = body_table(colliders, 0.0, 1 / 60)
    assert table[:, c.BODY_SIZE] == pytest.approx([0.2, 0, 1, 0.5, 0, 0.1, 0])  # the projecting mesh is the second
    assert table[3, c.BODY_RESTITUTION] == 0.25
    assert table[6, c.BODY_STIFFNESS] == 7


@pytest.mark.parametrize(
    ("override", "line"),
    [
        ({"sphere_response": "reflect"}, "spheres[0].response: 'reflect' is not one of: projection, reflection"),
        ({"sphere_response": "reflection", "sphere_swept": True}, "spheres[0].swept: works with projection, not with"),
        (
            {"sphere_response": "repulsion", "sphere_against": "triangles"},
            "spheres[0].against: triangles are for projection, not for repulsion",
        ),
        ({"ground_response": "repulsion", "ground_swept": True}, "ground.swept: works with projection"),
    ],
)
def test_what_a_response_cannot_do_is_said_in_one_line(override: dict[str, object], line: str) -> None:
    with pytest.raises(SceneError) as caught:
        load_scene("curtain", **override)
    assert str(caught.value).startswith(f"curtain (override): {line}")
