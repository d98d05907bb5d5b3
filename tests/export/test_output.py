"""The format of an export from its path and options, and refused combinations."""

from __future__ import annotations

from pathlib import Path

import pytest

from taichi_cloth.export.output import CLIP_ONLY_FORMATS, FORMATS, Output, default_path, format_of
from taichi_cloth.system.errors import OutputConflict, UsageError


@pytest.mark.parametrize(
    ("out", "name", "clip", "expected"),
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
        ("a.glb", None, True, "glb"),
        ("a.glb", None, False, "glb"),
        ("folder", None, True, "obj"),
        ("folder", "ply", True, "ply"),
        ("fold.er", "ply", True, "ply"),
    ],
)
def test_the_format_follows_from_the_suffix_or_the_option(
    out: str | None, name: str | None, clip: bool, expected: str
) -> None:
    assert format_of(Path(out) if out else None, name, clip=clip) == expected


@pytest.mark.parametrize(
    ("out", "name", "clip", "message"),
    [
        (
            "a.stl",
            None,
            False,
            "unknown suffix '.stl'; use .obj, .ply, .pc2, .usdc, .usda, .usd, .glb, .html",
        ),
        ("a", None, False, "missing suffix"),
        ("a", "obj", False, "missing suffix"),
        ("a", "pc2", True, "missing suffix"),
        ("a.stl", None, True, "unknown suffix"),
        ("a.obj", "ply", False, "has the suffix of OBJ files, but --format is ply"),
        ("a.obj", None, True, "a clip of OBJ files is a folder"),
        ("a.pc2", None, False, "a PC2 file holds a clip, not one frame: use --frames A:B"),
        (None, "pc2", False, "a PC2 file holds a clip"),
    ],
)
def test_contradictory_options_are_refused(out: str | None, name: str | None, clip: bool, message: str) -> None:
    with pytest.raises(UsageError) as refused:
        format_of(Path(out) if out else None, name, clip=clip, options=True)
    assert message in str(refused.value)


@pytest.mark.parametrize("format", FORMATS)
def test_a_default_path_has_its_format(format: str) -> None:
    for clip in (True,) if format in CLIP_ONLY_FORMATS else (False, True):
        path = default_path("curtain", format, clip=clip)
        assert format_of(path, format, clip=clip) == format


@pytest.mark.parametrize("first", [0, 5])
@pytest.mark.parametrize(("frames", "every", "samples"), [(1, 1, 1), (7, 1, 7), (7, 3, 3), (6, 3, 2), (2, 9, 1)])
def test_number_of_samples(first: int, frames: int, every: int, samples: int) -> None:
    output = Output(Path("a.pc2"), "pc2", first + frames, clip=True, first=first, every=every)
    assert output.samples == samples


def test_a_file_in_place_of_the_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("")
    with pytest.raises(OutputConflict, match="is a file"):
        Output(tmp_path / "a", "obj", 1, clip=True).existing_samples()
