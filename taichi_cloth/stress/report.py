"""What came out, as tables: results by unit, and by case and setting."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ..bench.report import print_table
from .store import Store
from .unit import ALIVE, FAILED, SLOW, Key, Result

NOT_RUN = "not run"
UNEXPLAINED = "unexplained"
HEADINGS = (
    "case", "variant", "setting", "state", "starts", "energy", "strain", "speed", "in body", "frames", "ms", "besides",
)  # fmt: skip
LEGEND = (
    "Worst of all starts that ran: those after a variant's first failure are skipped. Energy: above all given, of it\n"
    "· strain of a thread · speed [m/s] · in body: depth of the deepest free particle [mm] · ms: median of a frame ·\n"
    "besides: what the case asks for, and its bound"
)


@dataclass(frozen=True)
class Cell:
    """A case with a setting."""

    planned: int  # variants
    results: list[Result]

    @property
    def state(self) -> str:
        """One variant that fails fails the case; one that is too slow leaves it open, as one that was not run does."""
        states = {result.state for result in self.results}
        if FAILED in states:
            return FAILED
        return NOT_RUN if len(self.results) < self.planned else SLOW if SLOW in states else ALIVE

    def shown(self) -> str:
        """Variants alive of all, and what the case is if not alive."""
        share = f"{sum(result.state == ALIVE for result in self.results)}/{self.planned}"
        state = self.state
        return share if state == ALIVE else f"**{share}**" if state == FAILED else f"{share} {state}"


Cells = dict[tuple[int, str], Cell]  # by number of the case, and setting


def cells_of(store: Store, keys: Sequence[Key] | None = None) -> Cells:
    """Of all that is planned, or of these units."""
    found: Cells = {}
    for case, variant, setting in store.planned if keys is None else keys:
        cell = found.setdefault((case, setting), Cell(0, []))
        result = store.results.get((case, variant, setting))
        found[case, setting] = Cell(cell.planned + 1, cell.results + ([result] if result else []))
    return found


def settings_of(cells: Cells) -> list[str]:
    return list(dict.fromkeys(setting for _, setting in cells))


def counts(cells: Cells) -> dict[str, dict[str, int]]:
    """By setting: how many cases are in which state."""
    found: dict[str, dict[str, int]] = {}
    for (_, setting), cell in cells.items():
        by_state = found.setdefault(setting, dict.fromkeys((ALIVE, FAILED, SLOW, NOT_RUN), 0))
        by_state[cell.state] += 1
    return found


def alive_with_any(cells: Cells, settings: Sequence[str]) -> int:
    """How many cases one of the settings survives at least."""
    return len({case for (case, setting), cell in cells.items() if setting in settings and cell.state == ALIVE})


def count_line(cells: Cells) -> str:
    return " · ".join(
        f"{setting} " + ", ".join(f"{number} {state}" for state, number in found.items() if number or state != NOT_RUN)
        for setting, found in counts(cells).items()
    )


def besides(result: Result) -> str:
    """Each number that the case tells, with its bound, and what is judged otherwise."""
    bounds = ("" if figure.bound is None else f" (≤ {figure.bound:.2g})" for figure in result.figures)
    told = [f"{figure.what} {figure.value:.2g}{bound}" for figure, bound in zip(result.figures, bounds, strict=True)]
    return "; ".join(told + result.notes)


def row(result: Result) -> tuple[str, ...]:
    return (
        f"{result.case} {result.name}",
        result.variant,
        result.setting,
        result.state,
        f"{result.ran} of {result.starts}",
        f"{result.energy:+.1%}" if abs(result.energy) < 100 else f"{result.energy:+.0e}",
        f"{result.strain:.2g}",
        f"{result.speed:.3g}",
        f"{1e3 * result.penetration:.2g}",
        str(result.frames),
        shown_ms(result),
        besides(result),
    )


def shown_ms(result: Result) -> str:
    """Of a frame; none where no frame ran after the first, which compiles."""
    ms = result.ms if result.slow_ms is None else result.slow_ms
    return f"{ms:.2f}" if ms else "-"


def failure_line(result: Result, reason: str, *, picture: bool = True) -> str:
    """Which start broke which bound, how to repeat it, and why."""
    failure = result.failure
    assert failure is not None
    return (
        f"{result.case} {result.name}, {result.variant}, fails with {result.setting}: {failure.what}"
        f" {failure.value:.4g}, not {failure.bound:.4g}, in frame {failure.frame} of start {failure.start}"
        f" (seed {failure.seed}); {reason or UNEXPLAINED}"
        + (f"; {result.picture}" if result.picture and picture else "")
    )


def slow_line(result: Result) -> str:
    who = f"{result.case} {result.name}, {result.variant}"
    return f"{who}, is too slow with {result.setting}: {result.slow_ms:.0f} ms a frame"


def print_report(store: Store, results: Sequence[Result]) -> None:
    """Of these results."""
    open_ones = store.unexplained(results)
    notes = [
        LEGEND,
        *(failure_line(r, store.reason(r)) for r in results if r.failure),
        *(slow_line(r) for r in results if r.state == SLOW),
    ]
    notes += [f"{len(open_ones)} of {sum(r.state == FAILED for r in results)} failures are unexplained"]
    notes += [store.machine, count_line(cells_of(store, [result.key for result in results]))]
    print_table(HEADINGS, map(row, results), slice(4, -1), notes)


def origin_lines(store: Store) -> list[str]:
    """Of how many units, when, and whether all were made with the same program."""
    results = store.ordered()
    missing = len(store.planned) - len(results)
    lines = [f"{missing} of {len(store.planned)} units not run."] if missing else []
    if store.older:
        lines.append(f"Of mixed origin: {store.older} of {len(results)} results are of an older program.")
    if fewest := {result.starts for result in results}:
        starts = f"{min(fewest)} to {max(fewest)}" if len(fewest) > 1 else f"{min(fewest)}"
        days = sorted({result.date[:10] for result in results})
        when = " to ".join(dict.fromkeys((days[0], days[-1])))
        hours = sum(result.seconds for result in results) / 3600
        lines.append(f"{starts} starts a variant; run {when}; {hours:.1f} hours of one core.")
    lines += [f"Run on {one}." for one in dict.fromkeys(result.machine for result in results if result.machine)]
    return lines
