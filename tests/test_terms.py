"""Retired words: the project uses the field's terms (docs/glossary.md) and American spelling."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

# By retired word: the term to use instead.
RETIRED = {
    "asked": "requested",
    "bond": "bending link",
    "centre": "center",
    "colour": "color",
    "dashpot": "spring damping",
    "doors": "access",
    "film": "video",
    "grip": "attachment",
    "keepsake": "capture",
    "knee": "elbow",
    "leash": "max distance",
    "metre": "meter",
    "neighbour": "neighbor",
    "puller": "dragger",
    "reel": "session",
    "strangers": "clients",
    "tangle": "intersection",
    "told": "reported",
}
TABLES_OF_OLD_NAMES = {"system/errors.py"}  # they refuse old keys, options and names by their new ones
HISTORY = {"docs/history.md"}  # titles of papers
# Written by the commands that measure, with the words that they had then.
MEASURED = {f"docs/{name}{rows}.md" for name in ("validation", "stability", "scenes") for rows in ("", "_rows")}


def texts() -> list[Path]:
    package = [path for suffix in ("py", "html", "js", "toml") for path in (ROOT / "taichi_cloth").rglob(f"*.{suffix}")]
    documents = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").glob("*.md")]
    return sorted([*package, *documents, *(ROOT / "assets").rglob("*.toml")])


@pytest.mark.parametrize("path", texts(), ids=lambda path: path.relative_to(ROOT).as_posix())
def test_no_retired_words(path: Path) -> None:
    name = path.relative_to(ROOT).as_posix()
    if name.removeprefix("taichi_cloth/") in TABLES_OF_OLD_NAMES or name in HISTORY | MEASURED:
        pytest.skip("names old words")
    text = (
        re.sub(r"`[^`\n]*`", "", path.read_text(encoding="utf-8")) if path.suffix == ".md" else path.read_text("utf-8")
    )
    for word, term in RETIRED.items():
        found = re.search(rf"(?<![a-zA-Z]){word}(s|es|ed)?(?![a-zA-Z])", text, re.IGNORECASE)
        assert found is None, f"{found[0]!r}: use {term!r}"


def test_retired_words_are_found() -> None:
    for word in RETIRED:
        assert re.search(rf"(?<![a-zA-Z]){word}(s|es|ed)?(?![a-zA-Z])", f"a {word}s_b", re.IGNORECASE)


NOT_IN_THE_PACKAGE = {"main.cpp", "section_key", "NAME_001", "KIND_001.toml"}  # a file of Taichi, and patterns of names


def test_names_in_docstrings_exist() -> None:
    """A name in backticks is a word of some source outside of backticks."""
    package = ROOT / "taichi_cloth"
    sources = {path: path.read_text(encoding="utf-8") for path in package.rglob("*.py")}
    others = [path for suffix in ("html", "js") for path in package.rglob(f"*.{suffix}")]
    others += (ROOT / "assets").rglob("*.toml")
    every = [re.sub(r"`[^`\n]*`", "", text) for text in sources.values()] + [path.read_text("utf-8") for path in others]
    known = set(re.findall(r"\w+", " ".join(every)))
    unknown = [
        f"{path.relative_to(ROOT)}: {name}"
        for path, text in sources.items()
        for name in re.findall(r"`([A-Za-z_][\w.]*)`", text)
        if name not in NOT_IN_THE_PACKAGE and not known.issuperset(name.split("."))
    ]
    assert unknown == []
