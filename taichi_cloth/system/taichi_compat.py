"""Uses of Taichi internals, with checks that they exist and work.

Only this module and `kernel_parsing.py` touch Taichi internals, which `tests/test_layers.py` checks. They are not part
of Taichi's interface, so another release may change or remove them. Each use is checked before it is relied on: the
release, the names, and for kernels a probe that must return the right numbers. If a check fails, the program does
without the internals, prints one line, and is slower.

The uses are the running program (`PROGRAM`), SIMD kernels (`SIMD`), graphs of kernel launches (`GRAPHS`), repeated
launches (`LAUNCHES`) and the folder of compiled kernels (`CACHE`). `DeviceArray` is the array type of graphs.
`kernel_parsing.py` has three more.
"""

import weakref
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial, reduce
from typing import Any, NamedTuple

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from .errors import one_line, print_note

# -- checks ------------------------------------------------------------------------------------------------------------

TESTED = (1, 7, 4)  # release that all uses were tested with
CPUS = (ti.x64, ti.arm64)


class InternalUse(NamedTuple):
    """One use of Taichi internals."""

    names: tuple[str, ...]
    """Dotted names it needs, within `taichi`."""
    fallback: str
    """What happens without it, for the user."""


PROGRAM = InternalUse(("lang.impl.get_runtime", "lang.impl.PyTaichi"), "references to an ended program are not found")
SIMD = InternalUse(
    (
        "_lib.core.CompileConfig.real_matrix_scalarize",
        "_lib.core.CompileConfig.fast_math",
        "lang.impl.current_cfg",
        "lang.impl.PyTaichi.materialize",
        "_lib.core.TypeFactory.get_tensor_type",
    ),
    "grids use the serial layout, which is slower",
)
GRAPHS = InternalUse(
    (
        "lang.kernel_impl.Kernel.ensure_compiled",
        "_lib.core.GraphBuilder.dispatch",
        "graph.GraphBuilder",
        "lang._ndarray.ScalarNdarray",
        "_lib.core.Program.delete_ndarray",
    ),
    "kernels are launched one by one, which is slower",
)
LAUNCHES = InternalUse(
    (
        "lang.kernel_impl.Kernel.ensure_compiled",
        "_lib.core.Kernel.make_launch_context",
        "_lib.core.KernelLaunchContext.set_arg_int",
        "_lib.core.KernelLaunchContext.set_arg_float",
        "_lib.core.KernelLaunchContext.set_arg_external_array_with_shape",
        "_lib.core.Program.compile_kernel",
        "_lib.core.Program.launch_kernel",
    ),
    "each frame takes up to 0.4 ms longer",
)
CACHE = InternalUse(
    ("lang.impl.default_cfg", "_lib.core.CompileConfig.offline_cache_file_path"),
    "compiled kernels are cached in Taichi's own folder, which is not checked",
)

_checked: dict[tuple[InternalUse, str], bool] = {}  # by use, and by name of the arch if it has a probe


def usable(use: InternalUse, probe: Callable[[], bool] | None = None) -> bool:
    """Return whether a use works: its names exist, and `probe` returns True on the current arch.

    Each use is checked once, with a probe once per arch. If the check fails, one line is printed.
    """
    key = use, "" if probe is None else str(ti.cfg.arch)  # the object is freed with its program
    if key not in _checked:
        problem = _find_problem(use, probe)
        _checked[key] = not problem
        if problem:
            print_note(f"{problem}: {use.fallback}")
    return _checked[key]


def find_internal(name: str) -> Any:
    """Return the object with this dotted name within `taichi`. Raises AttributeError."""
    return reduce(getattr, name.split("."), ti)


def _find_problem(use: InternalUse, probe: Callable[[], bool] | None) -> str:
    """Return why a use does not work, or "" if it works."""
    if ti.__version__ != TESTED:
        installed, tested = (".".join(map(str, version)) for version in (ti.__version__, TESTED))
        return f"Taichi is {installed}, but only {tested} is tested"
    for name in use.names:
        try:
            find_internal(name)
        except AttributeError:
            return f"Taichi has no {name}"
    try:
        return "" if probe is None or probe() else "a probe kernel returns wrong numbers"
    except Exception as error:  # the program can do without, whatever the error
        return f"a probe kernel fails ({one_line(f'{type(error).__name__}: {error}')[:200]})"


# -- Taichi programs and device arrays ---------------------------------------------------------------------------------


class _UnknownProgram:
    """Stands for the running program where `PROGRAM` is not usable."""


_unknown_program: _UnknownProgram | None = None


def running_program() -> Any:
    """Return the running Taichi program, or None. Do not store it; use `ProgramRef` instead."""
    return ti.lang.impl.get_runtime().prog if usable(PROGRAM) else _unknown_program


def on_start() -> None:
    """Call this after `ti.init`."""
    global _unknown_program
    _unknown_program = _UnknownProgram()


def on_reset() -> None:
    """Call this after `ti.reset`."""
    global _unknown_program
    _unknown_program = None


class ProgramRef:
    """Weak reference to the Taichi program that runs when the reference is created.

    A Taichi program owns all fields, arrays and compiled kernels, from `ti.init` to `ti.reset`. An ended program must
    not be kept alive: its destructor frees its arrays by address, and by then those addresses may belong to the next
    program.
    """

    def __init__(self) -> None:
        program = running_program()
        self._program = None if program is None else weakref.ref(program)

    def runs(self) -> bool:
        """Return whether that program still runs. False if none ran."""
        program = None if self._program is None else self._program()
        return program is not None and program is running_program()


# If a release does not have this class, the check of `GRAPHS` fails and no array is created.
_ScalarNdarray: Any = getattr(getattr(ti.lang, "_ndarray", None), "ScalarNdarray", object)


class DeviceArray(_ScalarNdarray):  # type: ignore[misc]  # Taichi has no types
    """A `ti.ndarray` of float32 in device memory that frees itself only while its own program runs.

    The array of Taichi 1.7.4 deletes its address in whichever program runs when Python collects it. If its own program
    has ended, that may be the address of an array in use. An ended program has freed its arrays itself.
    """

    arr: Any
    """Handle of Taichi."""

    def __init__(self, shape: tuple[int, ...]) -> None:
        super().__init__(ti.f32, shape)
        self._delete = weakref.finalize(self, _delete, ProgramRef(), self.arr)
        self._delete.atexit = False  # modules may be unloaded by then

    def free(self) -> None:
        """Free the memory now, even if the array is still referenced. A second call has no effect."""
        self._delete()
        self.arr = None

    def __del__(self) -> None:
        """Do nothing, instead of the destructor of Taichi: `_delete` frees the memory."""


def _delete(program: ProgramRef, array: Any) -> None:
    if program.runs():
        running_program().delete_ndarray(array)


# -- SIMD kernels ------------------------------------------------------------------------------------------------------


def tensor_type(element: Any) -> Any:
    """Return the type of a field element that LLVM gets as one value; `element`: a vector or matrix type."""
    return element.tensor_type


def materialize_fields() -> None:
    """Allocate all fields that were declared so far. Taichi does so before the next kernel."""
    ti.lang.impl.get_runtime().materialize()


@contextmanager
def no_scalarization(on: bool) -> Iterator[None]:
    """Compile kernels without scalarization, if `on`.

    Fast math is off too: it would reorder the sums of packets and not those of scalars, and the SIMD layout has to give
    the same bits as the serial one. No other kernel is compiled meanwhile: Taichi works in one thread only, which
    `taichi_runtime.check_thread` checks before each frame.
    """
    if not on:
        yield
        return
    options = ti.lang.impl.current_cfg()
    before = options.real_matrix_scalarize, options.fast_math
    options.real_matrix_scalarize = options.fast_math = False
    try:
        yield
    finally:
        options.real_matrix_scalarize, options.fast_math = before


# -- graphs ------------------------------------------------------------------------------------------------------------


def dispatch(builder: Any, kernel: Any, values: Sequence[object], arguments: Sequence[object]) -> None:
    """Add a launch of `kernel` to the graph that `builder` builds.

    Taichi's own `dispatch` takes no kernel with templates, so the kernel is compiled for `values` first.
    """
    primal = kernel._primal
    key = primal.ensure_compiled(*values)
    builder._graph_builder.dispatch(primal.compiled_kernels[key], list(arguments))


# -- repeated launches -------------------------------------------------------------------------------------------------


class RepeatedLaunch:
    """A kernel that is launched many times with the same templates, on the CPU in a tenth of the time of a call.

    Taichi 1.7.4 looks up the compiled kernel and makes a launch context at every call, which takes longer than a frame
    of a small cloth. Here both are kept. Integers, floats and arrays may change; arrays must be C-contiguous. On a GPU,
    in debug mode and without `LAUNCHES` this is a plain call.
    """

    def __init__(self, kernel: Any, *, scalarize: bool = True) -> None:
        """`scalarize`: see `no_scalarization`."""
        self._kernel, self._scalarize = kernel, scalarize
        self._program: ProgramRef | None = None  # in which the launch was prepared
        self._code: Any = None
        self._context: Any = None
        self._setters: list[tuple[int, tuple[int], Any]] = []  # position, index in the context, and its setter or type

    def __call__(self, *values: Any) -> None:
        """Launch the kernel. Templates must be those of the first call. Raises ValueError for an unsuitable array."""
        if self._program is None or not self._program.runs():
            self._program = ProgramRef()
            with no_scalarization(not self._scalarize):
                self._prepare(values)
        if self._context is None:
            with no_scalarization(not self._scalarize):
                self._kernel(*values)
            return
        self._launch(values)

    def _launch(self, values: Sequence[Any]) -> None:
        for position, index, set_value in self._setters:
            set_value(index, values[position])
        running_program().launch_kernel(self._code, self._context)

    def _prepare(self, values: Sequence[Any]) -> None:
        """Compile the kernel, if it can be launched without a call."""
        self._context = None
        if not ti.cfg.debug and ti.cfg.arch in CPUS and usable(PROGRAM) and usable(LAUNCHES, _launch_is_correct):
            self._compile(values)

    def _compile(self, values: Sequence[Any]) -> None:
        primal, program = self._kernel._primal, running_program()
        compiled = primal.compiled_kernels[primal.ensure_compiled(*values)]
        self._code = program.compile_kernel(program.config(), program.get_device_caps(), compiled)
        self._context = compiled.make_launch_context()
        self._setters = []
        for position, argument in enumerate(primal.arguments):
            kind = argument.annotation
            if not isinstance(kind, ti.template):
                self._setters.append((position, (len(self._setters),), self._setter(kind)))

    def _setter(self, kind: Any) -> Any:
        """Return the function that sets an argument of this annotation."""
        if kind in (int, ti.i32):
            return self._context.set_arg_int
        if kind in (float, ti.f32):
            return self._context.set_arg_float
        return partial(_set_array, self._context, np.dtype(ti.lang.util.to_numpy_type(kind.dtype)))


def _set_array(context: Any, dtype: np.dtype[Any], index: tuple[int], array: NDArray[Any]) -> None:
    if array.dtype != dtype or not array.flags.c_contiguous:
        raise ValueError(f"the kernel takes a C-contiguous array of {dtype}, not of {array.dtype}")
    context.set_arg_external_array_with_shape(index, array.ctypes.data, array.nbytes, array.shape, 0)


f32_array = ti.types.ndarray(dtype=ti.f32, ndim=1)


@ti.kernel  # type: ignore[untyped-decorator]
def launch_probe(shift: ti.template(), count: int, factor: float, values: f32_array):  # type: ignore
    """Each kind of argument that a frame has."""
    for i in range(count):
        values[i] = factor * values[i] + shift  # type: ignore[index]


def _launch_is_correct() -> bool:
    """Return whether a launch that is repeated with other arguments gives the right numbers."""
    launch = RepeatedLaunch(launch_probe)
    values = np.array([1, 2, 3], np.float32), np.array([4, 5, 6], np.float32)
    calls = (1, 3, 2.0, values[0]), (1, 2, 0.5, values[1])
    launch._compile(calls[0])
    for call in calls:
        launch._launch(call)
    return [array.tolist() for array in values] == [[3, 5, 7], [3, 3.5, 6]]


# -- parsing (the uses are in `kernel_parsing.py`) ---------------------------------------------------------------------


@ti.func  # type: ignore[untyped-decorator]
def _add_square(total: int, i: int) -> int:
    return total + i * i


@ti.kernel  # type: ignore[untyped-decorator]
def parse_probe(use: ti.template(), count: int) -> int:  # type: ignore[valid-type]
    """Return Σ i² over i < count, twice: in each kind of loop, with a function that is inlined. `use`: any number."""
    total = 0
    for i in range(count):
        total += _add_square(0, i)
    for i, j in ti.ndrange(count, 1):
        total += _add_square(j, i)
    return total


def parsed_correctly(use: int) -> bool:
    """Return whether a kernel that is compiled now returns the right number. `use`: a number for each replacement."""
    return bool(parse_probe(use, 5) == 60)


# -- start-up ----------------------------------------------------------------------------------------------------------


def is_arch_available(name: str) -> bool:
    """Return whether this machine has an arch. True if the release has no such check: starting Taichi decides."""
    supported = getattr(ti.lang.misc, "is_arch_supported", None)
    return supported is None or bool(supported(getattr(ti, name)))


def default_cache_folder() -> str:
    """Return the folder in which Taichi caches compiled kernels. Needs `CACHE`."""
    return str(ti.lang.impl.default_cfg().offline_cache_file_path)
