"""What pages are told: a scene once, its panel when it changes, every moment that is sent, and figures.

A message is JSON with arrays behind it, little-endian: four bytes tell how long the JSON is, which is filled up with
spaces to a multiple of four. Of the arrays the JSON says how many numbers there are.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..interact.keys import KEYS, MOUSE
from ..page.sheet import left_of, quantised, vertices
from ..page.surroundings import Solids, air
from ..scene.live import LiveKey, live_keys
from ..scene.model import PRESET_NAMES, SOLVER_NAMES
from ..view import draw_bodies, solids
from ..view.draw_list import HELD, PINNED, bead_radius
from ..view.fill import FULL_STRAIN, strain_colours
from ..view.panel import HAND_HELP, numbers, with_cost
from ..view.patterns import pattern_colours
from ..view.session import Session
from .words import BARRED

RAMP = 129  # colours of strain, from shortest to longest
SLIDER_STEPS = 400


def packed(head: dict[str, Any], arrays: Sequence[NDArray[Any]] = ()) -> bytes:
    """One message."""
    text = json.dumps(head, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    return b"".join([struct.pack("<I", len(text)), text, *(array.tobytes() for array in arrays)])


class Telling:
    """What there is to tell of a session's scene, as long as it is the same scene of the same cloth."""

    def __init__(self, session: Session, number: int) -> None:
        """`number` is that of the scene, since the server began."""
        self.number = number
        self._session = session
        self._simulation = session.simulation
        self._scene = session.simulation.scene
        self._whole = self._seen = session.simulation.topology
        self._keys = live_keys(self._scene)
        self._there = np.ones(self._whole.triangle_count, bool)
        ball = solids.unit_sphere(8)
        self._solids = Solids(self._simulation, [draw_bodies.coloured(ball, ball, tint) for tint in (HELD, PINNED)])

    @property
    def holds(self) -> bool:
        """Whether it is the same still: no other scene, stages, fabric, method, nor a torn cloth made whole."""
        simulation = self._session.simulation
        return (
            simulation is self._simulation
            and simulation.scene is self._scene
            and simulation.topology.triangle_count <= self._there.sum()
        )

    def scene(self) -> bytes:
        """All that stays."""
        whole, scene = self._whole, self._scene
        owner, tint, corners = vertices(whole, pattern_colours(whole, scene.look))
        told, solid_vertices, solid_corners = self._solids.packed()
        springs = whole.family_counts.get("structural", 0) or whole.spring_count
        strains, ramp = np.linspace(-FULL_STRAIN, FULL_STRAIN, RAMP), np.zeros((RAMP, 3), np.float32)
        strain_colours(strains.astype(np.float32), ramp)
        head = {
            "kind": "scene",
            "of": self.number,
            "name": scene.name,
            "title": scene.title or scene.name,
            "particles": whole.particle_count,
            "vertices": len(owner),
            "triangles": len(corners),
            "springs": springs,
            "solids": told,
            "solidVertices": len(solid_vertices),
            "solidCorners": len(solid_corners),
            "bead": bead_radius(whole),
            "fullStrain": FULL_STRAIN,
            "ramp": np.rint(255 * ramp).astype(int).tolist(),
            "keys": [[key.code, key.label, key.action, key.help] for key in KEYS if key.action not in BARRED],
            "mouse": MOUSE,
            **air(scene),
        }
        arrays = [
            solid_vertices.astype("<f4"),
            whole.rest[:springs].astype("<f4"),
            solid_corners.astype("<u4"),
            owner.astype("<u4"),
            corners.astype("<u4"),
            whole.ends[:springs].astype("<u4"),
            tint,
        ]
        return packed(head, arrays)

    def moment(self) -> bytes:
        """Where everything is now. Places are whole numbers of 16 bits within the cloth's box."""
        simulation = self._simulation
        if simulation.topology is not self._seen:  # it tore, or has other pins
            self._seen = simulation.topology
            self._there = left_of(self._whole, self._seen)
        x = simulation.positions()
        low, step, steps = quantised(x)
        held = [grip.index for grip in (puller.grip for puller in self._session.pullers.values()) if grip]
        beads = x[[*held, *simulation.added_pins]]
        poses = np.swapaxes(self._solids.poses(), 1, 2)
        there = np.zeros(0, np.uint8) if self._there.all() else np.packbits(self._there, bitorder="little")
        head = {
            "kind": "moment",
            "of": self.number,
            "frame": simulation.frame,
            "low": low.tolist(),
            "step": step.tolist(),
            "poses": len(poses),
            "held": len(held),
            "beads": len(beads),
            "there": len(there),
        }
        return packed(head, [poses.astype("<f4"), beads.astype("<f4"), steps.astype("<u2"), there])

    def panel(self, scenes: list[str]) -> bytes:
        """What there is to choose, to switch and to move."""
        session, scene, times = self._session, self._scene, self._session.stage_times
        sliders = [_slider(key) for key in self._keys.values()]
        hand = {"low": 0.0, "high": session.largest_radius, "value": session.usual_radius}
        hand |= {"step": session.largest_radius / SLIDER_STEPS}
        return packed(
            {
                "kind": "panel",
                "of": self.number,
                "scenes": scenes,
                "scene": scene.name,
                "solvers": SOLVER_NAMES,
                "solver": scene.solver.name,
                "fabrics": PRESET_NAMES,
                "fabric": session.fabric,
                "stages": {name: [with_cost(name, times), on] for name, on in session.stages.items()},
                "wind": with_cost("wind", times) if scene.wind else "",
                "sliders": [*sliders, {"name": "hand", "label": "Hand", "unit": "m", "help": HAND_HELP, **hand}],
            }
        )

    def figures(self, sending_ms: float, pictures: float, visitors: int) -> bytes:
        """How fast and how right it is; measured just now. `pictures` were sent in a second."""
        session, simulation, measures = self._session, self._simulation, self._session.measures
        strains = 100 * measures.max_strain, 100 * measures.mean_strain
        row = simulation.seconds, measures.kinetic_energy, measures.potential_energy, *strains
        return packed(
            {
                "kind": "figures",
                "of": self.number,
                "frozen": session.frozen,
                "note": session.note,
                "numbers": numbers(session, sending_ms, pictures, "sending"),
                "values": {name: simulation.get(name) for name in self._keys} | {"hand": session.radius},
                "wind": simulation.get("wind"),
                "row": row if measures.finite else None,
                "visitors": visitors,
            }
        )


def _slider(key: LiveKey) -> dict[str, Any]:
    step = 1 if key.is_int else (key.high - key.low) / SLIDER_STEPS
    told = {"name": key.name, "label": key.label, "unit": key.unit, "help": key.help}
    return told | {"low": key.low, "high": key.high, "step": step, "value": key.value}
