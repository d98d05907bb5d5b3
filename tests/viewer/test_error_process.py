"""Errors of frames measured by another process: it follows the running scene, and a failure delays nothing."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from taichi_cloth.geometry.scene_loader import load_scene
from taichi_cloth.scene import Scene
from taichi_cloth.simulation.copies import FrameErrorMeter, FrameStart
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.viewer import error_process
from taichi_cloth.viewer.error_process import ABANDON, Answer, ErrorProcess, Job, Measurer

pytestmark = pytest.mark.usefixtures("serial_layout")

MAX_FRAMES = 20_000  # until an answer must have come; a frame waits for 10 ms


def scene(**changes: Any) -> Scene:
    return load_scene("drape15", **({"rows": 6, "columns": 7} | changes))


@pytest.fixture
def process(monkeypatch: pytest.MonkeyPatch) -> Iterator[ErrorProcess]:
    """It measures the third frame of a scene, and has no pause after a change."""
    monkeypatch.setattr(error_process, "FRAMES_BEFORE", 2)
    monkeypatch.setattr(error_process, "SETTLED_SECONDS", 0.0)
    process = ErrorProcess()
    yield process
    process.close()


@pytest.fixture
def measurer() -> Iterator[Measurer]:
    with closing(Measurer()) as measurer:
        yield measurer


def run_until_answered(process: ErrorProcess, simulation: Simulation) -> Answer:
    for _ in range(MAX_FRAMES):
        process.run_frame(simulation)
        if process.answer is not None:
            return process.answer
        time.sleep(0.01)
    pytest.fail("no answer")


def job_of(simulation: Simulation) -> Job:
    start = FrameStart.of(simulation)
    simulation.step()
    return Job(simulation.scene, "serial", start, simulation.positions())


def test_an_answer_that_comes_after_the_cloth_has_changed_is_dropped(process: ErrorProcess) -> None:
    class Pipe:
        def poll(self) -> bool:
            return True

        def recv(self) -> Answer:
            return Answer(growth=1.0)

        def send(self, message: object) -> None:
            pass

        def close(self) -> None:
            pass

    with Simulation(scene()) as simulation:
        for change, known in (
            (lambda: None, True),
            (simulation.reset, True),  # the owner tells it with `forget`
            (process.forget, False),
            (lambda: simulation.switch_solver("xpbd"), False),
            (lambda: None, True),
        ):
            process.run_frame(simulation)  # knows the scene
            process.answer = None
            process._pipe, process._is_busy, process._is_stale = Pipe(), True, False  # type: ignore[assignment]
            process._frames = -10
            change()
            process.run_frame(simulation)
            assert (process.answer is not None) == known
            assert not process._is_busy


def test_a_frame_of_an_earlier_scene_is_given_up(process: ErrorProcess, monkeypatch: pytest.MonkeyPatch) -> None:
    """It may compile for a minute. A process that works for the scene that runs goes on."""

    class Pipe:
        sent = 0

        def poll(self) -> bool:
            return False

        def send(self, message: object) -> None:
            self.sent += isinstance(message, Job)

        def close(self) -> None:
            pass

    pipe = Pipe()
    process._pipe = pipe  # type: ignore[assignment]
    ended = []
    monkeypatch.setattr(process, "close", lambda: ended.append(process))
    with Simulation(scene()) as simulation:
        while not pipe.sent:
            process.run_frame(simulation)
        monkeypatch.setattr(error_process, "STALE_SECONDS", 0.0)
        process.forget()  # a slider moved
        process.run_frame(simulation)
        assert not ended
        simulation.switch_solver("xpbd")
        process.run_frame(simulation)
        assert ended


def test_nothing_is_measured_while_a_slider_moves(process: ErrorProcess, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(error_process, "SETTLED_SECONDS", 0.3)
    monkeypatch.setattr(error_process, "FRAMES_BEFORE", 0)
    now = [100.0]
    monkeypatch.setattr(error_process.time, "perf_counter", lambda: now[0])
    process._frames = 1
    assert process.is_free
    for _ in range(20):  # for two seconds
        process.forget()
        now[0] += 0.1
        assert not process.is_free
    now[0] += 0.25
    assert process.is_free
    process._next = now[0] + 5.0  # of the share of time
    process.forget()
    assert process._next == now[0] + 5.0


def test_a_change_abandons_the_measurement_that_is_under_way(process: ErrorProcess) -> None:
    class Pipe:
        def __init__(self) -> None:
            self.sent: list[object] = []
            self.answers: list[Answer] = []

        def poll(self) -> bool:
            return bool(self.answers)

        def recv(self) -> Answer:
            return self.answers.pop()

        def send(self, message: object) -> None:
            self.sent.append(message)

        def close(self) -> None:
            pass

    pipe = Pipe()
    process._pipe = pipe  # type: ignore[assignment]
    with Simulation(scene()) as simulation:
        process.forget()
        assert pipe.sent == []  # nothing is under way
        while not pipe.sent:
            process.run_frame(simulation)
        for _ in range(3):  # a slider moves
            process.forget()
            process.run_frame(simulation)
        assert len(pipe.sent) == 2
        assert pipe.sent[1] == ABANDON
        pipe.answers = [Answer(error=None)]
        process.run_frame(simulation)  # the next frame is measured at once
        assert process.answer is None
        assert isinstance(pipe.sent[2], Job)
        assert process.state == "being measured (0 s)"
        process._sent -= 8.0
        pipe.answers = [Answer(growth=1.0)]
        process.run_frame(simulation)
        process._sent, process.answer = process._sent - 2.0, None
        assert process.state == "being measured (2 s of about 8 s)"


def test_an_abandoned_measurement_ends_before_its_next_frame_and_the_next_is_whole(measurer: Measurer) -> None:
    with Simulation(scene()) as simulation:
        job = job_of(simulation)
        whole = measurer.answer(job)
        frames: list[int] = []

        def is_abandoned() -> bool:
            frames.append(1)
            return len(frames) == limit

        with closing(Measurer(is_abandoned)) as other:
            for limit in (2, 20):  # in the measurement, and in the second that follows it
                frames.clear()
                assert other.answer(job).error is None
                assert len(frames) == limit
            limit = 0
            again = other.answer(job)
    assert whole.error is not None
    assert again.error is not None
    np.testing.assert_allclose(again.error.by_particle, whole.error.by_particle, rtol=0.02, atol=1e-6)
    assert again.growth == pytest.approx(whole.growth, rel=0.02)


def test_the_process_measures_the_frame_after_a_change_soon(process: ErrorProcess) -> None:
    with Simulation(scene()) as simulation:
        run_until_answered(process, simulation)
        for _ in range(3):
            process._next = 0.0
            while not process._is_busy:
                process.run_frame(simulation)
            simulation.reset()
            process.forget()
        assert run_until_answered(process, simulation).error is not None


def test_another_process_measures_the_errors_of_the_scenes_that_run(process: ErrorProcess) -> None:
    for running in (scene(), scene(substeps=20)):
        with (
            Simulation(running) as simulation,
            Simulation(running) as alone,
            closing(FrameErrorMeter(running)) as meter,
        ):
            answer = run_until_answered(process, simulation)
            assert answer.error is not None
            alone.step(answer.error.frame - 1)
            assert answer.error.error == pytest.approx(meter.measure_frame(alone).error, rel=1e-3)
            alone.step(simulation.frame - alone.frame)
            np.testing.assert_array_equal(simulation.positions(), alone.positions())


def test_a_scene_that_is_too_stiff_for_the_reference_is_refused_until_the_scene_changes(measurer: Measurer) -> None:
    with Simulation(scene(warp=1e9, weft=1e9, width=0.4, area_density=0.001)) as simulation:
        refused = measurer.answer(job_of(simulation))
    assert refused.error is None
    assert refused.is_final
    assert refused.refusal.startswith("drape15: explicit needs")
    with Simulation(scene()) as simulation:
        assert measurer.answer(job_of(simulation)).refusal == ""


def test_a_reference_that_is_too_slow_or_diverges_is_refused(
    measurer: Measurer, monkeypatch: pytest.MonkeyPatch
) -> None:
    with Simulation(scene()) as simulation:
        job = job_of(simulation)
        diverged = measurer.answer(replace(job, after=np.full_like(job.after, np.inf)))
        monkeypatch.setattr(error_process, "MAX_SECONDS", 0.0)
        slow = measurer.answer(job)
        monkeypatch.setattr(error_process, "MAX_SECONDS", 1e9)
        again = measurer.answer(job)
    assert diverged.refusal.endswith("diverges")
    assert slow.refusal.startswith("its reference takes 0.")
    assert slow.growth is None
    assert again.refusal == ""  # another frame, or fewer iterations, may be measured
    assert not diverged.is_final
    assert not slow.is_final
    process = ErrorProcess()
    for answer in (slow, diverged):  # the picture shows no error that the panel does not
        assert answer.error is not None
        process.answer = answer
        assert process.error is None
    process.answer = again
    assert process.error is again.error


def test_growth_is_measured_if_there_is_time(measurer: Measurer, monkeypatch: pytest.MonkeyPatch) -> None:
    with Simulation(scene()) as simulation:
        job = job_of(simulation)
        monkeypatch.setattr(error_process, "MAX_GROWTH_SECONDS", 1e9)
        whole = measurer.answer(job)
        assert whole.error is not None
        assert whole.growth is not None
        assert whole.growth > whole.error.error
        assert whole.seconds > whole.error.seconds
        monkeypatch.setattr(error_process, "MAX_GROWTH_SECONDS", 0.0)
        assert measurer.answer(job).growth is None


def test_compiling_does_not_count_as_time_that_a_measurement_took(
    measurer: Measurer, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = [0.0]

    class Meter:
        def growth(self, start: FrameStart) -> float:
            now[0] += 0.5
            return 0.1

        def close(self) -> None:
            pass

    def measure(job: Job) -> Answer:
        now[0] += 20.0  # of which compiling takes nearly all
        measurer._meter = Meter()  # type: ignore[assignment]
        return Answer(error=found.error, seconds=0.01)

    with Simulation(scene()) as simulation:
        job = job_of(simulation)
        found = measurer.answer(job)
        monkeypatch.setattr(error_process.time, "process_time", lambda: now[0])
        monkeypatch.setattr(measurer, "measure", measure)
        monkeypatch.setattr(error_process, "MAX_GROWTH_SECONDS", 1e9)
        assert measurer.answer(job).seconds == pytest.approx(0.51)


def test_the_panel_tells_when_the_next_frame_is_measured(
    process: ErrorProcess, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(error_process.time, "perf_counter", lambda: 100.0)
    assert process.state == "not measured yet"
    process._next = 112.0
    assert process.state == "not measured yet: the next in 12 s"


def test_a_refused_scene_is_not_sent_again(process: ErrorProcess, monkeypatch: pytest.MonkeyPatch) -> None:
    sent: list[Job] = []
    monkeypatch.setattr(process, "_send", sent.append)
    with Simulation(scene()) as simulation:
        for _ in range(4):
            process.run_frame(simulation)
        assert len(sent) == 2  # FRAMES_BEFORE are not
        process.answer = Answer(refusal="takes too long")
        process.run_frame(simulation)
        assert len(sent) == 3
        process.answer = Answer(refusal="too stiff", is_final=True)
        process.run_frame(simulation)
        assert len(sent) == 3
    with Simulation(scene()) as simulation:
        process.run_frame(simulation)
        assert process.answer is None
        assert len(sent) == 4


def test_measuring_takes_a_tenth_of_the_time(process: ErrorProcess, monkeypatch: pytest.MonkeyPatch) -> None:
    now = [100.0]
    monkeypatch.setattr(error_process.time, "perf_counter", lambda: now[0])

    class Pipe:
        sent = 0

        def poll(self) -> bool:
            return True

        def recv(self) -> Answer:
            return Answer(seconds=0.2)

        def send(self, job: Job) -> None:
            self.sent += 1

        def close(self) -> None:
            pass

    pipe = Pipe()
    monkeypatch.setattr(process, "_pipe", pipe)
    with Simulation(scene()) as simulation:
        for _ in range(100):
            process.run_frame(simulation)
            now[0] += 0.1
    assert pipe.sent == 5  # every 2 s: an answer comes a frame after its job, and the next job 1.8 s later


def test_a_process_that_has_died_is_reported_and_delays_nothing(process: ErrorProcess) -> None:
    with Simulation(scene()) as simulation:
        run_until_answered(process, simulation)
        assert process._process is not None
        process._process.kill()
        process._process.join()
        process.answer, process._next = None, 0.0
        answer = run_until_answered(process, simulation)
        assert answer.refusal.startswith("the process that measures it has ended")
        frame = simulation.frame
        process.run_frame(simulation)
        assert simulation.frame == frame + 1


def test_closing_ends_the_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(error_process, "SETTLED_SECONDS", 0.0)
    process = ErrorProcess()
    process.close()
    with Simulation(scene()) as simulation:
        process._frames = error_process.FRAMES_BEFORE
        process.run_frame(simulation)
        child = process._process
        assert child is not None
        assert child.is_alive()
        process.close()
        child.join(10)
        assert not child.is_alive()
