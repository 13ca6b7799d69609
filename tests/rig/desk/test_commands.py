"""The commands that the desk starts, in JSON lines: preflight alone, balance with answers."""

import io
import json
import sys
import threading
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest

from processing.errors import ConfigurationError
from rig.devices import OrderSocket, SessionNews
from rig.prepare import JsonReporter
from tests.rig.command_line import CONFIGS, SMALL, Done, rig, set_words
from tests.waiting import until

SIMULATED = CONFIGS / "demo.toml"


def lines(done: Done) -> list[dict[str, Any]]:
    return [json.loads(line) for line in done.stdout.splitlines()]


def test_preflight_alone_judges_and_records_nothing(tmp_path: Any) -> None:
    output = {"session.output": f'"{tmp_path.as_posix()}"'}
    done = rig("doctor", "--preflight", SIMULATED, "--json", *set_words({**SMALL, **output}))
    assert done.returncode == 0, done.stderr
    (table,) = [line["table"] for line in lines(done) if line["kind"] == "preflight"]
    named = {row["name"]: row for row in table}
    assert {"spot found", "exposure", "saturation", "frame rate", "disk space"} <= named.keys()
    assert all(row["ok"] for row in table)
    assert list(tmp_path.iterdir()) == []


def test_preflight_alone_says_no_go_with_a_remedy() -> None:
    # the light is far too bright
    done = rig("doctor", "--preflight", SIMULATED, *set_words({**SMALL, "simulation.optics.peak_dn": "2000"}))
    assert done.returncode == 1
    assert "no-go: " in done.stderr
    assert "lower the exposure (exposure_us)" in done.stderr


def test_balance_in_json_lines_tells_way_faults_and_advice_and_takes_answers(tmp_path: Any) -> None:
    words = {**SMALL, "balance.seconds": "16"}
    wrong = ["z 1", "x one", "x", "x 1,5", "x nan", "x 1e9", "x 1 turn"]
    answers = io.StringIO("".join(f"{line}\n" for line in [*wrong, "q"]))
    done = _balance_with(answers, words, str(tmp_path / "history.jsonl"))
    told = lines(done)
    kinds = [line["kind"] for line in told]
    assert {"trajectory", "live"} <= set(kinds)
    assert kinds[-2 * len(wrong) - 2 :] == ["found", "ask", *(["wrong", "ask"] * len(wrong))]
    for line, typed in zip((line for line in told if line["kind"] == "wrong"), wrong, strict=True):
        assert line["problem"].startswith(f"{typed!r}: should be a weight (")
    (found,) = [line for line in told if line["kind"] == "found"]
    assert found["text"]
    assert {"name", "value", "u_value", "unit", "limit", "meaning", "ok"} == set(found["faults"][0])


def test_a_line_that_turns_is_seen_in_one_measurement_and_is_no_success(tmp_path: Path) -> None:
    spin = {"simulation.axes.spin_rad_per_s": "1e-4", "session.output": f"'{tmp_path.as_posix()}'"}
    done = rig("balance", SIMULATED, *set_words({**SMALL, **spin}), typed="f\nq\n")
    assert done.returncode == 1
    assert "nothing learned yet" in done.stderr
    # the advice is given again after a turn was to be forgotten
    assert done.stdout.count("the weights are right; still out of limits: spin") == 2
    (shown, _) = [line for line in done.stdout.splitlines() if line.startswith("NO  spin")]
    # 1e-4 rad/s
    assert abs(float(shown.split()[2]) - 0.3438) < 0.005


def test_a_turn_that_is_stated_is_made_at_the_simulated_rig(tmp_path: Path) -> None:
    words = set_words({**SMALL, "balance.seconds": "16", "session.output": f"'{tmp_path.as_posix()}'"})
    done = rig("balance", SIMULATED, *words, typed="x 0.1\nq\n")
    assert done.returncode == 0, done.stderr
    # apart from what real weights teach
    history = tmp_path / "balance-history-simulated.jsonl"
    (learned,) = [line for line in map(json.loads, history.read_text().splitlines()) if "before" in line]
    assert abs(learned["after"][0] - learned["before"][0]) > 0.5, learned


def _balance_with(answers: io.StringIO, words: dict[str, str], history: str) -> Done:
    """`rig balance --json`, whose standard input has these answers."""
    read = JsonReporter.ask

    def ask(self: JsonReporter) -> str:
        with patch.object(sys, "stdin", answers):
            return read(self)

    with patch.object(JsonReporter, "ask", ask):
        return rig(
            "balance", SIMULATED, "--json", "--seed", "1", "--history-file", history, *set_words(words)
        )


def test_the_camera_is_waited_for_before_it_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A session that was stopped answers no more while its process still closes its devices."""
    pytest.importorskip("nicegui", reason="rig desk is not installed: pip install '.[desk]'")
    from rig.desk import desk as desk_module
    from rig.desk import jobs
    from rig.interruption import start_python

    ends = tmp_path / "ends"
    waits = f"import os, time\nwhile not os.path.exists({str(ends)!r}): time.sleep(0.01)"
    monkeypatch.setattr(jobs, "start_python", lambda *_, **how: start_python("-c", waits, **how))
    desk = desk_module.Desk(SIMULATED, (f'session.output="{(tmp_path / "runs").as_posix()}"',))

    def is_refused(holder: str) -> None:
        monkeypatch.setattr(desk_module, "_MAX_CAMERA_WAIT_S", 0.3)
        with pytest.raises(ConfigurationError, match=f"which {holder} has; wait, or end it first"):
            desk.free_camera("run")
        monkeypatch.setattr(desk_module, "_MAX_CAMERA_WAIT_S", 20.0)

    desk.jobs.begin("fit")
    desk.free_camera("run")
    desk.jobs.begin("balance", uses_camera=True)
    is_refused("rig balance")
    desk.lighting.off()
    desk.free_camera("run")
    assert not desk.jobs["balance"].running
    with pytest.raises(ConfigurationError, match="rig fit still runs; wait, or end it first"):
        desk.jobs.begin("fit")
    desk.follower.start()
    folder = desk.start_session({})
    is_refused("a session")
    with OrderSocket(folder, SessionNews(), {}):
        until(lambda: desk.follower.running)
    until(lambda: not desk.follower.running)
    assert desk.start_runs
    threading.Timer(0.3, ends.touch).start()
    desk.free_camera("run")
    assert not desk.start_runs
    assert not desk.start_failed
    desk.close()
    assert desk.jobs["fit"].wait(50.0)


def test_a_seed_is_for_the_simulated_rig_only() -> None:
    done = rig("balance", SIMULATED, "--seed", "3", "--set", "camera.driver=usb3vision")
    assert done.returncode == 2
    assert "--seed 3 works with the simulated rig only" in done.stderr


@pytest.mark.parametrize("words", [["--port", "70000"], ["--port", "x"]])
def test_a_port_that_is_none_is_refused(words: list[str]) -> None:
    assert rig("desk", SIMULATED, "--no-browser", *words).returncode == 2
