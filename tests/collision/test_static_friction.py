"""Static friction: cloth that lies on a ball does not creep, nor does a column that leans within the friction cone."""

from dataclasses import replace

import numpy as np
import pytest
import taichi as ti
import taichi.math as tm
from numpy.typing import NDArray

from taichi_cloth.collision.static_friction import NEVER, bounded_friction, slide_since_anchor
from taichi_cloth.geometry.scene_loader import check_scene
from taichi_cloth.kernels import step_params as c
from taichi_cloth.kernels.step_params import StepContext, param_array
from taichi_cloth.scene.collider_schema import Sphere
from taichi_cloth.scene.fabric_schema import Fabric
from taichi_cloth.scene.schema import Cloth, Scene, SelfCollision, Solver
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.state.contact_data import FrictionAnchors
from taichi_cloth.system.errors import SceneError

Floats = NDArray[np.float64]
THICKNESS, FRICTION = 0.1, 0.3
# Eight particles stacked on the first, which is pinned, and others far away that touch nothing. The springs are
# stretched, so they have almost no stiffness.
LOOSE = Scene(
    cloth=Cloth(rows=2, columns=9, width=8.0, height=1.0, mass_lumping="uniform", pins=(0, *range(8, 18))),
    fabric=Fabric(warp=1e-9, weft=1e-9, shear=1e-9, bend_spring=0.0),
    solver=Solver("xpbd", substeps=30, iterations=4, damping=4.0),
    self_collision=SelfCollision(THICKNESS, FRICTION, static_friction=True),
)


def leaning(degrees: float, count: int) -> Floats:
    """Return `count` particles stacked in a leaning line, and the others 10 m apart [m], (18, 3)."""
    x = np.array([[10.0 * k, 50.0, 0.0] for k in range(18)])
    up = np.array([np.sin(np.radians(degrees)), np.cos(np.radians(degrees)), 0.0])
    x[:count] = np.arange(count)[:, None] * THICKNESS * up
    return x


def creep(scene: Scene, layout: str) -> float:
    """Return the largest displacement in a column that leans by 10° after a second [m]; tan 10° = 0.18."""
    x = leaning(10.0, 8)
    with Simulation(scene, layout) as simulation:
        simulation.set_state(x)
        for _ in range(60):
            simulation.step()
        return float(np.linalg.norm(simulation.positions() - x, axis=1)[:8].max())


@pytest.mark.parametrize(
    "layout", ["serial", *(pytest.param(name, marks=pytest.mark.long) for name in ("simd", "parallel"))]
)
def test_a_column_that_leans_within_the_friction_cone_stands(layout: str) -> None:
    assert creep(LOOSE, layout) < 0.01 * THICKNESS


@pytest.mark.long
def test_without_static_friction_the_column_creeps() -> None:
    assert creep(replace(LOOSE, self_collision=SelfCollision(THICKNESS, FRICTION)), "serial") > 0.1 * THICKNESS


def test_a_column_that_leans_farther_slides_with_coulomb_friction() -> None:
    """A particle on a pinned one: d·θ″ = g·sin θ − μ·(g·cos θ − d·θ′²), from rest."""
    free = replace(LOOSE, solver=replace(LOOSE.solver, damping=0.0))
    start, frames, steps = np.radians(25.0), 9, 10_000
    turned, rate, h = start, 0.0, frames / 60 / steps
    for _ in range(steps):
        normal = 9.81 * np.cos(turned) - THICKNESS * rate**2
        rate += h * (9.81 * np.sin(turned) - FRICTION * normal) / THICKNESS
        turned += h * rate
    with Simulation(free, "serial") as simulation:
        simulation.set_state(leaning(25.0, 2))
        for _ in range(frames):
            simulation.step()
        x = simulation.positions()[1]
    assert np.arctan2(x[0], x[1]) - start == pytest.approx(turned - start, rel=0.05)


@ti.kernel
def touch(anchors: ti.template(), s: int, params: param_array, gap: tm.vec3, normal: tm.vec3, push: tm.vec3) -> tm.vec3:
    """Return how far the pair of entry 0 has slid by substep s."""
    return slide_since_anchor(anchors, ti.static(StepContext(s, 8, 0.01, 0, params, params)), 0, normal, gap, push)


def test_an_anchor_lasts_while_the_pair_is_in_contact() -> None:
    """Two pushes of 1 cm allow 6 mm of static friction; a longer slide drags the anchor along."""
    anchors = FrictionAnchors(
        gap=ti.Vector.field(3, ti.f32, 1), normal_correction=ti.field(ti.f32, 1), last_contact=ti.field(ti.i32, 1)
    )
    anchors.last_contact[0] = NEVER
    params = np.zeros(c.PARAM_COUNT, np.float32)
    params[c.SELF_FRICTION] = FRICTION
    up, push = tm.vec3(0.0, 1.0, 0.0), tm.vec3(0.0, 0.01, 0.0)

    def slid(s: int, x: float) -> list[float]:
        return list(touch(anchors, s, params, tm.vec3(x, 0.1, 0.0), up, push))

    assert slid(0, 0.0) == [0, 0, 0]  # contact begins
    assert slid(0, 0.0) == [0, 0, 0]  # another iteration
    assert slid(1, 0.004) == pytest.approx([0.004, 0, 0])
    assert slid(2, 0.009) == pytest.approx([0.003, 0, 0])  # one push of 1 cm in the last substep allows 3 mm
    assert slid(4, 0.012) == [0, 0, 0]  # no contact for a substep: it begins again
    assert slid(5, 0.014) == pytest.approx([0.002, 0, 0])


def test_metrics_do_not_change_the_simulation() -> None:
    """Intersections are counted with the hash of the candidate lists, which are then rebuilt."""
    positions = []
    for with_metrics in (False, True):
        with Simulation(LOOSE, "serial") as simulation:
            simulation.set_state(leaning(15.0, 8))
            for _ in range(5):
                simulation.step()
                if with_metrics:
                    simulation.metrics()
            positions.append(simulation.positions())
    assert np.array_equal(positions[0], positions[1])


def test_static_friction_requires_particle_contact() -> None:
    scene = replace(LOOSE, self_collision=SelfCollision(0.1, primitives="triangles", static_friction=True))
    with pytest.raises(SceneError, match=r"self_collision\.static_friction: requires primitives"):
        check_scene(scene)


@ti.kernel
def bounded(push_sum: tm.vec3, friction_sum: tm.vec3, slide: tm.vec3, friction: float) -> tm.vec3:
    return bounded_friction(push_sum, friction_sum, tm.vec3(0.0, 1.0, 0.0), slide, friction)


@pytest.mark.parametrize(
    ("friction", "before", "slide", "expected"),
    [
        (0.5, 0.0, 0.02, -0.02),  # within 0.5 · 0.1: it stops
        (0.5, 0.0, 0.08, -0.05),  # beyond: it slides on
        (0.5, -0.04, 0.02, -0.01),  # 0.04 of 0.05 are used up
        (0.5, -0.04, -0.03, 0.03),  # springs pulled it back: friction gives way
        (0.5, -0.04, -0.10, 0.09),  # and turns around
        (0.1, -0.04, 0.02, 0.0),  # a smoother collider does not take back the friction of another
    ],
)
def test_friction_is_bounded_by_the_sum_of_a_substep(
    friction: float, before: float, slide: float, expected: float
) -> None:
    found = bounded(tm.vec3(0.0, 0.1, 0.0), tm.vec3(before, 0.0, 0.0), tm.vec3(slide, 0.3, 0.0), friction)
    assert list(found) == pytest.approx([expected, 0.0, 0.0], abs=1e-7)


ON_A_BALL = Scene(
    cloth=Cloth(17, 17, 1.0, 1.0, center=(0.0, 0.0, 0.0), rotation=(-90.0, 0.0, 0.0), pins=()),
    solver=Solver("xpbd", substeps=60, iterations=4, damping=5.0),
    spheres=(Sphere(center=(0.0, -0.35, 0.0), radius=0.3, margin=0.02, friction=1.5),),
)


@pytest.mark.parametrize(
    ("collide_with", "layout"),
    [("particles", "simd"), ("particles", "serial"), ("particles", "parallel"), ("triangles", "serial")],
)
def test_cloth_on_a_ball_does_not_creep(collide_with: str, layout: str) -> None:
    """Its weight is felt in the first iteration, and springs pull it tight in all."""
    ball = replace(ON_A_BALL.spheres[0], collide_with=collide_with)
    with Simulation(replace(ON_A_BALL, spheres=(ball,)), layout) as simulation:
        simulation.step(240)
        before = simulation.positions()
        simulation.step(60)
        touching = np.linalg.norm(before - ball.center, axis=1) < 0.325
        assert touching.sum() > 20
        assert np.linalg.norm(simulation.positions() - before, axis=1)[touching].max() < 1e-4
