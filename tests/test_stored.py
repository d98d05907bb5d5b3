"""What documents quote from stored results, which commands write."""

from __future__ import annotations

import csv
import json
import re
from datetime import UTC, date, datetime
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

DOCS = Path(__file__).parents[1] / "docs"

Words = dict[str, Any]


@pytest.fixture(autouse=True, scope="module")
def taichi() -> None:
    """Nothing here needs Taichi."""


@pytest.fixture
def results(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder of results instead of the repository's."""
    monkeypatch.syspath_prepend(str(DOCS))
    import stored

    monkeypatch.setattr(stored, "RESULTS", tmp_path)
    (tmp_path / "machine").mkdir()
    return tmp_path / "machine"


@pytest.fixture
def tables(results: Path) -> ModuleType:
    import tables

    return tables


@pytest.fixture
def errors(results: Path) -> ModuleType:
    import error_blocks

    return error_blocks


@pytest.fixture
def verdicts(results: Path) -> ModuleType:
    import verdict_blocks

    return verdict_blocks


def variant(
    case: int, name: str, of: str, setting: str, *, failure: Words | None = None, slow: float | None = None
) -> Words:
    return {"case": case, "name": name, "variant": of, "setting": setting, "failure": failure, "slow_ms": slow}


FAILURE = {"start": 3, "seed": 7, "frame": 12, "what": "strain", "value": 0.175, "bound": 0.013}
STABILITY = {
    "machine": "a machine",
    "planned": [
        *[[1, of, setting] for setting in ("xpbd", "robust") for of in ("1 N/m", "10 N/m")],
        *[[2, "wide", setting] for setting in ("xpbd", "robust", "explicit")],
    ],
    "results": [
        variant(1, "stiffness", "1 N/m", "xpbd"),
        variant(1, "stiffness", "10 N/m", "xpbd", failure=FAILURE),
        variant(1, "stiffness", "1 N/m", "robust"),
        variant(2, "gap", "wide", "xpbd", slow=130.0),
        variant(2, "gap", "wide", "robust"),
    ],
}


def row(reference: str, solver: str, verdict: str, error: float | None) -> Words:
    return {"reference": reference, "name": "fall", "solver": solver, "verdict": verdict, "error": error}


VALIDATION = {
    "machine": {"cpu": "one", "cores": "2 cores"},
    "rows": [
        row("A1", "xpbd", "excellent", 1e-6),
        row("A1", "xpbd", "falls short", 0.25),
        row("A2", "xpbd", "pass", 1e-3),
        row("A1", "explicit", "excellent", 0.0),
        row("A2", "explicit", "too slow", None),
    ],
}


def write(folder: Path, name: str, words: Words) -> None:
    (folder / f"{name}.json").write_text(json.dumps(words), encoding="utf-8")


def test_documents_state_that_no_run_is_stored(errors: ModuleType, verdicts: ModuleType) -> None:
    blocks = [verdicts.stability_summary, verdicts.validation_summary, verdicts.nobody]
    blocks += [verdicts.soak, verdicts.unfinished, verdicts.fabric_rows]
    for block in (*blocks, verdicts.bar_friction, errors.frames, errors.sheets, errors.scene_summary):
        assert "o run is stored" in block(), block
    assert verdicts.unconverged().count("no run is stored") == len(verdicts.SOLVER_CATALOG)
    assert "no run is stored" in verdicts.choosing()
    assert errors.goals().count("not measured") > 10
    for solver in verdicts.SOLVER_CATALOG:
        assert verdicts.solver(solver).count("no run is stored") == 4


def test_a_case_fails_with_one_variant_and_counts_only_if_it_ran(results: Path, verdicts: ModuleType) -> None:
    write(results, "stability", STABILITY)
    assert verdicts.stability_summary().splitlines() == [
        "| setting | cases | alive | failed | too slow | not run |",
        "| --- | --- | --- | --- | --- | --- |",
        "| `robust` | 2 | 1 | 0 | 0 | 1 |",
        "| `xpbd` | 2 | 0 | 1 | 1 | 0 |",
        "| `explicit` | 1 | 0 | 0 | 0 | 1 |",
        "",
        "Runs: `stress`: a machine · date not stored.",
    ]
    assert verdicts.hard_cases("xpbd").splitlines() == [
        "Cases that break cloth ([stability](../stability.md)) and that it survives: 0 of 2.",
        "",
        "- 1 stiffness fails (10 N/m): strain 0.175, bound 0.013",
        "- 2 gap: too slow",
    ]
    assert verdicts.survives("robust") == "1 of 1, 1 not run"
    assert verdicts.survives("xpbd") == "0 of 2"
    assert verdicts.survives("explicit") == "not run"
    unknown = "- Not known of 1 cases: no solver that ran them survives them, and not all have."
    assert verdicts.nobody().splitlines() == ["- 1 stiffness", unknown]


def test_a_long_run_is_told_by_its_drift_or_its_end(results: Path, verdicts: ModuleType) -> None:
    drift = {"what": "drift [m]", "value": 4e-5, "bound": 1e-4}
    ran = {"parameters": "two runs", "frames": 101_200, "figures": [drift, {"what": "speed", "value": 1, "bound": 2}]}
    words = {
        "machine": "a machine",
        "planned": [[32, of, setting] for setting in ("verlet", "xpbd") for of in ("hanging", "swinging")],
        "results": [
            variant(32, "long run", "hanging", "verlet", failure=FAILURE | {"frame": 5400}) | ran,
            variant(32, "long run", "swinging", "verlet", slow=130.0) | ran,
            variant(32, "long run", "hanging", "xpbd") | ran,
        ],
    }
    write(results, "soak", words)
    assert verdicts.soak().splitlines() == [
        "two runs:",
        "",
        "| setting | hanging | swinging |",
        "| --- | --- | --- |",
        "| `verlet` | strain 0.17 after 5,400 frames (≤ 0.013) | too slow: 130\N{NO-BREAK SPACE}ms a frame |",
        "| `xpbd` | alive after 101,200 frames, drift [m] 4e-05 | not run |",
        "",
        "Runs: `stress --soak`: a machine · date not stored.",
    ]


def test_documents_count_cases_as_the_report_of_stress_does(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(DOCS))
    import stored

    from taichi_cloth.evaluation.stress.store import load
    from taichi_cloth.evaluation.stress.stress_report import cells_of, counts

    words = stored.load("stability")
    assert words is not None
    found = {setting: dict(states) for setting, states in stored.survival(words).items()}
    counted = counts(cells_of(load(stored.RESULTS / "stability.json"))).items()
    assert found == {setting: {state: n for state, n in states.items() if n} for setting, states in counted}


def test_the_readme_quotes_the_summaries_of_both_pages_whole(verdicts: ModuleType) -> None:
    readme = (DOCS.parent / "README.md").read_text(encoding="utf-8")
    tops = {}
    for page, end in (("validation.md", r"\| solver"), ("stability.md", r"\d+ (results|starts)")):
        text = (DOCS / page).read_text(encoding="utf-8")
        tops[page] = re.split(f"\n{end}", text)[0].splitlines()[2:]
        link = f" [{page[:-3]}_rows.md]({page[:-3]}_rows.md) has them all."
        assert [line for line in tops[page] if line.replace(link, "") not in readme] == []
    assert sum("pass in every row" in line for line in tops["validation.md"]) == 1
    assert sum("only with the other material" in line for line in tops["stability.md"]) == 1


def test_rows_of_references_are_counted_by_verdict(results: Path, verdicts: ModuleType) -> None:
    write(results, "validation", VALIDATION)
    assert verdicts.validation_summary().splitlines()[2:5] == [
        "| all | 5 | 60.0% | 40.0% |",
        "| `xpbd` | 3 | 66.7% | 33.3% |",
        "| `explicit` | 2 | 50.0% | 50.0% |",
    ]
    assert verdicts.references("xpbd").splitlines()[-1] == "| A1 fall | 1 of 2 | 0 of 2 | 0.25 |"
    assert verdicts.references("explicit").splitlines()[-1] == "| A2 fall | 0 of 1 | 1 of 1 | - |"
    assert verdicts.falls_short("xpbd") == "1 of 2"


def test_rows_with_a_shipped_fabric_are_shown_by_solver(results: Path, verdicts: ModuleType) -> None:
    rows = [
        row("A4.6", "xpbd", "pass", 0.0) | {"what": "silk: drape coefficient [%]", "measured": 34.66},
        row("A4.6", "lines", "fails", 8.4) | {"what": "silk: drape coefficient [%]", "measured": 78.4},
        row("A4.6", "xpbd", "fails", None) | {"what": "denim: drape coefficient [%]", "measured": None},
        row("A4.6", "xpbd", "pass", 0.1) | {"what": "change of a coefficient [%]", "measured": 0.1},
    ]
    write(results, "validation", {"machine": "a machine", "rows": rows})
    assert verdicts.fabric_rows().splitlines()[:4] == [
        "| row | `xpbd` | `lines` |",
        "| --- | --- | --- |",
        "| A4.6 silk: drape coefficient [%] | 34.7 | 78.4, fails |",
        "| A4.6 denim: drape coefficient [%] | -, fails |  |",
    ]


TOO_EARLY = "iterations end too early: a law"


def exact_row(number: str, solver: str, what: str, verdict: str, exact: float, measured: float | None) -> Words:
    found = {"reference": number, "name": "sheet", "solver": solver, "what": what, "verdict": verdict}
    return found | {"exact": exact, "measured": measured, "error": None}


def test_the_error_of_a_default_setting_is_that_of_its_worst_rows(results: Path, verdicts: ModuleType) -> None:
    rows = [
        exact_row("A3.1", "xpbd", "16 rows: longer by [m]", "excellent", 2.0, 2.0002),
        exact_row("A3.1", "xpbd", "128 rows: longer by [m]", "falls short", 2.0, 4.4),
        exact_row("A3.1", "lines", "16 rows: longer by [m]", "excellent", 2.0, 1.999),
        exact_row("A3.1", "lines", "128 rows: longer by [m]", "too slow", 2.0, None),
        exact_row("A5.1", "xpbd", "on the bias [N/m]", "falls short", 100.0, 86.0) | {"reason": TOO_EARLY},
        exact_row("A5.1", "xpbd", "along the warp [N/m]", "pass", 100.0, 101.0),
        exact_row("A5.1", "lines", "on the bias [N/m]", "pass", 100.0, 98.1),
        exact_row("A2.5", "rk4", "sag [m]", "too slow", 1.0, None),
        exact_row("A9.9", "explicit", "for another reason", "falls short", 1.0, 9.0) | {"reason": "rounding"},
        exact_row("B3", "xpbd", "10×5: longer by [m]", "falls short", 1.0, 9.0) | {"reason": TOO_EARLY},
        exact_row("B6.1", "xpbd", "longer by [m]", "falls short", 1.0, 9.0) | {"reason": TOO_EARLY},
        exact_row("A8.3", "xpbd", "difference [m]", "falls short", 0.0, 9.0) | {"reason": TOO_EARLY},
    ]
    write(results, "validation", {"machine": "a machine", "rows": rows})
    assert verdicts.unfinished() == (
        "Defaults whose iterations end too early: `xpbd` (+120\N{NO-BREAK SPACE}% in A3.1,"
        " −14\N{NO-BREAK SPACE}% in A5.1, 9 instead of 0 in A8.3)."
    )
    differs = "it differs from exact values by"
    space = "\N{NO-BREAK SPACE}"
    substeps, iterations = verdicts.SOLVER_CATALOG["xpbd"].defaults
    assert verdicts.distance("xpbd") == (
        f"with its default setting ({substeps}×{iterations}) {differs} +120{space}% in A3.1 sheet"
        f" (*128 rows: longer by*, falls short); −14{space}% in A5.1 sheet (*on the bias*, falls short);"
        f" 9 instead of 0 in A8.3 sheet (*difference*, falls short)."
    )
    assert verdicts.distance("lines").endswith(
        f"{differs} −0.05{space}% in A3.1 sheet (*16 rows: longer by*), 1 of 2 rows too slow to be measured."
    )
    assert verdicts.distance("rk4").endswith(f"{differs} A2.5 sheet, 1 of 1 rows too slow to be measured.")
    assert verdicts.distance("explicit").endswith(f"{differs} nothing that these references measure.")


def test_friction_on_a_bar_is_too_weak_if_the_ends_slip_too_early(results: Path, verdicts: ModuleType) -> None:
    rows = [
        exact_row("A7.4", "verlet", "μ = 0.1", "falls short", 2.0, 1.5),
        exact_row("A7.4", "verlet", "μ = 0.3", "falls short", 4.0, 1.0),
        exact_row("A7.4", "xpbd", "μ = 0.1", "pass", 2.0, 1.9),
        exact_row("A7.4", "explicit", "μ = 0.1", "falls short", 2.0, 2.9),
        exact_row("A7.4", "rk4", "μ = 0.1", "too slow", 2.0, None),
    ]
    write(results, "validation", {"machine": "a machine", "rows": rows})
    assert verdicts.bar_friction() == "Too weak: `verlet` in 2 of 2 rows, by up to −75\N{NO-BREAK SPACE}%."


RUNS = (("one", "2026-01-04 09:00"), ("two", "2026-01-02 23:59"), ("one", "2026-01-03 00:00"))


def test_documents_name_machine_date_and_commit_of_a_run(
    results: Path, tables: ModuleType, errors: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    from taichi_cloth.evaluation.bench import bench_report
    from taichi_cloth.system.console import machine

    monkeypatch.setattr(bench_report, "commit_of", lambda: "0123456789abcdef+")
    bench_report.write_json(results / "bench.json", [], [], {})
    today = datetime.now(UTC).date().isoformat()
    assert errors.frames().splitlines()[0] == " · ".join([*machine().values(), today, "commit 01234567+"])
    units = [variant(1, "stiffness", "1 N/m", "xpbd") | {"machine": name, "date": date} for name, date in RUNS]
    write(results, "stability", STABILITY | {"results": units, "older": 1})
    line = tables.runs_line("bench --goals", "stress")
    assert line == "Runs: `stress`: one and two · 2026-01-02 to 2026-01-04 (1 of 3 results are of an older version)."


def test_the_machine_of_the_curtain_is_that_of_the_run_with_the_same_times(results: Path, tables: ModuleType) -> None:
    import stored

    with stored.ERRORS.open(encoding="utf-8", newline="") as file:
        points = [{"median_ms": float(row["median_ms"])} for row in csv.DictReader(file)]
    assert tables.machine_and_date_of_curtain() == "machine and date not stored in assets/error.csv"
    write(results, "error", {"machine": "a machine", "date": "2026-01-02", "commit": 40 * "a", "points": points})
    assert tables.machine_and_date_of_curtain() == "a machine · 2026-01-02 · commit aaaaaaaa"
    write(results, "error", {"machine": "a machine", "points": points[1:]})
    assert tables.machine_and_date_of_curtain() == "machine and date not stored in assets/error.csv"


@pytest.mark.parametrize(
    ("figure", "more", "message"),
    [
        (1.5, False, "excellent"),
        (1.51, False, "good; 1.01 times off excellent"),
        (3.0, False, "good; 2 times off excellent"),
        (4.0, False, "good; 2.67 times off excellent"),
        (6.0, False, "**missed** by 1.5 times"),
        (6.0, True, "excellent"),
        (3.0, True, "good; 2 times off excellent"),
        (1.0, True, "**missed** by 2.5 times"),
    ],
)
def test_a_goal_is_reached_or_missed_by_a_factor(figure: float, more: bool, message: str, results: Path) -> None:
    from goals import Goal

    bounds = (2.5, 6.0) if more else (4.0, 1.5)
    assert Goal("what", "times", *bounds, lambda: figure, more_is_better=more).cells()[-1] == message


def test_a_time_with_too_large_an_error_misses_the_goal(results: Path) -> None:
    from goals import Goal, sheet

    found = {"name": "denim 64", "rms_error": 1.5e-3, "uncertainty": 5e-4, "median_ms": 3.0}
    goal = Goal("what", "ms", 25, 8, sheet("denim 64", 1e-3))
    assert goal.cells()[-1] == "not measured"
    write(results, "goals", {"machine": {}, "commands": [], "sheets": [found]})
    assert goal.cells()[-2:] == [
        "0.2\N{NO-BREAK SPACE}% in 3.00\N{NO-BREAK SPACE}ms",
        "**missed**: error 2 times too large",
    ]
    write(
        results, "goals", {"machine": {}, "commands": [], "sheets": [found | {"rms_error": 7e-4, "uncertainty": 2e-4}]}
    )
    assert goal.cells()[-2:] == ["3\N{NO-BREAK SPACE}ms", "excellent"]
    write(results, "goals", {"machine": {}, "commands": [], "sheets": [found | {"rms_error": 7e-4}]})
    assert goal.cells()[-1] == "**missed**: error 1.2 times too large"  # the reference is not accurate enough


def test_only_a_setting_that_ran_all_cases_reaches_the_goal_of_the_hard_cases(results: Path) -> None:
    from goals import alive

    cases = [(case, "a", setting) for setting, count in (("robust", 40), ("slack", 39)) for case in range(1, count + 1)]
    failed = [(case, "a", "robust") for case in range(1, 31)]
    rows = [
        {"case": case, "name": "", "variant": variant, "setting": setting, "slow_ms": None}
        | {"failure": {} if (case, variant, setting) in failed else None}
        for case, variant, setting in cases
    ]
    write(results, "stability", {"planned": cases, "results": rows})
    assert alive() == 10


def test_times_of_a_busy_machine_are_marked(results: Path) -> None:
    import stored

    quiet = {"median_ms": 1.0, "p95_ms": 1.6}
    assert stored.disturbed([]) == ""
    assert stored.disturbed([quiet, quiet, quiet | {"p95_ms": 9.0}, {"median_ms": None}]) == ""
    assert "is 3.0 times its median" in stored.disturbed([quiet, quiet | {"p95_ms": 3.0}, quiet | {"p95_ms": 9.0}])


def test_the_goal_of_the_curtain_uses_its_largest_error(
    results: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import stored
    from goals import Goal, curtain

    head = "solver,cells,substeps,iterations,median_ms,rms_error,max_error\n"
    monkeypatch.setattr(stored, "ERRORS", tmp_path / "error.csv")
    stored.ERRORS.write_text(f"{head}explicit,64,110,1,1.5,1e-7,2e-5\nlines,64,5,1,0.5,1e-7,3e-5\n", encoding="utf-8")
    goal = Goal("what", "ms", 6, 1.5, curtain(64, 1e-5))
    assert goal.cells()[-1] == "**missed**: error 2 times too large"
    assert "`explicit` 110 is closest: 0.002\N{NO-BREAK SPACE}%" in goal.cells()[-2]
    assert Goal("what", "ms", 6, 0.4, curtain(64, 4e-5)).cells()[-1] == "good; 1.25 times off excellent"


@pytest.mark.parametrize(
    ("share", "text"), [(0.014, "1.4"), (6.2e-6, "0.00062"), (0.32, "32"), (1.0, "100"), (0.1, "10")]
)
def test_errors_have_two_significant_digits(share: float, text: str, results: Path) -> None:
    import stored

    assert stored.per_cent(share) == f"{text}\N{NO-BREAK SPACE}%"


def test_cloth_that_is_not_finite_is_never_chosen(results: Path, errors: ModuleType, verdicts: ModuleType) -> None:
    """NaN compares as neither larger nor smaller: `min` would return the first of the rows."""
    import stored

    fast: Words = {"solver": "xpbd", "substeps": 1, "iterations": 1, "median_ms": 0.1}
    nan = float("nan")
    broken = [fast | {"max_error": largest, "rms_error": nan} for largest in (nan, 1e-9)]
    good = fast | {"median_ms": 2.0, "max_error": 0.01, "rms_error": 0.001}
    assert stored.most_accurate([*broken, good]) == stored.fastest([*broken, good], 0.1) == good
    assert stored.most_accurate(broken) is None
    assert errors.most_accurate(broken) == "none"

    point: Words = {"scene": "s", "p95_ms": 1.0, "max_strain": 0.1, "median_ms": 1.0, "max_error": 0.02}
    points = [point | {"setting": f"xpbd {n}×1", "rms_error": error} for n, error in ((1, nan), (2, 0.01))]
    points += [point | {"setting": "lines 5×1", "rms_error": nan}]
    scene: Words = {"scene": "s", "horizon": 9, "rms_uncertainty": 1e-6, "max_uncertainty": 1e-6, "points": points}
    write(results, "scene_errors", {"machine": {"cpu": "one"}, "scenes": [scene], "left_out": {}})
    [row] = [line for line in errors.scene_summary().splitlines() if line.startswith("| `s`")]
    cells = dict(zip(verdicts.SOLVER_CATALOG, row.strip("| ").split(" | ")[2:], strict=False))
    assert cells["xpbd"].startswith("1% (2×1: ")
    assert cells["lines"] == "not finite"


STORED_RUNS = DOCS.parent / "benchmarks" / "results"


@pytest.mark.parametrize("file", sorted(STORED_RUNS.rglob("*.json")), ids=lambda file: file.stem)
def test_every_stored_run_names_machine_date_and_commit(file: Path) -> None:
    """Of hard cases, which are run in pieces, each result does."""
    words = json.loads(file.read_text(encoding="utf-8"))
    for run in words.get("results", [words]):
        assert run["machine"]
        assert date.fromisoformat(run["date"][:10]) > date(2026, 1, 1)
    assert "results" in words or len(words["commit"]) >= 7
