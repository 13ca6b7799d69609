"""What the desk costs a session that records 500 frames/s: frames lost, share of a core, delay of the page.

Run as ``python -m tests.benchmarks desk [--quick]`` from the repository. The same run from memory is made
alone, then with a desk that asks for news and for ten pictures a second, in turns: the machine is noisy.
"""

import http.client
import os
import subprocess
import sys
import tempfile
import threading
import time
import urllib.parse
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from rig.desk.sessions import SessionIndex
from rig.instrument.snapshot import Snapshot
from rig.measure.screen import RunDisplay
from rig.measure.session_file import RunEntry, RunState, SessionState
from rig.orders import OrderSocket, SessionNews
from rig.settings import load_configuration
from tests.benchmarks.bench_pipeline import real_time
from tests.benchmarks.desk_in_browser import first_paint_s, random_use
from tests.rig.desk.desk_page import Page
from tests.rig.view.headless_browser import headless_browser

RATE_HZ, WIDTH, HEIGHT = 500.0, 640, 480
PICTURES_HZ = 10.0


def run(quick: bool = False) -> dict[str, Any]:
    """All numbers of this topic."""
    seconds, turns = (6.0, 1) if quick else (30.0, 3)
    alone, watched = [], []
    for _ in range(turns):
        alone.append(measured(seconds, desk=False))
        watched.append(measured(seconds, desk=True))
    results = {
        "frames": sum(one["frames"] for one in watched),
        "lost with a desk": sum(one["dropped"] for one in watched),
        "lost alone": sum(one["dropped"] for one in alone),
        "cores alone": float(np.median([one["cores"] for one in alone])),
        "cores with a desk": float(np.median([one["cores"] for one in watched])),
        "share of a core, the channel's own": float(np.median([one["own_cores"] for one in watched])),
        "pictures/s seen": float(np.median([one["pictures_hz"] for one in watched])),
        "latency p99 alone, ms": float(np.median([one["latency_p99_ms"] for one in alone])),
        "latency p99 with a desk, ms": float(np.median([one["latency_p99_ms"] for one in watched])),
        "a picture at the desk, ms": float(np.median([one["picture_ms"] for one in watched])),
        "cores of the desk itself": float(np.median([one["desk_cores"] for one in watched])),
    }
    results |= with_a_page(seconds if quick else 2 * seconds)
    found, rows_s, read_s = search_s(5_000 if quick else 100_000)
    results |= {
        "sessions searched": found,
        "a search of them, s": rows_s,
        "reading them all once, s": read_s,
        "first paint, s": first_paint_s(),
        **random_use(200 if quick else 10_000),
    }
    for name, value in results.items():
        print(f"{name:<36} {value:.4g}" if isinstance(value, int | float) else f"{name:<36} {value}")
    return results


def with_a_page(seconds: float) -> dict[str, Any]:
    """What desk and channel take, by processor time, while a browser shows Measure of 500 frames/s.

    Memory is compared between the first and the last third: a page that is just opened still grows.
    """
    one = measured(seconds, desk=True, page=True)
    return {
        "with a page: frames lost": one["dropped"],
        "with a page: cores of the desk": one["desk_cores"],
        "with a page: cores of the channel": one["own_cores"],
        "with a page: cores of both": one["desk_cores"] + one["own_cores"],
        "with a page: pictures/s seen": one["pictures_hz"],
        "with a page: memory of the desk, MiB": one["desk_mib"],
        "with a page: it has grown by, MiB": one["grown_mib"],
        "with a page: heap of the page has grown by, MiB": one["page_grown_mib"],
    }


def search_s(sessions: int) -> tuple[int, float, float]:
    """How many sessions there are, the longest of some searches, and the first reading of all of them."""
    with tempfile.TemporaryDirectory() as place:
        for number in range(sessions):
            folder = Path(place) / f"2026-{number:06d}-rig"
            folder.mkdir()
            state = SessionState(
                source="rig.toml",
                runs_wanted=1,
                configuration={"session": {"sample": f"sample {number % 97}", "operator": "A. Person"}},
                entries=(RunEntry(number=1, record="run-1.mcap", state=RunState.COMPLETE),),
            )
            (folder / "session.json").write_text(state.model_dump_json(), encoding="utf-8")
        index = SessionIndex(Path(place))
        began_s = time.monotonic()
        index.look()
        read_s = time.monotonic() - began_s
        took_s = []
        for words in ("", "sample 13", "nobody", "person complete 004242"):
            began_s = time.monotonic()
            page = index.page(None, words, first=20)
            took_s.append(time.monotonic() - began_s)
        return page.all, max(took_s), read_s


def measured(seconds: float, *, desk: bool, page: bool = False) -> dict[str, Any]:
    """One run; with a `desk` in a process of its own, which asks for pictures as a browser does.

    `page`: a real browser shows the page, and nothing else asks.
    """
    with tempfile.TemporaryDirectory() as place, ExitStack() as stack:
        folder = Path(place) / "session"
        folder.mkdir()
        source = Path(place) / "rig.toml"
        source.write_text(
            f'[session]\noutput = "{place}"\n[camera]\ndriver = "simulated"\n', encoding="utf-8"
        )
        config = load_configuration(source)
        session_news = SessionNews(config)
        session_news.begin_run("benchmark", 255, None)
        display = RunDisplay("benchmark", 2.0, config.deflection_unit)

        def show(snapshot: Snapshot) -> None:
            session_news.state(display.values(snapshot), display.facts(snapshot))

        stack.enter_context(OrderSocket(folder, session_news, {}))
        answering = stack.enter_context(own_time(OrderSocket, "_answer"))
        keeping = stack.enter_context(own_time(SessionNews, "block"))
        looking = stack.enter_context(Desk(source, page=page)) if desk else None
        found = real_time(WIDTH, HEIGHT, 8, RATE_HZ, seconds, watchers=[display, session_news], show=show)
        if looking is not None:
            found |= {
                "own_cores": (answering[0] + keeping[0]) / seconds,
                "pictures_hz": session_news.pictures / seconds,
                "picture_ms": float(np.median(looking.took_ms)) if looking.took_ms else np.nan,
                "desk_cores": looking.cores,
            }
            if page:
                found |= looking.memory()
        return found


@contextmanager
def own_time(kind: type, name: str) -> Iterator[list[float]]:
    """Processor time in s that a method of a class takes in all threads, as the one number of a list."""
    original, spent_s = getattr(kind, name), [0.0]

    def timed(*words: Any) -> Any:
        began_s = time.thread_time()
        found = original(*words)
        spent_s[0] += time.thread_time() - began_s
        return found

    setattr(kind, name, timed)
    try:
        yield spent_s
    finally:
        setattr(kind, name, original)


class Desk:
    """`rig desk` in a process, and a thread that asks it for pictures, or a page that does."""

    def __init__(self, source: Path, *, page: bool = False) -> None:
        self.took_ms: list[float] = []
        self._source, self._with_page = source, page
        self._held: list[tuple[float, float]] = []
        self._opened = ExitStack()
        self._ended = threading.Event()

    def __enter__(self) -> "Desk":
        self._process = subprocess.Popen(
            [sys.executable, "-m", "rig", "desk", str(self._source), "--no-browser"],
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )
        assert self._process.stdout is not None
        self._address = urllib.parse.urlsplit(self._process.stdout.readline().strip())
        if self._with_page:
            page = Page(self._opened.enter_context(headless_browser()))
            page.open(self._address.geturl())
            page.key("4")
            page.wait("document.getElementById('amplitude').offsetParent !== null")
            self._page = page
        self._began = time.monotonic(), self._busy_s()
        self._thread = threading.Thread(target=self._weigh if self._with_page else self._look, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()
        self._opened.close()
        self._process.kill()
        self._process.communicate()

    @property
    def cores(self) -> float:
        """What the desk itself took since it was opened."""
        began_s, busy_s = self._began
        return (self._busy_s() - busy_s) / (time.monotonic() - began_s)

    def memory(self) -> dict[str, float]:
        """Of the desk in MiB, and by how much it and the page's heap were larger in the last third."""
        held = np.array(self._held)
        third = max(1, len(held) // 3)
        grown = np.median(held[-third:], axis=0) - np.median(held[third : 2 * third], axis=0)
        return {
            "desk_mib": float(np.median(held[-third:, 0])),
            "grown_mib": float(grown[0]),
            "page_grown_mib": float(grown[1]),
        }

    def _weigh(self) -> None:
        while not self._ended.wait(1.0):
            pages = int(Path(f"/proc/{self._process.pid}/statm").read_text().split()[1])
            # what is only waiting to be collected is no growth
            self._page.browser.call("HeapProfiler.collectGarbage")
            heap = self._page.browser.call("Runtime.getHeapUsage")["usedSize"]
            self._held.append((pages * os.sysconf("SC_PAGE_SIZE") / 2**20, heap / 2**20))

    def _busy_s(self) -> float:
        words = Path(f"/proc/{self._process.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")

    def _look(self) -> None:
        key = urllib.parse.parse_qs(self._address.query)["key"][0]
        headers = {"Cookie": f"rig_desk_{self._address.port}={key}"}
        connection = http.client.HTTPConnection("127.0.0.1", self._address.port or 0, timeout=10)
        due_s = time.monotonic()
        while not self._ended.wait(max(0.0, due_s - time.monotonic())):
            due_s = max(due_s + 1 / PICTURES_HZ, time.monotonic())
            asked_s = time.monotonic()
            connection.request("GET", "/picture?width=800&height=540", headers=headers)
            connection.getresponse().read()
            self.took_ms.append(1e3 * (time.monotonic() - asked_s))
