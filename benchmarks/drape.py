"""Measure how the drape coefficients of A4.6 depend on start, mesh and springs: `python benchmarks/drape.py`.

Each cell has the coefficient [%], the number of folds, and the time until rest [s]. With `explicit` this takes minutes.
"""

from __future__ import annotations

from typing import Any

import taichi_cloth as tc
from taichi_cloth.evaluation.validate.drape import LINKS, PUBLISHED, DrapeResult, drape_simulation, simulate_to_rest

VARIANTS: dict[str, dict[str, Any]] = {
    "as in A4.6": {},
    "another start": {"seed": 1},
    "a third start": {"seed": 2},
    f"{LINKS - 3} rings outside the disc, not {LINKS}": {"links": LINKS - 3},
    f"{LINKS + 4} rings": {"links": LINKS + 4},
    "membrane twice as stiff": {"membrane": 2.0},
    "membrane 30 times as stiff, as along threads": {"membrane": 30.0},
    "bending × 0.75": {"bending": 0.75},
    "bending × 0.5": {"bending": 0.5},
}


def measure(preset: str, changes: dict[str, Any]) -> DrapeResult:
    with drape_simulation(preset, "explicit", **changes) as simulation:
        return simulate_to_rest(simulation)


def main() -> None:
    tc.init()
    print("| | " + " | ".join(PUBLISHED) + " |\n|---|" + "---|" * len(PUBLISHED), flush=True)
    for name, changes in VARIANTS.items():
        results = [measure(preset, changes) for preset in PUBLISHED]
        cells = [f"{one.coefficient:.1f}, {one.folds}, {one.seconds:g}" for one in results]
        print(f"| {name} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
