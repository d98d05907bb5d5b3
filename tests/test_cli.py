"""The command line: processes, exit codes, and one line for every error."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from types import SimpleNamespace

import pytest
from PIL import Image

from taichi_cloth import __main__ as cli
from taichi_cloth import __version__
from taichi_cloth.cli import scenes
from taichi_cloth.cli.program import overrides
from taichi_cloth.cli.scenes import summary
from taichi_cloth.geometry import cloth_builder
from taichi_cloth.geometry.scene_loader import load_scene
from taichi_cloth.render import image
from taichi_cloth.scene.schema import SOLVER_NAMES, Cloth
from taichi_cloth.simulation import error_estimate
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.system.console import count_noun

SMALL = ["--size", "96x54"]


def run(
    *words: str, cwd: Path, preexec_fn: Callable[[], None] | None = None, variables: Mapping[str, str] | None = None
) -> subprocess.CompletedProcess[str]:
    """Run a command in its own process without a display. `variables`: added to the environment."""
    environment = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY")}
    environment |= variables or {}
    command = [sys.executable, "-m", "taichi_cloth", *words]
    return subprocess.run(
        command, cwd=cwd, env=environment, capture_output=True, text=True, timeout=300, preexec_fn=preexec_fn
    )


def error_of(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    """Return the line that an invalid command prints."""
    try:
        code: object = cli.main(words)
    except SystemExit as error:
        code = error.code
    out, err = capsys.readouterr()
    assert code == 2
    assert out == ""
    assert err.count("\n") == 1
    return err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["rendr"], "did you mean 'render'?"),
        (["render"], "SCENE"),
        (["render", "curtian"], "did you mean 'curtain'?"),
        (["render", "none.toml"], "none.toml: cannot be read: No such file"),
        (["render", "curtain", "--frames", "0"], "'0' is not an integer from 1"),
        (["render", "curtain", "--frames", "-3"], "not an integer"),
        (["render", "curtain", "--frames", "nan"], "not an integer"),
        (["render", "curtain", "--size", "960"], "'960' is not WxH"),
        (["render", "curtain", "--size", "0x5"], "WxH"),
        (["render", "curtain", "--size", "9000x5"], "WxH"),
        (["render", "curtain", "--view", "strian"], "did you mean 'strain'?"),
        (["render", "curtain", "--samples", "3"], "invalid choice: 3"),
        (["render", "curtain", "--force", "--resume"], "not allowed with"),
        (["render", "curtain", "--set", "wind_q=1"], "did you mean 'wind_z'?"),
        (["render", "curtain", "--set", "wind_z"], "KEY=VALUE"),
        (["render", "curtain", "--set", "rows=1"], "rows: 1 is out of range: 2 to 2048"),
        (["render", "curtain", "--solver", "varlet"], "did you mean 'verlet'?"),
        (["render", "curtain", "--without", "sphere"], "did you mean 'spheres'?"),
        (["render", "curtain", "--arch", "cudo"], "invalid choice: 'cudo'"),
        (["render", "curtain", "--layout", "lane"], "unknown layout 'lane': simd, serial, parallel"),
        (["render", "curtain", "--path", "simd"], "--path was renamed to --layout"),
        (["render", "curtain", "--quick"], "--quick"),
        (["check"], "FILE"),
        (["--sett", "x=1"], "--sett"),
    ],
)
def test_an_invalid_command_is_one_line_and_exit_code_2(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: list[str], message: str
) -> None:
    monkeypatch.chdir(tmp_path)
    assert message in error_of(capsys, *words)
    assert list(tmp_path.iterdir()) == []


def test_an_interrupted_command_says_that_its_files_are_complete(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(_: object) -> int:
        raise KeyboardInterrupt

    monkeypatch.setattr(scenes, "lines_of_preset", interrupted)
    assert cli.main(["list", "--presets"]) == 130
    assert capsys.readouterr().err == "taichi-cloth: interrupted; files that were written are complete\n"


def test_a_slow_frame_is_forecast(monkeypatch: pytest.MonkeyPatch) -> None:
    """Before it runs: it cannot be interrupted."""
    with Simulation(load_scene("curtain", rows=4, columns=5)) as simulation:
        assert " a frame" not in summary(simulation, "cpu")
        monkeypatch.setattr(error_estimate, "SAMPLE", 4)  # then 20 particles are many
        monkeypatch.setattr(error_estimate, "cost_of", lambda scene: SimpleNamespace(ms=1234567.0))
        assert summary(simulation, "cpu").splitlines()[-1] == "a frame takes about 1,235 s or more"


def test_several_keys_are_joined_by_commas() -> None:
    found = overrides(["rows=20,wind_x = 2", "wind={x=1, z=6},gravity=3"], "--set")
    assert found == {"rows": 20, "wind_x": 2, "wind": {"x": 1, "z": 6}, "gravity": 3}
    assert overrides(["spheres=[{radius=1,center=[0,1,2]}],rows=3"], "--set") == {
        "spheres": [{"radius": 1, "center": [0, 1, 2]}],
        "rows": 3,
    }
    for quote in "\"'":
        assert overrides([f"file={quote}a,b=c.obj{quote},scale=2"], "--set") == {"file": "a,b=c.obj", "scale": 2}


def test_list_prints_a_line_for_every_scene(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["list"]) == 0
    *lines, explanation = capsys.readouterr().out.splitlines()
    assert explanation.startswith("not converged: ")
    assert {"curtain", "drape15", "table"} <= {line.split()[0] for line in lines}
    assert all(len(line.split()) > 3 for line in lines)
    [drape, curtain] = (next(line for line in lines if line.startswith(name)) for name in ("drape15", "curtain"))
    assert drape.endswith(" · not converged")
    assert "not converged" not in curtain


def test_check(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text("[cloth]\nrows = 7\ncolumns = 9\n")
    assert cli.main(["check", str(path), "twist", "denim"]) == 0
    mine, twist, denim = capsys.readouterr().out.splitlines()
    assert mine.startswith(
        f"{path}: valid · 9×7 particles · 4.35×3.45 m · 300 springs · 9 pins · verlet 5×12 · about 0."
    )
    assert mine.endswith(" ms per frame of 16.7 ms")
    assert ", without self_collision, which may take longer than all else: --time measures a frame · " in twist
    assert " · 16,002 springs and 23,938 bending links · 2 pins · lines 5×1 · " in denim


@pytest.mark.parametrize(
    ("keys", "note"),
    [
        ("[cloth]\nwidth = 120\nheight = 90", "a side of more than 20 m: lengths are in meters"),
        ("[forces]\ngravity = -9.81", "gravity points up: forces.gravity is positive downward"),
        ("[[attachments]]\ncenter = [0, 2, 0]", "an attachment without pins moves nothing"),
        ("[cloth]\npins = []\n[tethers]", "tethers have no effect: they tie particles to pins, and the cloth has none"),
        ("[solver]\nname = 'rk4'\niterations = 5", "rk4 does not iterate: solver.iterations has no effect"),
        (
            "[maps]\nstiffness = 'map.csv'\nstiffness_max = 4",
            "verlet corrects at most the whole error: a stiffness over 1 of a map acts as 1",
        ),
        ("[cloth]\nwidth = 2\nheight = 20", ""),
    ],
)
def test_check_tells_values_that_are_often_mistakes(
    keys: str, note: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(f"{keys}\n")
    (tmp_path / "map.csv").write_text("\n".join(["0.5"] * (Cloth().rows * Cloth().columns)))
    assert cli.main(["check", str(path)]) == 0
    line = capsys.readouterr().out.rstrip()
    assert line.endswith(f" · {note}") if note else "meters" not in line


def test_check_tells_that_verlet_does_not_use_the_springs_of_a_fabric(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    file = tmp_path / "mine.toml"
    for text, told in (
        ("[fabric]\nwarp = 5\nshear = 1", "verlet uses [verlet], not fabric.warp, fabric.shear"),
        ("[fabric]\nbending_stiffness = 1e-2", "verlet uses [verlet], not fabric.bending_stiffness"),
        ("[fabric]\ncompression = 0\ndamping_time = 0.01", "not fabric.compression, fabric.damping_time"),
        ("[solver]\nname = 'lines'\n[verlet]\nbend = 0.5", "lines uses [fabric], not verlet.bend"),
        ("[fabric]\nwarp = 5\n[solver]\nname = 'xpbd'", ""),
        ("[fabric]\npreset = 'silk'", ""),
    ):
        file.write_text(text)
        assert cli.main(["check", str(file)]) == 0
        out = capsys.readouterr().out.strip()
        assert out.endswith(told) if told else "verlet uses" not in out


def test_check_prints_every_mistake_of_every_file_and_counts_them(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("a b.toml").write_text("[cloth]\nrow = 7\n[wnd]\n")
    Path("ü.toml").write_text("[wind]\nz = 'x'\n")
    assert cli.main(["check", "a b.toml", "curtain", "ü.toml", "curtian", "."]) == 2
    captured = capsys.readouterr()
    lines = captured.out.splitlines()
    assert lines[0] == "a b.toml: wnd: unknown key (did you mean 'wind'?)"
    assert lines[1] == "a b.toml: cloth.row: unknown key (did you mean 'rows'?)"
    assert lines[2].startswith(
        "curtain: valid · 30×24 particles · 4.35×3.45 m · 4,052 springs · 30 pins · verlet 5×12 · about "
    )
    assert lines[3] == "ü.toml: wind.z: must be a number, got 'x'"
    assert lines[4].endswith("(did you mean 'curtain'?)")
    assert lines[5] == ".: is a folder, not a scene file"
    assert captured.err == "taichi-cloth: 5 mistakes in 4 of 5 files\n"


def test_check_counts_the_edges_of_a_membrane(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["check", "bias"]) == 0
    assert " · 1,332 edges of a membrane and 3,890 bending links · " in capsys.readouterr().out
    assert cli.main(["check", "curtain", "--set", "model=membrane"]) == 0  # verlet does not read [fabric]
    assert " · 4,052 springs · " in capsys.readouterr().out


def test_check_counts_particles_that_start_inside_a_collider(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    sheet = "[cloth]\nrows = 9\ncolumns = 9\nwidth = 1.0\nheight = 1.0\ncenter = [0.0, 1.0, 0.0]\n"
    path = tmp_path / "ball.toml"
    for radius, inside in ((0.1, "1 particle"), (0.13, "5 particles")):
        path.write_text(f"{sheet}[[spheres]]\ncenter = [0.0, 1.0, 0.0]\nradius = {radius}")
        assert cli.main(["check", str(path)]) == 0
        assert capsys.readouterr().out.strip().endswith(f" · {inside} inside a collider at the start")
    path.write_text(f"{sheet}[[spheres]]\ncenter = [0.0, 1.0, 0.2]\nradius = 0.15")
    assert cli.main(["check", str(path)]) == 0
    assert "inside" not in capsys.readouterr().out


@pytest.mark.parametrize("command", [["render"], ["compare", "--b", "gravity=5"]])
def test_commands_that_run_a_scene_tell_that_cloth_starts_inside_a_collider(
    command: list[str], capsys: pytest.CaptureFixture[str], tmp_path: Path, running: None
) -> None:
    path = tmp_path / "ball.toml"
    path.write_text("[cloth]\nrows = 9\ncolumns = 9\n[[spheres]]\ncenter = [0.0, 1.0, 0.0]\nradius = 9.0")
    name, *options = command
    output = ["--frames", "1", "--size", "64x48", "--out", str(tmp_path / "out")]
    assert cli.main([name, str(path), *options, *output]) == 0
    assert "particles inside a collider at the start\n" in capsys.readouterr().out


HUGE = "[cloth]\nrows = 2000\ncolumns = 2000\n[solver]\n"


@pytest.mark.parametrize(
    ("text", "end"),
    [
        (
            HUGE + 'name = "implicit"',
            r"more than \d\d s per frame, \d,\d{3} times slower than real time · .* GB of memory",
        ),
        (
            HUGE + 'name = "explicit"',
            r"explicit 18\d\d · more than [\d,]+ s per frame, .* times slower than real time .*",
        ),
        ("[cloth]\nrows = 256\ncolumns = 256", r"about \d\d ms per frame, [\d.]+ times slower than real time · not .*"),
    ],
)
def test_check_tells_that_a_scene_cannot_run_in_real_time(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, end: str
) -> None:
    monkeypatch.setattr(cloth_builder, "memory_bytes", lambda: 16e9)
    path = tmp_path / "huge.toml"
    path.write_text(text)
    assert cli.main(["check", str(path)]) == 0
    assert re.fullmatch(f".*: valid · .*{end}", capsys.readouterr().out.strip())


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("[cloth]\nrows = 200\ncolumns = 300", "60,000 particles need about 0.108 GB of memory, more than the 0.1 GB"),
        (
            '[solver]\nname = "lines"\n[tearing]',
            "lines needs a grid with whole rows, and tearing breaks rows; use verlet",
        ),
        ('[cloth]\nrows = 900\n[fabric]\nwarp = 1e9\n[solver]\nname = "rk4"', "substeps a frame, more than 200,000"),
    ],
)
def test_check_refuses_what_run_refuses(
    capsys: pytest.CaptureFixture[str],
    running: None,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    text: str,
    reason: str,
) -> None:
    monkeypatch.setattr(cloth_builder, "memory_bytes", lambda: 100_000_000)
    path = tmp_path / "refused.toml"
    path.write_text(text)
    assert cli.main(["check", str(path)]) == 2
    captured = capsys.readouterr()
    assert captured.out.startswith(f"{path}: ")
    assert reason in captured.out
    assert captured.err == "taichi-cloth: 1 mistake\n"
    assert cli.main(["render", str(path), "--frames", "1", "--out", str(tmp_path / "o"), *SMALL]) == 2
    captured = capsys.readouterr()
    assert reason in captured.err
    assert captured.out == ""


def test_check_measures_frames(here: None, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["check", "drape15", "--time"]) == 0
    assert re.search(r" · [\d.]+ ms per frame of 16.7 ms \(measured\) · not converged", capsys.readouterr().out)


def test_frame_times_are_compared_with_real_time() -> None:
    assert [scenes.frame_time(ms) for ms in (0.0512, 9.96, 16.8, 33.3, 25_000)] == [
        "0.051 ms per frame of 16.7 ms",
        "10 ms per frame of 16.7 ms",
        "17 ms per frame of 16.7 ms",
        "33 ms per frame, 2.0 times slower than real time",
        "25 s per frame, 1,500 times slower than real time",
    ]


def test_check_takes_overrides_and_refuses_them_with_the_line_of_a_run(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["check", "drape15", "--set", "rows=20,columns=30", "--set", "solver=lines"]) == 0
    out, err = capsys.readouterr()
    assert out.startswith("drape15: valid · 30×20 particles · ")
    assert " · lines " in out
    assert err == ""
    for wrong, line in (
        ("substep=8", "drape15 (override): substep: unknown key (did you mean 'substeps'?)\n"),
        ("rows=1", "drape15 (override): cloth.rows: 1 is out of range: 2 to 2048\n"),
    ):
        assert cli.main(["check", "drape15", "--set", wrong]) == 2
        out, err = capsys.readouterr()
        assert (out, err) == (line, "taichi-cloth: 1 mistake\n")
        assert cli.main(["export", "drape15", "--set", wrong]) == 2
        assert capsys.readouterr().err == f"taichi-cloth: {line}"
    assert cli.main(["check", "drape15", "--set", "rows"]) == 2
    assert capsys.readouterr().err == "taichi-cloth: --set: rows: must be KEY=VALUE, as in wind.z=6\n"


def test_check_takes_the_variants_of_a_run(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["check", "curtain", "table", "--solver", "xpbd", "--without", "ground"]) == 0
    for line in capsys.readouterr().out.splitlines():
        assert " · xpbd " in line
        assert "ground" not in line
    assert cli.main(["check", "curtain", "--without", "wnd"]) == 2
    assert capsys.readouterr().out.endswith("(did you mean 'wind'?)\n")


def test_list_prints_a_line_for_every_solver(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["list", "--solvers"]) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == list(SOLVER_NAMES)


def test_a_solver_in_place_of_a_key_is_hinted_at(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["compare", "curtain", "--a", "verlet"]) == 2
    expected = "taichi-cloth: --a: verlet: must be KEY=VALUE (did you mean 'solver=verlet'?)\n"
    assert capsys.readouterr().err == expected


def test_schema(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["schema"]) == 0
    assert "area_density" in capsys.readouterr().out


def test_schema_of_a_section(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["schema", "spheres"]) == 0
    table = capsys.readouterr().out
    assert "radius" in table
    assert "area_density" not in table
    assert cli.main(["schema", "sphere"]) == 2
    assert capsys.readouterr().err == "taichi-cloth: unknown section 'sphere'; did you mean 'spheres'?\n"


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="0"):
        cli.main(["--version"])
    assert __version__ in capsys.readouterr().out


def test_every_command_has_an_example_and_its_defaults(capsys: pytest.CaptureFixture[str]) -> None:
    for command in ("run", "render", "export", "list", "check"):
        with pytest.raises(SystemExit, match="0"):
            cli.main([command, "--help"])
        assert "example: taichi-cloth" in capsys.readouterr().out
    with pytest.raises(SystemExit):
        cli.main(["render", "--help"])
    assert "(default: 240)" in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize("command", ["run", "compare", "render", "export", "replay", "bench", "stress", "validate"])
def test_help_lists_allowed_values_in_its_sentences_and_not_in_braces(
    command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit, match="0"):
        cli.main([command, "--help"])
    text = " ".join(capsys.readouterr().out.split())
    assert "{" not in text
    lists = {
        ("run", "compare", "render", "export", "replay"): "Taichi backend: cpu, cuda, vulkan, metal or gpu",
        ("compare", "render"): "view: shaded, strain, error, wireframe or particles (default: shaded)",
        ("bench", "validate"): "only this solver: verlet, xpbd, explicit, lines, rk4 or implicit",
        ("export",): "file format: obj, ply, pc2, usd, glb or html (default: by the suffix of --out)",
    }
    assert [line for commands, line in lists.items() if command in commands and line not in text] == []


def test_help_states_each_default_once_and_omits_empty_ones(capsys: pytest.CaptureFixture[str]) -> None:
    for command in ("run", "render", "replay", "export", "compare", "ablate", "bench", "validate", "stress"):
        with pytest.raises(SystemExit, match="0"):
            cli.main([command, "--help"])
        text = " ".join(capsys.readouterr().out.split())
        assert [word for word in ("None)", "False)", "[])", ") (default") if word in text] == [], command


def test_count_noun_uses_singular_and_plural() -> None:
    assert count_noun(1, "image") == "1 image"
    assert [count_noun(n, "frame") for n in (0, 2)] == ["0 frames", "2 frames"]


# -- existing output ----------------------------------------------------------------------------------------


def test_a_scene_with_several_mistakes_names_one_and_counts_the_others(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    for text, more in (("a = 1", ""), ("a = 1\nb = 2", "1 more mistake"), ("a = 1\nb = 2\nc = 3", "2 more mistakes")):
        file = tmp_path / "bad.toml"
        file.write_text(text, encoding="utf-8")
        assert cli.main(["run", str(file)]) == 2
        line = capsys.readouterr().err
        assert line.startswith(f"taichi-cloth: {file}: a: unknown key")
        assert line.endswith(
            f" ({more}; `taichi-cloth check` lists all)\n" if more else "self_collision, camera, look\n"
        )


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["--out", "o.png"], "--out names a folder of images, not a file: o.png; --video writes one file"),
        (["--target", "0,2,0"], "unknown option --target; use --set 'camera.target=[X,Y,Z]'"),  # not --target-error
        (["--iterations", "4"], "unknown option --iterations; use --set iterations=VALUE"),
        (["--wind-x", "4"], "unknown option --wind-x; use --set wind_x=VALUE"),
        (["--width", "30"], "unknown option --width; use --size WIDTHxHEIGHT"),
        (["--frame", "2"], "unknown option --frame; did you mean '--frames'?"),
    ],
)
def test_wrong_options_of_render_are_named(
    words: list[str], line: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    try:
        code = cli.main(["render", "drape15", *words])
    except SystemExit as end:
        code = int(end.code or 0)
    assert code == 2
    assert line in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


DRAPE = ["render", "drape15", "--out", "o", "--frames", "2", *SMALL]


@pytest.fixture
def here(running: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def refused(capsys: pytest.CaptureFixture[str], *more: str) -> str:
    """Return the error line of a render of `DRAPE` that is refused."""
    capsys.readouterr()
    assert cli.main([*DRAPE, *more]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    return err


def test_frames_are_not_overwritten_without_force(here: None, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(DRAPE) == 0
    last = Path("o/frame_00001.png")
    last.write_bytes(b"mine")
    assert "--force" in refused(capsys)
    assert last.read_bytes() == b"mine"
    assert cli.main([*DRAPE, "--force"]) == 0
    assert last.read_bytes() != b"mine"


def test_a_resume_of_another_run_is_refused(here: None, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(DRAPE) == 0
    for change in (["--size", "64x64"], ["--set", "wind_z=5"], ["--view", "strain"], ["--layout", other_layout()]):
        assert "cannot be resumed" in refused(capsys, *change, "--resume")


def other_layout() -> str:
    """Return a layout that `DRAPE` does not use."""
    used = json.loads(Path("o/run.json").read_bytes())["settings"]["layout"]
    return "serial" if used == "parallel" else "parallel"


def test_a_resume_on_another_arch_is_refused(
    here: None, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert cli.main(DRAPE) == 0
    monkeypatch.setattr(image, "running_arch", lambda: "cuda")
    assert "cannot be resumed" in refused(capsys, "--resume")


def test_a_render_of_an_earlier_version_without_layout_and_arch_can_be_resumed(here: None) -> None:
    assert cli.main(DRAPE) == 0
    report = json.loads(Path("o/run.json").read_bytes())
    for key in ("layout", "arch"):
        del report["settings"][key]
    Path("o/run.json").write_text(json.dumps(report), encoding="utf-8")
    assert cli.main([*DRAPE, "--resume"]) == 0
    assert json.loads(Path("o/run.json").read_bytes())["settings"]["arch"] == "cpu"


@pytest.mark.parametrize("content", [b"", b"garbage", b"[]", b"3", b"\xff\xfe", b"{}"])
def test_a_resume_over_a_damaged_report_is_refused(
    here: None, capsys: pytest.CaptureFixture[str], content: bytes
) -> None:
    Path("o").mkdir()
    Path("o/run.json").write_bytes(content)
    assert "use --force to start over" in refused(capsys, "--resume")
    assert Path("o/run.json").read_bytes() == content


def test_an_output_that_is_a_file_is_refused(here: None, capsys: pytest.CaptureFixture[str]) -> None:
    Path("o").write_text("mine")
    assert refused(capsys) == "taichi-cloth: o is a file, not a folder\n"
    assert Path("o").read_text() == "mine"


# -- rendering, in its own process ----------------------------------------------------------------------


def test_render_writes_images_and_their_settings(tmp_path: Path) -> None:
    words = ["render", "curtain", "--frames", "7", "--every", "3", "--out", "o", "--contact-sheet", *SMALL]
    done = run(*words, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    lines = done.stdout.splitlines()
    assert lines[0] == "curtain · verlet 5×12 · simd · 30×24 · structural shear bend wind sphere ground · cpu · seed 0"
    assert lines[-1] == "3 images in o (frames 0 to 6, every 3), and contact_sheet.png"
    names = sorted(p.name for p in (tmp_path / "o").iterdir())
    assert names == ["contact_sheet.png", "frame_00000.png", "frame_00001.png", "frame_00002.png", "run.json"]
    with Image.open(tmp_path / "o" / "frame_00002.png") as image:
        assert image.size == (96, 54)
    report = json.loads((tmp_path / "o" / "run.json").read_text())
    assert report["complete"]
    assert [line["frame"] for line in report["frames"]] == list(range(7))
    assert [line["frame"] for line in report["frames"] if "draw_ms" in line] == [0, 3, 6]
    assert report["seed"] == 0
    assert report["settings"]["every"] == 3
    assert "rows = 24" in report["scene_text"]
    assert {"taichi", "numpy", "taichi_cloth"} <= report["machine"].keys()
    assert report["frames"][6]["max_strain"] > 0
    assert all(line["physics_ms"] > 0 for line in report["frames"])


def test_two_runs_give_the_same_bytes_in_different_environments(tmp_path: Path) -> None:
    """Output works on a terminal with ASCII only. TI_ARCH and TI_DEFAULT_FP change nothing."""
    environments: dict[str, dict[str, str]] = {
        "a": {},
        "b": {"PYTHONIOENCODING": "ascii", "TI_ARCH": "bogus", "TI_DEFAULT_FP": "64"},
    }
    for out, variables in environments.items():
        words = ["render", "drape15", "--frames", "20", "--every", "19", "--out", out, *SMALL]
        done = run(*words, cwd=tmp_path, variables=variables)
        assert (done.returncode, done.stderr) == (0, "")
        assert ("verlet 1×5" if out == "a" else "verlet 1?5") in done.stdout
    for k in range(2):
        first, second = ((tmp_path / out / f"frame_{k:05d}.png").read_bytes() for out in ("a", "b"))
        assert first == second


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no signals to send")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_render_leaves_complete_files_and_resumes_to_the_same_frames(
    here: None, tmp_path: Path, number: int
) -> None:
    words = ["render", "drape15", *SMALL]
    command = [sys.executable, "-m", "taichi_cloth", *words, "--frames", "100000", "--out", "o"]
    process = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    while not (tmp_path / "o" / "frame_00005.png").exists():
        assert process.poll() is None
    process.send_signal(number)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    made = sorted((tmp_path / "o").glob("frame_*.png"))
    assert err == f"taichi-cloth: interrupted; {len(made)} images in o; --resume continues\n"
    assert not list((tmp_path / "o").glob(".*"))
    assert not json.loads((tmp_path / "o" / "run.json").read_text())["complete"]
    for path in made:
        with Image.open(path) as image:
            image.load()
    frames = str(len(made) + 3)
    assert cli.main([*words, "--frames", frames, "--out", "o", "--resume"]) == 0
    assert cli.main([*words, "--frames", frames, "--out", "whole"]) == 0
    resumed, whole = ({p.name: p.read_bytes() for p in (tmp_path / out).glob("*.png")} for out in ("o", "whole"))
    assert resumed == whole
    assert not list((tmp_path / "o").glob(".*"))


def test_a_closed_pipe_prints_no_error(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "taichi_cloth", "render", "drape15", "--frames", "400", *SMALL]
    process = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stderr is not None
    assert "drape15" in process.stdout.readline()
    process.stdout.close()
    assert process.stderr.read() == ""
    process.stderr.close()
    assert process.wait(timeout=60) == 1


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no limit of file sizes")
def test_a_write_error_is_one_line_and_leaves_no_partial_files(tmp_path: Path) -> None:
    import resource

    def limit() -> None:  # of the file size [bytes]
        resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))

    words = ["render", "curtain", "--frames", "4", "--out", "o", "--size", "320x180"]
    done = run(*words, cwd=tmp_path, preexec_fn=limit)
    assert done.returncode == 1
    assert done.stderr.startswith("taichi-cloth: ")
    assert re.fullmatch(r"taichi-cloth: o/frame_0000\d\.png: File too large\n", done.stderr)
    assert not list((tmp_path / "o").glob(".*"))
    assert not list((tmp_path / "o").glob("*.png"))


def test_without_a_display_run_renders_images_and_states_the_reason(
    here: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    done = run("run", "drape15", "--frames", "3", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[0].startswith("no window (")
    assert "earlier run" not in done.stdout
    assert sorted(p.name for p in (tmp_path / "out" / "run_drape15").glob("*.png")) == [
        "contact_sheet.png",
        *[f"frame_{k:05d}.png" for k in range(3)],
    ]
    assert not (tmp_path / "out" / "drape15").exists()  # the images of `render` stay
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    assert cli.main(["run", "drape15", "--frames", "2", "--size", "64x48"]) == 0  # also a second time
    with Image.open(tmp_path / "out" / "run_drape15" / "frame_00001.png") as image:
        assert image.size == (64, 48)
    assert "the images of an earlier run in" in capsys.readouterr().out
