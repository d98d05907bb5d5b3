"""The commands that measure: each prints its tables, writes its files and returns the exit code."""

from __future__ import annotations

import argparse
from pathlib import Path

from . import runtime
from .cli_options import Command, count, strain
from .errors import OutputInUse, WrongUse
from .scene import load_scene
from .scene.model import SOLVER_NAMES


def declare(command: Command) -> None:
    bench = command("bench", run_bench, "measure frames, compiling and memory on this machine", "bench --only verlet")
    which = bench.add_mutually_exclusive_group()
    which.add_argument("--only", choices=SOLVER_NAMES, metavar="SOLVER", help="measure one solver")
    which.add_argument("--stages", action="store_true", help="what each stage of the curtain costs, instead")
    bench.add_argument("--error", action="store_true", help="how wrong each setting is, beside its time, instead")
    bench.add_argument(
        "--scene",
        action="append",
        default=[],
        metavar="SCENE",
        help="with --error: on this scene instead of the curtain",
    )
    bench.add_argument("--markdown", type=Path, metavar="FILE", help="with --scene: write the tables for a document")
    bench.add_argument("--plot", type=Path, metavar="DIR", help="with --error: a picture for each grid")
    bench.add_argument("--full", action="store_true", help="all there is; takes half an hour")
    bench.add_argument("--frames", type=count, default=120, metavar="N", help="frames to time in each measurement")
    bench.add_argument("--csv", type=Path, metavar="FILE", help="write the measurements, a line each")
    bench.add_argument("--json", type=Path, metavar="FILE", help="write measurements, stages and machine")
    bench.add_argument("--force", action="store_true", help="replace FILE")

    validate = command(
        "validate", run_validate, "measure every solver against known answers", "validate --only A2 --solver spring"
    )
    validate.add_argument("--only", metavar="REF", help="one reference, or all that begin so: A2.1, A2, B")
    validate.add_argument("--solver", choices=SOLVER_NAMES, metavar="NAME", help="one solver")
    validate.add_argument("--json", type=Path, metavar="FILE", help="write the rows, with bounds and sources")
    validate.add_argument("--markdown", type=Path, metavar="FILE", help="write the table for a document")
    validate.add_argument("--force", action="store_true", help="replace FILE")

    stress = command("stress", run_stress, "run 40 cases that break cloth", "stress --only yank --solver lines")
    stress.add_argument("--only", metavar="CASE", help="one case, by its number or name")
    stress.add_argument("--solver", choices=(*SOLVER_NAMES, "robust"), metavar="NAME", help="one solver, or robust")
    stress.add_argument(
        "--tear", type=strain, metavar="STRAIN", help="sheets tear where threads are stretched by so much"
    )
    stress.add_argument("--starts", type=count, default=10, metavar="N", help="starts of each case")
    stress.add_argument("--long", action="store_true", help="with --only 32: a million frames")
    stress.add_argument("--json", type=Path, metavar="FILE", help="write every start, with what broke")
    stress.add_argument("--markdown", type=Path, metavar="FILE", help="write the page for a document")
    stress.add_argument(
        "--pictures", type=Path, default=Path("out/stress"), metavar="DIR", help="folder for frames that failed"
    )
    stress.add_argument("--force", action="store_true", help="replace FILE")

    ablate = command("ablate", run_ablate, "what each stage of a scene costs, and what it changes", "ablate curtain")
    ablate.add_argument("scenes", nargs="+", metavar="SCENE", help="shipped scenes or TOML files")
    ablate.add_argument("--frames", type=count, default=120, metavar="N", help="frames to compare at most")
    ablate.add_argument("--markdown", type=Path, metavar="FILE", help="write the tables for a document")
    ablate.add_argument("--force", action="store_true", help="replace FILE")


def run_bench(args: argparse.Namespace) -> int:
    from .bench import cases as c
    from .bench import children, report
    from .progress import steps_progress

    for path in filter(None, (args.csv, args.json, args.markdown)):
        report.check_free(path, force=args.force)
    if args.markdown and not args.scene:
        raise WrongUse("--markdown writes the errors on scenes: it goes with --scene")
    if args.error:
        return run_gallery(args) if args.scene else run_front(args)
    if args.plot or args.scene:
        raise WrongUse("--plot and --scene are about errors: they go with --error")
    chosen = c.all_cases() if args.full else [] if args.stages else c.default_cases()
    cases = c.only(chosen, args.only)
    stages = c.stage_cases() if args.stages or (args.full and not args.only) else []
    with steps_progress(children.steps(cases, stages)) as on_step, children.bench(args.frames, on_step) as bench:
        rows, stage_rows = bench.measure(cases, stages)
    report.print_report(rows, stage_rows, bench.floor.missing)
    if args.csv:
        report.write_csv(args.csv, rows)
    if args.json:
        report.write_json(args.json, rows, stage_rows, bench.floor.missing)
    return 1 if report.failures(rows, stage_rows) else 0


def run_front(args: argparse.Namespace) -> int:
    from .accuracy import report, sweep
    from .accuracy.truth import Curtain
    from .bench.report import write_csv
    from .progress import steps_progress

    if args.stages:
        raise WrongUse("--error and --stages are two measurements: give one of them")
    if args.plot:
        report.plotting()
    runtime.start("cpu")
    cells = sweep.ALL_GRIDS if args.full else sweep.GRIDS
    wanted = list(sweep.points([Curtain(n) for n in cells], args.only))
    found = []
    with steps_progress(len(wanted)) as on_step:
        for curtain, solver, substeps, iterations in wanted:
            on_step(f"{solver} {substeps}×{iterations}, {curtain.cells} cells")
            found.append(sweep.measure(curtain, solver, substeps, iterations))
    found = sweep.once(found)
    report.print_report(found)
    if args.csv:
        write_csv(args.csv, found, sweep.Point)
    if args.json:
        report.write_json(args.json, found)
    if args.plot:
        print(f"{len(report.plot(args.plot, found))} pictures in {args.plot}")
    return 0


def run_gallery(args: argparse.Namespace) -> int:
    scenes = [load_scene(name) for name in args.scene]
    from .accuracy import gallery
    from .bench.report import write_csv
    from .progress import steps_progress

    if args.stages or args.only or args.full or args.plot or args.json:
        raise WrongUse("--scene goes with --csv and --markdown, not with --stages, --only, --full, --plot or --json")
    runtime.start("cpu")
    found = []
    with steps_progress(sum(len(gallery.settings(scene)) + 1 for scene in scenes)) as on_step:
        for scene in scenes:
            for step in gallery.errors(scene):
                if isinstance(step, str):
                    on_step(step)
                else:
                    found.append(step)
    gallery.print_report(found)
    if args.csv:
        write_csv(args.csv, [point for errors in found for point in errors.points], gallery.ScenePoint)
    if args.markdown:
        gallery.write_markdown(args.markdown, found)
    return 0


def run_validate(args: argparse.Namespace) -> int:
    from .bench.report import check_free
    from .progress import steps_progress
    from .validate import report
    from .validate.catalogue import chosen
    from .validate.row import measure

    for path in filter(None, (args.json, args.markdown)):
        check_free(path, force=args.force)
    pairs = chosen(args.only, args.solver)
    runtime.start("cpu")
    results = []
    with steps_progress(len(pairs)) as on_step:
        for reference, solver in pairs:
            on_step(f"{reference.number} {reference.name}, {solver}")
            results += measure(reference, solver)
    report.print_report(results)
    if args.json:
        report.write_json(args.json, results)
    if args.markdown:
        report.write_markdown(args.markdown, results)
    return 1 if any(result.broken for result in results) else 0


def run_stress(args: argparse.Namespace) -> int:
    from .bench.report import check_free
    from .progress import steps_progress
    from .stress import report, running
    from .stress.catalogue import chosen
    from .stress.setting import ROBUST

    for path in filter(None, (args.json, args.markdown)):
        check_free(path, force=args.force)
    if args.tear is not None and args.markdown:
        raise WrongUse("--markdown writes the page about sheets that stay whole: --tear has no part in it")
    if args.pictures.exists() and not args.pictures.is_dir():
        raise OutputInUse(f"{args.pictures} is a file, not a folder")
    pairs = chosen(args.only, args.solver, long=args.long, tear=args.tear)
    with steps_progress(len(pairs)) as on_step:
        results = running.run_all(pairs, args.starts, args.pictures, on_step)
    report.print_report(results)
    if args.json:
        report.write_json(args.json, results)
    if args.markdown:
        report.write_markdown(args.markdown, results)
    robust = ROBUST if args.tear is None else ROBUST.tearing(args.tear)
    return 0 if all(result.alive for result in results if result.setting == robust.name) else 1


def run_ablate(args: argparse.Namespace) -> int:
    scenes = [load_scene(name) for name in args.scenes]
    from .accuracy import ablate
    from .bench.report import check_free
    from .progress import steps_progress

    if args.markdown:
        check_free(args.markdown, force=args.force)
    runtime.start("cpu")
    found = []
    with steps_progress(len(scenes)) as on_step:
        for scene in scenes:
            on_step(scene.name)
            found.append(ablate.ablate(scene, args.frames))
    ablate.print_tables(found)
    if args.markdown:
        ablate.write_markdown(args.markdown, found)
    return 0
