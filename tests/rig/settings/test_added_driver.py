"""A camera driver that somebody adds: one file and one entry, tried in a copy of the tree."""

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
print(CliRunner().invoke(app, ["devices"]).output)
"""


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    for package in ("rig", "acquisition", "calibration", "processing"):
        shutil.copytree(PROJECT / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__"))
    return tmp_path


def test_an_added_driver_has_a_section_a_serial_number_and_is_found(copy: Path) -> None:
    cameras = copy / "acquisition" / "cameras"
    (cameras / "still.py").write_text(DRIVER)
    registry = (cameras / "drivers.py").read_text()
    head = "DRIVERS: dict[str, Driver] = {"
    assert head in registry
    (cameras / "drivers.py").write_text(registry.replace(head, head + ENTRY))
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
