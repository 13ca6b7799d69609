"""The audit log: what was acknowledged, by whom; it follows no link and stops nothing."""

import json
import sys
from io import StringIO
from pathlib import Path

import pytest

from processing.errors import DeviceError
from rig.channel import SessionNews
from rig.control import Interlock
from rig.control.simulated import SimulatedBoard
from rig.devices import Devices
from rig.measure.session_orders import acknowledge_interlock
from rig.settings import Configuration, load_configuration
from tests.rig.command_line import CONFIGS
from tests.rig.control.test_service import until


class Terminal(StringIO):
    """Somebody at a keyboard."""

    def isatty(self) -> bool:
        return True


def test_an_interlock_is_acknowledged_by_a_person_and_that_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = Configuration(camera={"driver": "simulated"}, session={"operator": "Ada"})
    devices, session_news = Devices(config, tmp_path), SessionNews(config)
    devices.permit.begin()
    devices.permit.interlock_opened(Interlock.CONTROLLER)
    monkeypatch.setattr(sys, "stderr", Terminal())
    monkeypatch.setattr(sys, "stdin", Terminal("no\nyes\n"))
    with pytest.raises(DeviceError, match="nobody has allowed light again"):
        acknowledge_interlock(devices, session_news)
    assert not (tmp_path / "audit.jsonl").exists()
    acknowledge_interlock(devices, session_news)
    assert not devices.permit.unacknowledged
    line = json.loads((tmp_path / "audit.jsonl").read_text())
    assert (line["what"], line["operator"]) == ("interlock acknowledged", "Ada")
    assert line["opened"] == "the interlock of the controller opened"
    assert line["utc"].endswith("+00:00")


def test_an_interlock_is_not_acknowledged_while_it_is_open(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    closed = True
    monkeypatch.setattr(SimulatedBoard, "interlock_closed", lambda _: closed)
    config = load_configuration(
        CONFIGS / "live.toml", ("camera.driver=simulated", "laser.kind=controller", "laser.max_power_w=0.001")
    )
    with Devices(config, tmp_path) as devices:
        assert devices.acknowledge() == "no interlock waits for an acknowledgement"
        devices.permit.begin()
        closed = False
        until(lambda: bool(devices.permit.unacknowledged))
        with pytest.raises(DeviceError, match="the controller's interlock is still open: close it"):
            devices.acknowledge()
        closed = True
        control = devices.required_control("this test")
        until(lambda: control.snapshot.status is not None and control.snapshot.status.interlock_closed)
        assert devices.acknowledge() == "the interlock of the controller opened: acknowledged"
    assert len((tmp_path / "audit.jsonl").read_text().splitlines()) == 1


def test_a_log_that_leads_elsewhere_is_not_followed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.write_text("a file of somebody else")
    (tmp_path / "audit.jsonl").symlink_to(elsewhere)
    Devices(Configuration(camera={"driver": "simulated"}), tmp_path).audit("weight turned")
    assert elsewhere.read_text() == "a file of somebody else"
    assert "audit.jsonl: the audit log cannot be written" in capsys.readouterr().err
