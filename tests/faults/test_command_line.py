"""Any words on the command line: understood, or refused in one line with exit code 2, and nothing is written."""

from __future__ import annotations

import argparse
import contextlib
import io
import os
from pathlib import Path
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from taichi_cloth import cli, runtime
from taichi_cloth.bench import children
from taichi_cloth.errors import WrongUse
from taichi_cloth.scene.overrides import override_places
from taichi_cloth.stress import running
from taichi_cloth.validate import running as measuring
from taichi_cloth.view import display

STOPPED = "stopped where the run would begin"


def commands() -> dict[str, argparse.ArgumentParser]:
    """The program's own commands."""
    [action] = [a for a in cli.build_parser()._actions if isinstance(a, argparse._SubParsersAction)]
    return dict(action.choices)


OPTIONS = {
    name: [s for a in parser._actions for s in a.option_strings if a.dest != "help"]
    for name, parser in commands().items()
}

# What an operating system can hand over: any characters but a zero; bytes that are no text come as half characters.
text = st.text(st.characters(exclude_characters="\0"), max_size=8)
scenes = st.sampled_from(["curtain", "curtian", "table", "none.toml", ".", "..", "/", "", "mine.toml", "-"])
values = st.sampled_from(
    [
        "0",
        "-1",
        "3",
        "nan",
        "inf",
        "1e999",
        "9" * 5000,
        "٣",
        "²",
        "0x10",
        "1_000",
        " 7 ",
        "960x540",
        "0x0",
        "x",
        "1x1x1",
    ]
    + ["verlet", "varlet", "lanes", "cpu", "strain", "a\nb", "a\x1b[31mb", "\udcff", "A2", "", "--", "-", "=", "out"]
)
overrides = st.builds(
    "{}={}".format,
    st.sampled_from(sorted(override_places())) | text,
    values
    | text
    | st.sampled_from(["nan", "-inf", "[1,2,3]", "[", "{a=1}", "true", "'x'", "[[0,0,0,0],[1]]", "1e400"]),
)


RIGHT = {"--size": "96x54", "--frames": "3", "--out": "o", "--solver": "lines", "--path": "list", "--every": "2"}
RIGHT |= {"--set": "wind_z=2", "--view": "strain", "--samples": "1", "--arch": "cpu", "--target-error": "2"}
RIGHT |= {"--only": "A2", "--csv": "file.csv", "--json": "file.json", "--markdown": "file.md", "--scene": "curtain"}


@st.composite
def words(draw: st.DrawFn) -> list[str]:
    """A command with some of its own options, not all of them with the values they need."""
    name = draw(st.sampled_from(sorted(OPTIONS)))
    found = [name, *draw(st.just(["curtain"]) | st.lists(scenes, max_size=2))]
    for option in draw(st.lists(st.sampled_from(OPTIONS[name]), max_size=4)):
        found.append(option)
        if draw(st.booleans()):
            found += [RIGHT[option]] if option in RIGHT else []
        else:
            found += draw(st.lists(overrides if option == "--set" else values | text, max_size=1))
    return draw(st.permutations(found)) if draw(st.booleans()) else found


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """A folder to be in, and no run that begins."""
    folder = tmp_path_factory.mktemp("empty")

    def stop(*arguments: Any, **options: Any) -> Any:
        raise WrongUse(STOPPED)

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(runtime, "start", stop)
        patched.setattr(children, "bench", stop)
        patched.setattr(running, "run_all", stop)
        patched.setattr(measuring, "measure_all", stop)
        patched.setattr(display, "window_obstacle", lambda: "no window in this test")
        yield folder


@given(words() | st.lists(text | values, max_size=4))
@example(["render", "curtain", "--out", "two\nlines", "--sett", "one\ntwo"])
@example(["check", "two\nlines.toml"])
@example(["validate", "--only", "two\nlines"])
@example(["bench", "--csv", "no folder/file.csv"])
@example(["stress"])
@example(["render", "curtain", "--set", "rows=2048", "--set", "columns=2048"])
def test_no_words_make_a_traceback(folder: Path, words: list[str]) -> None:
    out, err = (io.TextIOWrapper(io.BytesIO(), "utf-8", "backslashreplace") for _ in range(2))
    with contextlib.chdir(folder), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            code = cli.main(words)
        except SystemExit as ended:
            code = ended.code
    err.seek(0)
    said = err.read()
    assert code in (0, 1, 2)
    if code:
        assert said.startswith("taichi-cloth")
        assert said.count("\n") == 1
        assert said[:-1].isprintable()
    else:
        assert said == ""
    assert os.listdir(folder) == []
