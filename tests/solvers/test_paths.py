"""All paths of a solver give the same cloth, to rounding, as long as folds have not amplified it."""

from dataclasses import replace

import numpy as np
import pytest

from taichi_cloth.scene.model import (
    Box,
    Capsule,
    Cloth,
    Fabric,
    Forces,
    Ground,
    Limit,
    Plane,
    Scene,
    Solver,
    Sphere,
    Springs,
    Tethers,
    Wind,
)
from taichi_cloth.simulation import Simulation
from taichi_cloth.solvers import SOLVERS, path_for

OTHER_PATHS = [(name, path) for name, kind in SOLVERS.items() for path in kind.paths if path != "list"]


def busy(solver: str) -> Scene:
    """All stages, on a sheet whose strips are not full and whose cells are not square."""
    return Scene(
        cloth=Cloth(
            rows=13,
            columns=35,
            width=1.2,
            height=0.5,
            center=(0.0, 2.0, 0.0),
            rotation=(-80.0, 0.0, 0.0),
            pins=("top-left", "top-right"),
        ),
        fabric=Fabric(warp=800.0, weft=500.0, shear=200.0, bend=4.0, bending=3e-4, damping_time=1e-4),
        solver=Solver(name=solver, damping=1.0, substeps=4, iterations=6),
        wind=Wind(x=1.0, z=4.0),
        limit=Limit(0.02, sweeps=2),
        tethers=Tethers(1.005),
        spheres=(Sphere(center=(0.0, 1.85, 0.1), radius=0.1, margin=0.02, sway=(0.3, 0.0, 0.0), friction=0.3),),
        capsules=(
            Capsule(center=(0.35, 1.9, 0.1), length=0.2, radius=0.04, rotation=(0.0, 0.0, 70.0), spin=(0, 60, 0)),
        ),
        boxes=(Box(center=(-0.4, 1.95, 0.1), size=(0.1, 0.05, 0.1), rotation=(0.0, 30.0, 10.0)),),
        planes=(Plane(center=(0.0, 1.8, 0.0), rotation=(8.0, 0.0, 5.0)),),
        ground=Ground(height=1.85),
    )


VARIANTS = {
    "all": lambda scene: scene,
    "one diagonal, equal masses, eight rows": lambda scene: replace(
        Scene(fabric=scene.fabric, solver=scene.solver),
        cloth=replace(scene.cloth, diagonals=1, rows=8, lumping="equal"),
    ),
    "no springs against bending, two slots a strip": lambda scene: replace(
        scene,
        cloth=replace(scene.cloth, rows=13, columns=11, width=0.4),
        fabric=replace(scene.fabric, bend=0.0),
        springs=Springs(bend=0.0),
    ),
    "nothing but gravity on a narrow strip": lambda scene: Scene(
        cloth=replace(scene.cloth, rows=2, height=0.05, columns=5, width=0.2), solver=scene.solver, forces=Forces()
    ),
}


# Diagonals and masses are in the topology, which `gather` shares with the list: only strips have them twice. What
# strips do at the ends of a grid is the same for all that sweep, sum or eliminate, and in `gather` stages are launches
# of their own, whatever the method: one of each, `make long` all.
SHOWN = ("verlet", "spring", "lines")
OF_STRIPS = ("one diagonal, equal masses, eight rows", "no springs against bending, two slots a strip")
BRIEF = {"lanes": "all", "gather": "nothing but gravity on a narrow strip"}
CASES = [
    pytest.param(
        solver,
        path,
        variant,
        id=f"{solver}-{path}-{variant}",
        marks=[pytest.mark.long] * (solver not in SHOWN and variant != BRIEF[path]),
    )
    for solver, path in OTHER_PATHS
    for variant in VARIANTS
    if path != "gather" or variant not in OF_STRIPS
]


@pytest.mark.parametrize(("solver", "path", "variant"), CASES)
def test_a_path_equals_the_list_of_springs(solver: str, path: str, variant: str) -> None:
    scene = VARIANTS[variant](busy(solver))
    # In this order a simulation alone, in the tests below, has the fields and kernels of `other`.
    with Simulation(scene, path=path) as other, Simulation(scene, path="list") as plain:
        assert (plain.solver.path, other.solver.path) == ("list", path)
        for frame in range(6):
            if frame == 2:
                held = plain.topology.particle_count - 2
                target = plain.positions()[held] + [0.0, 0.01, 0.01]
                plain.grab(held, target, radius=0.08)
                other.grab(held, target, radius=0.08)
                assert len(plain.held) > 3
            if frame == 3:
                for simulation in (plain, other):
                    simulation.set("gravity", 3.0)
                    simulation.set("substeps", simulation.substeps + 1)
            if frame == 4:
                plain.release()
                other.release()
            plain.advance_frame()
            other.advance_frame()
            # Sums in another order differ in the last bit, and a buckling sheet makes ten times of it in a frame:
            # so every frame begins with the same cloth.
            assert other.positions() == pytest.approx(plain.positions(), abs=1e-4 * scene.cloth.width)
            assert np.median(np.abs(other.positions() - plain.positions())) < 1e-6 * scene.cloth.width
            for name in ("x", "x_prev", "velocity"):
                getattr(other.cloth, name).copy_from(getattr(plain.cloth, name))
        assert np.linalg.norm(plain.positions() - plain.topology.start, axis=1).max() > 0.005


def bits(scene: Scene, path: str, frames: int) -> bytes:
    """All that moved in some frames."""
    with Simulation(scene, path) as simulation:
        for _ in range(frames):
            simulation.advance_frame()
        return simulation.positions().tobytes() + simulation.velocities().tobytes()


@pytest.mark.parametrize(
    "solver", [pytest.param(name, marks=[pytest.mark.long] * (name not in SHOWN)) for name in SOLVERS]
)
def test_threads_side_by_side_give_the_same_bits_every_time(solver: str) -> None:
    with Simulation(busy(solver), "gather") as simulation:
        seen = []
        for _ in range(2):
            for _ in range(3):
                simulation.advance_frame()
            seen.append(simulation.positions().tobytes())
            simulation.reset()
    assert seen[0] == seen[1] == np.frombuffer(bits(busy(solver), "gather", 3))[: len(seen[0]) // 8].tobytes()


@pytest.mark.parametrize(
    ("solver", "path"),
    [("spring", "lanes"), ("spring", "gather"), pytest.param("lines", "lanes", marks=pytest.mark.long)],
)
def test_nothing_is_left_of_the_cloth_that_had_the_fields_before(solver: str, path: str) -> None:
    """The first and the second have the same capacities, and so the same fields, and the kernels of the tests above."""
    large = busy(solver)
    small = replace(large, cloth=replace(large.cloth, rows=12, columns=34, pins=("top-left",)))
    with Simulation(small, path) as simulation:
        fields, work = simulation.cloth, simulation.solver.work
    with Simulation(large, path) as simulation:
        assert (simulation.cloth is fields, simulation.solver.work is work) == (True, True)
    alone = bits(small, path, 3)
    bits(large, path, 3)
    assert bits(small, path, 3) == alone


def test_the_path_is_chosen_by_the_grid() -> None:
    verlet = SOLVERS["verlet"]
    assert path_for(verlet, (24, 30)) == "lanes"
    assert [path_for(verlet, (9, columns)) for columns in (7, 8)] == ["list", "lanes"]
    assert path_for(verlet, (24, 30), "list") == "list"


def test_an_unknown_path_is_refused_by_name() -> None:
    with pytest.raises(ValueError, match="verlet has no path 'lane': lanes, list, gather; did you mean 'lanes'"):
        path_for(SOLVERS["verlet"], (24, 30), "lane")
