"""The toolkit's camera takes the same picture as ours, or a press would miss what the user sees; the wheel."""

from __future__ import annotations

import numpy as np
import pytest
import taichi as ti

from taichi_cloth.interact.camera import OrbitCamera
from taichi_cloth.view.window import aim, wheel


@pytest.mark.parametrize("shift", [0.0, 0.3])
@pytest.mark.parametrize("aspect", [0.7, 1.8])
def test_the_toolkit_sees_what_the_orbit_camera_sees(aspect: float, shift: float) -> None:
    camera = OrbitCamera((3.0, 4.0, 5.0), (0.5, 1.0, -0.5), 40)
    camera.orbit(0.4, -0.1)
    camera.zoom(2)
    camera.shift = shift
    lens = ti.ui.Camera()
    aim(lens, camera)
    theirs = (lens.get_view_matrix() @ lens.get_projection_matrix(aspect)).T  # it hands out transposes
    ours = camera.view_projection(aspect)
    assert theirs[[0, 1, 3]] == pytest.approx(ours[[0, 1, 3]], abs=1e-5)  # row 2, depth, runs the other way
    assert np.linalg.matrix_rank(theirs) == 4


def test_the_wheel_counts_where_the_toolkit_has_one() -> None:
    class WithWheel:
        def get_scroll_delta(self) -> tuple[float, float]:
            return 0.5, -2.0

    assert wheel(WithWheel()) == -2.0
    assert wheel(object()) == 0.0
