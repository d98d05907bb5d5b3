"""A frame for many threads: its parts are launched one after the other without going back to Python.

Every loop of a part is a launch of its own on a GPU, and a frame has hundreds. Taichi compiles no parallel loop inside
a serial one; but a graph of its kernels (`ti.graph`) queues them all from one call, where Python would take 0.1 ms
for each.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import taichi as ti
from numpy.typing import NDArray
from taichi.graph import Arg, ArgKind, Graph, GraphBuilder

from ..kernels.controls import Substep, row, table
from ..kernels.internals import GRAPHS, usable
from ..state.device_array import DeviceArray

SCALARS = {"substeps": ti.i32, "h": ti.f32, "held": ti.i32}
TABLES = {"controls": 1, "bodies": 2}  # number of dimensions


@ti.kernel
def run_part(
    part: ti.template(),
    cloth: ti.template(),
    stages: ti.template(),
    s: int,
    substeps: int,
    h: float,
    held: int,
    controls: row,
    bodies: table,
):
    """One part of substep `s`; every loop in it runs in parallel."""
    part(cloth, stages, ti.static(Substep(s, substeps, h, held, controls, bodies)))


class Launches:
    """Runs parts of substeps on one cloth."""

    def __init__(self, work: Any, stages: Any) -> None:
        self._work = work
        self._stages = stages
        # By name, with what was last copied there.
        self._arrays: dict[str, tuple[DeviceArray, NDArray[np.float32]]] = {}
        self._graphs: dict[tuple[tuple[Any, int], ...], Graph] = {}

    def run(self, parts: Sequence[tuple[Any, int]], steering: dict[str, Any]) -> None:
        """Launches each part for the substep beside it. `steering`: the other fields of `Substep`, by name.

        A sequence of parts is put together when it is first asked for.
        """
        if not usable(GRAPHS, _graph_gives_right_numbers):
            self._run_one_by_one(parts, steering)
            return
        values = {name: self._there(name, value) for name, value in steering.items()}
        key = tuple(parts)
        if key not in self._graphs:
            self._graphs[key] = self._graph(key, values)
        self._graphs[key].run(values | {f"s{s}": s for _, s in parts})

    def close(self) -> None:
        """Frees the arrays and drops the graphs, at once: the garbage collector may come in a later Taichi program."""
        for array, _ in self._arrays.values():
            array.free()
        self._arrays.clear()
        self._graphs.clear()

    def _there(self, name: str, value: Any) -> Any:
        """An array where the threads run; from Python's memory every launch would copy it both ways."""
        if name not in TABLES:
            return value
        filled = _not_empty(value)
        array, last = self._arrays.get(name, (None, None))
        if last is None or last.shape != filled.shape:
            if array is not None:
                array.free()
            array = DeviceArray(filled.shape)
        if last is None or not np.array_equal(last, filled):  # a copy takes 0.1 ms
            array.from_numpy(filled)
            self._arrays[name] = array, filled.copy()
        return array

    def _run_one_by_one(self, parts: Sequence[tuple[Any, int]], steering: dict[str, Any]) -> None:
        """From Python, with tables in its memory: nothing of Taichi's inside."""
        given = [_not_empty(steering[name]) for name in (*SCALARS, *TABLES)]
        for part, s in parts:
            run_part(part, self._work, self._stages, s, *given)

    def _graph(self, parts: Sequence[tuple[Any, int]], values: dict[str, Any]) -> Graph:
        builder = GraphBuilder()
        steering = [Arg(ArgKind.SCALAR, name, kind) for name, kind in SCALARS.items()]
        steering += [Arg(ArgKind.NDARRAY, name, ti.f32, ndim=count) for name, count in TABLES.items()]
        given = [values[name] for name in (*SCALARS, *TABLES)]
        for part, s in parts:
            arguments = [Arg(ArgKind.SCALAR, f"s{s}", ti.i32), *steering]
            _dispatch(builder, run_part, (part, self._work, self._stages, s, *given), arguments)
        return builder.compile()


def _not_empty(value: Any) -> Any:
    """A table of at least one row: Taichi has no empty arrays."""
    empty = isinstance(value, np.ndarray) and not value.size
    return np.zeros((1, *value.shape[1:]), np.float32) if empty else value


def _dispatch(builder: GraphBuilder, kernel: Any, values: Sequence[Any], arguments: Sequence[Any]) -> None:
    """Taichi's own `dispatch` takes no kernels with templates: they are compiled for the values at hand first."""
    primal = kernel._primal
    key = primal.ensure_compiled(*values)
    builder._graph_builder.dispatch(primal.compiled_kernels[key], list(arguments))


@ti.kernel
def probe(times: ti.template(), s: int, out: row):
    """A loop with each kind of argument that a part has."""
    for i in range(out.shape[0]):
        out[i] = out[i] + times * s


def _graph_gives_right_numbers() -> bool:
    """Whether a graph of two launches of the probe does."""
    array, builder = DeviceArray((4,)), GraphBuilder()
    for name in ("s0", "s1"):
        arguments = [Arg(ArgKind.SCALAR, name, ti.i32), Arg(ArgKind.NDARRAY, "out", ti.f32, ndim=1)]
        _dispatch(builder, probe, (3, 0, array), arguments)
    builder.compile().run({"s0": 2, "s1": 5, "out": array})
    right = bool((array.to_numpy() == 3 * 2 + 3 * 5).all())
    array.free()
    return right
