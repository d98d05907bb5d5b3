"""A setting changes the scene of a case as docs/stability.md says, and nothing else of it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from taichi_cloth.evaluation.stress.setup import DEFAULT_SETTINGS, ROBUST, ROBUST_SLACK, SETTINGS, Setting
from taichi_cloth.scene.collider_schema import Box, Capsule, Ground, Mesh, Plane, Sphere
from taichi_cloth.scene.fabric_schema import Fabric
from taichi_cloth.scene.schema import COLLIDERS, Scene, SelfCollision, Solver, StrainLimit
from taichi_cloth.scene.solver_catalog import SOLVER_CATALOG

BARE = Scene(
    fabric=Fabric(warp=3.0, weft=4.0, shear=5.0, bending_stiffness=6e-3, damping_time=0.01, compression=0.6),
    solver=Solver("lines", 3, 2, stiffness=0.7, damping=1.5),
)
FULL = replace(
    BARE,
    ground=Ground(height=0.1),
    spheres=(Sphere(radius=0.2), Sphere(name="other", radius=0.3)),
    capsules=(Capsule(radius=0.1),),
    boxes=(Box(),),
    planes=(Plane(),),
    meshes=(Mesh(),),
    strain_limit=StrainLimit(strain=0.05, iterations=3),
    self_collision=SelfCollision(thickness=0.03, friction=0.2),
)


@pytest.fixture(autouse=True, scope="module")
def taichi() -> None:
    """No test of this module needs Taichi."""


def hard(scene: Scene) -> Scene:
    """Return the scene with the keys that the page lists for `robust`."""
    collision = scene.self_collision
    anchors = collision is not None and collision.primitives == "particles"
    parts: dict[str, Any] = {
        "solver": replace(scene.solver, name="xpbd", substeps=60, iterations=8),
        "self_collision": collision and replace(collision, untangle=True, static_friction=anchors),
        "strain_limit": scene.strain_limit and replace(scene.strain_limit, iterations=24),
        "ground": scene.ground and replace(scene.ground, continuous=True),
    }
    for kind in COLLIDERS:
        parts[kind] = tuple(replace(one, continuous=True) for one in getattr(scene, kind))
    return replace(scene, **parts)


def with_damping(scene: Scene, damping: float) -> Scene:
    return replace(scene, solver=replace(scene.solver, damping=damping))


@pytest.mark.parametrize("scene", [BARE, FULL], ids=["bare", "full"])
@pytest.mark.parametrize(("damping", "slack"), [(0.0, 0.0), (0.1, 4.0), (1.5, 4.0), (4.5, 4.5)])
def test_robust_keeps_the_cloth_and_robust_slack_takes_another(scene: Scene, damping: float, slack: float) -> None:
    """Fabric, compression and damping are those of the scene: `robust` may not survive with an easier cloth."""
    scene = with_damping(scene, damping)
    found = ROBUST.of(scene)
    assert found == hard(scene)
    assert found.fabric == scene.fabric
    assert found.solver.damping == damping
    other = ROBUST_SLACK.of(scene)
    assert other == with_damping(replace(found, fabric=replace(scene.fabric, compression=0.0)), slack)


def test_static_friction_needs_contact_between_particles() -> None:
    scene = replace(FULL, self_collision=SelfCollision(thickness=0.01, primitives="triangles"))
    assert ROBUST.of(scene) == hard(scene)


@pytest.mark.parametrize("setting", DEFAULT_SETTINGS.values(), ids=DEFAULT_SETTINGS)
def test_a_default_setting_changes_the_solver_only(setting: Setting) -> None:
    """And the iterations of the strain limit."""
    substeps, iterations = SOLVER_CATALOG[setting.name].defaults
    solver = replace(FULL.solver, name=setting.name, substeps=substeps, iterations=iterations)
    limit = FULL.strain_limit and replace(FULL.strain_limit, iterations=1)
    assert setting.of(FULL) == replace(FULL, solver=solver, strain_limit=limit)


def test_the_settings_are_the_solvers_and_the_two_for_hard_scenes() -> None:
    assert list(SETTINGS) == [*SOLVER_CATALOG, "robust", "robust-slack"]
