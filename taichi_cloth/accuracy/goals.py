"""What `taichi-cloth bench --goals` measures beside the usual frames: commands from their start, and fine sheets.

docs/performance.md holds these figures, those of `bench` and those of `bench --error` against the project's goals.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from ..bench.report import machine, made, number, printed_table, wide_console
from ..bench.startup import Startup
from ..files import whole_file
from .pinned_sheet import SheetError


def print_report(commands: Sequence[Startup], sheets: Sequence[SheetError]) -> None:
    console = wide_console()
    lines = [["process", "seconds", "peak MB"]]
    lines += [[one.what, f"{one.seconds:.2f}", number(one.peak_mb, ".0f")] for one in commands]
    console.print(printed_table(lines))
    lines = [["sheet", "method", "frames", "ms", "p95", "error rms", "largest", "reference in doubt by", "strain"]]
    for one in sheets:
        errors = (f"{one.rms_error:.3%}", f"{one.max_error:.2%}", f"{one.doubt:.3%}", f"{one.max_strain:.1%}")
        lines.append([one.name, one.method, str(one.frames), f"{one.median_ms:.2f}", f"{one.p95_ms:.2f}", *errors])
    console.print(printed_table(lines))
    console.print(" · ".join(machine().values()), soft_wrap=True)


def write_json(path: Path, commands: Sequence[Startup], sheets: Sequence[SheetError]) -> None:
    """Raises OSError."""
    everything = {
        **made(),
        "commands": [asdict(one) for one in commands],
        "sheets": [asdict(one) for one in sheets],
    }
    with whole_file(path) as file:
        file.write(json.dumps(everything, indent=1).encode())
