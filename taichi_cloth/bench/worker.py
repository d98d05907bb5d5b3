"""One measurement in a process of its own: its kernels, its cache and its memory are nobody else's.

`python -m taichi_cloth.bench.worker` reads a line of JSON for each order and answers each with one:

    {"cases": [...], "cache": folder}  → how long each case took to compile, and what it turned out to be
    {"frames": n, "seconds": s}        → milliseconds of each frame of each case, n or what s seconds allow
    {"depth_of": n}                    → how deep cloth was in a body, in the first n frames of each case [m]
    end of the input                   → strain and size of each case, and the peak of the memory
"""

from __future__ import annotations

import dataclasses
import json
import os
import sys
from math import prod
from typing import Any

from .. import runtime
from ..machine import peak_bytes
from ..simulation import Simulation
from ..timing import frames, timed_frame
from .cases import Case, scene_of, static_strain


def first_frame(simulation: Simulation) -> dict[str, Any]:
    """Compiles: what the first frame takes longer than the second."""
    compiling, running = timed_frame(simulation), timed_frame(simulation)
    return {
        "compile_s": (compiling - running) / 1e3,
        "path": simulation.solver.path,
        "substeps": simulation.substeps,
        "springs": simulation.topology.spring_count,
    }


def deepest(simulation: Simulation, count: int) -> float:
    """The largest penetration [m] after each of the first frames."""
    simulation.reset()
    depth = 0.0
    for _ in range(count):
        simulation.advance_frame()
        depth = max(depth, simulation.measure().penetration)
    return depth


def state_bytes(simulation: Simulation) -> int:
    """Size of the fields of the cloth and of what its solver keeps beside it."""
    total = 0
    for state in {id(s): s for s in (simulation.cloth, *vars(simulation.solver).values())}.values():
        if dataclasses.is_dataclass(state):
            for field in dataclasses.fields(state):
                values = getattr(state, field.name)
                if hasattr(values, "dtype") and hasattr(values, "shape"):
                    total += 4 * prod(values.shape) * getattr(values, "n", 1) * getattr(values, "m", 1)
    return total


def outcome(simulation: Simulation) -> dict[str, Any]:
    measures = simulation.measure()
    strain = measures.max_strain if measures.finite else None
    return {
        "max_strain": strain,
        "static_strain": static_strain(simulation.scene),
        "state_bytes": state_bytes(simulation),
    }


def main() -> None:
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # whatever else prints does not end up among the answers

    def answer(message: Any) -> None:
        answers.write(json.dumps(message) + "\n")
        answers.flush()

    order = json.loads(sys.stdin.readline() or "null")
    if order is None:
        return
    runtime.start(offline_cache_file_path=order["cache"])
    simulations, compiled = [], []
    for words in order["cases"]:
        case = Case(**words)
        simulations.append(Simulation(scene_of(case), case.path))
        compiled.append(first_frame(simulations[-1]))
    answer(compiled)
    for line in sys.stdin:
        order = json.loads(line)
        if "depth_of" in order:
            answer([deepest(simulation, order["depth_of"]) for simulation in simulations])
        else:
            answer(frames(simulations, order["frames"], order["seconds"]))
    answer({"cases": [outcome(simulation) for simulation in simulations], "peak_bytes": peak_bytes()})
    for simulation in simulations:
        simulation.close()
    runtime.stop()  # writes the cache


if __name__ == "__main__":
    main()
