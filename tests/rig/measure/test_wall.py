"""Nothing that only watches can end a run: all of it fails here, and the run comes to its end."""

import contextlib
from pathlib import Path
from typing import Any

import pytest

from acquisition.record.events import EventKind
from processing.balance import BalanceEstimator
from processing.swing import TurningPointDetector
from rig.instrument import ObserverGuard
from rig.measure import readings, record_plainly
from rig.measure.posterior import LivePosterior
from rig.measure.screen import RunDisplay
from tests.rig.command_line import CONFIGS, SMALL, configured, events_of

WATCHERS = {
    "watcher RunDisplay": (RunDisplay, "take"),
    "the display": (RunDisplay, "show"),
    "the live fit": (LivePosterior, "take"),
    "the estimate of the balance": (BalanceEstimator, "update"),
    "the watch for steps": (readings.StepEvents, "take"),
}


def measured(tmp_path: Path) -> list[tuple[str, str]]:
    """Events of a run of ten seconds."""
    stated = {**SMALL, "session.max_duration_s": "10", "preflight.when": '"never"'}
    config = configured(stated | {"session.stop_when": '["u(b)/b < 1e-9"]'})
    with contextlib.suppress(SystemExit, ValueError):
        record_plainly(config, CONFIGS / "demo.toml", tmp_path / "run.mcap")
    return events_of(tmp_path / "run.mcap")


def test_what_only_watches_ends_no_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """All of it fails at once."""

    def fails(*_: object, **__: object) -> None:
        raise ValueError("an array of the wrong shape")

    for kind, method in WATCHERS.values():
        monkeypatch.setattr(kind, method, fails)
    events = measured(tmp_path)
    assert events[-1] == (EventKind.STOP, "time limit of 10 s reached")
    told = [text for kind, text in events if kind == EventKind.WATCHER_FAILED]
    (in_all,) = [text for text in told if text.startswith("in all: ")]
    for name in WATCHERS:
        assert told.count(f"{name} has failed, the run goes on: ValueError: an array of the wrong shape") == 1
        assert name in in_all
    assert sum("has failed" in text for text in told) == len(WATCHERS)


def test_an_error_of_what_measures_ends_the_run_and_the_record_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    usual, calls = TurningPointDetector.update, 0

    def fails(detector: TurningPointDetector, *args: Any) -> Any:
        nonlocal calls
        calls += 1
        if calls == 5:
            raise ValueError("no shape fits")
        return usual(detector, *args)

    monkeypatch.setattr(TurningPointDetector, "update", fails)
    events = measured(tmp_path)
    assert [kind for kind, _ in events[-2:]] == [EventKind.FAILED, EventKind.STOP]
    assert "no shape fits" in events[-1][1]


def test_a_wall_retries_counts_and_leaves_out() -> None:
    wall = ObserverGuard()
    calls = 0

    def sometimes(fails: bool) -> int:
        nonlocal calls
        calls += 1
        if fails:
            raise RuntimeError("now and then")
        return 7

    assert wall.call("it", 0, sometimes, True) == 0
    assert wall.call("it", 0, sometimes, False) == 7
    for _ in range(30):
        wall.call("it", 0, sometimes, True)
    assert calls == 12
    assert wall.text == "it 11 times"
    assert len(wall.take_news()) == 2
    assert wall.take_news() == []
