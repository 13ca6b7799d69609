"""The features of a camera by name: messages, access, threads, and descriptions of real cameras."""

import gzip
import re
import sys
import threading
import time
from pathlib import Path

import pytest

from acquisition.camera import CameraLost
from acquisition.cameras.usb3vision import link
from acquisition.cameras.usb3vision.camera import Usb3VisionCamera
from acquisition.cameras.usb3vision.node_map import ACCESS, NodeMap, decode_description
from processing.errors import DeviceError, MissingPackage
from tests.acquisition.cameras.usb3vision.backend import WITHOUT_GENICAM, InProcessBackend, camera_on
from tests.acquisition.cameras.usb3vision.device import VisionDevice

pytest.importorskip("genicam.genapi", reason=WITHOUT_GENICAM)

HEAD = """<RegisterDescription ModelName="E" VendorName="T" ToolTip="t" StandardNameSpace="USB"
 SchemaMajorVersion="1" SchemaMinorVersion="1" SchemaSubMinorVersion="0" MajorVersion="1" MinorVersion="0"
 SubMinorVersion="0" ProductGuid="11111111-2222-3333-4444-555555555555"
 VersionGuid="11111111-2222-3333-4444-666666666666" xmlns="http://www.genicam.org/GenApi/Version_1_1">
 <Category Name="Root"><pFeature>F</pFeature></Category><Port Name="Device"/>"""


class Ram:
    """Registers that hold the reader up for `pause_s`."""

    def __init__(self) -> None:
        self.data = bytearray(256)
        self.pause_s = 0.0
        self.error: Exception | None = None

    def read(self, address: int, length: int) -> bytes:
        time.sleep(self.pause_s)
        if self.error is not None:
            raise self.error
        return bytes(self.data[address : address + length])

    def write(self, address: int, data: bytes) -> None:
        if self.error is not None:
            raise self.error
        self.data[address : address + len(data)] = data


def node_map(body: str, ram: Ram | None = None) -> NodeMap:
    return NodeMap(f"{HEAD}{body}</RegisterDescription>", ram or Ram(), "camera")  # type: ignore[arg-type]


def register(name: str, address: int, more: str = "", kind: str = "IntReg", length: int = 4) -> str:
    last = "<Endianess>LittleEndian</Endianess>" if kind == "IntReg" else ""
    return (
        f'<{kind} Name="{name}"><Address>{address}</Address><Length>{length}</Length>'
        f"<AccessMode>RW</AccessMode><pPort>Device</pPort>{more}{last}</{kind}>"
    )


def test_locked_absent_and_read_only_features_say_so() -> None:
    body = (
        '<Integer Name="Lock"><Value>0</Value></Integer><Integer Name="There"><Value>1</Value></Integer>'
        '<Integer Name="F"><pIsAvailable>There</pIsAvailable><pIsLocked>Lock</pIsLocked>'
        "<Value>3</Value></Integer>"
        '<Integer Name="G"><pIsImplemented>There</pIsImplemented><ImposedAccessMode>RO</ImposedAccessMode>'
        "<Value>3</Value></Integer>"
    )
    nodes = node_map(body)
    nodes.write("F", 4)
    with pytest.raises(DeviceError, match="camera: G cannot be set: it is read-only"):
        nodes.write("G", 4)
    nodes.write("Lock", 1)
    assert nodes.get("F") == 4
    with pytest.raises(DeviceError, match="F cannot be set: it is read-only"):
        nodes.write("F", 5)
    nodes.write("There", 0)
    with pytest.raises(DeviceError, match="F cannot be read: it is not available"):
        nodes.get("F")
    with pytest.raises(DeviceError, match="G cannot be read: it is not implemented"):
        nodes.get("G")
    with pytest.raises(DeviceError, match="has no feature 'H'"):
        nodes.get("H")
    assert (nodes.access("H"), nodes.choices("H")) == ("not implemented", ())


def test_texts_switches_commands_and_plain_bytes() -> None:
    ram = Ram()
    body = (
        register("Text", 0, kind="StringReg", length=8)
        + '<String Name="F"><pValue>Text</pValue></String>'
        + register("Raw", 8, kind="Register", length=4)
        + register("Bit", 16)
        + '<Boolean Name="Switch"><pValue>Bit</pValue><OnValue>5</OnValue><OffValue>2</OffValue></Boolean>'
        + register("Do", 20)
        + '<Command Name="Go"><pValue>Do</pValue><CommandValue>9</CommandValue></Command>'
    )
    nodes = node_map(body, ram)
    nodes.write("F", "Grün")
    assert (nodes.get("F"), bytes(ram.data[:8])) == ("Grün", "Grün".encode().ljust(8, b"\0"))
    with pytest.raises(DeviceError, match=r"F cannot be set to '123456789': .*length is 8"):
        nodes.write("F", "123456789")
    ram.data[8:12] = b"abcd"
    assert nodes.get("Raw") == b"abcd"
    with pytest.raises(DeviceError, match="Raw is a Register and cannot be set"):
        nodes.write("Raw", "abcd")
    with pytest.raises(DeviceError, match="Switch cannot be read: Value '0' is neither"):
        nodes.get("Switch")
    for value, raw in ((True, 5), ("off", 2), ("True", 5), (0, 2)):
        nodes.write("Switch", value)
        assert (nodes.get("Switch"), ram.data[16]) == (raw == 5, raw)
    with pytest.raises(DeviceError, match="Switch = wide must be true or false"):
        nodes.write("Switch", "wide")
    nodes.write("Go", True)
    assert ram.data[20] == 9
    for name, what in (("Root", "Category"), ("Device", "Port")):
        with pytest.raises(DeviceError, match=f"{name} is a {what} and has no value|cannot be read"):
            nodes.get(name)
    ram.data[:4] = b"Gr\xfcn"
    nodes.renew()
    with pytest.raises(DeviceError, match="F cannot be read: 'utf-8' codec"):
        nodes.get("F")


def test_numbers_are_taken_in_words_and_refused_with_what_is_allowed() -> None:
    nodes = node_map(
        '<Integer Name="F"><Value>8</Value><Min>8</Min><Max>1440</Max><Inc>8</Inc></Integer>'
        '<Float Name="G"><Value>1</Value><Min>0.5</Min><Max>2e4</Max><Unit>us</Unit></Float>'
        '<Float Name="H"><Value>1</Value></Float>'
    )
    for value in ("0x140", 320, 320.0, "320"):
        nodes.write("F", 8)
        nodes.write("F", value)
        assert nodes.get("F") == 320
    for name, value, reason in (
        ("F", "wide", "F = 'wide' is not a number"),
        ("F", 12.5, "F = 12.5 must be a whole number"),
        ("F", 12, "F = 12 is out of range; allowed is 8 to 1440 in steps of 8"),
        ("F", 1 << 70, "is out of range; allowed is 8 to 1440 in steps of 8"),
        ("G", "1,5", "G = '1,5' is not a number"),
        ("G", float("nan"), "G = nan is out of range; allowed is 0.5 to 20000 us"),
    ):
        with pytest.raises(DeviceError, match=re.escape(reason)):
            nodes.write(name, value)
    assert (nodes.limits("F"), nodes.limits("H")) == ((8, 1440), (None, None))


def test_a_lost_camera_is_told_as_that_and_read_again_when_it_is_back() -> None:
    ram = Ram()
    nodes = node_map(register("F", 0), ram)
    ram.error = CameraLost("camera: is gone")
    for use in (lambda: nodes.get("F"), lambda: nodes.write("F", 1), lambda: list(nodes.readings())):
        with pytest.raises(CameraLost, match="is gone"):
            use()
    ram.error = DeviceError("camera: busy")
    assert [reading.problem for reading in nodes.readings()] == ["camera: busy"]
    ram.error = None
    assert nodes.get("F") == 0


@pytest.mark.timeout(20)
def test_threads_that_read_at_once_do_not_wait_for_each_other_for_ever() -> None:
    ram = Ram()
    ram.pause_s = 0.002
    nodes = node_map(register("F", 0, "<Cachable>NoCache</Cachable>"), ram)
    uses = [lambda: nodes.get("F"), lambda: nodes.write("F", 3), lambda: list(nodes.readings()), nodes.renew]
    threads = [
        threading.Thread(target=lambda use=use: [use() for _ in range(20)], daemon=True) for use in uses
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(10)
    assert not any(thread.is_alive() for thread in threads)


def test_without_genicam_one_line_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "genicam", None)
    device = VisionDevice()
    with pytest.raises(
        MissingPackage, match=r"needs genicam, of the extra usb3vision: .* -m pip install genicam$"
    ):
        camera_on(device).open()
    monkeypatch.setattr(link, "_libusb", lambda: InProcessBackend(device))
    (listed,) = link.list_cameras()
    assert listed.serial == device.serial
    assert listed.problem.endswith("-m pip install genicam")
    monkeypatch.undo()
    camera: Usb3VisionCamera = camera_on(device)
    assert camera.open().serial == device.serial
    camera.close()


# ---- descriptions of real cameras


class Memory:
    """A camera's registers: every byte is random but always the same, until it is written."""

    def __init__(self, seed: int) -> None:
        self.seed = seed
        self.bytes: dict[int, int] = {}

    def _byte(self, address: int) -> int:
        if address not in self.bytes:
            mixed = (address * 0x9E3779B97F4A7C15 + (self.seed + 1) * 0xD1B54A32D192ED03) % (1 << 64)
            random_byte = ((mixed ^ mixed >> 29) * 0xBF58476D1CE4E5B9 >> 40) & 0xFF
            # Sparse memories make more flags agree with each other than dense ones do.
            self.bytes[address] = random_byte & 0x81 if self.seed else random_byte
        return self.bytes[address]

    def read(self, address: int, length: int) -> bytes:
        return bytes(self._byte(address + index) for index in range(length))

    def write(self, address: int, data: bytes) -> None:
        self.bytes.update({address + index: byte for index, byte in enumerate(data)})


@pytest.mark.parametrize("seed", [0, 1])
def test_every_feature_of_real_cameras_is_read_and_set_or_refused_in_one_line(
    shared_data: Path, seed: int
) -> None:
    files = sorted((shared_data / "genicam").glob("*.xml.gz"))
    if not files:
        pytest.skip(f"no descriptions of real cameras in {shared_data / 'genicam'}")
    for file in files:
        xml = decode_description(gzip.decompress(file.read_bytes()), file.name)
        nodes = NodeMap(xml, Memory(seed), file.name)  # type: ignore[arg-type]
        for name in ("Width", "Height", "PixelFormat", "AcquisitionStart", "AcquisitionStop"):
            assert nodes.has(name)
        readings = list(nodes.readings())
        assert len(readings) > 60
        done, refused = 0, []
        for reading in readings:
            assert "\n" not in reading.problem
            assert reading.access in ACCESS or reading.problem
            if reading.value is None or reading.kind == "Register" or not nodes.writable(reading.name):
                continue
            value = reading.maximum if reading.maximum is not None else reading.value
            value = reading.choices[-1] if reading.choices else value
            try:
                nodes.write(reading.name, value)
                done += 1
            except DeviceError as error:
                refused.append(str(error))
        assert done > 5
        assert all(text.startswith(f"{file.name}: ") and "\n" not in text for text in refused)
