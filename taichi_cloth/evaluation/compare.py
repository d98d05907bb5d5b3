"""The command `compare`: two variants of a scene, side by side."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from ..cli.output_commands import log_option
from ..cli.program import (
    ARCH_HELP,
    DEFAULT_FRAMES,
    VIEWS,
    Command,
    any_of,
    check_log,
    count,
    file_path,
    no_errors_option,
    overrides,
    refuse_log,
    size,
)
from ..scene import Scene
from ..scene.solver_catalog import SOLVER_CATALOG
from ..system import taichi_runtime as runtime
from ..system.errors import UsageError

if TYPE_CHECKING:
    import numpy as np

    from ..render.split_view import Run


def add_commands(command: Command) -> None:
    """Add the command `compare`."""
    comparing = command(
        "compare",
        compare,
        "compare time, strain and error of two variants of a scene",
        "compare curtain --a solver=verlet,iterations=2 --b solver=explicit",
    )
    comparing.add_argument("scene", metavar="SCENE", help="shipped scene or TOML file")
    for letter, side in (("a", "left"), ("b", "right")):
        comparing.add_argument(
            f"--{letter}",
            action="append",
            default=[],
            metavar="KEY=VALUE,…",
            help=f"scene keys to override on the {side} side, such as solver=explicit; repeatable",
        )
    comparing.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE,…",
        help="scene keys to override on both sides; repeatable",
    )
    comparing.add_argument("--arch", choices=runtime.ARCHS, default="cpu", metavar="NAME", help=ARCH_HELP)
    comparing.add_argument(
        "--frames", type=count, metavar="N", help="number of frames (default: no limit in a window, 240 as images)"
    )
    comparing.add_argument(
        "--size",
        type=size,
        default="1240x720",
        metavar="WxH",
        help="size of window or image, both sides together [pixels]",
    )
    log_option(comparing)
    no_errors_option(comparing)
    comparing.add_argument("--headless", action="store_true", help="render images instead of opening a window")
    comparing.add_argument("--view", choices=VIEWS, default="shaded", metavar="NAME", help=f"view: {any_of(VIEWS)}")
    comparing.add_argument("--every", type=count, default=1, metavar="K", help="render every Kth frame")
    comparing.add_argument(
        "--out",
        type=file_path,
        metavar="DIR",
        help="folder of the images; implies --headless (default: out/compare_SCENE)",
    )
    comparing.add_argument("--force", action="store_true", help="overwrite existing images")


VERLET_NOTE = (
    "verlet has stiffnesses without unit: more iterations make its cloth stretch less, and may move it away from the"
    " reference, which has the springs of [fabric] (docs/frame_error.md)"
)
MAX_REFERENCE_STEPS = 5000  # in a frame; ten times those of the stiffest shipped scene


def compare(args: argparse.Namespace) -> int:
    """Run the command `compare`: in a window, or as images."""
    from ..geometry.scene_loader import load_scene

    check_log(args.log)
    shared = overrides(args.set, "--set")
    sides = overrides(args.a, "--a"), overrides(args.b, "--b")
    scenes = [load_scene(args.scene, **(shared | side)) for side in sides]
    for letter, side, scene in zip("ab", sides, scenes, strict=True):
        if SOLVER_CATALOG[scene.solver.name].is_explicit and {"iterations", "solver.iterations"} & side.keys():
            print(f"{letter}: {scene.solver.name} does not iterate: iterations has no effect")
    if scenes[0] == scenes[1]:
        raise UsageError(
            "both sides are the same scene: set a difference, such as --a solver=verlet --b solver=explicit"
        )
    from ..viewer.toolkit import window_obstacle

    obstacle = "--headless" if args.headless else "--out" if args.out else window_obstacle()
    if obstacle is None:
        from ..viewer import comparison_window
        from ..viewer.comparison import Comparison

        runtime.start(args.arch)
        left, right = scenes
        aspect = comparison_window.aspect_of(args.size)
        comparison_window.run(
            lambda: Comparison(left, right, aspect, view=args.view, errors=not args.no_errors),
            size=args.size,
            frames=args.frames,
            log=args.log,
        )
        return 0
    refuse_log(args.log, obstacle)
    if not (args.headless or args.out):
        print(f"no window ({obstacle}): rendering images instead", flush=True)
    return render_compared(scenes, args)


def render_compared(scenes: list[Scene], args: argparse.Namespace) -> int:
    """Render both scenes to images, and write and print what was measured."""
    from ..render import image, split_view
    from ..render.split_view import half_width
    from ..simulation.simulation import Simulation
    from ..system.console import frames_progress, printed_table, wide_console

    half_width(args.size[0])
    plan = image.RenderPlan(
        out=args.out or Path("out") / f"compare_{scenes[0].name}",
        frames=args.frames or DEFAULT_FRAMES,
        width=args.size[0],
        height=args.size[1],
        view=args.view,
        every=args.every,
    )
    runtime.start(args.arch)
    with Simulation(scenes[0]) as a, Simulation(scenes[1]) as b:
        for letter, simulation in (("a", a), ("b", b)):
            print(f"{letter}: {simulation.scene.name} · {simulation.method}", flush=True)
            if simulation.warnings:
                print(f"   {simulation.warnings}", flush=True)
        with image.claim_folder(plan, a, force=args.force, resume=None):
            reference = converged(scenes, plan.frames)
            with frames_progress(plan.frames) as advance:
                left, right, distances = split_view.render_both(
                    a, b, plan, advance, len(reference), errors=not args.no_errors
                )
            errors = [error(run, reference) for run in (left, right)]
            measured = {"horizon": len(reference), "rms_error": errors}
            split_view.write_report(plan, (left, right), distances, measured)
        wide_console().print(printed_table(table([left, right], errors)))
        print(summary(distances, reference))
        for line in explanations([median_frame_errors(run) for run in (left, right)], errors):
            print(line)
        if len(reference) and any(run.simulation.solver.name == "verlet" for run in (left, right)):
            print(VERLET_NOTE)
    print(f"{plan.images}; a is on the left, b on the right")
    return 0


def converged(scenes: list[Scene], frames: int) -> np.ndarray | tuple[()]:
    """Return the positions of the reference solution, (frames, N, 3) [m], up to its horizon and at most `frames`.

    Empty if the scenes differ in more than the solver, if the reference solver does not support them, and if it would
    take more than `MAX_REFERENCE_STEPS`.
    """
    from ..system.console import spinner
    from .bench import scene_error
    from .reference.solution import reason_unsupported, steps_per_frame

    a, b = (replace(scene, solver=scenes[0].solver, verlet=scenes[0].verlet) for scene in scenes)
    if a != b:
        print("no reference solution: the sides differ in more than [solver] and [verlet]")
        return ()
    if reason := reason_unsupported(a):
        print(f"no reference solution: {reason}")
        return ()
    if (steps := steps_per_frame(a)) > MAX_REFERENCE_STEPS:
        print(f"no reference solution: it would take {steps:,} steps a frame, more than {MAX_REFERENCE_STEPS:,}")
        return ()
    frames = min(frames, scene_error.FRAMES)
    print(f"reference solution: {frames} frames of {steps:,} steps, which only the first run computes …", flush=True)
    with spinner("reference solution: this can take minutes"):
        return scene_error.solution(a, frames).positions


def error(run: Run, reference: np.ndarray | tuple[()]) -> float | None:
    """Return the RMS error of positions up to the horizon, relative to the longer side; None without a reference."""
    import numpy as np

    if not len(reference) or not run.positions:
        return None
    frames = min(len(reference), len(run.positions))
    offsets = np.array(run.positions[:frames]) - reference[:frames]
    return float(np.sqrt((offsets**2).sum(axis=2).mean())) / run.simulation.topology.longest_side


def table(runs: list[Run], errors: list[float | None]) -> list[list[str]]:
    """Return the rows of the table as text, the header first."""
    import numpy as np

    from .bench import scene_error

    rows = [["", "setting", "ms", "p95", "max strain", *FRAME_ERROR_COLUMNS, "RMS error"]]
    for letter, run, rms_error in zip("ab", runs, errors, strict=True):
        median, p95 = np.percentile(run.ms, (50, 95))
        error_text = "-" if rms_error is None else scene_error.share(rms_error, 0.0)
        method = run.simulation.method
        parts = frame_error_cells(run)
        rows.append([letter, method, f"{median:.2f}", f"{p95:.2f}", f"{max(run.strain):.1%}", *parts, error_text])
    return rows


FRAME_ERROR_COLUMNS = ["frame error [mm]", "residual", "step error"]


def frame_error_cells(run: Run) -> list[str]:
    """Return the median error of a frame, the residual of the iterations and the step error [mm], as text."""
    return ["-" if value is None else f"{1e3 * value:.2g}" for value in median_frame_errors(run)]


def median_frame_errors(run: Run) -> list[float | None]:
    """Return the median error of a frame, the residual of the iterations and the step error [m]; None if unknown."""
    from ..simulation.copies import median_parts

    medians = median_parts(found.parts for found in run.frame_errors)
    return [medians[name] for name in ("error", "residual", "step_error")]


def explanations(frame_errors: list[list[float | None]], rms_errors: list[float | None]) -> list[str]:
    """Return lines about figures that seem to contradict each other.

    `frame_errors`: of both sides, as `median_frame_errors`. `rms_errors`: of both sides over the run.
    """
    lines = []
    for letter, (error, residual, step) in zip("ab", frame_errors, strict=True):
        if error and max(residual or 0.0, step or 0.0) > 1.5 * error:
            lines.append(
                f"{letter}: residual and step error point in opposite directions: they partly cancel in the frame error"
            )
    (a, *_), (b, *_) = frame_errors
    rms_a, rms_b = rms_errors
    if a and b and rms_a and rms_b and (a < b) != (rms_a < rms_b):
        lines.append(
            "a frame error is that of one frame from the state of its own side; in the RMS error those of all frames"
            " add up or cancel, so the order of the sides can differ"
        )
    return lines


def summary(distances: list[float], reference: np.ndarray | tuple[()]) -> str:
    """Return one line: the distance of the two sides at the end, and over which frames the error is."""
    from ..system.console import count_noun
    from .bench import scene_error

    line = f"RMS distance after {count_noun(len(distances), 'frame')}: {distances[-1]:.2%} of the side"
    if not len(reference):
        return f"{line}; no error, as there is no reference solution"
    if len(reference) >= len(distances):
        return line
    why = "" if len(reference) == scene_error.FRAMES else scene_error.CHAOS
    return f"{line}; RMS error: of the first {len(reference)} frames{why}"
