"""The reference compared with another method: implicit steps, each solved by Newton's method until it converges."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from taichi_cloth import load_scene
from taichi_cloth.evaluation.reference.solution import Motion
from taichi_cloth.evaluation.reference.static_solution import BlockSystem
from taichi_cloth.geometry.spring_model import Floats, SpringModel, spring_model
from taichi_cloth.scene.collider_schema import Sphere
from taichi_cloth.scene.schema import FRAME_SECONDS, Scene, Wind


def cloth_of(name: str) -> Scene:
    """Return a shipped scene with the cloth and its weight only."""
    scene = load_scene(name)
    still = tuple(
        replace(one, oscillation=(0.0, 0.0, 0.0), rocking=(0.0, 0.0, 0.0), keyframes=()) for one in scene.attachments
    )
    solver = replace(scene.solver, damping=0.0)
    return replace(scene, spheres=(), capsules=(), attachments=still, wind=None, ground=None, solver=solver)


Force = Callable[[Floats, Floats], Floats]


def implicit_midpoint(model: SpringModel, frames: int, steps: int, other: Force | None = None) -> Floats:
    """Return positions (3, N) by M·(x½ − x − h/2·v)·4/h² = F(x½), solved until no component changes by 1e-13 m.

    `other` returns forces beside those of springs and weight [N], (3, N), from positions and velocities in the middle
    of the step. Newton's matrix leaves them out, which costs iterations and changes no solution.
    """
    h, system = FRAME_SECONDS / steps, BlockSystem(model)
    x, v = model.start, np.zeros_like(model.start)
    for _ in range(frames * steps):
        ahead = x + h / 2 * v
        middle = ahead.copy()
        for _ in range(20):
            force = model.elastic_force(middle) + model.weight()
            if other is not None:
                force += other(middle, 2 / h * (middle - x))
            wrong = (force - 4 / h**2 * model.mass * (middle - ahead)) * model.free
            change = system.solve(4 / h**2 * model.mass, model.stiffness_blocks(middle), wrong)
            middle += change
            if np.abs(change).max() < 1e-13:
                break
        mean = 2 / h * (middle - x)
        x, v = x + h * mean, 2 * mean - v
    return x


@pytest.mark.parametrize(
    ("name", "frames", "steps", "bound"),
    [("drape15", 5, 16, 3e-7), pytest.param("cape", 2, 48, 8e-7, marks=pytest.mark.long)],
)
def test_both_methods_agree(name: str, frames: int, steps: int, bound: float) -> None:
    """Richardson extrapolation of two runs with implicit steps agrees to a small share of the side."""
    scene = cloth_of(name)
    model = spring_model(scene)
    explicit = Motion(scene, 400)
    for _ in range(frames):
        explicit.step_frame()
    coarse, fine = (implicit_midpoint(model, frames, n) for n in (steps, 2 * steps))
    errors = distances(explicit, model, coarse, fine)
    assert errors[2] < bound
    assert errors[1] < errors[0] / 2


def distances(motion: Motion, model: SpringModel, coarse: Floats, fine: Floats) -> list[float]:
    """Return the distances of two runs and of their extrapolation from the reference, as shares of the side."""
    return [
        float(np.abs(x - motion.x).max()) / model.topology.longest_side for x in (coarse, fine, (4 * fine - coarse) / 3)
    ]


WIND = Wind(x=1.5, z=4.0, turbulence=0.0, drag=1.2, lift=0.8)
BALL = Sphere(center=(0.1, 2.175, 0.76), radius=0.3, margin=0.02, friction=0.0, response="repulsion", stiffness=800.0)


def wind_and_ball(scene: Scene, model: SpringModel) -> Force:
    """Return the forces of `WIND` on each triangle and of `BALL` on each particle, written from their definitions.

    Wind: ½ρA·(n·u)·[C_D·(n·u)·û + C_L·(|u|·n − (n·u)·û)], a third of it at each corner. Ball: k per area, times the
    depth below its margin.
    """
    air, reach = np.array([WIND.x, 0.0, WIND.z]), BALL.radius + BALL.margin
    of_density = BALL.stiffness / scene.cloth.area_density
    triangles = model.topology.triangles

    def force(x: Floats, v: Floats) -> Floats:
        corners = x.T[triangles]
        u = air - v.T[triangles].mean(axis=1)
        doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        twice_area = np.linalg.norm(doubled, axis=1, keepdims=True)
        speed = np.linalg.norm(u, axis=1, keepdims=True)
        n, along = doubled / twice_area, u / speed
        across = (n * u).sum(axis=1, keepdims=True)
        push = WIND.drag * across * along + WIND.lift * (speed * n - across * along)
        total = np.zeros((x.shape[1], 3))
        np.add.at(total, triangles, (WIND.air_density * twice_area / 12 * across * push)[:, None])
        offset = x.T - BALL.center
        distance = np.linalg.norm(offset, axis=1)
        depth = np.maximum(reach - distance, 0.0)
        total += (np.ravel(model.mass) * of_density * depth / distance)[:, None] * offset
        return total.T

    return force


def test_both_methods_agree_in_wind_and_in_contact() -> None:
    """The wind blows a sheet against a ball, which repels it from its margin on: a force with a kink and no jump."""
    scene = replace(cloth_of("drape15"), wind=WIND, spheres=(BALL,))
    model, frames = spring_model(scene), 3
    motion, without_ball, without_wind = (
        Motion(one, 400) for one in (scene, replace(scene, spheres=()), replace(scene, wind=None))
    )
    for _ in range(frames):
        for one in (motion, without_ball, without_wind):
            one.step_frame()
    other = wind_and_ball(scene, model)
    coarse, fine = (implicit_midpoint(model, frames, n, other) for n in (16, 32))
    errors = distances(motion, model, coarse, fine)
    assert errors[2] < 5e-7
    assert errors[1] < errors[0] / 2
    assert np.abs(without_ball.x - motion.x).max() > 1e-4
    assert np.abs(without_wind.x - motion.x).max() > 1e-2
