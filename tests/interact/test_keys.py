"""The table of keys."""

from __future__ import annotations

from pathlib import Path

from taichi_cloth.interact.keys import KEYS, table

# What Taichi 1.7.4 reports (taichi/ui/utils/utils.h); digits, F-keys and punctuation give nothing.
REPORTED = {*"abcdefghijklmnopqrstuvwxyz", " ", "Tab", "Escape", "Left", "Right", "Up", "Down"}


def test_every_key_is_one_the_window_can_see_and_has_one_meaning() -> None:
    codes = [key.code for key in KEYS]
    assert set(codes) <= REPORTED
    assert len(set(codes)) == len(codes)
    assert len({key.action for key in KEYS}) == len(KEYS)


def test_the_readme_has_the_table_of_all_keys() -> None:
    readme = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")
    assert "\n".join(table()) in readme, "put this table there:\n" + "\n".join(table())
    assert all(f"| {key.label} | {key.help} |" in readme for key in KEYS)
