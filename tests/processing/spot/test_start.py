"""Start values of a fit, from chords and from areas, lie near the spot that is there."""

import math

import numpy as np
import pytest

from processing.spot.fit_values import AMPLITUDE, BACKGROUND, COVARIANCE, PARAMETERS, SIGMA_X, SIGMA_Y, X, Y
from processing.spot.start import start_from_areas, start_from_chords
from tests.processing.spot.frames import light, tilted_light

SHAPE = (80, 100)
PLACE = (58.4, 37.7)


def on_areas(image: np.ndarray, background: float, full_scale: float = 255.0) -> np.ndarray:
    p = np.zeros(PARAMETERS)
    mask, stack = np.zeros(image.shape, np.uint8), np.zeros(image.size, np.int64)
    y, x = np.unravel_index(np.argmax(image), image.shape)
    peak = float(image.max())
    assert start_from_areas(image, int(x), int(y), background, peak, full_scale, mask, stack, p)
    assert not mask.any()  # ready for the next frame
    return p


@pytest.mark.parametrize("clipped", [False, True])
@pytest.mark.parametrize("angle", [0.0, 0.6, -0.6, math.pi / 2])
def test_areas_give_an_ellipse_its_place_shape_and_height(angle: float, clipped: bool) -> None:
    """Also of a spot twice as bright as the sensor can show, of which the middle is flat."""
    peak = 480.0 if clipped else 200.0
    beam = tilted_light(SHAPE, *PLACE, (8.0, 4.0), angle, peak) + 10
    p = on_areas(np.minimum(np.rint(beam), 255).astype(np.uint8), 10.0)
    assert p[[X, Y]] == pytest.approx(PLACE, abs=0.15)
    cosine, sine = math.cos(angle), math.sin(angle)
    xx, yy = (8 * cosine) ** 2 + (4 * sine) ** 2, (8 * sine) ** 2 + (4 * cosine) ** 2
    assert (p[SIGMA_X], p[SIGMA_Y]) == pytest.approx((xx**0.5, yy**0.5), rel=0.1)
    assert p[COVARIANCE] == pytest.approx((64 - 16) * sine * cosine, abs=3)
    assert p[AMPLITUDE] == pytest.approx(peak, rel=0.3 if clipped else 0.05)
    assert p[BACKGROUND] == 10.0


def test_areas_are_those_of_the_place_alone() -> None:
    """A second spot apart from it counts no more than if it were not there; a line of pixels is no spot."""
    one = light(SHAPE, *PLACE, 4, 200)
    two = one + light(SHAPE, 20, 20, 6, 150)
    alone, beside = (on_areas(np.rint(beam).astype(np.uint8), 0.0) for beam in (one, two))
    assert beside == pytest.approx(alone)
    thin = np.zeros(SHAPE, np.uint8)
    thin[40, 50:52] = 200
    p = np.zeros(PARAMETERS)
    mask, stack = np.zeros(SHAPE, np.uint8), np.zeros(thin.size, np.int64)
    assert not start_from_areas(thin, 50, 40, 0.0, 200.0, 255.0, mask, stack, p)
    assert not start_from_areas(thin, 50, 40, 200.0, 200.0, 255.0, mask, stack, p)


@pytest.mark.parametrize(("from_x", "from_y"), [(58, 38), (55, 38), (58, 42), (61, 35)])
def test_chords_converge_to_the_centre(from_x: int, from_y: int) -> None:
    beam = light(SHAPE, *PLACE, 6, 200, 4) + 10
    p = np.zeros(PARAMETERS)
    image = np.rint(beam).astype(np.uint8)
    assert start_from_chords(image, from_x, from_y, 10.0, int(image[from_y, from_x]), p)
    assert p[[X, Y]] == pytest.approx(PLACE, abs=0.3)
    assert (p[SIGMA_X], p[SIGMA_Y]) == pytest.approx((6, 4), rel=0.1)
    assert p[AMPLITUDE] == pytest.approx(200, rel=0.05)
    assert p[BACKGROUND] == 10.0


@pytest.mark.parametrize("place", [(2.0, 40.0), (97.5, 40.0), (50.0, 1.5), (50.0, 78.0)])
def test_chords_that_reach_an_edge_say_so(place: tuple[float, float]) -> None:
    image = np.rint(light(SHAPE, *place, 6, 200)).astype(np.uint8)
    p = np.zeros(PARAMETERS)
    assert not start_from_chords(image, round(place[0]), round(place[1]), 0.0, 200, p)


def test_a_single_pixel_has_no_chord() -> None:
    image = np.zeros(SHAPE, np.uint8)
    image[40, 50] = 200
    assert not start_from_chords(image, 50, 40, 0.0, 200, np.zeros(PARAMETERS))
    assert not start_from_chords(image, 51, 40, 0.0, 200, np.zeros(PARAMETERS))
