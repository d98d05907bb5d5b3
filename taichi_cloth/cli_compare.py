"""`compare`: a scene in two ways, side by side."""

from __future__ import annotations

import argparse
import re
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from . import runtime
from .cli_options import DEFAULT_FRAMES, VIEWS, Command, count, size
from .errors import WrongUse
from .scene import Scene, load_scene, parse_override

if TYPE_CHECKING:
    import numpy as np

    from .view.compare_frames import Run

NEXT_KEY = re.compile(r",(?=\s*\w+\s*=)")  # a comma inside a value is followed by no key


def declare(command: Command) -> None:
    comparing = command(
        "compare",
        compare,
        "a scene in two ways, side by side, with the time, the strain and the error of each",
        "compare curtain --a solver=verlet,iterations=2 --b solver=spring",
    )
    comparing.add_argument("scene", metavar="SCENE", help="a shipped scene or a TOML file")
    for letter, side in (("a", "left"), ("b", "right")):
        comparing.add_argument(
            f"--{letter}",
            action="append",
            default=[],
            metavar="KEY=VALUE,…",
            help=f"what is other on the {side}, as in solver=spring",
        )
    comparing.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="what is other in both")
    comparing.add_argument("--arch", choices=runtime.ARCHS, default="cpu", help="Taichi back-end")
    comparing.add_argument("--frames", type=count, metavar="N", help="end after so many frames")
    comparing.add_argument("--size", type=size, default="1480x640", metavar="WxH", help="size of both in pixels")
    comparing.add_argument("--log", type=Path, metavar="FILE", help="write one line of JSON for every displayed frame")
    comparing.add_argument("--headless", action="store_true", help="render pictures even where a window could open")
    comparing.add_argument("--view", choices=VIEWS, default="shaded", help="how the cloth is drawn")
    comparing.add_argument("--every", type=count, default=1, metavar="K", help="draw every K-th frame only")
    comparing.add_argument(
        "--out", type=Path, metavar="DIR", help="folder for the pictures (default: out/compare_SCENE)"
    )
    comparing.add_argument("--force", action="store_true", help="replace the pictures in DIR")


def overrides(texts: list[str]) -> dict[str, Any]:
    """`solver=verlet,iterations=2` as keys and values. Raises SceneError for what is none."""
    return dict(parse_override(part) for text in texts for part in NEXT_KEY.split(text))


def compare(args: argparse.Namespace) -> int:
    shared = overrides(args.set)
    scenes = [load_scene(args.scene, **(shared | overrides(own))) for own in (args.a, args.b)]
    if scenes[0] == scenes[1]:
        raise WrongUse("both sides are the same scene: say what differs, as in --a solver=verlet --b solver=spring")
    from .view.display import window_obstacle

    obstacle = "--headless was given" if args.headless or args.out else window_obstacle()
    if obstacle is None:
        from .view import pair_window
        from .view.pair import Pair

        runtime.start(args.arch)
        left, right = scenes
        pair_window.run(
            lambda: Pair(left, right, pair_window.aspect_of(args.size)),
            size=args.size,
            frames=args.frames,
            log=args.log,
        )
        return 0
    if not (args.headless or args.out):
        print(f"no window ({obstacle}): rendering frames instead", flush=True)
    return render_compared(scenes, args)


def render_compared(scenes: list[Scene], args: argparse.Namespace) -> int:
    from .bench.report import printed_table, wide_console
    from .progress import counted, frames_progress
    from .simulation import Simulation
    from .view import compare_frames, frames
    from .view.sides import half_of

    half_of(args.size[0])
    plan = frames.Plan(
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
        with frames.claimed(plan, a, force=args.force, resume=False):
            truth = converged(scenes, plan.frames)
            with frames_progress(plan.frames) as advance:
                left, right, distances = compare_frames.render_both(a, b, plan, advance, len(truth))
            errors = [error(run, truth) for run in (left, right)]
            told = {"horizon": len(truth), "rms_error": errors}
            compare_frames.write_report(plan, (left, right), distances, told)
        wide_console().print(printed_table(table([left, right], errors)))
        print(summary(distances, truth))
    print(f"{counted(plan.pictures, 'picture')} in {plan.out}, a on the left, b on the right")
    return 0


def converged(scenes: list[Scene], frames: int) -> np.ndarray | tuple[()]:
    """Where the particles truly are, (frames, N, 3) [m], up to the horizon and at most so many frames.

    Nothing for two different cloths, and for one that the reference does not cover.
    """
    from .accuracy import gallery
    from .reference.solution import without_solution

    a, b = (replace(scene, solver=scenes[0].solver, springs=scenes[0].springs) for scene in scenes)
    if a != b or without_solution(a):
        return ()
    print("the reference that both are measured against …", flush=True)
    return gallery.solution(a, min(frames, gallery.FRAMES)).places


def error(run: Run, truth: np.ndarray | tuple[()]) -> float | None:
    """Root mean square of all places up to the horizon, as a share of the longer side."""
    import numpy as np

    if not len(truth) or not run.places:
        return None
    seen = min(len(truth), len(run.places))
    away = np.array(run.places[:seen]) - truth[:seen]
    return float(np.sqrt((away**2).sum(axis=2).mean())) / run.simulation.topology.side


def table(runs: list[Run], errors: list[float | None]) -> list[list[str]]:
    """Rows of text, the heading first."""
    import numpy as np

    rows = [["", "setting", "ms", "p95", "largest strain", "error rms"]]
    for letter, run, wrong in zip("ab", runs, errors, strict=True):
        ms, worst = np.percentile(run.ms, (50, 95))
        told = "-" if wrong is None else f"{wrong:.3%}"
        method = run.simulation.method
        rows.append([letter, method, f"{ms:.2f}", f"{worst:.2f}", f"{max(run.strain):.1%}", told])
    return rows


def summary(distances: list[float], truth: np.ndarray | tuple[()]) -> str:
    """How far apart they are, and what the error is one of."""
    from .progress import counted

    line = f"apart after {counted(len(distances), 'frame')}: {distances[-1]:.2%} of the side"
    if not len(truth):
        return f"{line}; two different cloths, or one without an independent reference, have no error"
    return (
        f"{line}; the error is one of the first {len(truth)} frames, behind which a hair's difference is another motion"
    )
