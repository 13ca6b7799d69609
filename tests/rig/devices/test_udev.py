"""`rig doctor --install-udev`: one file of rules, from what the drivers themselves look for."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from acquisition.cameras.usb3vision.link import VISION_CLASS, VISION_SUBCLASS
from rig.control.lasers import thorlabs4000
from rig.devices import udev_rules
from tests.rig.command_line import CONFIGS, rig

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="udev is a part of Linux")
NAME = "70-optical-pendulum-rig.rules"


def test_the_rules_match_what_the_drivers_open() -> None:
    rules = udev_rules()
    assert f":{VISION_CLASS:02x}{VISION_SUBCLASS:02x}*" in rules
    assert f'ATTRS{{idVendor}}=="{thorlabs4000.USB_VENDOR:04x}"' in rules
    for line in rules.splitlines():
        assert line.startswith("#") or re.fullmatch(
            r'(?:[A-Z]+(?:\{\w+\})?(?:==|=|\+=)"[^"]+"(?:, |$))+', line
        ), line
    # where systemd grants what the tag asks for
    assert int(NAME.partition("-")[0]) < 73


def test_it_is_written_to_a_folder_and_again(tmp_path: Path) -> None:
    for _ in range(2):
        done = rig("doctor", "--install-udev", "--udev-folder", tmp_path)
        assert (done.returncode, done.stdout) == (0, f"{tmp_path / NAME}\n")
        assert "plug the devices in again" in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == [NAME]
    assert (tmp_path / NAME).read_text() == udev_rules()
    assert (tmp_path / NAME).stat().st_mode & 0o777 == 0o644


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_who_may_not_write_there_is_told_the_one_command(tmp_path: Path) -> None:
    tmp_path.chmod(0o555)
    done = rig("doctor", "--install-udev", "--udev-folder", tmp_path)
    assert done.returncode == 1
    assert "only root may write it: sudo " in done.stderr


def test_a_folder_or_a_configuration_that_is_missing_is_refused(tmp_path: Path) -> None:
    done = rig("doctor", "--install-udev", "--udev-folder", tmp_path / "none")
    assert (done.returncode, done.stdout) == (2, "")
    done = rig("doctor", "--preflight")
    assert done.returncode == 2
    assert "need the configuration to check" in done.stderr
    assert rig("doctor", CONFIGS / "none.toml").returncode == 2


def test_udev_finds_no_fault(tmp_path: Path) -> None:
    udevadm = shutil.which("udevadm")
    listed = udevadm and subprocess.run([udevadm, "--help"], capture_output=True, text=True, check=False)
    if not listed or "verify" not in listed.stdout:
        pytest.skip("udevadm verify, of systemd 254 or later, is not installed")
    (tmp_path / NAME).write_text(udev_rules())
    # a group that this machine lacks is no fault of the rules
    done = subprocess.run(
        [udevadm, "verify", "--resolve-names=never", tmp_path / NAME],
        capture_output=True,
        text=True,
        check=False,
        timeout=30,
    )
    assert done.returncode == 0, done.stdout + done.stderr
