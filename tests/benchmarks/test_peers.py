"""What all peers share: the sheet, its measurements, and the report of a missing peer."""

from __future__ import annotations

import importlib.util
import json
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

PEERS = Path(__file__).resolve().parents[2] / "benchmarks" / "peers"


def load(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(f"peers_{path.stem}", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look up their module there
    spec.loader.exec_module(module)
    return module


cloth = load(PEERS / "cloth.py")
peers = load(PEERS / "run.py")


def test_the_sheet_is_a_square_meter_of_fabric() -> None:
    sheet = cloth.Sheet(3, 4)
    assert sheet.masses.sum() == pytest.approx(0.2)
    a, b, c = (sheet.points[sheet.triangles[:, k]] for k in range(3))
    areas = np.cross(b - a, c - a)[:, 2] / 2  # positive: counter-clockwise from above
    assert areas == pytest.approx(1 / 12)
    assert [sheet.points[pin].tolist() for pin in sheet.pins] == [[0, 1, 0], [1, 1, 0]]


def test_a_peer_may_order_the_particles_in_any_way() -> None:
    sheet = cloth.Sheet(3, 4)
    shuffled = np.random.default_rng(0).permutation(12)
    theirs = sheet.points[shuffled]
    assert theirs[sheet.order_of(theirs)].tolist() == sheet.points.tolist()
    with pytest.raises(SystemExit, match="every point"):
        sheet.order_of(theirs[1:])


def test_strain_lowest_point_and_energy_of_a_falling_sheet(capsys: pytest.CaptureFixture[str]) -> None:
    sheet = cloth.Sheet(3, 4)
    frame = 0

    def advance() -> None:
        nonlocal frame
        frame += 1

    def positions() -> np.ndarray:  # falls at 3 m/s while its width grows by 1 % per frame
        return sheet.points * [1 + 0.01 * frame, 1, 1] + [0, 0, -3 * frame / 60]

    cloth.run("paper", "1", "none", sheet, 4, advance, positions)
    line = json.loads(capsys.readouterr().out)
    assert line["max_strain"] == pytest.approx(0.04)
    assert line["lowest"] == pytest.approx(-0.2)
    sideways = 0.6**2 * (sheet.masses * sheet.points[:, 0] ** 2).sum() / 0.2 / 2  # 0.01 x per frame is 0.6 x m/s
    assert line["kinetic_per_kg"] == pytest.approx(4.5 + sideways)
    assert line["finite"] is True


def test_a_program_that_cannot_run_is_skipped_with_its_last_line() -> None:
    with pytest.raises(peers.Skip, match=r"^RuntimeError: no flex here$"):
        peers.call([sys.executable, "-c", "raise RuntimeError('no flex here')"], 60)
    with pytest.raises(peers.Skip, match=r"more than 0\.2 s"):
        peers.call([sys.executable, "-c", "import time; time.sleep(9)"], 0.2)
    with pytest.raises(peers.Skip):
        peers.call(["no-such-program"], 1)


def test_a_peer_that_fails_does_not_stop_the_others(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    line = {"peer": "B", "version": "2", "rows": 24, "columns": 30, "setting": "x", "median_ms": 1.0, "p95_ms": 2.0}
    good = line | {"max_strain": 0.01, "lowest": -1.0, "kinetic_per_kg": 0.5, "finite": True}
    blown = line | {"max_strain": None, "lowest": None, "kinetic_per_kg": None, "finite": False}

    def environment(peer: Any) -> Path:
        if peer.name == "a":
            raise peers.Skip("no wheel for this Python")
        return Path("python")

    monkeypatch.setattr(peers, "PEERS", (peers.Peer("a", "a", ("x",)), peers.Peer("b", "b", ("x",))))
    monkeypatch.setattr(peers, "environment", environment)
    monkeypatch.setattr(peers, "measure", lambda *given: good if given[2] == 24 else blown)
    monkeypatch.setattr(sys, "argv", ["run.py", "--json", str(tmp_path / "peers.json")])
    assert peers.main() == 0
    printed = capsys.readouterr()
    assert printed.err == "a skipped: no wheel for this Python\n"
    assert "1.0 % | -1.000 m | 0.500 |" in printed.out
    assert "blew up" in printed.out
    assert json.loads((tmp_path / "peers.json").read_text()) == [good, blown]


@pytest.mark.parametrize("peer", peers.PEERS, ids=lambda peer: peer.name)
def test_every_peer_has_a_script_with_its_settings(peer: Any) -> None:
    source = (PEERS / f"{peer.name}_cloth.py").read_text()
    assert [setting for setting in peer.settings if f'"{setting}"' not in source] == []
