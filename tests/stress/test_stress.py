"""The command `stress`: a few cases, what it reports, and that it can fail."""

import importlib
import json
import signal
import subprocess
import sys
from dataclasses import replace
from functools import partial
from math import inf
from pathlib import Path

import numpy as np
import pytest

from taichi_cloth import cli
from taichi_cloth.errors import WrongUse
from taichi_cloth.mesh.from_scene import topology_of
from taichi_cloth.scene.model import SOLVER_NAMES, Ground, Limit, SelfCollision, Solver, Sphere, Tear
from taichi_cloth.stress import catalogue, report
from taichi_cloth.stress.catalogue import CASES, Case
from taichi_cloth.stress.running import Outcome, Result, deaf_children, run_all, run_case
from taichi_cloth.stress.scenes import sheet
from taichi_cloth.stress.setting import ROBUST, SETTINGS, Setting
from taichi_cloth.stress.springs import long_run
from taichi_cloth.stress.starts import flattened
from taichi_cloth.stress.touching import went_through
from taichi_cloth.stress.trial import Trial, close
from taichi_cloth.stress.watch import Broken

SMALL = Setting("xpbd", Solver("xpbd", 10, 2), cells=8)
QUICK = (2, 4, 5, 6, 8, 12, 30)  # cases that need no kernels but those of a sheet that hangs


@pytest.mark.parametrize("case", [case for case in CASES if case.number in QUICK], ids=lambda case: case.name)
def test_a_small_sheet_is_alive(case: Case) -> None:
    result = run_case(case, SMALL, 1, None)
    assert result.alive, result.failed[0].failure


@pytest.mark.long
@pytest.mark.parametrize("start", [0, 1], ids=["hanging", "swinging"])
def test_a_hundred_thousand_frames(start: int) -> None:
    try:
        long_run(Trial(SETTINGS["robust"], start), frames=100_000)
    finally:
        close()


@pytest.mark.long
def test_a_knotted_sheet_is_at_rest() -> None:
    """What docs/stability.md says of sheets that went through themselves: no method opens them while springs push."""
    trial = Trial(replace(SETTINGS["robust"], compression=1.0), 1)
    try:
        with pytest.raises(Broken, match="strain 5 s after"):
            flattened(trial)
        knotted = trial.simulation.measure().max_strain
        assert knotted > 2 * trial.most_strain
        trial.simulation.change_solver("spring")
        for _ in range(1200):
            trial.simulation.advance_frame()
        assert trial.simulation.measure().max_strain == pytest.approx(knotted, rel=0.01)
        assert np.abs(trial.simulation.velocities()).max() < 0.02
    finally:
        close()


@pytest.mark.long
def test_slack_threads_come_to_rest_where_they_would_anyhow() -> None:
    """The same start as above, and a sheet that was never disturbed: their energy has one valley."""
    ends = []
    try:
        for disturbed in (False, True):
            trial = Trial(SETTINGS["robust"], 1)
            if disturbed:
                flattened(trial)
            else:
                trial.open(sheet(trial.cells))
                trial.start()
                trial.run(10.0)
            ends.append(trial.simulation.positions())
    finally:
        close()
    assert ends[0] == pytest.approx(ends[1], abs=1e-3)


def test_there_are_forty_and_reasons_name_settings() -> None:
    assert [case.number for case in CASES] == list(range(1, 41))
    assert len({case.name for case in CASES}) == 40
    assert list(SETTINGS) == [*SOLVER_NAMES, "robust"]
    assert {name for case in CASES for name in case.beyond} <= set(SETTINGS)


def test_the_dearest_settings_run_first() -> None:
    assert max(SETTINGS.values(), key=lambda setting: setting.cost) == ROBUST


def test_chosen() -> None:
    assert [(c.number, s.name) for c, s in catalogue.chosen("yank", None)] == [(29, name) for name in SETTINGS]
    assert [(c.number, s.name) for c, s in catalogue.chosen("29", "robust")] == [(29, "robust")]
    assert len(catalogue.chosen(None, None)) == 40 * 7
    with pytest.raises(WrongUse, match="no case 'yak': 1 stiffness sweep, 2 "):
        catalogue.chosen("yak", None)
    with pytest.raises(WrongUse, match="goes with --only 32"):
        catalogue.chosen("31", None, long=True)
    [(case, _)] = catalogue.chosen("32", "lines", long=True)
    assert isinstance(case.run, partial)
    assert case.run.keywords == {"frames": 1_000_000}


def test_a_setting_keeps_what_is_the_scenes() -> None:
    scene = sheet(4, spheres=(Sphere(),), ground=Ground(), damping=0.7)
    robust = Setting("r", Solver("lines", 3, 1, damping=0.5), limit_sweeps=7, swept=True).of(scene)
    assert robust.solver == Solver("lines", 3, 1, damping=0.7)
    assert robust.limit is None
    assert robust.fabric == scene.fabric
    slack = Setting("r", Solver("lines"), compression=0.3)
    assert slack.of(scene).fabric == replace(scene.fabric, compression=0.3)
    assert slack.of(slack.of(scene)) == slack.of(scene)
    touching = replace(scene, self_collision=SelfCollision(thickness=0.01))
    assert Setting("r", Solver("lines"), untangle=True).of(touching).self_collision == SelfCollision(
        0.01, untangle=True
    )
    assert Setting("r", Solver("lines"), untangle=True).of(scene).self_collision is None
    assert Setting("r", Solver("lines"), stick=True).of(touching).self_collision == SelfCollision(0.01, stick=True)
    assert robust.ground is not None
    assert (robust.ground.swept, robust.spheres[0].swept) == (True, True)
    limited = replace(scene, limit=Limit(0.2), solver=replace(scene.solver, damping=0.0))
    kept = Setting("r", Solver("lines", damping=9.0), limit_sweeps=7).of(limited)
    assert (kept.limit, kept.solver.damping) == (Limit(0.2, sweeps=7), 0.0)  # without damping it stays
    assert Setting("r", Solver("lines", damping=9.0)).of(scene).solver.damping == 9.0


def pulled_apart(trial: Trial) -> None:
    trial.open(sheet(8, pins=("top", "bottom")))
    trial.start()
    pins = trial.simulation.positions()[trial.simulation.topology.pinned]
    trial.move_pins(np.where(pins[:, 1:2] < 0, pins - [0.0, 1.0, 0.0], pins), 0.5)
    trial.settle()


def test_a_sheet_that_tears_is_alive_and_need_not_be_still() -> None:
    tearing = SMALL.tearing(0.3)
    scene = tearing.of(sheet(8))
    assert (tearing.name, scene.tear, scene.fabric.bending) == ("xpbd tear 0.3", Tear(0.3), 0.0)
    case = Case(1, "pulled apart", "", pulled_apart)
    result = run_case(case, tearing, 1, None)
    assert result.alive, result.failed[0].failure
    [torn] = [figure.value for figure in result.outcomes[0].figures if figure.what == "torn [%]"]
    assert torn / 100 * topology_of(scene, "fabric").spring_count >= 9  # one thread in each column
    [outcome] = run_case(case, SMALL, 1, None).outcomes  # whole, it stays twice as long
    assert outcome.failure is not None
    assert outcome.failure.what == "strain 5 s after"


def test_who_can_tear() -> None:
    able = [name for name in SETTINGS if name != "lines"]
    assert [s.name for _, s in catalogue.chosen("29", None, tear=0.5)] == [f"{name} tear 0.5" for name in able]
    with pytest.raises(
        WrongUse, match="lines needs a grid of whole rows, and one that tears loses its rows: take verlet"
    ):
        catalogue.chosen("29", "lines", tear=0.5)


def breaks(trial: Trial) -> None:
    trial.open(sheet(8), rest=inf)
    trial.start()
    trial.run(0.1)
    trial.tell("way [m]", 3.0)
    if trial.number:
        raise Broken("something", 2.0, 1.0)


def broken_case(**beyond: str) -> Case:
    return Case(1, "test", "nothing", breaks, beyond)


def results(tmp_path: Path, **beyond: str) -> list[Result]:
    return [run_case(broken_case(**beyond), SMALL, 2, tmp_path / "pictures")]


def test_the_report(tmp_path: Path) -> None:
    [result] = found = results(tmp_path, xpbd="it is made to")
    assert [outcome.failure is None for outcome in result.outcomes] == [True, False]
    path = tmp_path / "pictures" / "01_test_xpbd_1.png"
    assert path.read_bytes().startswith(b"\x89PNG")
    line = f"1 test fails with xpbd (starts 1): something 2, not 1 in frame 6 of start 1; it is made to; {path}"
    assert report.failures(found) == [line]
    assert report.count(found) == "xpbd 0 alive, 1 failed"
    assert report.matrix(found) == [["case", "what", "xpbd"], ["1 test", "nothing", "**1/2**"]]
    assert report.cells(result)[2] == "1/2"
    assert report.cells(result)[-1] == "way [m] 3"
    report.write_json(tmp_path / "o.json", found)
    [row] = json.loads((tmp_path / "o.json").read_text(encoding="utf-8"))["results"]
    assert (row["case"], row["alive"], row["reason"]) == (1, False, "it is made to")
    assert row["starts"][1]["failure"] == {"frame": 6, "what": "something", "value": 2.0, "bound": 1.0}
    report.write_markdown(tmp_path / "o.md", found)
    text = (tmp_path / "o.md").read_text(encoding="utf-8")
    assert "| 1 test | nothing | **1/2** |" in text
    assert "it is made to" in text
    assert f'`[solver] name = "{ROBUST.solver.name}"`' in text
    assert str(path) not in text  # pictures are not part of the document


def test_what_goes_through_a_ball() -> None:
    before = np.array([[0.0, 0.0, 1.0], [0.04, 0.0, 1.0], [0.06, 0.0, 1.0], [0.0, 0.0, 0.2], [0.2, 0.0, 0.1]])
    after = np.array([[0.0, 0.0, -1.0], [0.04, 0.0, -9.0], [0.06, 0.0, -1.0], [0.0, 0.0, 0.1], [-0.2, 0.0, 0.1]])
    assert [went_through(b[None], a[None], 0.1) for b, a in zip(before, after, strict=True)] == [1, 1, 0, 0, 0]


def test_a_run_that_was_cut_says_so() -> None:
    outcome = Outcome(0, None, 12, True, 1.0, 0.0, 0.0, 0.0, 0.0, [])
    assert report.cells(Result(broken_case(), "xpbd", [outcome, replace(outcome, frames=300, cut=False)]))[7] == "12+"


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    words = ["stress", "--only", "1", "--starts", "2", "--json", "o.json"]
    monkeypatch.setattr(catalogue, "CASES", (broken_case(),))
    monkeypatch.setattr(catalogue, "SETTINGS", {"xpbd": SMALL})
    assert cli.main(words) == 0  # only the robust setting must survive
    told = capsys.readouterr().out
    assert "1 test fails with xpbd (starts 1): something 2, not 1 in frame 6 of start 1; it should not; " in told
    assert told.rstrip().endswith("xpbd 0 alive, 1 failed")
    assert list((tmp_path / "out" / "stress").iterdir())
    assert cli.main(words) == 2
    assert "o.json exists already: use --force" in capsys.readouterr().err
    monkeypatch.setattr(catalogue, "SETTINGS", {"robust": replace(SMALL, name="robust")})
    assert cli.main([*words, "--force"]) == 1


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["--only", "41"], "no case '41': 1 stiffness sweep, "),
        (["--long"], "--long is about the long run: it goes with --only 32"),
        (["--markdown", "no/where.md"], "no is no folder to write where.md into"),
        (["--markdown", "o.md", "--tear", "0.5"], "--tear has no part in it"),
        (["--solver", "lines", "--tear", "0.5"], "lines needs a grid of whole rows"),
    ],
)
def test_wrong_use_is_one_line(
    words: list[str], line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert cli.main(["stress", *words]) == 2
    assert line in capsys.readouterr().err


def test_an_unknown_solver_and_a_wrong_number_of_starts(capsys: pytest.CaptureFixture[str]) -> None:
    for words in (["--tear", "nan"], ["--solver", "robst"], ["--starts", "0"]):
        with pytest.raises(SystemExit) as ended:
            cli.main(["stress", *words])
        assert ended.value.code == 2
    assert "did you mean 'robust'?" in capsys.readouterr().err


@pytest.mark.skipif(sys.platform == "win32", reason="Windows passes no signals on")
def test_processes_that_run_cases_do_not_hear_ctrl_c() -> None:
    ask = [sys.executable, "-c", "import signal; print(signal.getsignal(signal.SIGINT) is signal.SIG_IGN)"]
    before = signal.getsignal(signal.SIGINT)
    with deaf_children():
        assert subprocess.check_output(ask, text=True) == "True\n"
    assert signal.getsignal(signal.SIGINT) is before
    assert subprocess.check_output(ask, text=True) == "False\n"


def test_what_ends_its_process_is_told_and_takes_no_other_with_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Processes are handed the module path, and import what they run."""
    (tmp_path / "ways_to_end.py").write_text(
        "import os\n\ndef lives(trial):\n    trial.frame = 3\n\ndef dies(trial):\n    os._exit(3)\n", encoding="utf-8"
    )
    monkeypatch.syspath_prepend(tmp_path)
    ways = importlib.import_module("ways_to_end")
    cases = [Case(k, way, "", getattr(ways, way)) for k, way in enumerate(("lives", "dies", "lives", "lives"), 1)]
    told: list[str] = []
    results = run_all([(case, SMALL) for case in cases], 2, None, told.append)
    assert [result.alive for result in results] == [True, False, True, True]
    assert [len(result.outcomes) for result in results] == [2, 1, 2, 2]
    assert sorted(told) == ["1 lives, xpbd", "2 dies, xpbd", "3 lives, xpbd", "4 lives, xpbd"]
    assert report.failures(results) == [
        "2 dies fails with xpbd (starts 0): times that its process ended 2, not 0 in frame 0 of start 0; it should not"
    ]
