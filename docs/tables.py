"""Markdown tables, and lines about the runs that stored results come from."""

from __future__ import annotations

import csv
from collections.abc import Callable

import stored

Rows = list[list[str]]


def table(header: list[str], rows: Rows) -> str:
    lines = [header, ["---"] * len(header), *([cell.replace("|", "\\|") for cell in row] for row in rows)]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


NO_DATE = "date not stored"
NO_COMMIT = "commit not stored"


def machine_and_date(words: stored.Words) -> str:
    """Return the machine, the versions, the date and the commit of a run as one line."""
    parts = stored.machine_of(words), words.get("date") or NO_DATE, short_commit(words)
    return " · ".join(parts)


def validation_run(words: stored.Words) -> str:
    """Return the machine, the date and the commit of a run, and how many of its rows were measured later."""
    later = sum(bool(row.get("later")) for row in words["rows"])
    return machine_and_date(words) + f" ({later} of {len(words['rows'])} rows later)" * bool(later)


def short_commit(words: stored.Words) -> str:
    """Return the first digits of a run's commit, with a + if files had changed since."""
    commit = words.get("commit")
    return f"commit {commit[:8]}" + "+" * commit.endswith("+") if commit else NO_COMMIT


def machines_and_dates(words: stored.Words) -> str:
    """Return the machines and the dates of a run that was continued: each of its results has its own."""
    machines = dict.fromkeys(row["machine"] for row in words["results"] if row.get("machine"))
    days = sorted({row["date"][:10] for row in words["results"] if row.get("date")})
    names = " and ".join(machines or [stored.machine_of(words)])
    dates = " to ".join(dict.fromkeys((days[0], days[-1]))) if days else NO_DATE
    count = words.get("older")
    older = f" ({count} of {len(words['results'])} results are of an older version)" if count else ""
    return f"{names} · {dates}{older}"


def machine_and_date_of_curtain() -> str:
    """Return the machine and date of assets/error.csv, from the JSON that was written with it.

    The CSV contains only the measurements. The JSON belongs to it if all its times are equal.
    """
    words = stored.load("error")
    with stored.ERRORS.open(encoding="utf-8", newline="") as file:
        times = [float(row["median_ms"]) for row in csv.DictReader(file)]
    if words is None or [point["median_ms"] for point in words["points"]] != times:
        return "machine and date not stored in assets/error.csv"
    later = [point["later"] for point in words["points"] if point.get("later")]
    return machine_and_date(words) + (f" ({len(later)} of {len(times)} points: {later[0]})" if later else "")


def gpu_and_date(words: stored.Words) -> str:
    """Return the GPU, and the machine and the date of a run on it."""
    return f"{words['device']} ({words['arch']}) · {machine_and_date(words)}"


# For each command: the name of its stored file, and the function that returns the machine and date of that file.
RUNS: dict[str, tuple[str, Callable[[stored.Words], str]]] = {
    "bench": ("bench", machine_and_date),
    "bench --goals": ("goals", machine_and_date),
    "bench --gpu": ("gpu", gpu_and_date),
    "bench --error --scene": ("scene_errors", machine_and_date),
    "validate": ("validation", validation_run),
    "ablate": ("ablation", machine_and_date),
    "stress": ("stability", machines_and_dates),
    "stress --soak": ("soak", machines_and_dates),
}


def runs_line(*commands: str) -> str:
    """Return the machines and dates of the stored runs of these commands, as one paragraph."""
    found = []
    for command in commands:
        if command == "bench --error":
            found.append(f"`{command}`: {machine_and_date_of_curtain()}")
            continue
        name, describe = RUNS[command]
        words = stored.load(name)
        if words is not None:
            found.append(f"`{command}`: {describe(words)}")
    return f"Runs: {'; '.join(found)}." if found else ""


def with_runs(text: str, *commands: str) -> str:
    """Return a block with the machines and dates of its results below it."""
    return "\n\n".join(filter(None, (text, runs_line(*commands))))
