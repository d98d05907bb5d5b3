"""The commands `bench`, `validate`, `stress` and `ablate`, which print tables and write files."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from ..cli.program import Command, any_of, count, file_path, seed, strain
from ..scene.schema import SOLVER_NAMES
from ..system import taichi_runtime as runtime
from ..system.errors import OutputConflict, UsageError

if TYPE_CHECKING:
    from .stress.store import Store
    from .stress.unit import Result, Unit

SETTINGS = (*SOLVER_NAMES, "robust", "robust-slack")
ONE_SOLVER = f"measure only this solver: {any_of(SOLVER_NAMES)}"


def file_option(parser: argparse.ArgumentParser, name: str, help: str, dest: str | None = None) -> None:
    """Add an option with a file."""
    parser.add_argument(name, type=file_path, dest=dest, metavar="FILE", help=help)


def add_commands(command: Command) -> None:
    """Add the commands and their options."""
    bench = command(
        "bench", run_bench, "measure frame time, compile time and memory on this machine", "bench --filter verlet"
    )
    which = bench.add_mutually_exclusive_group()
    which.add_argument("--filter", choices=SOLVER_NAMES, metavar="SOLVER", help=ONE_SOLVER)
    which.add_argument("--features", action="store_true", help="measure what each feature of the curtain costs instead")
    which.add_argument("--goals", action="store_true", help="measure commands, and errors on fine sheets, instead")
    which.add_argument("--gpu", action="store_true", help="measure a GPU against the CPU instead, in five minutes")
    text = f"with --gpu: {any_of(runtime.ARCHS[1:])} (default: gpu)"
    bench.add_argument("--arch", choices=runtime.ARCHS[1:], metavar="NAME", help=text)
    bench.add_argument("--error", action="store_true", help="measure error and frame time of each setting instead")
    bench.add_argument(
        "--scene", action="append", default=[], metavar="SCENE", help="with --error: a scene to measure on; repeatable"
    )
    file_option(bench, "--markdown", "with --scene: write the tables as Markdown")
    bench.add_argument("--plot", type=file_path, metavar="DIR", help="with --error: write a plot for each grid")
    bench.add_argument("--all", action="store_true", help="measure all cases, in half an hour")
    bench.add_argument("--frames", type=count, default=120, metavar="N", help="frames to time in each measurement")
    file_option(bench, "--csv", "write the measurements as CSV")
    file_option(bench, "--json", "write measurements and machine as JSON")
    bench.add_argument("--force", action="store_true", help="replace output files that exist")

    validate = command(
        "validate", run_validate, "compare every solver with known solutions", "validate --filter A2 --solver explicit"
    )
    validate.add_argument("--filter", metavar="REF", help="only references that begin with REF, such as A2.1, A2 or B")
    validate.add_argument("--solver", choices=SOLVER_NAMES, metavar="NAME", help=ONE_SOLVER)
    file_option(validate, "--from", "measure nothing; report the results that --json wrote", dest="read")
    file_option(validate, "--json", "write results, bounds and sources as JSON")
    file_option(validate, "--markdown", "write the report as Markdown")
    validate.add_argument(
        "--update", action="store_true", help="with --json: replace only what was measured, and keep the other results"
    )
    validate.add_argument("--force", action="store_true", help="replace output files that exist")

    stress = command("stress", run_stress, "run 40 cases that break cloth", "stress --filter yank --solver lines")
    stress.add_argument("--filter", metavar="CASE", help="run only this case, a number or name")
    stress.add_argument("--variant", metavar="NAME", help="with --filter: run only this variant")
    stress.add_argument(
        "--solver", choices=SETTINGS, metavar="NAME", help=f"run only this solver or setting: {any_of(SETTINGS)}"
    )
    stress.add_argument("--tear", type=strain, metavar="STRAIN", help="let sheets tear at this strain")
    how_many = stress.add_mutually_exclusive_group()
    how_many.add_argument("--runs", type=count, default=10, metavar="N", help="runs of each variant, from other starts")
    how_many.add_argument("--quick", action="store_const", dest="runs", const=1, help="run each variant once: --runs 1")
    how_many.add_argument("--seed", type=seed, metavar="N", help="with --variant and --solver: run this start only")
    stress.add_argument("--soak", action="store_true", help="with --filter 32: run a million frames")
    file_option(stress, "--json", "write all results as JSON, after each variant")
    stress.add_argument("--resume", action="store_true", help="with --json: continue from the results in FILE")
    stress.add_argument(
        "--recheck",
        action="store_true",
        help="with --resume: keep results of an earlier version whose last run, repeated here, ends in the same bits",
    )
    stress.add_argument(
        "--explain", action="store_true", help="with --json: then find causes of failures by experiments"
    )
    file_option(stress, "--from", "run nothing; report the results that --json wrote", dest="source")
    file_option(stress, "--markdown", "write the report as Markdown")
    stress.add_argument(
        "--image-dir", type=file_path, default=Path("out/stress"), metavar="DIR", help="images of failed frames"
    )
    stress.add_argument(
        "--force", action="store_true", help="replace output files that exist; drop results of removed cases"
    )

    ablation = command("ablate", run_ablate, "measure what each feature of a scene costs and changes", "ablate curtain")
    ablation.add_argument("scenes", nargs="+", metavar="SCENE", help="shipped scenes or TOML files")
    ablation.add_argument("--frames", type=count, default=120, metavar="N", help="compare at most N frames")
    file_option(ablation, "--json", "write all results as JSON")
    file_option(ablation, "--markdown", "write the tables as Markdown")
    ablation.add_argument("--force", action="store_true", help="replace output files that exist")


# -- bench -------------------------------------------------------------------------------------------------------------


def run_bench(args: argparse.Namespace) -> int:
    """Run `bench`, or the measurement that its options select."""
    from ..system.console import check_output_file, steps_progress, write_csv
    from .bench import bench_report as report
    from .bench import cases as c
    from .bench import subprocess_runner

    for path in filter(None, (args.csv, args.json, args.markdown)):
        check_output_file(path, force=args.force)
    if args.markdown and not args.scene:
        raise UsageError("--markdown needs --scene: it writes the errors on scenes")
    if args.arch and not args.gpu:
        raise UsageError("--arch needs --gpu: the other measurements are of the CPU")
    if args.error:
        return run_scene_errors(args) if args.scene else run_error_sweep(args)
    if args.goals or args.gpu:
        return run_goals(args) if args.goals else run_gpu(args)
    if args.plot or args.scene:
        raise UsageError("--plot and --scene need --error")
    chosen = c.all_cases() if args.all else [] if args.features else c.default_cases()
    cases = c.filter_cases(chosen, args.filter)
    features = c.feature_cases() if args.features or (args.all and not args.filter) else []
    with (
        steps_progress(subprocess_runner.steps(cases, features)) as on_step,
        subprocess_runner.bench(args.frames, on_step) as bench,
    ):
        rows, stage_rows = bench.measure(cases, features)
    report.print_report(rows, stage_rows, bench.floor.missing)
    if args.csv:
        write_csv(args.csv, rows, report.Row)
    if args.json:
        report.write_json(args.json, rows, stage_rows, bench.floor.missing)
    return 1 if report.failures(rows, stage_rows) else 0


def run_goals(args: argparse.Namespace) -> int:
    """Run `bench --goals`."""
    from ..system.console import steps_progress
    from .bench import pinned_sheet, subprocess_runner

    if args.all or args.plot or args.scene or args.csv:
        raise UsageError("--goals cannot be combined with --all, --plot, --scene or --csv; use --json")
    with steps_progress(subprocess_runner.MEASURED + len(pinned_sheet.CASES)) as on_step:
        commands = []
        for command in subprocess_runner.measure():
            on_step(command.what)
            commands.append(command)
        runtime.start("cpu")
        sheets = []
        for case in pinned_sheet.CASES:
            on_step(case.name)
            sheets.append(pinned_sheet.measure(case))
    pinned_sheet.print_report(commands, sheets)
    if args.json:
        pinned_sheet.write_json(args.json, commands, sheets)
    return 0


def run_gpu(args: argparse.Namespace) -> int:
    """Run `bench --gpu`."""
    if args.all or args.plot or args.scene or args.csv:
        raise UsageError("--gpu cannot be combined with --all, --plot, --scene or --csv; use --json")
    arch = runtime.available_arch(args.arch or "gpu")
    from .bench.gpu import measure_and_report

    measure_and_report(arch, args.json)
    return 0


def run_error_sweep(args: argparse.Namespace) -> int:
    """Run `bench --error` on the swinging curtain."""
    from ..system.console import steps_progress, write_csv
    from .bench import error_sweep

    if args.features or args.goals or args.gpu:
        raise UsageError("use only one of --error, --features, --goals and --gpu")
    if args.plot:
        error_sweep.load_pyplot()
    runtime.start("cpu")
    cells = error_sweep.ALL_GRIDS if args.all else error_sweep.GRIDS
    wanted = list(error_sweep.points([error_sweep.Curtain(n) for n in cells], args.filter))
    found = []
    with steps_progress(len(wanted)) as on_step:
        for curtain, solver, substeps, iterations in wanted:
            on_step(f"{solver} {substeps}×{iterations}, {curtain.cells} cells")
            found.append(error_sweep.measure(curtain, solver, substeps, iterations))
    found = error_sweep.without_duplicates(found)
    error_sweep.print_report(found)
    if args.csv:
        write_csv(args.csv, found, error_sweep.Point)
    if args.json:
        error_sweep.write_json(args.json, found)
    if args.plot:
        print(f"{len(error_sweep.plot(args.plot, found))} plots in {args.plot}")
    return 0


def run_scene_errors(args: argparse.Namespace) -> int:
    """Run `bench --error` on scenes."""
    from ..geometry.scene_loader import load_scene

    scenes = [load_scene(name) for name in args.scene]
    from ..system.console import steps_progress, write_csv
    from .bench import scene_error

    if args.features or args.goals or args.gpu or args.filter or args.all or args.plot:
        raise UsageError(
            "--scene can be combined with --csv, --json and --markdown, not with --features, --filter, --all, --plot,"
            " --goals or --gpu"
        )
    runtime.start("cpu")
    found = []
    with steps_progress(sum(len(scene_error.settings(scene)) + 1 for scene in scenes)) as on_step:
        for scene in scenes:
            for step in scene_error.errors(scene):
                if isinstance(step, str):
                    on_step(step)
                else:
                    found.append(step)
    scene_error.print_report(found)
    if args.csv:
        write_csv(args.csv, [point for errors in found for point in errors.points], scene_error.ScenePoint)
    if args.json:
        scene_error.write_json(args.json, found)
    if args.markdown:
        scene_error.write_markdown(args.markdown, found)
    return 0


# -- validate ----------------------------------------------------------------------------------------------------------


def run_validate(args: argparse.Namespace) -> int:
    """Run `validate`. The exit code is 1 if a result falls short and theory does not explain by how much."""
    from ..system.console import check_output_file, page_files, steps_progress
    from .validate import validation_report as report
    from .validate.references import measure_all, select_pairs

    if args.update and (not args.json or args.read):
        raise UsageError("--update needs --json with earlier results, and does not go with --from")
    earlier = report.read_json(args.json) if args.update else None
    for path in filter(None, (args.json if earlier is None else None, *page_files(args.markdown))):
        check_output_file(path, force=args.force)
    if args.read:
        if args.filter or args.solver:
            raise UsageError("--from reads earlier results: it cannot be combined with --filter or --solver")
        run = report.read_json(args.read)
    else:
        pairs = select_pairs(args.filter, args.solver)
        with steps_progress(len(pairs)) as on_step:
            run = report.this_machine(lambda: measure_all(pairs, on_step))
    report.print_report(run)
    if earlier is not None:
        everything = [(one.number, solver) for one, solver in select_pairs(None, None)]
        run = report.updated(earlier, run, everything)
    if args.json:
        report.write_json(args.json, run)
    if args.markdown:
        report.write_pages(args.markdown, run)
    return 1 if any(result.row.unexplained for result in run.results) else 0


# -- stress ------------------------------------------------------------------------------------------------------------


def run_stress(args: argparse.Namespace) -> int:
    """Run `stress`. The exit code is 1 if a failure has no known cause."""
    from ..system.console import check_output_file, page_files
    from .stress import store
    from .stress import stress_report as report

    for path in page_files(args.markdown):
        check_output_file(path, force=args.force)
    if args.tear is not None and args.markdown:
        raise UsageError("--markdown cannot be combined with --tear: it writes the report of sheets that do not tear")
    if args.source:
        which = ("filter", "variant", "solver", "tear", "seed", "soak", "json", "resume", "recheck", "explain")
        # 0 equals False, but is a seed
        if given := [f"--{name}" for name in which if not any(getattr(args, name) is one for one in (None, False))]:
            raise UsageError(f"--from runs nothing, and reports all results: leave out {', '.join(given)}")
        stored = store.load(args.source)
        results = stored.ordered()
    else:
        stored, results = run_units(args)
    report.print_report(stored, results)
    if args.markdown:
        report.write_pages(args.markdown, stored)
    return 1 if stored.unexplained(results) else 0


def run_units(args: argparse.Namespace) -> tuple[Store, list[Result]]:
    """Run the requested units that are not stored yet. Return the store, and the results of all requested units."""
    from ..system.console import check_output_file, steps_progress
    from .stress import runner, store
    from .stress.runner import select_units
    from .stress.setup import ROBUST_SLACK
    from .stress.unit import ALIVE

    for flag, other in (("resume", "json"), ("explain", "json"), ("recheck", "resume")):
        if getattr(args, flag) and not getattr(args, other):
            raise UsageError(f"--{flag} needs --{other}")
    if args.json and not (args.resume and args.json.is_file()):
        check_output_file(args.json, force=args.force)
    if args.image_dir.exists() and not args.image_dir.is_dir():
        raise OutputConflict(f"{args.image_dir} is a file, not a folder")
    units = select_units(args.filter, args.variant, args.solver, long=args.soak, tear=args.tear)
    if args.seed is not None and (len(units) != 1 or args.json):
        raise UsageError("--seed repeats one run: it needs --filter, --variant and --solver, and does not allow --json")
    planned = units if args.soak or args.tear is not None else select_units()
    stored = store.Store.new(args.json, planned)
    if args.resume and args.json.is_file():
        stored = stored.continued(store.load(args.json), drop=args.force and planned is not units)
    if args.recheck:
        runner.recheck(stored, units)
    needed = units if args.solver else [unit for unit in units if stored.is_needed(unit.key)]
    remaining = stored.left(needed, args.runs)
    earlier = dict(stored.results)
    seconds = {key: result.seconds for key, result in earlier.items()}
    if measured := [seconds[unit.key] for unit in remaining if unit.key in seconds]:
        hours = sum(measured) / len(measured) * len(remaining) / min(runner.CORES, len(remaining)) / 3600
        print(f"{len(remaining)} of {len(needed)} variants to run: about {hours:.1f} hours", flush=True)

    def starts(unit: Unit) -> list[tuple[int, int]]:
        return [(0, args.seed)] if args.seed is not None else unit.starts(args.runs)

    with steps_progress(len(remaining)) as on_step:

        def on_result(result: Result) -> None:
            stored.add(result)
            on_step(f"{result.case} {result.name}, {result.variant}, {result.setting}: {result.state}")

        # The others decide which units of `robust-slack` are needed.
        slack = [unit for unit in remaining if unit.setting.name == ROBUST_SLACK.name]
        for part in ([unit for unit in remaining if unit not in slack], slack):
            if now := [unit for unit in part if args.solver or stored.is_needed(unit.key)]:
                runner.run_all(runner.dearest_first(now, seconds), starts, args.image_dir, on_result)
    for result in stored.of(unit for unit in remaining if unit.key in earlier):
        if earlier[result.key].state == ALIVE != result.state:
            print(f"{result.case} {result.name}, {result.variant}, {result.setting}: alive before, now {result.state}")
    if not args.solver:
        stored.drop_unneeded()
    if args.explain:
        runner.explain(stored, units)
    return stored, stored.of(units)


# -- ablate ------------------------------------------------------------------------------------------------------------


def run_ablate(args: argparse.Namespace) -> int:
    """Run `ablate`."""
    from ..geometry.scene_loader import load_scene

    scenes = [load_scene(name) for name in args.scenes]
    from ..system.console import check_output_file, steps_progress
    from . import ablation

    for path in filter(None, (args.json, args.markdown)):
        check_output_file(path, force=args.force)
    runtime.start("cpu")
    found = []
    with steps_progress(len(scenes)) as on_step:
        for scene in scenes:
            on_step(scene.name)
            found.append(ablation.ablate(scene, args.frames))
    ablation.print_tables(found)
    run = ablation.this_machine(found)
    if args.json:
        ablation.write_json(args.json, run)
    if args.markdown:
        ablation.write_markdown(args.markdown, run)
    return 0
