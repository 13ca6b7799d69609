"""The drawings and the gallery of troubles in docs are what their code draws."""

import runpy
from pathlib import Path

import cv2
import numpy as np
import pytest

PICTURES = Path(__file__).resolve().parents[2] / "docs" / "pictures"
DRAWN = runpy.run_path(str(PICTURES / "drawings.py"))
TROUBLES = runpy.run_path(str(PICTURES / "troubles.py"))
REMEDY = "something else is drawn now; make drawings, and look at it"


@pytest.mark.parametrize("name", sorted(DRAWN["DRAWINGS"]))
def test_drawings_are_as_they_are_drawn(name: str) -> None:
    assert (PICTURES / f"{name}.svg").read_bytes() == DRAWN["svg"](DRAWN["DRAWINGS"][name]), REMEDY


@pytest.mark.parametrize("name", ["ghost", "fringes", "tilt"])
def test_troubles_look_as_they_are_shown(name: str) -> None:
    """Those with the shortest runs; numbers may differ in the last digits, and with them single pixels."""
    drawn = cv2.imdecode(np.frombuffer(TROUBLES["drawn"](name), dtype=np.uint8), cv2.IMREAD_GRAYSCALE)
    kept = cv2.imread(str(PICTURES / "troubles" / f"{name}.png"), cv2.IMREAD_GRAYSCALE)
    assert drawn is not None
    assert kept is not None
    assert drawn.shape == kept.shape, REMEDY
    assert np.mean(cv2.absdiff(drawn, kept) > 60) < 0.002, REMEDY


def test_every_trouble_is_shown() -> None:
    page = (PICTURES.parent / "build.md").read_text(encoding="utf-8")
    for name in TROUBLES["TROUBLES"]:
        assert f"](pictures/troubles/{name}.png)" in page
    assert {path.stem for path in (PICTURES / "troubles").glob("*.png")} == set(TROUBLES["TROUBLES"])
