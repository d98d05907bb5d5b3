"""Error messages for the user."""

from __future__ import annotations

import errno
import json
import pickle
import re
import sys
import tomllib
from importlib import metadata
from pathlib import Path

import pytest

import taichi_cloth
from taichi_cloth.geometry.mesh_reader import ObjError
from taichi_cloth.system.errors import PinError, SceneError, UsageError, error_text, install_command, nearest_name


def test_the_text_of_an_os_error_has_its_file_and_reason() -> None:
    assert (
        error_text(OSError(errno.ENOSPC, "No space left on device", "out/a.png"))
        == "out/a.png: No space left on device"
    )
    assert error_text(OSError(errno.EAGAIN, "no more processes")) == "no more processes"
    assert error_text(OSError("odd")) == "odd"
    assert error_text(RuntimeError("the cloth blew up")) == "the cloth blew up"


# -- packages that are not installed -----------------------------------------------------------------------------------


class Installed:
    """A package that pip installed. `origin`: what pip stored of its source, if anything."""

    def __init__(self, origin: object) -> None:
        self._origin = origin

    def read_text(self, name: str) -> str | None:
        assert name == "direct_url.json"
        return None if self._origin is None else json.dumps(self._origin)


def installed_from(monkeypatch: pytest.MonkeyPatch, origin: object) -> None:
    monkeypatch.setattr(metadata, "distribution", lambda name: Installed(origin))


def test_the_command_installs_an_extra_from_where_the_package_came(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    checkout = tmp_path / "my cloth"
    monkeypatch.setattr(sys, "executable", "python3")
    installed_from(monkeypatch, {"url": checkout.as_uri(), "dir_info": {}})
    assert install_command("web") == f'python3 -m pip install "{checkout}[web]"'
    installed_from(monkeypatch, {"url": checkout.as_uri(), "dir_info": {"editable": True}})
    assert install_command("usd") == f'python3 -m pip install -e "{checkout}[usd]"'
    monkeypatch.setattr(sys, "executable", "/my programs/python3")
    assert install_command("usd").startswith('"/my programs/python3" -m pip install ')


@pytest.mark.parametrize("origin", [None, {"url": "https://example.org/cloth.git", "vcs_info": {"vcs": "git"}}])
def test_without_a_known_folder_the_command_is_for_the_checkout(
    monkeypatch: pytest.MonkeyPatch, origin: object
) -> None:
    installed_from(monkeypatch, origin)
    assert install_command("web") == f'{sys.executable} -m pip install ".[web]" in the folder of the checkout'


def test_a_package_that_runs_uninstalled_has_the_command_too(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> None:
        raise metadata.PackageNotFoundError(name)

    monkeypatch.setattr(metadata, "distribution", missing)
    assert install_command("web").endswith('".[web]" in the folder of the checkout')


def test_every_named_extra_exists_and_none_is_installed_from_an_index() -> None:
    package = Path(taichi_cloth.__file__).parent
    pages = [*package.parent.glob("docs/**/*.md"), package.parent / "README.md"]
    project = tomllib.loads((package.parent / "pyproject.toml").read_text("utf-8"))["project"]
    texts = {path: path.read_text("utf-8") for path in (*package.rglob("*.py"), *pages)}
    pattern = re.compile(r"""install_command\(["'](\w+)|"\.\[([\w,]+)\]\"""")
    found = [name for text in texts.values() for groups in pattern.findall(text) for name in "".join(groups).split(",")]
    assert {"web", "usd", "video", "maps", "plot"} <= set(found) <= set(project["optional-dependencies"])
    assert [path.name for path, text in texts.items() if "taichi-cloth[" in text] == []


@pytest.mark.parametrize(
    "error",
    [
        SceneError("a.toml", "wind.z", "500 is out of range", "x"),
        ObjError(Path("a.obj"), 3, "no vertices"),
        PinError("no group 'hem'", "hem", ["top"]),
        UsageError("unknown layout"),
    ],
)
def test_errors_arrive_from_other_processes(error: Exception) -> None:
    """A process pool pickles them, and would wait forever for one that cannot be unpickled."""
    copy = pickle.loads(pickle.dumps(error))
    assert (type(copy), str(copy)) == (type(error), str(error))
    assert vars(copy).get("reason") == vars(error).get("reason")


@pytest.mark.parametrize(
    ("wrong", "name"),
    [
        ("XPBD", "xpbd"),
        ("DENIM", "denim"),
        ("demin", "denim"),
        ("seat_belt", "belt_seat"),
        ("denima", "denim"),
        ("Structural", "structural"),
        ("nothing", ""),
        ("rk5", "rk4"),
    ],
)
def test_the_nearest_name_is_found_in_spite_of_capitals_and_swapped_letters(wrong: str, name: str) -> None:
    assert nearest_name(wrong, ["xpbd", "rk4", "denim", "silk", "belt_seat", "structural"]) == name
