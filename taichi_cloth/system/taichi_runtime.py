"""Starts and stops Taichi, checks its kernel cache, and describes software versions and machine.

Only this module starts Taichi; importing the package does not.

Taichi 1.7 crashes (SIGSEGV, SIGABRT) at exit if it cannot create the folder of its kernel cache, and at the first
kernel if the index in that folder is damaged. A lock file left by a killed process disables the cache for good.
"""

from __future__ import annotations

import atexit
import contextlib
import gc
import io
import os
import platform
import re
import shutil
import struct
import sys
import tempfile
import threading
import time
import weakref
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING

from .errors import UsageError, choose_from

if TYPE_CHECKING:
    from . import taichi_compat

ARCHS = ("cpu", "cuda", "vulkan", "metal", "gpu")  # gpu: the first available of the other three
NUMBER_TYPES = {"default_fp": "f32", "default_ip": "i32"}  # options of `ti.init` that kernels of this package rely on
# Taichi prefers these to the options of `ti.init`.
IGNORED_VARIABLES = ("TI_ARCH", *(f"TI_{name.upper()}" for name in NUMBER_TYPES))

# Taichi reads these when it is imported: no banner on stdout, no thread that checks for a new version online.
os.environ.setdefault("ENABLE_TAICHI_HEADER_PRINT", "0")
os.environ.setdefault("TI_SKIP_VERSION_CHECK", "ON")
if "HOME" not in os.environ and os.name == "posix":  # Taichi caches there, and crashes without it
    home = os.path.expanduser("~")  # from the system's user database; "~" if the user is not in it
    os.environ.setdefault("XDG_CACHE_HOME", os.devnull if home == "~" else os.path.join(home, ".cache"))


_starting = threading.Lock()  # held while `start_if_needed` starts Taichi
_started: tuple[taichi_compat.ProgramRef, threading.Thread] | None = (
    None  # the program that `start` started, and its thread
)
_forked = False  # whether this process was forked from one in which Taichi ran


def start(arch: str = "cpu", **options: object) -> str:
    """Start Taichi on `arch`, after ending a running Taichi program. Return the arch that runs.

    `options` are passed to `ti.init`. The environment variables TI_ARCH, TI_DEFAULT_FP and TI_DEFAULT_IP are removed,
    because Taichi would use them instead.

    `arch`: "cpu", "cuda", "vulkan", "metal", or "gpu" for the first of these three that the machine has. Raises
    ValueError for another arch and for an unknown option, UsageError for an arch that this machine does not have, for
    default types of numbers other than float32 and int32, and in a forked process, and RuntimeError if there are still
    references to the ended program; the message names them.
    """
    global _started
    check_not_forked()
    chosen = available_arch(arch)
    import taichi as ti

    from . import taichi_compat

    for name, usual in NUMBER_TYPES.items():
        _check_number_type(name, options.get(name, getattr(ti, usual)))
    stop()
    if "offline_cache_file_path" not in options and taichi_compat.usable(taichi_compat.CACHE):
        usual = os.environ.get("TI_OFFLINE_CACHE_FILE_PATH") or taichi_compat.default_cache_folder()
        options["offline_cache_file_path"] = str(usable_cache_folder(Path(usual), stop))
    settings = {
        "log_level": ti.ERROR,  # no warnings, for example when two processes write to the kernel cache at once
        "enable_fallback": False,
        # By default Taichi caches 100 MB of kernels and drops the oldest; six solvers on a dozen scenes need more.
        "offline_cache_max_size_of_files": 1 << 29,  # [bytes]
        # On the CPU Taichi's own passes are off. Their time grows faster than the size of a kernel: 12 s for a frame in
        # the SIMD layout, 2 s without them. LLVM repeats most of their work; without them frames are 5–10 % slower.
        "advanced_optimization": chosen != "cpu",
        **options,
    }
    with contextlib.redirect_stdout(io.StringIO()):  # Taichi prints its arch and has no option against it
        try:
            ti.init(arch=getattr(ti, chosen), **settings)
        except KeyError as error:  # an option that it does not have
            raise ValueError(error.args[0]) from None
    _replace_parser()
    taichi_compat.on_start()
    _started = taichi_compat.ProgramRef(), threading.current_thread()  # an id is used again
    return chosen


def available_arch(arch: str) -> str:
    """Return the arch that `start` would start for `arch`. Raises ValueError and UsageError as `start` does."""
    if arch not in ARCHS:
        raise ValueError(f"unknown arch {arch!r}{choose_from(arch, ARCHS)}")
    for name in IGNORED_VARIABLES:
        os.environ.pop(name, None)
    _import_taichi()
    import taichi as ti

    from . import taichi_compat

    ti.set_logging_level(ti.ERROR)  # or a missing CUDA library is reported twice
    available = [name for name in ARCHS[1:-1] if taichi_compat.is_arch_available(name)]
    chosen = next(iter(available), "gpu") if arch == "gpu" else arch
    if chosen not in ("cpu", *available):
        raise UsageError(f"arch {arch} is not available: this machine has {', '.join(['cpu', *available])}")
    return chosen


def start_if_needed() -> None:
    """Start Taichi on the CPU unless it runs already. Raises UsageError in a forked process."""
    check_not_forked()
    with _starting:
        _import_taichi()
        from . import taichi_compat

        if taichi_compat.running_program() is None:
            start()
        else:
            import taichi as ti

            for name in NUMBER_TYPES:
                _check_number_type(name, getattr(ti.cfg, name))
            _replace_parser()


def _check_number_type(name: str, chosen: object) -> None:
    """Raise UsageError for a type of numbers with which kernels of this package end in a crash of Taichi."""
    import taichi as ti

    if chosen != getattr(ti, usual := NUMBER_TYPES[name]):
        raise UsageError(f"{name} must be ti.{usual}, the default of Taichi; kernels of your own can name their types")


def _replace_parser() -> None:
    """Let Taichi parse kernels faster and, if it runs on one thread, compile loops that need no other."""
    import taichi as ti

    from . import kernel_parsing

    kernel_parsing.replace_parser()
    if on_cpu() and ti.cfg.cpu_max_num_threads == 1:
        kernel_parsing.serialize_loops()


def _import_taichi() -> None:
    """Import Taichi without its message about graphical shells, which it logs where `sys.stdout` is replaced."""
    level = os.environ.get("TI_LOG_LEVEL")
    os.environ["TI_LOG_LEVEL"] = level or "error"
    import taichi  # noqa: F401

    if level is None:  # `ti.init` prefers it to its argument
        del os.environ["TI_LOG_LEVEL"]


def _after_fork() -> None:
    global _forked
    _forked = _started is not None and _started[0].runs()


if hasattr(os, "register_at_fork"):  # Windows has no fork
    os.register_at_fork(after_in_child=_after_fork)


def check_not_forked() -> None:
    """Raise UsageError in a process forked from one in which Taichi ran.

    Taichi's own threads do not exist there, and it would wait for them without end.
    """
    if _forked:
        raise UsageError(
            "Taichi does not work in a process forked from one that used it: start processes by"
            ' multiprocessing.get_context("spawn")'
        )


def check_thread() -> None:
    """Raise UsageError in another thread than the one that started Taichi, and in a forked process.

    In another thread Taichi would end in a failed assertion, after which no thread could open a simulation.
    """
    check_not_forked()
    if _started is not None and _started[1] is not threading.current_thread() and _started[0].runs():
        raise UsageError(
            "Taichi works only in the thread that started it: open and use simulations in one thread, or in processes;"
            " tc.init() starts it anew in this thread, and ends the simulations of the other"
        )


def stop() -> None:
    """End Taichi. Close all windows before; open simulations cannot continue.

    Raises RuntimeError if something else still refers to the ended program: once collected, it would free memory of the
    next program. Taichi does not start again until that reference is gone.
    """
    global _ended
    import taichi as ti

    from . import kernel_parsing, taichi_compat

    kernel_parsing.restore_functions()
    running = taichi_compat.running_program()
    if running is not None:
        _ended = weakref.ref(running)
    del running
    ti.reset()
    taichi_compat.on_reset()
    if _ended() is not None:
        gc.collect()
    if (program := _ended()) is not None:
        raise RuntimeError(f"Taichi's program has ended but is still referenced by {_referrers(program)}")


def on_cpu() -> bool:
    """Return whether the running Taichi program is compiled for the CPU."""
    import taichi as ti

    return ti.cfg.arch in (ti.x64, ti.arm64)


def running_arch() -> str:
    """Return the arch of the running Taichi program, as `start` returns it."""
    import taichi as ti

    return "cpu" if on_cpu() else str(ti.cfg.arch.name)


def _no_program() -> None:
    """Return None: no program has ended before the first start."""


_ended: Callable[[], object] = _no_program  # weak reference to the program that ended last


def _referrers(program: object) -> str:
    """Return what refers to a program, as text. Python does not report local variables of running functions."""
    words = []
    for referrer in gc.get_referrers(program):
        if isinstance(referrer, dict):  # the namespace of a module, or another dict
            module = referrer.get("__name__", "a dict")
            for name, value in referrer.items():  # a comprehension would add its cell as a referrer
                if value is program:
                    words.append(f"{module}: {name}")
        elif not isinstance(referrer, FrameType):
            words.append(f"a {type(referrer).__module__}.{type(referrer).__qualname__}")
    return ", ".join(words) or "a local variable"


# -- machine -----------------------------------------------------------------------------------------------------------


def machine() -> dict[str, str]:
    """Return software versions and system, which are stored with the results of a run."""
    return {
        "taichi_cloth": version("taichi-cloth"),
        "taichi": version("taichi"),
        "numpy": version("numpy"),
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.machine()}",
    }


def cpu_model() -> str:
    """Return the name of the processor."""
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text(errors="replace").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def peak_bytes() -> int | None:
    """Return the peak memory of this process [bytes], or None if the system does not report it."""
    status = Path("/proc/self/status")
    if status.exists():  # getrusage would include the peak of the parent
        found = re.search(r"VmHWM:\s+(\d+) kB", status.read_text())
        return int(found[1]) * 1024 if found else None
    try:
        import resource
    except ImportError:  # Windows
        return None
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


def memory_bytes() -> int | None:
    """Return the memory of this machine [bytes], or None if the system does not report it."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):  # AttributeError: Windows
        return None


INDEX, LOCK, KERNELS = "ticache.tcb", "ticache.lock", "*.tic"
LOCK_TIMEOUT = 60.0  # [s] while Taichi holds the lock, it reads the index, or writes a kernel every few milliseconds


def usable_cache_folder(usual: Path, before_exit: Callable[[], None]) -> Path:
    """Repair the folder `usual` and return it; if it cannot be used, return a temporary folder for this process.

    The temporary folder is removed at exit, after a call of `before_exit`. That function must end Taichi, which writes
    to its folder once more. Raises OSError if no temporary folder can be created either.
    """
    try:
        usual.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=usual):
            pass
        _repair(usual)
        return usual
    except OSError:
        folder = tempfile.mkdtemp(prefix="taichi_cloth_kernels_")

    def remove() -> None:
        before_exit()
        shutil.rmtree(folder, ignore_errors=True)

    atexit.register(remove)
    return Path(folder)


def _repair(folder: Path) -> None:
    """Remove the lock of a dead process, and a damaged index: its kernels are then compiled again. Raises OSError.

    A process is taken for dead if its lock is older than `LOCK_TIMEOUT`, and so are all kernels: the lock does not say
    whose it is.
    """
    lock, index = folder / LOCK, folder / INDEX
    with contextlib.suppress(FileNotFoundError):
        if time.time() - max(file.stat().st_mtime for file in (lock, *folder.glob(KERNELS))) > LOCK_TIMEOUT:
            lock.unlink()
    with contextlib.suppress(FileNotFoundError):
        if not is_index_consistent(index.read_bytes()):
            index.unlink()


def is_index_consistent(content: bytes) -> bool:
    """Return whether all lengths in an index of Taichi 1.7 are consistent.

    A wrong total length and another version count as sound, because Taichi detects them itself.

    The index has its total length, a version of three 16-bit numbers, the size of the folder and the number of kernels.
    Each kernel has its name twice, its size and two times. Lengths and counts are 64-bit numbers before their data.
    """
    head = struct.calcsize("<Q3HQQ")
    if len(content) < head:
        return True
    total, *version, _, kernels = struct.unpack_from("<Q3HQQ", content)
    length = len(content)
    if total != length or version[:2] != [1, 7]:
        return True
    offset = head
    for _ in range(kernels):
        for _ in range(2):
            if offset + 8 > length:
                return False
            offset += 8 + int.from_bytes(content[offset : offset + 8], "little")
        offset += 3 * 8
        if offset > length:
            return False
    return offset == length
