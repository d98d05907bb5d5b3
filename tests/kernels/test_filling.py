"""Fields filled together are those filled one by one."""

import numpy as np
import pytest
import taichi as ti

from taichi_cloth.kernels.filling import write_all
from taichi_cloth.state import fields


@pytest.mark.parametrize("serial", [True, False])
def test_every_kind_of_field_has_its_values_and_zeros_behind_them(serial: bool) -> None:
    random = np.random.default_rng(4)
    cases = [
        (fields.numbers(32), random.normal(size=32)),
        (fields.places(16), random.normal(size=(9, 3))),
        (ti.Vector.field(2, ti.i32, 8), random.integers(-(2**31), 2**31, (5, 2))),
        (fields.numbers(4, lanes=True), random.normal(size=(3, 8))),
        (fields.places(4, lanes=True), random.normal(size=(2, 3, 8))),
        (fields.numbers(16, kind=ti.i32), np.array([True, False, True])),
        (fields.places(16), np.zeros((0, 3))),
    ]
    for field, _ in cases:
        field.fill(7)
    if serial:
        fields.put_all(*cases)
    else:  # as on a GPU
        bits = [fields._filled(*case).reshape(-1).view(np.int32) for case in cases]
        write_all(tuple(field for field, _ in cases), np.concatenate(bits), False)
    for field, values in cases:
        found = field.to_numpy()
        assert (found[: len(values)] == values.astype(found.dtype)).all()
        assert (found[len(values) :] == 0).all()


def test_values_that_do_not_fit_are_refused() -> None:
    with pytest.raises(ValueError, match="broadcast"):
        fields.put(fields.numbers(4), np.zeros(5))
