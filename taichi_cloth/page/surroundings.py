"""What is around the cloth in a page: colliders and pole as solids, and light, air and floor as the window has them."""

from __future__ import annotations

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
    """All that is drawn of a scene but the cloth and the floor, and where it is at each sample."""

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        bodies = simulation.bodies()
        self._drawn = [k for k, body in enumerate(bodies) if not isinstance(body.collider, Ground)]
        self._soups = [_soup(bodies[k]) for k in self._drawn]
        self._poses: list[list[Floats]] = [[] for _ in self._drawn]
        if simulation.scene.look.pole:
            self._soups.append(draw_bodies.pole(simulation.scene, simulation.topology.start))
            self._poses.append([np.eye(4)])

    def add(self) -> None:
        """Takes where they are now; those that never move are told once."""
        bodies = self._simulation.bodies()
        for k, poses in zip(self._drawn, self._poses, strict=False):  # the pole comes behind
            if not poses or not is_still(bodies[k].collider):
                poses.append(_pose(bodies[k]))

    def packed(self) -> tuple[list[dict[str, Any]], Floats, Floats, NDArray[np.int64]]:
        """What each is, then of all in a row: vertices (V, 6), poses (M, 4, 4) by columns, corners (3·T,)."""
        told: list[dict[str, Any]] = []
        poses, corners, vertices = [np.zeros((0, 4, 4))], [np.zeros(0, np.int64)], [np.zeros((0, 6))]
        placed = welded = first = 0
        for soup, of_one in zip(self._soups, self._poses, strict=True):
            tint = [round(float(share), 3) for share in soup[2][0]]
            told.append({"tint": tint, "first": first, "corners": len(soup[0]), "pose": placed, "poses": len(of_one)})
            one, inverse = np.unique(np.hstack(soup[:2]), axis=0, return_inverse=True)
            vertices.append(one)
            corners.append(inverse.ravel() + welded)
            poses.append(np.swapaxes(of_one, 1, 2))
            placed, welded, first = placed + len(of_one), welded + len(one), first + len(soup[0])
        return told, np.concatenate(vertices), np.concatenate(poses), np.concatenate(corners)


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


def _pose(body: Body) -> Floats:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = body.axes, body.center
    return pose
