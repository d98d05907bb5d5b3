"""Scenes without some of what they name."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

from .errors import SceneError, nearest
from .model import Scene, parts

NEEDED = ("grips", "regions", "maps")  # what hangs from them would fall


def may_do_without(scene: Scene) -> list[str]:
    """Sections that the scene has and need not have, in its own order."""
    return [name for name, part in parts().items() if part.optional and getattr(scene, name) and name not in NEEDED]


def scene_without(scene: Scene, names: Iterable[str]) -> Scene:
    """The scene without these sections. Raises SceneError for one that it does not have."""
    off: dict[str, Any] = {}
    for name in names:
        section = name.replace("-", "_")
        have = may_do_without(scene)
        if section not in have:
            reason = f"{scene.name} has no such stage; it can do without {', '.join(have) or 'none'}"
            raise SceneError("", name, reason, nearest(section, have))
        off[section] = () if parts()[section].many else None
    return replace(scene, **off)
