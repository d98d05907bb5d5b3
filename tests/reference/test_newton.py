"""The reference against another way to the same motion: implicit steps, each solved by Newton's method to the end."""

from dataclasses import replace

import numpy as np
import pytest

from taichi_cloth import load_scene
from taichi_cloth.reference.blocks import BlockSystem
from taichi_cloth.reference.dynamics import Motion
from taichi_cloth.reference.springs import Floats, SpringModel, spring_model
from taichi_cloth.scene.model import FRAME_SECONDS, Scene


def cloth_of(name: str) -> Scene:
    """The cloth of a shipped scene under its weight alone."""
    scene = load_scene(name)
    still = tuple(replace(grip, sway=(0.0, 0.0, 0.0), rock=(0.0, 0.0, 0.0), path=()) for grip in scene.grips)
    solver = replace(scene.solver, damping=0.0)
    return replace(scene, spheres=(), capsules=(), grips=still, wind=None, ground=None, solver=solver)


def implicit_midpoint(model: SpringModel, frames: int, steps: int) -> Floats:
    """Places (3, N) by M·(x½ − x − h/2·v)·4/h² = F(x½), solved until nothing moves by more than 1e-13 m."""
    h, system = FRAME_SECONDS / steps, BlockSystem(model)
    x, v = model.start, np.zeros_like(model.start)
    for _ in range(frames * steps):
        ahead = x + h / 2 * v
        middle = ahead.copy()
        for _ in range(20):
            force = model.elastic(middle) + model.weight()
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
def test_both_ways_agree(name: str, frames: int, steps: int, bound: float) -> None:
    """To a share of the side that the shorter implicit steps reach, by Richardson's extrapolation of both."""
    scene = cloth_of(name)
    model = spring_model(scene)
    explicit = Motion(scene, 400)
    for _ in range(frames):
        explicit.frame()
    coarse, fine = (implicit_midpoint(model, frames, n) for n in (steps, 2 * steps))
    away = [np.abs(x - explicit.x).max() / model.topology.side for x in (coarse, fine, (4 * fine - coarse) / 3)]
    assert away[2] < bound
    assert away[1] < away[0] / 2
