"""Exports to a full disk: no partial file, the older file is kept, and the error is one line."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from taichi_cloth import __main__ as cli

pytestmark = pytest.mark.usefixtures("running")

Disk = Callable[..., Path]


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("small.toml").write_text("[cloth]\nrows = 12\ncolumns = 12\n")


@pytest.mark.parametrize("name", ["c.pc2", "c.usdc", "c.usda", "c.html"])
def test_a_clip_that_does_not_fit_keeps_the_older_file(
    disk: Disk, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    out = disk("o", "size=16k")
    older = {out / name, out / "c.obj"}
    for path in older:
        path.write_text("older")
    words = ["small.toml", "--layout", "serial", "--frames", "0:90", "--out", f"o/{name}", "--force"]
    assert cli.main(["export", *words]) == 1
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert "No space left on device" in err
    assert err.startswith(f"taichi-cloth: o/{name}: ")
    assert set(out.iterdir()) == older
    assert {path.read_text() for path in older} == {"older"}


def test_numbered_files_that_fit_are_kept(disk: Disk, capsys: pytest.CaptureFixture[str]) -> None:
    out = disk("o", "size=64k")
    assert (
        cli.main(["export", "small.toml", "--layout", "serial", "--frames", "0:90", "--format", "ply", "--out", "o"])
        == 1
    )
    err = capsys.readouterr().err
    assert re.fullmatch(r"taichi-cloth: o/frame_000\d\d\.ply: No space left on device\n", err)
    names = sorted(path.name for path in out.iterdir())
    assert names == [f"frame_{k:05d}.ply" for k in range(len(names))]
    assert len(names) > 2
    assert len({path.stat().st_size for path in out.iterdir()}) == 1
