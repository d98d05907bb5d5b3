"""A9: closed forms, hand-made cloth that falls short, and two setups that have found mistakes."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from taichi_cloth.evaluation.validate import continuum
from taichi_cloth.evaluation.validate.check import EXCELLENT, FAIL, Check
from taichi_cloth.evaluation.validate.continuum import (
    TENSOR,
    bias_shear,
    diamonds,
    green_strains,
    irregular,
    picture_frame_force,
    strip_modulus,
    thread_shear,
    zones,
)
from taichi_cloth.simulation.simulation import Simulation


def test_strips_along_the_threads_have_the_stiffness_of_a_strip_that_is_free_sideways() -> None:
    assert strip_modulus(TENSOR, 0.0) == pytest.approx(2000 - 300**2 / 1500)
    assert strip_modulus(TENSOR, 90.0) == pytest.approx(1500 - 300**2 / 2000)


def test_an_isotropic_strip_has_one_stiffness() -> None:
    """E = 1000 N/m and ν = 0.25: C11 = E/(1 − ν²), C66 = E/2(1 + ν)."""
    tensor = {"c11": 1000 / 0.9375, "c22": 1000 / 0.9375, "c12": 250 / 0.9375, "c66": 400.0}
    assert [strip_modulus(tensor, angle) for angle in (0.0, 17.0, 45.0, 90.0)] == pytest.approx([1000.0] * 4)


def test_the_force_of_a_picture_frame_is_the_published_one() -> None:
    found = [picture_frame_force(np.radians(angle)) for angle in (10, 20, 30, 40)]
    assert found == pytest.approx([0.2660, 0.5603, 0.8660, 1.1651], abs=5e-5)


def test_the_angle_of_a_bias_extension_is_the_published_one() -> None:
    found = [bias_shear(one) for one in (0.05, 0.1, 0.2, 0.3)]
    assert found == pytest.approx([5.88, 12.12, 26.10, 43.63], abs=5e-3)


@pytest.mark.parametrize("mesh", [irregular(4, 4, 0.3), diamonds(3, 6, 0.5)])
def test_meshes_cover_their_rectangle_once(mesh: tuple[np.ndarray, np.ndarray]) -> None:
    points, triangles = mesh
    u, v = points[triangles[:, 1]] - points[triangles[:, 0]], points[triangles[:, 2]] - points[triangles[:, 0]]
    areas = np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]) / 2
    assert areas.sum() == pytest.approx(np.prod(np.ptp(points, axis=0)))
    assert areas.min() > 1e-3
    assert set(triangles.ravel()) == set(range(len(points)))


def test_strains_along_turned_axes() -> None:
    """Threads at 45° that a simple stretch turns towards each other: E = ½(λ² − 1) along y, half of it in shear."""
    points, triangles = diamonds(2, 4, 0.5)
    x = np.c_[points * [1.0, 1.1], np.zeros(len(points))]
    strain = 0.5 * (1.1**2 - 1)
    assert green_strains(points, triangles, x)[0] == pytest.approx(np.diag([0.0, strain]))
    assert green_strains(points, triangles, x, 45.0)[0] == pytest.approx(np.full((2, 2), strain / 2))


def sheared_zones() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points, triangles, and positions at which a thread along (1, 1) shears what it meets by a tenth of a radian.

    Threads along (1, −1) turn where the others end at free edges, that is where |x − y| < 0.25.
    """
    points, triangles = diamonds(8, 16, 0.5)
    c = points[:, 0] - points[:, 1]
    turned = np.clip(c, -0.25, 0.25)[:, None] * np.tan(0.1) * [-0.5, -0.5]
    return points, triangles, np.c_[points + turned, np.zeros(len(points))]


def test_the_zones_of_a_bias_extension() -> None:
    """A mean over zones that reach beyond their borders would be smaller."""
    points, triangles, x = sheared_zones()
    middle, beside = zones(points, triangles)
    assert thread_shear(points, triangles[middle], x) == pytest.approx(np.degrees(0.1), rel=1e-6)
    centers = points[triangles[beside]].mean(axis=1)
    turning = np.abs(centers[:, 0] - centers[:, 1]) < 0.25
    assert turning.sum() == (~turning).sum() > 20  # half of these zones along each thread
    assert thread_shear(points, triangles[beside][turning], x) == pytest.approx(np.degrees(0.1), rel=1e-6)
    assert thread_shear(points, triangles[beside][~turning], x) == pytest.approx(0.0, abs=1e-6)
    at_clamps = np.abs(points[triangles].mean(axis=1)[:, 1]) > 0.27 + np.abs(points[triangles].mean(axis=1)[:, 0])
    assert not ((middle | beside) & at_clamps).any()
    assert not (middle & beside).any()


@pytest.mark.parametrize(("angle", "verdicts"), [(26.1, [EXCELLENT, FAIL]), (13.05, [FAIL, EXCELLENT])])
def test_threads_that_turn_too_far_or_not_enough_fall_short(
    monkeypatch: pytest.MonkeyPatch, angle: float, verdicts: list[str]
) -> None:
    """One angle everywhere is right in one zone only."""
    monkeypatch.setattr(continuum, "EXTENSIONS", (0.2,))
    monkeypatch.setattr(continuum, "advance", lambda simulation, seconds: None)
    monkeypatch.setattr(continuum, "thread_shear", lambda *cloth: angle)
    assert [row.verdict for row in continuum.extended(["middle", "beside"], "explicit")] == verdicts


def patched(monkeypatch: pytest.MonkeyPatch, moved: float, force: float) -> list[Check]:
    """Rows of a patch whose middle particle is off by `moved` [m], and whose reactions are off by a factor."""

    def at_rest(simulation: Simulation, start: np.ndarray) -> np.ndarray:
        x = start.copy()
        x[len(x) // 2, 0] += moved
        return x

    def reactions(simulation: Simulation) -> np.ndarray:
        right = np.isclose(simulation.topology.start[:, 0], 0.5)
        traction = continuum.first_piola(gradient, TENSOR)[:, 0]
        return force * right[:, None] / right.sum() * np.array([*traction, 0.0])

    gradient = np.array(continuum.GRADIENTS["sheared by 10 %"])
    monkeypatch.setattr(continuum, "at_rest", at_rest)
    monkeypatch.setattr(continuum, "mean_reactions", reactions)
    return list(continuum.patched(["strain", "force"], "explicit", gradient))


@pytest.mark.parametrize(
    ("moved", "force", "verdicts"),
    [(0.0, 1.0, [EXCELLENT, EXCELLENT]), (2e-5, 1.0, [FAIL, EXCELLENT]), (0.0, 1.0002, [EXCELLENT, FAIL])],
)
def test_a_patch_falls_short_by_its_strain_or_its_force(
    monkeypatch: pytest.MonkeyPatch, moved: float, force: float, verdicts: list[str]
) -> None:
    assert [row.verdict for row in patched(monkeypatch, moved, force)] == verdicts


@pytest.mark.parametrize(("factor", "verdict"), [(1.0, EXCELLENT), (1.03, FAIL)])
def test_a_strip_that_is_too_stiff_falls_short(monkeypatch: pytest.MonkeyPatch, factor: float, verdict: str) -> None:
    def advance(simulation: Simulation, seconds: float) -> None:
        """Stretch every row by what hangs below it: P = λ·E·(λ² − 1)/2."""
        mass = simulation.topology.mass.reshape(continuum.STRIP_ROWS, -1).sum(axis=1)
        pull = mass[::-1].cumsum()[::-1][1:] * continuum.PULL_GRAVITY / continuum.STRIP_WIDTH
        stretch = np.ones(len(pull))
        for _ in range(60):
            stretch = np.sqrt(1 + 2 * pull / (stretch * factor * strip_modulus(TENSOR, 90.0)))
        x = simulation.topology.start.reshape(continuum.STRIP_ROWS, -1, 3).copy()
        x[1:, :, 1] = x[0, 0, 1] - np.cumsum(stretch / len(stretch))[:, None]
        simulation.set_state(x.reshape(-1, 3))

    monkeypatch.setattr(continuum, "advance", advance)
    assert continuum.pulled("", "explicit", 90.0).verdict == verdict


@pytest.mark.parametrize(("factor", "verdict"), [(1.0, EXCELLENT), (1.04, FAIL)])
def test_a_frame_that_needs_too_much_force_falls_short(
    monkeypatch: pytest.MonkeyPatch, factor: float, verdict: str
) -> None:
    """A sheet as it is, whose reactions are those of the closed form, at two opposite corners."""
    angle = np.radians(30.0)

    def reactions(simulation: Simulation) -> np.ndarray:
        flat, half = simulation.topology.start, angle / 2
        growth = np.array([[-np.sin(half), np.cos(half)], [np.cos(half), -np.sin(half)]]) / 2
        forces = np.zeros_like(flat)
        corner = growth @ flat[0, :2]
        work = picture_frame_force(angle) * np.sin(np.pi / 4 - half) * continuum.SOFT
        forces[0, :2] = factor * work * corner / (corner @ corner)
        return forces

    monkeypatch.setattr(continuum, "at_rest", lambda simulation, start: start)
    monkeypatch.setattr(continuum, "mean_reactions", reactions)
    assert continuum.framed("", "explicit", angle).verdict == verdict


@pytest.mark.parametrize("solver", ["implicit", "xpbd"])
def test_a_strip_along_the_weft_droops_in_the_usual_layout(solver: str) -> None:
    """A matrix without the bending of a membrane let `implicit` droop by 2 % too far."""
    for row in continuum.drooped(["drop", "reach"], solver, True, continuum.BENDING["weft"]):
        assert row.verdict == EXCELLENT


@pytest.mark.parametrize("changed", ["warp", "weft"])
def test_a_strip_that_bends_otherwise_falls_short(monkeypatch: pytest.MonkeyPatch, changed: str) -> None:
    real = continuum.base

    def stiffer(*arguments: object, **keys: object):  # type: ignore[no-untyped-def]
        scene = real(*arguments, **keys)  # type: ignore[arg-type]
        return replace(scene, forces=replace(scene.forces, gravity=9.81 * 0.9))

    monkeypatch.setattr(continuum, "base", stiffer)
    rows = continuum.drooped(["drop", "reach"], "explicit", changed == "weft", continuum.BENDING[changed])
    assert FAIL in [row.verdict for row in rows]


def test_every_solver_with_membranes_is_measured() -> None:
    from taichi_cloth.evaluation.validate.references import REFERENCES

    found: dict[str, Callable[..., object]] = {one.number: one.run for one in REFERENCES if one.number.startswith("A9")}
    woven = found.pop("A9.8")
    assert [one.solvers for one in REFERENCES if one.run is woven] == [("explicit", "rk4")]
    assert list(found) == ["A9.1", "A9.2", "A9.3", "A9.4", "A9.5", "A9.7"]
    assert {one.solvers for one in REFERENCES if one.number in found} == {("xpbd", "explicit", "rk4", "implicit")}
