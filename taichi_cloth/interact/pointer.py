"""Who owns the mouse. A press gives it to one of panel, cloth and camera, and it stays there until release.

The toolkit cannot tell whether its panel wants the mouse, so the place of a press decides, against the
rectangle the panel was given. That the user may have moved the panel shows only later, when a widget
changes during what looked like a pull on the cloth: the cloth is let go then.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

BUTTONS = ("left", "right", "middle")
ZOOM_STEPS = 20.0  # zoom steps of a drag over one height of the window


class Owner(Enum):
    """What the mouse acts on."""

    IDLE = "idle"
    PANEL = "panel"
    CLOTH = "cloth"
    CAMERA = "camera"
    NOTHING = "nothing"  # pressed where there is nothing; waits for the release


@dataclass(frozen=True)
class Mouse:
    """The mouse in one displayed frame."""

    x: float  # to the right from the window's left edge [heights of the window]
    y: float  # up from its lower edge [heights of the window]
    held: frozenset[str] = frozenset()  # those of `BUTTONS` that are down


@dataclass(frozen=True)
class Gesture:
    """What the mouse asks for in this frame."""

    press: bool = False  # try to take the cloth here; call `miss` if there is none
    release: bool = False  # let go of the cloth
    orbit: tuple[float, float] = (0.0, 0.0)  # [heights of the window] to the right, up
    zoom: float = 0.0  # steps, nearer if positive


class Pointer:
    """Turns buttons and motion into gestures. The first button pressed owns the mouse, others are ignored."""

    def __init__(self) -> None:
        self.owner = Owner.IDLE
        self._button = ""
        self._last = Mouse(0.0, 0.0)

    def update(self, mouse: Mouse, *, on_panel: bool, widget_changed: bool) -> Gesture:
        """Takes one frame's mouse; `on_panel`: it is inside the panel's rectangle."""
        right, up = mouse.x - self._last.x, mouse.y - self._last.y
        self._last = mouse
        if self.owner is Owner.IDLE:
            return self._begin(mouse, on_panel)
        if self._button not in mouse.held:
            held = self.owner is Owner.CLOTH
            self.owner = Owner.IDLE
            return Gesture(release=held)
        if self.owner is Owner.CLOTH and widget_changed:
            self.owner = Owner.PANEL
            return Gesture(release=True)
        if self.owner is Owner.CAMERA:
            return Gesture(zoom=ZOOM_STEPS * up) if self._button == "middle" else Gesture(orbit=(right, up))
        return Gesture()

    def _begin(self, mouse: Mouse, on_panel: bool) -> Gesture:
        if not mouse.held:
            return Gesture()
        self._button = min(mouse.held, key=BUTTONS.index)
        if on_panel:
            self.owner = Owner.PANEL
            return Gesture()
        self.owner = Owner.CLOTH if self._button == "left" else Owner.CAMERA
        return Gesture(press=self.owner is Owner.CLOTH)

    def miss(self) -> None:
        """The press hit no cloth, or the cloth that was held is gone: nothing more until the button is up."""
        if self.owner is Owner.CLOTH:
            self.owner = Owner.NOTHING
