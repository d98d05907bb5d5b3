"""Run the same hanging cloth in other cloth simulators, each in its own virtual environment.

    python benchmarks/peers/run.py [--filter NAME] [--json FILE] [--frames N]

The first run installs the other simulators (peers) with pip in `.env` in this folder. A peer that cannot be installed,
fails or takes too long is skipped with the reason. `cloth.py` defines the cloth. A small strain can come from a wrong
motion: the kinetic energy after the last frame shows whether the cloth still swings.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import venv
from dataclasses import dataclass
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
ENVIRONMENTS = HERE / ".env"
SIZES = ((24, 30), (64, 64))  # rows, columns

INSTALL_SECONDS = 900
RUN_SECONDS = 240


@dataclass(frozen=True)
class Peer:
    """Another simulator, measured by the script `NAME_cloth.py`."""

    name: str
    package: str
    """Package on PyPI."""
    settings: tuple[str, ...]
    """Settings of the script to run."""


PEERS = (
    Peer("pypbd", "pyPBD==2.2.2", ("xpbd 3x3", "distance 5x12", "distance 60x1")),
    Peer("mujoco", "mujoco==4.0.0", ("8 steps", "1 step")),
    Peer("pybullet", "pybullet==3.2.7", ("40 N/m", "2000 N/m")),
    Peer("newton", "newton==1.8.0", ("style3d 1x2", "style3d 2x10", "vbd 10x4")),
)


class Skip(Exception):
    """A peer, or one of its runs, is skipped. The message is one line with the reason."""


def last_line(text: str) -> str:
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return lines[-1] if lines else "no message"


def call(command: list[str], seconds: int) -> str:
    """Return the standard output of a command. Raises Skip with the last line of its error output."""
    try:
        result = subprocess.run(command, capture_output=True, text=True, timeout=seconds)
    except subprocess.TimeoutExpired:
        raise Skip(f"more than {seconds} s") from None
    except OSError as error:
        raise Skip(str(error)) from None
    if result.returncode:
        raise Skip(last_line(result.stderr))
    return result.stdout


def environment(peer: Peer) -> Path:
    """Return the Python of the peer's virtual environment, which is created by the first call."""
    folder = ENVIRONMENTS / peer.name
    python = folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    ready = folder / "installed"
    if not (ready.exists() and ready.read_text() == peer.package):
        print(f"{peer.name}: installing {peer.package}", file=sys.stderr)
        try:
            venv.create(folder, with_pip=True, clear=True)
        except (OSError, subprocess.CalledProcessError) as error:
            raise Skip(f"no virtual environment: {error}") from None
        install = [str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
        call([*install, peer.package, "numpy"], INSTALL_SECONDS)
        ready.write_text(peer.package)
    return python


def measure(python: Path, peer: Peer, rows: int, columns: int, frames: int, setting: str) -> dict[str, Any]:
    script = HERE / f"{peer.name}_cloth.py"
    output = call([str(python), str(script), str(rows), str(columns), str(frames), setting], RUN_SECONDS)
    line: dict[str, Any] = json.loads(last_line(output))  # some peers print other lines first
    return line


def table(lines: list[dict[str, Any]]) -> str:
    """Return the results as a Markdown table."""
    rows = [
        "| peer | columns × rows | setting | ms per frame | p95 | max strain | lowest | J/kg |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for line in lines:
        diverged = not line["finite"] or line["max_strain"] > 100
        result = (
            "blew up | – | –"
            if diverged
            else f"{100 * line['max_strain']:.1f} % | {line['lowest']:.3f} m | {line['kinetic_per_kg']:.3f}"
        )
        rows.append(
            f"| {line['peer']} {line['version']} | {line['columns']} × {line['rows']} | {line['setting']}"
            f" | {line['median_ms']:.1f} | {line['p95_ms']:.1f} | {result} |"
        )
    return "\n".join(rows)


def main() -> int:
    parser = argparse.ArgumentParser(description="run the same hanging cloth in other cloth simulators")
    parser.add_argument("--filter", choices=[peer.name for peer in PEERS], help="run one peer only")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all results to FILE")
    parser.add_argument("--frames", type=int, default=60, help="frames of 1/60 s (default 60)")
    arguments = parser.parse_args()
    lines = []
    for peer in PEERS:
        if arguments.filter not in (None, peer.name):
            continue
        try:
            python = environment(peer)
        except Skip as reason:
            print(f"{peer.name} skipped: {reason}", file=sys.stderr)
            continue
        for rows, columns in SIZES:
            for setting in peer.settings:
                try:
                    lines.append(measure(python, peer, rows, columns, arguments.frames, setting))
                except Skip as reason:
                    print(f"{peer.name} {columns} × {rows}, {setting} skipped: {reason}", file=sys.stderr)
    print(table(lines))
    if arguments.json:
        arguments.json.write_text(json.dumps(lines, indent=1) + "\n")
    return 0 if lines else 1


if __name__ == "__main__":
    sys.exit(main())
