"""`[maps] max_distance`: no particle moves farther from its start than its maximum distance."""

from pathlib import Path

import numpy as np
import pytest

from taichi_cloth.geometry.cloth_builder import max_distances
from taichi_cloth.geometry.scene_loader import check_scene, load_scene
from taichi_cloth.scene.fabric_schema import Fabric, VerletSprings
from taichi_cloth.scene.schema import Cloth, Maps, Scene, Solver
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.system.errors import SceneError

ROWS, COLUMNS = 6, 33  # does not fill its SIMD packets
LONGEST = 0.3  # [m]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A map from 0 at the left edge to 1 at the right."""
    numbers = np.tile(np.linspace(0, 1, COLUMNS), (ROWS, 1))
    (tmp_path / "reach.csv").write_text("\n".join(map(str, numbers.reshape(-1))))
    return tmp_path


def scene(folder: Path, solver: str) -> Scene:
    cloth = Cloth(rows=ROWS, columns=COLUMNS, width=3.2, height=0.5, rotation=(-90.0, 0.0, 0.0), pins=())
    soft = Fabric(warp=20.0, weft=20.0, shear=5.0, bend_spring=0.1)
    maps = Maps(folder=str(folder), max_distance="reach.csv", max_distance_max=LONGEST)
    springs = VerletSprings(structural=0.02, shear=0.02, bend=0.0)
    return Scene(cloth=cloth, fabric=soft, verlet=springs, solver=Solver(solver, 10, 2), maps=maps)


CASES = [("verlet", "simd"), ("xpbd", "serial"), ("explicit", "parallel"), ("lines", "simd"), ("implicit", "serial")]


@pytest.mark.parametrize(("solver", "layout"), CASES)
def test_cloth_falls_to_its_maximum_distances(folder: Path, solver: str, layout: str) -> None:
    with Simulation(scene(folder, solver), layout) as simulation:
        assert "max distances" in simulation.features
        reach = simulation.topology.max_distance
        assert reach is not None
        for _ in range(90):
            simulation.step()
            away = np.linalg.norm(simulation.positions() - simulation.topology.start, axis=1)
            assert (away <= reach + 1e-5).all()
        assert away[reach == 0].max() < 1e-6
        middle = (reach > 0.1) & (reach < 0.28)
        assert away[middle] == pytest.approx(reach[middle], rel=0.02)  # gravity pulls each to its limit
        assert simulation.metrics().kinetic_energy < 1e-3


def test_layouts_agree(folder: Path) -> None:
    found = {}
    for layout in ("serial", "simd", "parallel"):
        with Simulation(scene(folder, "explicit"), layout) as simulation:
            for _ in range(8):
                simulation.step()
            found[layout] = simulation.positions()
    assert found["simd"] == pytest.approx(found["serial"], abs=1e-5)
    assert found["parallel"] == pytest.approx(found["serial"], abs=1e-5)


def test_a_particle_grabbed_beyond_its_maximum_distance_returns_when_released(folder: Path) -> None:
    with Simulation(scene(folder, "verlet")) as simulation:
        grab = simulation.grab(40)
        grab.move_to(simulation.positions()[40] + [0.0, 1.0, 0.0])
        for _ in range(5):
            simulation.step()
        assert np.linalg.norm(simulation.positions()[40] - simulation.topology.start[40]) == pytest.approx(
            1.0, abs=1e-5
        )
        grab.release()
        simulation.step()
        assert simulation.topology.max_distance is not None
        reach = simulation.topology.max_distance[40]
        assert np.linalg.norm(simulation.positions()[40] - simulation.topology.start[40]) <= reach + 1e-5


def test_the_map_interpolates_between_both_limits(folder: Path) -> None:
    maps = Maps(folder=str(folder), max_distance="reach.csv", max_distance_min=0.5, max_distance_max=0.1)
    reach = max_distances(Scene(cloth=Cloth(rows=ROWS, columns=COLUMNS), maps=maps))
    assert reach is not None
    assert reach.reshape(ROWS, COLUMNS)[3, [0, 16, 32]] == pytest.approx([0.5, 0.3, 0.1])
    assert max_distances(Scene()) is None
    with pytest.raises(SceneError, match=r"maps\.max_distance: .*reach\.csv has values of shape \(198,\)"):
        check_scene(Scene(maps=maps))


def test_the_relief_scene_stays_within_its_map() -> None:
    with Simulation(load_scene("relief")) as simulation:
        for _ in range(60):
            simulation.step()
        away = np.linalg.norm(simulation.positions() - simulation.topology.start, axis=1)
        reach = simulation.topology.max_distance
        assert reach is not None
        assert (away <= reach + 1e-4).all()
        loose = reach > 0.02
        assert (away[loose] > 0.98 * reach[loose]).mean() > 0.1  # many particles are at their limit, which shapes it
