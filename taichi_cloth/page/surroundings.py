"""What is around the cloth in a page: colliders and pole as solids, and light, air and floor as the window has them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..contact.bodies import Body, is_still
from ..scene.model import Ground, Scene, Sphere
from ..simulation import Simulation
from ..view import draw_bodies, draw_list, lighting, shadow, sides, solids
from ..view.draw_bodies import Soup
from .sheet import Floats


class Solids:
    """All that is drawn of a scene but the cloth and the floor: colliders and the pole."""

    def __init__(self, simulation: Simulation, more: Sequence[Soup] = ()) -> None:
        """`more` are drawn too; whoever adds them says where."""
        self._simulation = simulation
        bodies = simulation.bodies()
        self._drawn = [k for k, body in enumerate(bodies) if not isinstance(body.collider, Ground)]
        self._sizes = [bodies[k].size[0] for k in self._drawn]
        self.moving = [not is_still(bodies[k].collider) for k in self._drawn]
        self._soups = [_soup(bodies[k]) for k in self._drawn]
        if simulation.scene.look.pole:
            self._soups.append(draw_bodies.pole(simulation.scene, simulation.topology.start))
            self.moving.append(False)
        self._soups += more

    def poses(self) -> Floats:
        """Where each is now, (K, 4, 4); without those that were added."""
        bodies = self._simulation.bodies()
        poses = [_pose(bodies[k], size) for k, size in zip(self._drawn, self._sizes, strict=True)]
        poses += [np.eye(4)] * (len(self.moving) - len(poses))
        return np.array(poses).reshape(-1, 4, 4)

    def packed(self) -> tuple[list[dict[str, Any]], Floats, NDArray[np.int64]]:
        """What each is, then of all in a row: vertices (V, 6) and corners (3·T,)."""
        told: list[dict[str, Any]] = []
        corners, vertices = [np.zeros(0, np.int64)], [np.zeros((0, 6))]
        welded = first = 0
        for soup in self._soups:
            tint = [round(float(share), 3) for share in soup[2][0]]
            told.append({"tint": tint, "first": first, "corners": len(soup[0])})
            one, inverse = np.unique(np.hstack(soup[:2]), axis=0, return_inverse=True)
            vertices.append(one)
            corners.append(inverse.ravel() + welded)
            welded, first = welded + len(one), first + len(soup[0])
        return told, np.concatenate(vertices), np.concatenate(corners)


def air(scene: Scene) -> dict[str, Any]:
    """Camera, light and floor, as the window has them; lengths in m, colours as factors 0…1."""
    camera, distance = scene.camera, float(np.linalg.norm(np.subtract(scene.camera.eye, scene.camera.target)))
    light = {
        "toLamp": shadow.TO_LAMP,
        "across": shadow.ACROSS,
        "upwards": shadow.UP,
        "lamp": lighting.LAMP,
        "sky": lighting.SKY,
        "bounce": lighting.BOUNCE,
        "rim": lighting.RIM,
        "toRim": lighting.TO_RIM,
        "background": lighting.BACKGROUND,
        "through": lighting.THROUGH,
        "gleam": lighting.GLEAM,
        "shadowSide": draw_list.SHADOWED * distance,
        "texel": 2 * draw_list.SHADOWED * distance / shadow.SIDE,
        "off": shadow.OFF,
        "soft": shadow.SOFT,
        "target": camera.target,
        "reach": draw_list.REACH * distance,
        "lined": draw_list.LINED * distance,
        "spacing": draw_list.round_length(draw_list.SPACING * distance),
        "lineWidth": draw_list.WIDTH * distance,
        "line": draw_list.LINE,
    }
    return {
        "camera": {"eye": camera.eye, "target": camera.target, "fov": camera.fov, "wide": sides.WIDE},
        "light": {name: np.array(value, float).tolist() for name, value in light.items()},
        "gloss": draw_list.GLOSS,
        "sheen": scene.look.sheen,
        "read": draw_list.READ,
        "floor": draw_list.FLOOR,
        "ground": None if scene.ground is None else scene.ground.height,
    }


def _soup(body: Body) -> Soup:
    """Around its own middle, along its own axes."""
    if isinstance(body.collider, Sphere):
        ball = solids.unit_sphere()
        return draw_bodies.coloured(body.size[0] * ball, ball, draw_bodies.BALL)
    return draw_bodies.soup(body)


def _pose(body: Body, first_size: float) -> Floats:
    """A ball may have grown."""
    pose = np.eye(4)
    scale = body.size[0] / first_size if isinstance(body.collider, Sphere) else 1.0
    pose[:3, :3], pose[:3, 3] = scale * body.axes, body.center
    return pose
