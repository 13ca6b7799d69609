"""A camera, a laser and an instrument can each be added by one entry, in a copy of the tree."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parents[3]
DRIVER = '''
from pydantic import BaseModel

from acquisition.camera import PluggedCamera


class StillSettings(BaseModel, frozen=True, extra="forbid"):
    """A camera that shows one image."""

    serial: str | None = None
    level_dn: int = 7


class StillCamera:
    def __init__(self, settings: StillSettings) -> None:
        self.settings = settings


def list_cameras() -> list[PluggedCamera]:
    return [PluggedCamera("still", "Still life", "A1", "on the table")]
'''
ENTRY = """
    "still": Driver(
        camera="acquisition.cameras.still:StillCamera",
        settings=("acquisition.cameras.still:StillSettings",),
        find="acquisition.cameras.still:list_cameras",
    ),
"""
LASER = """
class Torch:
    def __init__(self, settings):
        self.settings = settings
"""
LASER_ENTRY = '\n    "torch": "rig.control.lasers.torch:Torch",'
INSTRUMENT = """
    Description(
        kind="plumb_line",
        title="A weight on a thread",
        results="period.",
        support="a thread",
        supports=1,
        report="decay",
        start_amplitude_rad=0.1,
        end_amplitude_rad=0.01,
    ),"""
PROGRAM = """
import sys
from pathlib import Path
from typer.testing import CliRunner
from processing.errors import ConfigurationError
from rig.cli import app
from rig.instrument import make_camera
from rig.settings import load_configuration

assert "acquisition.cameras.usb3vision.camera" not in sys.modules, "drivers are imported when asked for"
settings = make_camera(load_configuration(Path("still.toml"))).settings
print(settings.level_dn, settings.serial)
print(make_camera(load_configuration(Path("still.toml"), ["camera.still.serial=B2"])).settings.serial)
for wrong in ("camera.still.levl_dn=8", "camera.driver=stil"):
    try:
        load_configuration(Path("still.toml"), [wrong])
    except ConfigurationError as error:
        print(error)
print(CliRunner().invoke(app, ["doctor"]).output)
from rig.control import make_laser

added = ["laser.kind=torch", "laser.port=p", "instrument.kind=plumb_line"]
config = load_configuration(Path("still.toml"), added)
print(type(make_laser(config.laser)).__name__, config.instrument.description().report)
print(CliRunner().invoke(app, ["init", "--instruments"]).output)
for wrong in ("laser.kind=torhc", "instrument.kind=plum_line"):
    try:
        load_configuration(Path("still.toml"), [wrong])
    except ConfigurationError as error:
        print(error)
"""


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    for package in ("rig", "acquisition", "calibration", "processing"):
        shutil.copytree(PROJECT / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__"))
    return tmp_path


def add(registry: Path, head: str, entry: str) -> None:
    text = registry.read_text(encoding="utf-8")
    assert head in text
    registry.write_text(text.replace(head, head + entry), encoding="utf-8")


def test_what_is_added_to_a_registry_is_configured_made_and_found(copy: Path) -> None:
    cameras, lasers = copy / "acquisition" / "cameras", copy / "rig" / "control" / "lasers"
    (cameras / "still.py").write_text(DRIVER, encoding="utf-8")
    add(cameras / "drivers.py", "DRIVERS: dict[str, Driver] = {", ENTRY)
    (lasers / "torch.py").write_text(LASER, encoding="utf-8")
    add(lasers / "settings.py", "LASERS: dict[str, str] = {", LASER_ENTRY)
    add(copy / "processing" / "instruments" / "descriptions.py", "_TABLE = (", INSTRUMENT)
    (copy / "still.toml").write_text(
        '[camera]\ndriver = "still"\nserial = "A1"\n[camera.still]\nlevel_dn = 9\n'
    )
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM],
        cwd=copy,
        env=os.environ | {"PYTHONPATH": str(copy)},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert lines[:2] == ["9 A1", "B2"]
    assert lines[2].endswith("camera.still.levl_dn: unknown key; did you mean level_dn?")
    assert "camera.driver = 'stil': no such driver; there are " in lines[3]
    assert "still" in lines[3]
    assert "camera  still  Still life  serial A1  on the table" in lines
    assert "Torch decay" in lines
    assert any("plumb_line" in line and "A weight on a thread: period." in line for line in lines)
    assert "laser.kind = 'torhc': unknown laser; choose one of none, controller, torch, " in lines[-2]
    assert "instrument.kind = 'plum_line': unknown instrument; choose one of plumb_line, " in lines[-1]
