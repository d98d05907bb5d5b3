"""Upload of several fields at once: every kind, bit for bit, with zeros after the given values."""

import numpy as np
import pytest
import taichi as ti

from taichi_cloth.state.field_pool import soa_vector_field, upload, upload_all

pytestmark = pytest.mark.bounds


def test_fields_of_every_kind_are_uploaded_together() -> None:
    numbers, integers = ti.field(ti.f32, 5), ti.field(ti.i32, 3)
    vectors, soa = ti.Vector.field(3, ti.f32, 4), soa_vector_field(2, 4)
    integers.fill(9)
    random = np.random.default_rng(1)
    given = random.normal(size=(4, 3)), random.integers(-(2**31), 2**31, (2, 2))
    upload_all(
        (numbers, np.array([0.1, -0.0, 1e-42])),  # the last is a subnormal float32
        (integers, np.array([-1])),
        (vectors, given[0]),
        (soa, given[1]),
    )
    assert numbers.to_numpy().tobytes() == np.array([0.1, -0.0, 1e-42, 0, 0], np.float32).tobytes()
    assert integers.to_numpy().tolist() == [-1, 0, 0]
    assert (vectors.to_numpy() == given[0].astype(np.float32)).all()
    assert (soa.to_numpy() == [*given[1], (0, 0), (0, 0)]).all()


def test_values_that_do_not_fit_are_rejected() -> None:
    with pytest.raises(ValueError, match="broadcast"):
        upload(ti.field(ti.f32, 2), np.zeros(3))
