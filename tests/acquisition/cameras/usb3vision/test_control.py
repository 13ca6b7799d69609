"""GenCP, bootstrap registers, manifest and discovery, with the test camera."""

import struct

import pytest

from acquisition.camera import CameraLost
from acquisition.cameras.usb3vision.gencp import GenCpChannel, NoAnswer, RegisterRefused
from acquisition.cameras.usb3vision.link import UsbLink, find_camera, find_cameras
from acquisition.cameras.usb3vision.node_map import decode_description, read_description
from acquisition.cameras.usb3vision.packets import plan_transfers, read_identity
from processing.errors import DeviceError
from tests.acquisition.cameras.usb3vision import description
from tests.acquisition.cameras.usb3vision.backend import InProcessBackend
from tests.acquisition.cameras.usb3vision.device import VisionDevice
from tests.acquisition.cameras.usb3vision.registers import MANIFEST, XML


def channel_to(device: VisionDevice, **settings: float) -> GenCpChannel:
    """A control channel to a camera that is alone on its bus."""
    camera = find_camera(None, InProcessBackend(device))
    link = UsbLink(camera.device, camera.name)
    link.claim()
    return GenCpChannel(link.send, link.receive, camera.name, **({"timeout_s": 0.05} | settings))  # type: ignore[arg-type]


def pending(identity: int, wait_ms: int) -> bytes:
    return struct.pack("<IHHHHHH", 0x43563355, 0, 0x0805, 4, identity, 0, wait_ms)


def identity_of(packet: bytes) -> int:
    return int(struct.unpack_from("<H", packet, 10)[0])


def test_identity_is_read_and_long_reads_are_cut_to_the_cameras_packets() -> None:
    device = VisionDevice("SN-7", max_packet=128)
    channel = channel_to(device)
    identity = read_identity(channel)
    assert (identity.vendor, identity.model, identity.serial) == ("Testwerk", "Pendulum Eye", "SN-7")
    assert identity.timestamp_increment_ns == 8
    before = device.commands
    assert channel.read(XML, 1000) == device.peek(XML, 1000)
    assert device.commands - before == -(-1000 // (128 - 12))


def test_long_writes_are_cut_too() -> None:
    device = VisionDevice(max_packet=64)
    channel = channel_to(device)
    data = bytes(range(200))
    channel.write(description.BASE + 0x100, data)
    assert device.peek(description.BASE + 0x100, 200) == data


def test_request_ids_skip_zero() -> None:
    device = VisionDevice()
    seen = []
    device.faults.replies = lambda command, reply: [seen.append(identity_of(reply)), reply][1:]  # type: ignore[func-returns-value]
    channel = channel_to(device)
    channel._last_id = 0xFFFD
    for _ in range(4):
        channel.read(0, 4)
    assert seen == [0xFFFE, 0xFFFF, 1, 2]


def test_a_pending_acknowledge_buys_time() -> None:
    device = VisionDevice()
    device.faults.reply_delay_s = lambda command: 0.2
    with pytest.raises(NoAnswer):
        channel_to(device, retries=1).read(0, 4)
    device = VisionDevice()
    channel = channel_to(device, retries=0)
    real_out = device.control_out

    def answer_later(packet: bytes) -> None:
        device._replies.append((0.0, pending(identity_of(packet), 400)))
        device.faults.reply_delay_s = lambda command: 0.2
        real_out(packet)

    device.control_out = answer_later  # type: ignore[method-assign]
    assert channel.read(0x4, 8) == b"Testwerk"


def test_late_and_foreign_replies_are_passed_over() -> None:
    device = VisionDevice()
    channel = channel_to(device)
    delays = iter([0.1, 0.0, 0.0, 0.0])
    device.faults.reply_delay_s = lambda command: next(delays)
    assert channel.read(0x44, 12) == b"Pendulum Eye"  # the first reply comes after the second command
    assert channel.read(0x4, 8) == b"Testwerk"


@pytest.mark.parametrize(
    ("damage", "expected"),
    [
        (lambda r: b"\0" + r[1:], "begins with 0x"),
        (lambda r: r[:5], "only 5 bytes"),
        (lambda r: r[:-2], "claims 4"),
        (lambda r: r[:6] + b"\x77\x77" + r[8:], "kind 0x7777"),
        (lambda r: r[:10] + struct.pack("<H", 999) + r[12:], "to command 999"),
        (lambda r: r[:8] + struct.pack("<H", 2) + r[10:14], "2 bytes where 4"),
    ],
)
def test_a_damaged_reply_is_named_after_the_retries(damage, expected: str) -> None:  # type: ignore[no-untyped-def]
    device = VisionDevice()
    channel = channel_to(device, timeout_s=0.02, retries=2)
    device.faults.replies = lambda command, reply: [damage(reply)]
    before = device.commands
    with pytest.raises(NoAnswer, match=expected):
        channel.read(0, 4)
    assert device.commands - before == 3


def test_one_damaged_reply_costs_nothing_but_a_retry() -> None:
    device = VisionDevice()
    channel = channel_to(device)
    good = device.faults.replies
    broken = iter([True])
    device.faults.replies = lambda c, r: [] if next(broken, False) else good(c, r)
    assert channel.read(0x4, 8) == b"Testwerk"


def test_an_error_status_is_named_and_busy_is_tried_again() -> None:
    device = VisionDevice()
    channel = channel_to(device)
    with pytest.raises(RegisterRefused, match=r"no register at this address \(status 0x8003\)"):
        channel.read(0xDEAD0000, 4)
    busy = iter([0x8007, 0x8007, 0])
    device.faults.refuse = lambda command, address: next(busy, 0)
    assert channel.read(0x4, 8) == b"Testwerk"


def test_an_unplugged_camera_is_lost_at_once() -> None:
    device = VisionDevice()
    channel = channel_to(device)
    device.unplug()
    with pytest.raises(CameraLost, match="plug it in again"):
        channel.read(0, 4)


@pytest.mark.parametrize("packing", ["zip", "plain"])
@pytest.mark.parametrize("prefix", [b"", b"Testwerk Eye (USB3)\n"])
def test_description_is_found_plain_and_zipped(packing: str, prefix: bytes) -> None:
    channel = channel_to(VisionDevice(packing=packing, prefix=prefix))
    identity = read_identity(channel)
    text = read_description(channel, identity.manifest_address, "camera")
    assert text == description.description().strip()


def test_the_newest_of_several_descriptions_is_taken() -> None:
    device = VisionDevice(packing="plain")
    newer = b"<newer/>"
    manifest = bytearray(8 + 3 * 64)
    entries = [(0, 2, 1, 9 << 10, XML, 5), (0, 1, 1, 0, XML + 100, len(newer)), (0, 0, 1, 0, XML, 50)]
    struct.pack_into("<Q", manifest, 0, len(entries))
    for index, entry in enumerate(entries):
        struct.pack_into("<HBBIQQ", manifest, 8 + 64 * index, *entry)
    device._segments[MANIFEST] = manifest
    device.poke(XML + 100, newer)
    assert read_description(channel_to(device), MANIFEST, "c") == "<newer/>"


@pytest.mark.parametrize(
    ("raw", "expected"),
    [
        (b"PK\x03\x04 not really", "archive with its description is damaged"),
        (b"no mark-up at all", "is not XML"),
        (b"", "is not XML"),
    ],
)
def test_a_damaged_description_is_one_clear_error(raw: bytes, expected: str) -> None:
    with pytest.raises(DeviceError, match=expected):
        decode_description(raw, "camera")


def test_a_damaged_manifest_is_one_clear_error() -> None:
    device = VisionDevice()
    channel = channel_to(device)
    device.poke(MANIFEST, struct.pack("<Q", 1 << 40))
    with pytest.raises(DeviceError, match="manifest lists"):
        read_description(channel, MANIFEST, "c")
    device.poke(MANIFEST, struct.pack("<Q", 1))
    device.poke(MANIFEST + 8 + 16, struct.pack("<Q", 1 << 50))
    with pytest.raises(DeviceError, match="manifest is damaged"):
        read_description(channel, MANIFEST, "c")


def test_transfers_add_up_to_the_frame() -> None:
    for payload in (1, 1024, 307200, 307201, 5_000_000, (1 << 20) + 3):
        for alignment in (1024, 4096):
            plan = plan_transfers(payload, 52, 32, alignment, 1 << 20)
            assert payload <= sum(plan.payload) < payload + alignment
            assert all(size % alignment == 0 for size in plan.payload)
            assert plan.leader == plan.trailer == alignment


# ---- discovery


def test_the_camera_that_is_meant_is_found_or_asked_for() -> None:
    with pytest.raises(DeviceError, match="usb3vision: no camera answers"):
        find_camera(None, InProcessBackend())
    backend = InProcessBackend(VisionDevice("one"), VisionDevice("two"))
    with pytest.raises(DeviceError, match=r"several cameras: .*serial one.*serial two.*; set camera.serial"):
        find_camera(None, backend)
    assert find_camera("two", backend).serial == "two"
    with pytest.raises(DeviceError, match=r"no camera has the serial number 'three'.*serial one.*serial two"):
        find_camera("three", backend)
    twins = InProcessBackend(VisionDevice("one"), VisionDevice("one"))
    with pytest.raises(DeviceError, match="unplug all but one"):
        find_camera("one", twins)


def test_without_permission_the_udev_rule_is_named() -> None:
    backend = InProcessBackend(VisionDevice("one"))
    backend.denied.add("one")
    with pytest.raises(DeviceError, match="rig doctor --install-udev"):
        find_camera(None, backend)
    with pytest.raises(DeviceError, match="no permission"):
        find_camera("one", backend)
    assert [camera.accessible for camera in find_cameras(backend)] == [False]


def test_a_camera_in_use_says_so() -> None:
    backend = InProcessBackend(VisionDevice("one"))
    first = find_camera(None, backend)
    holder = UsbLink(first.device, first.name)
    holder.claim()
    second = find_camera(None, backend)
    with pytest.raises(DeviceError, match="in use by another program"):
        UsbLink(second.device, second.name).claim()
