"""Colours of the desk: every text can be read in every theme, and no colour stands anywhere else."""

import re
from pathlib import Path

import pytest

from rig.desk import page
from rig.report import html
from rig.terminal import palette

DESK = Path(page.__file__).parent
_TEXTS = ("ink", "dim", "line", "go", "warn", "no")
PAIRS = (
    *((ink, ground) for ink in _TEXTS for ground in ("ground", "card", "raised")),
    *(("on-ground", ground) for ground in ("go-ground", "no-ground", "alarm", "told")),
    ("bar-ink", "bar"),
    ("bar-dim", "bar"),
    ("bar-ink", "bar-button"),
    ("off-ink", "off"),
    ("picture-ink", "picture"),
)
"""Ink and ground of every text; 4.5 is asked."""
DRAWN = (
    *((ink, ground) for ink in ("edge", "line", "second") for ground in ("ground", "card")),
    ("edge", "raised"),
)
"""Curves, and edges of what can be filled or pressed; 3 is asked."""


def themes() -> dict[str, dict[str, str]]:
    """The colours of both themes by name."""
    found: dict[str, dict[str, str]] = {"light": {}, "dark": {}}
    text = (DESK / "static" / "theme.css").read_text("utf-8")
    for name, light, dark, both in re.findall(
        r"--([\w-]+): (?:light-dark\((#\w{6}), (#\w{6})\)|(#\w{6}));", text
    ):
        found["light"][name], found["dark"][name] = light or both, dark or both
    return found


def contrast(one: str, other: str) -> float:
    """Contrast of two ``#rrggbb`` colours as WCAG 2 defines it, 1 to 21."""
    brighter, darker = sorted((_luminance(one), _luminance(other)), reverse=True)
    return (brighter + 0.05) / (darker + 0.05)


def _luminance(colour: str) -> float:
    red, green, blue = (
        part / 12.92 if part <= 0.03928 else ((part + 0.055) / 1.055) ** 2.4
        for part in (one / 255 for one in palette.rgba(colour)[:3])
    )
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


def test_contrast_is_that_of_wcag() -> None:
    assert contrast("#000000", "#ffffff") == pytest.approx(21.0)
    assert contrast("#777777", "#ffffff") == pytest.approx(4.48, abs=0.01)


@pytest.mark.parametrize("name", ["light", "dark"])
def test_texts_and_drawings_can_be_read(name: str) -> None:
    colours = themes()[name]
    for pairs, least in ((PAIRS, 4.5), (DRAWN, 3.0)):
        dull = {pair: found for pair in pairs if (found := contrast(*(colours[one] for one in pair))) < least}
        assert dull == {}


def test_every_state_of_a_report_can_be_read_on_every_ground() -> None:
    """A report brings its own ground."""
    inks, grounds = ("ink", "soft", "accent", "good", "bad"), ("paper", "tint", "warn")
    pairs = [(html.COLOURS[ink], html.COLOURS[ground]) for ink in inks for ground in grounds]
    assert {pair: found for pair in pairs if (found := contrast(*pair)) < 4.5} == {}
    assert "body { background: var(--paper);" in html.page("", "", [])


def test_every_colour_that_is_used_has_a_name() -> None:
    names = set(themes()["dark"])
    text = "".join(path.read_text("utf-8") for path in (*DESK.rglob("*.py"), *DESK.rglob("static/*")))
    sizes = set(re.findall(r"--(head|room|aspect|small):", text))
    assert set(re.findall(r"var\(--([\w-]+)\)", text)) - {"name"} <= names | sizes


def test_panels_and_bars_have_no_colours_of_their_own() -> None:
    of_themes = DESK / "static" / "theme.css"
    for path in {*(DESK / "panels").glob("*.py"), DESK / "header.py", *(DESK / "static").iterdir()} - {
        of_themes
    }:
        found = re.findall(r"(?:: |solid )(#[0-9a-fA-F]{3,6})\b", path.read_text("utf-8"))
        assert found == [], path.name
    assert themes()["dark"]["ground"] == "#0e1113"
