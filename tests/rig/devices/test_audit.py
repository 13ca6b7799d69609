"""The audit log: what happened to the light, and who did it; it follows no link and stops nothing."""

import json
import sys
from io import StringIO
from pathlib import Path
from typing import Any

import pytest

from processing.errors import DeviceError
from rig.control import LightRefused, TripCause, run_in_thread
from rig.control.simulated import SimulatedBoard
from rig.devices import AuditEntry, Devices, SessionNews
from rig.devices.audit import AUDIT_NAME, AuditLog
from rig.measure.session_orders import await_acknowledgement
from rig.settings import Configuration, load_configuration
from tests.rig.command_line import CONFIGS
from tests.rig.control.wires import pull_cable
from tests.waiting import until


class Terminal(StringIO):
    """Somebody at a keyboard."""

    def isatty(self) -> bool:
        return True


def lines_of(folder: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (folder / AUDIT_NAME).read_text().splitlines()]


def tripped(folder: Path) -> Devices:
    config = Configuration(camera={"driver": "simulated"}, session={"operator": "Ada"})
    devices = Devices(config, folder, "rig run")
    devices.permit.trip(TripCause.INTERLOCK, "the interlock of the controller opened")
    return devices


def test_a_trip_is_acknowledged_by_its_number_and_that_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    devices, session_news = tripped(tmp_path), SessionNews()
    monkeypatch.setattr(sys, "stderr", Terminal())
    # nothing that is less than the number and Enter, then the word and Enter
    for typed in ("\n", "y\n\n", "yes\n\n", "a\n\n", "2\n\n", "", "01x\n\n"):
        monkeypatch.setattr(sys, "stdin", Terminal(typed))
        with pytest.raises(LightRefused, match="nobody has acknowledged it"):
            await_acknowledgement(devices, session_news)
        with pytest.raises(LightRefused, match=r"trip 1 \(INTERLOCK\).*turn its key, then start again"):
            devices.light()
    monkeypatch.setattr(sys, "stdin", Terminal("1\nlight\n"))
    await_acknowledgement(devices, session_news)
    assert not devices.permit.latched
    lines = lines_of(tmp_path)
    trip, latch, *refused, last = lines
    assert {line["what"] for line in refused} == {"refused"}
    assert (trip["what"], trip["cause"], trip["lit"]) == ("trip", "INTERLOCK", False)
    assert [latch[key] for key in ("what", "cause", "number", "lit")] == ["latch", "INTERLOCK", 1, False]
    said = [last[key] for key in ("what", "operator", "by", "task")]
    assert said == ["acknowledge", "Ada", "terminal", "rig run"]
    assert last["why"] == "trip 1 (INTERLOCK): the interlock of the controller opened"
    assert last["utc"].endswith("+00:00")


def test_an_interlock_is_not_acknowledged_while_it_is_open_or_its_controller_silent(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    closed, pulled = True, False
    monkeypatch.setattr(SimulatedBoard, "interlock_closed", lambda _: closed)
    pull_cable(monkeypatch, lambda: pulled)
    config = load_configuration(
        CONFIGS / "live.toml", ("camera.driver=simulated", "laser.kind=controller", "laser.max_power_w=0.001")
    )
    with Devices(config, tmp_path) as devices:
        with pytest.raises(DeviceError, match="trip 1 cannot be acknowledged: nothing is latched"):
            devices.acknowledge(1, "test")
        # nothing is lit: it latches all the same
        closed = False
        until(lambda: bool(devices.permit.latched))
        with pytest.raises(DeviceError, match="the controller's interlock is still open: close it"):
            devices.acknowledge(1, "test")
        closed = True
        control = devices.required_control("this test")
        until(lambda: control.snapshot.status is not None and control.snapshot.status.interlock_closed)
        with pytest.raises(DeviceError, match="trip 7 cannot be acknowledged: latched is trip 1"):
            devices.acknowledge(7, "test")
        assert devices.acknowledge(1, "test").endswith("the interlock of the controller opened: acknowledged")
        closed = False
        until(lambda: bool(devices.permit.latched))
        pulled = True
        until(lambda: control.snapshot.status is None)
        with pytest.raises(
            DeviceError, match="the controller does not answer, so its cause may still be present"
        ):
            devices.acknowledge(2, "test")
    said = [line["what"] for line in lines_of(tmp_path)]
    assert said == ["trip", "latch", "acknowledge", "trip", "latch"]


def test_a_log_that_leads_elsewhere_is_not_followed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.write_text("a file of somebody else")
    (tmp_path / "audit.jsonl").symlink_to(elsewhere)
    devices = Devices(Configuration(camera={"driver": "simulated"}), tmp_path)
    devices.audit(AuditEntry.WEIGHT, "as advised")
    devices._log.wait()
    assert elsewhere.read_text() == "a file of somebody else"
    assert "audit.jsonl: the audit log cannot be written" in capsys.readouterr().err


def test_a_line_that_was_cut_costs_no_other(tmp_path: Path) -> None:
    log = AuditLog(tmp_path, "Ada", "test")
    log.append(AuditEntry.LIT, "asked for")
    log.append(AuditEntry.DARK, "trip 1")
    log.wait()
    path = tmp_path / AUDIT_NAME
    path.write_bytes(path.read_bytes()[:-20])
    log.append(AuditEntry.LIT, "asked for again")
    log.wait()
    first, cut, last = path.read_text().splitlines()
    assert json.loads(first)["why"] == "asked for"
    assert json.loads(last)["why"] == "asked for again"
    assert not cut.endswith("}")


def test_who_watches_is_told_what_the_next_run_waits_for(tmp_path: Path) -> None:
    devices, session_news = tripped(tmp_path), SessionNews()
    session_news.news()
    waiting = run_in_thread(await_acknowledgement, devices, session_news)
    until(lambda: "waits for a person" in session_news.news()["state"].get("progress", ""))
    assert "trip 1 (INTERLOCK)" in session_news.news()["state"]["progress"]
    devices.acknowledge(1, "the desk")
    devices.permit.request_light()
    waiting.result(30.0)
