"""A Video4Linux camera that goes and comes back while a stream reads it, in QEMU, with no setting changed.

Run by ``make test-kernel``; skipped, with the reason, where QEMU or a kernel can't be had.
"""

from itertools import pairwise
from typing import Any

import pytest

from tests.kernel.scenarios import scenario

pytestmark = pytest.mark.kernel

GUEST = "guest_reconnection {vivid}"


@pytest.mark.parametrize("name", ["cable", "settings", "module", "other_number"])
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
    assert scenario(results, "settings")["images"] == [[360, 640, "uint16"]]


def test_a_camera_with_another_number_is_found_again(results: dict[str, Any]) -> None:
    seen = scenario(results, "other_number")
    assert seen["before"] != seen["after"]
