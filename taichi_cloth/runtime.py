"""Starting Taichi: the only place that does, so that importing the package never does."""

from __future__ import annotations

import contextlib
import functools
import io
import os
import textwrap
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from .errors import WrongUse
from .kernel_cache import sound_folder

ARCHS = ("cpu", "cuda", "vulkan", "metal", "gpu")  # gpu: the first of the three that is there

# Read by Taichi when it is imported: no banner on stdout, no thread that asks the network for a newer version.
os.environ.setdefault("ENABLE_TAICHI_HEADER_PRINT", "0")
os.environ.setdefault("TI_SKIP_VERSION_CHECK", "ON")
if "HOME" not in os.environ and os.name == "posix":  # Taichi looks there for its cache, and ends the process without it
    home = os.path.expanduser("~")  # as the system's list of users says; "~" for a user who is not in it
    os.environ.setdefault("XDG_CACHE_HOME", os.devnull if home == "~" else os.path.join(home, ".cache"))


def start(arch: str = "cpu", **options: Any) -> str:
    """Starts Taichi on `arch`, ending what ran before; other options go to `ti.init`. Returns the arch that runs.

    The environment's TI_ARCH, which Taichi would follow instead, is set aside.
    Raises ValueError for an arch that is not one of `ARCHS`, and WrongUse for one that this machine does not have.
    """
    if arch not in ARCHS:
        raise ValueError(f"unknown arch {arch!r}: {', '.join(ARCHS)}")
    os.environ.pop("TI_ARCH", None)
    import taichi as ti

    ti.set_logging_level(ti.ERROR)  # or a missing CUDA library is told twice
    there = [name for name in ARCHS[1:-1] if ti.lang.misc.is_arch_supported(getattr(ti, name))]
    chosen = next(iter(there), "gpu") if arch == "gpu" else arch
    if chosen not in ("cpu", *there):
        raise WrongUse(f"arch {arch} is not there: this machine has {', '.join(['cpu', *there])}")
    _read_kernels_once()
    if "offline_cache_file_path" not in options:
        usual = os.environ.get("TI_OFFLINE_CACHE_FILE_PATH") or ti.lang.impl.default_cfg().offline_cache_file_path
        options["offline_cache_file_path"] = str(sound_folder(Path(usual), stop))
    settings = {
        "log_level": ti.ERROR,  # a warning is told, for one, when two programs write to the cache of kernels at once
        "enable_fallback": False,
        # Taichi keeps 100 MB of compiled kernels and then drops the oldest: six methods on a dozen scenes are more.
        "offline_cache_max_size_of_files": 1 << 29,  # [bytes]
        # Taichi's own passes over a kernel grow faster than its size (12 s for a frame in strips, against 2 s
        # without them); LLVM does most of their work again, and frames are 5–10 % slower.
        "advanced_optimization": chosen != "cpu",
        **options,
    }
    with contextlib.redirect_stdout(io.StringIO()):  # Taichi prints its arch, and offers no switch for it
        ti.init(arch=getattr(ti, chosen), **settings)
    return chosen


def _read_kernels_once() -> None:
    """Takes half the time and more off Taichi's reading of a kernel: 1 s of each start, whatever its cache holds.

    At each call that it inlines, a thousand in one frame, Taichi 1.7 looks through all modules and splits the file for
    the lines of the function. For its error messages it wraps the line and a row of carets for every part of every
    expression, 60,000 times for one frame, though there are no more than 4,000 different ones. The messages stay the
    same.
    """
    from taichi.lang import kernel_impl
    from taichi.lang.ast import ast_transformer_utils

    kernel_impl.getsourcefile, kernel_impl.getsourcelines = _source_file, _source_lines
    ast_transformer_utils.TextWrapper = _wrapper


@functools.cache
def _source_file(function: Callable[..., Any]) -> str:
    from taichi.lang import _wrap_inspect

    return str(_wrap_inspect.getsourcefile(function))


@functools.cache
def _source_lines(function: Callable[..., Any]) -> tuple[list[str], int]:
    """The lines and the number of the first."""
    from taichi.lang import _wrap_inspect

    lines, first = _wrap_inspect.getsourcelines(function)
    return lines, first


@functools.cache
def _wrapper(width: int) -> SimpleNamespace:
    """A `textwrap.TextWrapper` that remembers."""
    return SimpleNamespace(wrap=functools.cache(textwrap.TextWrapper(width).wrap))


def start_if_needed() -> None:
    """Starts Taichi on the CPU unless it runs already."""
    import taichi as ti

    if ti.lang.impl.get_runtime().prog is None:
        start()


def stop() -> None:
    """Ends Taichi; simulations and windows must be closed before."""
    import taichi as ti

    ti.reset()
