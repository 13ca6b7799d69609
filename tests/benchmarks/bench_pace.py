"""Latency and pace of a run in real time: alone, with desk and viewer, with the camera in another process.

Run as ``python -m tests.benchmarks pace [--quick]`` from the repository. The ways are measured in turns, for
other work on the machine disturbs them; its load stands beside each figure. With ``python -m
tests.benchmarks.bench_pace --rr`` all threads of a run have the scheduler's class of real time (root), which
shows what the rig does when nothing else wants the processor.
"""

import os
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

from rig.instrument.snapshot import Snapshot
from rig.measure import run as run_module
from rig.measure.run_parts import Watcher
from rig.measure.screen import RunDisplay
from rig.orders import OrderSocket, SessionNews
from rig.settings import load_configuration
from tests.benchmarks.bench_desk import Desk
from tests.benchmarks.bench_pipeline import real_time
from tests.benchmarks.memory_camera import MemoryCamera
from tests.benchmarks.process_camera import ProcessCamera


class Case(NamedTuple):
    """Frames of a size and rate, and the figures asked of them: ms of 99 %, ms at most, cores."""

    width: int
    height: int
    rate_hz: float
    p99_ms: float
    most_ms: float
    cores: float

    def __str__(self) -> str:
        return f"{self.rate_hz:g}/s of {self.width}x{self.height}"


WAYS = ("alone", "with desk and viewer", "camera in another process")
CASES = (
    Case(640, 480, 500.0, 3.0, 20.0, float("inf")),
    Case(256, 256, 2000.0, 10.0, float("inf"), float("inf")),
    Case(640, 480, 1000.0, float("inf"), float("inf"), 0.8),
)


class Company(NamedTuple):
    """What watches the run."""

    watchers: Sequence[Watcher]
    show: Callable[[Snapshot], None]


@contextmanager
def desk_and_viewer() -> Iterator[Company]:
    """A desk that asks for ten pictures a second; the run's record is read for a Rerun file and a page."""
    with tempfile.TemporaryDirectory() as place, ExitStack() as stack:
        folder = Path(place) / "session"
        folder.mkdir()
        source = Path(place) / "rig.toml"
        source.write_text(
            f'[session]\noutput = "{place}"\n[camera]\ndriver = "simulated"\n', encoding="utf-8"
        )
        config = load_configuration(source)
        news = SessionNews(config)
        news.begin_run("benchmark", 255, None)
        display = RunDisplay("benchmark", 2.0, config.deflection_unit)

        def show(snapshot: Snapshot) -> None:
            news.state(display.values(snapshot), display.facts(snapshot))

        stack.enter_context(OrderSocket(folder, news, {}))
        stack.enter_context(Desk(source))
        yield Company([display, news], show)


def measured(case: Case, seconds: float, way: str) -> dict[str, Any]:
    """One run, with the load of the machine beside it."""
    with ExitStack() as stack:
        company = Company((), lambda _: None)
        if way == "with desk and viewer":
            company = stack.enter_context(desk_and_viewer())
        of = ProcessCamera if way == "camera in another process" else MemoryCamera
        watchers, show = company
        found = real_time(
            case.width,
            case.height,
            8,
            case.rate_hz,
            seconds,
            of=of,
            watchers=watchers,
            show=show,
            viewed=way == "with desk and viewer",
        )
    return found | {"load": os.getloadavg()[0]}


def run(quick: bool = False, real_time_class: bool = False) -> dict[str, Any]:
    """All numbers of this topic."""
    seconds, turns = (5.0, 1) if quick else (30.0, 2)
    results: dict[str, Any] = {}
    with ExitStack() as stack:
        if real_time_class:
            stack.enter_context(round_robin())
        for case in CASES:
            for _ in range(turns):
                for way in WAYS:
                    found = measured(case, seconds, way)
                    results.setdefault(f"{case}, {way}", []).append(found)
                    numbers = ", ".join(f"{key} {value:.3g}" for key, value in found.items())
                    print(f"{case}, {way}: {numbers}", flush=True)
    return results


def slowest(seconds: int) -> dict[str, list[dict[str, float]]]:
    """The first of the cases alone, twice in every way."""
    return {way: [measured(CASES[0], seconds, way) for _ in range(2)] for way in WAYS}


@contextmanager
def round_robin() -> Iterator[None]:
    """While a run is made, all threads of this process have the class of real time, as those they start."""
    original = run_module.Run.execute

    def execute(self: run_module.Run, *words: Any, **named: Any) -> Any:
        _all_threads(os.SCHED_RR, 1)
        try:
            return original(self, *words, **named)
        finally:
            _all_threads(os.SCHED_OTHER, 0)

    run_module.Run.execute = execute  # type: ignore[method-assign]
    try:
        yield
    finally:
        run_module.Run.execute = original  # type: ignore[method-assign]


def _all_threads(scheduler: int, priority: int) -> None:
    for thread in os.listdir("/proc/self/task"):
        with suppress(ProcessLookupError):
            os.sched_setscheduler(int(thread), scheduler, os.sched_param(priority))


if __name__ == "__main__":
    run("--quick" in sys.argv, "--rr" in sys.argv)
