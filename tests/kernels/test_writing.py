"""Fields that are filled together: every kind, bit for bit, with zeros behind what was given."""

import numpy as np
import pytest
import taichi as ti

from taichi_cloth.kernels.whole import kept_whole, placed, whole_field
from taichi_cloth.state.fields import put, put_all


def test_fields_of_every_kind_are_filled_together() -> None:
    numbers, wholes = ti.field(ti.f32, 5), ti.field(ti.i32, 3)
    places, apart = ti.Vector.field(3, ti.f32, 4), ti.Vector.field(2, ti.i32, 4, layout=ti.Layout.SOA)
    rows, slots = placed(lambda: (whole_field((8,), ti.i32, 2), whole_field((3, 8), ti.f32, 2)))
    wholes.fill(9)
    random = np.random.default_rng(1)
    given = random.normal(size=(4, 3)), random.integers(-(2**31), 2**31, (2, 8)), random.normal(size=(1, 3, 8))
    put_all(
        (numbers, np.array([0.1, -0.0, 1e-42])),  # the last is below the least normal float32
        (wholes, np.array([-1])),
        (places, given[0]),
        (rows, given[1]),
        (slots, given[2]),
    )
    assert numbers.to_numpy().tobytes() == np.array([0.1, -0.0, 1e-42, 0, 0], np.float32).tobytes()
    assert wholes.to_numpy().tolist() == [-1, 0, 0]
    assert (places.to_numpy() == given[0].astype(np.float32)).all()
    assert (rows.to_numpy() == given[1]).all()
    assert (slots.to_numpy()[0] == given[2][0].astype(np.float32)).all()
    assert (slots.to_numpy()[1] == 0).all()


def test_what_does_not_fit_is_refused() -> None:
    with pytest.raises(ValueError, match="broadcast"):
        put(ti.field(ti.f32, 2), np.zeros(3))
