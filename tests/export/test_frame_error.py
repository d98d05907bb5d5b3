"""The error of a frame in the Python API."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing

import numpy as np
import pytest

import taichi_cloth as tc
from taichi_cloth.simulation.copies import FrameErrorMeter

pytestmark = pytest.mark.usefixtures("serial_layout")


@pytest.fixture
def simulation() -> Iterator[tc.Simulation]:
    with tc.Simulation(tc.load_scene("drape15", rows=6, columns=7)) as simulation:
        yield simulation


def test_the_error_of_the_last_frame_is_measured_on_request(simulation: tc.Simulation) -> None:
    simulation.step(5)
    assert simulation.frame_error is None
    assert simulation.metrics().frame_error is None
    simulation.step(3, measure_error=True)
    found = simulation.frame_error
    assert found is not None
    assert (found.frame, simulation.frame) == (8, 8)
    assert simulation.metrics().frame_error == found.error
    with tc.Simulation(simulation.scene) as other, closing(FrameErrorMeter(other.scene)) as meter:
        other.step(7)
        assert found.error == pytest.approx(meter.measure_frame(other).error)
        np.testing.assert_array_equal(simulation.positions(), other.positions())
    simulation.reset()
    assert simulation.metrics().frame_error is None
    simulation.step()
    assert simulation.frame_error is None


def test_an_error_does_not_return_with_its_frame_number(simulation: tc.Simulation) -> None:
    simulation.step(5, measure_error=True)
    assert simulation.frame_error is not None
    simulation.reset()
    simulation.step(5)
    assert simulation.frame == 5
    assert simulation.frame_error is None


def test_after_a_change_of_the_solver_its_error_is_measured(simulation: tc.Simulation) -> None:
    simulation.step(10, measure_error=True)
    assert simulation.frame_error is not None
    before = simulation.frame_error.error
    simulation.switch_solver("explicit")
    simulation.step(2, measure_error=True)
    assert simulation.frame_error is not None
    assert simulation.frame_error.error < before / 5


def test_too_stiff_a_fabric_is_refused_before_a_step() -> None:
    stiff = {"warp": 1e9, "weft": 1e9, "width": 0.4, "area_density": 0.001}
    with tc.Simulation(tc.load_scene("drape15", rows=6, columns=7, **stiff)) as simulation:
        with pytest.raises(tc.UsageError, match="drape15: explicit needs"):
            simulation.step(measure_error=True)
        assert simulation.frame == 0


def test_an_image_shows_the_error_that_was_measured(simulation: tc.Simulation) -> None:
    def redness() -> float:
        pixels = tc.render_image(simulation, (96, 64), "error").pixels.astype(int)
        return float(np.percentile(pixels[..., 0] - pixels[..., 2], 99))

    simulation.step(4)
    with pytest.raises(tc.UsageError, match="call step\\(measure_error=True\\) before"):
        redness()
    pixels = tc.render_image(simulation, (96, 64)).pixels.astype(int)
    plain = float(np.percentile(pixels[..., 0] - pixels[..., 2], 99))
    simulation.step(measure_error=True)
    assert redness() > plain + 40


def test_a_change_drops_the_error_and_a_new_target_does_not(simulation: tc.Simulation) -> None:
    changes = (
        lambda: simulation.set_state(simulation.positions()),
        lambda: simulation.switch_solver("explicit"),
        lambda: simulation.params.__setitem__("gravity", 5.0),
        lambda: simulation.pin(20),
    )
    grab = simulation.grab(15)
    for change in changes:
        simulation.step(measure_error=True)
        if grab.active:
            grab.move_to((0.0, 1.0, 0.0))
        assert simulation.frame_error is not None
        change()
        assert simulation.frame_error is None
        assert simulation.metrics().frame_error is None
