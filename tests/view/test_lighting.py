"""Light and shadow, by hand numbers on a few triangles."""

import numpy as np
import pytest
import taichi as ti

from taichi_cloth.view import shadow
from taichi_cloth.view.draw_mesh import DrawMesh
from taichi_cloth.view.lighting import BACKGROUND, BOUNCE, LAMP, RIM, SKY, THROUGH, TO_RIM, light_cloth, light_floor
from taichi_cloth.view.shadow import ACROSS, SIDE, TO_LAMP, UP

FRAME = ti.math.vec4(0.0, 0.0, 0.0, 4.0)  # a texel is 31 mm
LAMPWARD, SIDEWAYS, UPWARD = (np.array(v.to_numpy(), np.float32) for v in (TO_LAMP, ACROSS, UP))


@pytest.fixture(scope="module")
def stage() -> tuple[DrawMesh, object]:
    mesh = DrawMesh(*(ti.Vector.field(3, ti.f32, 12) for _ in range(4)))
    mesh.albedo.fill(1.0)
    return mesh, ti.field(ti.i32, (SIDE, SIDE))


def facing_the_lamp(distance: float, half: float) -> np.ndarray:
    """A triangle across the light around its axis; `distance` [m] towards the lamp."""
    corners = [(-half, -half), (3 * half, -half), (-half, 3 * half)]
    return np.array([distance * LAMPWARD + a * SIDEWAYS + b * UPWARD for a, b in corners], np.float32)


def put(stage: tuple[DrawMesh, object], triangles: list[np.ndarray], normal: np.ndarray) -> DrawMesh:
    mesh, dark = stage
    rows = np.zeros((12, 3), np.float32)
    rows[: 3 * len(triangles)] = np.concatenate(triangles)
    mesh.position.from_numpy(rows)
    mesh.normal.from_numpy(np.tile(normal.astype(np.float32), (12, 1)))
    mesh.corners = 3 * len(triangles)
    shadow.clear(dark)
    shadow.cast(mesh, 0, mesh.corners, dark, FRAME)
    return mesh


def lit(stage: tuple[DrawMesh, object], triangle: int, eye: np.ndarray) -> np.ndarray:
    """Colour of a white triangle, at its first corner."""
    light_cloth(stage[0], 0, stage[0].corners, 0.0, 1.0, ti.math.vec3(*eye.tolist()), stage[1], FRAME)
    return stage[0].colour.to_numpy()[3 * triangle]


def around(normal: np.ndarray) -> np.ndarray:
    """Light from sky, floor and rim, by hand."""
    sky = 0.5 + 0.5 * normal[1]
    rim = max(float(normal @ TO_RIM.to_numpy()), 0.0) * RIM.to_numpy()
    return (1 - sky) * BOUNCE.to_numpy() + sky * SKY.to_numpy() + rim


def test_the_axes_of_the_shadow_are_at_right_angles() -> None:
    axes = np.stack([SIDEWAYS, UPWARD, LAMPWARD])
    assert axes @ axes.T == pytest.approx(np.eye(3), abs=2e-4)
    assert np.linalg.norm(TO_RIM.to_numpy()) == pytest.approx(1, abs=2e-4)


def test_a_sheet_is_lit_before_and_through_its_back(stage: tuple[DrawMesh, object]) -> None:
    put(stage, [facing_the_lamp(0.0, 0.5)], LAMPWARD)
    front = np.minimum(around(LAMPWARD) + LAMP.to_numpy(), 1)
    assert lit(stage, 0, 5 * LAMPWARD) == pytest.approx(front, abs=1e-3)
    back = around(-LAMPWARD) + THROUGH * LAMP.to_numpy()
    assert lit(stage, 0, -5 * LAMPWARD) == pytest.approx(back, abs=1e-3)


@pytest.mark.parametrize(("distance", "shaded"), [(1.0, True), (-1.0, False)], ids=["before", "behind"])
def test_only_what_is_nearer_to_the_lamp_throws_a_shadow(
    stage: tuple[DrawMesh, object], distance: float, shaded: bool
) -> None:
    put(stage, [facing_the_lamp(0.0, 0.3), facing_the_lamp(distance, 1.0)], LAMPWARD)
    expected = around(LAMPWARD) + (0 if shaded else 1) * LAMP.to_numpy()
    assert lit(stage, 0, 5 * LAMPWARD) == pytest.approx(np.minimum(expected, 1), abs=1e-3)


def test_the_edge_of_a_shadow_is_soft(stage: tuple[DrawMesh, object]) -> None:
    """A corner straight behind the edge of what is before it gets about half of the lamp's light."""
    before = facing_the_lamp(1.0, 1.0) + 1.0 * SIDEWAYS  # its edge runs through the middle
    mesh = put(stage, [facing_the_lamp(0.0, 1e-4), before], LAMPWARD)
    mesh.albedo.fill(0.5)
    share = (lit(stage, 0, 5 * LAMPWARD) / 0.5 - around(LAMPWARD)) / LAMP.to_numpy()
    mesh.albedo.fill(1.0)
    assert 0.2 < share.mean() < 0.8


def test_what_is_not_finite_or_far_off_the_map_does_no_harm(stage: tuple[DrawMesh, object]) -> None:
    fine = facing_the_lamp(0.0, 0.3)
    put(stage, [fine, np.full((3, 3), np.nan), np.full((3, 3), np.inf), 1e20 * fine], LAMPWARD)
    assert np.isfinite(lit(stage, 0, 5 * LAMPWARD)).all()
    assert stage[1].to_numpy().any()


def test_the_floor_ends_in_the_background(stage: tuple[DrawMesh, object]) -> None:
    mesh = put(stage, [np.array([[9.0, 0.0, 0.0], [9.0, 0.0, 1.0], [9.0, 0.0, 0.5]], np.float32)], np.array([0, 1, 0]))
    light_floor(mesh, 3, stage[1], FRAME, ti.math.vec3(0.0), 9.0)
    assert mesh.colour.to_numpy()[0] == pytest.approx(BACKGROUND, abs=1e-6)
