"""A desk that is open for hours holds no more than after one: counted in objects, not in memory."""

import json
import math
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
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
HALF_S, RATE_HZ = 1.2, 2.0
FULL_AFTER_S, LATER_S = 3600.0, 14_400.0
"""The run goes on from one hour to four."""
MORE = 8000
"""Objects by which two counts may differ. A count has some 240,000; NiceGUI keeps messages for 48 s. Of
9,000 half-cycles, 21,600 frames and 18,000 points of fits between the two none may stay."""


class ToldRun:
    """A run that lasts as long as it is told to."""

    def __init__(self, folder: Path) -> None:
        self.news = SessionNews()
        path = folder / "run-1.mcap"
        self.news.begin_run("run 1", 255, None, path)
        self.record = RecordWriter(path, time.time_ns(), deflection_unit=DeflectionUnit.PX)
        self._spot, self._frames = Spot(*[0.0] * 10, SpotFlag(0)), 0
        self.socket = OrderSocket(folder, self.news, {})
        self._random = np.random.default_rng(38)
        self._until_s, self._swings = 0.0, 0

    def go_on_until(self, until_s: float) -> None:
        """More frames, half-cycles, fits and events."""
        while self._until_s < until_s:
            end_s = min(until_s, self._until_s + 60.0)
            self._minute(end_s)
            self._until_s = end_s

    def _minute(self, end_s: float) -> None:
        time_s = np.arange(self._until_s, end_s, 1 / RATE_HZ)
        noise, none = self._random.normal(size=(2, len(time_s))), np.zeros_like(time_s)
        y = 100.0 * np.exp(-time_s / 2e4) * np.cos(math.pi * time_s / HALF_S)
        times_ns = (time_s * 1e9).astype(np.int64)
        moved = Deflections(times_ns, noise[0], y + noise[1], none, none, DeflectionUnit.PX)
        swings = []
        while self._swings * HALF_S < end_s:
            at_s, self._swings = self._swings * HALF_S, self._swings + 1
            size = 100.0 * math.exp(-at_s / 2e4)
            swings.append(HalfCycle(self._swings, int(at_s * 1e9), 0.0, size, 0.1, HALF_S, 1e-4, 0.0, 1, 0))
        row = self._spot._replace(x_px=0.0)
        numbers = range(self._frames, self._frames + len(times_ns))
        self._frames += len(times_ns)
        at = times_ns.tolist()
        self.record.write_spots(numbers, at, at, [row] * len(at), moved)
        for swing in swings:
            self.record.write_swing(swing)
        of = range(0, self._swings, -(-self._swings // 100))
        at_ns, few = [int(k * HALF_S * 1e9) for k in of], self._random.normal(size=len(of)).tolist()
        end_ns = int(end_s * 1e9)
        estimates = {key: float(self._random.normal(1.0, 0.1)) for key in ("b", "p", "c")}
        for key, value in estimates.items():
            self.record.write(RecordedEstimate(end_ns, self._swings, value, 0.1, key))
        for turn_ns, value in zip(at_ns, few, strict=True):
            point = RecordedFittedPoint(end_ns, turn_ns, value, value, value, value)
            self.record.write(point)
        self.record.write_event(end_ns, "gap", f"{self._swings} frames are missing")
        self.record.flush()
        told = {key: {"value": value, "standard_uncertainty": 0.1} for key, value in estimates.items()}
        state = {"phase": "measuring", "elapsed_s": end_s, "amplitude": float(y[-1]), "estimates": told}
        self.news.state(state, [("elapsed", f"told {end_s:.0f} s"), ("half-cycles", str(self._swings))])


class CountedDesk:
    """A desk in a process of its own that counts its objects."""

    def __init__(self, config: Path) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-m", "tests.rig.desk.counted_desk", str(config)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            cwd=ROOT,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
        )
        self.address = self._line()

    def count(self) -> dict[str, int]:
        """How many objects of each kind there are."""
        assert self.process.stdin is not None
        print(file=self.process.stdin, flush=True)
        found: dict[str, int] = json.loads(self._line())
        return found

    def _line(self) -> str:
        assert self.process.stdout is not None
        return self.process.stdout.readline().strip()


@pytest.fixture
def told_desk(desk_configuration: Callable[[str], Path]) -> Iterator[tuple[CountedDesk, ToldRun]]:
    """A desk and a run that it follows."""
    config = desk_configuration("")
    folder = config.parent / "runs" / "told"
    folder.mkdir(parents=True)
    run = ToldRun(folder)
    run.go_on_until(60.0)
    with run.socket:
        desk = CountedDesk(config)
        yield desk, run
        run.record.close()
        desk.process.kill()
        desk.process.communicate()


def test_a_desk_holds_no_more_after_four_hours_of_a_run_than_after_one(
    told_desk: tuple[CountedDesk, ToldRun], browser: HeadlessBrowser
) -> None:
    desk, run = told_desk
    with browser.another() as tab:
        page = Page(tab)
        page.open(desk.address)
        page.key("3")

        def counted(until_s: float) -> dict[str, int]:
            run.go_on_until(until_s)
            page.wait_text(f"told {until_s:.0f} s")
            return min((desk.count() for _ in range(3)), key=lambda one: (one["clients"], one["all"]))

        first = counted(FULL_AFTER_S)
        last = counted(LATER_S)
        assert last["all"] - first["all"] < MORE, {
            key: count - first.get(key, 0) for key, count in last.items() if count - first.get(key, 0) > 20
        }
        assert (last["clients"], last["elements"]) == (1, first["elements"])
