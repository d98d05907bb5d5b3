"""`fabric.model = "weave"`: kernels against the float64 model, both solvers against the typed curves, and refusals."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import taichi as ti
from meshes import irregular, write_obj
from serial_kernels import check_elastic_forces

from taichi_cloth.geometry.scene_loader import load_scene
from taichi_cloth.geometry.spring_model import spring_model
from taichi_cloth.kernels.constraint_math import arcsine
from taichi_cloth.scene.fabric_schema import Fabric, Weave
from taichi_cloth.scene.schema import Cloth, Forces, Scene, Solver
from taichi_cloth.scene.solver_catalog import SOLVER_CATALOG
from taichi_cloth.simulation.builder import feature_names
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.system.errors import UsageError

FLAT_CURVES = {
    "warp": ((0.02, 10.0), (0.05, 100.0)),  # [N/m]
    "weft": ((0.04, 12.0), (0.06, 30.0), (0.1, 150.0)),
    "shear": ((1.0, 0.5), (8.0, 1.6), (20.0, 8.0)),  # [degrees], [N/m]
}
CURVES = {**FLAT_CURVES, "bending_warp": ((2.0, 2e-3), (20.0, 8e-3)), "bending_weft": ((5.0, 2e-3),)}
LAYOUTS = ("serial", "parallel", "simd")


def hung(solver: str = "explicit", curves: dict[str, Any] | None = None, **fabric: Any) -> Scene:
    """Return a sheet of 1 m that hangs by two corners."""
    cloth = Cloth(rows=9, columns=11, width=1.0, height=1.0, pins=("top-left", "top-right"))
    keys = {"model": "weave"} | fabric
    weave = Weave(**(FLAT_CURVES if curves is None else curves))
    return Scene(cloth=cloth, fabric=Fabric(**keys), weave=weave, solver=Solver(solver, damping=4.0))


@ti.kernel
def arcsines(x: ti.types.ndarray(), y: ti.types.ndarray()):
    for i in range(x.shape[0]):
        y[i] = arcsine(x[i])


def test_the_arcsine_is_that_of_numpy() -> None:
    x = np.concatenate([np.linspace(-1, 1, 20001), [1e-9, -1e-9, 1.0000001, 0.5, -0.5]]).astype(np.float32)
    y = np.zeros_like(x)
    arcsines(x, y)
    assert y == pytest.approx(np.arcsin(np.clip(x.astype(np.float64), -1, 1)), rel=3e-7, abs=1e-12)


@pytest.mark.parametrize("curves", [FLAT_CURVES, CURVES], ids=["flat", "bending"])
@pytest.mark.parametrize(("compression", "damping_time"), [(1.0, 0.0), (0.25, 0.0), (0.25, 0.01), (0.0, 0.0)])
@pytest.mark.parametrize("scale", [0.003, 0.05])
def test_kernel_forces_are_those_of_the_float64_model(
    curves: dict[str, Any], compression: float, damping_time: float, scale: float
) -> None:
    """Of crumpled cloth; the factor on the stiffness scales them."""
    random = np.random.default_rng(0)
    scene = hung(curves=curves, compression=compression, damping_time=damping_time)
    scene = replace(scene, solver=replace(scene.solver, stiffness=0.5))
    with Simulation(scene, "serial") as simulation:
        x = simulation.topology.start + random.normal(scale=scale, size=simulation.topology.start.shape)
        v = random.normal(scale=0.1, size=x.shape)
        simulation.set_state(x, v)
        check_elastic_forces(simulation)


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("keys", [{}, {"compression": 0.25, "damping_time": 0.001}], ids=["plain", "damped"])
def test_substeps_of_every_layout_have_the_float64_forces(layout: str, keys: dict[str, float]) -> None:
    """The steps of `explicit`, repeated in float64. 19 columns divide no strip of eight evenly."""
    scene = hung(curves=FLAT_CURVES if layout == "simd" else CURVES, **keys)
    scene = replace(
        scene,
        cloth=replace(scene.cloth, rows=12, columns=19, pins=()),
        solver=replace(scene.solver, damping=0.0),
        forces=Forces(gravity=0.0),
    )
    with Simulation(scene, layout) as simulation:
        shape = simulation.topology.start.shape
        simulation.set_state(
            simulation.topology.start + np.random.default_rng(3).normal(scale=2e-3, size=shape),
            np.random.default_rng(4).normal(scale=0.2, size=shape),
        )
        start, v = simulation.positions(), simulation.velocities().T
        found: list[np.ndarray] = []
        simulation.step_by_substep(lambda _: found.append(simulation.positions()))
        model = replace(spring_model(scene, simulation.topology), damping_time=simulation.built.damping_time)
    x, h = start.T.copy(), simulation.h
    for s, positions in enumerate(found):
        force = model.elastic_force(x) + model.damping_force(x, v)
        v = v + (0.5 if s == 0 else 1.0) * h * force / model.mass
        x = x + h * v
        assert positions == pytest.approx(x.T, abs=2e-6 * (s + 1))
    assert np.abs(x.T - start).max() > 1e-3


@pytest.mark.parametrize("solver", ["explicit", "rk4"])
@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("keys", [{}, {"compression": 0.25, "damping_time": 0.001}], ids=["plain", "damped"])
def test_all_layouts_move_alike(solver: str, layout: str, keys: dict[str, float]) -> None:
    scene = hung(solver, FLAT_CURVES if layout == "simd" else CURVES, **keys)
    scene = replace(scene, cloth=replace(scene.cloth, rows=11, columns=19, rotation=(50.0, 20.0, 0.0)))
    found = []
    for one in ("serial", layout):
        with Simulation(scene, one) as simulation:
            shape = simulation.topology.start.shape
            simulation.set_state(simulation.topology.start + np.random.default_rng(3).normal(scale=2e-3, size=shape))
            simulation.step(2)
            found.append(simulation.positions())
    assert np.abs(found[0] - simulation.topology.start).max() > 5e-3
    assert found[1] == pytest.approx(found[0], abs=1e-5)


@pytest.mark.parametrize("layout", ["serial", "parallel"])
def test_layers_bend_as_one_sheet_does(layout: str) -> None:
    scene = hung(curves=CURVES)
    scene = replace(scene, cloth=replace(scene.cloth, pins=("top",), rotation=(70.0, 0.0, 0.0)))
    with Simulation(scene, "serial") as simulation:
        simulation.step(20)
        one = simulation.positions() - simulation.topology.start
    layered = replace(scene, cloth=replace(scene.cloth, layers=2, layer_spacing=0.3))
    with Simulation(layered, layout) as simulation:
        simulation.step(20)
        both = (simulation.positions() - simulation.topology.start).reshape(2, -1, 3)
    assert both == pytest.approx(np.stack([one, one]), abs=1e-4)


@pytest.mark.parametrize("solver", ["explicit", "rk4"])
def test_a_strip_settles_at_the_strain_of_its_curve(solver: str) -> None:
    """Two threads carry weights: every segment has the strain at which the typed tension is its load."""
    cloth = Cloth(5, 2, 0.1, 0.4, pins=("top",), area_density=0.01, corner_mass=0.1)
    scene = replace(hung(solver), cloth=cloth, solver=Solver(solver, damping=10.0))
    with Simulation(scene, "serial") as simulation:
        simulation.step(300)
        x, mass = simulation.positions().reshape(5, 2, 3), simulation.topology.mass.reshape(5, 2)
        assert np.abs(simulation.velocities()).max() < 5e-3
    strains = (x[:-1, :, 1] - x[1:, :, 1]) / 0.1 - 1
    tensions = 9.81 * np.cumsum(mass[::-1], axis=0)[-2::-1] / 0.05
    expected = np.interp(tensions, *np.array(((0.0, 0.0), *FLAT_CURVES["warp"])).T[::-1])
    assert expected.min() > 0.02  # beyond the first point
    assert strains == pytest.approx(expected, rel=3e-3)


@pytest.mark.parametrize("solver", ["explicit", "rk4"])
@pytest.mark.parametrize("curves", [FLAT_CURVES, CURVES], ids=["flat", "bending"])
def test_the_energy_hardly_grows_without_damping(solver: str, curves: dict[str, Any]) -> None:
    """By less than 2 % in a second, from a crumpled state (`KINK_MARGIN`)."""
    scene = hung(solver, curves)
    scene = replace(scene, solver=replace(scene.solver, damping=0.0))
    with Simulation(scene, "serial") as simulation:
        model = spring_model(scene, simulation.topology)
        random = np.random.default_rng(5)
        simulation.set_state(simulation.topology.start + random.normal(scale=2e-3, size=simulation.positions().shape))

        def energy() -> float:
            v = simulation.velocities().T
            return model.energy(simulation.positions().T) + 0.5 * float(model.mass @ (v * v).sum(axis=0))

        start = energy()
        total = [abs(start)]
        for _ in range(60):
            simulation.step()
            total.append(energy())
        assert max(total[1:]) < 1.02 * start


@pytest.mark.parametrize("solver", ["explicit", "rk4"])
@pytest.mark.parametrize("layout", LAYOUTS)
def test_crushed_cloth_keeps_its_numbers(solver: str, layout: str) -> None:
    """Particles at one point, threads on top of each other, and then a recovery."""
    scene = hung(solver, FLAT_CURVES if layout == "simd" else CURVES, compression=0.5)
    scene = replace(scene, cloth=replace(scene.cloth, pins=()), forces=Forces(gravity=0.0))
    with Simulation(scene, layout) as simulation:
        start = simulation.topology.start
        for factors in ([0.0, 0.0, 0.0], [0.0, 1.0, 1.0], [1e-6, 1e-6, 1.0], [0.05, 0.3, 1.0], [1.0, -1.0, 1.0]):
            center = start.mean(axis=0)
            simulation.set_state(center + (start - center) * factors)
            simulation.step(3)
            assert np.isfinite(simulation.positions()).all()
        sheared = start.copy()
        sheared[:, 0] = sheared[:, 0] + (start - center)[:, 1] * 0.999
        sheared[:, 1] = sheared[:, 1] * 0.001
        simulation.set_state(sheared)
        simulation.step(10)
        assert np.isfinite(simulation.positions()).all()


def test_a_sheet_without_gravity_stays_as_it_is() -> None:
    for layout in LAYOUTS:
        scene = hung(curves=FLAT_CURVES if layout == "simd" else CURVES)
        with Simulation(replace(scene, forces=Forces(gravity=0.0)), layout) as simulation:
            simulation.step(5)
            assert simulation.positions() == pytest.approx(simulation.topology.start, abs=1e-6)


def test_bending_curves_hold_a_strip_that_others_let_hang() -> None:
    drops = []
    for curves in (FLAT_CURVES, {**FLAT_CURVES, "bending_warp": ((1.0, 0.02),)}):
        scene = hung(curves=curves)
        cloth = Cloth(11, 3, 0.1, 0.3, pins=tuple(range(6)), rotation=(-90.0, 0.0, 0.0), area_density=0.1)
        with Simulation(replace(scene, cloth=cloth, solver=Solver("explicit", damping=5.0)), "serial") as simulation:
            simulation.step(120)
            drops.append(float((simulation.topology.start - simulation.positions())[-3:, 1].mean()))
    assert drops[0] > 0.2
    # A clamped beam with B = 0.02 N·m and w = 0.98 N/m² over L = 0.27 m + half a link: w·L⁴/(8·B).
    assert drops[1] == pytest.approx(0.1 * 9.81 * 0.285**4 / (8 * 0.02), rel=0.05)


# -- refusals ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("solver", [name for name, info in SOLVER_CATALOG.items() if "weave" not in info.models])
def test_other_solvers_are_refused(solver: str) -> None:
    with pytest.raises(UsageError) as raised:
        Simulation(hung(solver))
    assert str(raised.value) == f'{solver} does not support fabric.model = "weave"; use explicit, rk4'


def test_curves_of_bending_need_a_layout_that_gathers() -> None:
    with pytest.raises(UsageError, match=r"layout simd is not supported: threads of a weave bend by weave"):
        Simulation(hung(curves=CURVES), "simd")
    with Simulation(hung(curves=CURVES)) as simulation:
        assert simulation.solver.layout_name == "serial"
        assert feature_names(simulation.solver.features) == ["weave"]


def test_a_mesh_is_refused(tmp_path: Path) -> None:
    mesh = write_obj(tmp_path / "irregular.obj", *irregular(9, 0.2))
    scene = replace(hung(), cloth=Cloth(file=mesh.name, folder=str(tmp_path)))
    with pytest.raises(ValueError, match=r"fabric\.model:? a weave needs a grid, but cloth\.file names a mesh"):
        load_scene(scene)
