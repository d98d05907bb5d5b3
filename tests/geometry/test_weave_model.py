"""The weave in float64: forces are slopes of the energy, strips have the typed curves, and the bound holds."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from taichi_cloth.geometry.cloth_builder import build_topology
from taichi_cloth.geometry.membrane_model import MAX_STRAIN
from taichi_cloth.geometry.spring_model import spring_model
from taichi_cloth.geometry.stability_bounds import max_frequency
from taichi_cloth.geometry.weave_model import KINK_MARGIN, MIN_STRETCH, WeaveModel, piecewise_linear
from taichi_cloth.scene.fabric_schema import Fabric, Weave
from taichi_cloth.scene.schema import Cloth, Maps, Scene

CURVES = {
    "warp": ((0.02, 10.0), (0.05, 100.0)),  # [N/m]: crimp first, then the yarns themselves
    "weft": ((0.04, 12.0), (0.06, 30.0), (0.1, 150.0)),
    "shear": ((1.0, 0.5), (8.0, 1.6), (20.0, 8.0)),  # [degrees], [N/m]: friction first, then jamming
    "bending_warp": ((20.0, 2e-4), (200.0, 1e-3)),  # [1/m], [N]
    "bending_weft": ((50.0, 2e-4),),
}
ROWS, COLUMNS, WIDTH, HEIGHT = 7, 9, 1.2, 0.9
CELL_WIDTH, CELL_HEIGHT = WIDTH / (COLUMNS - 1), HEIGHT / (ROWS - 1)


def sheet(curves: dict[str, Any] | None = None, **fabric: Any) -> Scene:
    cloth = Cloth(rows=ROWS, columns=COLUMNS, width=WIDTH, height=HEIGHT, center=(0.0, 0.0, 0.0))
    keys = {"model": "weave", "bend_spring": 0.0} | fabric
    return Scene(cloth=cloth, fabric=Fabric(**keys), weave=Weave(**(CURVES if curves is None else curves)))


def woven(curves: dict[str, Any] | None = None, **fabric: Any) -> tuple[WeaveModel, np.ndarray]:
    """Return the weave of a sheet, and its flat positions, (3, N)."""
    topology = build_topology(sheet(curves, **fabric), "fabric")
    assert isinstance(topology.membrane, WeaveModel)
    return topology.membrane, topology.flat.T.copy()


def rotated(x: np.ndarray) -> np.ndarray:
    """Turn positions about an axis that is none of the coordinate axes."""
    rotation = np.linalg.qr(np.random.default_rng(4).normal(size=(3, 3)))[0]
    return rotation @ x


@settings(max_examples=25)
@given(
    seed=st.integers(0, 10**6),
    scale=st.sampled_from([1e-3, 1e-2, 5e-2, 0.3]),
    stretch=st.floats(0.05, 1.2),
    compression=st.sampled_from([1.0, 0.25, 0.0]),
)
def test_forces_are_minus_the_gradient_of_the_energy(
    seed: int, scale: float, stretch: float, compression: float
) -> None:
    """Also of crumpled cloth, and of threads that are pressed to less than `MIN_STRETCH` of their length."""
    weave, flat = woven(compression=compression)
    random = np.random.default_rng(seed)
    x = rotated(flat * stretch) + random.normal(scale=scale, size=flat.shape)
    force, step = weave.force(x), 1e-7
    direction = random.normal(size=flat.shape)
    direction /= np.linalg.norm(direction)
    slope = (weave.energy(x + step * direction) - weave.energy(x - step * direction)) / (2 * step)
    size = np.linalg.norm(force)
    assert -(force * direction).sum() == pytest.approx(slope, rel=1e-4, abs=1e-5 * size + 1e-7)


def test_the_energy_of_short_threads_is_continuous() -> None:
    weave, flat = woven()
    energies = [weave.energy(flat * (MIN_STRETCH + shift)) for shift in (-1e-9, 1e-9)]
    assert energies[0] == pytest.approx(energies[1], rel=1e-7)


@pytest.mark.parametrize("strain", [0.01, 0.03, 0.055, 0.2])
def test_a_pulled_strip_has_the_typed_curve(strain: float) -> None:
    weave, flat = woven()
    for name, axis, width in (("warp", 1, WIDTH), ("weft", 0, HEIGHT)):
        x = flat.copy()
        x[axis] *= 1 + strain
        ends = flat[axis] > flat[axis].max() - 1e-9
        (x0, y0), (x1, y1) = CURVES[name][-2:]
        points = np.array(((0.0, 0.0), *CURVES[name]))
        expected = np.interp(strain, *points.T) if strain < x1 else y1 + (y1 - y0) / (x1 - x0) * (strain - x1)
        assert -weave.force(x)[axis, ends].sum() / width == pytest.approx(expected, rel=1e-9)


def test_a_compressed_strip_has_the_first_slope_times_compression() -> None:
    for compression in (1.0, 0.25, 0.0):
        weave, flat = woven(compression=compression)
        top = flat[1] > flat[1].max() - 1e-9
        force = weave.force(flat * [[1.0], [0.97], [1.0]])[1, top].sum()
        assert force / WIDTH == pytest.approx(compression * 0.03 * 10.0 / 0.02, rel=1e-9)


@pytest.mark.parametrize("degrees", [0.5, 5.0, 15.0, 30.0, -5.0])
def test_a_sheared_sheet_has_the_moment_at_all_crossings(degrees: float) -> None:
    """Threads turn without a change of length: the energy is that of the moment, and its slope the moment."""
    weave, flat = woven({**CURVES, "bending_warp": (), "bending_weft": ()})

    def energy(degrees: float) -> float:
        angle = np.radians(degrees)
        return weave.energy(np.array([[1.0, np.sin(angle), 0.0], [0.0, np.cos(angle), 0.0], [0.0, 0.0, 1.0]]) @ flat)

    step = 1e-4
    slope = (energy(degrees + step) - energy(degrees - step)) / np.radians(2 * step)
    points = np.array(((0.0, 0.0), *CURVES["shear"]))
    after = 8.0 + (8.0 - 1.6) / 12 * (abs(degrees) - 20)
    expected = np.interp(abs(degrees), *points.T) if abs(degrees) < 20 else after
    assert slope / (WIDTH * HEIGHT) == pytest.approx(np.sign(degrees) * expected, rel=1e-6)


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("radius", [0.1, 0.2, 1.0])
def test_a_strip_on_a_circle_has_the_moment_of_its_curvature(axis: int, radius: float) -> None:
    """Particles on a circle, a cell apart: κ = 1/R exactly. The energy is ∫M dκ for every length with a particle."""
    weave, flat = woven()
    side, count = (CELL_HEIGHT, ROWS) if axis == 0 else (CELL_WIDTH, COLUMNS)
    along = flat[1 - axis]
    turn = 2 * np.arcsin(side / (2 * radius)) * along / side  # of a chord of one cell
    x = flat.copy()
    x[1 - axis], x[2] = radius * np.sin(turn), radius * (1 - np.cos(turn))
    curve = piecewise_linear(CURVES[("bending_warp", "bending_weft")[axis]])
    expected = float(curve.integral(np.array([1 / radius]))[0])
    width = WIDTH if axis == 0 else HEIGHT
    assert weave.energy(x) == pytest.approx(expected * width * side * (count - 2), rel=1e-9)


def test_a_bent_strip_needs_the_moment_at_its_ends() -> None:
    """The force on an end, times the segment, is the moment M per width, to second order in the angle."""
    weave, flat = woven({**CURVES, "bending_weft": ()})
    radius = 1.0
    turn = 2 * np.arcsin(CELL_HEIGHT / (2 * radius)) * flat[1] / CELL_HEIGHT
    x = flat.copy()
    x[1], x[2] = radius * np.sin(turn), radius * (1 - np.cos(turn))
    ends = flat[1] > flat[1].max() - 1e-9
    moment = np.linalg.norm(weave.force(x)[:, ends].sum(axis=1)) * CELL_HEIGHT / WIDTH
    assert moment == pytest.approx(2e-4 / 20.0 / radius, rel=CELL_HEIGHT**2 / radius**2)


@pytest.mark.parametrize("compression", [1.0, 0.0])
def test_motion_as_a_rigid_body_has_no_force(compression: float) -> None:
    weave, flat = woven(compression=compression)
    assert np.abs(weave.force(rotated(flat) + 3.0)).max() < 1e-9
    assert abs(weave.energy(rotated(flat) + 3.0)) < 1e-12


def test_damping_is_the_change_of_tension_and_takes_energy() -> None:
    weave, flat = woven({**CURVES, "bending_warp": (), "bending_weft": ()})
    random = np.random.default_rng(2)
    x, v = rotated(flat) + random.normal(scale=0.003, size=flat.shape), random.normal(size=flat.shape)
    assert (weave.damper_force(x, v, 0.02) * v).sum() < 0
    rigid = np.cross([0.3, -0.2, 0.5], x.T).T + 1.0
    assert np.abs(weave.damper_force(x, rigid, 0.02)).max() < 1e-9
    step, stretched = 1e-7, rotated(flat * 1.03)
    change = (weave.force(stretched * (1 + step)) - weave.force(stretched * (1 - step))) / (2 * step)
    assert weave.damper_force(stretched, stretched, 0.02) == pytest.approx(0.02 * change, abs=1e-5)


def test_threads_on_edges_represent_half_a_cell() -> None:
    weave, _ = woven()
    assert weave.area.sum() == pytest.approx(WIDTH * HEIGHT)
    for axis, width, count in ((0, WIDTH, ROWS), (1, HEIGHT, COLUMNS)):
        assert weave.bends.width[weave.bends.axis == axis].sum() == pytest.approx(width * (count - 2))
    assert set(np.unique(np.diff(weave.bends.corners, axis=1))) == {1, COLUMNS}


def test_layers_are_separate() -> None:
    scene = sheet()
    layered = replace(scene, cloth=replace(scene.cloth, layers=3, layer_spacing=0.1, layer_rotation=30.0))
    one, three = (build_topology(of, "fabric").membrane for of in (scene, layered))
    assert isinstance(one, WeaveModel)
    assert isinstance(three, WeaveModel)
    layer = three.bends.corners // (ROWS * COLUMNS)
    assert (layer == layer[:, :1]).all()
    assert len(three.bends.width) == 3 * len(one.bends.width)
    assert np.sort(three.bends.width) == pytest.approx(np.sort(np.tile(one.bends.width, 3)))
    topology = build_topology(layered, "fabric")
    assert np.abs(three.force(topology.start.T)).max() < 1e-3  # starts are rounded to float32


def test_maps_and_the_factor_scale_all_energies(tmp_path: Any) -> None:
    (tmp_path / "half.csv").write_text("0.5\n" * (ROWS * COLUMNS))
    scene = sheet()
    mapped = replace(scene, maps=Maps(stiffness="half.csv", folder=str(tmp_path)))
    soft = replace(scene, solver=replace(scene.solver, stiffness=0.5))
    x = rotated(spring_model(scene).start) + np.random.default_rng(0).normal(scale=0.01, size=(3, ROWS * COLUMNS))
    forces = [spring_model(one).elastic_force(x) for one in (scene, mapped, soft)]
    assert forces[1] == pytest.approx(forces[0] / 2)
    assert forces[2] == pytest.approx(forces[0] / 2)


def fastest(weave: WeaveModel, x: np.ndarray, mass: np.ndarray) -> float:
    """Return the angular frequency of the fastest vibration about positions (3, N) [radians/s]."""
    size, step = x.size, 1e-7
    stiffness = np.empty((size, size))
    for k in range(size):
        shift = np.zeros(size)
        shift[k] = step
        moved = [weave.force(x + sign * shift.reshape(x.shape)) for sign in (1, -1)]
        stiffness[k] = (moved[1] - moved[0]).reshape(-1) / (2 * step)
    root = 1 / np.sqrt(np.tile(mass, 3))
    return float(np.sqrt(np.linalg.eigvalsh(root[:, None] * (stiffness + stiffness.T) / 2 * root).max()))


def free(scene: Scene) -> tuple[WeaveModel, np.ndarray, np.ndarray, float]:
    """Return the weave without pins, its start, its masses and the bound of its frequencies."""
    topology = build_topology(replace(scene, cloth=replace(scene.cloth, pins=())), "fabric")
    assert isinstance(topology.membrane, WeaveModel)
    bound = max_frequency(topology, np.zeros(topology.spring_count), topology.membrane)
    return topology.membrane, topology.start.T, topology.mass, bound


@pytest.mark.parametrize("steep", ["warp", "shear", "bending_weft"])
def test_no_vibration_is_faster_than_the_bound(steep: str) -> None:
    """With one curve much steeper than the others, flat and crumpled; in tension along the warp it is nearly met."""
    soft = {"warp": ((0.1, 1.0),), "weft": ((0.1, 1.0),), "shear": ((10.0, 0.1),)}
    steeper = {
        "warp": ((0.02, 10.0), (0.09, 200.0)),
        "shear": ((1.0, 5.0), (20.0, 30.0)),
        "bending_weft": ((10.0, 1.0),),
    }
    weave, start, mass, bound = free(sheet({**soft, steep: steeper[steep]}))
    found = []
    for seed, scale in ((0, 0.0), (1, 1e-3), (2, 5e-3)):
        x = rotated(start * [[1.0], [1 + (0.99 * MAX_STRAIN if steep == "warp" else 0.0)], [1.0]])
        x = x + np.random.default_rng(seed).normal(scale=scale, size=start.shape)
        stretches = np.concatenate([np.linalg.norm(f, axis=0) for f in weave.gradient(x)])
        x *= min(1.0, (1 + MAX_STRAIN) / stretches.max())
        found.append(fastest(weave, x, mass))
    assert max(found) <= bound / KINK_MARGIN
    assert max(found) > {"warp": 0.9, "shear": 0.4, "bending_weft": 0.7}[steep] * bound / KINK_MARGIN


def test_the_bound_counts_slopes_up_to_the_largest_strain() -> None:
    """A curve that is steep only beyond it does not shorten substeps."""
    late = {**CURVES, "warp": (*CURVES["warp"], (MAX_STRAIN + 0.01, 250.0), (0.2, 1e5))}
    early = {**CURVES, "warp": (*CURVES["warp"], (0.06, 250.0), (0.2, 1e5))}
    bounds = [free(sheet(curves))[3] for curves in (CURVES, late, early)]
    assert bounds[1] == pytest.approx(bounds[0])
    assert bounds[2] > 5 * bounds[0]
