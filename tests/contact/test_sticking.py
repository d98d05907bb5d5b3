"""Friction that holds: what leans within its cone stands still, and what leans farther slides as it ever did."""

from dataclasses import replace

import numpy as np
import pytest
import taichi as ti
import taichi.math as tm
from numpy.typing import NDArray

from taichi_cloth.contact.sticking import NEVER, slid_since
from taichi_cloth.kernels import controls as c
from taichi_cloth.kernels.controls import Substep, row
from taichi_cloth.scene import SceneError, check_scene
from taichi_cloth.scene.model import Cloth, Fabric, Scene, SelfCollision, Solver
from taichi_cloth.simulation import Simulation
from taichi_cloth.state.anchors import Anchors

Floats = NDArray[np.float64]
THICKNESS, FRICTION = 0.1, 0.3
# Eight particles to be piled up on the first, which is held, and others far away that touch nothing. Springs that are
# longer than they want to be would pull: these have as good as no constant.
LOOSE = Scene(
    cloth=Cloth(rows=2, columns=9, width=8.0, height=1.0, lumping="equal", pins=(0, *range(8, 18))),
    fabric=Fabric(warp=1e-9, weft=1e-9, shear=1e-9, bend=0.0),
    solver=Solver("xpbd", substeps=30, iterations=4, damping=4.0),
    self_collision=SelfCollision(THICKNESS, FRICTION, stick=True),
)


def leaning(degrees: float, count: int) -> Floats:
    """So many particles one on the other in a line that leans, the others 10 m apart [m], (18, 3)."""
    x = np.array([[10.0 * k, 50.0, 0.0] for k in range(18)])
    up = np.array([np.sin(np.radians(degrees)), np.cos(np.radians(degrees)), 0.0])
    x[:count] = np.arange(count)[:, None] * THICKNESS * up
    return x


def creep(scene: Scene, path: str) -> float:
    """How far the farthest of a column that leans by 10° goes in a second [m]. It may: tan 10° = 0.18."""
    x = leaning(10.0, 8)
    with Simulation(scene, path) as simulation:
        simulation.place(x)
        for _ in range(60):
            simulation.advance_frame()
        return float(np.linalg.norm(simulation.positions() - x, axis=1)[:8].max())


@pytest.mark.parametrize("path", ["list", *(pytest.param(p, marks=pytest.mark.long) for p in ("lanes", "gather"))])
def test_a_column_that_leans_within_the_cone_stands(path: str) -> None:
    assert creep(LOOSE, path) < 0.01 * THICKNESS


@pytest.mark.long
def test_without_it_the_column_creeps() -> None:
    assert creep(replace(LOOSE, self_collision=SelfCollision(THICKNESS, FRICTION)), "list") > 0.1 * THICKNESS


def test_one_that_leans_farther_slides_with_no_more_than_its_friction() -> None:
    """A particle on one that is held: d·θ″ = g·sin θ − μ·(g·cos θ − d·θ′²), from rest."""
    free = replace(LOOSE, solver=replace(LOOSE.solver, damping=0.0))
    start, frames, steps = np.radians(25.0), 9, 10_000
    turned, rate, h = start, 0.0, frames / 60 / steps
    for _ in range(steps):
        normal = 9.81 * np.cos(turned) - THICKNESS * rate**2
        rate += h * (9.81 * np.sin(turned) - FRICTION * normal) / THICKNESS
        turned += h * rate
    with Simulation(free, "list") as simulation:
        simulation.place(leaning(25.0, 2))
        for _ in range(frames):
            simulation.advance_frame()
        x = simulation.positions()[1]
    assert np.arctan2(x[0], x[1]) - start == pytest.approx(turned - start, rel=0.05)


@ti.kernel
def meet(anchors: ti.template(), s: int, controls: row, gap: tm.vec3, apart: tm.vec3, push: tm.vec3) -> tm.vec3:
    """How far the pair of row 0 has slid, told in substep s."""
    return slid_since(anchors, ti.static(Substep(s, 8, 0.01, 0, controls, controls)), 0, apart, gap, push)


def test_an_anchor_is_kept_as_long_as_a_pair_touches_and_no_longer() -> None:
    """Its friction holds what two pushes of 1 cm can: 6 mm of a slide, of which the rest drags the anchor along."""
    anchors = Anchors(gap=ti.Vector.field(3, ti.f32, 1), pushed=ti.field(ti.f32, 1), met=ti.field(ti.i32, 1))
    anchors.met[0] = NEVER
    controls = np.zeros(c.COUNT, np.float32)
    controls[c.SELF_FRICTION] = FRICTION
    up, push = tm.vec3(0.0, 1.0, 0.0), tm.vec3(0.0, 0.01, 0.0)

    def slid(s: int, x: float) -> list[float]:
        return list(meet(anchors, s, controls, tm.vec3(x, 0.1, 0.0), up, push))

    assert slid(0, 0.0) == [0, 0, 0]  # where they meet
    assert slid(0, 0.0) == [0, 0, 0]  # pushed again in another iteration
    assert slid(1, 0.004) == pytest.approx([0.004, 0, 0])
    assert slid(2, 0.009) == pytest.approx([0.003, 0, 0])  # one push of 1 cm in the last substep: it holds 3 mm
    assert slid(4, 0.012) == [0, 0, 0]  # apart for a substep: they meet anew
    assert slid(5, 0.014) == pytest.approx([0.002, 0, 0])


def test_a_run_that_is_measured_gives_the_same_bits() -> None:
    """Crossings are counted with the buckets of the lists, which are then made anew."""
    places = []
    for measured in (False, True):
        with Simulation(LOOSE, "list") as simulation:
            simulation.place(leaning(15.0, 8))
            for _ in range(5):
                simulation.advance_frame()
                if measured:
                    simulation.measure()
            places.append(simulation.positions())
    assert np.array_equal(*places)


def test_it_is_for_particles() -> None:
    scene = replace(LOOSE, self_collision=SelfCollision(0.1, contacts="triangles", stick=True))
    with pytest.raises(SceneError, match=r"self_collision\.stick: is for contacts between particles"):
        check_scene(scene)
