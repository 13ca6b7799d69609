"""The report as a browser shows it: its first screen, a phone, paper; axe-core over it."""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.rig.desk.desk_page import Page
from tests.rig.desk.test_accessibility import RUN, axe
from tests.rig.view.headless_browser import headless_browser

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]
__all__ = ["axe"]
LOADED = "document.readyState === 'complete' && [...document.images].every(image => image.complete)"


@pytest.fixture(scope="module")
def page(measured_series: Path) -> Iterator[Page]:
    with headless_browser() as browser:
        found = Page(browser)
        browser.open((measured_series / "report.html").as_uri())
        found.wait(LOADED)
        yield found


def show(page: Page, media: str = "") -> None:
    """On a screen, or on paper."""
    page.browser.call("Emulation.setEmulatedMedia", media=media)


def test_verdict_and_decay_are_on_the_first_screen(page: Page) -> None:
    show(page)
    page.ask("scrollTo(0, 0)")
    for part in (".verdict", ".first .key", ".first figure img"):
        box = page.ask(
            "(r => [r.left, r.top, r.right, r.bottom])"
            f"(document.querySelector({part!r}).getBoundingClientRect())"
        )
        assert box[0] >= 0
        assert box[2] <= 1280
        assert 0 < box[3] <= 800, part
    assert "Fig. 12" in page.ask("document.querySelector('.first figcaption').innerText")
    assert "conditions" in page.ask("document.querySelector('.verdict').innerText").lower()


def test_axe_finds_nothing(page: Page, axe: str) -> None:
    show(page)
    page.ask("document.querySelectorAll('details').forEach(each => each.open = true)")
    if not page.ask("typeof axe === 'object'"):
        page.ask(axe + "; true")
    found = json.loads(page.ask(RUN))
    page.ask("document.querySelectorAll('details').forEach(each => each.open = false)")
    assert found == [], json.dumps(found, indent=1)


def test_a_phone_scrolls_downwards_only(page: Page) -> None:
    show(page)
    size = {"width": 390, "height": 844, "deviceScaleFactor": 1, "mobile": True}
    page.browser.call("Emulation.setDeviceMetricsOverride", **size)
    page.wait("innerWidth === 390")
    assert page.ask("document.documentElement.scrollWidth") <= 390
    assert (
        page.ask("getComputedStyle(document.querySelector('.first')).gridTemplateColumns.split(' ').length")
        == 1
    )
    page.browser.call(
        "Emulation.setDeviceMetricsOverride", width=1280, height=800, deviceScaleFactor=1, mobile=False
    )
    page.wait("innerWidth === 1280")


def test_paper_has_neither_hashes_nor_configuration(page: Page) -> None:
    page.ask("document.querySelectorAll('details').forEach(each => each.open = true)")
    show(page, "print")
    assert "session.max_duration_s" not in page.text()
    assert "sha256 of results.json" in page.text()
    show(page)
    assert "session.max_duration_s" in page.text(), "it is there, on the screen"
