"""What a record says of its camera comes back as values, also from records that say less."""

from dataclasses import replace
from itertools import product

import pytest

from acquisition.camera import CameraInfo, ShutterKind
from acquisition.record.digest import RecordedCamera, camera_metadata

INFO = CameraInfo("v4l2", "Maker", "Model", "7", 640, 480, 255, has_clock=True)


WORDS = {
    "Rolling": ShutterKind.ROLLING,
    "RollingShutter": ShutterKind.ROLLING,
    "Global": ShutterKind.GLOBAL,
    "GlobalReset": ShutterKind.OTHER,
    "": ShutterKind.UNKNOWN,
}


@pytest.mark.parametrize("word", WORDS)
def test_what_is_written_is_read_as_the_same_values(word: str) -> None:
    for driver, has_clock in product(("simulated", "v4l2"), (True, False)):
        written = camera_metadata(replace(INFO, driver=driver, shutter=word, has_clock=has_clock))
        expected = RecordedCamera(driver == "simulated", has_clock, WORDS[word])
        assert RecordedCamera.from_metadata(written) == expected


def test_a_record_that_says_nothing_is_no_camera_without_a_clock() -> None:
    assert RecordedCamera.from_metadata({}) == RecordedCamera(False, None, ShutterKind.UNKNOWN)
    assert RecordedCamera.from_metadata({"camera": {"has_clock": "perhaps"}}).has_clock is None
