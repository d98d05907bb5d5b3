"""Screenshots, clips, meshes (keys S, C and E) and scenes: numbered files; images and clips with their recording.

Clips are rendered from their recordings, by another process (`taichi-cloth replay FILE --video`), after they end:
rendering an image takes longer than a frame may, so the window would stutter.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from ..render.camera import OrbitCamera
from ..render.draw_list import DrawList
from ..render.image import render_pixels
from ..render.image_files import available_formats, write_png
from ..render.rasterizer import Rasterizer
from ..scene import SceneError
from ..simulation.recording import Recorder
from ..simulation.simulation import Simulation
from ..system.errors import UsageError, error_text, install_command
from ..system.files import next_free_path
from .toolkit import Progress, Refusal

Size = tuple[int, int]
Exporter = Callable[[Simulation, Path], Path]  # writes mesh or scene to a new file in a folder, and returns its path


class Capture:
    """Writes screenshots, clips, meshes and scenes to `out/SCENE`, never over existing files.

    Methods that return a string return one line for the user, or an empty string if there is nothing to report.
    """

    def __init__(self, out: Path) -> None:
        self._out = out.absolute()  # the window changes the working directory
        self._out_parent = self._out.parent
        self._jobs: list[VideoJob] = []
        self.clip_is_on = False
        """Whether a clip is being recorded."""

    def screenshot(self, recorder: Recorder, draw_list: DrawList, camera: OrbitCamera, view: str, size: Size) -> str:
        """Write an image of `size` [pixels] and the recording that leads to it."""
        try:
            file = self._save_recording(recorder, "shot", size)
            image = file.with_suffix(".png")
            write_png(image, render_pixels(Rasterizer(*size), draw_list, camera, view))
        except OSError as error:
            return Refusal(f"screenshot failed: {error_text(error)}")
        return f"wrote {self._relative(image)} and its recording, {file.name}"

    def mesh(self, export: Exporter, simulation: Simulation) -> str:
        """Write the cloth as it is now."""
        try:
            path = export(simulation, self._out / simulation.scene.name)
        except OSError as error:
            return Refusal(f"cannot write the mesh: {error_text(error)}")
        return f"wrote {self._relative(path)}"

    def scene(self, save: Exporter, simulation: Simulation) -> str:
        """Write the scene with the present values of its parameters."""
        try:
            path = save(simulation, self._out / simulation.scene.name)
        except (OSError, SceneError, UsageError) as error:
            return Refusal(f"cannot save the scene: {error_text(error)}")
        return f"wrote {self._relative(path)}"

    def begin_clip(self) -> str:
        """Begin a clip at this moment. The caller has restarted the recorder."""
        self.clip_is_on = True
        return Progress("recording a clip: press C to stop")

    def end_clip(self, recorder: Recorder, size: Size) -> str:
        """End the clip, if there is one: save its recording and start rendering it at `size` [pixels]."""
        if not self.clip_is_on:
            return ""
        self.clip_is_on = False
        if recorder.frames == 0:
            return Refusal("no clip written: it has no frames")
        try:
            job = VideoJob(self._save_recording(recorder, "clip", size), recorder.frames + 1)
        except OSError as error:
            return Refusal(f"clip failed: {error_text(error)}")
        self._jobs.append(job)
        return Progress(f"rendering {self._relative(job.output)}")

    def status(self) -> str:
        """Return the results of clips that finished rendering since the last call."""
        done = [job for job in self._jobs if job.is_done]
        self._jobs = [job for job in self._jobs if job not in done]
        results = [self._result(job) for job in done]
        kind = Refusal if any(isinstance(result, Refusal) for result in results) else str
        return kind("; ".join(results))

    def wait(self) -> str:
        """Wait until all clips are rendered. Return their results."""
        for job in self._jobs:
            print(f"rendering {self._relative(job.output)}, {job.images} images; Ctrl-C stops it", flush=True)
            job.wait()
        return self.status()

    def close(self) -> None:
        """Stop rendering clips."""
        for job in self._jobs:
            job.end()

    def _result(self, job: VideoJob) -> str:
        error = job.error()
        if error:
            return Refusal(f"{self._relative(job.output)}: {error}")
        missing = "" if job.output.suffix else f", as images; for a video: {install_command('video')}"
        return f"wrote {self._relative(job.output)}{missing}"

    def _save_recording(self, recorder: Recorder, kind: str, size: Size) -> Path:
        """Save the recording so far to a new file. Return its path. Raises OSError."""
        folder = self._out / recorder.simulation.scene.name
        folder.mkdir(parents=True, exist_ok=True)
        file = next_free_name(folder, kind)
        try:
            recorder.save(file, size)
        except OSError:
            file.unlink(missing_ok=True)
            raise
        return file

    def _relative(self, path: Path) -> str:
        """Return a path for messages, relative to the folder that contains `out`."""
        return str(path.relative_to(self._out_parent))


class VideoJob:
    """A process that renders a clip from its recording.

    The output `video` is the first format that this machine can write, or a folder of PNG files if it can write none.
    """

    def __init__(self, recording: Path, images: int) -> None:
        """Start the process. `images`: number of images of the clip. Raises OSError."""
        self.images = images
        kind = next(iter(available_formats()), "")
        self.output = recording.with_suffix(kind)
        options: list[str | Path] = ["--video", self.output] if kind else ["--headless", "--out", self.output]
        package = str(Path(__file__).parents[2])
        path = os.pathsep.join(filter(None, [package, os.environ.get("PYTHONPATH")]))
        low_priority = ["nice"] if shutil.which("nice") else []  # the window has priority
        self._process = subprocess.Popen(
            [*low_priority, sys.executable, "-m", "taichi_cloth", "replay", recording, *options],
            env=os.environ | {"PYTHONPATH": path},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,  # at most a dozen lines: the pipe does not fill up
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            start_new_session=True,  # Ctrl-C reaches the window only, which then ends this process itself
        )

    @property
    def is_done(self) -> bool:
        """Whether the process has ended."""
        return self._process.poll() is not None

    def wait(self) -> None:
        """Wait until the process has ended."""
        self._process.wait()

    def end(self) -> None:
        """Terminate the process."""
        self._process.terminate()
        self._process.communicate()

    def error(self) -> str:
        """Return the last line that the process printed if it failed, else an empty string. It must have ended."""
        output, _ = self._process.communicate()
        return "" if self._process.returncode == 0 else ([*output.splitlines()] or ["rendering was stopped"])[-1]


def next_free_name(folder: Path, kind: str) -> Path:
    """Create an empty file for a new recording, `KIND_001.toml` or the next free number. Return its path.

    Once the file exists, no other window takes its number. Raises OSError.
    """
    while True:
        path = next_free_path(folder, kind).with_suffix(".toml")
        with suppress(FileExistsError):  # another window took this number first
            path.open("x").close()
            return path
