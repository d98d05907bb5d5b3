"""What is shipped: scenes, one TOML file each, and meshes, one OBJ file each, named by their stems."""

from __future__ import annotations

from pathlib import Path

from .errors import SceneError, nearest, shown

_PACKAGE = Path(__file__).parents[1]


def asset_folder() -> Path:
    """`assets` inside an installed package, or at the top of a checkout."""
    inside = _PACKAGE / "assets"
    return inside if (inside / "scenes").is_dir() else _PACKAGE.parent / "assets"


def scene_names() -> list[str]:
    """Names of all shipped scenes, sorted."""
    return sorted(path.stem for path in (asset_folder() / "scenes").glob("*.toml"))


def mesh_names() -> list[str]:
    """Names of all shipped meshes, sorted."""
    return sorted(path.stem for path in (asset_folder() / "meshes").glob("*.obj"))


def is_file_name(text: str) -> bool:
    """Whether it is written as a path, and not as the name of something shipped."""
    return text.endswith((".toml", ".obj")) or "/" in text or "\\" in text


def scene_path(name_or_path: str | Path) -> Path:
    """The file of a shipped scene, or the path as given. Raises SceneError for a name that is none."""
    text = str(name_or_path)
    if isinstance(name_or_path, Path) or is_file_name(text):
        return Path(text)
    names = scene_names()
    if text not in names:
        reason = f"no such scene: {', '.join(names)}, or the path of a TOML file"
        raise SceneError(text or "scene", "", reason, nearest(text, names))
    return asset_folder() / "scenes" / f"{text}.toml"


def mesh_path(file: str, folder: str) -> Path:
    """The OBJ file of a shipped mesh, or a path as a scene file in `folder` gives it."""
    return Path(folder) / file if is_file_name(file) else asset_folder() / "meshes" / f"{file}.obj"


def is_map_name(text: str) -> bool:
    """Whether it names a shipped map, and not a file."""
    return bool(text) and not (Path(text).suffix or "/" in text or "\\" in text)


def map_path(file: str, folder: str) -> Path:
    """The file of a shipped map, or a path as a scene file in `folder` gives it. Raises ValueError for a wrong name."""
    if not is_map_name(file):
        return Path(folder) / file
    shipped = {path.stem: path for path in sorted((asset_folder() / "maps").glob("*.csv"))}
    if file not in shipped:
        known = ", ".join(shipped)
        raise ValueError(f"{shown(file)} is no shipped map: {known}, or the path of a picture, a .csv or an .npy file")
    return shipped[file]
