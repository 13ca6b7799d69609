"""Colours of the desk: every text can be read in every theme, and no colour stands anywhere else."""

import re
from pathlib import Path

import pytest

from rig.desk import style, theme
from rig.desk.theme import DRAWN, PAIRS, THEMES, contrast

DESK = Path(theme.__file__).parent


def test_contrast_is_that_of_wcag() -> None:
    assert contrast("#000000", "#ffffff") == pytest.approx(21.0)
    assert contrast("#777777", "#ffffff") == pytest.approx(4.48, abs=0.01)


@pytest.mark.parametrize("name", THEMES)
def test_texts_and_drawings_can_be_read(name: str) -> None:
    colours = THEMES[name]
    for pairs, least in ((PAIRS, 4.5), (DRAWN, 3.0)):
        dull = {pair: found for pair in pairs if (found := contrast(*(colours[one] for one in pair))) < least}
        assert dull == {}


def test_every_theme_has_every_colour_and_every_colour_that_is_used_has_a_name() -> None:
    names = set(THEMES["dark"])
    assert all(set(colours) == names for colours in THEMES.values())
    text = "".join(path.read_text("utf-8") for path in DESK.rglob("*.py"))
    sizes = set(re.findall(r"--(head|room|aspect|small):", text))
    assert set(re.findall(r"var\(--([\w-]+)\)", text)) - {"name"} <= names | sizes


def test_panels_and_bars_have_no_colours_of_their_own() -> None:
    bars = [DESK / f"{name}.py" for name in ("safety_bar", "alarm_bar", "watchdog")]
    for path in (*(DESK / "panels").glob("*.py"), *bars):
        found = re.findall(r"(?:: |solid )(#[0-9a-fA-F]{3,6})\b", path.read_text("utf-8"))
        assert found == [], path.name
    assert "#0e1113" in style.STYLE
