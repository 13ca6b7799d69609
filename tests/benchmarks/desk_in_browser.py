"""The desk in a real browser: when the first page is painted, and ten thousand random clicks and keys."""

import contextlib
import os
import random
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from tests.rig.desk.conftest import RIG
from tests.rig.desk.desk_page import DeskProcess, Page, desk_page
from tests.rig.view.headless_browser import HeadlessBrowser, headless_browser

WATCH = """
window.rigErrors = [];
addEventListener('error', event => rigErrors.push(String(event.message)));
addEventListener('unhandledrejection', event => rigErrors.push(String(event.reason)));
const say = console.error;
console.error = (...words) => { rigErrors.push(words.join(' ')); say(...words); };
"""
KEYS = "123456zov?+- abcxyz"
SEED = 38
_LOOK_EVERY = 50


@contextlib.contextmanager
def a_desk() -> Iterator[tuple[HeadlessBrowser, Path, DeskProcess, Page]]:
    """A desk of the simulated rig at rest, and a browser."""
    with tempfile.TemporaryDirectory() as place, headless_browser() as browser:
        config = Path(place) / "rig.toml"
        config.write_text(RIG.replace("OUTPUT", f"{place}/runs"), encoding="utf-8")
        os.environ["PYTHONPATH"] = str(Path(__file__).resolve().parents[2])
        with desk_page(browser, config) as (desk, page):
            yield browser, Path(place), desk, page


def first_paint_s(times: int = 5) -> float:
    """Median time from the request to the first contentful paint, of pages whose scripts are cached."""
    with a_desk() as (_, _, _, page):
        found = []
        for _ in range(times):
            page.ask("location.reload()")
            time.sleep(0.3)
            painted = page.wait("performance.getEntriesByName('first-contentful-paint')[0]?.startTime")
            found.append(1e-3 * float(painted))
        return sorted(found)[times // 2]


def random_use(count: int, seed: int = SEED) -> dict[str, Any]:
    """Clicks on anything and random keys, all from a seed: errors of the page, and whether it was ever lit.

    LIGHT OFF and what opens another tab are left out; the clicks are no pointer's, and must light nothing.
    """
    chosen = random.Random(seed)
    with a_desk() as (_, place, desk, page):
        page.ask(WATCH)
        lit = done = 0
        errors: list[str] = []
        for number in range(count):
            if chosen.random() < 0.5:
                page.ask(
                    "(() => { const all = [...document.querySelectorAll('button, .q-tab, input, .q-checkbox, "
                    ".q-expansion-item .q-item')].filter(one => one.offsetParent && one.id !== 'light-off'); "
                    f"const one = all[Math.floor({chosen.random()} * all.length)]; "
                    "one?.click(); one?.focus?.(); })()"
                )
            else:
                page.type(chosen.choice(KEYS))
            done += 1
            if number % _LOOK_EVERY == _LOOK_EVERY - 1:
                errors += page.ask("rigErrors.splice(0)") or []
                lit += bool(page.ask("/laser on/.test(document.getElementById('safety').innerText)"))
        begun = list(place.glob("runs/*/run-*.mcap"))
        return {
            "random clicks and keys": done,
            "errors in the page": len(errors),
            "first errors": errors[:3],
            "looks with light": lit,
            "records begun": len(begun),
            "the desk lives": desk.runs,
            "lines in its log": desk.said(),
        }
