"""The aravis driver with Aravis's fake GigE camera; run by test_camera.py in a network namespace."""

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from acquisition.camera import Camera, CameraLost, CameraSettings, Frame, FrameTimeout, PixelFormat
from acquisition.cameras import drivers
from acquisition.cameras.aravis.camera import AravisCamera
from acquisition.cameras.aravis.library import find_cameras, load_library
from acquisition.cameras.drivers import AravisSettings
from acquisition.frames.losses import BlockNumbers, LossCause
from processing.errors import DeviceError
from rig.devices.clocks import wait_for_network_clock
from rig.devices.frame_stream import FrameStream
from tests.acquisition.cameras.aravis.fake_camera import SERIAL, FakeCamera
from tests.acquisition.cameras.conformance import CameraConformance, Unplug

# At this exposure and gain the fake camera's ramp is not stretched: pixel (x, y) is x + y + id, modulo 255.
PLAIN = CameraSettings(width_px=64, height_px=48, exposure_us=10_000.0, gain_db=0.0, frame_rate_hz=100.0)
PATIENCE_S = 60.0


def wait_for_camera() -> None:
    """Until the fake camera answers."""
    deadline_s = time.monotonic() + PATIENCE_S
    while not find_cameras():
        assert time.monotonic() < deadline_s, "the fake camera does not answer"


def begin(camera: AravisCamera) -> None:
    """Plain frames from now on."""
    camera.open()
    camera.configure(PLAIN)
    camera.start()


@contextmanager
def pulled_out(fake: FakeCamera) -> Iterator[None]:
    """Without the camera, which answers again at the end."""
    fake.pull_out()
    try:
        yield
    finally:
        fake.plug_in()
        wait_for_camera()


@pytest.fixture(scope="module")
def fake() -> Iterator[FakeCamera]:
    """A camera for all tests that leave it whole."""
    fake = FakeCamera()
    wait_for_camera()
    yield fake
    fake.pull_out()


@pytest.fixture
def camera(fake: FakeCamera) -> Iterator[AravisCamera]:
    camera = AravisCamera()
    yield camera
    camera.close()


class Triggered(AravisCamera):
    """Waits for a software trigger that does not come."""

    def configure(self, settings: CameraSettings) -> CameraSettings:
        applied = super().configure(settings)
        features = self._open_device()
        features.select_continuous = lambda: features.camera.set_trigger("Software")  # type: ignore[method-assign]
        return applied


class TestConformance(CameraConformance):
    PIXEL_FORMATS: ClassVar[tuple[PixelFormat, ...]] = ("mono8", "mono16")
    WRONG_FORMAT: ClassVar[PixelFormat | None] = "mono12"
    APPLIES: ClassVar[dict[str, float]] = {
        "exposure_us": 2000.0,
        "gain_db": 2.0,
        "frame_rate_hz": 50.0,
        "width_px": 320,
    }
    SKIPS_WHEN_SLOW = True

    @pytest.fixture
    def camera(self, camera: AravisCamera) -> Camera:
        return camera

    @pytest.fixture
    def blocked_camera(self, fake: FakeCamera) -> Iterator[Camera]:
        camera = Triggered()
        yield camera
        camera.close()

    @pytest.fixture
    def unplugged(self, fake: FakeCamera) -> Iterator[tuple[Camera, Unplug]]:
        camera = AravisCamera()
        yield camera, fake.pull_out
        camera.close()
        fake.plug_in()
        wait_for_camera()


def check_ramps(frames: list[Frame]) -> None:
    """Every pixel is as the fake camera draws it, every frame one step further."""
    rows, columns = np.indices(frames[0].image.shape)
    start = int(frames[0].image[0, 0]) - frames[0].sequence
    for frame in frames:
        assert np.array_equal(frame.image, (rows + columns + start + frame.sequence) % 255)


def test_frames_come_whole_while_their_ids_roll_over(
    fake: FakeCamera, monkeypatch: pytest.MonkeyPatch
) -> None:
    fake.pull_out()
    fake.plug_in()  # its ids begin again, some hundred frames before they roll over
    wait_for_camera()
    ids: list[int] = []
    number = BlockNumbers.number

    def noted(self: BlockNumbers, frame_id: int, lost: LossCause) -> int | None:
        ids.append(frame_id)
        return number(self, frame_id, lost)

    monkeypatch.setattr(BlockNumbers, "number", noted)
    camera = AravisCamera()
    begin(camera)
    frames: list[Frame] = []
    while not ids or ids[-1] > 60_000 or ids[-1] < 50:
        frame = camera.read(5.0)
        assert frame is not None
        frames.append(frame)
    status = camera.status
    camera.close()
    assert 65_000 < ids[0] < 65_535
    numbers = [frame.sequence for frame in frames]
    assert numbers[-1] - numbers[0] == 65_535 - ids[0] + ids[-1]
    assert numbers[-1] + 1 - len(frames) == status.dropped
    check_ramps(frames)


def test_packets_that_are_lost_make_frames_that_are_counted(fake: FakeCamera) -> None:
    fake.pull_out()
    lossy = FakeCamera(lost_per_thousand=20)
    wait_for_camera()
    camera = AravisCamera()
    try:
        begin(camera)
        frames = []
        while not frames or frames[-1].sequence < 200:
            frame = camera.read(10.0)
            assert frame is not None
            frames.append(frame)
        status = camera.status
    finally:
        camera.close()
        lossy.pull_out()
        fake.plug_in()
        wait_for_camera()
    # six packets a frame, each lost with 2 %: one frame in nine
    assert status.dropped == frames[-1].sequence + 1 - len(frames)
    assert status.dropped > 5
    assert status.dropped_by_camera == 0
    check_ramps(frames)


def test_frames_that_a_late_reader_loses_are_ours(
    fake: FakeCamera, camera: AravisCamera, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("acquisition.cameras.aravis.camera.buffer_count", lambda *_: 2)
    begin(camera)
    assert camera.read(5.0) is not None
    deadline_s = time.monotonic() + PATIENCE_S
    while camera._stream.get_info_uint64_by_name("n_underruns") < 100:
        assert time.monotonic() < deadline_s, "two buffers are never too few"
        time.sleep(0.05)
    frames = [camera.read(5.0) for _ in range(5)]
    status = camera.status
    camera.close()
    assert all(frames)
    assert status.dropped_by_host > 0


def test_the_run_goes_on_when_the_camera_comes_back(fake: FakeCamera, camera: AravisCamera) -> None:
    begin(camera)
    stream = FrameStream(camera, PLAIN)
    assert stream.begin() is not None
    events: list[tuple[str, str]] = []
    frames: list[Frame] = []

    def take_until(done: Callable[[], bool], what: str) -> None:
        deadline_s = time.monotonic() + PATIENCE_S
        while not done():
            assert time.monotonic() < deadline_s, f"{what} did not happen: {events}, {stream.ended}"
            frames.extend(stream.take(64, 0.1))
            events.extend(stream.take_events())

    take_until(lambda: len(frames) > 20, "frames")
    events.clear()
    fake.pull_out()
    take_until(lambda: "camera lost" in dict(events), "the loss")
    before = len(frames)
    fake.plug_in()
    take_until(lambda: "camera back" in dict(events) and len(frames) > before + 20, "the return")
    stream.close()
    camera.close()
    kinds = [kind for kind, _ in events]
    assert kinds.index("camera silent") < kinds.index("camera lost") < kinds.index("camera back")
    assert stream.failure is None
    numbers = [frame.sequence for frame in frames]
    assert numbers == sorted(set(numbers))
    assert numbers[-1] + 1 - len(numbers) > 50  # more than half a second was lost, whoever was quick
    assert stream.losses.while_unplugged > 50


def test_a_silent_camera_that_is_there_is_not_taken_for_lost(fake: FakeCamera) -> None:
    camera = Triggered()
    begin(camera)
    for _ in range(4):
        with pytest.raises(FrameTimeout):
            camera.read(1.0)
    camera.close()


def test_stop_and_close_return_at_once_although_the_camera_is_dead(
    fake: FakeCamera, camera: AravisCamera
) -> None:
    begin(camera)
    assert camera.read(5.0) is not None
    with pulled_out(fake):
        begin_s = time.monotonic()
        camera.stop()
        camera.close()
        # libaravis alone takes 2.5 s for the one and 5 s for the other
        assert time.monotonic() - begin_s < 2.0
    camera.open()
    camera.close()


def test_a_dead_camera_can_not_be_opened_or_set(fake: FakeCamera, camera: AravisCamera) -> None:
    camera.open()
    with pulled_out(fake):
        with pytest.raises(DeviceError, match=SERIAL):
            camera.configure(PLAIN)
        camera.close()
        with pytest.raises(DeviceError, match="no camera answers"):
            camera.open()


def test_a_wrong_serial_number_lists_what_is_there(fake: FakeCamera) -> None:
    with pytest.raises(DeviceError, match=f"'none'.*{SERIAL}"):
        AravisCamera(AravisSettings(serial="none")).open()


def test_two_cameras_and_no_serial_number_are_listed(fake: FakeCamera) -> None:
    aravis = load_library().aravis
    aravis.enable_interface("Fake")
    try:
        with pytest.raises(DeviceError, match=f"several.*{SERIAL}"):
            AravisCamera().open()
        camera = AravisCamera(AravisSettings(serial=SERIAL))
        assert camera.open().serial == SERIAL
        camera.close()
    finally:
        aravis.disable_interface("Fake")
        aravis.update_device_list()


MORE_FEATURES = """
<Category Name="Wires"><pFeature>LineSelector</pFeature><pFeature>LineMode</pFeature>
 <pFeature>LineSource</pFeature><pFeature>PtpEnable</pFeature><pFeature>PtpDataSetLatch</pFeature>
 <pFeature>PtpStatus</pFeature><pFeature>GammaEnable</pFeature>
 <pFeature>ExposureAuto</pFeature>
 <pFeature>ResultingFrameRate</pFeature></Category>
<Enumeration Name="LineSelector"><EnumEntry Name="Line1"><Value>1</Value></EnumEntry>
 <EnumEntry Name="Line2"><Value>2</Value></EnumEntry><Value>1</Value></Enumeration>
<Enumeration Name="LineMode"><EnumEntry Name="Input"><Value>0</Value></EnumEntry>
 <EnumEntry Name="Output"><Value>1</Value></EnumEntry><Value>0</Value></Enumeration>
<Enumeration Name="LineSource"><EnumEntry Name="Off"><Value>0</Value></EnumEntry>
 <EnumEntry Name="ExposureActive"><Value>1</Value></EnumEntry><Value>0</Value></Enumeration>
<Boolean Name="PtpEnable"><pValue>PtpOn</pValue></Boolean><Integer Name="PtpOn"><Value>0</Value></Integer>
<Command Name="PtpDataSetLatch"><pValue>Latched</pValue><CommandValue>1</CommandValue></Command>
<Integer Name="Latched"><Value>0</Value></Integer>
<Enumeration Name="PtpStatus"><EnumEntry Name="Disabled"><Value>0</Value></EnumEntry>
 <EnumEntry Name="Slave"><Value>1</Value></EnumEntry><pValue>PtpState</pValue></Enumeration>
<IntSwissKnife Name="PtpState"><pVariable Name="ON">PtpOn</pVariable>
 <pVariable Name="LATCHED">Latched</pVariable><Formula>ON * LATCHED</Formula></IntSwissKnife>
<Boolean Name="GammaEnable"><pValue>GammaOn</pValue></Boolean>
<Integer Name="GammaOn"><Value>1</Value></Integer>
<Enumeration Name="ExposureAuto"><EnumEntry Name="Off"><Value>0</Value></EnumEntry>
 <EnumEntry Name="Continuous"><Value>1</Value></EnumEntry><Value>0</Value></Enumeration>
<Float Name="ResultingFrameRate"><Value>40.0</Value></Float>
"""


@pytest.fixture
def richer(tmp_path: Path) -> Iterator[AravisCamera]:
    """libaravis's other fake, in this process, with lines, a network clock and gamma besides."""
    aravis = load_library().aravis
    aravis.enable_interface("Fake")
    plain = aravis.Camera.new("Fake_1").get_device().get_genicam_xml()[0]
    root, end = '<Category Name="Root" NameSpace="Standard">', "</RegisterDescription>"
    more = {root: f"{root}<pFeature>Wires</pFeature>", end: MORE_FEATURES + end}
    assert all(place in plain for place in more)
    (tmp_path / "plain.xml").write_text(plain)
    for place, text in more.items():
        plain = plain.replace(place, text)
    (tmp_path / "richer.xml").write_text(plain)
    aravis.set_fake_camera_genicam_filename(str(tmp_path / "richer.xml"))
    camera = AravisCamera(AravisSettings(serial="Fake_1"))
    camera.open()
    yield camera
    camera.close()
    aravis.set_fake_camera_genicam_filename(str(tmp_path / "plain.xml"))
    aravis.disable_interface("Fake")
    aravis.update_device_list()


def test_what_another_program_left_on_is_switched_off_unless_asked(richer: AravisCamera) -> None:
    left_on = {"GainAuto": "Continuous", "ExposureAuto": "Continuous", "GammaEnable": "true"}
    features = richer._open_device()
    for name, value in left_on.items():
        features.write(name, value)
    features.camera.set_trigger("Line0")

    def said() -> list[str]:
        return [str(richer.feature_value(name)) for name in (*left_on, "TriggerMode")]

    assert said() == [*left_on.values(), "On"]
    richer.configure(CameraSettings())
    assert said() == ["Off", "Off", "false", "Off"]
    richer.configure(CameraSettings(features=left_on))
    assert said() == [*left_on.values(), "Off"]


def test_trigger_exposure_output_and_network_clock(richer: AravisCamera) -> None:
    asked = CameraSettings(trigger="Line0", exposure_output="Line2", ptp=True, frame_rate_hz=100.0)
    applied = richer.configure(asked)
    assert (applied.trigger, applied.trigger_edge, applied.exposure_output) == ("Line0", "rising", "Line2")
    assert applied.ptp is True
    assert applied.frame_rate_hz == 40.0, "that which the camera says results"
    assert richer.feature_value("LineSource") == "ExposureActive"
    assert richer.feature_value("PtpStatus") == "Slave", "read after it was latched"
    assert richer.feature_values()["PtpStatus"] == "Slave"
    assert richer.configure(CameraSettings(binning=2)).binning == 2
    assert richer.configure(CameraSettings(binning=1)).binning == 1
    wait_for_network_clock(richer)
    assert richer.configure(CameraSettings(ptp=False)).ptp is False
    with pytest.raises(DeviceError, match="not the network's, its state is Disabled; is a clock running"):
        wait_for_network_clock(richer, timeout_s=0.1)
    assert richer.feature_value("TriggerMode") == "On", "kept"
    with pytest.raises(DeviceError, match="TriggerSource cannot be Line9; it can be Line0, Software"):
        richer.configure(CameraSettings(trigger="Line9"))


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        (CameraSettings(exposure_us=1e12), r"exposure_us = 1e\+12.*10 to 1e\+07"),
        (CameraSettings(gain_db=90.0), "gain_db = 90.*0 to 10"),
        (CameraSettings(frame_rate_hz=1e6), r"frame_rate_hz = 1e\+06.*0.1 to 1000"),
    ],
)
def test_a_value_out_of_range_says_the_range(camera: AravisCamera, asked: CameraSettings, words: str) -> None:
    camera.open()
    with pytest.raises(DeviceError, match=words):
        camera.configure(asked)


def test_a_camera_that_another_program_controls_is_refused(fake: FakeCamera, camera: AravisCamera) -> None:
    camera.open()
    program = (
        "from acquisition.cameras.aravis.camera import AravisCamera\n"
        "from acquisition.camera import CameraSettings\n"
        "camera = AravisCamera(); camera.open()\n"
        "camera.configure(CameraSettings(width_px=64)); camera.start()"
    )
    other = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert other.returncode
    assert "in use by another program" in other.stderr


def test_rig_devices_lists_it(fake: FakeCamera) -> None:
    cameras, notes = drivers.find_cameras()
    found = [camera for camera in cameras if camera.driver == "aravis"]
    assert [(camera.serial, camera.connection) for camera in found] == [(SERIAL, "127.0.0.1")], notes


def test_a_camera_that_is_closed_gives_no_frames_and_no_crash(camera: AravisCamera) -> None:
    begin(camera)
    camera.close()
    assert camera.read(0.1) is None
    with pytest.raises(DeviceError, match="not open"):
        camera.start()
    with pytest.raises((CameraLost, DeviceError)):
        camera.configure(PLAIN)
