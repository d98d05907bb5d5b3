"""Which format a user means, and what is refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from taichi_cloth.errors import OutputInUse, WrongUse
from taichi_cloth.export.output import CLIPS, FORMATS, Output, default_path, format_of


@pytest.mark.parametrize(
    ("out", "name", "clip", "meant"),
    [
        (None, None, False, "obj"),
        (None, None, True, "pc2"),
        (None, "usd", False, "usd"),
        ("a.obj", None, False, "obj"),
        ("a.PLY", None, False, "ply"),
        ("a.b.usda", None, True, "usd"),
        ("a.usd", "usd", False, "usd"),
        ("a.usdc", None, True, "usd"),
        ("a.pc2", None, True, "pc2"),
        ("a.html", None, True, "html"),
        ("folder", None, True, "obj"),
        ("folder", "ply", True, "ply"),
        ("fold.er", "ply", True, "ply"),
    ],
)
def test_the_format_is_told_by_the_suffix_or_by_name(out: str | None, name: str | None, clip: bool, meant: str) -> None:
    assert format_of(Path(out) if out else None, name, clip=clip) == meant


@pytest.mark.parametrize(
    ("out", "name", "clip", "said"),
    [
        (
            "a.stl",
            None,
            False,
            "no format has the suffix '.stl'; there are .obj, .ply, .pc2, .usdc, .usda, .usd, .html",
        ),
        ("a", None, False, "a file needs a suffix"),
        ("a", "obj", False, "a file needs a suffix"),
        ("a", "pc2", True, "a file needs a suffix"),
        ("a.stl", None, True, "no format"),
        ("a.obj", "ply", False, "is a name of OBJ files, and --format says ply"),
        ("a.obj", None, True, "a clip of OBJ files is a folder"),
        ("a.pc2", None, False, "a PC2 file holds a clip: use `bake`, or --clip"),
        (None, "pc2", False, "a PC2 file holds a clip"),
    ],
)
def test_what_is_meant_by_nobody_is_refused(out: str | None, name: str | None, clip: bool, said: str) -> None:
    with pytest.raises(WrongUse) as refused:
        format_of(Path(out) if out else None, name, clip=clip)
    assert said in str(refused.value)


@pytest.mark.parametrize("format", FORMATS)
def test_a_default_path_is_one_of_its_format(format: str) -> None:
    for clip in (True,) if format in CLIPS else (False, True):
        path = default_path("curtain", format, clip=clip)
        assert format_of(path, format, clip=clip) == format


@pytest.mark.parametrize(("frames", "every", "samples"), [(1, 1, 1), (7, 1, 7), (7, 3, 3), (6, 3, 2), (2, 9, 1)])
def test_samples_are_those_of_a_render(frames: int, every: int, samples: int) -> None:
    assert Output(Path("a.pc2"), "pc2", frames, clip=True, every=every).samples == samples


def test_a_folder_that_is_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("")
    with pytest.raises(OutputInUse, match="is a file"):
        Output(tmp_path / "a", "obj", 1, clip=True).earlier()
