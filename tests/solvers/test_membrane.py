"""`fabric.model = "membrane"`: kernels against the float64 membrane, all solvers against each other, and refusals."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import taichi as ti
from meshes import irregular, write_obj
from serial_kernels import NO_COLLIDER, check_elastic_forces, frame_params, run_serially

from taichi_cloth.geometry.scene_loader import load_scene
from taichi_cloth.geometry.spring_model import spring_model
from taichi_cloth.kernels.conjugate_gradient import add_stiffness_products
from taichi_cloth.kernels.membrane_constraints import solve_membrane
from taichi_cloth.scene import SceneError
from taichi_cloth.scene.fabric_schema import Fabric
from taichi_cloth.scene.schema import Cloth, Forces, Maps, Scene, Solver, StrainLimit, Tearing
from taichi_cloth.scene.solver_catalog import SOLVER_CATALOG
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.system.errors import UsageError

TENSOR = {"c11": 900.0, "c22": 600.0, "c12": 200.0, "c66": 150.0}  # [N/m]
SOLVERS = [name for name, info in SOLVER_CATALOG.items() if "membrane" in info.models and info.uses_si_constants]


def hung(solver: str = "explicit", *, mesh: Path | None = None, **fabric: Any) -> Scene:
    """Return a sheet of 1 m that hangs by two corners."""
    cloth = Cloth(rows=9, columns=9, width=1.0, height=1.0, pins=("top-left", "top-right"))
    if mesh is not None:
        cloth = Cloth(file=mesh.name, folder=str(mesh.parent), pins=(86, 94))
    keys = {"model": "membrane", **TENSOR, "bending_stiffness": 1e-4} | fabric
    return Scene(cloth=cloth, fabric=Fabric(**keys), solver=Solver(solver, damping=4.0))


@pytest.fixture
def mesh(tmp_path: Path) -> Path:
    return write_obj(tmp_path / "irregular.obj", *irregular(9, 0.2))


@pytest.mark.parametrize("compression", [1.0, 0.25])
@pytest.mark.parametrize("damping_time", [0.0, 0.05])
def test_kernel_forces_are_those_of_the_float64_membrane(mesh: Path, compression: float, damping_time: float) -> None:
    random = np.random.default_rng(0)
    angle = 0.0 if compression == 1.0 else 25.0
    keys = {"compression": compression, "damping_time": damping_time, "warp_angle": angle}
    for scene in (hung(**keys), hung(mesh=mesh, **keys)):
        with Simulation(scene, "serial") as simulation:
            x = simulation.topology.start + random.normal(scale=0.01, size=simulation.topology.start.shape)
            v = random.normal(scale=0.1, size=x.shape)
            simulation.set_state(x, v)
            check_elastic_forces(simulation)


@ti.func
def elastic_products(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    add_stiffness_products(cloth, features, ctx.params, ctx.h)


@pytest.mark.parametrize("crumpled", [False, True])
def test_the_product_is_the_change_of_the_force(mesh: Path, crumpled: bool) -> None:
    """In tension, and with less stiffness but never a negative one in compression."""
    random, h = np.random.default_rng(1), 1e-3
    scene = hung("implicit", mesh=mesh, bending_stiffness=0.0)
    with Simulation(scene, "serial") as simulation:
        x = simulation.topology.start * (1.0 if crumpled else 1.05)
        x += random.normal(scale=0.03 if crumpled else 0.0005, size=x.shape)
        d = random.normal(size=x.shape)
        simulation.set_state(x)
        layout = simulation.solver.layout
        for field, values in ((layout.cg.direction, d), (layout.cg.product, 0.0 * d)):
            rows = np.zeros((field.shape[0], 3), np.float32)
            rows[: len(d)] = values
            field.from_numpy(rows)
        run_serially(
            elastic_products, layout, simulation.solver.features, 0, 1, h, 0, frame_params(simulation), NO_COLLIDER
        )
        found = simulation.solver.cloth.to_numpy(layout.cg.product)
        model, y, step = spring_model(scene, simulation.topology), simulation.positions().T, 1e-6
        exact = -(model.elastic_force(y + step * d.T) - model.elastic_force(y - step * d.T)).T / (2 * step) * h**2
    if crumpled:
        assert (found * d).sum() > (exact * d).sum()
    else:
        assert found == pytest.approx(exact, abs=1e-3 * np.abs(exact).max())


@ti.func
def membrane_constraints(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    solve_membrane(cloth, features, ctx.params, ctx.h)


@pytest.mark.parametrize("damping_time", [0.0, 0.1])
@pytest.mark.parametrize("compression", [0.5, 0.0])
def test_one_projection_is_that_of_a_float64_solution(tmp_path: Path, compression: float, damping_time: float) -> None:
    """Of a single triangle, with another mass at every corner and multipliers from an earlier iteration."""
    flat = np.array([[0.0, 0.0, 0.0], [1.0, 0.2, 0.0], [0.3, 0.9, 0.0]])
    write_obj(tmp_path / "one.obj", flat, [[0, 1, 2]])
    h, damping_steps, multiplier = 0.1, damping_time / 0.1, np.array([0.02, -0.01, 0.03])
    keys = {"model": "membrane", **TENSOR, "compression": compression, "damping_time": damping_time}
    scene = Scene(cloth=Cloth(file="one.obj", folder=str(tmp_path)), fabric=Fabric(**keys), solver=Solver("xpbd"))
    with Simulation(scene, "serial") as simulation:
        membrane, layout = simulation.topology.membrane, simulation.solver.layout
        assert membrane is not None
        x = np.array([[0.0, 0.0, 0.0], [1.1, 0.2, 0.1], [0.8, 0.8, -0.1]])  # sheared
        before = x + np.random.default_rng(2).normal(scale=0.01, size=x.shape)
        w = np.array([3.0, 5.0, 2.0])
        simulation.solver.cloth.upload_positions(x, before, w)
        rows = np.zeros((layout.membrane.multiplier.shape[0], 3), np.float32)
        rows[0] = multiplier
        layout.membrane.multiplier.from_numpy(rows)
        params = frame_params(simulation)
        run_serially(membrane_constraints, layout, simulation.solver.features, 0, 1, h, 0, params, NO_COLLIDER)
        found = simulation.solver.cloth.to_numpy(layout.x)
    strain, step = membrane.strain(x.T)[:, 0], 1e-6
    slopes = np.zeros((3, 9))  # of the strains by the coordinates
    for k in range(9):
        shift = np.zeros(9)
        shift[k] = step
        ends = [membrane.strain(x.T + sign * shift.reshape(3, 3).T)[:, 0] for sign in (1, -1)]
        slopes[:, k] = (ends[0] - ends[1]) / (2 * step)
    root = np.diag(np.where(strain < 0, np.sqrt(compression), 1.0) * [1.0, 1.0, 0.0] + [0.0, 0.0, 1.0])
    k = h**2 * membrane.area[0] * root @ membrane.tensor @ root
    g = slopes * np.repeat(w, 3) @ slopes.T
    growth = slopes @ (x - before).reshape(-1)
    left = k @ g * (1 + damping_steps) + np.eye(3)
    change = np.linalg.solve(left, -k @ (strain + damping_steps * growth) - multiplier)
    expected = x + (np.repeat(w, 3) * (slopes.T @ change)).reshape(3, 3)
    assert np.abs(expected - x).max() > 1e-3
    assert found == pytest.approx(expected, abs=2e-6)


def test_a_flattened_triangle_opens_to_its_shape_and_not_beyond(tmp_path: Path) -> None:
    """Newton's step from a height of 1 % would make it 50 times as high."""
    write_obj(tmp_path / "one.obj", np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), [[0, 1, 2]])
    scene = Scene(
        cloth=Cloth(file="one.obj", folder=str(tmp_path)),
        fabric=Fabric(model="membrane", **TENSOR),
        solver=Solver("xpbd"),
    )
    with Simulation(scene, "serial") as simulation:
        layout, heights = simulation.solver.layout, [0.01]
        x = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.01, 0.0]])
        simulation.solver.cloth.upload_positions(x, x, np.ones(3))
        layout.membrane.multiplier.fill(0.0)
        for _ in range(12):
            params = frame_params(simulation)
            run_serially(membrane_constraints, layout, simulation.solver.features, 0, 1, 10.0, 0, params, NO_COLLIDER)
            corners = simulation.solver.cloth.to_numpy(layout.x)
            heights.append(float(np.linalg.norm(corners[2] - corners[0])))
        assert (np.diff(heights)[:4] > 0).all()
        assert max(heights) < 1.2
        assert heights[-1] == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("from_file", [False, True])
def test_all_solvers_hang_alike_and_pins_carry_the_weight(mesh: Path, solver: str, from_file: bool) -> None:
    scenes = [hung(name, mesh=mesh if from_file else None) for name in ("implicit", solver)]
    shapes = []
    for scene in scenes:
        with Simulation(scene, "serial") as simulation:
            simulation.step(240)
            shapes.append(simulation.positions())
            weight = 9.81 * simulation.topology.mass.sum()
            assert simulation.reaction_forces()[:, 1].sum() == pytest.approx(weight, rel=0.02)
    assert np.abs(shapes[0] - simulation.topology.start).max() > 0.005
    assert shapes[1] == pytest.approx(shapes[0], abs=1e-4)


def test_a_swing_converges_to_the_same_motion() -> None:
    """`explicit` and `rk4` of half the substeps agree; `xpbd` is of first order in the substep."""
    start, errors = hung(), {}

    def swung(solver: str, substeps: int, iterations: int = 1) -> np.ndarray:
        scene = replace(start, solver=Solver(solver, substeps, iterations, damping=0.0))
        scene = replace(scene, cloth=replace(scene.cloth, rotation=(60.0, 0.0, 0.0)))
        with Simulation(scene, "serial") as simulation:
            simulation.step(20)
            return simulation.positions()

    reference = swung("rk4", 200)
    assert swung("explicit", 400) == pytest.approx(reference, abs=2e-5)
    for substeps in (50, 100):
        errors[substeps] = np.abs(swung("xpbd", substeps, 40) - reference).max()
    assert errors[100] < 0.02
    assert errors[50] / errors[100] == pytest.approx(2.0, rel=0.25)
    assert np.abs(swung("implicit", 40) - reference).max() < 0.005


CREASED = {"compression": 0.25, "damping_time": 0.002}
TURNED = {"warp_angle": 30.0}


@pytest.mark.parametrize("solver", ["explicit", "rk4", "implicit"])
@pytest.mark.parametrize("layout", ["simd", "parallel"])
@pytest.mark.parametrize("keys", [CREASED, TURNED], ids=["compressed", "turned"])
def test_all_layouts_move_alike(solver: str, layout: str, keys: dict[str, float]) -> None:
    """A sheet of 19 columns, which no strip of the SIMD layout divides evenly, from a crumpled state."""
    scene = hung(solver, **keys)
    scene = replace(scene, cloth=replace(scene.cloth, rows=11, columns=19, rotation=(50.0, 20.0, 0.0)))
    found = []
    for one in ("serial", layout):
        with Simulation(scene, one) as simulation:
            shape = simulation.topology.start.shape
            simulation.set_state(simulation.topology.start + np.random.default_rng(3).normal(scale=2e-3, size=shape))
            simulation.step(2)
            found.append(simulation.positions())
    assert np.abs(found[0] - simulation.topology.start).max() > 5e-3
    assert found[1] == pytest.approx(found[0], abs=5e-5 if solver == "implicit" else 1e-5)  # it iterates


@pytest.mark.parametrize("solver", ["explicit", "rk4", "implicit"])
def test_a_mesh_in_the_parallel_layout_moves_as_in_the_serial_one(mesh: Path, solver: str) -> None:
    found = []
    for layout in ("serial", "parallel"):
        with Simulation(hung(solver, mesh=mesh), layout) as simulation:
            simulation.step(5)
            found.append(simulation.positions())
    assert found[1] == pytest.approx(found[0], abs=1e-5)


@pytest.mark.parametrize("keys", [CREASED, TURNED], ids=["compressed", "turned"])
def test_xpbd_converges_to_the_same_substep_in_both_layouts(keys: dict[str, float]) -> None:
    """They solve triangles in another order, so only converged iterations agree."""
    scene = hung("xpbd", **keys)
    cloth = replace(scene.cloth, rows=11, columns=19, rotation=(50.0, 20.0, 0.0))
    scene = replace(scene, cloth=cloth, solver=Solver("xpbd", 20, 200, damping=1.0))
    found = []
    for layout in ("serial", "simd"):
        with Simulation(scene, layout) as simulation:
            shape = simulation.topology.start.shape
            simulation.set_state(simulation.topology.start + np.random.default_rng(3).normal(scale=1e-3, size=shape))
            simulation.step(2)
            found.append(simulation.positions())
    assert np.abs(found[0] - simulation.topology.start).max() > 5e-3
    assert found[1] == pytest.approx(found[0], abs=3e-5)


@pytest.mark.parametrize("seed", [2, 3])
def test_xpbd_recovers_from_grabs_that_jump_by_meters_every_frame(seed: int) -> None:
    """Triangles are pressed to almost nothing, and pulled until rounding makes a determinant negative."""
    scene, random = load_scene("bias"), np.random.default_rng(seed)
    with Simulation(replace(scene, wind=None, solver=replace(scene.solver, name="xpbd")), "serial") as simulation:
        free = np.flatnonzero(~simulation.topology.pinned)
        for _ in range(6):
            grab = simulation.grab(int(random.choice(free)), radius=float(random.choice([0.02, 0.1, 0.3])))
            for _ in range(12):
                grab.move_to(random.uniform(-3, 3, 3))
                simulation.step()
            grab.release()
            simulation.step(8)
        simulation.step(300)
        sides = np.diff(simulation.positions()[simulation.topology.ends], axis=1)
        lengths = np.linalg.norm(sides[:, 0], axis=1) / simulation.topology.rest
        assert lengths.max() < 4.0  # at rest 2.6, at the pins


@pytest.mark.parametrize("layout", ["serial", "simd"])
@pytest.mark.parametrize("solver", SOLVERS)
def test_after_a_reset_the_cloth_moves_as_if_no_number_had_been_lost(solver: str, layout: str) -> None:
    with Simulation(hung(solver), layout) as simulation:
        simulation.step(3)
        expected = simulation.positions()
        x = simulation.positions()
        x[40] = np.nan
        simulation.place(x)  # `set_state` refuses it
        simulation.step()
        assert not np.isfinite(simulation.positions()).all()
        simulation.reset()
        simulation.step(3)
        assert (simulation.positions() == expected).all()


def test_free_fall_and_rotation_keep_the_shape() -> None:
    scene = hung("explicit", damping_time=0.001)
    scene = replace(scene, cloth=replace(scene.cloth, pins=()), solver=replace(scene.solver, damping=0.0))
    with Simulation(scene, "serial") as simulation:
        x = simulation.topology.start
        about = x - x.mean(axis=0)
        simulation.set_state(x, 0.3 * np.cross([0.0, 0.0, 1.0], about))
        simulation.step(30)
        sides = [
            np.linalg.norm(np.diff(y[simulation.topology.ends], axis=1), axis=2) for y in (x, simulation.positions())
        ]
        assert sides[1] == pytest.approx(sides[0], rel=2e-3)
        assert simulation.positions().mean(axis=0) - x.mean(axis=0) == pytest.approx(
            [0.0, -0.5 * 9.81 * 0.25, 0.0], abs=1e-3
        )


def test_a_stiffness_map_scales_the_membrane(tmp_path: Path) -> None:
    """A map of one half everywhere is half the tensor."""
    (tmp_path / "half.csv").write_text("0.5\n" * 81)
    scene = replace(hung("implicit"), maps=Maps(stiffness="half.csv", folder=str(tmp_path)))
    half = hung("implicit", **{name: value / 2 for name, value in TENSOR.items()})
    found = []
    for one in (scene, half):
        with Simulation(one, "serial") as simulation:
            simulation.step(30)
            found.append(simulation.positions())
    assert found[0] == pytest.approx(found[1], abs=1e-5)


def test_the_factor_on_the_stiffness_scales_the_membrane() -> None:
    found = []
    for factor, tensor in ((0.25, TENSOR), (1.0, {name: value / 4 for name, value in TENSOR.items()})):
        scene = hung("explicit", **tensor, bending_stiffness=0.0)
        with Simulation(
            replace(scene, solver=replace(scene.solver, stiffness=factor, substeps=60)), "serial"
        ) as simulation:
            simulation.step(30)
            found.append((simulation.positions(), simulation.forces()))
    assert found[0][0] == pytest.approx(found[1][0], abs=1e-5)
    assert found[0][1] == pytest.approx(found[1][1], abs=1e-2)


def test_the_skirt_swings_in_folds() -> None:
    """A circle skirt hangs in folds, whose number changes as it turns, and stretches by a few percent."""
    with Simulation(load_scene("skirt")) as simulation:
        across = simulation.topology.flat[:, [0, 2]]
        hem = np.linalg.norm(across, axis=1) > 0.999 * np.linalg.norm(across, axis=1).max()  # in order around it
        folds = []
        for _ in range(3):
            simulation.step(60)
            distance = np.linalg.norm(simulation.positions()[hem][:, [0, 2]], axis=1)
            outside = distance > distance.mean()
            folds.append(int((outside & ~np.roll(outside, 1)).sum()))
        assert min(folds) >= 4
        assert max(folds) <= 14
        assert simulation.metrics().max_strain < 0.1


# -- refusals ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"c12": 800.0}, r"fabric\.c12:? must be between ±√\(c11·c22\) = ±734\.847 N/m.*got 800"),
        ({"c66": 0.0}, r"fabric\.c66:? must be greater than 0 for a membrane, got 0"),
        ({"model": "springs"}, r'fabric\.c11:? belongs to a membrane: set fabric\.model = "membrane"'),
        ({"model": "mebrane"}, r"fabric\.model: 'mebrane' .*did you mean 'membrane'"),
    ],
)
def test_a_wrong_tensor_is_one_line(keys: dict[str, Any], message: str) -> None:
    with pytest.raises(SceneError, match=message) as raised:
        load_scene(hung(**keys))
    assert "\n" not in str(raised.value)


def test_a_tensor_from_springs_needs_all_of_them() -> None:
    with pytest.raises(SceneError, match=r"fabric\.shear:? must be greater than 0 for a membrane"):
        load_scene(Scene(fabric=Fabric(model="membrane", shear=0.0)))


@pytest.mark.parametrize("section", [{"strain_limit": StrainLimit()}, {"tearing": Tearing()}])
def test_what_needs_springs_is_refused(section: dict[str, Any]) -> None:
    with pytest.raises(SceneError, match=f'{next(iter(section))}:? needs springs, but fabric.model is "membrane"'):
        load_scene(replace(hung(bending_stiffness=0.0), **section))


def test_solvers_and_layouts_without_membranes_are_refused() -> None:
    with pytest.raises(UsageError, match=r'lines does not support fabric\.model = "membrane"; use xpbd, explicit'):
        Simulation(hung("lines"))
    with pytest.raises(UsageError, match="layout parallel is not supported: xpbd solves a membrane triangle by"):
        Simulation(hung("xpbd"), "parallel")
    with pytest.raises(UsageError, match=r"layout simd is not supported: fabric\.compression acts along"):
        Simulation(hung(compression=0.5, warp_angle=45.0), "simd")


def test_verlet_does_not_read_the_fabric() -> None:
    with Simulation(hung("verlet")) as simulation:
        simulation.step(10)
        assert np.isfinite(simulation.positions()).all()


def test_a_sheet_without_gravity_stays_as_it_is() -> None:
    for solver in SOLVERS:
        with Simulation(replace(hung(solver), forces=Forces(gravity=0.0)), "serial") as simulation:
            simulation.step(5)
            assert simulation.positions() == pytest.approx(simulation.topology.start, abs=1e-6)


@pytest.mark.parametrize("layout", ["serial", "simd", "parallel"])
def test_a_sheet_stretched_a_hundred_thousandfold_springs_back(layout: str) -> None:
    """Its forces grow with the cube of the stretch: products of two such vectors leave the range of float32."""
    cloth, free = Cloth(rows=6, columns=6, width=0.2, height=0.2, pins=()), Forces(gravity=0.0)
    scene = Scene(cloth=cloth, fabric=hung().fabric, forces=free, solver=Solver("implicit", 10, 1))
    with Simulation(scene, layout) as simulation:
        for stretch in (1e4, 1e5, 3e5):
            simulation.set_state(stretch * simulation.topology.start)
            simulation.step(30)
            assert simulation.metrics().max_strain < 1.0
