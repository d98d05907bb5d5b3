"""Path and format of an export, from the options of the command line. Imports neither NumPy nor Taichi."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from ..system.errors import OutputConflict, UsageError, choose_from, install_command

SUFFIXES = {
    "obj": (".obj",),
    "ply": (".ply",),
    "pc2": (".pc2",),
    "usd": (".usdc", ".usda", ".usd"),
    "glb": (".glb",),
    "html": (".html",),
}
BY_SUFFIX = {ending: name for name, endings in SUFFIXES.items() for ending in endings}
FORMATS = tuple(SUFFIXES)
UP_AXES = ("y", "z")
FOLDER_FORMATS = ("obj", "ply")  # formats whose clips are folders of numbered files
Y_UP_FORMATS = {"glb": "glTF files", "html": "HTML pages"}  # formats whose up axis is y
CLIP_ONLY_FORMATS = {"pc2": "a PC2 file holds", "html": "an HTML page plays"}  # formats for clips only


@dataclass(frozen=True)
class Output:
    """What to write, and where: the cloth after some frames, or a clip."""

    path: Path
    """File, or folder if `is_folder`."""
    format: str
    """One of `FORMATS`."""
    frames: int
    """Frames to simulate, of 1/60 s each."""
    up: str = "y"
    """The axis that is up in the file, one of `UP_AXES`."""
    clip: bool = False
    first: int = 0
    """Frames before the first sample of a clip."""
    every: int = 1
    """Frames per sample of a clip."""

    @property
    def is_folder(self) -> bool:
        """Whether the output is a folder of numbered files."""
        return self.clip and self.format in FOLDER_FORMATS

    @property
    def samples(self) -> int:
        """Number of samples in a clip: after `first` frames, after `every` more, and so on."""
        return -(-(self.frames - self.first) // self.every)

    @property
    def mesh(self) -> Path:
        """The mesh file that a PC2 file animates."""
        return self.path.with_suffix(".obj")

    def sample_path(self, sample: int) -> Path:
        """Return the path of a sample in a folder."""
        return self.path / f"frame_{sample:05d}.{self.format}"

    def single_files(self) -> list[Path]:
        """Return the files to write, without numbered ones."""
        return [] if self.is_folder else [self.path, self.mesh] if self.format == "pc2" else [self.path]

    def existing_samples(self) -> list[Path]:
        """Return the numbered files that exist in the folder. Raises OutputConflict if the path is a file."""
        if self.path.exists() and not self.path.is_dir():
            raise OutputConflict(f"{self.path} is a file; a clip of {self.format.upper()} files needs a folder")
        return sorted(self.path.glob(f"frame_*.{self.format}"))

    def prepare(self) -> None:
        """Make the folder of the output, and remove the numbered files of an older clip.

        Raises OutputConflict if the path of a folder is a file, and OSError.
        """
        folder = self.path if self.is_folder else self.path.parent
        older = self.existing_samples() if self.is_folder else []
        folder.mkdir(parents=True, exist_ok=True)
        for path in older:
            path.unlink()


def format_of(path: Path | None, name: str | None, *, clip: bool, options: bool = False) -> str:
    """Return the export format from the suffix of `path` and the format `name`, either of which may be None.

    Raises UsageError if they disagree, if they do not determine a format, and for a format that cannot be written so.
    `options`: whether path and name come from the command line, whose options its message then names.
    """
    if name is not None and name not in FORMATS:
        raise UsageError(f"unknown format {name!r}{choose_from(str(name), FORMATS)}")
    out = f"--out {path}" if options else f"{path}"
    if path is None:
        chosen = name or ("pc2" if clip else "obj")
    elif path.suffix.lower() not in BY_SUFFIX:
        chosen = name or ("obj" if clip and not path.suffix else "")
        if chosen not in FOLDER_FORMATS or not clip:
            problem = f"unknown suffix {path.suffix!r}" if path.suffix else "missing suffix"
            known = [suffix for suffix, one in BY_SUFFIX.items() if not (clip and one in FOLDER_FORMATS)]
            folder = ", or no suffix for a folder of OBJ or PLY files" if clip else ""
            raise UsageError(f"{out}: {problem}; use {', '.join(known)}{folder}")
    else:
        by_suffix = BY_SUFFIX[path.suffix.lower()]
        chosen = name or by_suffix
        if chosen != by_suffix:
            given = "--format" if options else "the format"
            raise UsageError(f"{out} has the suffix of {by_suffix.upper()} files, but {given} is {chosen}")
        if clip and chosen in FOLDER_FORMATS:
            raise UsageError(f"{out}: a clip of {chosen.upper()} files is a folder; omit the suffix")
    if chosen in CLIP_ONLY_FORMATS and not clip:
        raise UsageError(f"{CLIP_ONLY_FORMATS[chosen]} a clip, not one frame: use --frames A:B")
    return chosen


def check_format(format: str, up: str) -> None:
    """Raise UsageError for an up axis that a format cannot have, and for USD if its package is not installed."""
    if format == "usd" and find_spec("pxr") is None:
        raise UsageError(f"USD files need usd-core: {install_command('usd')}")
    if up not in UP_AXES:
        raise UsageError(f"unknown up axis {up!r}: use {' or '.join(UP_AXES)}")
    if up != "y" and format in Y_UP_FORMATS:
        raise UsageError(f"the up axis {up} does not apply to {Y_UP_FORMATS[format]}, in which y is up")


def default_path(scene: str, format: str, *, clip: bool) -> Path:
    """Return the default path: in the folder `out`, named after the scene."""
    folder = Path("out")
    return folder / scene if clip and format in FOLDER_FORMATS else folder / f"{scene}{SUFFIXES[format][0]}"
