"""HTML pages with holes: `{{name}}` stands for a part."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import Any

from ..errors import one_line

DRAWING = Path(__file__).with_name("drawing.js")


def filled(page: Path, title: str, parts: Mapping[str, str]) -> str:
    """The page with its title, the script that draws and what else is given; `parts` are taken as they are."""
    all_parts = {"title": escape(one_line(title)), "drawing": DRAWING.read_text(encoding="utf-8"), **parts}
    return re.sub(r"\{\{(\w+)\}\}", lambda found: all_parts[found[1]], page.read_text(encoding="utf-8"))


def script_safe(value: Any) -> str:
    """JSON that stands in a script element: nothing in it is taken for HTML."""
    return json.dumps(value, separators=(",", ":")).replace("<", "\\u003c")
