"""The command `export`, run as from a shell."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from pxr import Usd, UsdGeom

import taichi_cloth as tc
from taichi_cloth.__main__ import main
from taichi_cloth.export.clip import export
from taichi_cloth.export.output import Output
from taichi_cloth.geometry.scene_loader import load_scene
from taichi_cloth.simulation.rollback import DivergenceGuard
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.system.errors import Diverged, UsageError, install_command

SCENE = """
[cloth]
rows = 6
columns = 7
[wind]
z = 5.0
[[spheres]]
oscillation = [1.0, 0.0, 0.0]
"""
pytestmark = pytest.mark.usefixtures("running")
CLIPS = ("o.pc2", "o.usdc", "o.usda", "o.glb", "o.html", "o")  # a folder of OBJ files last


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Give every test its own working folder, with a small scene."""
    monkeypatch.chdir(tmp_path)
    Path("small.toml").write_text(SCENE)
    return tmp_path


def run(command: str, *more: str) -> int:
    return main([command, "small.toml", "--layout", "serial", *more])


def states(frames: int) -> list[np.ndarray]:
    """Return the positions before the first frame and after each frame."""
    with Simulation(load_scene("small.toml"), "serial") as simulation:
        found = [simulation.positions()]
        for _ in range(frames):
            simulation.step()
            found.append(simulation.positions())
    return found


def error_line(capsys: pytest.CaptureFixture[str], *words: str, code: int = 2) -> str:
    """Run a command that fails with this exit code, and return its one line on stderr."""
    capsys.readouterr()
    try:
        ended: int | str | None = main(words)
    except SystemExit as error:
        ended = error.code
    err = capsys.readouterr().err
    assert ended == code, err
    assert err.count("\n") == 1
    return err


def written_files() -> list[str]:
    return sorted(str(path) for path in Path().rglob("*") if path.is_file() and path.name != "small.toml")


def vertices(path: str) -> np.ndarray:
    mesh = trimesh.load(path, process=False, maintain_order=True)
    assert isinstance(mesh, trimesh.Trimesh)
    return np.asarray(mesh.vertices)


def face_count(path: str) -> int:
    mesh = trimesh.load(path, process=False)
    assert isinstance(mesh, trimesh.Trimesh)
    return len(mesh.faces)


# -- output files -------------------------------------------------------------------------------------------


def test_export_writes_the_cloth_after_n_frames(capsys: pytest.CaptureFixture[str]) -> None:
    x = states(5)[5]
    for words in (
        ["--out", "new/c.obj"],
        ["--out", "c.ply"],
        ["--format", "obj"],
        ["--out", "z.ply", "--up-axis", "z"],
    ):
        assert run("export", "--frames", "5", *words) == 0
    assert written_files() == ["c.ply", "new/c.obj", "out/small.obj", "z.ply"]
    assert vertices("new/c.obj") == pytest.approx(x, rel=1e-6, abs=1e-9)
    assert Path("new/c.obj").read_bytes() == Path("out/small.obj").read_bytes()
    assert (vertices("c.ply") == x.astype(np.float32)).all()
    assert (vertices("z.ply") == np.stack([x[:, 0], -x[:, 2], x[:, 1]], axis=1).astype(np.float32)).all()
    assert capsys.readouterr().out.splitlines()[-1] == "z.ply: after 5 frames, 42 particles, 60 triangles, z up"


@pytest.mark.parametrize("first", [0, 4])
def test_a_clip_has_a_sample_every_k_frames(first: int) -> None:
    clip = states(first + 7)[first : first + 7 : 3]
    for out in ([], ["--out", "o"], ["--out", "o.usdc"], ["--out", "q.html"]):
        assert run("export", "--frames", f"{first}:{first + 7}", "--every", "3", *out) == 0
    numbered = [f"o/frame_0000{k}.obj" for k in range(3)]
    assert written_files() == ["o.usdc", *numbered, "out/small.obj", "out/small.pc2", "q.html"]
    cache = np.frombuffer(Path("out/small.pc2").read_bytes(), "<f4", offset=32).reshape(3, -1, 3)
    assert (cache == np.array(clip, np.float32)).all()
    assert vertices("out/small.obj") == pytest.approx(clip[0], rel=1e-6, abs=1e-9)
    assert b"vn " not in Path("out/small.obj").read_bytes()
    stage = Usd.Stage.Open("o.usdc")
    assert (stage.GetEndTimeCode(), stage.GetFramesPerSecond()) == (2, 20)
    points = UsdGeom.Mesh(stage.GetPrimAtPath("/small/cloth")).GetPointsAttr()
    sphere = UsdGeom.Xformable(stage.GetPrimAtPath("/small/colliders/sphere_0"))
    centers = [sphere.GetLocalTransformation(k).ExtractTranslation()[0] for k in range(3)]
    assert centers[0] < centers[1] < centers[2]
    for k, x in enumerate(clip):
        assert vertices(numbered[k]) == pytest.approx(x, rel=1e-6, abs=1e-9)
        assert (np.array(points.Get(k)) == x.astype(np.float32)).all()


def test_torn_triangles_are_omitted_except_in_animated_meshes() -> None:
    Path("o").mkdir()
    with Simulation(load_scene("tear", rows=8, columns=8, area_density=9.0), "serial") as simulation:
        for path, format in (("o", "obj"), ("c.obj", "obj"), ("d.pc2", "pc2"), ("e.usda", "usd"), ("f.glb", "glb")):
            simulation.reset()
            export(simulation, Output(Path(path), format, 40, clip=path != "c.obj"), lambda k: None)
        remaining = simulation.topology.triangle_count
    paths = ("c.obj", "o/frame_00000.obj", "o/frame_00039.obj", "d.obj")
    end, first, last, animated = (face_count(path) for path in paths)
    assert end == remaining <= last < first == animated == 98
    stage = Usd.Stage.Open("e.usda")
    assert len(UsdGeom.Mesh(stage.GetPrimAtPath("/tear/cloth")).GetFaceVertexCountsAttr().Get()) == 98
    assert len(trimesh.load("f.glb", force="scene").geometry["cloth"].faces) == 98


def test_one_frame_is_exported_from_python(monkeypatch: pytest.MonkeyPatch) -> None:
    with Simulation(load_scene("small.toml"), "serial") as simulation:
        x = simulation.positions()
        for name in ("a.obj", "b.ply", "c.usda", "d.glb"):
            tc.export_mesh(simulation, name)
        tc.export_mesh(simulation, "z.obj", up="z")
        for name, up, message in (
            ("e.glb", "z", "the up axis z does not apply to glTF files, in which y is up"),
            ("e.obj", "x", "unknown up axis 'x': use y or z"),
            ("e.stl", "y", "unknown suffix"),
        ):
            with pytest.raises(UsageError, match=message):
                tc.export_mesh(simulation, name, up)
        monkeypatch.setitem(sys.modules, "pxr", None)
        with pytest.raises(UsageError, match="USD files need usd-core"):
            tc.export_mesh(simulation, "e.usda")
    assert written_files() == ["a.obj", "b.ply", "c.usda", "d.glb", "z.obj"]
    assert vertices("a.obj") == pytest.approx(x, rel=1e-6, abs=1e-9)
    assert vertices("z.obj") == pytest.approx(np.stack([x[:, 0], -x[:, 2], x[:, 1]], axis=1), rel=1e-6, abs=1e-9)
    cloth = trimesh.load("d.glb", force="scene").geometry["cloth"]
    assert np.ptp(cloth.vertices, axis=0) == pytest.approx(np.ptp(x, axis=0), abs=1e-6)


# -- refused options -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["export", "small.toml", "--html", "c.html"], "--html was renamed to --out FILE.html"),
        (["export", "small.toml", "--clip"], "--clip was renamed to --frames A:B"),
        (["bake", "small.toml"], "bake was renamed to export --frames A:B"),
        (["export", "small.toml", "--format", "obk"], "did you mean 'obj'?"),
        (["export", "small.toml", "--frames", "0-10"], "'0-10' is neither a number of frames nor a range A:B"),
        (["export", "small.toml", "--out", "c.stl"], "unknown suffix '.stl'"),
        (["export", "small.toml", "--out", "c.pc2"], "use --frames A:B"),
        (["export", "small.toml", "--out", "c.html"], "an HTML page plays a clip, not one frame: use --frames A:B"),
        (
            ["export", "small.toml", "--frames", "0:9", "--out", "c.html", "--up-axis", "z"],
            "the up axis z does not apply to HTML pages",
        ),
        (["export", "small.toml", "--out", "c.glb", "--up-axis", "z"], "the up axis z does not apply to glTF files"),
        (["export", "small.toml", "--every", "2"], "applies to clips only: use --frames 0:240"),
        (["export", "small.toml", "--up-axis", "x"], "invalid choice"),
        (["export", "small.toml", "--frames", "0:9", "--out", "c.obj"], "is a folder"),
        (["export", "small.toml", "--frames", "0"], "not an integer"),
        (["export", "small.toml", "--frames", "0:0"], "'0:0' is not a range A:B of frames"),
        (["export", "small.toml", "--frames", "0:x"], "'0:x' is not a range A:B of frames"),
        (["export", "small.toml", "--frames", "5:5"], "'5:5' is not a range A:B of frames with 0 <= A < B"),
        (["export", "small.toml", "--frames=-1:5"], "is not a range"),
        (["export", "small.toml", "--frames", "5:0"], "'5:0' is not a range A:B of frames with 0 <= A < B"),
        (["export", "small.toml", "--layout", "lane"], "unknown layout 'lane'"),
        (["export", "smal.toml"], "smal.toml"),
    ],
)
def test_an_invalid_command_is_one_line_and_writes_nothing(
    capsys: pytest.CaptureFixture[str], words: list[str], message: str
) -> None:
    assert message in error_line(capsys, *words)
    assert list(Path().iterdir()) == [Path("small.toml")]


def test_usd_without_its_extra_is_one_line(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pxr", None)
    line = error_line(capsys, "export", "small.toml", "--out", "c.usdc")
    assert line == f"taichi-cloth: USD files need usd-core: {install_command('usd')}\n"


def test_existing_files_are_overwritten_only_with_force(capsys: pytest.CaptureFixture[str]) -> None:
    small = ["export", "small.toml", "--layout", "serial", "--frames"]
    assert run("export", "--frames", "0:3", "--out", "o") == 0
    for name in ("c.obj", "c.usda", "d.obj"):
        Path(name).write_text("original")
    Path("c.usdc").mkdir()
    for words in (
        ["2", "--out", "c.obj"],
        ["2", "--out", "c.usda"],
        ["0:2", "--out", "d.pc2"],  # the mesh that it animates
        ["0:2", "--out", "o"],
    ):
        assert "use --force" in error_line(capsys, *small, *words)
    assert "is a folder" in error_line(capsys, *small, "0:2", "--out", "c.usdc", "--force")
    assert "is not a folder" in error_line(capsys, *small, "2", "--out", "c.obj/d.obj")
    assert "is a file" in error_line(capsys, *small, "0:2", "--format", "ply", "--out", "small.toml")
    assert [Path(name).read_text() for name in ("c.obj", "c.usda", "d.obj")] == ["original"] * 3
    assert len(written_files()) == 6
    for words in (["2", "--out", "c.obj"], ["0:2", "--out", "d.pc2"], ["0:2", "--out", "o"]):
        assert main([*small, *words, "--force"]) == 0
    assert written_files() == ["c.obj", "c.usda", "d.obj", "d.pc2", "o/frame_00000.obj", "o/frame_00001.obj"]
    assert vertices("d.obj").shape == (42, 3)


# -- runs that end early -------------------------------------------------------------------------------------------


def numbered_files(clip: str, samples: int) -> list[str]:
    return [f"o/frame_{k:05d}.obj" for k in range(samples)] if clip == "o" else []


@pytest.mark.parametrize("clip", CLIPS)
def test_an_interrupted_clip_leaves_no_partial_file_and_keeps_the_older_one(
    clip: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = ["o.glb", "o.html", "o.obj", "o.pc2", "o.usda", "o.usdc"]
    for name in before:
        Path(name).write_text("older")

    def check_and_snapshot(guard: DivergenceGuard) -> bool:
        if guard._simulation.frame == 4:
            raise KeyboardInterrupt
        return True

    monkeypatch.setattr(DivergenceGuard, "check_and_snapshot", check_and_snapshot)
    assert run("export", "--frames", "0:100", "--out", clip, "--force") == 130
    assert written_files() == sorted([*before, *numbered_files(clip, 4)])
    assert {Path(name).read_text() for name in before} == {"older"}


@pytest.mark.parametrize("clip", CLIPS)
def test_divergence_is_reported_and_finished_files_remain(
    clip: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    real = DivergenceGuard.check_and_snapshot

    def check_and_snapshot(guard: DivergenceGuard) -> bool:
        if guard._simulation.frame == 3:
            guard._simulation.cloth.x[5] = (np.nan, 0.0, 0.0)
        return real(guard)

    monkeypatch.setattr(DivergenceGuard, "check_and_snapshot", check_and_snapshot)
    words = ["export", "small.toml", "--layout", "serial", "--frames", "0:9", "--out", clip]
    assert "the cloth blew up in frame 3: try 10 substeps" in error_line(capsys, *words, code=1)
    assert written_files() == numbered_files(clip, 3)


def test_a_diverged_cloth_is_not_exported() -> None:
    with Simulation(load_scene("small.toml"), "serial") as simulation:

        def diverge(frame: int) -> None:
            simulation.cloth.x[5] = (0.0, np.inf, 0.0)

        with pytest.raises(Diverged):
            export(simulation, Output(Path("c.obj"), "obj", 4), diverge)
    assert written_files() == []


# -- imports ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("words", ["'--help'", "'export', '--help'"])
def test_help_imports_no_large_package(words: str) -> None:
    code = f"import sys; from taichi_cloth.__main__ import main\ntry: main([{words}])\n"
    code += "finally: assert not {'taichi', 'numpy', 'pxr', 'trimesh'} & set(sys.modules), sys.modules"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "taichi-cloth" in done.stdout


def test_usd_is_imported_for_usd_files_only() -> None:
    code = "import sys, taichi_cloth.export.clip; sys.exit('pxr' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], stdout=subprocess.DEVNULL).returncode == 0
