"""Rows, tables and JSON of `bench --gpu`, and the bytes that a frame of each solver moves."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from ...scene.schema import FRAME_SECONDS
from ...scene.solver_catalog import SOLVER_CATALOG
from ...system.console import machine, milliseconds, new_file, number, printed_table, wide_console
from ..worker_pool import TIME
from .bench_report import run_info
from .error_sweep import FRAMES

SAME_MOTION = 1e-4  # [m] largest difference between CPU and GPU that counts as the same motion
REAL_TIME_ERROR = 0.01  # of the side


@dataclass(frozen=True)
class Comparison:
    """Difference between the CPU (serial layout) and the GPU after some frames of one scene."""

    scene: str
    solver: str
    frames: int
    rms_difference: float | None = None
    """Root mean square distance of the particles, as a share of the cloth's longer side."""
    max_difference: float | None = None
    """Largest distance of a particle, as a share of the longer side."""
    max_meters: float | None = None
    """Largest distance of a particle [m]."""
    error: str | None = None
    """Why it was not measured; None if it was."""

    @property
    def verdict(self) -> str:
        if self.error is not None:
            return not_measured(self.error)
        return "pass" if self.max_meters is not None and self.max_meters <= SAME_MOTION else "differs"


@dataclass(frozen=True)
class GridRow:
    """Frame time and error of one setting on the swinging curtain. A value that was not measured is None."""

    solver: str
    cells: int
    """Cells along a side."""
    substeps: int
    iterations: int
    is_default: bool = False
    """Whether it is the solver's default setting; an explicit solver takes the substeps that stability needs."""
    particles: int | None = None
    frames: int | None = None
    """Frames that were compared, from the start of the swing; all but the first were timed."""
    median_ms: float | None = None
    """Median frame time on the GPU [ms]."""
    p95_ms: float | None = None
    """95th percentile of the frame time [ms]."""
    rms_error: float | None = None
    """Root mean square over all particles and frames, as a share of the side."""
    max_error: float | None = None
    """Largest error of a particle in a frame, as a share of the side."""
    reference: str | None = None
    """What the error is measured against."""
    rms_uncertainty: float | None = None
    """Root mean square uncertainty of that reference, as a share of the side."""
    max_uncertainty: float | None = None
    """Largest uncertainty of that reference, as a share of the side."""
    phases: int | None = None
    """Phases that a frame queues: each is one launch for every loop that it has."""
    megabytes: float | None = None
    """Fewest megabytes that a frame moves."""
    bandwidth_share: float | None = None
    """`megabytes` a frame time, over the bandwidth of a copy. It exceeds 1 where the cloth stays in a cache."""
    setup_s: float | None = None
    """Time to build the simulation of this grid [s]."""
    compile_s: float | None = None
    """Time of the first frame on this grid less that of the second [s], without a kernel cache."""
    cpu_ms: float | None = None
    """Median frame time of the same setting on the CPU of this machine [ms]."""
    cpu_layout: str | None = None
    error: str | None = None
    """Why it was not measured; None if it was."""

    @classmethod
    def failed(cls, solver: str, cells: int, why: str) -> GridRow:
        """Return the row of a grid that was not measured."""
        return cls(solver, cells, *SOLVER_CATALOG[solver].defaults, is_default=True, error=why)

    def over(self, bandwidth: float | None) -> GridRow:
        """Return the row with the share of the bandwidth of a copy [bytes/s] that its frames reach."""
        if bandwidth is None or self.megabytes is None or self.median_ms is None:
            return self
        return replace(self, bandwidth_share=1e6 * self.megabytes / (1e-3 * self.median_ms) / bandwidth)

    @property
    def setting(self) -> str:
        """Substeps and iterations: `5×12`, or `110` for a solver without iterations."""
        return f"{self.substeps}" if SOLVER_CATALOG[self.solver].is_explicit else f"{self.substeps}×{self.iterations}"

    @property
    def shown_setting(self) -> str:
        """The setting, with a star for the default. The substeps of an explicit solver are known once it has run."""
        if self.median_ms is None and SOLVER_CATALOG[self.solver].is_explicit:
            return "-"
        return self.setting + "*" * self.is_default

    @property
    def is_real_time(self) -> bool:
        """Whether a frame takes at most 1/60 s, and the largest error of the whole second is at most 1 %.

        The uncertainty of the reference is added to the error.
        """
        if self.median_ms is None or self.max_error is None or self.max_uncertainty is None or self.frames != FRAMES:
            return False
        return self.median_ms <= 1e3 * FRAME_SECONDS and self.max_error + self.max_uncertainty <= REAL_TIME_ERROR


@dataclass
class GpuRun:
    """All that `bench --gpu` measures."""

    arch: str
    device: str
    """Name of the GPU; of the arch, if the system does not tell."""
    bandwidth: float | None = None
    """Bytes that a copy reads and writes in a second."""
    comparisons: list[Comparison] = field(default_factory=list)
    rows: list[GridRow] = field(default_factory=list)
    missing: dict[str, str] = field(default_factory=dict)
    """What else was not measured, with the reason."""
    seconds: float = 0.0
    """Time that the run took [s]."""


def device_name(arch: str) -> str:
    """Return the name of the GPU: Taichi does not tell it, NVIDIA's own program does."""
    if arch == "cuda":
        command = ["nvidia-smi", "--query-gpu=name", "--format=csv,noheader"]
        try:
            done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=20)
            return done.stdout.splitlines()[0].strip()
        except (OSError, subprocess.SubprocessError, IndexError):
            pass
    return arch


def not_measured(why: str) -> str:
    """Return why something was not measured, for a table: short. The JSON file has the whole reason."""
    return "not measured: time" if why == TIME else f"failed: {why if len(why) <= 60 else why[:59] + '…'}"


# -- bytes of a frame --------------------------------------------------------------------------------------------------

# Bytes of an element of each field that the curtain's kernels use: three float32 of a particle, or one.
VECTORS = (
    *("x", "x_prev", "velocity", "force", "start_velocity", "correction"),
    *("first_velocity", "velocity_sum", "acceleration_sum"),
    *("residual", "scaled", "direction", "solution", "product"),
)
BYTES = dict.fromkeys(VECTORS, 12) | {"inverse_mass": 4, "spring_first": 4}


@dataclass(frozen=True)
class Traffic:
    """Fewest bytes that a phase moves: in each of its loops, every field that it reads or writes, once.

    Nothing is assumed to stay in a cache from one loop to the next: the whole GPU waits between them.
    """

    particle: float = 0
    """Bytes for every particle."""
    spring: float = 0
    """Bytes for every spring."""

    def __add__(self, other: Traffic) -> Traffic:
        return Traffic(self.particle + other.particle, self.spring + other.spring)

    def times(self, count: float) -> Traffic:
        return Traffic(count * self.particle, count * self.spring)


def loop(reads: str, writes: str = "") -> Traffic:
    """Return the bytes of a loop over all particles; `reads` and `writes`: names of fields."""
    return Traffic(sum(BYTES[name] for name in f"{reads} {writes}".split()))


# A thread per particle goes over its springs: of every spring it reads the index, at both ends (2 × 4 bytes), the two
# particles (8), rest length and stiffness (4 each).
SPRINGS_OF_PARTICLES = Traffic(spring=24)
FORCES = loop("x force spring_first", "force") + SPRINGS_OF_PARTICLES
# A thread per spring of one color reads its particles (8 bytes), rest length and stiffness (4 each). Over all colors,
# every spring reads and writes what a constraint changes of both ends.
SPRING = Traffic(spring=16)
MULTIPLIER = Traffic(spring=4)


def of_both_ends(particle: Traffic) -> Traffic:
    return Traffic(spring=2 * particle.particle)


ACCELERATE = loop("x velocity force inverse_mass", "x velocity force")
BEGIN_STAGE = loop("x velocity inverse_mass", "x velocity x_prev start_velocity") + ACCELERATE
# Only the first of the two stages of a substep reads `start_velocity` and `inverse_mass` at its end: half of the time.
END_STAGE = (
    loop("velocity start_velocity", "start_velocity")
    + loop("x velocity", "x velocity x_prev")
    + loop("start_velocity inverse_mass").times(0.5)
)
# Down each line: index, rest length, stiffness and multiplier of a spring are read, n, coupling and change written (12,
# 4, 4). Up again: index, n, coupling and change are read, and the multiplier changed. The curtain has two directions.
LINES = Traffic(spring=4 * 4 + 20 + 4 + 20 + 8) + (
    loop("x inverse_mass") + loop("x velocity inverse_mass", "x velocity")
).times(2)
STAGE_OF_RK4 = FORCES + loop(
    "velocity force inverse_mass velocity_sum acceleration_sum x_prev first_velocity",
    "velocity_sum acceleration_sum x velocity force",
)
PRODUCT = (
    loop("direction inverse_mass", "product")
    + loop("x direction product spring_first", "product")
    + SPRINGS_OF_PARTICLES
    + loop("direction product")
    + loop("solution direction residual product inverse_mass", "solution residual scaled")
    + loop("residual scaled")
    + loop("scaled direction", "direction")
)
NOTHING = Traffic()  # of a phase whose features the curtain does not have

TRAFFIC: dict[str, dict[str, Traffic]] = {
    "verlet": {
        "predict": loop("x x_prev force inverse_mass", "x x_prev force"),
        "iterate": SPRING + of_both_ends(loop("x inverse_mass", "x")),
        "finalize": NOTHING,
    },
    "xpbd": {
        "predict": ACCELERATE + loop("", "x_prev") + MULTIPLIER,
        "iterate": SPRING + MULTIPLIER.times(2) + of_both_ends(loop("x velocity inverse_mass", "x velocity")),
        "finalize": NOTHING,
    },
    "explicit": {"predict": FORCES + ACCELERATE, "finalize": NOTHING, "stop_at_colliders": NOTHING},
    "lines": {
        "predict": BEGIN_STAGE + MULTIPLIER,
        "iterate": LINES,
        "finalize": END_STAGE,
        "stop_at_colliders": NOTHING,
    },
    "rk4": {
        "no_op": NOTHING,
        "finalize": loop("x velocity inverse_mass", "x_prev velocity first_velocity velocity_sum acceleration_sum")
        + STAGE_OF_RK4.times(4)
        + loop("x_prev velocity_sum first_velocity acceleration_sum", "x velocity"),
        "stop_at_colliders": NOTHING,
    },
    "implicit": {
        "predict": BEGIN_STAGE + loop("", "correction"),
        "start_iteration": FORCES
        + loop("inverse_mass force correction", "force residual")
        + loop("residual inverse_mass", "scaled direction solution")
        + loop("residual scaled"),
        "cg_iteration": PRODUCT,
        "end_iteration": loop("x velocity solution correction", "x velocity correction") + loop("solution"),
        "finalize": END_STAGE,
        "stop_at_colliders": NOTHING,
    },
}


def frame_bytes(solver: str, phases: Mapping[str, int], particles: int, springs: int) -> float | None:
    """Return the fewest bytes that a frame of the curtain moves; None if a phase is not in `TRAFFIC`.

    `phases`: how often the frame runs each phase.
    """
    known = TRAFFIC[solver]
    if set(phases) - set(known):
        return None
    total = Traffic()
    for name, count in phases.items():
        total += known[name].times(count)
    return total.particle * particles + total.spring * springs


# -- report ------------------------------------------------------------------------------------------------------------

COMPARED = ("scene", "solver", "frames", "RMS difference", "largest", "largest mm", "")
HEADINGS = ("solver", "cells", "n×m", "frames", "ms", "p95", "max error", "RMS", "±", "MB", "of copy", "phases")
MORE = ("first s", "build s", "CPU ms", "CPU ÷ GPU", "")
LEGEND = (
    "Swinging curtain (as `bench --error`), one second or fewer frames · max error, RMS: distance from the converged\n"
    "float64 motion of the same grid, as a share of the side · ±: largest uncertainty of that motion · MB: fewest that"
    " a\nframe moves · of copy: MB a frame time over the bandwidth of a copy · phases: queued in a frame · first: time"
    " to\ncompile · build: time to build the grid · CPU: the same setting on this machine's CPU · *: default setting ·"
    " ←: real\ntime within 1 %"
)


def compared_cells(row: Comparison) -> list[str]:
    """Return a row of the table of comparisons as text."""
    meters = None if row.max_meters is None else 1e3 * row.max_meters
    figures = (number(row.rms_difference, ".1e"), number(row.max_difference, ".1e"), number(meters, ".2g"))
    return [row.scene, row.solver, str(row.frames), *figures, row.verdict]


def cells(row: GridRow) -> list[str]:
    """Return a row of the table of grids as text."""
    faster = None if row.cpu_ms is None or row.median_ms is None else row.cpu_ms / row.median_ms
    remark = not_measured(row.error) if row.error is not None else "←" if row.is_real_time else ""
    return [
        row.solver,
        str(row.cells),
        row.shown_setting,
        number(row.frames, "d"),
        milliseconds(row.median_ms),
        milliseconds(row.p95_ms),
        *(number(share, ".1e") for share in (row.max_error, row.rms_error, row.max_uncertainty)),
        number(row.megabytes, ".3g"),
        number(row.bandwidth_share, ".0%"),
        number(row.phases, "d"),
        number(row.compile_s, ".1f"),
        number(row.setup_s, ".1f"),
        milliseconds(row.cpu_ms),
        number(faster, ".2g"),
        remark,
    ]


def largest_real_time(rows: Sequence[GridRow]) -> GridRow | None:
    """Return the fastest row of the largest grid with a setting that runs in real time within 1 %."""
    found = [row for row in rows if row.is_real_time and row.median_ms is not None]
    return min(found, key=lambda row: (-row.cells, row.median_ms or 0.0), default=None)


def summary_lines(run: GpuRun) -> list[str]:
    """Return lines of text: bandwidth, the largest cloth in real time, and what was not measured."""
    copied = "not measured" if run.bandwidth is None else f"{run.bandwidth / 1e9:,.0f} GB/s"
    best = largest_real_time(run.rows)
    real_time = "no setting"
    if best is not None:
        real_time = f"{best.particles:,} particles, {best.solver} {best.setting}, {milliseconds(best.median_ms)} ms"
    return [
        f"Bandwidth of a copy, read and written: {copied}",
        f"In real time (a frame in {1e3 * FRAME_SECONDS:.1f} ms) within {REAL_TIME_ERROR:.0%}: {real_time}",
        *(f"{what}: {not_measured(why)}" for what, why in run.missing.items()),
        " · ".join((run.device, run.arch, *machine().values(), f"{run.seconds:.0f} s")),
    ]


def print_report(run: GpuRun) -> None:
    """Print both tables, the summary lines, and GPU and machine in the last line."""
    console = wide_console()
    console.width = max(console.width, 200)  # else every cell would be broken
    console.print(printed_table([COMPARED, *map(compared_cells, run.comparisons)]))
    console.print(f"pass: no particle differs by more than {1e3 * SAME_MOTION:g} mm", soft_wrap=True)
    console.print(printed_table([(*HEADINGS, *MORE), *map(cells, run.rows)]))
    for line in (LEGEND, *summary_lines(run)):
        console.print(line, soft_wrap=True)


def write_json(path: Path, run: GpuRun) -> None:
    """Write all results as JSON. Raises OSError."""
    results = {**run_info(), **asdict(run), "summary": summary_lines(run)}
    with new_file(path) as file:
        file.write(json.dumps(results, indent=1, allow_nan=False).encode())


def read_run(words: Mapping[str, Any]) -> GpuRun:
    """Return the run in the content of a JSON file."""
    return GpuRun(
        arch=words["arch"],
        device=words["device"],
        bandwidth=words["bandwidth"],
        comparisons=[Comparison(**row) for row in words["comparisons"]],
        rows=[GridRow(**row) for row in words["rows"]],
        missing=words["missing"],
        seconds=words["seconds"],
    )
