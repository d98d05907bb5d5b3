"""How many floats Taichi's kernels treat at once on this processor: 4, 8 or 16.

LLVM's optimiser decides that by the processor's name, and takes 4 for one that it does not know: Taichi 1.7's LLVM 15
knows none of AMD from Zen 5 on. The code that it generates then does use AVX's instructions, four floats wide.
"""

import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

TIME_LIMIT = 60  # [s]
WIDTHS = {"x": 4, "y": 8, "z": 16}  # floats in a register: xmm, ymm, zmm


def floats_at_once() -> int | None:
    """By the assembly that Taichi writes for a small kernel; None where it is not that of an x86-64 processor."""
    with tempfile.TemporaryDirectory(prefix="taichi_cloth_registers_", ignore_cleanup_errors=True) as folder:
        command = [sys.executable, "-m", "taichi_cloth.bench.registers", folder]
        try:
            subprocess.run(command, capture_output=True, timeout=TIME_LIMIT, check=True)
        except (OSError, subprocess.SubprocessError):
            return None
        text = "".join(file.read_text(errors="replace") for file in Path(folder).glob("*.s"))
    return widest(text)


def widest(assembly: str) -> int | None:
    """Floats of the widest sum in x86-64 assembly; None where there is none."""
    return max((WIDTHS[letter] for letter in re.findall(r"\bv?addps\b.*%([xyz])mm", assembly)), default=None)


def main() -> None:
    import taichi as ti

    from .. import runtime

    os.chdir(sys.argv[1])  # where Taichi writes it
    runtime.start(offline_cache=False, print_kernel_asm=True)
    x = ti.Matrix.field(3, 8, ti.f32, 8)

    @ti.kernel
    def double():
        for i in x:
            x[i] = x[i] + x[i]

    double()


if __name__ == "__main__":
    main()
