"""Verdicts on the beam (go, caution and no-go, with the reason that is theirs) and on the balance."""

import math
from collections.abc import Callable, Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from processing.balance import Balance, BalanceLimits
from processing.spot import SpotFlag, SpotModel, SpotTracker, fixed_light
from processing.spot.fit_values import Image, Spot
from rig.instrument import beam_quality
from rig.instrument.balance import balance_failures, balance_verdicts, run_balance_verdicts
from rig.settings import PreflightSettings
from rig.terminal import Verdict
from tests.processing.spot.frames import LIT_EIGHT_BIT, exposed, light
from tests.rig.made_up import balance_of

SHAPE = (110, 120)
Y, X = np.indices(SHAPE)
Light = Callable[[float, float], NDArray[np.float64]]
LUMPS = np.random.default_rng(5).normal(size=(6, 2))


def good(x: float, y: float) -> NDArray[np.float64]:
    return light(SHAPE, x, y, 5, 160, 7)


def ghost(x: float, y: float) -> NDArray[np.float64]:
    return good(x, y) + light(SHAPE, x + 14, y - 9, 5, 0.06 * 160, 7)


def cut(x: float, y: float) -> NDArray[np.float64]:
    """A screen that leaves what is left of 0.8 sigma."""
    return np.where(x + 4 > X, good(x, y), 0.0)


def grazed(x: float, y: float) -> NDArray[np.float64]:
    """The same at two sigma."""
    return np.where(x + 10 > X, good(x, y), 0.0)


def donut(x: float, y: float) -> NDArray[np.float64]:
    square = ((x - X) ** 2 + (y - Y) ** 2) / (2 * 6.0**2)
    return np.asarray(160 * math.e * square * np.exp(-square))


def ragged(x: float, y: float) -> NDArray[np.float64]:
    lumps = sum(
        (18 * light(SHAPE, x + 5 * a, y + 5 * b, 2.5, 1.0) * (-1) ** k for k, (a, b) in enumerate(LUMPS))
    )
    return np.maximum(0.85 * good(x, y) + lumps, 0.0)


def judged(beam: Light, frames: int = 16, x_px: float = 60.0) -> Verdict:
    rng, tracker = np.random.default_rng(8), SpotTracker(LIT_EIGHT_BIT)
    images, spots = [], []
    for k in range(frames):
        place = x_px + 0.4 * math.sin(k), 54 + 0.3 * math.cos(0.7 * k)
        images.append(exposed(beam(*place), rng, sensor=LIT_EIGHT_BIT))
        spots.append(tracker.track(images[-1]))
    return beam_quality(images[-32:], spots, tracker.model, 255.0, PreflightSettings())


def moving(still: NDArray[np.float64], hot: Sequence[tuple[int, int]] = ()) -> list[tuple[Image, Spot]]:
    """Pictures of a spot that moves through light which does not, on a sensor with hot pixels (y, x)."""
    rng, tracker = np.random.default_rng(8), SpotTracker(LIT_EIGHT_BIT)
    pictures = []
    for k in range(48):
        image = exposed(good(60.0 + 40.0 * math.sin(0.3 * k), 54.0) + still, rng, sensor=LIT_EIGHT_BIT)
        for place in hot:
            image[place] = 120
        pictures.append((image, tracker.track(image)))
    return pictures


def test_a_hot_pixel_is_no_light_that_shifts_the_spot() -> None:
    """Fits leave it out."""
    none = np.zeros_like(good(60.0, 54.0))
    places = [(spot.x_px, spot.y_px) for _, spot in moving(none)]
    hot = moving(none, [(52, 70), (56, 51), (57, 51)])
    assert np.abs(np.array([(spot.x_px, spot.y_px) for _, spot in hot]) - places).max() < 0.02
    assert fixed_light(hot) is None


def test_light_that_stays_where_it_is_is_a_caution() -> None:
    pictures = moving(0.03 * good(70.0, 54.0), [(52, 70)])
    found = fixed_light(pictures)
    assert found is not None
    assert found.relative_height == pytest.approx(0.03, rel=0.2)
    images, spots = zip(*pictures, strict=True)
    verdict = beam_quality(images, spots, SpotModel.ONE, 255.0, PreflightSettings(), light=found)
    assert "light that stays where it is" in verdict.reason
    assert "block it" in verdict.remedy
    # of a spot that hardly moves it cannot be told
    assert fixed_light(pictures[:1] * 16) is None


def test_a_good_beam_is_go_with_its_numbers() -> None:
    verdict = judged(good, 140)
    assert (verdict.ok, verdict.remedy) == (True, "")
    assert verdict.measured.startswith("one Gaussian, χ²/dof 0.95")
    assert "POOR_FIT in 0 % of frames" in verdict.measured
    assert verdict.line.startswith("beam quality: go, one Gaussian")
    assert "one Gaussian so far" in judged(good).measured


@pytest.mark.parametrize(
    ("beam", "x_px", "ok", "reason", "remedy"),
    [
        (ghost, 60.0, True, "a second spot or ghost: 5", ""),
        (grazed, 60.0, True, "something cuts it: ", ""),
        (cut, 60.0, False, "something cuts it: ", ""),
        (donut, 60.0, True, "hollow: ", ""),
        (ragged, 60.0, True, "ragged: ", ""),
        (good, 8.0, False, "edge of the sensor", ""),
        (lambda x, y: np.zeros(SHAPE), 60.0, False, "", "find the spot first"),
    ],
)
def test_what_is_wrong_with_a_beam_is_named(
    beam: Light, x_px: float, ok: bool, reason: str, remedy: str
) -> None:
    verdict = judged(beam, 3, x_px)
    assert verdict.ok is ok
    assert reason in verdict.reason
    assert verdict.remedy
    assert remedy in verdict.remedy


def test_a_learned_profile_that_fits_is_caution_and_one_that_does_not_is_no_go() -> None:
    learned = judged(ragged, 170)
    assert learned.ok
    assert learned.remedy
    assert learned.measured.startswith("learned profile, χ²/dof ")
    image = exposed(good(60, 54), np.random.default_rng(1), sensor=LIT_EIGHT_BIT)
    spot, limits = SpotTracker(LIT_EIGHT_BIT).track(image), PreflightSettings()
    changing = [spot._replace(chi2_per_dof=9.0, flags=SpotFlag.LEARNED | SpotFlag.POOR_FIT)] * 50
    verdict = beam_quality([], changing, SpotModel.LEARNED, 255.0, limits)
    assert (verdict.ok, verdict.reason) == (False, "no model fits")
    assert "POOR_FIT in 100 % of frames" in verdict.measured
    mild = [spot._replace(chi2_per_dof=1.8, flags=SpotFlag.POOR_FIT)] * 50
    assumed = beam_quality([], mild, SpotModel.ONE, 255.0, limits, noise_is_known=False)
    assert (assumed.ok, assumed.remedy) == (True, "rig calibrate sensor")


LIMITS = BalanceLimits()
LIMIT_RAD_PER_S = math.radians(LIMITS.spin_deg_per_min) / 60.0


def turning(part_of_limit: float, u_part: float) -> Balance:
    """A balance of which only the rotation is known, in parts of its limit."""
    rate, u = (part * LIMIT_RAD_PER_S for part in (part_of_limit, u_part))
    return balance_of(rotation_rad_per_s=rate, u_rotation_rad_per_s=u)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize(
    ("part", "run_ok", "moment_ok"), [(0.9, True, True), (1.1, False, True), (1.3, False, False)]
)
def test_a_rotation_near_its_limit(sign: float, part: float, run_ok: bool, moment_ok: bool) -> None:
    balance = turning(sign * part, 0.1)
    assert [one.ok for one in balance_verdicts(balance, LIMITS)] == [run_ok]
    assert (not balance_failures(balance, LIMITS)) == moment_ok


def test_a_run_says_where_it_does_not_know_whether_its_plane_turned() -> None:
    unknown = turning(math.nan, math.nan)
    for balance in (None, unknown):
        (one,) = run_balance_verdicts(balance, LIMITS)
        assert one.ok
        assert one.name == "plane of swing"
        assert "not known" in one.reason
        assert one.remedy
    assert run_balance_verdicts(turning(0.5, 0.1), LIMITS) == balance_verdicts(turning(0.5, 0.1), LIMITS)
