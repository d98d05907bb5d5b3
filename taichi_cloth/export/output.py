"""Where an export goes and in which format, from what the user said. Imports nothing heavy."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ..errors import OutputInUse, WrongUse

SUFFIXES = {"obj": (".obj",), "ply": (".ply",), "pc2": (".pc2",), "usd": (".usdc", ".usda", ".usd"), "html": (".html",)}
BY_SUFFIX = {ending: name for name, endings in SUFFIXES.items() for ending in endings}
FORMATS = tuple(SUFFIXES)
UPS = ("y", "z")
FOLDERS = ("obj", "ply")  # a clip of these is a folder of numbered files
CLIPS = {"pc2": "a PC2 file holds", "html": "an HTML page plays"}  # and nothing else


@dataclass(frozen=True)
class Output:
    """What to write: one moment, or a clip of `frames` frames of 1/60 s of which every `every`-th is kept."""

    path: Path
    format: str
    frames: int
    up: str = "y"
    clip: bool = False
    every: int = 1

    @property
    def is_folder(self) -> bool:
        return self.clip and self.format in FOLDERS

    @property
    def samples(self) -> int:
        """Number of moments in a clip: before the first frame, after `every`, …"""
        return -(-self.frames // self.every)

    @property
    def mesh(self) -> Path:
        """The mesh that a PC2 file moves."""
        return self.path.with_suffix(".obj")

    def numbered(self, sample: int) -> Path:
        return self.path / f"frame_{sample:05d}.{self.format}"

    def files(self) -> list[Path]:
        """Those that it makes beside the numbered ones."""
        return [] if self.is_folder else [self.path, self.mesh] if self.format == "pc2" else [self.path]

    def earlier(self) -> list[Path]:
        """Numbered files that are in the folder. Raises OutputInUse where it is none."""
        if self.path.exists() and not self.path.is_dir():
            raise OutputInUse(f"{self.path} is a file: a clip of {self.format.upper()} files is a folder")
        return sorted(self.path.glob(f"frame_*.{self.format}"))


def format_of(path: Path | None, name: str | None, *, clip: bool) -> str:
    """The format that a path's suffix or its own name tells. Raises WrongUse where they do not agree or say nothing."""
    if path is None:
        chosen = name or ("pc2" if clip else "obj")
    elif path.suffix.lower() not in BY_SUFFIX:
        chosen = name or ("obj" if clip and not path.suffix else "")
        if chosen not in FOLDERS or not clip:
            has = f"no format has the suffix {path.suffix!r}" if path.suffix else "a file needs a suffix"
            raise WrongUse(f"--out {path}: {has}; there are {', '.join(BY_SUFFIX)}")
    else:
        told = BY_SUFFIX[path.suffix.lower()]
        chosen = name or told
        if chosen != told:
            raise WrongUse(f"--out {path} is a name of {told.upper()} files, and --format says {chosen}")
        if clip and chosen in FOLDERS:
            raise WrongUse(f"--out {path}: a clip of {chosen.upper()} files is a folder; name one without a suffix")
    if chosen in CLIPS and not clip:
        raise WrongUse(f"{CLIPS[chosen]} a clip: use `bake`, or --clip")
    return chosen


def default_path(scene: str, format: str, *, clip: bool) -> Path:
    """In the folder `out`, by the scene's name."""
    folder = Path("out")
    return folder / scene if clip and format in FOLDERS else folder / f"{scene}{SUFFIXES[format][0]}"
