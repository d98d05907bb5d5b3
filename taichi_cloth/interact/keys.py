"""Every key, once: the window obeys this table, and the panel and the README print it.

The toolkit reports letters, Space, Escape and arrows only: no digits, no F-keys, no mouse wheel.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Key:
    """A key and what it does."""

    code: str  # the toolkit's name for it
    label: str
    action: str
    help: str
    held: bool = False  # acts as long as it is down, at a rate


KEYS = (
    Key(" ", "Space", "freeze", "freeze, go on"),
    Key("n", "N", "step", "one frame on"),
    Key("r", "R", "reset", "start again"),
    Key("g", "G", "wind", "wind on, off"),
    Key("v", "V", "view", "next view"),
    Key("t", "T", "solver", "next solver"),
    Key("y", "Y", "fabric", "next fabric"),
    Key("x", "X", "stage", "stages off in turn"),
    Key("p", "P", "pin", "pin, unpin here"),
    Key("j", "J", "smaller_hand", "smaller hand"),
    Key("l", "L", "larger_hand", "larger hand"),
    Key("d", "D", "own_values", "scene's own values"),
    Key("k", "K", "curves", "curves on, off"),
    Key("b", "B", "previous_scene", "previous scene"),
    Key("m", "M", "next_scene", "next scene"),
    Key("e", "E", "export", "write an OBJ file"),
    Key("f", "F", "first_view", "first view point"),
    Key("Tab", "Tab", "page", "next page of panel"),
    Key("h", "H", "hide", "hide, show panel"),
    Key("s", "S", "screenshot", "screenshot"),
    Key("c", "C", "clip", "begin, end a clip"),
    Key("i", "I", "zoom_in", "zoom in", held=True),
    Key("o", "O", "zoom_out", "zoom out", held=True),
    Key("Left", "Left", "pan_left", "move the view left", held=True),
    Key("Right", "Right", "pan_right", "move it right", held=True),
    Key("Up", "Up", "pan_up", "move it up", held=True),
    Key("Down", "Down", "pan_down", "move it down", held=True),
    Key("Escape", "Esc", "quit", "quit"),
)

ARROWS = ("Left", "Right", "Up", "Down")  # one line of help is enough for the four

MOUSE = (
    ("left drag", "pull the cloth"),
    ("right drag", "turn the view"),
    ("middle drag", "zoom"),
)


def table() -> list[str]:
    """Mouse and keys as a Markdown table, two to a row: that of the README."""
    entries = [*MOUSE, *((key.label, key.help) for key in KEYS)]
    half = (len(entries) + 1) // 2
    left, right = entries[:half], [*entries[half:], ("", "")]
    rows = [f"| {a} | {what} | {b} | {other} |" for (a, what), (b, other) in zip(left, right, strict=False)]
    return ["| mouse, key | | key | |", "|---|---|---|---|", *rows]
