"""A desk that is open for hours holds no more than after one: counted in objects, not in memory."""

import json
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("nicegui", reason="rig desk is not installed: pip install '.[desk]'")

from acquisition.record.topics import RecordedEstimate, RecordedFittedPoint
from acquisition.record.writer import RecordWriter
from processing.deflections import Deflections, DeflectionUnit
from processing.spot import Spot, SpotFlag
from processing.swing import HalfCycle
from rig.devices import OrderSocket, SessionNews
from tests.rig.desk.desk_page import Page
from tests.rig.view.headless_browser import HeadlessBrowser

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]
ROOT = Path(__file__).resolve().parents[3]
FULL_AFTER_MIN, LATER_MIN = 60, 240
FRAMES, SWINGS, POINTS = 120, 50, 100
"""Of each minute: frames, half-cycles, points of a fit."""
MORE = 8000
"""Objects by which two counts may differ. A count has some 240,000; NiceGUI keeps messages for 48 s. Of
9,000 half-cycles, 21,600 frames and 18,000 points of fits between the two none may stay."""
COUNTS = """
import gc, json, sys, threading
from collections import Counter
from nicegui import Client
from rig.cli import main

def answer():
    for _ in sys.stdin:
        gc.collect()
        found = Counter(type(one).__name__ for one in gc.get_objects())
        clients = list(Client.instances.values())
        own = {"clients": len(clients), "elements": sum(len(one.elements) for one in clients)}
        print(json.dumps({**found, "all": sum(found.values()), **own}), flush=True)

threading.Thread(target=answer, daemon=True).start()
main()
"""
"""`rig desk`, which answers a line on standard input by the number of objects that its collector knows."""


def tell_minute(news: SessionNews, record: RecordWriter, minute: int) -> None:
    """One more minute of a run: frames, half-cycles, a fit, an event."""
    begin_ns, none = minute * 60_000_000_000, np.zeros(FRAMES)
    times_ns = begin_ns + np.arange(FRAMES) * 500_000_000
    y = 100.0 * np.cos(2.6 * times_ns / 1e9)
    numbers, at = range(minute * FRAMES, (minute + 1) * FRAMES), times_ns.tolist()
    moved = Deflections(times_ns, none, y, none, none, DeflectionUnit.PX)
    record.write_spots(numbers, at, at, [Spot(*[0.0] * 10, SpotFlag(0))] * FRAMES, moved)
    for k in range(SWINGS):
        turn_ns = begin_ns + k * 1_200_000_000
        record.write_half_cycle(
            HalfCycle(minute * SWINGS + k, turn_ns, 0.0, 100.0 - 0.01 * k, 0.1, 1.2, 1e-4, 0.0, 1, 0)
        )
    end_ns = begin_ns + 60_000_000_000
    for key in ("b", "p", "c"):
        record.write(RecordedEstimate(end_ns, minute * SWINGS, 1.0 + 0.01 * minute, 0.1, key))
    for k in range(POINTS):
        record.write(RecordedFittedPoint(end_ns, k * end_ns // POINTS, *[0.1 * k] * 4))
    record.write_event(end_ns, "gap", f"{minute} frames are missing")
    record.flush()
    told = {"b": {"value": 1.0 + 0.01 * minute, "standard_uncertainty": 0.1}}
    news.state(
        {"phase": "measuring", "elapsed_s": end_ns / 1e9, "amplitude": float(y[-1]), "estimates": told},
        [("elapsed", f"told {minute + 1} min")],
    )


def test_a_desk_holds_no_more_after_four_hours_of_a_run_than_after_one(
    desk_configuration: Callable[[str], Path], browser: HeadlessBrowser
) -> None:
    config = desk_configuration("")
    folder = config.parent / "runs" / "told"
    folder.mkdir(parents=True)
    news = SessionNews()
    news.begin_run("run 1", 255, None, folder / "run-1.mcap")
    record = RecordWriter(folder / "run-1.mcap", time.time_ns(), deflection_unit=DeflectionUnit.PX)
    tell_minute(news, record, 0)
    words = [sys.executable, "-c", COUNTS, "desk", str(config), "--no-browser"]
    pipe = subprocess.PIPE
    with (
        OrderSocket(folder, news, {}),
        subprocess.Popen(
            words, stdin=pipe, stdout=pipe, stderr=subprocess.DEVNULL, text=True, cwd=ROOT
        ) as desk,
        browser.another() as tab,
    ):
        assert desk.stdin is not None
        assert desk.stdout is not None
        page = Page(tab)

        def counted(begin_min: int, end_min: int) -> dict[str, int]:
            for minute in range(begin_min, end_min):
                tell_minute(news, record, minute)
            page.wait_text(f"told {end_min} min")
            counts = []
            for _ in range(3):
                print(file=desk.stdin, flush=True)
                counts.append(json.loads(desk.stdout.readline()))
            return min(counts, key=lambda one: (one["clients"], one["all"]))

        try:
            page.open(desk.stdout.readline().strip())
            page.key("3")
            first = counted(1, FULL_AFTER_MIN)
            last = counted(FULL_AFTER_MIN, LATER_MIN)
        finally:
            record.close()
            desk.kill()
    assert last["all"] - first["all"] < MORE, {
        key: count - first.get(key, 0) for key, count in last.items() if count - first.get(key, 0) > 20
    }
    assert (last["clients"], last["elements"]) == (1, first["elements"])
