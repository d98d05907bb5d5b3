"""Fields that are filled together: every kind, bit for bit, with zeros behind what was given."""

import numpy as np
import pytest
import taichi as ti

from taichi_cloth.state.fields import put, put_all, rows


def test_fields_of_every_kind_are_filled_together() -> None:
    numbers, wholes = ti.field(ti.f32, 5), ti.field(ti.i32, 3)
    places, apart = ti.Vector.field(3, ti.f32, 4), rows(2, 4)
    wholes.fill(9)
    random = np.random.default_rng(1)
    given = random.normal(size=(4, 3)), random.integers(-(2**31), 2**31, (2, 2))
    put_all(
        (numbers, np.array([0.1, -0.0, 1e-42])),  # the last is below the least normal float32
        (wholes, np.array([-1])),
        (places, given[0]),
        (apart, given[1]),
    )
    assert numbers.to_numpy().tobytes() == np.array([0.1, -0.0, 1e-42, 0, 0], np.float32).tobytes()
    assert wholes.to_numpy().tolist() == [-1, 0, 0]
    assert (places.to_numpy() == given[0].astype(np.float32)).all()
    assert (apart.to_numpy() == [*given[1], (0, 0), (0, 0)]).all()


def test_what_does_not_fit_is_refused() -> None:
    with pytest.raises(ValueError, match="broadcast"):
        put(ti.field(ti.f32, 2), np.zeros(3))
