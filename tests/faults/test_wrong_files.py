"""Wrong files, folders and values on the command line: one line names them, exit code 2, and nothing is written."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from taichi_cloth import __main__ as cli

Refused = Callable[[list[str], str], None]
SHEET = "[cloth]\nrows = 8\ncolumns = 8\n"
FILES = {
    "ok.toml": SHEET.encode(),
    "scene.txt": SHEET.encode(),
    "größe ü.toml": SHEET.encode(),
    "bom.toml": b"\xef\xbb\xbf" + SHEET.encode(),
    "crlf.toml": SHEET.replace("\n", "\r\n").encode(),
    "empty.toml": b"",
    "binary.toml": b"\0\1\xff\xfe",
    "latin1.toml": 'title = "été"'.encode("latin-1"),
    "json.toml": b'{"a": 1}',
    "huge.toml": b"[cloth]\nrows = 99999999999999999999\n",
    "negative.toml": b"[cloth]\nrows = -3\n",
    "missing.toml": b"[cloth]\nrows =\n",
    "double.toml": b"[[cloth]]\nrows = 3\n",
    "mesh.obj": b"v 0 0 0\n",
    "mesh.toml": b'[cloth]\nfile = "mesh.obj"\n',
    "meshes.toml": b'[[meshes]]\nfile = "./folder"\n',
    "maps.toml": b'[maps]\npin = "./folder"\n',
    "picture.png": b"\x89PNG\r\n\x1a\n",
    "results.json": b"[1]",
    "bytes.json": b"\xff",
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with these files, and a folder in it."""
    folder = tmp_path_factory.mktemp("wrong files")
    for name, content in FILES.items():
        (folder / name).write_bytes(content)
    (folder / "folder").mkdir()
    return folder


@pytest.fixture
def here(folder: Path, running: None, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The folder is the working folder, and nothing in it changes."""
    monkeypatch.chdir(folder)
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*")}
    yield
    assert {path: path.stat().st_mtime_ns for path in folder.rglob("*")} == before


RENDER = ["render", "ok.toml", "--frames", "1", "--size", "16x16"]
EXPORT = ["export", "ok.toml", "--frames", "1", "--out"]
LINES: list[tuple[list[str], str]] = [
    (["run", "binary.toml"], "binary.toml: is not UTF-8 text (byte 2)"),
    (["run", "latin1.toml"], "latin1.toml: is not UTF-8 text (byte 9)"),
    (["run", "json.toml"], "json.toml: is not valid TOML: "),
    (["run", "missing.toml"], "missing.toml: is not valid TOML: "),
    (["run", "huge.toml"], "huge.toml: cloth.rows: 99999999999999999999 is out of range: 2 to 2048"),
    (["run", "negative.toml"], "negative.toml: cloth.rows: -3 is out of range: 2 to 2048"),
    (["run", "double.toml"], "double.toml: cloth: write [cloth] with single brackets"),
    (["run", "mesh.toml"], "mesh.toml: cloth.file: mesh.obj: has no faces"),
    (["run", "meshes.toml"], "meshes.toml: meshes[0].file: folder: "),
    (["run", "maps.toml"], "maps.toml: maps.pin: folder "),
    (["run", "mesh.obj"], "mesh.obj: is a mesh, not a scene"),
    (["./part.stl"], "part.stl: is a mesh, not a scene: convert it to OBJ, and write a scene whose [cloth] has file"),
    (["run", "ok"], "or the path of a TOML file (did you mean 'ok.toml'?)"),
    (["ok"], "unknown command 'ok'; did you mean 'ok.toml'?"),
    (["run", "scene.txt"], "scene.txt: is no shipped scene; for the file, write ./scene.txt"),
    (["run", "picture.png"], "picture.png: is no shipped scene"),
    (["run", "folder"], "folder: is a folder, not a scene file"),
    (["run", "folder/"], "folder: is a folder, not a scene file"),
    (["run", ""], "scene: no such scene; use "),
    (["run", "none/a.toml"], "a.toml: cannot be read: No such file or directory"),
    (["run", "ok.toml", "--log", "folder"], "folder is a folder, not a file"),
    (["run", "ok.toml", "--log", "empty.toml/log"], "cannot write log: empty.toml is not a folder"),
    (["run", "ok.toml", "--log", "ok.log", "--headless"], "--log has a line per displayed frame, but no window opens"),
    (["run", "ok.toml", "--log", ""], "argument --log: the path is empty"),
    (["run", "ok.toml", "--size", "0x9"], "'0x9' is not WxH in pixels, 1 to 8192 each"),
    ([*RENDER, "--out", "empty.toml"], "empty.toml is a file, not a folder"),
    ([*RENDER, "--out", ""], "argument --out: the path is empty"),
    ([*RENDER, "--video", "a.avi"], "a.avi: a video file must end in .mp4 or .webp"),
    ([*RENDER, "--video", "folder"], "folder: a video file must end in .mp4 or .webp"),
    ([*RENDER, "--video", "ok.toml/a.webp"], "cannot write a.webp: ok.toml is not a folder"),
    ([*RENDER, "--frames", "99999999999"], "'99999999999' is not an integer from 1 to 10000000"),
    ([*RENDER, "--frames"], "argument --frames: expected one argument"),
    ([*RENDER, "--set", "cloth.rows="], "cloth.rows: must be an integer, got ''"),
    ([*RENDER, "--set", "cloth.rows=1e400"], "cloth.rows: must be an integer, got inf"),
    ([*RENDER, "--set", "wind.z=nan"], "wind.z: must be a finite number, got nan"),
    ([*RENDER, "--set", "wind.z=-1e308"], "wind.z: -1e+308 is out of range: -100 to 100 m/s"),
    ([*RENDER, "--set", "cloth=3"], "cloth: is a section: set one of its keys, such as cloth.rows"),
    ([*RENDER, "--set", "maps.pin=none.png"], "maps.pin: none.png cannot be read: No such file"),
    ([*EXPORT, "folder"], "--out folder: missing suffix; use .obj"),
    ([*EXPORT, "a.xyz"], "--out a.xyz: unknown suffix '.xyz'; use .obj"),
    ([*EXPORT, "ok.toml/a.obj"], "cannot write a.obj: ok.toml is not a folder"),
    ([*EXPORT, "a.obj", "--frames", "5:2"], "'5:2' is not a range A:B of frames"),
    (["compare", "ok.toml", "--a", "=3"], "--a: =3: must be KEY=VALUE"),
    (["compare", "folder", "--a", "rows=3"], "folder: is a folder, not a scene file"),
    (["compare", "ok.toml", "--a", "rows=9", "--log", "folder"], "folder is a folder, not a file"),
    (["compare", "ok.toml", "--a", "rows=9", "--log", "ok.log", "--out", "images"], "no window opens (--out)"),
    (["replay", "ok.toml", "--log", "ok.log", "--check"], "no window opens (--check)"),
    (["replay", "folder"], "folder: not a recording: it is a folder"),
    (["replay", "ok.toml"], "ok.toml: not a recording: it has no [recording]"),
    (["replay", "binary.toml"], "binary.toml: not a recording: not UTF-8 text (byte 2)"),
    (["replay", "picture.png"], "picture.png is an image: give the recording picture.toml beside it"),
    (["bench", "--csv", "folder"], "folder is a folder, not a file"),
    (["bench", "--csv", "ok.toml"], "ok.toml already exists; use --force to replace it"),
    (["bench", "--json", "ok.toml/none/a.json"], "cannot write a.json: ok.toml/none is not a folder"),
    (["validate", "--from", "none.json"], "none.json: No such file or directory"),
    (["validate", "--from", "results.json"], "results.json was not written by `validate --json`"),
    (["validate", "--from", "bytes.json"], "bytes.json was not written by `validate --json`"),
    (["stress", "--from", "results.json"], "results.json is not a results file of `stress --json`"),
    (["stress", "--from", "bytes.json"], "bytes.json is not a results file of `stress --json`"),
    (["stress", "--seed", "-1"], "'-1' is not an integer from 0 to "),
    (["stress", "--image-dir", "ok.toml"], "ok.toml is a file, not a folder"),
    (["ablate", "ok.toml", "none.toml"], "none.toml: cannot be read: No such file"),
    (["ablate", "ok.toml", "--markdown", "folder"], "folder is a folder, not a file"),
    (["web", "--port", "99999"], "'99999' is not a port from 0 to 65535"),
]


@pytest.mark.parametrize(("words", "message"), LINES, ids=[" ".join(words) for words, _ in LINES])
def test_a_wrong_command_line_is_one_line(here: None, refused: Refused, words: list[str], message: str) -> None:
    refused(words, message)


def test_check_names_every_wrong_file(here: None, capsys: pytest.CaptureFixture[str]) -> None:
    names = [*FILES, "folder", "none.toml", "./scene.txt"]
    assert cli.main(["check", *names]) == 2
    out, error = capsys.readouterr()
    lines = out.splitlines()
    valid = {line.split(": valid · ")[0] for line in lines if ": valid · " in line}
    assert valid == {"ok.toml", "größe ü.toml", "bom.toml", "crlf.toml", "empty.toml", "./scene.txt"}
    assert [line.split(": ")[0] for line in lines] == names
    wrong = len(names) - len(valid)
    assert error == f"taichi-cloth: {wrong} mistakes in {wrong} of {len(names)} files\n"


@pytest.mark.skipif(sys.platform == "win32" or os.geteuid() == 0, reason="root may read and write everything")
def test_files_without_permission_are_refused_before_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("closed.toml").touch(mode=0o000)
    Path("closed").mkdir(mode=0o555)
    assert cli.main(["run", "closed.toml"]) == 2
    assert capsys.readouterr().err == "taichi-cloth: closed.toml: cannot be read: Permission denied\n"
    assert cli.main(["bench", "--csv", "closed/a.csv"]) == 2
    assert capsys.readouterr().err == "taichi-cloth: cannot write a.csv: no permission to write in closed\n"
