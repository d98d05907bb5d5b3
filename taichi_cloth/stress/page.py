"""The pages about stability: what alive means, who is, and what fails; and a line for every variant."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ..bench.report import markdown_table
from ..files import whole_file
from .causes import EXPERIMENT_SECONDS, FINER
from .report import (
    HEADINGS,
    LEGEND,
    NOT_RUN,
    UNEXPLAINED,
    Cells,
    alive_with_any,
    cells_of,
    counts,
    failure_line,
    origin_lines,
    row,
    settings_of,
)
from .setting import CELLS, ROBUST, ROBUST_SLACK
from .store import Store
from .trial import SLOW_MS
from .unit import ALIVE, FAILED, SLOW, Result

ROWS = "_rows"  # at the end of the second page's name
RECOMMENDED = (ROBUST.name, ROBUST_SLACK.name)


def write_pages(path: Path, store: Store) -> None:
    """From stored results alone. Raises OSError."""
    rows = path.with_name(f"{path.stem}{ROWS}{path.suffix}")
    for target, lines in ((path, main_page(store, rows.name)), (rows, rows_page(store, path.name))):
        with whole_file(target) as file:
            file.write("\n".join([*lines, ""]).encode())


def main_page(store: Store, rows: str) -> list[str]:
    cells = cells_of(store)
    cases = len({case for case, _ in cells})
    lines = ["# Stability: what survives, and what does not", "", *summary(store, cells), ""]
    if any(setting == ROBUST_SLACK.name for _, setting in cells):
        either = alive_with_any(cells, RECOMMENDED)
        lines += [f"With `{ROBUST.name}` or `{ROBUST_SLACK.name}`: {either} of {cases} cases alive.", ""]
    lines += [line for told in origin_lines(store) for line in (told, "")]
    lines += PAGE.format(
        robust=robust_words(), cells=CELLS, compression=ROBUST_SLACK.compression, damping=ROBUST_SLACK.solver.damping,
        cases=cases, rows=rows, slow=SLOW_MS, finer=FINER, experiment=EXPERIMENT_SECONDS,
    ).splitlines()  # fmt: skip
    notes = dict.fromkeys(f"- {r.case} {r.name}: {r.about}." for r in store.ordered() if r.about)
    lines += ["", "## Variants alive", "", *markdown_table(matrix(store, cells)), "", "## What fails, and why", ""]
    failures = [line for key, cell in cells.items() for line in case_lines(store, key[1], cell.results)]
    return [*lines, *(failures or ["Nothing."]), "", "## Where a case differs from its list", "", *notes]


def summary(store: Store, cells: Cells) -> list[str]:
    """A line for each setting, the recommended ones first."""
    found = counts(cells)
    states = [ALIVE, FAILED, SLOW]
    states += [NOT_RUN] if any(one[NOT_RUN] for one in found.values()) else []
    open_ones = store.unexplained(store.ordered())
    lines = [["setting", "cases", *states, "failures unexplained"]]
    for setting in sorted(found, key=lambda name: name not in RECOMMENDED):
        mine = sum(result.setting == setting for result in open_ones)
        numbers = [found[setting][state] for state in states]
        lines.append([f"`{setting}`", *map(str, [sum(found[setting].values()), *numbers, mine])])
    return markdown_table(lines)


def matrix(store: Store, cells: Cells) -> list[list[str]]:
    """A line for each case: variants alive with each setting, in bold where one fails."""
    settings = settings_of(cells)
    what = {result.case: (f"{result.case} {result.name}", result.parameters) for result in store.ordered()}
    lines = [["case", "what", *settings]]
    for case in dict.fromkeys(number for number, _ in cells):
        shown = (cells[case, one].shown() if (case, one) in cells else "" for one in settings)
        lines.append([*what.get(case, (str(case), "")), *shown])
    return lines


def case_lines(store: Store, setting: str, results: Sequence[Result]) -> list[str]:
    """One line for a case that fails with a setting, one for a case that is too slow; all failures of those that are
    recommended.
    """
    failed = [result for result in results if result.state == FAILED]
    slow = [result for result in results if result.state == SLOW]
    lines = []
    if failed and setting in RECOMMENDED:
        lines += [f"- {failure_line(result, store.reason(result), picture=False)}" for result in failed]
    elif failed:
        first, broken = failed[0], failed[0].failure
        assert broken is not None
        names = ", ".join(result.variant for result in failed)
        reasons = dict.fromkeys(store.reason(result) or UNEXPLAINED for result in failed)
        lines.append(
            f"- {first.case} {first.name} fails with {setting} ({names}): {broken.what} {broken.value:.4g}, not"
            f" {broken.bound:.4g}, in frame {broken.frame}; {'; '.join(reasons)}"
        )
    if slow:
        names = ", ".join(f"{result.variant}: {result.slow_ms:.0f} ms" for result in slow)
        lines.append(f"- {slow[0].case} {slow[0].name} is too slow with {setting} ({names})")
    return lines


def rows_page(store: Store, main: str) -> list[str]:
    """A line for every variant that ran, and for every failure how to repeat it."""
    results = store.ordered()
    lines = [
        "# Stability: every variant",
        "",
        f"The results behind [{main}]({main}).",
        "",
        LEGEND.replace("\n", " "),
        "",
    ]
    lines += markdown_table([HEADINGS, *(row(result) for result in results)])
    failures = [f"- {failure_line(r, store.reason(r), picture=False)}" for r in results if r.failure]
    return [*lines, "", "## Failures", "", *(failures or ["None."])]


def robust_words() -> str:
    """The recommended setting, as a scene writes it."""
    solver = ROBUST.solver
    words = [f'`[solver] name = "{solver.name}"`, `substeps = {solver.substeps}`, `iterations = {solver.iterations}`']
    words += [
        "`swept = true` in every collider",
        "`untangle = true` and `stick = true` where a scene has `[self_collision]`",
    ]
    words += [f"and `[limit] sweeps = {ROBUST.limit_sweeps}` where a scene has a limit"]
    return ", ".join(words)


PAGE = """\
`make stress` runs {cases} cases that break cloth, each in several variants and each variant from ten starts, with every
solver at its usual substeps and iterations and with two settings that are recommended for hard scenes:

- `robust` is the scene's own cloth with {robust}.
- `robust-slack` is another material, run in the same way: its threads do not resist compression
  (`[fabric] compression = {compression:g}`), and it is damped at {damping:g}/s where a scene has less but some. It runs
  the cases that `robust` does not survive.

Starts differ by a random seed: places or velocities are disturbed a little. One start that fails fails the variant, and
one variant that fails fails the case. `taichi-cloth stress --only yank --variant "10 m" --solver xpbd` runs one
variant, and `--seed N` repeats one start. [{rows}]({rows}) has a line for every variant.

Unless a case says otherwise the sheet is 1 m by 1 m of 0.2 kg/m², {cells} × {cells} cells with every setting, 1000 N/m
along threads and diagonals, 1.57e-5 N·m of bending, damped at 2/s, hung by two corners or its top edge.

**Alive** means, after every frame: all positions and velocities are finite; pins are where they were put, to the last
bit; no particle is farther than two sides from all that holds, carries or throws it; energy is no more than at the
start and than was given since, plus 1 %. And for the last quarter of a second of the 5 seconds after the disturbance no
thread is strained by more than the static strain plus 1 %, and nothing is faster than 0.1 m/s. The static strain is
that of the same cloth in float64 with the constants of its fabric, whatever the method's own artificial stretch; of a
cloth without pins, which comes to lie on something, it is that of one hung by two corners, an upper bound. Cases 20 to
22, 24 to 26, 28, 31 to 34, 36 and 37 go on for three to five seconds before these five begin: the list runs every case
for ten. Cases 2, 3 and 8 to 13 end with the five seconds. The extra bounds of a case are in its row, as is what it
judges otherwise. Cases 19 and 20 are without gravity. Sheets that swing or fall without damping (cases 32, 33 and 37)
are damped before they must rest. A mesh with slivers (case 24) is judged by the static strain of the same mesh without
them, flat cells by that of a square sheet.

**Energy** is the sum of motion, height, springs and bending, with the constants of the fabric, for what is given and
for what is judged alike. What is done between two frames is known exactly. Within a frame, growth counts as given up to
a bound on the work of hands, wind and moving colliders, and of colliders that hold particles because they appeared
around them (`taichi_cloth/stress/watch.py` has the formulas). The bound of colliders is a loose one: it takes every
particle that a collider may touch to be hit by it in every frame.

**Too slow** is a variant whose frames take more than {slow:.0f} ms (30 frames a second), by the median of the first
five after compiling, unless its row says otherwise. It counts neither as alive nor as failed.

**Causes** come from experiments on the start that failed. Three continue it from where it failed: Newton's method in
float64, five more seconds of the same run, and the same substeps in float64. The others repeat it and two more starts
with one change: swept colliders, {finer} times the iterations, {finer} times the substeps, or both. The first
experiment that ends well gives the cause. An experiment whose frames take more than {experiment:g} s for one start is
stopped and gives none. A failure without a cause is unexplained, and so is one that later breaks another bound, or
breaks the same one by more.

`taichi-cloth stress --tear 0.5` runs the cases with sheets whose threads give way at that strain: without bending,
which cannot be cut, and without `lines`, whose rows must be whole. Alive is the same there, but that a sheet that has
torn need not be still at the end: pieces fall. Rows tell the share of springs torn."""
