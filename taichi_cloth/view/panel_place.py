"""Where the panel is. The toolkit does not say, but its settings file does, some seconds after a move."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

TITLE_HEIGHT = 19  # [pixels] what is left of a collapsed panel

# A section of imgui.ini. "Collapsed" stands where the user has folded the panel into its title.
SECTION = r"\[Window\]\[{name}\]\nPos=(-?\d+),(-?\d+)\nSize=(\d+),(\d+)\nCollapsed=(\d)"


@dataclass(frozen=True)
class Place:
    """A rectangle in pixels from the top left corner of the window."""

    left: int
    top: int
    width: int
    height: int

    @property
    def right(self) -> int:
        return self.left + self.width

    def contains(self, cursor: tuple[float, float], size: tuple[int, int]) -> bool:
        """Whether a screen point (from the bottom left, 0…1) of a window of `size` pixels lies in it."""
        x, y = cursor[0] * size[0] - self.left, (1 - cursor[1]) * size[1] - self.top
        return 0 <= x <= self.width and 0 <= y <= self.height


def saved_place(settings: Path, name: str) -> Place | None:
    """The place of the panel `name` by the toolkit's settings file, None while the file says nothing of it."""
    try:
        found = re.search(SECTION.format(name=re.escape(name)), settings.read_text(encoding="utf-8"))
    except OSError:
        return None
    if found is None:
        return None
    left, top, width, height, collapsed = map(int, found.groups())
    return Place(left, top, width, TITLE_HEIGHT if collapsed else height)
