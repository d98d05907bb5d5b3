"""All layouts of a solver give the same cloth, to rounding, until folds amplify it."""

from dataclasses import replace

import numpy as np
import pytest

from taichi_cloth.scene.collider_schema import Box, Capsule, Ground, Plane, Sphere
from taichi_cloth.scene.fabric_schema import Fabric, VerletSprings
from taichi_cloth.scene.schema import Cloth, Forces, Scene, Solver, StrainLimit, Tethers, Wind
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.solvers import LAYOUTS, SOLVERS, choose_layout

CPU_THREADS = 2  # for the parallel layout

OTHER_LAYOUTS = [(name, layout) for name, kind in SOLVERS.items() for layout in LAYOUTS if layout != "serial"]


def busy(solver: str) -> Scene:
    """All features, on a sheet that does not fill its SIMD packets and whose cells are not square."""
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
        fabric=Fabric(warp=800.0, weft=500.0, shear=200.0, bend_spring=4.0, bending_stiffness=3e-4, damping_time=1e-4),
        solver=Solver(name=solver, damping=1.0, substeps=4, iterations=6),
        wind=Wind(x=1.0, z=4.0),
        strain_limit=StrainLimit(0.02, iterations=2),
        tethers=Tethers(1.005),
        spheres=(Sphere(center=(0.0, 1.85, 0.1), radius=0.1, margin=0.02, oscillation=(0.3, 0.0, 0.0), friction=0.3),),
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
        cloth=replace(scene.cloth, diagonals=1, rows=8, mass_lumping="uniform"),
    ),
    "no bend springs, two packets a row": lambda scene: replace(
        scene,
        cloth=replace(scene.cloth, rows=13, columns=11, width=0.4),
        fabric=replace(scene.fabric, bend_spring=0.0),
        verlet=VerletSprings(bend=0.0),
    ),
    "only gravity on a narrow strip": lambda scene: Scene(
        cloth=replace(scene.cloth, rows=2, height=0.05, columns=5, width=0.2), solver=scene.solver, forces=Forces()
    ),
}


# Diagonals and masses are in the topology, which the parallel layout shares with the serial one: only the SIMD layout
# has copies. At the ends of a grid the SIMD layout treats all solvers of a kind (sweeps, sums, elimination) alike, and
# in the parallel layout features are launches of their own for every solver: one of each here, all in `make long`.
SHOWN = ("verlet", "explicit", "lines")
SIMD_VARIANTS = ("one diagonal, equal masses, eight rows", "no bend springs, two packets a row")
BRIEF = {"simd": "all", "parallel": "only gravity on a narrow strip"}
CASES = [
    pytest.param(
        solver,
        layout,
        variant,
        id=f"{solver}-{layout}-{variant}",
        marks=[pytest.mark.long] * (solver not in SHOWN and variant != BRIEF[layout]),
    )
    for solver, layout in OTHER_LAYOUTS
    for variant in VARIANTS
    if layout != "parallel" or variant not in SIMD_VARIANTS
]


@pytest.mark.parametrize(("solver", "layout", "variant"), CASES)
def test_a_layout_matches_the_serial_layout(solver: str, layout: str, variant: str) -> None:
    scene = VARIANTS[variant](busy(solver))
    # In this order a single simulation in the tests below gets the fields and kernels of `other`.
    with Simulation(scene, layout=layout) as other, Simulation(scene, layout="serial") as serial:
        assert (serial.solver.layout_name, other.solver.layout_name) == ("serial", layout)
        for frame in range(6):
            if frame == 2:
                particle = serial.topology.particle_count - 2
                target = serial.positions()[particle] + [0.0, 0.01, 0.01]
                grabs = [simulation.grab(particle, radius=0.08) for simulation in (serial, other)]
                for grab in grabs:
                    grab.move_to(target)
                assert len(serial.grabbed) > 3
            if frame == 3:
                for simulation in (serial, other):
                    simulation.params["gravity"] = 3.0
                    simulation.params["substeps"] = simulation.substeps + 1
            if frame == 4:
                for grab in grabs:
                    grab.release()
            serial.step()
            other.step()
            # Sums in another order differ in the last bit, which a buckling sheet amplifies tenfold in a frame: every
            # frame starts with the same cloth.
            assert other.positions() == pytest.approx(serial.positions(), abs=1e-4 * scene.cloth.width)
            assert np.median(np.abs(other.positions() - serial.positions())) < 1e-6 * scene.cloth.width
            for name in ("x", "x_prev", "velocity"):
                getattr(other.cloth, name).copy_from(getattr(serial.cloth, name))
        assert np.linalg.norm(serial.positions() - serial.topology.start, axis=1).max() > 0.005


def bits(scene: Scene, layout: str, frames: int) -> bytes:
    """Return positions and velocities after some frames."""
    with Simulation(scene, layout) as simulation:
        for _ in range(frames):
            simulation.step()
        return simulation.positions().tobytes() + simulation.velocities().tobytes()


@pytest.mark.parametrize(
    "solver", [pytest.param(name, marks=[pytest.mark.long] * (name not in SHOWN)) for name in SOLVERS]
)
def test_the_parallel_layout_is_bit_reproducible(solver: str) -> None:
    with Simulation(busy(solver), "parallel") as simulation:
        seen = []
        for _ in range(2):
            for _ in range(3):
                simulation.step()
            seen.append(simulation.positions().tobytes())
            simulation.reset()
    assert seen[0] == seen[1] == np.frombuffer(bits(busy(solver), "parallel", 3))[: len(seen[0]) // 8].tobytes()


@pytest.mark.parametrize(
    ("solver", "layout"),
    [("explicit", "simd"), ("explicit", "parallel"), pytest.param("lines", "simd", marks=pytest.mark.long)],
)
def test_reused_fields_have_no_effect(solver: str, layout: str) -> None:
    """Both cloths have the same capacities, and so the same fields, and the kernels of the tests above."""
    large = busy(solver)
    small = replace(large, cloth=replace(large.cloth, rows=12, columns=34, pins=("top-left",)))
    with Simulation(small, layout) as simulation:
        cloth, work = simulation.cloth, simulation.solver.layout
    with Simulation(large, layout) as simulation:
        assert (simulation.cloth is cloth, simulation.solver.layout is work) == (True, True)
    alone = bits(small, layout, 3)
    bits(large, layout, 3)
    assert bits(small, layout, 3) == alone


def test_the_grid_determines_the_default_layout() -> None:
    verlet = SOLVERS["verlet"]
    assert choose_layout(verlet, (24, 30)) == "simd"
    assert [choose_layout(verlet, (9, columns)) for columns in (7, 8)] == ["serial", "simd"]
    assert choose_layout(verlet, (24, 30), "serial") == "serial"


def test_an_unknown_layout_is_rejected() -> None:
    with pytest.raises(ValueError, match="unknown layout 'paralel': simd, serial, parallel; did you mean 'parallel'"):
        choose_layout(SOLVERS["verlet"], (24, 30), "paralel")
