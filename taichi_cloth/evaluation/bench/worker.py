"""A child process of the bench, with its own kernels, kernel cache and memory.

`python -m taichi_cloth.evaluation.bench.worker` reads requests, each a line of JSON, and writes a line for each:

    {"cases": [...], "cache": folder}  → of each case: compile time [s], layout, substeps, number of springs
    {"frames": n, "seconds": s}        → time of each frame of each case [ms]: n frames, or fewer after s seconds
    {"depth_of": n}                    → largest penetration of each case in its first n frames [m]
    end of input                       → strain and size of the fields of each case, and peak memory; of one case also
                                         the error of a frame
"""

from __future__ import annotations

import dataclasses
import json
import os
import sys
from contextlib import closing
from math import prod

from ...simulation.copies import FrameErrorMeter, time_frames, timed_frame
from ...simulation.simulation import Simulation
from ...system import taichi_runtime as runtime
from ...system.errors import UsageError
from ...system.taichi_runtime import peak_bytes
from .cases import Case, scene_of, static_strain


def first_frame(simulation: Simulation) -> dict[str, object]:
    """Run two frames. Return facts about the case; the compile time [s] is the first frame's less the second's."""
    compiling, running = timed_frame(simulation), timed_frame(simulation)
    return {
        "compile_s": (compiling - running) / 1e3,
        "layout": simulation.solver.layout_name,
        "substeps": simulation.substeps,
        "springs": simulation.topology.spring_count,
    }


def deepest(simulation: Simulation, count: int) -> float:
    """Restart, and return the largest penetration after each of the first `count` frames [m]."""
    simulation.reset()
    depth = 0.0
    for _ in range(count):
        simulation.step()
        depth = max(depth, simulation.metrics().penetration)
    return depth


def state_bytes(simulation: Simulation) -> int:
    """Return the size of the fields of the cloth and of its solver's layouts [bytes]."""
    total = 0
    for state in {id(s): s for s in (simulation.cloth, *vars(simulation.solver).values())}.values():
        if dataclasses.is_dataclass(state):
            for field in dataclasses.fields(state):
                values = getattr(state, field.name)
                if hasattr(values, "dtype") and hasattr(values, "shape"):
                    total += 4 * prod(values.shape) * getattr(values, "n", 1) * getattr(values, "m", 1)
    return total


def outcome(simulation: Simulation) -> dict[str, object]:
    """Return the largest strain (None if the cloth blew up), the static strain, and the size of the fields [bytes]."""
    metrics = simulation.metrics()
    strain = metrics.max_strain if metrics.finite else None
    return {
        "max_strain": strain,
        "static_strain": static_strain(simulation.scene),
        "state_bytes": state_bytes(simulation),
    }


def error_of_a_frame(simulation: Simulation) -> float | None:
    """Return the error of the next frame [m] (`FrameErrorMeter`), or None if the fabric is too stiff to measure it.

    Also None if the reference has not converged.
    """
    try:
        meter = FrameErrorMeter(simulation.scene, simulation.requested_layout)
    except UsageError:
        return None
    with closing(meter):
        found = meter.measure_frame(simulation)
        return found.error if found.reference_has_converged else None


def main() -> None:
    """Serve requests until the end of input."""
    responses = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # other output goes to stderr, not between the responses

    def respond(message: object) -> None:
        responses.write(json.dumps(message) + "\n")
        responses.flush()

    request = json.loads(sys.stdin.readline() or "null")
    if request is None:
        return
    runtime.start(offline_cache_file_path=request["cache"])
    simulations, compiled = [], []
    for arguments in request["cases"]:
        case = Case(**arguments)
        simulations.append(Simulation(scene_of(case), case.layout))
        compiled.append(first_frame(simulations[-1]))
    respond(compiled)
    for line in sys.stdin:
        request = json.loads(line)
        if "depth_of" in request:
            respond([deepest(simulation, request["depth_of"]) for simulation in simulations])
        else:
            respond(time_frames(simulations, request["frames"], request["seconds"]))
    peak = peak_bytes()  # without the copies that measure the error
    outcomes = [outcome(simulation) for simulation in simulations]
    if len(simulations) == 1:
        outcomes[0]["frame_error"] = error_of_a_frame(simulations[0])
    respond({"cases": outcomes, "peak_bytes": peak})
    for simulation in simulations:
        simulation.close()
    runtime.stop()  # writes the cache


if __name__ == "__main__":
    main()
