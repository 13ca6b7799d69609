"""The shape of a beam: what it has more or less than a Gaussian, and where."""

import math

import numpy as np
import pytest

from processing.spot import Spot, beam_shape
from tests.processing.spot.frames import tilted_light

SHAPE = (120, 140)


def seen_at(x_px: float, y_px: float, peak_dn: float, lobe_dn: float = 0.0) -> tuple[np.ndarray, Spot]:
    """A tilted beam of full scale 255 DN, with a lobe 12 px to the right and 5 px up."""
    image = 40 + tilted_light(SHAPE, x_px, y_px, (6, 4), 0.4, peak_dn)
    image += tilted_light(SHAPE, x_px + 12, y_px - 5, (3, 3), 0.0, lobe_dn)
    return np.minimum(image, 255), Spot(x_px, y_px, 0.1, 0.1, 6.0, 4.0, 0.4, peak_dn, 40.0, 1.0, 0)


@pytest.mark.parametrize("peak_dn", [150.0, 400.0])
def test_a_gaussian_departs_nowhere_be_it_clipped_or_at_an_edge(peak_dn: float) -> None:
    places = ((60.3, 50.7), (10.2, 110.4), (131.6, 8.3))
    images, spots = zip(*(seen_at(x, y, peak_dn) for x, y in places), strict=True)
    found = beam_shape(images, spots, 255.0)
    assert found is not None
    assert found.departure < 2e-3
    assert found.lopsided == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize("lobe_dn", [15.0, -15.0])
def test_a_lobe_is_found_where_it_is(lobe_dn: float) -> None:
    image, spot = seen_at(60.3, 50.7, 150.0, lobe_dn)
    found = beam_shape([image], [spot], 255.0)
    assert found is not None
    # a Gaussian of 3 px, smoothed by one of 0.33 of the beam's
    smoothed = 9 / (9 + 0.33**2 * 6 * 4)
    assert found.departure == pytest.approx(0.1 * smoothed, rel=0.05)
    assert found.away_px == pytest.approx(13.0, abs=0.3)
    assert found.away_sigmas == pytest.approx(found.away_px / math.sqrt(6 * 4))
    assert found.extra_light is (lobe_dn > 0)
