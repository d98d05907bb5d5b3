"""Starting Taichi: the only place that does, so that importing the package never does."""

from __future__ import annotations

import contextlib
import gc
import io
import os
import weakref
from collections.abc import Callable
from pathlib import Path
from types import FrameType
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
    Raises ValueError for an arch that is not one of `ARCHS`, WrongUse for one that this machine does not have, and
    RuntimeError where something keeps a reference to Taichi's program that ended, which it names.
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
    stop()
    # Only now: they import Taichi.
    from . import source_cache
    from .kernels.internals import CACHE, usable

    source_cache.install()
    if "offline_cache_file_path" not in options and usable(CACHE):
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


def start_if_needed() -> None:
    """Starts Taichi on the CPU unless it runs already."""
    import taichi as ti

    if ti.lang.impl.get_runtime().prog is None:
        start()
    else:
        from . import source_cache

        source_cache.install()


def stop() -> None:
    """Ends Taichi. Windows must be closed before; simulations that are open can go no further.

    Raises RuntimeError where something else keeps a reference to the ended program: when that goes, it frees memory of
    the next program. Nothing starts again before it has gone.
    """
    global _ended
    import taichi as ti

    from . import source_cache

    source_cache.remove()
    running = ti.lang.impl.get_runtime().prog
    if running is not None:
        _ended = weakref.ref(running)
    del running
    ti.reset()
    if _ended() is not None:
        gc.collect()
    if (program := _ended()) is not None:
        raise RuntimeError(f"Taichi's program has ended, and is still referred to by {_holders(program)}")


def _gone() -> None:
    """Before the first start: nothing has ended."""


_ended: Callable[[], Any] = _gone  # the program that ended last, by a weak reference


def _holders(program: Any) -> str:
    """What refers to a program, in words. Python does not tell of local variables of functions that run."""
    words = []
    for holder in gc.get_referrers(program):
        if isinstance(holder, dict):  # of a module, or any other
            module = holder.get("__name__", "a dict")
            for name, value in holder.items():  # no comprehension: its cell would be one more holder
                if value is program:
                    words.append(f"{module}: {name}")
        elif not isinstance(holder, FrameType):
            words.append(f"a {type(holder).__module__}.{type(holder).__qualname__}")
    return ", ".join(words) or "a local variable"
