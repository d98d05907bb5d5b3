"""Results are whole in their file after every unit, and a run goes on with those of the same program alone."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from taichi_cloth.errors import WrongUse
from taichi_cloth.stress import store as module
from taichi_cloth.stress.store import Store, load, origin
from taichi_cloth.stress.trial import Figure
from taichi_cloth.stress.unit import run_unit

from .conftest import BREAKS, SWINGS, failed, result


def test_what_is_written_is_read_again(tmp_path: Path) -> None:
    store = Store.new(tmp_path / "o.json", [SWINGS, BREAKS])
    store.add(run_unit(SWINGS, SWINGS.starts(1), None))
    store.add(replace(failed(variant="breaks"), figures=[Figure("way", 1.5, None)]))
    again = load(tmp_path / "o.json")
    assert again == store
    assert [r.state for r in again.ordered()] == ["alive", "failed"]
    assert again.ordered()[0].origin == origin()


def test_the_file_is_whole_after_every_unit(tmp_path: Path) -> None:
    store = Store.new(tmp_path / "o.json", [SWINGS, BREAKS])
    for count, unit in enumerate((BREAKS, SWINGS), 1):
        store.add(result(variant=unit.variant.name))
        assert len(json.loads((tmp_path / "o.json").read_text(encoding="utf-8"))["results"]) == count


def test_what_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    store = Store.new(None, [SWINGS, BREAKS])
    store.add(result(variant="swings", starts=4))
    assert store.left([SWINGS, BREAKS], 4) == [BREAKS]
    assert store.left([SWINGS, BREAKS], 1) == [BREAKS]  # more starts were run than are asked for
    assert store.left([SWINGS, BREAKS], 5) == [SWINGS, BREAKS]
    monkeypatch.setattr(module, "origin", lambda: "another program")
    assert store.left([SWINGS, BREAKS], 4) == [SWINGS, BREAKS]


def test_older_results_stay_until_they_are_run_again() -> None:
    older = Store.new(None, [SWINGS])
    older.results[SWINGS.key] = result(variant="swings", origin="older")
    older.results[7, "gone", "xpbd"] = result(7, "gone")
    kept = Store.new(None, [SWINGS, BREAKS]).continued(older)
    assert [r.origin for r in kept.ordered()] == ["older"]
    assert kept.left([SWINGS, BREAKS], 10) == [SWINGS, BREAKS]


def test_the_origin_is_that_of_physics_and_judging(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for name in ("stress/watch.py", "stress/known.py", "kernels/springs.py", "web/hub.py", "simulation.py"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("1\n")
    monkeypatch.setattr(module, "PACKAGE", tmp_path)
    for name in module.FILES:
        (tmp_path / f"{name}.py").touch()

    def after(name: str) -> str:
        (tmp_path / name).write_text("2\n")
        return origin.__wrapped__()

    first = origin.__wrapped__()
    assert after("web/hub.py") == first
    assert after("stress/known.py") == first
    second = after("stress/watch.py")
    assert first != second != after("kernels/springs.py")


@pytest.mark.parametrize("text", ["", "[]", '{"machine": "", "planned": [], "results": [{}]}'])
def test_a_file_that_is_none(text: str, tmp_path: Path) -> None:
    (tmp_path / "o.json").write_text(text)
    with pytest.raises(WrongUse, match="holds no results of stress"):
        load(tmp_path / "o.json")
    with pytest.raises(WrongUse, match="No such file"):
        load(tmp_path / "none.json")
