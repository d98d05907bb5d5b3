"""The table of keys."""

from __future__ import annotations

from pathlib import Path

from taichi_cloth.viewer.input import SHORTCUTS, table

# The keys that Taichi 1.7.4 reports (taichi/ui/utils/utils.h); it reports no digits, F-keys and punctuation.
REPORTED = {*"abcdefghijklmnopqrstuvwxyz", " ", "Tab", "Escape", "Left", "Right", "Up", "Down"}


def test_the_window_reports_every_key_and_each_has_one_action() -> None:
    codes = [key.code for key in SHORTCUTS]
    assert set(codes) <= REPORTED
    assert len(set(codes)) == len(codes)
    assert len({key.action for key in SHORTCUTS}) == len(SHORTCUTS)


def test_the_page_about_controls_contains_the_table_of_keys() -> None:
    page = (Path(__file__).parents[2] / "docs" / "controls.md").read_text(encoding="utf-8")
    assert "\n".join(table()) in page, "docs/controls.md needs this table:\n" + "\n".join(table())
    assert all(f"| {key.label} | {key.help} |" in page for key in SHORTCUTS)
