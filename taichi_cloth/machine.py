"""What a file says of the programs and the machine that made it."""

from __future__ import annotations

import platform
import re
import sys
from importlib.metadata import version
from pathlib import Path


def machine() -> dict[str, str]:
    """Versions and machine that a run's numbers belong to."""
    return {
        "taichi_cloth": version("taichi-cloth"),
        "taichi": version("taichi"),
        "numpy": version("numpy"),
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.machine()}",
    }


def cpu_model() -> str:
    """Name of the processor."""
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text(errors="replace").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def peak_bytes() -> int | None:
    """Most memory this process has had; None where the system does not tell."""
    status = Path("/proc/self/status")
    if status.exists():  # getrusage would start with the peak of the parent
        found = re.search(r"VmHWM:\s+(\d+) kB", status.read_text())
        return int(found[1]) * 1024 if found else None
    try:
        import resource
    except ImportError:  # Windows
        return None
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
