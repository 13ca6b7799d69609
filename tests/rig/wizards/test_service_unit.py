"""`rig service`: units that systemd accepts, in any folder, and that light nothing by themselves."""

import configparser
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from rig.settings import shipped
from rig.wizards import write_unit
from tests.rig.command_line import rig

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="systemd is a part of Linux")
PLAN = '[[series]]\nname = "one"\nconfig = "mine.toml"\nruns = 1\n'


@pytest.fixture
def odd_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with what systemd would otherwise take for its own language."""
    folder = tmp_path / 'a %h "night" $HOME'
    folder.mkdir()
    shutil.copy(shipped("demo"), folder / "mine.toml")
    (folder / "night.toml").write_text(PLAN)
    monkeypatch.chdir(folder)
    return folder


def section(path: Path) -> configparser.SectionProxy:
    read = configparser.RawConfigParser(strict=True)
    read.read(path)
    return read["Service"]


def test_a_session_survives_its_desk_and_a_night_is_started_by_a_person(odd_folder: Path) -> None:
    done = rig("service", "desk", "mine.toml", "-o", "units")
    assert (done.returncode, done.stdout) == (0, "units/rig-desk.service\n")
    assert "systemctl --user enable --now rig-desk.service" in done.stderr
    desk = section(Path("units/rig-desk.service"))
    assert desk["KillMode"] == "process"
    assert desk["ExecStart"].endswith(" --no-browser --port 8642")
    assert rig("service", "night", "night.toml", "-o", "units").returncode == 0
    unit = Path("units/rig-night@.service").read_text()
    night = section(Path("units/rig-night@.service"))
    assert "Restart" not in night
    assert "[Install]" not in unit
    assert "Timer" not in unit
    assert int(night["TimeoutStopSec"]) > 60


def test_a_unit_that_says_something_else_stays(odd_folder: Path) -> None:
    write_unit("desk", Path("mine.toml"), Path("units"), 8642)
    assert write_unit("desk", Path("mine.toml"), Path("units"), 8642).is_file()
    done = rig("service", "desk", "mine.toml", "-o", "units", "--port", "8643")
    assert done.returncode == 2
    assert "is not overwritten" in done.stderr
    assert rig("service", "night", "none.toml", "-o", "units").returncode == 2


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is not installed")
@pytest.mark.parametrize(("service", "file", "name"), [
    ("desk", "mine.toml", "rig-desk.service"),
    ("night", "night.toml", "rig-night@2026-11-26.service"),
])  # fmt: skip
def test_systemd_finds_no_fault(service: str, file: str, name: str, odd_folder: Path) -> None:
    units = odd_folder.parent / "units"
    assert rig("service", service, file, "-o", units).returncode == 0
    done = subprocess.run(
        ["systemd-analyze", "--user", "verify", "--man=no", units / name],
        capture_output=True,
        text=True,
        check=False,
        timeout=30,
        env={"XDG_RUNTIME_DIR": str(odd_folder.parent), "PATH": "/usr/bin:/bin"},
    )
    # whatever it says of units of the system itself
    mine = [line for line in done.stderr.splitlines() if "rig-" in line]
    assert (done.returncode, mine) == (0, [])
