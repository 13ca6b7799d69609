"""A session whose output has gone while hang-ups are ignored is finished all the same."""

import json
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest

from rig.devices import SessionNews
from rig.measure import measure_session, screen
from tests.rig.command_line import CONFIGS, QUICK, configured, set_words

NOHUP = (
    "import os, signal, sys; signal.signal(signal.SIGHUP, signal.SIG_IGN); "
    "os.execv(sys.executable, [sys.executable, *sys.argv[1:]])"
)


@pytest.mark.slow
def test_a_session_without_anybody_to_read_its_output_is_complete(tmp_path: Path) -> None:
    out, into = os.pipe()
    words = ["-m", "rig", "run", CONFIGS / "demo.toml", "-o", tmp_path / "out", *set_words(QUICK)]
    process = subprocess.Popen(
        [sys.executable, "-c", NOHUP, *words],
        stdin=subprocess.DEVNULL,
        stdout=into,
        stderr=into,
    )
    os.close(into)
    # whoever read it goes away: every further line is an error
    os.close(out)
    process.wait(250)
    (entry,) = json.loads((tmp_path / "out" / "session.json").read_text())["entries"]
    assert entry["state"] == "complete"
    assert (tmp_path / "out" / "results.json").exists()
    assert (tmp_path / "out" / "report.html").exists()


def test_who_watches_is_told_on_when_the_terminal_was_closed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    phases: list[str] = []
    usual = SessionNews.state

    def state(news: SessionNews, values: Mapping[str, Any], rows: Sequence[tuple[str, str]]) -> None:
        phases.append(values["phase"])
        usual(news, values, rows)

    def closed(*_: object, **__: object) -> None:
        raise BrokenPipeError

    monkeypatch.setattr(SessionNews, "state", state)
    monkeypatch.setattr(screen, "say", closed)
    values = {**QUICK, "session.max_duration_s": "3"}
    config = configured(values)
    measure_session(config, CONFIGS / "demo.toml", tmp_path / "out")
    assert phases[-1] == "done"
