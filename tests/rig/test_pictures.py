"""The pictures of README and docs, the drawings and the gallery of troubles are what is drawn now."""

import json
import runpy

import cv2
import numpy as np
import pytest

from tests.rig.drawn_pictures import CONFIGURATION, DRAWN, PICTURES, drawn_now

OTHERS = {
    f"desk-{panel}.png"
    for panel in ("align", "balance", "preflight", "measure", "alarm", "calibrate", "sessions")
}
"""Pages of the desk: docs/pictures/desk.py photographs them."""


@pytest.mark.usefixtures("figures")
def test_the_pictures_show_what_is_drawn_now() -> None:
    stated, now = json.loads(DRAWN.read_text(encoding="utf-8")), drawn_now()
    older = sorted(name for name in {*stated, *now} if stated.get(name) != now.get(name))
    assert not older, f"{', '.join(older)}: something else is drawn now; make pictures, and look at them"
    assert {path.name for path in PICTURES.glob("*.png")} - OTHERS == set(now) - {CONFIGURATION.name}


DRAWING_CODE = runpy.run_path(str(PICTURES / "drawings.py"))
TROUBLES = runpy.run_path(str(PICTURES / "troubles.py"))
REMEDY = "something else is drawn now; make drawings, and look at it"


@pytest.mark.parametrize("name", sorted(DRAWING_CODE["DRAWINGS"]))
def test_drawings_are_as_they_are_drawn(name: str) -> None:
    assert (PICTURES / f"{name}.svg").read_bytes() == DRAWING_CODE["svg"](DRAWING_CODE["DRAWINGS"][name]), (
        REMEDY
    )


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
