"""What came out as a table, as JSON and as Markdown."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from ..bench.report import machine, markdown_table, print_table
from ..files import whole_file
from .running import Outcome, Result, by_setting
from .setting import CELLS, ROBUST, SETTINGS

HEADINGS = ("case", "solver", "alive", "energy", "strain", "speed", "in body", "frames", "ms", "besides")
LEGEND = (
    "Worst of all starts. Energy: above all that was given, of it · strain of a thread · speed [m/s] · in body: depth\n"
    "of the deepest free particle [mm] · besides: what the case asks for, and its bound"
)


def figures(outcomes: Sequence[Outcome]) -> str:
    """The worst of each number that a case tells."""
    worst: dict[str, tuple[float, float]] = {}
    for outcome in outcomes:
        for figure in outcome.figures:
            if figure.what not in worst or figure.value > worst[figure.what][0]:
                worst[figure.what] = figure.value, figure.bound
    return "; ".join(
        f"{what} {value:.2g}" + (f" (≤ {bound:.2g})" if bound < float("inf") else "")
        for what, (value, bound) in worst.items()
    )


def cells(result: Result) -> tuple[str, ...]:
    """A row of the table."""
    some = result.outcomes
    frames = max(outcome.frames for outcome in some)
    least = min((outcome.frames for outcome in some if outcome.cut), default=0)
    total = sum(outcome.frames for outcome in some)
    energy = max(outcome.energy for outcome in some)
    return (
        result.name,
        result.setting,
        f"{len(some) - len(result.failed)}/{len(some)}",
        f"{energy:+.1%}" if abs(energy) < 100 else f"{energy:+.0e}",
        f"{max(outcome.strain for outcome in some):.2g}",
        f"{max(outcome.speed for outcome in some):.3g}",
        f"{1e3 * max(outcome.penetration for outcome in some):.2g}",
        f"{least}+" if least else str(frames),
        f"{sum(outcome.ms * outcome.frames for outcome in some) / max(total, 1):.2f}",
        figures(some),
    )


def failures(results: Sequence[Result], *, pictures: bool = True) -> list[str]:
    """A line for each case and setting that fails: which starts, what broke first, why, and its picture."""
    lines = []
    for result in results:
        if result.failed:
            first = result.failed[0]
            assert first.failure is not None
            why = result.reason or "it should not"
            broke = f"{first.failure.what} {first.failure.value:.3g}, not {first.failure.bound:.3g}"
            who = ", ".join(str(outcome.start) for outcome in result.failed)
            lines.append(
                f"{result.name} fails with {result.setting} (starts {who}): {broke}"
                f" in frame {first.failure.frame} of start {first.start}; {why}"
                + (f"; {first.picture}" if first.picture and pictures else "")
            )
    return lines


def count(results: Sequence[Result]) -> str:
    """The last line: cases alive and failed, by setting."""
    return " · ".join(
        f"{setting} {sum(r.alive for r in some)} alive, {sum(not r.alive for r in some)} failed"
        for setting, some in by_setting(results)
    )


def matrix(results: Sequence[Result]) -> list[list[str]]:
    """A line for each case: starts alive with each setting, in bold where one is not."""
    settings = [setting for setting, _ in by_setting(results)]
    lines = [["case", "what", *settings]]
    for name in dict.fromkeys(result.name for result in results):
        some = {result.setting: result for result in results if result.name == name}
        line = [name, next(iter(some.values())).case.parameters]
        for setting in settings:
            share = cells(some[setting])[2] if setting in some else ""
            line.append(share if setting not in some or some[setting].alive else f"**{share}**")
        lines.append(line)
    return lines


def print_report(results: Sequence[Result]) -> None:
    notes = (LEGEND, *failures(results), " · ".join(machine().values()), count(results))
    print_table(HEADINGS, map(cells, results), slice(2, -1), notes)


def write_json(path: Path, results: Sequence[Result]) -> None:
    """All there is. Raises OSError."""
    rows = [
        {
            "case": result.case.number,
            "name": result.case.name,
            "setting": result.setting,
            "alive": result.alive,
            "reason": result.reason,
            "starts": [asdict(outcome) for outcome in result.outcomes],
        }
        for result in results
    ]
    with whole_file(path) as file:
        file.write(json.dumps({"machine": machine(), "results": rows}, indent=1, ensure_ascii=False).encode())


def robust_words() -> str:
    """The recommended setting, as a scene writes it."""
    solver = ROBUST.solver
    words = [f'`[solver] name = "{solver.name}"`, `substeps = {solver.substeps}`, `iterations = {solver.iterations}`']
    words += [f"`[fabric] compression = {ROBUST.compression:g}`"]
    words += [f"`damping = {solver.damping:g}` where a scene has less but some", "`swept = true` in every collider"]
    words += ["`untangle = true` and `stick = true` where a scene has `[self_collision]`"]
    words += [f"and `[limit] sweeps = {ROBUST.limit_sweeps}` where a scene has a limit"]
    return ", ".join(words)


def write_markdown(path: Path, results: Sequence[Result]) -> None:
    """The page about stability: what alive means, who is, and why some are not. Raises OSError."""
    small = " and ".join(f"{s.cells} with `{s.name}`" for s in SETTINGS.values() if s.cells < CELLS)
    starts = max(len(result.outcomes) for result in results)
    lines = [
        "# Stability: what survives, and what does not",
        "",
        count(results),
        "",
        " · ".join(machine().values()),
        "",
    ]
    lines += PAGE.format(robust=robust_words(), cells=CELLS, small=small, starts=starts).splitlines()
    lines += ["", "## Starts alive", "", *markdown_table(matrix(results))]
    lines += [
        "",
        "## What fails, and why",
        "",
        *(f"- {line}" for line in failures(results, pictures=False) or ["nothing"]),
    ]
    lines += ["", "## All rows", "", LEGEND.replace("\n", " "), ""]
    lines += markdown_table([HEADINGS, *(cells(result) for result in results)])
    with whole_file(path) as file:
        file.write("\n".join([*lines, ""]).encode())


PAGE = """\
`make stress` runs 40 cases that break cloth with every solver at its usual substeps and iterations, and with the
setting that is recommended for hard scenes, `robust`: {robust}.
{starts} starts each (the command makes ten unless it is told otherwise), no two alike; they take the
variants of a case in turn. `taichi-cloth stress --only yank --solver lines` runs one of them.

Unless a case says otherwise the sheet is 1 m by 1 m of 0.2 kg/m², {cells} × {cells} cells ({small}), 1000 N/m along
threads and diagonals, 1.57e-5 N·m of bending, damped at 2/s, hung by two corners or its top edge.

**Alive** means, after every frame: all places and velocities are finite; pins are where they were put, to the last
bit; no particle is farther than two sides from all that holds, carries or throws it; energy is no more than at the
start and than was given since, plus 1 % (`taichi_cloth/stress/watch.py` says what counts as given). And 5 seconds
after the last disturbance no thread is stretched by 1 % more than at rest, and nothing is faster than 0.1 m/s. The
extra bounds of a case are in its row. One start that fails is a failure.

`robust` lets threads go slack. A spring that resists being shortened has an energy with many valleys: a sheet that has
gone through itself comes to rest in one of them, folded and strained, and no method opens it. Real threads buckle
instead (Choi and Ko 2002). What only pulls has a convex energy, as weight and bending have: one valley, into which
damping leads from everywhere: five seconds after the flattened start (10) every particle is within 0.03 mm of where it
is on a sheet that was never disturbed. A tenth of the constant is already too much to push with: of nine starts of 7,
10 and 27 one is alive then.

Contact has valleys of its own: it holds on the wrong side what was squeezed through. So `robust` also lets go where the
cloth goes through itself (`untangle`). A sheet that is twisted (14) does: at twice its length its particles are farther
apart than it is thick, and whole turns slip through. What is through is out again at the end, and nothing crosses.

Friction that counts what slid in one substep alone holds nothing still. Contacts are put right by shares, so that what
carries a weight has to slide a little before it is held, in every substep anew, and a heap flows like honey: that of 16
at 5.5 mm/s, at 4.9 with ten times the damping and at 3.7 with three times the iterations. Where it flows over an edge
it slips by fits and starts. So `robust` counts what two particles slid since they met (`stick`): the same heap loses a
twelfth of the height in the same time, and the tower of 16 stands on its bar.

A run ends early where its frames take so many substeps that it would last for minutes (stiff springs with the
explicit methods): its frames are then marked with a plus. Colliders are swept in `robust` only. The cloth of 14
to 16 keeps off itself by its particles, at nine tenths of a cell; the layers of 15 and 16 are those of one strip.

`taichi-cloth stress --tear 0.5` runs the cases with sheets whose threads give way at that strain: without bending,
which cannot be cut, and without `lines`, whose rows must be whole. Alive is the same there, but that a sheet that has
torn need neither be still at the end nor near to its pins: pieces fall. Rows tell the share of springs torn."""
