"""`--log`: one line of JSON for every displayed frame."""

from __future__ import annotations

import json
from pathlib import Path
from types import TracebackType
from typing import Any, TextIO

from ..scene.live import live_keys
from .session import Session


class Journal:
    """Writes lines to a file as they come, so that another program can follow it. Raises OSError."""

    def __init__(self, path: Path) -> None:
        self._file: TextIO = path.open("w", encoding="utf-8")

    def write(self, line: dict[str, Any]) -> None:
        self._file.write(json.dumps(line) + "\n")
        self._file.flush()

    def __enter__(self) -> Journal:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._file.close()


def line_of(
    session: Session, displayed: int, cursor: tuple[float, float], aspect: float, draw_ms: float
) -> dict[str, Any]:
    """What there is to say of one picture. Screen points run from (0, 0) at the bottom left to (1, 1)."""
    simulation, camera, measures = session.simulation, session.camera, session.measures
    held = simulation.grabbed
    particle = None if held is None else camera.to_screen(simulation.positions()[held], aspect)[0][0].tolist()
    return {
        "displayed": displayed,
        "scene": simulation.scene.name,
        "solver": simulation.solver.name,
        "frame": simulation.frame,
        "physics_ms": round(session.physics_ms, 3),
        "draw_ms": round(draw_ms, 3),
        "max_strain": measures.max_strain,
        "mean_strain": measures.mean_strain,
        "view": session.view,
        "frozen": session.frozen,
        "panel": not session.hidden,
        "page": session.page,
        "curves": session.curves,
        "radius": session.radius,
        "fabric": simulation.scene.fabric.preset,
        "stages": simulation.stages,
        "mouse": session.pointer.owner.value,
        "cursor": list(cursor),
        "grabbed": held,
        "held": len(simulation.held),
        "added_pins": simulation.added_pins.tolist(),
        "particle": particle,
        "eye": list(camera.eye),
        "target": camera.target.tolist(),
        "wind": simulation.get("wind"),
        "live": {name: simulation.get(name) for name in live_keys(simulation.scene)},
    }
