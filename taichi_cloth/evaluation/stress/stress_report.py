"""Reports of stress results: tables in the terminal, and two pages of the documentation."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ...scene.schema import FRAME_SECONDS
from ...system.console import count_noun, markdown_table, new_file, page_files, print_table
from .case_catalog import CASES
from .causes import EXPERIMENT_SECONDS, FINER
from .extremes import HANGING_FRAMES, LONG_HANGING, LONG_SWINGING
from .layered_cloth import LOOK_EVERY
from .loads import LANDING_SECONDS
from .setup import CELLS, ROBUST, ROBUST_SLACK, SIDE, THICKNESS, THIN
from .store import Store
from .trial import REST_SPEED, REST_STRAIN, SLOW_MS, TIMED_EVERY, TIMED_WINDOW, Measurement
from .unit import ALIVE, FAILED, SLOW, Key, Result

NOT_RUN = "not run"
UNEXPLAINED = "unexplained"  # by all experiments
NOT_EXAMINED = "not examined"  # some experiments have not run, and none found a cause
HEADINGS = (
    "case", "variant", "setting", "state", "starts", "energy", "strain", "at rest", "speed", "depth", "frames", "ms",
    "other",
)  # fmt: skip
LEGEND = (
    "Worst values of all starts that ran; starts after the first failure of a variant are skipped. Energy: excess\n"
    "over that at the start and the work done since, relative to the available energy · strain of structural springs,\n"
    "as a fraction, and at rest with its bound · speed [m/s] · depth of the deepest free particle in a collider [mm]\n"
    "· ms: median of a frame · other: values that the case records, with bounds, and notes"
)
LEGEND_OF_REPEATED = " · 1 again: a later version repeated the last start only"


@dataclass(frozen=True)
class Cell:
    """The results of one case with one setting."""

    planned: int  # number of variants
    results: list[Result]

    @property
    def state(self) -> str:
        """Return the state of the case: failed if one variant failed, else not run if one is missing.

        Otherwise it is too slow if one variant is, else alive.
        """
        states = {result.state for result in self.results}
        if FAILED in states:
            return FAILED
        return NOT_RUN if len(self.results) < self.planned else SLOW if SLOW in states else ALIVE

    def shown(self) -> str:
        """Return the number of variants alive and of all variants, with the state of the case if it is not alive."""
        share = f"{sum(result.state == ALIVE for result in self.results)}/{self.planned}"
        state = self.state
        return share if state == ALIVE else f"**{share}**" if state == FAILED else f"{share} {state}"


Cells = dict[tuple[int, str], Cell]  # by case number and setting


def cells_of(store: Store, keys: Sequence[Key] | None = None) -> Cells:
    """Return the cells of all planned units, or of the units `keys`."""
    found: Cells = {}
    for case, variant, setting in store.planned if keys is None else keys:
        cell = found.setdefault((case, setting), Cell(0, []))
        result = store.results.get((case, variant, setting))
        found[case, setting] = Cell(cell.planned + 1, cell.results + ([result] if result else []))
    return found


def settings_of(cells: Cells) -> list[str]:
    """Return the names of the settings, in order."""
    return list(dict.fromkeys(setting for _, setting in cells))


def counts(cells: Cells) -> dict[str, dict[str, int]]:
    """Return the number of cases in each state, by setting."""
    found: dict[str, dict[str, int]] = {}
    for (_, setting), cell in cells.items():
        by_state = found.setdefault(setting, dict.fromkeys((ALIVE, FAILED, SLOW, NOT_RUN), 0))
        by_state[cell.state] += 1
    return found


def alive_with_any(cells: Cells, settings: Sequence[str]) -> int:
    """Return the number of cases that are alive with at least one of these settings."""
    return len({case for (case, setting), cell in cells.items() if setting in settings and cell.state == ALIVE})


def count_line(cells: Cells) -> str:
    """Return the numbers of `counts` as one line."""
    return " · ".join(
        f"{setting} " + ", ".join(f"{number} {state}" for state, number in found.items() if number or state != NOT_RUN)
        for setting, found in counts(cells).items()
    )


def with_bound(figure: Measurement) -> str:
    return f"{figure.value:.2g}" if figure.bound is None else f"{figure.value:.4g} (≤ {figure.bound:.4g})"


def besides(result: Result) -> str:
    """Return the values that the case recorded, with their bounds, and its notes. Strain at rest has a column."""
    own = [f"{one.what} {with_bound(one)}" for one in result.figures if one.what not in (REST_STRAIN, REST_SPEED)]
    return "; ".join(own + result.notes)


def row(result: Result) -> tuple[str, ...]:
    """Return one row of the table, with the columns of `HEADINGS`."""
    return (
        f"{result.case} {result.name}",
        result.variant,
        result.setting,
        result.state,
        f"{result.ran} of {result.starts}" + (", 1 again" if result.repeated else ""),
        f"{result.energy:+.1%}" if abs(result.energy) < 100 else f"{result.energy:+.0e}",
        f"{result.strain:.3g}",
        " ".join(with_bound(figure) for figure in result.figures if figure.what == REST_STRAIN),
        f"{result.speed:.3g}",
        f"{1e3 * result.penetration:.2g}",
        str(result.frames),
        frame_time(result),
        besides(result),
    )


def frame_time(result: Result) -> str:
    """Return the time of a frame [ms] as text; `-` if no frame ran after the first, which compiles."""
    ms = result.ms if result.slow_ms is None else result.slow_ms
    return f"{ms:.2f}" if ms else "-"


def explanation(store: Store, result: Result) -> str:
    """Return the cause of a failure in words; otherwise whether all experiments looked for it."""
    cause = store.cause(result)
    return NOT_EXAMINED if cause is None or not cause.is_final else cause.shown or UNEXPLAINED


def failure_line(result: Result, reason: str, *, picture: bool = True) -> str:
    """Return one line: which start violated which bound, its seed, the cause, and the path of its image."""
    failure = result.failure
    assert failure is not None
    return (
        f"{result.case} {result.name}, {result.variant}, fails with {result.setting}: {failure.what}"
        f" {failure.value:.4g}, bound {failure.bound:.4g}, in frame {failure.frame} of start {failure.start}"
        f" (seed {failure.seed}); {reason}" + (f"; {result.picture}" if result.picture and picture else "")
    )


def slow_line(result: Result) -> str:
    """Return one line for a variant that is too slow."""
    variant = f"{result.case} {result.name}, {result.variant}"
    return f"{variant}, is too slow with {result.setting}: {result.slow_ms:.0f} ms per frame"


def print_report(store: Store, results: Sequence[Result]) -> None:
    """Print the table of these results, their failures, and the counts."""
    notes = [
        LEGEND + LEGEND_OF_REPEATED * any(result.repeated for result in results),
        *(failure_line(r, explanation(store, r)) for r in results if r.failure),
        *(slow_line(r) for r in results if r.state == SLOW),
    ]
    failed = [result for result in results if result.state == FAILED]
    number = Counter(explanation(store, result) for result in failed)
    parts = ", ".join(f"{number[kind]} {kind}" for kind in (UNEXPLAINED, NOT_EXAMINED))
    notes += [f"of {count_noun(len(failed), 'failure')}, {parts}"]
    if number[NOT_EXAMINED]:
        notes.append("--json FILE --explain looks for causes of failures")
    notes += [store.machine, count_line(cells_of(store, [result.key for result in results]))]
    print_table(HEADINGS, map(row, results), slice(4, -1), notes)


def origin_lines(store: Store) -> list[str]:
    """Return lines that say how many units ran, when, for how long, on which machines, and with which version."""
    results = store.ordered()
    missing = len(store.planned) - len(results)
    combinations = f"{len(store.planned)} combinations of variant and setting"
    lines = [f"{missing} of {combinations} were not run."] if missing else []
    if store.older:
        lines.append(
            f"{store.older} of {len(results)} results are of earlier versions of the program or of its rules, and the"
            " present one has not confirmed them."
        )
    if repeated := sum(bool(result.repeated) for result in results):
        lines.append(
            f"{repeated} results were confirmed once by a later version than the one that produced them: it repeated"
            " the last start of each bit by bit."
        )
    if fewest := {result.starts for result in results}:
        starts = f"{min(fewest)} to {max(fewest)}" if len(fewest) > 1 else f"{min(fewest)}"
        days = sorted({result.date[:10] for result in results})
        when = " to ".join(dict.fromkeys((days[0], days[-1])))
        hours = sum(result.seconds for result in results) / 3600
        on_two = "" if missing else f", {hours / 2:.1f} hours on two cores (goal: {GOAL_HOURS:g})"
        lines.append(f"{starts} starts per variant; run {when}; {hours:.1f} hours of CPU time{on_two}.")
        if store.repeat_seconds and not missing:
            present = store.present_seconds() / 7200
            lines.append(f"At the speed of the starts that confirmed results: {present:.1f} hours on two cores.")
    if timed := [cause.seconds for cause in store.causes.values() if cause.seconds]:
        took = f"{sum(timed) / 3600:.1f} more hours; the others were not timed"
        lines.append(f"Looking for the causes of {count_noun(len(timed), 'failure')} took {took}.")
    lines += [f"Run on {name}." for name in dict.fromkeys(result.machine for result in results if result.machine)]
    return lines


GOAL_HOURS = 4.0  # of a whole run on two cores
USUAL_SECONDS = 10.0  # that a case must run at least
FOR_HARD_SCENES = (ROBUST.name, ROBUST_SLACK.name)


def write_pages(path: Path, store: Store) -> None:
    """Write the summary to `path` and the table of variants next to it, from stored results alone. Raises OSError."""
    path, rows = page_files(path)
    for target, lines in ((path, main_page(store, rows.name)), (rows, rows_page(store, path.name))):
        with new_file(target) as file:
            file.write("\n".join([*lines, ""]).encode())


def main_page(store: Store, rows: str) -> list[str]:
    """Return the lines of the summary page. `rows` is the file name of the other page."""
    cells = cells_of(store)
    cases = len({case for case, _ in cells})
    lines = ["# Stability", "", *summary(store, cells), ""]
    if any(setting == ROBUST_SLACK.name for _, setting in cells):
        either = alive_with_any(cells, FOR_HARD_SCENES)
        other = either - alive_with_any(cells, [ROBUST.name])
        lines += [
            f"With `{ROBUST.name}` or `{ROBUST_SLACK.name}`: {either} of {cases} cases alive, {other} of them only with"
            f" the other material of `{ROBUST_SLACK.name}`.",
            "",
        ]
    lines += [part for line in origin_lines(store) for part in (line, "")]
    lines += PAGE.format(
        robust=robust_words(), cells=CELLS, compression=ROBUST_SLACK.compression, damping=ROBUST_SLACK.solver.damping,
        cases=cases, rows=rows, slow=SLOW_MS, every=TIMED_EVERY, window=TIMED_WINDOW, finer=FINER,
        experiment=EXPERIMENT_SECONDS, thickness=THICKNESS, look_every=LOOK_EVERY, thin=100 * THIN,
        distance=100 * THICKNESS * SIDE / CELLS, landing=LANDING_SECONDS, shorter=shorter_runs(store),
        hanging=HANGING_FRAMES, long_hanging=LONG_HANGING, long_swinging=LONG_SWINGING,
    ).splitlines()  # fmt: skip
    lines += ["", "## Variants alive", "", *markdown_table(matrix(store, cells)), ""]
    lines += [f"## Failures of `{ROBUST.name}`, and causes", ""]
    found = [result for result in store.ordered() if result.setting == ROBUST.name]
    failures = [
        f"- {failure_line(result, explanation(store, result), picture=False)}" for result in found if result.failure
    ]
    failures += [f"- {slow_line(result)}" for result in found if result.state == SLOW]
    return [*lines, *(failures or ["None."])]


def shorter_runs(store: Store) -> str:
    """Return the cases with variants that were alive after less than `USUAL_SECONDS`, each with its shortest time."""
    shortest: dict[int, float] = {}
    for result in store.ordered():
        seconds = result.frames * FRAME_SECONDS
        if result.state == ALIVE and 0 < seconds < USUAL_SECONDS:
            shortest[result.case] = min(seconds, shortest.get(result.case, seconds))
    return ", ".join(f"case {case} ({shortest[case]:.2g} s)" for case in sorted(shortest)) or "none"


def summary(store: Store, cells: Cells) -> list[str]:
    """Return a table with one row per setting, those for hard scenes first."""
    found = counts(cells)
    states = [ALIVE, FAILED, SLOW]
    states += [NOT_RUN] if any(number[NOT_RUN] for number in found.values()) else []
    number = Counter((one.setting, explanation(store, one)) for one in store.ordered() if one.failure)
    lines = [["setting", "cases", *states, f"failed variants {UNEXPLAINED}", f"failed variants {NOT_EXAMINED}"]]
    for setting in sorted(found, key=lambda name: name not in FOR_HARD_SCENES):
        numbers = [found[setting][state] for state in states]
        numbers += [number[setting, why] for why in (UNEXPLAINED, NOT_EXAMINED)]
        lines.append([f"`{setting}`", *map(str, [sum(found[setting].values()), *numbers])])
    return markdown_table(lines)


def matrix(store: Store, cells: Cells) -> list[list[str]]:
    """Return a table with one row per case: the number of variants alive with each setting, in bold if one failed."""
    settings = settings_of(cells)
    labels = {case.number: (f"{case.number} {case.name}", case.parameters) for case in CASES}  # also of cases not run
    labels |= {result.case: (f"{result.case} {result.name}", result.parameters) for result in store.ordered()}
    lines = [["case", "what", *settings]]
    for case in dict.fromkeys(number for number, _ in cells):
        shown = (cells[case, one].shown() if (case, one) in cells else "" for one in settings)
        lines.append([*labels.get(case, (str(case), "")), *shown])
    return lines


def rows_page(store: Store, main: str) -> list[str]:
    """Return the lines of the second page: every variant that ran, and every failure with its seed."""
    results = store.ordered()
    lines = [
        "# Stability: every variant",
        "",
        f"The results behind [{main}]({main}).",
        "",
        LEGEND.replace("\n", " ") + LEGEND_OF_REPEATED,
        "",
    ]
    lines += markdown_table([HEADINGS, *(row(result) for result in results)])
    failures = [f"- {failure_line(r, explanation(store, r), picture=False)}" for r in results if r.failure]
    notes = dict.fromkeys(f"- {r.case} {r.name}: {r.about}." for r in results if r.about)
    lines += ["", "## Failures", "", *(failures or ["None."])]
    return [*lines, "", "## Differences from the specification", "", *notes]


def robust_words() -> str:
    """Return the setting `robust` in the keys of a scene file."""
    solver = ROBUST.solver
    words = [f'`[solver] name = "{solver.name}"`, `substeps = {solver.substeps}`, `iterations = {solver.iterations}`']
    words += ["`continuous = true` in every collider"]
    words += ["`untangle = true` and `static_friction = true` if the scene has `[self_collision]`"]
    words += [f"and `[strain_limit] iterations = {ROBUST.strain_limit_iterations}` if the scene has a strain limit"]
    return ", ".join(words)


PAGE = """\
`make stress` runs {cases} cases that break cloth, each in several variants, and each variant from ten random starts:
with every solver at its defaults ([some are unfinished](limits.md)), and with two settings for hard scenes:

- `robust` is the scene's own cloth with {robust}.
- `robust-slack` is the same with another material: its springs do not resist compression
  (`[fabric] compression = {compression:g}`), and damping between 0 and {damping:g}/s is raised to {damping:g}/s.
  Only the cases that `robust` does not survive are run with it.

Each start has a random seed, which disturbs positions or velocities slightly. A variant fails if one of its starts
fails, and a case fails if one of its variants fails. `taichi-cloth stress --filter yank --variant "10 m" --solver xpbd`
runs one variant, and `--seed N` repeats one start: the report prints the seed of the one that failed. [{rows}]({rows})
lists every variant and every failure.

Unless a case says otherwise, the sheet is 1 m by 1 m with 0.2 kg/m² and {cells} × {cells} cells, for every setting. Its
springs have 1000 N/m along rows, columns and diagonals, its bending stiffness is 1.57e-5 N·m and its damping 2/s. It
hangs from two corners or from its top edge.

**Alive** means that after every frame

- all positions and velocities are finite,
- every pin is exactly where it was put,
- no particle is farther than two sides of the sheet from everything that holds, carries or throws it, plus an
  allowance where a case stretches, blows or throws cloth (`far` in `evaluation/stress/`, in meters),
- the energy is at most that at the start, plus the work done since, plus 1 % of both and of the sheet's weight times
  two of its sides: a solver of first order makes such errors in a fall, and a sheet that starts at rest has no energy.
  The work of hands, wind, attachments and moving bodies within a frame counts with an upper bound.

In addition, the cloth must come to rest within 5 s after the last disturbance, or after its start if there is none.
Cloth that falls (cases 33, 34 and 37) has {landing:g} s to land before. In the last quarter of a second, and from then
to the end of the case, no structural spring may exceed the static strain plus 1 %, and no particle 0.1 m/s. Diagonals
and shortened springs are not judged: cloth that shears or folds finer than a cell changes them without strain.
The static strain is that of the same cloth in float64 with the constants of its fabric; a solver's artificial stretch
is not part of it. It is 0 for cloth without pins that falls or lies on planes, and for the two sheets on the table of
case 39. For cloth without pins that lies on something else, where parts of it hang down, it is that of the cloth hung
from two corners, a bound that we chose. Additional bounds of a case, and what it judges differently, are in its row.
Cases 19 and 20 have no gravity. Sheets that swing or fall without damping (cases 32, 33 and 37) get damping before they
must come to rest. Some cases take the static strain of other cloth. For layers (cases 15 and 16) it is that of a single
one, hung from two corners. A mesh with slivers (case 24) is judged by that of the same mesh without them, and flat
cells by that of a square sheet.

A solver may refuse the cloth of case 24: because of its defect, because of the substeps it would need, or because the
solver needs a grid. This counts as alive, and the row has the message.

Sheets that collide with themselves keep a distance of {thickness:g} cells (with 33×33 particles {distance:.1f} cm) in
cases 14 and 15, and of {thin:g} cm in cases 16 and 39. Intersections of case 14 and gaps of case 15 are looked for
every {look_every} frames, intersections of cases 14 to 16 at the end, and the gap of case 16 once, after 5 s. A gap is
the distance between adjacent layers: of particles from triangles, and of edges from edges.

A case runs for ten seconds or longer. Variants that ran to their end in less time: {shorter}. Case 32 runs
{hanging:,} frames; with `--soak` it runs {long_hanging:,} frames at rest and {long_swinging:,} in motion. Case 28
judges chatter, a velocity that changes its sign from frame to frame. While the wind blows, slower motion passes; in the
second after the sheet has come to rest, all motion counts. The friction of case 39 is a mean over 0.1 s.

**Energy** is the sum of kinetic, gravitational, spring and bending energy, with the constants k of the fabric. For
implicit solvers, whose springs act softer the longer the substep h is, it is computed with k/(1 + c·k·h²·Σw). Here c
belongs to the slowest motion of the sheet, and Σw is the sum of the inverse masses at the ends of a spring. The same
sum is used for the work and for the bound. Twice the sum of k times the squared rounding of a position is allowed too.
Work done between two frames is known exactly. Within a frame, growth of the energy counts as work up to a bound on the
work of grabs, wind, moving colliders, and colliders that push particles out because they appeared around them
(formulas: `taichi_cloth/evaluation/stress/invariants.py`). The bound for colliders is loose: it assumes that they hit
every particle within reach in every frame.

**Too slow** means more than {slow:.0f} ms per frame (30 frames per second) unless the row says otherwise. The time is
the median of the last {window} frames of a scene after compilation, checked after 5 frames and then every {every}. All
cores run units at once; one that is too slow runs again alone, and only that run counts. Frames that are judged substep
by substep are not timed. A variant that is too slow counts neither as alive nor as failed; what it would have violated
later is not known. With 33×33 particles no variant of cases 15, 16 and 39 ran for a second. Cases 15 and 39 also have
smaller sheets, which cost less. So has case 16, whose specification bounds only the time: none is fast enough for them.

**Causes** are looked for by experiments on the start that failed, with `--explain`. Three continue from the state in
which it failed: Newton's method in float64, five more seconds of the same run, and steps in float64. One takes such
steps from the last disturbance. The others repeat this start and two more, or nine if the first start survived, with
one change: {finer} times the iterations, {finer} times the substeps, or both, or, where particles went through a
collider or energy appeared, continuous collision detection. The first experiment that succeeds gives the cause. One
whose frames take more than {experiment:g} s for one start, or will by the time of the failure, is stopped and has none.
A failure is unexplained if all experiments ran and none found a cause, and not examined if some have not run. One that
later violates another bound, or the same bound by more, counts as not examined.

`taichi-cloth stress --tear 0.5` runs the cases with cloth that tears at that strain. It has no bending stiffness, which
does not support tearing, and omits `lines`, which needs complete grid rows. The criteria are the same, but torn cloth
need not be at rest at the end, because pieces fall. The rows report the share of torn springs."""
