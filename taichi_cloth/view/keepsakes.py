"""What S and C leave behind: screenshots and clips, numbered, each beside the recording that repeats it.

A clip is drawn from its recording, by another process (`taichi-cloth replay FILE --video`) after its end: to draw a
picture takes longer than a frame may, and the window would stutter.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

from ..errors import why
from ..files import new_name
from ..interact.camera import OrbitCamera
from ..record.recorded import Recorded
from ..record.recording import Recording
from .draw_list import DrawList
from .png import write_png
from .portrait import portrait
from .raster import Raster
from .video import kinds

Size = tuple[int, int]


class Keepsakes:
    """Writes into `out/SCENE`, over nothing that is there. Every call returns a line for the user."""

    def __init__(self, out: Path) -> None:
        self._out = out.absolute()  # the window works in another folder
        self._beside = self._out.parent
        self._drawings: list[Drawing] = []
        self.clip_is_on = False

    def screenshot(self, simulation: Recorded, draw_list: DrawList, camera: OrbitCamera, view: str, size: Size) -> str:
        try:
            file = self._write(simulation, "shot", size)
            picture = file.with_suffix(".png")
            write_png(picture, portrait(Raster(*size), draw_list, camera, view))
        except OSError as error:
            return f"no screenshot: {why(error)}"
        return f"wrote {self._shown(picture)}"

    def begin_clip(self) -> str:
        """From here on; the simulation has begun to record anew."""
        self.clip_is_on = True
        return "a clip is on: C ends it"

    def end_clip(self, simulation: Recorded, size: Size) -> str:
        if not self.clip_is_on:
            return ""
        self.clip_is_on = False
        if simulation.take.frames == 0:
            return "no clip: nothing moved"
        try:
            drawing = Drawing(self._write(simulation, "clip", size))
        except OSError as error:
            return f"no clip: {why(error)}"
        self._drawings.append(drawing)
        return f"drawing {self._shown(drawing.film)}"

    def news(self) -> str:
        """Of clips that are done since the last call."""
        done = [drawing for drawing in self._drawings if drawing.is_done]
        self._drawings = [drawing for drawing in self._drawings if drawing not in done]
        return "; ".join(self._result(drawing) for drawing in done)

    def wait(self) -> str:
        """Until all clips are drawn."""
        for drawing in self._drawings:
            print(f"drawing {self._shown(drawing.film)}", flush=True)
            drawing.wait()
        return self.news()

    def close(self) -> None:
        """Ends what is being drawn."""
        for drawing in self._drawings:
            drawing.end()

    def _result(self, drawing: Drawing) -> str:
        error = drawing.error()
        return f"{self._shown(drawing.film)}: {error}" if error else f"wrote {self._shown(drawing.film)}"

    def _write(self, simulation: Recorded, kind: str, size: Size) -> Path:
        """The recording up to now in a new file. Raises OSError."""
        folder = self._out / simulation.scene.name
        folder.mkdir(parents=True, exist_ok=True)
        file = taken(folder, kind)
        try:
            Recording.of(simulation, size).write(file)
        except OSError:
            file.unlink(missing_ok=True)
            raise
        return file

    def _shown(self, path: Path) -> str:
        return str(path.relative_to(self._beside))


class Drawing:
    """A clip that another process draws."""

    def __init__(self, recording: Path) -> None:
        """Raises OSError."""
        kind = next(iter(kinds()), "")
        self.film = recording.with_suffix(kind)
        where: list[str | Path] = ["--video", self.film] if kind else ["--headless", "--out", self.film]
        package = str(Path(__file__).parents[2])
        path = os.pathsep.join(filter(None, [package, os.environ.get("PYTHONPATH")]))
        low = ["nice"] if shutil.which("nice") else []  # the window goes first
        self._process = subprocess.Popen(
            [*low, sys.executable, "-m", "taichi_cloth", "replay", recording, *where],
            env=os.environ | {"PYTHONPATH": path},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,  # a dozen lines, which wait in it
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            start_new_session=True,  # Ctrl-C is for the window, which ends its drawings itself
        )

    @property
    def is_done(self) -> bool:
        return self._process.poll() is not None

    def wait(self) -> None:
        self._process.wait()

    def end(self) -> None:
        self._process.terminate()
        self._process.communicate()

    def error(self) -> str:
        """The last line of one that failed; nothing of one that did well. It must have ended."""
        words, _ = self._process.communicate()
        return "" if self._process.returncode == 0 else ([*words.splitlines()] or ["the drawing was ended"])[-1]


def taken(folder: Path, kind: str) -> Path:
    """A new recording's file, empty: no other window will write there. Raises OSError."""
    while True:
        path = new_name(folder, kind).with_suffix(".toml")
        with suppress(FileExistsError):  # another window was quicker
            path.open("x").close()
            return path
