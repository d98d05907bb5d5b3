"""A callback of `step_by_substep` that reads all there is to read changes no bit."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh

from taichi_cloth.scene.collider_schema import Mesh
from taichi_cloth.scene.fabric_schema import Fabric
from taichi_cloth.scene.schema import Cloth, Scene, Solver
from taichi_cloth.simulation.simulation import Simulation

pytestmark = pytest.mark.usefixtures("serial_layout")

BALL = trimesh.creation.icosphere(subdivisions=1, radius=0.2)


def test_metrics_within_a_frame_leave_the_surfaces_of_the_frame(tmp_path: Path) -> None:
    """A ball grows under a sheet."""
    BALL.export(tmp_path / "body.obj")
    samples = np.array(BALL.vertices) * np.linspace(1.0, 1.5, 31)[:, None, None]
    header = struct.pack("<12siiffi", b"POINTCACHE2\0", 1, samples.shape[1], 0.0, 1.0, len(samples))
    (tmp_path / "body.pc2").write_bytes(header + samples.astype("<f4").tobytes())
    ball = Mesh(
        file="./body.obj",
        folder=str(tmp_path),
        center=(0.0, 0.0, 0.0),
        margin=0.01,
        clip="body.pc2",
        clip_rate=60.0,
        clip_loop=False,
    )
    scene = Scene(
        cloth=Cloth(rows=7, columns=7, width=0.4, height=0.4, center=(0.0, 0.22, 0.0), rotation=(-90, 0, 0), pins=()),
        fabric=Fabric(warp=30.0, weft=30.0, shear=10.0, bend_spring=0.3),
        meshes=(ball,),
        solver=Solver("xpbd", 6, 4),
    )
    with Simulation(scene) as whole, Simulation(scene) as parts:
        found = []
        for _ in range(12):
            whole.step()
            parts.step_by_substep(lambda _: found.append(parts.metrics()))
            np.testing.assert_array_equal(whole.positions(), parts.positions())
        assert len(found) == 72
        assert whole.metrics() == parts.metrics()
