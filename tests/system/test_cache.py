"""A stored result is read the next time; a failing disk or a damaged file only costs time."""

from pathlib import Path

import numpy as np
import pytest

from taichi_cloth.system.files import cache_folder, cached


@pytest.fixture
def calls(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    (tmp_path / "code.py").write_text("one = 1")
    return []


def ask(calls: list[str], what: str, tmp_path: Path) -> float:
    def make() -> np.ndarray:
        calls.append(what)
        return np.array([float(len(calls))])

    return float(cached(what, tmp_path / "code.py", make)[0])


def test_a_result_is_computed_once_for_each_text_and_source(calls: list[str], tmp_path: Path) -> None:
    assert [ask(calls, what, tmp_path) for what in "aabab"] == [1, 1, 2, 1, 2]
    (tmp_path / "code.py").write_text("one = 2")
    assert ask(calls, "a", tmp_path) == 3


def test_all_files_of_a_source_folder_count(calls: list[str], tmp_path: Path) -> None:
    assert cached("a", tmp_path, lambda: np.array([1]))[0] == 1
    assert cached("a", tmp_path, lambda: np.array([2]))[0] == 1
    (tmp_path / "other.py").write_text("two = 2")
    assert cached("a", tmp_path, lambda: np.array([3]))[0] == 3


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
