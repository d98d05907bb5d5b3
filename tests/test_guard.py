"""A cloth that blows up is stopped on its last good frame, and its user told what to change."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from taichi_cloth import cli
from taichi_cloth.guard import Guard
from taichi_cloth.scene import load_scene
from taichi_cloth.scene.model import Cloth, Fabric, Scene, Solver
from taichi_cloth.simulation import Simulation
from taichi_cloth.solvers.spring import Spring

pytestmark = pytest.mark.usefixtures("running", "on_lists")

STIFF = Scene(
    cloth=Cloth(rows=9, columns=12, width=0.6, height=0.4, center=(0.0, 1.0, 0.0), rotation=(-60.0, 0.0, 0.0)),
    fabric=Fabric(warp=5e4, weft=5e4),
    solver=Solver("spring", substeps=10),
)


@pytest.fixture
def unstable(monkeypatch: pytest.MonkeyPatch) -> None:
    """`spring` takes as few substeps as it is asked for."""
    monkeypatch.setattr(Spring, "least_substeps", lambda self, damping_time: 2)


@pytest.mark.parametrize("path", ["lanes", "list"])
def test_a_real_blow_up_ends_on_the_last_good_frame(unstable: None, path: str) -> None:
    with Simulation(STIFF, path) as simulation:
        guard = Guard(simulation)
        seen = [simulation.positions()]
        for _ in range(60):
            simulation.advance_frame()
            if not guard.sound():
                break
            seen.append(simulation.positions())
        bad = simulation.frame
        assert bad < 60
        line = guard.restore()
        assert simulation.frame == bad - 1
        assert (simulation.positions() == seen[-1]).all()
        assert simulation.measure().finite
        assert np.abs(simulation.velocities()).max() < 1e4
        helps = "try 20 substeps instead of 10 (2 are the fewest that small motions bear), or less wind, gravity or"
        assert line.startswith(f"the cloth blew up in frame {bad}: {helps}")


@pytest.mark.parametrize("number", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("solver", ["verlet", "spring"])
def test_one_bad_number_is_found(solver: str, number: float) -> None:
    with Simulation(load_scene("drape15", solver=solver)) as simulation:
        guard = Guard(simulation)
        simulation.advance_frame()
        assert guard.sound()
        simulation.cloth.x[117] = (0.0, number, 0.0)
        assert not guard.sound()
        guard.restore()
        assert guard.sound()


@pytest.mark.parametrize("component", [0, 1, 2])
@pytest.mark.parametrize("field", ["x", "velocity"])
@pytest.mark.parametrize("path", ["list", "gather"])
def test_one_bad_component_of_one_particle_is_found(path: str, field: str, component: int) -> None:
    """In `spring`, whose velocity is a field of its own and not taken from places."""
    with Simulation(load_scene("drape15", solver="spring"), path) as simulation:
        guard = Guard(simulation)
        simulation.advance_frame()
        for number in (np.nan, np.inf, -np.inf):
            assert guard.sound()
            values = np.array(getattr(simulation.cloth, field)[117])
            values[component] = number
            getattr(simulation.cloth, field)[117] = values
            assert not guard.sound()
            guard.restore()
        assert guard.sound()


def test_what_a_blow_up_tears_is_whole_again() -> None:
    with Simulation(load_scene("tear", rows=8, columns=8)) as simulation:
        guard = Guard(simulation)
        simulation.advance_frame()
        assert guard.sound()
        whole = simulation.topology
        rush = np.arange(64)[:, None] * np.full((64, 3), 1e4)
        simulation.place(simulation.positions(), rush)
        simulation.advance_frame()
        assert simulation.topology.spring_count < whole.spring_count
        assert not guard.sound()
        guard.restore()
        assert simulation.topology is whole
        assert simulation.cloth.spring_count[None] == whole.spring_count


def test_what_was_moved_away_from_the_scene_is_named_first() -> None:
    with Simulation(load_scene("curtain")) as simulation:
        guard = Guard(simulation)
        simulation.grab(700, (5.0, 5.0, 5.0))
        simulation.set("substeps", 1)
        simulation.set("wind_z", 90.0)
        assert guard.restore().endswith(": wind z is 90 m/s, the scene's own is 0.9")
        assert simulation.grabbed is None


def test_watching_changes_nothing() -> None:
    ends = []
    for watched in (False, True):
        with Simulation(load_scene("curtain")) as simulation:
            guard = Guard(simulation)
            for _ in range(30):
                simulation.advance_frame()
                assert not watched or guard.sound()
            ends.append(simulation.positions())
    assert (ends[0] == ends[1]).all()


def test_a_render_that_blows_up_keeps_its_pictures_and_the_last_good_frame(
    unstable: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "o"
    words = ["render", "drape15", "--solver", "spring", "--set", "substeps=10", "--set", "warp=50000"]
    assert cli.main([*words, "--frames", "100", "--size", "64x36", "--samples", "1", "--out", str(out)]) == 1
    told = capsys.readouterr().err.strip()
    assert told.startswith("taichi-cloth: the cloth blew up in frame ")
    assert "\n" not in told
    assert told.endswith(f"is saved in {out / 'last_good.npz'}")
    bad = int(told.split("frame ")[1].split(":")[0])
    assert len(list(out.glob("frame_*.png"))) == bad
    with Simulation(load_scene("drape15", solver="spring", substeps=10, warp=50000)) as simulation:
        simulation.load(out / "last_good.npz")
        assert simulation.frame == bad - 1
        assert simulation.measure().finite
