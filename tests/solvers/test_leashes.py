"""`[maps] max_distance`: no particle goes farther from its start than its leash reaches."""

from pathlib import Path

import numpy as np
import pytest

from taichi_cloth.mesh.from_scene import leash_of
from taichi_cloth.scene import Scene, SceneError, check_scene, load_scene
from taichi_cloth.scene.model import Cloth, Fabric, Maps, Solver, Springs
from taichi_cloth.simulation import Simulation

ROWS, COLUMNS = 6, 33  # strips are not full
LONGEST = 0.3  # [m]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A map from 0 at the left edge to 1 at the right."""
    numbers = np.tile(np.linspace(0, 1, COLUMNS), (ROWS, 1))
    (tmp_path / "reach.csv").write_text("\n".join(map(str, numbers.reshape(-1))))
    return tmp_path


def scene(folder: Path, solver: str) -> Scene:
    cloth = Cloth(rows=ROWS, columns=COLUMNS, width=3.2, height=0.5, rotation=(-90.0, 0.0, 0.0), pins=())
    soft = Fabric(warp=20.0, weft=20.0, shear=5.0, bend=0.1)
    maps = Maps(folder=str(folder), max_distance="reach.csv", max_distance_hi=LONGEST)
    springs = Springs(structural=0.02, shear=0.02, bend=0.0)
    return Scene(cloth=cloth, fabric=soft, springs=springs, solver=Solver(solver, 10, 2), maps=maps)


CASES = [("verlet", "lanes"), ("xpbd", "list"), ("spring", "gather"), ("lines", "lanes"), ("projective", "list")]


@pytest.mark.parametrize(("solver", "path"), CASES)
def test_it_falls_as_far_as_its_leashes(folder: Path, solver: str, path: str) -> None:
    with Simulation(scene(folder, solver), path) as simulation:
        assert "leashes" in simulation.stages
        for _ in range(90):
            simulation.advance_frame()
            away = np.linalg.norm(simulation.positions() - simulation.topology.start, axis=1)
            assert (away <= simulation.topology.leash + 1e-5).all()
        reach = simulation.topology.leash
        assert away[reach == 0].max() < 1e-6
        middle = (reach > 0.1) & (reach < 0.28)
        assert away[middle] == pytest.approx(reach[middle], rel=0.02)  # gravity holds each at its end
        assert simulation.measure().kinetic_energy < 1e-3


def test_paths_are_equal(folder: Path) -> None:
    found = {}
    for path in ("list", "lanes", "gather"):
        with Simulation(scene(folder, "spring"), path) as simulation:
            for _ in range(8):
                simulation.advance_frame()
            found[path] = simulation.positions()
    assert found["lanes"] == pytest.approx(found["list"], abs=1e-5)
    assert found["gather"] == pytest.approx(found["list"], abs=1e-5)


def test_what_is_pulled_farther_comes_back(folder: Path) -> None:
    with Simulation(scene(folder, "verlet")) as simulation:
        simulation.grab(40, simulation.positions()[40] + [0.0, 1.0, 0.0])
        for _ in range(5):
            simulation.advance_frame()
        assert np.linalg.norm(simulation.positions()[40] - simulation.topology.start[40]) == pytest.approx(
            1.0, abs=1e-5
        )
        simulation.release()
        simulation.advance_frame()
        leash = simulation.topology.leash[40]
        assert np.linalg.norm(simulation.positions()[40] - simulation.topology.start[40]) <= leash + 1e-5


def test_a_leash_is_between_its_two_ends(folder: Path) -> None:
    maps = Maps(folder=str(folder), max_distance="reach.csv", max_distance_lo=0.5, max_distance_hi=0.1)
    leash = leash_of(Scene(cloth=Cloth(rows=ROWS, columns=COLUMNS), maps=maps))
    assert leash.reshape(ROWS, COLUMNS)[3, [0, 16, 32]] == pytest.approx([0.5, 0.3, 0.1])
    assert leash_of(Scene()) is None
    with pytest.raises(SceneError, match=r"maps\.max_distance: .*reach\.csv has numbers of shape \(198,\)"):
        check_scene(Scene(maps=maps))


def test_the_relief_keeps_to_its_map() -> None:
    with Simulation(load_scene("relief")) as simulation:
        for _ in range(60):
            simulation.advance_frame()
        away = np.linalg.norm(simulation.positions() - simulation.topology.start, axis=1)
        reach = simulation.topology.leash
        assert (away <= reach + 1e-4).all()
        loose = reach > 0.02
        assert (away[loose] > 0.98 * reach[loose]).mean() > 0.1  # taut leashes are what shapes it
