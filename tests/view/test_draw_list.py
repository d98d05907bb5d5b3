"""The draw list: what is in it, in each view, and that it costs nothing to make again and again."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from taichi_cloth.interact.camera import OrbitCamera
from taichi_cloth.scene import load_scene
from taichi_cloth.simulation import Simulation
from taichi_cloth.view import solids
from taichi_cloth.view.draw_list import HELD, VIEWS, DrawList
from taichi_cloth.view.raster import Raster

pytestmark = pytest.mark.usefixtures("on_lists")

EYE = (3.0, 2.5, 6.0)


def used(field: object, mesh: object) -> np.ndarray:
    return field.to_numpy()[: mesh.corners]


@pytest.mark.parametrize("name", ["curtain", "drape15", "table"])
@pytest.mark.parametrize("view", VIEWS)
def test_every_scene_and_view_is_drawn_whole(name: str, view: str) -> None:
    with Simulation(load_scene(name)) as simulation:
        draw_list = DrawList(simulation)
        simulation.place(simulation.positions() * [1.1, 0.9, 1.1])  # a frame would be compiled
        mesh = draw_list.update(view, EYE)
        assert 0 < mesh.cloth_from < mesh.corners <= mesh.position.shape[0]
        assert mesh.corners % 3 == 0
        assert mesh.cloth_from % 3 == 0
        position, normal, colour = (used(f, mesh) for f in (mesh.position, mesh.normal, mesh.colour))
        assert np.isfinite(position).all()
        assert np.linalg.norm(normal, axis=1) == pytest.approx(1, abs=1e-3)
        assert colour.min() >= 0
        draw_list.close()


def test_the_cloth_is_drawn_where_it_is() -> None:
    with Simulation(load_scene("curtain")) as simulation:
        draw_list = DrawList(simulation)
        mesh = draw_list.update("shaded", EYE)
        corners = used(mesh.position, mesh)[mesh.cloth_from :].reshape(-1, 3, 3)
        assert corners == pytest.approx(simulation.positions()[simulation.topology.triangles], abs=1e-6)
        draw_list.close()


def floor_under(mesh: object, x: float, z: float) -> float:
    """Brightness of the floor's corner nearest to a place."""
    place, colour = mesh.position.to_numpy()[: mesh.solids_from], mesh.colour.to_numpy()[: mesh.solids_from]
    return float(colour[np.hypot(place[:, 0] - x, place[:, 2] - z).argmin()].mean())


def test_the_cloth_throws_its_shadow_away_from_the_lamp() -> None:
    """The lamp is at the left, above and in front: in falling by 0.72 m, light goes 0.46 m right and 0.52 m back."""
    with Simulation(load_scene("curtain")) as simulation:
        draw_list = DrawList(simulation)
        mesh = draw_list.update("shaded", EYE)
        height = simulation.scene.cloth.center[1]
        x, z = height * 0.46 / 0.72, -height * 0.52 / 0.72
        assert floor_under(mesh, x, z) < 0.8 * floor_under(mesh, -x, -z)
        draw_list.close()


def test_the_held_particle_is_marked() -> None:
    with Simulation(load_scene("curtain")) as simulation:
        draw_list = DrawList(simulation)
        simulation.grab(700, (0.3, 1.0, 0.5))
        simulation.advance_frame()
        mesh = draw_list.update("shaded", EYE)
        marker = np.isclose(used(mesh.albedo, mesh), HELD).all(axis=1)
        assert used(mesh.position, mesh)[marker].mean(axis=0) == pytest.approx([0.3, 1.0, 0.5], abs=0.02)
        draw_list.close()


def test_without_a_ground_there_is_no_floor() -> None:
    with Simulation(replace(load_scene("curtain"), ground=None)) as simulation:
        draw_list = DrawList(simulation)
        mesh = draw_list.update("shaded", EYE)
        assert used(mesh.position, mesh)[:, 1].min() > 0.4
        draw_list.close()


def test_two_hundred_scene_switches_do_not_grow(tmp_path: object) -> None:
    scenes = [load_scene(name) for name in ("curtain", "drape15", "table")]
    fields = set()
    for k in range(200):
        with Simulation(scenes[k % 3]) as simulation:
            draw_list = DrawList(simulation)
            fields.add(id(draw_list.update(VIEWS[k % 4], EYE)))
            draw_list.close()
    assert len(fields) <= 3


def test_solids_are_closed_and_face_outwards() -> None:
    sphere = solids.unit_sphere()
    for corners, volume in (
        (sphere, 4 / 3 * np.pi),
        (solids.cylinder(np.zeros(3), np.array([0.0, 0.0, 2.0]), 0.5)[0], 2 * np.pi * 0.25),
        (solids.box(np.ones(3), np.array([1.0, 2.0, 3.0]))[0], 6.0),
    ):
        a, b, c = corners.reshape(-1, 3, 3).transpose(1, 0, 2)
        assert np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6 == pytest.approx(volume, rel=0.02)


@pytest.mark.parametrize("axis", range(3))
def test_normals_of_a_box_point_away_from_its_middle(axis: int) -> None:
    corners, normals = solids.box(np.zeros(3), np.ones(3))
    assert (np.einsum("ij,ij->i", corners, normals) == 0.5).all()
    assert np.abs(normals[:, axis]).sum() == 12


GOLDEN = Path(__file__).with_name("golden_curtain.png")


def test_the_picture_of_the_curtain_is_the_golden_one() -> None:
    """A change of look shows here; `GOLDEN` is then drawn anew, looked at and committed."""
    scene = load_scene("curtain")
    camera = OrbitCamera.from_scene(scene.camera)
    with Simulation(scene) as simulation:
        draw_list = DrawList(simulation)
        for _ in range(40):  # before the ball folds the cloth: folds magnify the last bit, and processors differ in it
            simulation.advance_frame()
        mesh = draw_list.update("shaded", camera.eye)
        picture = Raster(320, 180).draw(mesh, camera.view_projection(320 / 180))
        draw_list.close()
    with Image.open(GOLDEN) as golden:
        difference = np.abs(picture.astype(int) - np.asarray(golden))
    assert difference.mean() < 0.5
    assert (difference.max(axis=2) > 16).mean() < 0.01
