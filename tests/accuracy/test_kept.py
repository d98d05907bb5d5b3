"""What is computed once is read the next time, and a bad disk or a torn file only costs time."""

from pathlib import Path

import numpy as np
import pytest

from taichi_cloth.accuracy.kept import folder, kept


@pytest.fixture
def calls(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    (tmp_path / "code.py").write_text("one = 1")
    return []


def ask(calls: list[str], what: str, tmp_path: Path) -> float:
    def make() -> np.ndarray:
        calls.append(what)
        return np.array([float(len(calls))])

    return float(kept(what, tmp_path / "code.py", make)[0])


def test_once_for_each_question_and_each_code(calls: list[str], tmp_path: Path) -> None:
    assert [ask(calls, what, tmp_path) for what in "aabab"] == [1, 1, 2, 1, 2]
    (tmp_path / "code.py").write_text("one = 2")
    assert ask(calls, "a", tmp_path) == 3


def test_a_folder_of_code_counts_whole(calls: list[str], tmp_path: Path) -> None:
    assert kept("a", tmp_path, lambda: np.array([1]))[0] == 1
    assert kept("a", tmp_path, lambda: np.array([2]))[0] == 1
    (tmp_path / "other.py").write_text("two = 2")
    assert kept("a", tmp_path, lambda: np.array([3]))[0] == 3


def test_a_torn_file_is_made_anew(calls: list[str], tmp_path: Path) -> None:
    ask(calls, "a", tmp_path)
    [file] = folder().iterdir()
    for content in (b"", file.read_bytes()[:-3], b"no array"):
        file.write_bytes(content)
        assert ask(calls, "a", tmp_path) == len(calls)
    assert len(calls) == 4
    assert ask(calls, "a", tmp_path) == 4


def test_without_a_place_to_keep_it(calls: list[str], tmp_path: Path) -> None:
    (tmp_path / "cache").write_text("a file stands where the folder should be")
    assert [ask(calls, "a", tmp_path) for _ in range(2)] == [1, 2]


def test_for_a_user_without_a_home(calls: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setattr("os.path.expanduser", lambda path: path)  # as it answers for one who is in no list of users
    with pytest.raises(FileNotFoundError, match="home"):
        folder()
    assert [ask(calls, "a", tmp_path) for _ in range(2)] == [1, 2]
