"""The commands that measure: each prints its tables, writes its files and returns the exit code."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from . import runtime
from .cli_options import Command, count, strain
from .errors import OutputInUse, WrongUse
from .scene import load_scene
from .scene.model import SOLVER_NAMES

if TYPE_CHECKING:
    from .stress.causes import Cause
    from .stress.store import Store
    from .stress.unit import Result, Unit


def declare(command: Command) -> None:
    bench = command("bench", run_bench, "measure frames, compiling and memory on this machine", "bench --only verlet")
    which = bench.add_mutually_exclusive_group()
    which.add_argument("--only", choices=SOLVER_NAMES, metavar="SOLVER", help="measure one solver")
    which.add_argument("--stages", action="store_true", help="what each stage of the curtain costs, instead")
    which.add_argument("--goals", action="store_true", help="start, memory and errors of fine sheets, instead")
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
    validate.add_argument(
        "--from", type=Path, dest="read", metavar="FILE", help="read the rows that --json wrote instead of measuring"
    )
    validate.add_argument("--json", type=Path, metavar="FILE", help="write the rows, with bounds and sources")
    validate.add_argument("--markdown", type=Path, metavar="FILE", help="write the table for a document")
    validate.add_argument("--force", action="store_true", help="replace FILE")

    stress = command("stress", run_stress, "run 40 cases that break cloth", "stress --only yank --solver lines")
    stress.add_argument("--only", metavar="CASE", help="one case, by its number or name")
    stress.add_argument("--variant", metavar="NAME", help="with --only: one variant of the case")
    stress.add_argument(
        "--solver", choices=(*SOLVER_NAMES, "robust", "robust-slack"), metavar="NAME", help="one solver or setting"
    )
    stress.add_argument(
        "--tear", type=strain, metavar="STRAIN", help="sheets tear where threads are stretched by so much"
    )
    how_many = stress.add_mutually_exclusive_group()
    how_many.add_argument("--starts", type=count, default=10, metavar="N", help="starts of each variant")
    how_many.add_argument("--quick", action="store_const", dest="starts", const=1, help="one start of each variant")
    how_many.add_argument("--seed", type=int, metavar="N", help="with one variant and --solver: the start of this seed")
    stress.add_argument("--long", action="store_true", help="with --only 32: a million frames")
    stress.add_argument("--json", type=Path, metavar="FILE", help="write every result, after each variant")
    stress.add_argument("--resume", action="store_true", help="with --json: go on with what FILE has")
    stress.add_argument(
        "--explain", action="store_true", help="with --json: find causes of failures by experiments, after the run"
    )
    stress.add_argument("--from", type=Path, dest="source", metavar="FILE", help="run nothing: report what FILE has")
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
    if args.goals:
        return run_goals(args)
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


def run_goals(args: argparse.Namespace) -> int:
    from .accuracy import goals, pinned_sheet
    from .bench import startup
    from .progress import steps_progress

    if args.full or args.plot or args.scene or args.csv:
        raise WrongUse("--goals goes with --json, not with --full, --plot, --scene or --csv")
    with steps_progress(startup.MEASURED + len(pinned_sheet.CASES)) as on_step:
        commands = []
        for command in startup.measure():
            on_step(command.what)
            commands.append(command)
        runtime.start("cpu")
        sheets = []
        for case in pinned_sheet.CASES:
            on_step(case.name)
            sheets.append(pinned_sheet.measure(case))
    goals.print_report(commands, sheets)
    if args.json:
        goals.write_json(args.json, commands, sheets)
    return 0


def run_front(args: argparse.Namespace) -> int:
    from .accuracy import report, sweep
    from .accuracy.truth import Curtain
    from .bench.report import write_csv
    from .progress import steps_progress

    if args.stages or args.goals:
        raise WrongUse("--error, --stages and --goals are three measurements: give one of them")
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

    if args.stages or args.goals or args.only or args.full or args.plot:
        raise WrongUse(
            "--scene goes with --csv, --json and --markdown, not with --stages, --only, --full, --plot or --goals"
        )
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
    if args.json:
        gallery.write_json(args.json, found)
    if args.markdown:
        gallery.write_markdown(args.markdown, found)
    return 0


def run_validate(args: argparse.Namespace) -> int:
    from .bench.report import check_free
    from .progress import steps_progress
    from .validate import page, report
    from .validate.catalogue import chosen
    from .validate.running import measure_all

    for path in filter(None, (args.json, args.markdown)):
        check_free(path, force=args.force)
    if args.read:
        if args.only or args.solver:
            raise WrongUse("--from reads the rows of an earlier run: it goes without --only and --solver")
        run = report.read_json(args.read)
    else:
        pairs = chosen(args.only, args.solver)
        with steps_progress(len(pairs)) as on_step:
            run = report.this_machine(measure_all(pairs, on_step))
    report.print_report(run)
    if args.json:
        report.write_json(args.json, run)
    if args.markdown:
        page.write_pages(args.markdown, run)
    return 1 if any(result.row.unexplained for result in run.results) else 0


def run_stress(args: argparse.Namespace) -> int:
    from .bench.report import check_free
    from .stress import page, report, store

    if args.markdown:
        check_free(args.markdown, force=args.force)
    if args.tear is not None and args.markdown:
        raise WrongUse("--markdown writes the page about sheets that stay whole: --tear has no part in it")
    if args.source:
        if args.json or args.resume or args.explain:
            raise WrongUse("--from runs nothing: it goes without --json, --resume and --explain")
        kept = store.load(args.source)
        results = kept.ordered()
    else:
        kept, results = run_units(args)
    report.print_report(kept, results)
    if args.markdown:
        page.write_pages(args.markdown, kept)
    return 1 if kept.unexplained(results) else 0


def run_units(args: argparse.Namespace) -> tuple[Store, list[Result]]:
    """Runs what is not stored yet. All that is stored, and the results of what was asked for."""
    from .bench.report import check_free
    from .progress import steps_progress
    from .stress import running, store
    from .stress.choose import chosen
    from .stress.setting import ROBUST_SLACK

    for flag in ("resume", "explain"):
        if getattr(args, flag) and not args.json:
            raise WrongUse(f"--{flag} goes on with a file: give it with --json")
    if args.json and not (args.resume and args.json.is_file()):
        check_free(args.json, force=args.force)
    if args.pictures.exists() and not args.pictures.is_dir():
        raise OutputInUse(f"{args.pictures} is a file, not a folder")
    units = chosen(args.only, args.variant, args.solver, long=args.long, tear=args.tear)
    if args.seed is not None and (len(units) != 1 or args.json):
        raise WrongUse("--seed repeats one start: it goes with --only, --variant and --solver, and without --json")
    whole = units if args.long or args.tear is not None else chosen()
    kept = store.Store.new(args.json, whole)
    if args.resume and args.json.is_file():
        kept = kept.continued(store.load(args.json))
    needed = units if args.solver else [unit for unit in units if kept.is_needed(unit.key)]
    left = kept.left(needed, args.starts)
    seconds = {key: result.seconds for key, result in kept.results.items()}
    if known := [seconds[unit.key] for unit in left if unit.key in seconds]:
        hours = sum(known) / len(known) * len(left) / min(running.CORES, len(left)) / 3600
        print(f"{len(left)} of {len(needed)} variants to run: about {hours:.1f} hours", flush=True)

    def starts(unit: Unit) -> list[tuple[int, int]]:
        return [(0, args.seed)] if args.seed is not None else unit.starts(args.starts)

    with steps_progress(len(left)) as on_step:

        def keep(result: Result) -> None:
            kept.add(result)
            on_step(f"{result.case} {result.name}, {result.variant}, {result.setting}: {result.state}")

        # What another material changes is known to be needed once all others ran.
        slack = [unit for unit in left if unit.setting.name == ROBUST_SLACK.name]
        for some in ([unit for unit in left if unit not in slack], slack):
            if now := [unit for unit in some if args.solver or kept.is_needed(unit.key)]:
                running.run_all(running.dearest_first(now, seconds), starts, args.pictures, keep)
    if args.explain:
        explain(kept, units)
    return kept, kept.of(units)


def explain(kept: Store, units: list[Unit]) -> None:
    """Makes experiments on the failures of these units, where that was not done yet."""
    from .progress import steps_progress
    from .stress import running

    failed = kept.untried(units)
    with steps_progress(len(failed)) as on_step:

        def keep(unit: Unit, cause: Cause) -> None:
            kept.explain(unit.key, cause)
            on_step(f"{unit.name}: {cause.shown or 'unexplained'}")

        running.explain_all(failed, keep)
    if left := len(kept.untried(units)):
        print(f"{left} failures were not examined: a process ended before its time")


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
