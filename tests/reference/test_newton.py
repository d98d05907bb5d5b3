"""The reference compared with another method: implicit steps, each solved by Newton's method until it converges."""

from dataclasses import replace

import numpy as np
import pytest

from taichi_cloth import load_scene
from taichi_cloth.evaluation.reference.solution import Motion
from taichi_cloth.evaluation.reference.static_solution import BlockSystem
from taichi_cloth.geometry.spring_model import Floats, SpringModel, spring_model
from taichi_cloth.scene.schema import FRAME_SECONDS, Scene


def cloth_of(name: str) -> Scene:
    """Return a shipped scene with the cloth and its weight only."""
    scene = load_scene(name)
    still = tuple(
        replace(one, oscillation=(0.0, 0.0, 0.0), rocking=(0.0, 0.0, 0.0), keyframes=()) for one in scene.attachments
    )
    solver = replace(scene.solver, damping=0.0)
    return replace(scene, spheres=(), capsules=(), attachments=still, wind=None, ground=None, solver=solver)


def implicit_midpoint(model: SpringModel, frames: int, steps: int) -> Floats:
    """Return positions (3, N) by M·(x½ − x − h/2·v)·4/h² = F(x½), solved until no component changes by 1e-13 m."""
    h, system = FRAME_SECONDS / steps, BlockSystem(model)
    x, v = model.start, np.zeros_like(model.start)
    for _ in range(frames * steps):
        ahead = x + h / 2 * v
        middle = ahead.copy()
        for _ in range(20):
            force = model.elastic_force(middle) + model.weight()
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
    [("drape15", 5, 16, 3e-7), pytest.param("cape", 2, 24, 3e-6, marks=pytest.mark.long)],
)
def test_both_methods_agree(name: str, frames: int, steps: int, bound: float) -> None:
    """Richardson extrapolation of two runs with implicit steps agrees to a small share of the side."""
    scene = cloth_of(name)
    model = spring_model(scene)
    explicit = Motion(scene, 400)
    for _ in range(frames):
        explicit.step_frame()
    coarse, fine = (implicit_midpoint(model, frames, n) for n in (steps, 2 * steps))
    errors = [
        np.abs(x - explicit.x).max() / model.topology.longest_side for x in (coarse, fine, (4 * fine - coarse) / 3)
    ]
    assert errors[2] < bound
    assert errors[1] < errors[0] / 2
