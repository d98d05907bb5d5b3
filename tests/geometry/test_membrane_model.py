"""The membrane in float64: patch tests on irregular triangles, closed forms of its stiffness, and its energy."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from meshes import irregular

from taichi_cloth.geometry.cloth_builder import build_topology
from taichi_cloth.geometry.membrane_model import MAX_STRAIN, Membrane, shapes_of
from taichi_cloth.geometry.spring_model import spring_model
from taichi_cloth.geometry.stability_bounds import max_frequency
from taichi_cloth.scene.fabric_schema import Fabric
from taichi_cloth.scene.schema import Cloth, Scene

TENSOR = np.array([[2000.0, 300.0, 0.0], [300.0, 1500.0, 0.0], [0.0, 0.0, 500.0]])  # [N/m]
KEYS = {"c11": 2000.0, "c22": 1500.0, "c12": 300.0, "c66": 500.0}


def square(warp_angle: float = 0.0, compression: float = 1.0) -> tuple[Membrane, np.ndarray]:
    """Return a square membrane of irregular triangles with a side of 1 m, and its flat positions, (3, N)."""
    flat, faces = irregular(9, 0.2)
    inverse_shape, area = shapes_of(flat, faces, warp_angle)
    return Membrane(faces, inverse_shape, area, TENSOR, compression), flat.T


def sheet(**fabric: Any) -> Scene:
    keys = {"model": "membrane", "bend_spring": 0.0} | fabric
    return Scene(cloth=Cloth(rows=7, columns=9, width=1.2, height=0.9), fabric=Fabric(**keys))


def rotated(x: np.ndarray) -> np.ndarray:
    """Turn positions about an axis that is none of the coordinate axes."""
    rotation = np.linalg.qr(np.random.default_rng(4).normal(size=(3, 3)))[0]
    return rotation @ x


@pytest.mark.parametrize(
    "gradient", [[[1.1, 0.0], [0.0, 1.0]], [[1.0, 0.1], [0.0, 1.0]], [[1.01, 0.02], [-0.01, 0.99]]]
)
def test_all_triangles_of_an_affine_shape_have_the_same_strain(gradient: list[list[float]]) -> None:
    membrane, flat = square()
    f = np.array(gradient)  # of x and y
    x = rotated(np.vstack([f @ flat[:2], flat[2:]]))
    green = 0.5 * (f.T @ f - np.eye(2))
    expected = [green[1, 1], green[0, 0], 2 * green[0, 1]]  # warp is along y
    assert membrane.strain(x) == pytest.approx(np.tile(expected, (len(membrane.area), 1)).T, abs=1e-12)
    inside = np.abs(flat[:2]).max(axis=0) < 0.5 - 1e-9
    assert inside.sum() > 20
    assert np.abs(membrane.force(x)[:, inside]).max() < 1e-9


def test_the_energy_of_an_affine_shape_is_that_of_its_area() -> None:
    membrane, flat = square()
    stretched = flat * [[1.02], [1.05], [1.0]]
    e = np.array([0.5 * (1.05**2 - 1), 0.5 * (1.02**2 - 1), 0.0])
    assert membrane.energy(stretched) == pytest.approx(0.5 * e @ TENSOR @ e, rel=1e-12)


def test_motion_as_a_rigid_body_has_no_force() -> None:
    membrane, flat = square()
    assert np.abs(membrane.force(rotated(flat) + 3.0)).max() < 1e-9


@pytest.mark.parametrize(("angle", "compression"), [(0.0, 1.0), (30.0, 1.0), (0.0, 0.25), (-70.0, 0.5)])
def test_forces_are_minus_the_gradient_of_the_energy(angle: float, compression: float) -> None:
    membrane, flat = square(angle, compression)
    random = np.random.default_rng(1)
    x = rotated(flat * 1.03) + random.normal(scale=0.01, size=flat.shape)
    force, step = membrane.force(x), 1e-6
    for particle in random.integers(flat.shape[1], size=12):
        for axis in range(3):
            shift = np.zeros_like(x)
            shift[axis, particle] = step
            slope = (membrane.energy(x + shift) - membrane.energy(x - shift)) / (2 * step)
            assert force[axis, particle] == pytest.approx(-slope, rel=1e-5, abs=1e-5)


def test_damping_is_the_stress_of_the_rate_of_strain() -> None:
    """Forces of damping are those by which the stress changes in a motion, times the damping time over the time."""
    membrane, flat = square()
    v = np.random.default_rng(2).normal(size=flat.shape)
    step = 1e-7
    change = (membrane.force(flat + step * v) - membrane.force(flat - step * v)) / (2 * step)
    assert membrane.damper_force(flat, v, 0.02) == pytest.approx(0.02 * change, abs=1e-4)
    assert np.abs(membrane.damper_force(flat, np.ones_like(v), 0.02)).max() < 1e-9


@pytest.mark.parametrize("angle", [0.0, 90.0, 45.0, 20.0])
def test_a_wide_strip_has_the_stiffness_of_its_direction(angle: float) -> None:
    """1/E = S₁₁·cos⁴θ + S₂₂·sin⁴θ + (2·S₁₂ + S₆₆)·sin²θ·cos²θ with S = C⁻¹: along the warp C₁₁ − C₁₂²/C₂₂."""
    membrane, flat = square(angle)
    top, right = flat[1] > 0.5 - 1e-9, flat[0] > 0.5 - 1e-9
    strains = np.array([[[0, 0], [0, 1]], [[1, 0], [0, 0]], [[0, 0.5], [0.5, 0]]])  # of y, x, and shear
    tractions = []
    for strain in strains:
        force = membrane.force(np.vstack([(np.eye(2) + 1e-7 * strain) @ flat[:2], flat[2:]])) / -1e-7
        tractions.append([force[1, top].sum(), force[0, right].sum(), force[0, top].sum()])
    elongation = np.linalg.solve(np.transpose(tractions), [1.0, 0.0, 0.0])[0]
    s, sin, cos = np.linalg.inv(TENSOR), np.sin(np.radians(angle)), np.cos(np.radians(angle))
    expected = s[0, 0] * cos**4 + s[1, 1] * sin**4 + (2 * s[0, 1] + s[2, 2]) * sin**2 * cos**2
    assert elongation == pytest.approx(expected, rel=1e-5)
    if angle == 0.0:
        assert 1 / elongation == pytest.approx(2000 - 300**2 / 1500, rel=1e-5)


@pytest.mark.parametrize(("degrees", "expected"), [(10, 0.2660), (20, 0.5603), (30, 0.8660), (40, 1.1651)])
def test_a_picture_frame_needs_the_force_of_its_closed_form(degrees: float, expected: float) -> None:
    """Threads of constant length in a frame with side L: F = L·W′(γ)/sin(π/4 − γ/2), over L·C₆₆."""
    membrane, flat = square()

    def energy(gamma: float) -> float:  # threads turn towards each other by half of the angle each
        a = gamma / 2
        gradient = np.array([[np.cos(a), np.sin(a)], [np.sin(a), np.cos(a)]])
        return membrane.energy(np.vstack([gradient @ flat[:2], flat[2:]]))

    gamma, step = np.radians(degrees), 1e-5
    slope = (energy(gamma + step) - energy(gamma - step)) / (2 * step)  # [J] of 1 m²
    assert slope / np.sin(np.pi / 4 - gamma / 2) / KEYS["c66"] == pytest.approx(expected, rel=2e-4)


def test_a_grid_has_two_triangulations_of_half_weight() -> None:
    membrane = build_topology(sheet(**KEYS), "fabric").membrane
    assert membrane is not None
    assert len(membrane.area) == 4 * 6 * 8
    assert membrane.area.sum() == pytest.approx(1.2 * 0.9)
    sides = np.sort(membrane.corners[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    diagonal = {tuple(side) for side in sides if abs(int(side[0]) - int(side[1])) in (8, 10)}
    assert len(diagonal) == 2 * 6 * 8


def test_layers_are_separate() -> None:
    scene = sheet(**KEYS)
    layered = replace(scene, cloth=replace(scene.cloth, layers=3, layer_spacing=0.1, layer_rotation=30.0))
    one, three = (build_topology(of, "fabric").membrane for of in (scene, layered))
    assert one is not None
    assert three is not None
    particles = 7 * 9
    assert three.area == pytest.approx(np.tile(one.area, 3))
    assert (three.corners // particles).max(axis=1).tolist() == (three.corners // particles).min(axis=1).tolist()
    topology = build_topology(layered, "fabric")
    assert np.abs(three.force(topology.start.T)).max() < 1e-3  # starts are rounded to float32


def test_without_constants_small_strains_cost_what_those_of_springs_do() -> None:
    """On square cells C₁₁ = warp + shear, C₂₂ = weft + shear, and C₁₂ = C₆₆ = shear."""
    cloth = Cloth(rows=9, columns=9, width=1.0, height=1.0)
    springs, membrane = (
        Scene(cloth=cloth, fabric=Fabric(900.0, 700.0, 200.0, 0.0, model=model)) for model in ("springs", "membrane")
    )
    models = [spring_model(replace(scene, forces=replace(scene.forces, gravity=0.0))) for scene in (springs, membrane)]
    for gradient in ([[1.0, 0.0], [0.0, 1.0001]], [[1.0001, 0.0], [0.0, 1.0]], [[1.0, 1e-4], [0.0, 1.0]]):
        x = models[0].start.copy()
        x[:2] = np.array(gradient) @ x[:2]
        energies = [model.energy(x) for model in models]
        assert energies[1] == pytest.approx(energies[0], rel=1e-3)


def fastest(membrane: Membrane, x: np.ndarray, mass: np.ndarray) -> float:
    """Return the angular frequency of the fastest vibration about positions (3, N) [radians/s]."""
    size, step = x.size, 1e-6
    stiffness = np.empty((size, size))
    for k in range(size):
        shift = np.zeros(size)
        shift[k] = step
        moved = [membrane.force(x + sign * shift.reshape(x.shape)) for sign in (1, -1)]
        stiffness[k] = (moved[1] - moved[0]).reshape(-1) / (2 * step)
    root = 1 / np.sqrt(np.tile(mass, 3))
    return float(np.sqrt(np.linalg.eigvalsh(root[:, None] * (stiffness + stiffness.T) / 2 * root).max()))


def test_the_bound_is_met_in_tension_along_the_warp() -> None:
    scene = sheet(c11=2000.0, c22=20.0, c66=10.0)
    topology = build_topology(replace(scene, cloth=replace(scene.cloth, pins=())), "fabric")
    assert topology.membrane is not None
    x = topology.start.T * [[1.0], [1 + MAX_STRAIN], [1.0]]
    bound = max_frequency(topology, np.zeros(topology.spring_count), topology.membrane)
    assert 0.93 * bound < fastest(topology.membrane, x, topology.mass) <= bound


@pytest.mark.parametrize("seed", range(3))
def test_no_vibration_is_faster_than_the_bound(seed: int) -> None:
    """Of a crumpled sheet whose tension reaches the strain that the bound allows."""
    topology = build_topology(sheet(**KEYS), "fabric")
    topology = replace(topology, pinned=np.zeros(topology.particle_count, bool))
    membrane = topology.membrane
    assert membrane is not None
    x = rotated(topology.start.T) + np.random.default_rng(seed).normal(scale=0.004, size=topology.start.T.shape)
    stretch = np.sqrt(2 * membrane.strain(x)[:2].max() + 1) - 1
    x *= (1 + MAX_STRAIN) / (1 + stretch)
    assert 0.09 < np.sqrt(2 * membrane.strain(x)[:2].max() + 1) - 1 < MAX_STRAIN + 1e-9
    bound = max_frequency(topology, np.zeros(topology.spring_count), membrane)
    assert 0.5 * bound < fastest(membrane, x, topology.mass) <= bound


def test_triangles_across_the_weft_axis_have_a_warp_direction() -> None:
    flat = np.array([[0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    inverse_shape, area = shapes_of(flat, np.array([[0, 1, 2]]), 0.0)
    assert np.isfinite(inverse_shape).all()
    assert area == pytest.approx([0.5])
