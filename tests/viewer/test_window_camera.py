"""The toolkit's camera has the projection of the orbit camera, which picking uses; the mouse wheel."""

from __future__ import annotations

import numpy as np
import pytest
import taichi as ti

from taichi_cloth.render.camera import OrbitCamera
from taichi_cloth.viewer.window import scroll_steps, set_camera


@pytest.mark.parametrize("shift", [0.0, 0.3])
@pytest.mark.parametrize("aspect", [0.7, 1.8])
def test_the_toolkit_camera_has_the_projection_of_the_orbit_camera(aspect: float, shift: float) -> None:
    camera = OrbitCamera((3.0, 4.0, 5.0), (0.5, 1.0, -0.5), 40)
    camera.orbit(0.4, -0.1)
    camera.zoom(2)
    camera.view_shift = shift
    lens = ti.ui.Camera()
    set_camera(lens, camera)
    theirs = (lens.get_view_matrix() @ lens.get_projection_matrix(aspect)).T  # it returns transposes
    ours = camera.view_projection(aspect)
    assert theirs[[0, 1, 3]] == pytest.approx(ours[[0, 1, 3]], abs=1e-5)  # row 2, depth, has the opposite direction
    assert np.linalg.matrix_rank(theirs) == 4


def test_scroll_steps_are_read_if_the_toolkit_reports_the_wheel() -> None:
    class WithWheel:
        def get_scroll_delta(self) -> tuple[float, float]:
            return 0.5, -2.0

    assert scroll_steps(WithWheel()) == -2.0
    assert scroll_steps(object()) == 0.0
