"""`rig doctor` and `rig camera` with the simulated rig."""

import json
import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from acquisition.camera import CameraSettings, Frame
from acquisition.cameras.simulated import SimulatedCamera
from acquisition.cameras.usb3vision import link
from acquisition.cameras.usb3vision.link import FoundCamera
from acquisition.cameras.usb3vision.node_map import FeatureReading
from acquisition.simulation.settings import SimulationSettings
from processing.errors import DeviceError
from rig.cli import app
from rig.devices import doctor as camera_checks
from rig.devices import picture as camera_picture
from rig.devices.doctor import check_usb_camera, check_usb_memory
from rig.devices.picture import feature_lines, find_exposure
from tests.acquisition.cameras.usb3vision.backend import InProcessBackend
from tests.acquisition.cameras.usb3vision.device import VisionDevice

DEMO = str(Path(__file__).resolve().parents[3] / "configs" / "demo.toml")


def spot(sigma_px: float, peak_dn: float) -> np.ndarray:
    y, x = np.mgrid[:120, :160]
    light = peak_dn * np.exp(-((x - 80.3) ** 2 + (y - 60.7) ** 2) / (2 * sigma_px**2))
    return np.rint(light + 40).astype(np.uint16)


@pytest.mark.parametrize("sigma_px", [4.0, 7.0, 12.0])
def test_sharpness_is_one_over_the_spot_size_whatever_the_brightness(sigma_px: float) -> None:
    for peak_dn in (800.0, 3000.0):
        seen = camera_picture.figures(spot(sigma_px, peak_dn), 4095)
        assert seen.sharpness_per_px * sigma_px == pytest.approx(1.0, rel=0.04)


def test_peak_and_saturation() -> None:
    image = spot(6.0, 2000.0)
    image[3, 3] = 4095  # one hot pixel is no peak, but it is saturated
    seen = camera_picture.figures(image, 4095)
    # the median of 3 x 3 lies about 1.2 px beside the top: exp(-1.2^2 / 72) = 0.98 of the light
    assert seen.peak == pytest.approx((40 + 0.98 * 2000) / 4095, rel=0.01)
    assert seen.saturated_px == 1
    assert seen.background == pytest.approx(40 / 4095)


def test_an_average_brings_noise_down_with_the_root_of_the_number() -> None:
    random = np.random.default_rng(3)
    frames = [
        Frame(random.normal(2000, 20, (100, 100)).round().astype(np.uint16), number, number, number)
        for number in range(25)
    ]
    assert camera_picture.average(frames).std() == pytest.approx(20 / 5, rel=0.05)


@pytest.mark.parametrize("exposure_us", [1.0, 20.0, 5000.0])
def test_exposure_is_found_from_far_too_dark_and_far_too_bright(exposure_us: float) -> None:
    camera = SimulatedCamera(SimulationSettings())
    info = camera.open()
    start = camera.configure(CameraSettings(exposure_us=exposure_us))
    found = find_exposure(camera, info, start, 0.7)
    assert found.peak == pytest.approx(0.7, rel=0.03)
    assert found.applied.exposure_us == found.exposure_us
    camera.start()
    frame = camera.read(5.0)
    assert frame is not None
    assert camera_picture.figures(frame.image, info.full_scale_dn).peak == pytest.approx(0.7, rel=0.06)
    camera.close()


def test_a_dark_camera_says_what_to_look_at() -> None:
    dark = SimulationSettings.model_validate({"optics": {"peak_dn": 0.0}})
    camera = SimulatedCamera(dark)
    info = camera.open()
    with pytest.raises(DeviceError, match="laser power"):
        find_exposure(camera, info, camera.configure(CameraSettings(exposure_us=100.0)))
    camera.close()


def test_devices_lists_and_says_nothing_is_there_where_it_is_so() -> None:
    done = CliRunner().invoke(app, ["doctor"])
    assert done.exit_code == 0
    assert "camera" in done.output


@pytest.mark.slow
def test_show_set_snap_focus_expose(tmp_path: Path) -> None:
    run = CliRunner().invoke
    shown = run(app, ["camera", "show", DEMO])
    assert shown.exit_code == 0
    assert "camera.exposure_us = " in shown.output
    done = run(app, ["camera", "show", DEMO, "--set", "camera.exposure_us=50"])
    assert "camera.exposure_us = 50" in done.output
    png = tmp_path / "one.png"
    done = run(
        app, ["camera", "snap", DEMO, "-o", str(png), "--average", "4", "--set", "camera.pixel_format=mono12"]
    )
    assert done.exit_code == 0
    image = cv2.imread(str(png), cv2.IMREAD_UNCHANGED)
    assert image is not None
    assert image.dtype == np.uint16, "a PNG keeps all bits"
    assert image.max() > 255
    assert "beam " in done.output
    again = run(app, ["camera", "snap", DEMO, "-o", str(png)])
    assert "not overwritten" in str(again.exception)
    done = run(app, ["camera", "align", DEMO, "--seconds", "0.5"])
    assert "sharpness" in done.output
    assert "off the crosshair" in done.output
    done = run(app, ["camera", "expose", DEMO])
    # the line can be put where it is said to belong
    assert re.search(r"^peak \d\d\.\d % of .*below \[camera\]:\nexposure_us = ", done.output)


@pytest.mark.parametrize("command", ["align", "snap"])
def test_the_noise_that_judges_a_picture_is_that_of_the_sensor(command: str, tmp_path: Path) -> None:
    noisy = ["--set", "simulation.sensor.read_noise_e=40"]
    more = ["--seconds", "0.5"] if command == "align" else ["-o", str(tmp_path / "a.png")]
    done = CliRunner().invoke(app, ["camera", command, DEMO, *more, *noisy])
    told = re.findall(r"χ²/dof ([0-9.]+)", done.output)
    assert [float(chi2) for chi2 in told] == pytest.approx([1.0] * len(told), abs=0.15)
    assert told


def test_checks_name_the_rule_and_the_port() -> None:
    found = FoundCamera("Testwerk", "T1", "7", 3, False, None)
    allowed, speed = check_usb_camera(found)
    assert not allowed.ok
    assert "rig doctor --install-udev" in allowed.remedy
    assert not speed.ok
    assert "USB 3" in speed.remedy


@pytest.fixture
def usb_camera(monkeypatch: pytest.MonkeyPatch) -> VisionDevice:
    """A USB3 Vision camera as the only one that libusb finds."""
    device = VisionDevice("EYE-7", frames_inside=100_000)
    backend = InProcessBackend(device)
    monkeypatch.setattr(link, "_libusb", lambda: backend)
    return device


USB = ["--set", "camera.driver=usb3vision", "--set", "camera.frame_rate_hz=200"]


def test_the_doctor_looks_at_a_usb_camera(usb_camera: VisionDevice, tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["doctor", DEMO, *USB, "--json"])
    checks = {
        check["name"]: check
        for check in map(json.loads, done.output.splitlines())
        if check["kind"] == "check"
    }
    assert checks["camera permission"]["ok"]
    assert "EYE-7" in checks["camera permission"]["reason"]
    assert {"camera USB speed", "frames", "clock", "processor"} <= set(checks)
    assert "lost: none" in checks["frames"]["reason"]


def test_the_doctor_explains_what_to_do_without_permission(
    usb_camera: VisionDevice, monkeypatch: pytest.MonkeyPatch
) -> None:
    (found,) = link.find_cameras()
    forbidden = replace(found, accessible=False)
    monkeypatch.setattr(link, "find_cameras", lambda backend=None: (forbidden,))
    monkeypatch.setattr(camera_checks, "find_cameras", lambda: (forbidden,))
    done = CliRunner().invoke(app, ["doctor", DEMO, *USB, "--json"])
    assert done.exit_code == 1
    checks = {check["name"]: check for check in map(json.loads, done.output.splitlines())}
    assert "rig doctor --install-udev" in checks["camera permission"]["remedy"]
    assert "no permission" in checks["camera"]["reason"]


def test_features_are_shown_with_unit_range_and_choices_and_can_be_set(usb_camera: VisionDevice) -> None:
    done = CliRunner().invoke(app, ["camera", "show", DEMO, *USB])
    assert done.exit_code == 0, done.exception
    lines = {line.split()[0]: line.split(maxsplit=1)[1] for line in done.output.splitlines()}
    assert lines["ExposureTime"].split("  ")[0].endswith(" us")
    assert lines["ExposureTime"].endswith("20 to 1000000 us")
    assert lines["Width"].endswith("8 to 1440")
    assert "one of Mono8, Mono10" in lines["PixelFormat"]
    assert lines["PayloadSize"].endswith("read-only")
    assert lines["SensorWidth"].split() == ["1440"], "a limit that is the number's own is none"
    assert lines["AcquisitionStart"] == "command"
    assert "FeatureReading" not in done.output
    done = CliRunner().invoke(app, ["camera", "show", DEMO, *USB, "--set", "camera.features.Gain=3.5"])
    assert re.search(r"^Gain +3\.5 dB ", done.output, re.MULTILINE), done.output
    done = CliRunner().invoke(app, ["camera", "show", DEMO, *USB, "--set", "camera.features.Gain=99"])
    assert "-12 to 24" in str(done.exception)


def test_a_feature_that_can_not_be_read_says_why() -> None:
    faulty = FeatureReading("Odd", "Integer", "readable and writable", problem="no register")
    raw = FeatureReading("Key", "Register", "read-only", b"\x01\xff")
    assert list(feature_lines([faulty, raw])) == ["Odd  -      no register", "Key  01 ff  read-only"]
    assert list(feature_lines([])) == []


def test_usb_memory_is_compared_with_the_frames(tmp_path: Path) -> None:
    limit = tmp_path / "usbfs_memory_mb"
    limit.write_text("16\n")
    (small,) = check_usb_memory(640 * 480, 27, limit)
    assert small.ok
    (fast,) = check_usb_memory(640 * 480, 51, limit)
    assert not fast.ok
    assert "51 frames ahead need 30 MB" in fast.reason
    (large,) = check_usb_memory(5_000_000, 4, limit)
    assert not large.ok
    assert "tee" in large.remedy


def test_the_commands_of_the_guide_run_as_they_stand(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    root = Path(DEMO).parents[1]
    lines = (root / "docs" / "cameras.md").read_text(encoding="utf-8").splitlines()
    commands = [line.split()[1:] for line in lines if line.startswith("    rig ")]
    assert len(commands) >= 6
    (tmp_path / "configs").symlink_to(root / "configs")
    monkeypatch.chdir(tmp_path)
    for words in commands:
        done = CliRunner().invoke(app, words)
        assert done.exit_code == 0, f"{words}: {done.output} {done.exception}"
    assert (tmp_path / "one-frame.png").is_file()


def test_a_snap_judges_each_spot_in_its_own_part(tmp_path: Path) -> None:
    vault = str(Path(DEMO).parent / "vault.toml")
    told = []
    for relative in ("1", "0"):
        more = ["-o", str(tmp_path / f"{relative}.png"), "--set", f"simulation.reference.relative={relative}"]
        told.append(CliRunner().invoke(app, ["camera", "snap", vault, *more]).output)
    both, alone = told
    assert re.search(r"reference: go, 1\d\d\.\d, 68\d\.\d px", both)
    assert "reference: NO-GO, none found" in alone
    # what is said of the pendulum's beam does not depend on the other's
    (beam,) = set(re.findall(r"χ²/dof [\d.]+", both))
    assert set(re.findall(r"χ²/dof [\d.]+", alone)) == {beam}
