"""Quirks of real cameras, each made by the test camera; the table of quirks has the sources."""

import itertools
import struct
from typing import Any

import numpy as np
import pytest

from acquisition.camera import CameraSettings, CameraStatus, Frame
from acquisition.cameras.usb3vision.camera import Usb3VisionCamera
from tests.acquisition.cameras.usb3vision import description as layout
from tests.acquisition.cameras.usb3vision.backend import InProcessBackend
from tests.acquisition.cameras.usb3vision.device import Faults, VisionDevice
from tests.acquisition.cameras.usb3vision.eager import EagerTransfers

# 256 x 128 bytes are whole packets
WHOLE_PACKETS = CameraSettings(width_px=256, height_px=128, frame_rate_hz=1000.0, exposure_us=50.0)
COUNT = 30


def frames_of(
    device: VisionDevice, settings: CameraSettings = WHOLE_PACKETS
) -> tuple[list[Frame], CameraStatus]:
    camera = Usb3VisionCamera(backend=InProcessBackend(device))
    camera.open()
    camera.configure(settings)
    camera.start()
    frames = []
    for _ in range(COUNT):
        frame = camera.read(2.0)
        assert frame is not None
        frames.append(frame)
    status = camera.status
    camera.close()
    return frames, status


QUIRKS: dict[str, dict[str, Any]] = {
    "empty packet": {"units": lambda kind, block, data: [data, b""] if kind == "payload" else [data]},
    "no packet sizes": {"states_packet_sizes": False},
    "announced too large": {"announced_extra": 5000},
    "trailer runs in": {"announced_extra": 5000, "ends_payload_short": False},
    "announced a transfer too many": {"announced_extra": 3 << 20},
    "reads words only": {"reads_words_only": True},
}


@pytest.mark.parametrize("quirk", QUIRKS)
def test_every_frame_of_a_camera_with_a_quirk_arrives(quirk: str) -> None:
    odd_length = b"\n" * (1 + len(layout.description()) % 2)
    device = VisionDevice(frames_inside=100_000, packing="plain", prefix=odd_length)
    device.faults = Faults(**QUIRKS[quirk])
    device._update()
    frames, status = frames_of(device)
    assert [frame.sequence for frame in frames] == list(range(COUNT))
    assert status.dropped == 0
    for frame in frames:
        assert np.array_equal(frame.image, device.pixels(frame.sequence))


@pytest.mark.parametrize("quirk", [quirk for quirk in QUIRKS if quirk != "reads words only"])
def test_with_reads_under_way_only_the_first_frames_are_lost(
    monkeypatch: pytest.MonkeyPatch, quirk: str
) -> None:
    device = VisionDevice(frames_inside=100_000)
    device.faults = Faults(**QUIRKS[quirk])
    device._update()
    monkeypatch.setattr(
        Usb3VisionCamera, "_transfers", lambda self, link, ahead: EagerTransfers(device, 3, 0.0005)
    )
    frames, status = frames_of(device)
    numbers = [frame.sequence for frame in frames]
    assert numbers[10:] == list(range(numbers[10], numbers[10] + COUNT - 10))
    assert numbers[10] < 30
    assert status.dropped == 0 or status.dropped_by_camera == 0


def test_a_block_that_is_sent_twice_or_late_is_no_loss_of_others() -> None:
    """Blocks 5, 7, 6, 8 ...: 6 counted as lost when 7 came, and its late coming loses nothing more."""
    device = VisionDevice(frames_inside=100_000)
    device.faults.block_ids = lambda block: {6: 7, 7: 6}.get(block, block)
    stamps: dict[int, bytes] = {}

    def swapped(kind: str, block: int, data: bytes) -> list[bytes]:
        if kind == "leader":
            stamps[block] = data[20:28]
            if block == 6:  # sent after 7, but exposed before it
                data = (
                    data[:20] + struct.pack("<Q", struct.unpack("<Q", stamps[7])[0] - 1_000_000) + data[28:]
                )
        return [data]

    device.faults.units = swapped
    frames, status = frames_of(device)
    times_ns = [frame.device_time_ns for frame in frames]
    assert all(later > earlier for earlier, later in itertools.pairwise(times_ns))
    assert status.dropped == 1


@pytest.mark.parametrize("bits", [16, 32])
def test_a_loss_across_the_end_of_a_short_counter_is_counted(bits: int) -> None:
    first = (1 << bits) - 10
    device = VisionDevice(frames_inside=100_000, first_block=first)
    device.faults.block_ids = lambda number: (number + (4 if number >= first + 10 else 0)) % (1 << bits)
    frames, status = frames_of(device)
    assert status.dropped == status.dropped_by_camera == 4
    assert frames[-1].sequence == COUNT + 3
