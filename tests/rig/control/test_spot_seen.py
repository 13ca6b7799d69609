"""Whether frames show the spot is judged by frames that were seen while the laser was lit."""

import numpy as np
import pytest
from numpy.typing import NDArray

from rig.control.light_permit import SpotSeen


class Clock:
    now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


RANDOM = np.random.default_rng(7)


def frame(peak_dn: float, lamp_dn: float = 0.0) -> NDArray[np.uint8]:
    """A spot on a noisy ground, a lamp beside it, and two hot pixels."""
    y, x = np.mgrid[:200, :300]
    spot = peak_dn * np.exp(-((x - 150) ** 2 + (y - 100) ** 2) / 72)
    lamp = lamp_dn * np.exp(-((x - 40) ** 2 + (y - 30) ** 2) / 200)
    image = RANDOM.normal(8.0, 1.5, x.shape) + spot + lamp
    image[5, 5] = image[9, 90] = 255
    return np.clip(image, 0, 255).astype(np.uint8)


def watched(clock: Clock, spot: SpotSeen, told: bool, peak_dn: float, lamp_dn: float = 0.0) -> None:
    """Three seconds of frames while the laser says of itself that it is lit, or not."""
    for _ in range(60):
        clock.now_s += 0.05
        spot.frame(frame(peak_dn, lamp_dn))
        spot.told(told)


@pytest.mark.slow
@pytest.mark.parametrize("lit_dn", [40.0, 200.0, 400.0])
@pytest.mark.parametrize("left", [0.0, 0.5, 1.0])
def test_a_spot_that_stays_disagrees_and_one_that_goes_agrees(lit_dn: float, left: float) -> None:
    clock = Clock()
    spot = SpotSeen(clock)
    assert (spot.seen, spot.disagrees, spot.agrees) == (None, False, False)
    watched(clock, spot, True, lit_dn, lamp_dn=4.0)
    assert (spot.seen, spot.disagrees, spot.agrees) == (True, False, False)
    watched(clock, spot, False, left * lit_dn, lamp_dn=4.0)
    stays = left > 0
    assert (spot.seen, spot.disagrees, spot.agrees) == (stays, stays, not stays)


def test_a_spot_that_left_the_sensor_while_it_was_lit_confirms_no_darkness() -> None:
    """A pendulum that was knocked: what the camera did not see before, it does not see go out."""
    clock = Clock()
    spot = SpotSeen(clock)
    watched(clock, spot, True, 200.0)
    watched(clock, spot, True, 0.0)
    # a record takes its time to be closed
    clock.now_s += 20.0
    watched(clock, spot, False, 0.0)
    assert (spot.seen, spot.disagrees, spot.agrees) == (False, False, False)
    # one that comes back is still light that should be off
    watched(clock, spot, False, 200.0)
    assert spot.disagrees
    # and one that swings out of it and back again was seen
    for _ in range(3):
        watched(clock, spot, True, 200.0)
        clock.now_s += 0.5
        spot.frame(frame(0.0))
        spot.told(True)
    clock.now_s += 20.0
    watched(clock, spot, False, 0.0)
    assert spot.agrees


def test_frames_on_their_way_do_not_disagree() -> None:
    clock = Clock()
    spot = SpotSeen(clock)
    spot.exposure_s = 1.0
    watched(clock, spot, True, 200.0)
    watched(clock, spot, True, 200.0)
    watched(clock, spot, False, 200.0)
    assert spot.seen
    assert not spot.disagrees
    watched(clock, spot, False, 200.0)
    assert spot.disagrees


def test_where_no_spot_was_ever_seen_nothing_is_judged() -> None:
    clock = Clock()
    spot = SpotSeen(clock)
    watched(clock, spot, True, 0.0)
    watched(clock, spot, False, 0.0)
    assert (spot.seen, spot.disagrees, spot.agrees) == (None, False, False)


def test_an_old_frame_has_its_age() -> None:
    clock = Clock()
    spot = SpotSeen(clock)
    assert spot.age_s == np.inf
    spot.frame(frame(0.0))
    clock.now_s += 5.0
    assert spot.age_s == 5.0
    spot.frame(np.zeros((1, 2), np.uint8))
    assert spot.age_s == 5.0
