"""The pictures of README and docs are not older than what the program draws."""

import json

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
