"""Formulas on plain values, against values computed by hand and closed forms."""

from typing import Any

import numpy as np
import pytest
import taichi as ti
import taichi.math as tm
from hypothesis import given
from hypothesis import strategies as st

from taichi_cloth.kernels import constraint_math as maths

pytestmark = pytest.mark.bounds

pair = ti.types.matrix(2, 3, ti.f32)


@ti.kernel
def verlet_step(x: tm.vec3, x_prev: tm.vec3, kept: float, acceleration: tm.vec3, h: float) -> tm.vec3:
    return maths.verlet_step(x, x_prev, kept, acceleration, h)


@ti.kernel
def project(p: tm.vec3, q: tm.vec3, w_p: float, w_q: float, rest: float, stiffness: float) -> pair:
    shift = maths.project_distance(q - p, w_p + w_q, rest, stiffness)
    return pair([shift * w_p, -shift * w_q])


@ti.kernel
def area_normal(a: tm.vec3, b: tm.vec3, c: tm.vec3) -> tm.vec3:
    return maths.triangle_area_normal(a, b, c)


@ti.kernel
def air_force(area_normal: tm.vec3, air: tm.vec3, half_density: float, drag: float, lift: float) -> tm.vec3:
    return maths.wind_force(area_normal, air, half_density, drag, lift)


@ti.kernel
def parabolic_wave(turns: float) -> float:
    return maths.parabolic_wave(turns)


@ti.kernel
def out_of_sphere(p: tm.vec3, center: tm.vec3, distance: float) -> tm.vec3:
    return maths.push_out_of_sphere(p, center, distance)


@ti.kernel
def out_of_box(p: tm.vec3, center: tm.vec3, half: tm.vec3, margin: float) -> tm.vec3:
    return maths.push_out_of_box(p, center, half, margin)


@ti.kernel
def friction_slide(push: tm.vec3, move: tm.vec3, friction: float) -> tm.vec3:
    return maths.friction_correction(push, move, friction)


def vec(*values: float) -> tm.vec3:
    return tm.vec3(*values)


def array(vector: object) -> np.ndarray:
    return np.array(vector, dtype=np.float64)


def close(vector: object, expected: Any, tolerance: float = 1e-6) -> bool:
    return np.allclose(array(vector), expected, rtol=0, atol=tolerance)


coordinate = st.floats(-3, 3, width=32)
point = st.tuples(coordinate, coordinate, coordinate)


# -- Verlet step -----------------------------------------------------------------------------------------


def test_verlet_step_by_hand() -> None:
    # 1 + (1 − 0.5)·0.8 − 10·0.1² = 1.3 along y; nothing changes along the other axes.
    assert close(verlet_step(vec(0, 1, 2), vec(0, 0.5, 2), 0.8, vec(0, -10, 0), 0.1), [0, 1.3, 2])


@given(point, point)
def test_verlet_step_without_damping_is_the_textbook_formula(x: tuple, x_prev: tuple) -> None:
    expected = 2 * np.array(x) - np.array(x_prev) + np.array([0, -9.81, 0]) * 0.02**2
    assert close(verlet_step(vec(*x), vec(*x_prev), 1.0, vec(0, -9.81, 0), 0.02), expected, 2e-6)


def test_verlet_step_with_a_zero_factor_discards_velocity() -> None:
    assert close(verlet_step(vec(1, 1, 1), vec(9, 9, 9), 0.0, vec(0, 0, 0), 0.1), [1, 1, 1])


# -- distance constraint -----------------------------------------------------------------------------------


def test_projection_splits_the_error_between_equal_masses() -> None:
    # Length 2, rest 1: each end corrects half of the excess of 1 m.
    moves = project(vec(0, 0, 0), vec(2, 0, 0), 3.0, 3.0, 1.0, 1.0)
    assert close(moves, [[0.5, 0, 0], [-0.5, 0, 0]])


def test_projection_moves_the_lighter_end_more() -> None:
    moves = project(vec(0, 0, 0), vec(0, 2, 0), 3.0, 1.0, 1.0, 1.0)
    assert close(moves, [[0, 0.75, 0], [0, -0.25, 0]])


def test_projection_does_not_move_a_pinned_end() -> None:
    moves = array(project(vec(0, 0, 0), vec(0, 0, 4), 0.0, 2.0, 1.0, 1.0))
    assert (moves[0] == 0).all()
    assert close(moves[1], [0, 0, -3])


def test_projection_between_two_pins_is_zero() -> None:
    assert (array(project(vec(0, 0, 0), vec(0, 0, 4), 0.0, 0.0, 1.0, 1.0)) == 0).all()


def test_projection_lengthens_a_short_spring_by_its_stiffness() -> None:
    # Error −0.5, a fifth of it corrected: 0.1 in total.
    moves = project(vec(0, 0, 0), vec(0.5, 0, 0), 1.0, 1.0, 1.0, 0.2)
    assert close(moves, [[-0.05, 0, 0], [0.05, 0, 0]])


def test_projection_of_a_spring_of_zero_length_is_finite() -> None:
    assert np.isfinite(array(project(vec(1, 1, 1), vec(1, 1, 1), 1.0, 1.0, 1.0, 1.0))).all()


@given(point, point, st.floats(0.125, 5, width=32), st.floats(0.125, 5, width=32), st.floats(0.0625, 2, width=32))
def test_projection_reaches_the_rest_length_and_keeps_the_center_of_mass(
    first: tuple, second: tuple, w_p: float, w_q: float, rest: float
) -> None:
    p, q = np.array(first), np.array(second)
    if np.linalg.norm(q - p) < 1e-3:
        return
    move_p, move_q = array(project(vec(*p), vec(*q), w_p, w_q, rest, 1.0))
    assert np.linalg.norm(q + move_q - p - move_p) == pytest.approx(rest, abs=1e-5)
    assert close(move_p / w_p + move_q / w_q, 0, 2e-4)


# -- wind on a triangle ------------------------------------------------------------------------------------

HALF_DENSITY = 0.6


def test_area_normal_of_a_right_triangle() -> None:
    assert close(area_normal(vec(0, 0, 0), vec(2, 0, 0), vec(0, 3, 0)), [0, 0, 3])


def test_perpendicular_wind_exerts_the_full_dynamic_pressure() -> None:
    # ½ρ·A·u² = 0.6 · 2 · 9 = 10.8 N along the wind, for either winding of the triangle.
    for side in (1.0, -1.0):
        assert close(air_force(vec(0, 0, 2 * side), vec(0, 0, 3), HALF_DENSITY, 1.0, 1.0), [0, 0, 10.8], 1e-5)


def test_parallel_wind_exerts_no_force() -> None:
    assert close(air_force(vec(0, 0, 2), vec(3, 0, 0), HALF_DENSITY, 1.0, 1.0), [0, 0, 0])


def test_still_air_and_a_degenerate_triangle_give_no_force() -> None:
    assert close(air_force(vec(0, 0, 2), vec(0, 0, 0), HALF_DENSITY, 1.0, 1.0), [0, 0, 0])
    assert close(air_force(vec(0, 0, 0), vec(0, 0, 3), HALF_DENSITY, 1.0, 1.0), [0, 0, 0])


def test_oblique_wind_by_hand() -> None:
    # 60° between wind (along x) and normal: cosθ = ½, ½ρ·A·u²·cosθ = 0.6 · 1 · 4 · ½ = 1.2 N, half of it for drag.
    normal = np.array([0.5, np.sqrt(0.75), 0])
    assert close(air_force(vec(*normal), vec(2, 0, 0), HALF_DENSITY, 1.0, 0.0), [0.6, 0, 0])
    assert close(air_force(vec(*normal), vec(2, 0, 0), HALF_DENSITY, 0.0, 1.0), 1.2 * (normal - [0.5, 0, 0]))


@given(point, point)
def test_drag_is_parallel_and_lift_perpendicular_to_the_air(area: tuple, air: tuple) -> None:
    drag = array(air_force(vec(*area), vec(*air), HALF_DENSITY, 1.0, 0.0))
    lift = array(air_force(vec(*area), vec(*air), HALF_DENSITY, 0.0, 1.0))
    scale = 1e-4 * (1 + np.linalg.norm(area) * np.dot(air, air))
    assert np.linalg.norm(np.cross(drag, air)) <= scale * (1 + np.linalg.norm(air))
    assert np.dot(drag, air) >= -scale
    assert abs(np.dot(lift, air)) <= scale * (1 + np.linalg.norm(air))


@given(point, point)
def test_equal_coefficients_give_a_force_along_the_normal(area: tuple, air: tuple) -> None:
    force = array(air_force(vec(*area), vec(*air), HALF_DENSITY, 1.3, 1.3))
    assert np.linalg.norm(np.cross(force, area)) <= 1e-4 * (1 + np.linalg.norm(force) * np.linalg.norm(area))


@pytest.mark.parametrize(("turns", "height"), [(0.0, 0.0), (0.25, -1.0), (0.5, 0.0), (0.75, 1.0), (7.25, -1.0)])
def test_parabolic_wave_ranges_from_minus_one_to_one(turns: float, height: float) -> None:
    assert parabolic_wave(turns) == pytest.approx(height, abs=1e-6)


# -- contact -----------------------------------------------------------------------------------------------


def test_a_point_in_a_sphere_moves_to_its_surface() -> None:
    assert close(out_of_sphere(vec(1.5, 0, 0), vec(1, 0, 0), 2.0), [1.5, 0, 0])


def test_a_point_outside_a_sphere_does_not_move() -> None:
    assert (array(out_of_sphere(vec(4, 0, 0), vec(1, 0, 0), 2.0)) == 0).all()


def test_the_center_of_a_sphere_has_a_direction_out() -> None:
    assert close(out_of_sphere(vec(1, 2, 3), vec(1, 2, 3), 2.0), [0, 2, 0])


@given(point, st.floats(0.125, 2, width=32))
def test_no_point_stays_in_a_sphere(p: tuple, distance: float) -> None:
    out = np.array(p) + array(out_of_sphere(vec(*p), vec(0, 0, 0), distance))
    assert np.linalg.norm(out) >= distance * (1 - 1e-5)


def box_distance(p: np.ndarray, half: np.ndarray) -> float:
    beyond = np.abs(p) - half
    return float(np.linalg.norm(np.maximum(beyond, 0)) + min(beyond.max(), 0))


def test_a_point_in_a_box_leaves_through_the_closest_face() -> None:
    assert close(out_of_box(vec(0.2, 0.9, -0.3), vec(0, 0, 0), vec(1, 1, 1), 0.05), [0, 0.15, 0])
    assert close(out_of_box(vec(0.2, 0.1, -0.8), vec(0, 0, 0), vec(1, 1, 1), 0.05), [0, 0, -0.25])


def test_the_margin_rounds_the_edges_of_a_box() -> None:
    # 0.03 and 0.04 past an edge is 0.05 away from it; a margin of 0.1 doubles that.
    assert close(out_of_box(vec(1.03, 1.04, 0), vec(0, 0, 0), vec(1, 1, 1), 0.1), [0.03, 0.04, 0])


@given(point, st.tuples(*[st.floats(0.125, 2, width=32)] * 3), st.floats(0, 0.5, width=32))
def test_no_point_stays_in_a_box(p: tuple, half: tuple, margin: float) -> None:
    push = array(out_of_box(vec(*p), vec(0, 0, 0), vec(*half), margin))
    before, after = (box_distance(np.array(x), np.array(half)) for x in (p, p + push))
    assert after >= margin - 1e-5
    assert (push == 0).all() or before <= margin + 1e-6
    assert np.linalg.norm(push) == pytest.approx(max(0.0, margin - before), abs=1e-5)  # the shortest displacement


def test_friction_removes_a_small_slide_completely() -> None:
    # Pushed up by 0.1 with μ = 0.5: friction removes up to 0.05 of sliding.
    assert close(friction_slide(vec(0, 0.1, 0), vec(0.04, -0.1, 0), 0.5), [-0.04, 0, 0])


def test_friction_removes_no_more_than_its_cone_allows() -> None:
    assert close(friction_slide(vec(0, 0.1, 0), vec(0.3, -0.1, 0.4), 0.5), [-0.03, 0, -0.04])


def test_no_friction_without_a_push_or_a_coefficient() -> None:
    assert (array(friction_slide(vec(0, 0, 0), vec(0.3, 0, 0), 0.5)) == 0).all()
    assert (array(friction_slide(vec(0, 0.1, 0), vec(0.3, 0, 0), 0.0)) == 0).all()
