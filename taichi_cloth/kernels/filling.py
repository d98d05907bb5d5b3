"""Several fields written at once."""

import taichi as ti

Bits = ti.types.ndarray(dtype=ti.i32, ndim=1)


@ti.kernel
def write_all(targets: ti.template(), bits: Bits, serial: ti.template()):
    """Writes a tuple of 1-D fields of numbers, vectors or matrices from their values' 32 bits, one after the other.

    Taichi's own `from_numpy` compiles a kernel for each field: a cloth's took nearly as long as a method's frame.
    `serial`: loops without threads are one task, compiled in half the time of one task for each field.
    """
    for k in ti.static(range(len(targets))):
        ti.loop_config(serialize=serial)
        for i in range(targets[k].shape[0]):
            first = ti.static(_first(targets, k)) + i * ti.static(_numbers(targets[k]))
            if ti.static(isinstance(targets[k], ti.MatrixField)):
                for p in ti.static(range(targets[k].n)):
                    for q in ti.static(range(targets[k].m)):
                        value = ti.bit_cast(bits[first + p * targets[k].m + q], targets[k].dtype)
                        if ti.static(targets[k].ndim == 1):
                            targets[k][i][p] = value
                        else:
                            targets[k][i][p, q] = value
            else:
                targets[k][i] = ti.bit_cast(bits[first], targets[k].dtype)


def _numbers(field) -> int:
    """In each slot."""
    return field.n * field.m if isinstance(field, ti.MatrixField) else 1


def _first(targets, k: int) -> int:
    """Where the values of the k-th field begin."""
    return sum(field.shape[0] * _numbers(field) for field in targets[:k])
