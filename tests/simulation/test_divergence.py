"""A diverged cloth is rolled back to its last stable frame, with advice for the user."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from taichi_cloth.__main__ import main
from taichi_cloth.geometry.scene_loader import load_scene
from taichi_cloth.scene.fabric_schema import Fabric
from taichi_cloth.scene.schema import Cloth, Scene, SelfCollision, Solver
from taichi_cloth.simulation.rollback import DivergenceGuard
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.solvers.explicit import Explicit

pytestmark = pytest.mark.usefixtures("running", "serial_layout")

STIFF = Scene(
    cloth=Cloth(rows=9, columns=12, width=0.6, height=0.4, center=(0.0, 1.0, 0.0), rotation=(-60.0, 0.0, 0.0)),
    fabric=Fabric(warp=5e4, weft=5e4),
    solver=Solver("explicit", substeps=10),
)


@pytest.fixture
def unstable(monkeypatch: pytest.MonkeyPatch) -> None:
    """`explicit` takes as few substeps as are requested."""
    monkeypatch.setattr(Explicit, "min_stable_substeps", lambda self, damping_time: 2)


@pytest.mark.parametrize("layout", ["simd", "serial"])
def test_divergence_is_rolled_back_to_the_last_stable_frame(unstable: None, layout: str) -> None:
    with Simulation(STIFF, layout) as simulation:
        guard = DivergenceGuard(simulation)
        stable = [simulation.positions()]
        for _ in range(60):
            simulation.step()
            if not guard.check_and_snapshot():
                break
            stable.append(simulation.positions())
        bad = simulation.frame
        assert bad < 60
        line = guard.roll_back()
        assert simulation.frame == bad - 1
        assert (simulation.positions() == stable[-1]).all()
        assert simulation.metrics().finite
        assert np.abs(simulation.velocities()).max() < 1e4
        advice = "try 20 substeps instead of 10 (small motions need at least 2), or less wind, gravity or"
        assert line.startswith(f"the cloth blew up in frame {bad}: {advice}")


@pytest.mark.parametrize("number", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("solver", ["verlet", "explicit"])
def test_one_number_that_is_not_finite_is_detected(solver: str, number: float) -> None:
    with Simulation(load_scene("drape15", solver=solver)) as simulation:
        guard = DivergenceGuard(simulation)
        simulation.step()
        assert guard.check_and_snapshot()
        simulation.cloth.x[117] = (0.0, number, 0.0)
        assert not guard.check_and_snapshot()
        guard.roll_back()
        assert guard.check_and_snapshot()


@pytest.mark.parametrize("component", [0, 1, 2])
@pytest.mark.parametrize("field", ["x", "velocity"])
@pytest.mark.parametrize("layout", ["serial", "parallel"])
def test_one_component_of_one_particle_is_detected(layout: str, field: str, component: int) -> None:
    """In `explicit`, which stores velocities in a field instead of taking them from positions."""
    with Simulation(load_scene("drape15", solver="explicit"), layout) as simulation:
        guard = DivergenceGuard(simulation)
        simulation.step()
        for number in (np.nan, np.inf, -np.inf):
            assert guard.check_and_snapshot()
            values = np.array(getattr(simulation.cloth, field)[117])
            values[component] = number
            getattr(simulation.cloth, field)[117] = values
            assert not guard.check_and_snapshot()
            guard.roll_back()
        assert guard.check_and_snapshot()


def test_springs_torn_by_divergence_are_restored() -> None:
    with Simulation(load_scene("tear", rows=8, columns=8)) as simulation:
        guard = DivergenceGuard(simulation)
        simulation.step()
        assert guard.check_and_snapshot()
        whole = simulation.topology
        velocities = np.arange(64)[:, None] * np.full((64, 3), 1e4)
        simulation.set_state(simulation.positions(), velocities)
        simulation.step()
        assert simulation.topology.spring_count < whole.spring_count
        assert not guard.check_and_snapshot()
        guard.roll_back()
        assert simulation.topology is whole
        assert simulation.cloth.spring_count[None] == whole.spring_count


def test_the_advice_names_a_parameter_that_differs_from_the_scene() -> None:
    with Simulation(load_scene("curtain")) as simulation:
        guard = DivergenceGuard(simulation)
        simulation.grab(700).move_to((5.0, 5.0, 5.0))
        simulation.params["substeps"] = 1
        simulation.params["wind_z"] = 90.0
        assert guard.roll_back().endswith(": wind z is 90 m/s, the scene's value is 0.9")
        assert len(simulation.grabbed) == 0


def test_penetration_free_contact_continues_from_where_a_reset_or_roll_back_puts_the_cloth() -> None:
    contact = SelfCollision(thickness=0.02, penetration_free=True)
    cloth = Cloth(rows=5, columns=5, width=0.4, height=0.4)
    scene = Scene(cloth=cloth, solver=Solver("xpbd", 4, 4), self_collision=contact)
    with Simulation(scene, "serial") as simulation:
        simulation.step(3)
        simulation.reset()
        assert simulation.penetration_free_since == 0
        simulation.step(2)
        guard = DivergenceGuard(simulation)
        simulation.step(2)
        guard.roll_back()
        assert (simulation.frame, simulation.penetration_free_since) == (2, 2)
        data = simulation.solver.layout.pair_data
        assert data is not None
        verified = data.x_safe.to_numpy()[data.particle.to_numpy()[: data.particle_count[None]]]
        np.testing.assert_array_equal(verified, simulation.cloth.x.to_numpy()[: len(verified)])


def test_the_guard_changes_nothing() -> None:
    ends = []
    for guarded in (False, True):
        with Simulation(load_scene("curtain")) as simulation:
            guard = DivergenceGuard(simulation)
            for _ in range(30):
                simulation.step()
                assert not guarded or guard.check_and_snapshot()
            ends.append(simulation.positions())
    assert (ends[0] == ends[1]).all()


def test_a_diverged_render_keeps_its_images_and_saves_the_last_good_frame(
    unstable: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "o"
    words = ["render", "drape15", "--solver", "explicit", "--set", "substeps=10", "--set", "warp=50000"]
    assert main([*words, "--frames", "100", "--size", "64x36", "--samples", "1", "--out", str(out)]) == 1
    line = capsys.readouterr().err.strip()
    assert line.startswith("taichi-cloth: the cloth blew up in frame ")
    assert "\n" not in line
    assert line.endswith(f"is saved in {out / 'last_good.npz'}")
    bad = int(line.split("frame ")[1].split(":")[0])
    assert len(list(out.glob("frame_*.png"))) == bad
    with Simulation(load_scene("drape15", solver="explicit", substeps=10, warp=50000)) as simulation:
        simulation.load(out / "last_good.npz")
        assert simulation.frame == bad - 1
        assert simulation.metrics().finite
