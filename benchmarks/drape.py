"""How much the drape coefficients of A4.6 depend on the start, the mesh and the springs: `python benchmarks/drape.py`.

Every cell is the coefficient [%], the folds, and the time [s] after which the shadow was still; with `spring`, minutes.
"""

from __future__ import annotations

from typing import Any

import taichi_cloth as tc
from taichi_cloth.validate.drape import LINKS, PUBLISHED, Draped, hung, settled

VARIANTS: dict[str, dict[str, Any]] = {
    "as in A4.6": {},
    "another start": {"seed": 1},
    "a third start": {"seed": 2},
    f"{LINKS - 3} rings over the disc, not {LINKS}": {"links": LINKS - 3},
    f"{LINKS + 4} rings": {"links": LINKS + 4},
    "membrane twice as stiff": {"membrane": 2.0},
    "membrane 30 times, as along threads": {"membrane": 30.0},
    "bending × 0.75": {"bending": 0.75},
    "bending × 0.5": {"bending": 0.5},
}


def found(preset: str, changes: dict[str, Any]) -> Draped:
    with hung(preset, "spring", **changes) as simulation:
        return settled(simulation)


def main() -> None:
    tc.start()
    print("| | " + " | ".join(PUBLISHED) + " |\n|---|" + "---|" * len(PUBLISHED), flush=True)
    for name, changes in VARIANTS.items():
        row = [found(preset, changes) for preset in PUBLISHED]
        cells = [f"{one.coefficient:.1f}, {one.folds}, {one.seconds:g}" for one in row]
        print(f"| {name} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
