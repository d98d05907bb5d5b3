"""Random command lines: accepted, or refused in one line with exit code 2, and nothing is written."""

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

from taichi_cloth import __main__ as cli
from taichi_cloth.cli import output_commands, run, scenes
from taichi_cloth.cli.program import build_parser
from taichi_cloth.evaluation import commands as evaluation_commands
from taichi_cloth.evaluation import compare
from taichi_cloth.evaluation.bench import subprocess_runner as children
from taichi_cloth.evaluation.stress import runner as running
from taichi_cloth.evaluation.validate import references as measuring
from taichi_cloth.scene.overrides import override_targets
from taichi_cloth.system import taichi_runtime as runtime
from taichi_cloth.system.errors import UsageError
from taichi_cloth.viewer import toolkit as display

MODULES = (run, compare, output_commands, scenes, evaluation_commands)  # as in `taichi_cloth.__main__`
STOPPED = "stopped before the run"


def commands() -> dict[str, argparse.ArgumentParser]:
    """The commands of the program."""
    [action] = [a for a in build_parser(MODULES)._actions if isinstance(a, argparse._SubParsersAction)]
    return dict(action.choices)


OPTIONS = {
    name: [s for a in parser._actions for s in a.option_strings if a.dest != "help"]
    for name, parser in commands().items()
}

# What an operating system can pass: any characters but zero; bytes that are not UTF-8 become lone surrogates.
text = st.text(st.characters(exclude_characters="\0"), max_size=8)
scene_names = st.sampled_from(["curtain", "curtian", "table", "none.toml", ".", "..", "/", "", "mine.toml", "-"])
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
    + ["verlet", "varlet", "simd", "cpu", "strain", "a\nb", "a\x1b[31mb", "\udcff", "A2", "", "--", "-", "=", "out"]
)
overrides = st.builds(
    "{}={}".format,
    st.sampled_from(sorted(override_targets())) | text,
    values
    | text
    | st.sampled_from(["nan", "-inf", "[1,2,3]", "[", "{a=1}", "true", "'x'", "[[0,0,0,0],[1]]", "1e400"]),
)


VALID = {"--size": "96x54", "--frames": "3", "--out": "o", "--solver": "lines", "--layout": "serial", "--every": "2"}
VALID |= {"--set": "wind_z=2", "--view": "strain", "--samples": "1", "--arch": "cpu", "--target-error": "2"}
VALID |= {"--filter": "A2", "--csv": "file.csv", "--json": "file.json", "--markdown": "file.md", "--scene": "curtain"}


@st.composite
def words(draw: st.DrawFn) -> list[str]:
    """A command with some of its options, some of them without their values."""
    name = draw(st.sampled_from(sorted(OPTIONS)))
    found = [name, *draw(st.just(["curtain"]) | st.lists(scene_names, max_size=2))]
    options = st.lists(st.sampled_from(OPTIONS[name]), max_size=4) if OPTIONS[name] else st.just([])
    for option in draw(options):
        found.append(option)
        if draw(st.booleans()):
            found += [VALID[option]] if option in VALID else []
        else:
            found += draw(st.lists(overrides if option == "--set" else values | text, max_size=1))
    return draw(st.permutations(found)) if draw(st.booleans()) else found


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """An empty working folder, in which no run begins."""
    folder = tmp_path_factory.mktemp("empty")

    def stop(*arguments: Any, **options: Any) -> Any:
        raise UsageError(STOPPED)

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
@example(["validate", "--filter", "two\nlines"])
@example(["validate", "--only", "two\nlines"])  # renamed to --filter
@example(["bench", "--csv", "no folder/file.csv"])
@example(["stress"])
@example(["9" * 300])  # too long for a name of a file
@example(["render", "curtain", "--set", "rows=2048", "--set", "columns=2048"])
def test_no_command_line_prints_a_traceback(folder: Path, words: list[str]) -> None:
    out, err = (io.TextIOWrapper(io.BytesIO(), "utf-8", "backslashreplace") for _ in range(2))
    with contextlib.chdir(folder), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            code: object = cli.main(words)
        except SystemExit as ended:
            code = ended.code
    err.seek(0)
    message = err.read()
    assert code in (0, 1, 2)
    if code:
        assert message.startswith("taichi-cloth")
        assert message.count("\n") == 1
        assert message[:-1].isprintable()
    else:
        assert message == ""
    assert os.listdir(folder) == []
