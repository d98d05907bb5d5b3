"""The commands `export` and `bake` as a user meets them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from pxr import Usd, UsdGeom

from taichi_cloth import cli
from taichi_cloth.errors import BlewUp
from taichi_cloth.export.clip import export
from taichi_cloth.export.output import Output
from taichi_cloth.guard import Guard
from taichi_cloth.scene import load_scene
from taichi_cloth.simulation import Simulation

SCENE = """
[cloth]
rows = 6
columns = 7
[wind]
z = 5.0
[[spheres]]
sway = [1.0, 0.0, 0.0]
"""
pytestmark = pytest.mark.usefixtures("running")
CLIPS = ("o.pc2", "o.usdc", "o.usda", "o.html", "o")  # a folder of OBJ files last


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Every test has a folder of its own, with a small scene in it."""
    monkeypatch.chdir(tmp_path)
    Path("small.toml").write_text(SCENE)
    return tmp_path


def run(command: str, *more: str) -> int:
    return cli.main([command, "small.toml", "--path", "list", *more])


def states(frames: int) -> list[np.ndarray]:
    """Where the cloth is before the first frame and after each."""
    with Simulation(load_scene("small.toml"), "list") as simulation:
        found = [simulation.positions()]
        for _ in range(frames):
            simulation.advance_frame()
            found.append(simulation.positions())
    return found


def mistake(capsys: pytest.CaptureFixture[str], *words: str, code: int = 2) -> str:
    """The one line that a command ends with."""
    capsys.readouterr()
    try:
        ended = cli.main(words)
    except SystemExit as error:
        ended = error.code
    err = capsys.readouterr().err
    assert ended == code, err
    assert err.count("\n") == 1
    return err


def made() -> list[str]:
    return sorted(str(path) for path in Path().rglob("*") if path.is_file() and path.name != "small.toml")


def vertices(path: str) -> np.ndarray:
    return np.asarray(trimesh.load(path, process=False, maintain_order=True).vertices)


# -- what is written -------------------------------------------------------------------------------------------


def test_export_writes_the_cloth_after_so_many_frames(capsys: pytest.CaptureFixture[str]) -> None:
    x = states(5)[5]
    for words in (["--out", "new/c.obj"], ["--out", "c.ply"], ["--format", "obj"], ["--out", "z.ply", "--up", "z"]):
        assert run("export", "--frames", "5", *words) == 0
    assert made() == ["c.ply", "new/c.obj", "out/small.obj", "z.ply"]
    assert vertices("new/c.obj") == pytest.approx(x, rel=1e-6, abs=1e-9)
    assert Path("new/c.obj").read_bytes() == Path("out/small.obj").read_bytes()
    assert (vertices("c.ply") == x.astype(np.float32)).all()
    assert (vertices("z.ply") == np.stack([x[:, 0], -x[:, 2], x[:, 1]], axis=1).astype(np.float32)).all()
    assert capsys.readouterr().out.splitlines()[-1] == "z.ply: after 5 frames, 42 particles, 60 triangles, z up"


def test_bake_writes_the_moments_that_a_render_shows() -> None:
    clip = states(7)[0:7:3]
    assert run("bake", "--frames", "7", "--every", "3") == 0
    assert run("bake", "--frames", "7", "--every", "3", "--out", "o") == 0
    assert run("export", "--clip", "--frames", "7", "--every", "3", "--out", "o.usdc") == 0
    assert run("export", "--frames", "7", "--every", "3", "--html", "p.html") == 0
    assert run("bake", "--frames", "7", "--every", "3", "--out", "q.html") == 0
    assert Path("p.html").read_bytes() == Path("q.html").read_bytes()
    numbered = [f"o/frame_0000{k}.obj" for k in range(3)]
    assert made() == ["o.usdc", *numbered, "out/small.obj", "out/small.pc2", "p.html", "q.html"]
    cache = np.frombuffer(Path("out/small.pc2").read_bytes(), "<f4", offset=32).reshape(3, -1, 3)
    assert (cache == np.array(clip, np.float32)).all()
    assert vertices("out/small.obj") == pytest.approx(clip[0], rel=1e-6, abs=1e-9)
    assert b"vn " not in Path("out/small.obj").read_bytes()
    stage = Usd.Stage.Open("o.usdc")
    assert (stage.GetEndTimeCode(), stage.GetFramesPerSecond()) == (2, 20)
    points = UsdGeom.Mesh(stage.GetPrimAtPath("/small/cloth")).GetPointsAttr()
    ball = UsdGeom.Xformable(stage.GetPrimAtPath("/small/colliders/sphere_0"))
    places = [ball.GetLocalTransformation(k).ExtractTranslation()[0] for k in range(3)]
    assert places[0] < places[1] < places[2]
    for k, x in enumerate(clip):
        assert vertices(numbered[k]) == pytest.approx(x, rel=1e-6, abs=1e-9)
        assert (np.array(points.Get(k)) == x.astype(np.float32)).all()


def test_what_a_tear_took_is_missing_but_for_files_of_points_that_move() -> None:
    Path("o").mkdir()
    with Simulation(load_scene("tear", rows=8, columns=8, area_density=9.0), "list") as simulation:
        for path, format in (("o", "obj"), ("c.obj", "obj"), ("d.pc2", "pc2"), ("e.usda", "usd")):
            simulation.reset()
            export(simulation, Output(Path(path), format, 40, clip=path != "c.obj"), lambda k: None)
        left = simulation.topology.triangle_count
    paths = ("c.obj", "o/frame_00000.obj", "o/frame_00039.obj", "d.obj")
    end, first, last, moved = (len(trimesh.load(path, process=False).faces) for path in paths)
    assert end == left <= last < first == moved == 98
    stage = Usd.Stage.Open("e.usda")
    assert len(UsdGeom.Mesh(stage.GetPrimAtPath("/tear/cloth")).GetFaceVertexCountsAttr().Get()) == 98


# -- what is refused -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["export", "small.toml", "--html", "c.html", "--out", "d.html"], "--html says both"),
        (["export", "small.toml", "--html", "c.html", "--format", "obj"], "--html says both"),
        (["export", "small.toml", "--format", "obk"], "did you mean 'obj'?"),
        (["export", "small.toml", "--out", "c.stl"], "no format has the suffix '.stl'"),
        (["export", "small.toml", "--out", "c.pc2"], "use `bake`"),
        (["export", "small.toml", "--out", "c.html"], "an HTML page plays a clip: use `bake`"),
        (["bake", "small.toml", "--out", "c.html", "--up", "z"], "stands upright by itself"),
        (["export", "small.toml", "--every", "2"], "it goes with --clip"),
        (["export", "small.toml", "--up", "x"], "invalid choice"),
        (["bake", "small.toml", "--out", "c.obj"], "is a folder"),
        (["bake", "small.toml", "--frames", "0"], "whole number"),
        (["bake", "small.toml", "--path", "lane"], "no path 'lane'"),
        (["bake", "smal.toml"], "smal.toml"),
    ],
)
def test_a_mistake_is_one_line_and_makes_nothing(
    capsys: pytest.CaptureFixture[str], words: list[str], said: str
) -> None:
    assert said in mistake(capsys, *words)
    assert list(Path().iterdir()) == [Path("small.toml")]


def test_usd_without_its_extra_is_one_line(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pxr", None)
    said = mistake(capsys, "bake", "small.toml", "--out", "c.usdc")
    assert said == "taichi-cloth: USD files need usd-core: pip install 'taichi-cloth[usd]'\n"


def test_what_is_there_is_replaced_by_force_only(capsys: pytest.CaptureFixture[str]) -> None:
    small = ["--path", "list", "--frames", "2"]
    assert run("bake", "--frames", "3", "--out", "o") == 0
    for name in ("c.obj", "c.usda", "d.obj"):
        Path(name).write_text("mine")
    Path("c.usdc").mkdir()
    for words in (
        ["export", "small.toml", "--out", "c.obj"],
        ["export", "small.toml", "--out", "c.usda"],
        ["bake", "small.toml", "--out", "d.pc2"],  # its mesh
        ["bake", "small.toml", "--out", "o"],
    ):
        assert "already: use --force" in mistake(capsys, *words, *small)
    assert "is a folder" in mistake(capsys, "bake", "small.toml", "--out", "c.usdc", "--force", *small)
    assert "is no folder" in mistake(capsys, "export", "small.toml", "--out", "c.obj/d.obj", *small)
    assert "is a file" in mistake(capsys, "bake", "small.toml", "--format", "ply", "--out", "small.toml", *small)
    assert [Path(name).read_text() for name in ("c.obj", "c.usda", "d.obj")] == ["mine"] * 3
    assert len(made()) == 6
    for words in (["export", "--out", "c.obj"], ["bake", "--out", "d.pc2"], ["bake", "--out", "o"]):
        assert run(*words, "--frames", "2", "--force") == 0
    assert made() == ["c.obj", "c.usda", "d.obj", "d.pc2", "o/frame_00000.obj", "o/frame_00001.obj"]
    assert vertices("d.obj").shape == (42, 3)


# -- what ends early -------------------------------------------------------------------------------------------


def kept(clip: str, samples: int) -> list[str]:
    return [f"o/frame_{k:05d}.obj" for k in range(samples)] if clip == "o" else []


@pytest.mark.parametrize("clip", CLIPS)
def test_an_interrupted_clip_leaves_no_half_file_and_the_older_one(clip: str, monkeypatch: pytest.MonkeyPatch) -> None:
    before = ["o.html", "o.obj", "o.pc2", "o.usda", "o.usdc"]
    for name in before:
        Path(name).write_text("older")

    def sound(guard: Guard) -> bool:
        if guard._simulation.frame == 4:
            raise KeyboardInterrupt
        return True

    monkeypatch.setattr(Guard, "sound", sound)
    assert run("bake", "--frames", "100", "--out", clip, "--force") == 130
    assert made() == sorted([*before, *kept(clip, 4)])
    assert {Path(name).read_text() for name in before} == {"older"}


@pytest.mark.parametrize("clip", CLIPS)
def test_a_cloth_that_blows_up_is_told_and_finished_files_stay(
    clip: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    real = Guard.sound

    def sound(guard: Guard) -> bool:
        if guard._simulation.frame == 3:
            guard._simulation.cloth.x[5] = (np.nan, 0.0, 0.0)
        return real(guard)

    monkeypatch.setattr(Guard, "sound", sound)
    words = ["bake", "small.toml", "--path", "list", "--frames", "9", "--out", clip]
    assert "the cloth blew up in frame 3: try 10 substeps" in mistake(capsys, *words, code=1)
    assert made() == kept(clip, 3)


def test_a_blown_up_cloth_is_not_exported() -> None:
    with Simulation(load_scene("small.toml"), "list") as simulation:

        def spoil(frame: int) -> None:
            simulation.cloth.x[5] = (0.0, np.inf, 0.0)

        with pytest.raises(BlewUp):
            export(simulation, Output(Path("c.obj"), "obj", 4), spoil)
    assert made() == []


# -- what is imported ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("words", ["'--help'", "'bake', '--help'", "'export', '--help'"])
def test_help_imports_nothing_heavy(words: str) -> None:
    code = f"import sys; from taichi_cloth.cli import main\ntry: main([{words}])\n"
    code += "finally: assert not {'taichi', 'numpy', 'pxr', 'trimesh'} & set(sys.modules), sys.modules"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "taichi-cloth" in done.stdout


def test_usd_is_imported_for_usd_files_only() -> None:
    code = "import sys, taichi_cloth.export.clip; sys.exit('pxr' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], stdout=subprocess.DEVNULL).returncode == 0
