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
        self._arrays: dict[str, tuple[Any, NDArray[np.float32]]] = {}  # by name, with what was last copied there
        self._graphs: dict[tuple[tuple[Any, int], ...], Graph] = {}

    def run(self, parts: Sequence[tuple[Any, int]], steering: dict[str, Any]) -> None:
        """Launches each part for the substep beside it. `steering`: the other fields of `Substep`, by name.

        A sequence of parts is put together when it is first asked for.
        """
        values = {name: self._there(name, value) for name, value in steering.items()}
        key = tuple(parts)
        if key not in self._graphs:
            self._graphs[key] = self._graph(key, values)
        self._graphs[key].run(values | {f"s{s}": s for _, s in parts})

    def _there(self, name: str, value: Any) -> Any:
        """An array where the threads run; from Python's memory every launch would copy it both ways."""
        if name not in TABLES:
            return value
        filled = value if value.size else np.zeros((1, *value.shape[1:]), np.float32)  # Taichi has no empty arrays
        array, last = self._arrays.get(name, (None, None))
        if last is None or last.shape != filled.shape:
            array = ti.ndarray(ti.f32, filled.shape)
        if last is None or not np.array_equal(last, filled):  # a copy takes 0.1 ms
            array.from_numpy(filled)
            self._arrays[name] = array, filled.copy()
        return array

    def _graph(self, parts: Sequence[tuple[Any, int]], values: dict[str, Any]) -> Graph:
        """Taichi's own `dispatch` takes no kernels with templates: they are compiled for the values at hand first."""
        builder = GraphBuilder()
        steering = [Arg(ArgKind.SCALAR, name, kind) for name, kind in SCALARS.items()]
        steering += [Arg(ArgKind.NDARRAY, name, ti.f32, ndim=count) for name, count in TABLES.items()]
        given = [values[name] for name in (*SCALARS, *TABLES)]
        kernel = run_part._primal
        for part, s in parts:
            key = kernel.ensure_compiled(part, self._work, self._stages, s, *given)
            arguments = [Arg(ArgKind.SCALAR, f"s{s}", ti.i32), *steering]
            builder._graph_builder.dispatch(kernel.compiled_kernels[key], arguments)
        return builder.compile()
