"""Parallel execution: the phases of a frame are queued as one Taichi graph, without returning to Python between them.

Every loop of a phase is a launch of its own on a GPU, and a frame has hundreds. Taichi compiles no parallel loop inside
a serial one, but a graph of its kernels (`ti.graph`) queues them all in one call, where Python takes 0.1 ms for each.
"""

from collections.abc import Sequence

import numpy as np
import taichi as ti
from numpy.typing import NDArray
from taichi.graph import Arg, ArgKind, Graph, GraphBuilder

from ..kernels.step_params import StepContext, collider_array, param_array
from ..system.taichi_compat import GRAPHS, DeviceArray, dispatch, usable

SCALARS = {"substeps": ti.i32, "h": ti.f32, "grabbed_count": ti.i32}
ARRAYS = {"params": 1, "colliders": 2}  # number of dimensions


@ti.kernel
def run_phase(
    phase: ti.template(),
    cloth: ti.template(),
    features: ti.template(),
    s: int,
    substeps: int,
    h: float,
    grabbed_count: int,
    params: param_array,
    colliders: collider_array,
):
    """Run one phase of substep `s`; every loop in it runs in parallel."""
    phase(cloth, features, ti.static(StepContext(s, substeps, h, grabbed_count, params, colliders)))


class GraphRunner:
    """Runs phases of substeps on one cloth."""

    def __init__(self, layout: object, features: object) -> None:
        self._layout = layout
        self._features = features
        # Device copies of the arrays by name, with what was last copied.
        self._arrays: dict[str, tuple[DeviceArray, NDArray[np.float32]]] = {}
        self._graphs: dict[tuple[tuple[object, int], ...], Graph] = {}

    def run(self, phases: Sequence[tuple[object, int]], shared: dict[str, object]) -> None:
        """Launch each phase for the substep beside it. `shared`: the other fields of `StepContext`, by name.

        The graph of a sequence of phases is built when it first runs.
        """
        if not usable(GRAPHS, _graph_is_correct):
            self._run_one_by_one(phases, shared)
            return
        values = {name: self._on_device(name, value) for name, value in shared.items()}
        key = tuple(phases)
        if key not in self._graphs:
            self._graphs[key] = self._build(key, values)
        self._graphs[key].run(values | {f"s{s}": s for _, s in phases})

    def close(self) -> None:
        """Free the arrays and drop the graphs now: garbage collection may happen in a later Taichi program."""
        for array, _ in self._arrays.values():
            array.free()
        self._arrays.clear()
        self._graphs.clear()

    def _on_device(self, name: str, value: object) -> object:
        """Return an array's copy on the device: from host memory every launch would copy it both ways."""
        if name not in ARRAYS:
            return value
        filled = _non_empty(value)
        array, last = self._arrays.get(name, (None, None))
        if last is None or last.shape != filled.shape:
            if array is not None:
                array.free()
            array = DeviceArray(filled.shape)
        if last is None or not np.array_equal(last, filled):  # a copy takes 0.1 ms
            array.from_numpy(filled)
            self._arrays[name] = array, filled.copy()
        return array

    def _run_one_by_one(self, phases: Sequence[tuple[object, int]], shared: dict[str, object]) -> None:
        """Launch from Python with arrays in host memory, which needs nothing internal of Taichi."""
        values = [_non_empty(shared[name]) for name in (*SCALARS, *ARRAYS)]
        for phase, s in phases:
            run_phase(phase, self._layout, self._features, s, *values)

    def _build(self, phases: Sequence[tuple[object, int]], values: dict[str, object]) -> Graph:
        builder = GraphBuilder()
        shared = [Arg(ArgKind.SCALAR, name, dtype) for name, dtype in SCALARS.items()]
        shared += [Arg(ArgKind.NDARRAY, name, ti.f32, ndim=dimensions) for name, dimensions in ARRAYS.items()]
        sample = [values[name] for name in (*SCALARS, *ARRAYS)]
        for phase, s in phases:
            arguments = [Arg(ArgKind.SCALAR, f"s{s}", ti.i32), *shared]
            dispatch(builder, run_phase, (phase, self._layout, self._features, s, *sample), arguments)
        return builder.compile()


def _non_empty(value: object) -> object:
    """Return an array with at least one row: Taichi has no empty arrays."""
    empty = isinstance(value, np.ndarray) and not value.size
    return np.zeros((1, *value.shape[1:]), np.float32) if empty else value


@ti.kernel
def probe(factor: ti.template(), s: int, out: param_array):
    """A loop with each kind of argument that a phase has."""
    for i in range(out.shape[0]):
        out[i] = out[i] + factor * s


def _graph_is_correct() -> bool:
    """Return whether a graph of two launches of the probe gives the right numbers."""
    array, builder = DeviceArray((4,)), GraphBuilder()
    for name in ("s0", "s1"):
        arguments = [Arg(ArgKind.SCALAR, name, ti.i32), Arg(ArgKind.NDARRAY, "out", ti.f32, ndim=1)]
        dispatch(builder, probe, (3, 0, array), arguments)
    builder.compile().run({"s0": 2, "s1": 5, "out": array})
    correct = bool((array.to_numpy() == 3 * 2 + 3 * 5).all())
    array.free()
    return correct
