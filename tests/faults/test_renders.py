"""Renders with a full disk, a read-only folder, another render in the same folder, or a sudden end."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import random
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from taichi_cloth import __main__ as cli
from taichi_cloth.geometry.scene_loader import load_scene
from taichi_cloth.render.image import LAST_GOOD, RenderPlan, save_last_good
from taichi_cloth.simulation.rollback import DivergenceGuard
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.system import files

pytestmark = pytest.mark.usefixtures("running")

Disk = Callable[..., Path]

SCENE = """
[cloth]
rows = 6
columns = 7
[wind]
z = 5.0
"""
FRAMES, ENDLESS = 40, 100000


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every test has its own folder with a small scene."""
    monkeypatch.chdir(tmp_path)
    Path("small.toml").write_text(SCENE)


def words(frames: object, out: str = "o") -> list[str]:
    return ["render", "small.toml", "--layout", "serial", "--size", "96x54", "--frames", str(frames), "--out", out]


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """The images of an uninterrupted render."""
    folder = tmp_path_factory.mktemp("uninterrupted")
    with contextlib.chdir(folder):
        Path("small.toml").write_text(SCENE)
        assert cli.main(words(FRAMES)) == 0
        return images("o")


def start(frames: object, *more: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "taichi_cloth", *words(frames), *more]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)


def wait_for(path: Path, process: subprocess.Popen[str]) -> None:
    while not path.exists():
        assert process.poll() is None, process.communicate()
        time.sleep(0.001)


def frame(k: int) -> Path:
    return Path("o") / f"frame_{k:05d}.png"


def contents(out: str = "o") -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in Path(out).iterdir()}


def images(out: str) -> dict[str, bytes]:
    """All images; each is complete."""
    for path in Path(out).glob("*.png"):
        with Image.open(path) as image:
            image.load()
    return {name: content for name, content in contents(out).items() if name.endswith(".png")}


def report() -> dict[str, Any]:
    content: dict[str, Any] = json.loads(Path("o/run.json").read_text())
    return content


def one_line(capsys: pytest.CaptureFixture[str]) -> str:
    err = capsys.readouterr().err
    assert err.startswith("taichi-cloth: ")
    assert err.count("\n") == 1
    return err


# -- two renders into one folder -------------------------------------------------------------------------------


@pytest.mark.skipif(os.name != "posix", reason="needs SIGSTOP")
def test_a_second_render_into_the_folder_is_refused_until_the_first_ends(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with start(ENDLESS) as first:
        try:
            wait_for(frame(3), first)
            first.send_signal(signal.SIGSTOP)  # so that it changes nothing in the meantime
            os.waitpid(first.pid, os.WUNTRACED)
            before = contents()
            for more in ([], ["--force"], ["--resume"]):
                assert cli.main([*words(5), *more]) == 2
                assert one_line(capsys) == ("taichi-cloth: o is in use by another render; choose another --out\n")
            assert contents() == before
        finally:
            first.kill()
    assert cli.main([*words(6), "--resume"]) == 0
    assert not list(Path("o").glob(".*"))


# -- a sudden end ----------------------------------------------------------------------------------------------


@pytest.mark.skipif(os.name != "posix", reason="needs SIGKILL")
@pytest.mark.parametrize("kills", [3, pytest.param(20, marks=pytest.mark.long)])
def test_a_render_killed_at_random_times_and_resumed_gives_the_frames_of_an_uninterrupted_run(kills: int) -> None:
    moment = random.Random(kills)
    for _ in range(kills):
        made = len(list(Path("o").glob("*.png")))
        with start(ENDLESS, "--resume") as run:
            try:
                if made == 0 or moment.random() < 0.8:
                    wait_for(frame(made + moment.randrange(15)), run)
                time.sleep(moment.random() * 0.1)  # during a frame, an image or the start
                assert run.poll() is None, run.communicate()
            finally:
                run.kill()
        assert len(images("o")) >= made
        assert not report()["complete"]
    frames = len(images("o")) + 3
    assert cli.main([*words(frames), "--resume"]) == 0
    assert cli.main(words(frames, "uninterrupted")) == 0
    assert images("o") == images("uninterrupted")
    assert report()["complete"]
    assert not list(Path("o").glob(".*"))


# -- a disk that is full ---------------------------------------------------------------------------------------


@pytest.fixture(params=["a small disk", "a mocked error"])
def make_room(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[], None]]:
    """The folder `o` has space for a few frames only, until this is called."""
    if request.param == "a small disk":
        out = request.getfixturevalue("disk")("o", "size=64k")
        yield lambda: subprocess.run(["mount", "-o", "remount,size=4m", out], check=True) and None
        return
    real, calls = os.replace, []

    def full(source: Path, target: Path) -> None:
        calls.append(target)
        if len(calls) > 8:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        real(source, target)

    with monkeypatch.context() as patched:
        patched.setattr(files.os, "replace", full)
        yield patched.undo


def test_a_render_stopped_by_a_full_disk_can_be_resumed(
    make_room: Callable[[], None], uninterrupted: dict[str, bytes], capsys: pytest.CaptureFixture[str]
) -> None:
    capsys.readouterr()
    assert cli.main(words(FRAMES)) == 1
    error = one_line(capsys)
    assert re.fullmatch(r"taichi-cloth: o/frame_000\d\d\.png: No space left on device\n", error)
    made = images("o")
    assert 3 < len(made) < 30
    assert contents().keys() == {*made, "run.json"}
    assert not report()["complete"]
    assert len(report()["frames"]) <= len(made) + 3  # images are written while the simulation goes on
    make_room()
    assert cli.main([*words(FRAMES), "--resume"]) == 0
    assert images("o") == uninterrupted
    assert report()["complete"]


def test_divergence_is_reported_if_the_last_good_frame_cannot_be_saved(tmp_path: Path) -> None:
    with Simulation(load_scene("small.toml"), "serial") as simulation:
        line = save_last_good(simulation, DivergenceGuard(simulation), RenderPlan(out=tmp_path / "gone", frames=1))
    assert line.startswith("the cloth blew up in frame 0: ")
    assert f"could not be saved: {tmp_path / 'gone' / LAST_GOOD}: No such file or directory" in line


# -- a folder that cannot be written ---------------------------------------------------------------------------


@pytest.fixture
def closed(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Path]:
    """A folder in which no file can be created."""
    if hasattr(os, "geteuid") and os.geteuid() == 0:  # root may write everywhere but on a read-only disk
        yield request.getfixturevalue("disk")("closed", "ro")
        return
    path = tmp_path / "closed"
    path.mkdir(mode=0o500)
    if os.access(path, os.W_OK):
        pytest.skip("this system lets everyone write everywhere")
    yield path
    path.chmod(0o700)


@pytest.mark.parametrize("inside", [".", "new"])
def test_a_read_only_folder_is_one_line(closed: Path, inside: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(words(3, os.path.normpath(f"closed/{inside}"))) == 1
    assert " closed/" in one_line(capsys)
    assert list(closed.iterdir()) == []
