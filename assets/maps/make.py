"""Writes the maps in this folder: `python assets/maps/make.py`."""

from pathlib import Path

import numpy as np

ROWS, COLUMNS = 41, 61


def rings() -> np.ndarray:
    """Waves around the middle of a sheet, 0…1, that end at its edge, (ROWS, COLUMNS)."""
    y, x = np.meshgrid(np.linspace(-1, 1, ROWS), np.linspace(-1.5, 1.5, COLUMNS), indexing="ij")
    away = np.hypot(x, y)
    edge = np.clip(np.minimum(1 - np.abs(y), 1.5 - np.abs(x)) / 0.15, 0, 1)
    return edge * (0.5 + 0.5 * np.cos(3 * np.pi * away))


if __name__ == "__main__":
    lines = [f"{value:.3f}" for value in rings().reshape(-1)]
    (Path(__file__).parent / "rings.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
