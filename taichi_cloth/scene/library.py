"""The shipped scenes: one TOML file each, named by its stem."""

from __future__ import annotations

from pathlib import Path

from .errors import SceneError, nearest

_PACKAGE = Path(__file__).parents[1]


def asset_folder() -> Path:
    """`assets` inside an installed package, or at the top of a checkout."""
    inside = _PACKAGE / "assets"
    return inside if (inside / "scenes").is_dir() else _PACKAGE.parent / "assets"


def scene_names() -> list[str]:
    """Names of all shipped scenes, sorted."""
    return sorted(path.stem for path in (asset_folder() / "scenes").glob("*.toml"))


def scene_path(name_or_path: str | Path) -> Path:
    """The file of a shipped scene, or the path as given. Raises SceneError for a name that is none."""
    text = str(name_or_path)
    if isinstance(name_or_path, Path) or text.endswith(".toml") or "/" in text or "\\" in text:
        return Path(text)
    names = scene_names()
    if text not in names:
        reason = f"no such scene: {', '.join(names)}, or the path of a TOML file"
        raise SceneError(text or "scene", "", reason, nearest(text, names))
    return asset_folder() / "scenes" / f"{text}.toml"
