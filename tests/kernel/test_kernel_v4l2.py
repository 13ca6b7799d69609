"""The Video4Linux driver with the kernel's test driver vivid, in QEMU."""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from tests.kernel.scenarios import scenario

pytestmark = pytest.mark.kernel

GUEST = "guest_v4l2 {vivid}"


def test_the_conformance_suite_passes(results: dict[str, Any]) -> None:
    seen = scenario(results, "kernel")
    assert seen["status"] == 0, seen["tests"]
    # what this device can't do is skipped with a reason; the formats are not among it
    passed = [name for name, outcome in seen["tests"].items() if not outcome]
    assert {"test_pixel_formats", "test_start_and_stop_fifty_times", "test_settings_are_read_back"} <= set(
        passed
    )
    assert len(passed) >= 15


def test_devices_are_listed_with_their_modes(results: dict[str, Any]) -> None:
    found = scenario(results, "devices")["found"]
    assert [device["name"] for device in found] == ["vivid"]
    assert "mono12 (Y12) 320 x 180 at 60 Hz" in found[0]["modes"]


def test_a_colour_of_a_mosaic_is_the_same_in_every_mosaic(results: dict[str, Any]) -> None:
    seen = scenario(results, "mosaic")
    assert seen["shapes"] == [[180, 320]]
    bars = {plane: [means[plane] for means in seen["means"].values()] for plane in ("red", "green", "blue")}
    for plane, of_mosaics in bars.items():
        # 4 of 180 rows of the bars differ between mosaics; another colour would differ by 0.3 and more
        assert np.ptp(of_mosaics, axis=0).max() < 0.05, plane
    # the colour bars are not grey: each plane shows others of them
    for one, other in (("red", "green"), ("green", "blue"), ("blue", "red")):
        assert np.abs(np.subtract(bars[one][0], bars[other][0])).max() > 0.3


def test_buffers_that_the_driver_drops_are_counted(results: dict[str, Any]) -> None:
    seen = scenario(results, "dropped")
    numbers = seen["numbers"]
    missing = numbers[-1] + 1 - len(numbers)
    assert missing > 5, "30 % of 60 were to be dropped"
    assert seen["dropped_by_bus"] > 5
    # the host's are frames for which a slow guest had no buffer
    assert seen["dropped_by_bus"] + seen["dropped_by_host"] == missing
    # The numbers are the driver's: over what is missing as much time passes as over as many frames that came;
    # single ones are late on a busy machine.
    per_number_ms, distances = np.array(seen["ms_per_number"]), np.diff(numbers)
    gaps = distances > 1
    over_gaps = float(np.sum((per_number_ms * distances)[gaps]) / np.sum(distances[gaps]))
    assert 0.7 < over_gaps / float(np.mean(per_number_ms[~gaps])) < 1.4
    # vivid stamps a frame when it is due, which may be a frame ahead; a slow guest fetches some late
    assert np.median(np.abs(seen["age_ms"])) < 100


def test_frames_that_nobody_fetched_are_lost_by_the_host(results: dict[str, Any]) -> None:
    seen = scenario(results, "late")
    numbers = seen["numbers"]
    pause = max(np.diff(numbers)) - 1
    assert pause > 5, "a second without a read is longer than four buffers last"
    assert seen["dropped_by_host"] >= pause
    # a guest that is slow loses single frames elsewhere, too
    assert seen["dropped_by_host"] + seen["dropped_by_bus"] == numbers[-1] + 1 - len(numbers)
    assert seen["delivered"] == len(numbers)


def test_buffers_that_the_driver_marks_as_damaged_are_counted_and_not_delivered(
    results: dict[str, Any],
) -> None:
    seen = scenario(results, "damaged")
    numbers = seen["numbers"]
    missing = numbers[-1] + 1 - len(numbers)
    assert seen["error_status"] == 5
    assert seen["dropped"] == missing >= 5


def test_a_region_holds_the_pixels_of_the_whole(results: dict[str, Any]) -> None:
    seen = scenario(results, "region")
    assert seen["applied"] == seen["asked"]
    assert seen["equal"] == [True, True, True]
    assert seen["levels"] > 3, "a picture without structure proves nothing"
    assert str(seen["sensor"][0]) in seen["beyond"]


def test_a_start_delivers_nothing_from_before_it(results: dict[str, Any]) -> None:
    seen = scenario(results, "stale")
    assert seen["before_start_ms"] <= 0
    assert seen["sequence"] == 0


@pytest.mark.parametrize(
    ("what", "words"),
    [
        ("exposure", "has no exposure time"),
        ("gain", "camera.v4l2.gain"),
        ("offset", "640 x 480"),
        ("gain range", "0 to 255"),
        ("no device", "/dev/video0 vivid"),
    ],
)
def test_what_cannot_be_is_refused(results: dict[str, Any], what: str, words: str) -> None:
    assert words in scenario(results, "refused")[what]


def test_gain_is_set_although_automatic_gain_was_on(results: dict[str, Any]) -> None:
    assert scenario(results, "refused")["gain set"] == "50"


def test_what_another_program_left_on_is_switched_off_unless_asked(results: dict[str, Any]) -> None:
    seen = scenario(results, "automatic")
    assert (seen["left"], seen["configured"], seen["asked"]) == (1, 0, 1)
    assert "leave camera.trigger = 'Line1' out" in seen["trigger"]


def test_unplugging_is_noticed_at_once(results: dict[str, Any]) -> None:
    seen = scenario(results, "unplugged")
    assert "plug it in again" in seen["message"]
    assert seen["noticed_s"] < 0.5
    assert seen["close_s"] < 1.0


@pytest.mark.parametrize("name", ["cable", "same_settings", "module", "other_number"])
def test_a_run_goes_on_when_its_camera_comes_back(results: dict[str, Any], name: str) -> None:
    seen = scenario(results, name)
    assert seen["failure"] == ""
    kinds = [kind for kind, _ in seen["events"]]
    assert kinds.count("camera lost") == kinds.count("camera back") == 1, seen["events"]
    assert "camera clock" not in kinds, seen["events"]
    assert "plug it in again" in dict(seen["events"])["camera lost"]
    numbers, times_ns, hosts_ns = seen["numbers"], seen["device_time_ns"], seen["host_time_ns"]
    assert len(numbers) > 40
    assert all(later > earlier for earlier, later in pairwise(numbers))
    assert all(later > earlier for earlier, later in pairwise(times_ns))
    # it was away for a second: what is missing is counted, and time goes on as the computer's
    assert seen["while_unplugged"] > 5
    assert numbers[-1] + 1 - len(numbers) <= seen["lost"]
    assert abs((times_ns[-1] - times_ns[0]) - (hosts_ns[-1] - hosts_ns[0])) < 500_000_000
    assert seen["reconnects"] == 1


def test_images_are_the_same_although_nothing_was_asked_for(results: dict[str, Any]) -> None:
    assert scenario(results, "same_settings")["images"] == [[360, 640, "uint16"]]


def test_a_camera_with_another_number_is_found_again(results: dict[str, Any]) -> None:
    seen = scenario(results, "other_number")
    assert seen["before"] != seen["after"]
