"""The USB3 Vision driver with a real kernel, real libusb and libaravis, in QEMU.

The camera made for the tests is attached to the kernel's virtual host controller over USB/IP.
"""

from typing import Any

import pytest

from tests.kernel.scenarios import scenario

pytestmark = pytest.mark.kernel

GUEST = "guest_usb"
FRAME_S = 1 / 20.0


@pytest.mark.parametrize("name", ["queued", "blocking", "packaged"])
def test_frames_come_whole_and_in_order(results: dict[str, Any], name: str) -> None:
    seen = scenario(results, name)
    assert seen["uses_queue"] is (name != "blocking")
    assert seen["numbers"] == list(range(len(seen["numbers"])))
    assert seen["equal"]
    assert seen["dropped"] == 0
    assert seen["stop_s"] < 1.0
    assert seen["again"] == 0


@pytest.mark.parametrize("name", ["damaged_queued", "damaged_blocking"])
def test_damaged_frames_are_counted_and_the_rest_is_whole(results: dict[str, Any], name: str) -> None:
    seen = scenario(results, name)
    numbers = seen["numbers"]
    missing = set(range(numbers[-1] + 1)) - set(numbers)
    assert {5, 12, 19, 26} <= missing
    # Reads that were queued for the rest of the damaged frame may have swallowed the next ones.
    assert missing <= {block + later for block in (5, 12, 19, 26) for later in range(5)}
    assert seen["dropped"] == len(missing)
    assert seen["equal"]


@pytest.mark.parametrize("name", ["unplugged_queued", "unplugged_blocking"])
def test_unplugged_in_the_middle_of_a_frame(results: dict[str, Any], name: str) -> None:
    seen = scenario(results, name)
    assert seen["frames"] == 10
    assert "plug it in again" in seen["message"]
    assert seen["noticed_s"] < 2 * FRAME_S + 0.5
    assert seen["after"] == 0
    assert seen["reconnects"] == 1


def test_our_driver_for_libaravis_reads_the_same_camera_and_notices_that_it_is_gone(
    results: dict[str, Any],
) -> None:
    seen = scenario(results, "aravis_driver")
    if "skipped" in seen:
        pytest.skip(seen["skipped"])
    assert seen["serial"] == "QEMU-1"
    assert seen["exposure_us"] == 200.0
    for start in seen["starts"]:
        # on a busy machine libaravis misses frames, most often the first: what it delivers is whole and
        # has its right number, and what is missing between is counted
        numbers, blocks = start["numbers"], start["blocks"]
        assert blocks == [blocks[0] + number for number in numbers]
        assert len(numbers) == 20
        assert start["dropped"] == numbers[-1] + 1 - 20
        assert start["times_rise"]
    assert "plug it in again" in seen["lost"]
