"""The documents do not point at what is not there."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

TOP = Path(__file__).parents[1]
DOCUMENTS = [*TOP.glob("*.md"), *(TOP / "docs").rglob("*.md")]
LINK = re.compile(r"\]\(([^)#]+)[^)]*\)")


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_every_link_to_a_file_leads_to_one(document: Path) -> None:
    targets = [link for link in LINK.findall(document.read_text(encoding="utf-8")) if "://" not in link]
    assert [link for link in targets if not (document.parent / link).exists()] == []


def test_links_are_found() -> None:
    assert "screenshots/hero.webp" in LINK.findall((TOP / "README.md").read_text(encoding="utf-8"))
    assert LINK.findall("[a](b.md) ![c](d/e.png#f)") == ["b.md", "d/e.png"]
