"""A stored result is read the next time; a failing disk or a damaged file only costs time."""

from pathlib import Path

import numpy as np
import pytest

from taichi_cloth.system import files
from taichi_cloth.system.files import cache_folder, cached, digest_of_sources


@pytest.fixture
def calls(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    (tmp_path / "map.csv").write_text("1")
    return []


def ask(calls: list[str], what: str, tmp_path: Path) -> float:
    def make() -> np.ndarray:
        calls.append(what)
        return np.array([float(len(calls))])

    return float(cached(what, make, [tmp_path / "map.csv"])[0])


def test_a_result_is_computed_once_for_each_text_and_content_of_files(calls: list[str], tmp_path: Path) -> None:
    assert [ask(calls, what, tmp_path) for what in "aabab"] == [1, 1, 2, 1, 2]
    (tmp_path / "map.csv").write_text("2")
    assert ask(calls, "a", tmp_path) == 3
    assert cached("a", lambda: np.array([4]))[0] == 4


def test_a_change_of_any_source_of_the_package_computes_it_again(
    calls: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package = tmp_path / "package"
    (package / "geometry").mkdir(parents=True)
    monkeypatch.setattr(files, "PACKAGE", package)
    assert ask(calls, "a", tmp_path) == 1
    for name, source in (("geometry/grid.py", "one"), ("geometry/grid.py", "two"), ("new.py", ""), ("notes.txt", "")):
        (package / name).write_text(source)
        digest_of_sources.cache_clear()  # as in another process
        ask(calls, name, tmp_path)
        ask(calls, "a", tmp_path)
    assert "".join(name[0] for name in calls) == "agagan" + "an"


def test_a_damaged_file_is_replaced(calls: list[str], tmp_path: Path) -> None:
    ask(calls, "a", tmp_path)
    [file] = cache_folder().iterdir()
    for content in (b"", file.read_bytes()[:-3], b"no array"):
        file.write_bytes(content)
        assert ask(calls, "a", tmp_path) == len(calls)
    assert len(calls) == 4
    assert ask(calls, "a", tmp_path) == 4


def test_without_a_cache_folder_results_are_computed(calls: list[str], tmp_path: Path) -> None:
    (tmp_path / "cache").write_text("a file stands where the folder should be")
    assert [ask(calls, "a", tmp_path) for _ in range(2)] == [1, 2]


def test_without_a_home_folder_results_are_computed(
    calls: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setattr(
        "os.path.expanduser", lambda path: path
    )  # as for a user without an entry in the password database
    with pytest.raises(FileNotFoundError, match="home"):
        cache_folder()
    assert [ask(calls, "a", tmp_path) for _ in range(2)] == [1, 2]
