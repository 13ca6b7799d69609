"""Speed of the spot tracker in units of cv2.sumElems over a frame that is not in the cache, and of its peers.

Everything is measured in interleaved rounds of one run on one core; medians over the rounds are taken.
Run as ``python -m tests.benchmarks spot_speed [--quick]``.
"""

import math
import time
import warnings
from collections.abc import Callable
from statistics import median
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from processing.spot import SpotTracker
from tests.processing.spot.frames import EIGHT_BIT, exposed, light, side_of

SHAPE = (1024, 1280)
RING = 64
"""Frames of 1.3 MB: more than the caches hold."""
TURN = 8
"""Frames that one method reads before the next one's turn, so that all of them meet the same load."""
SIGMAS = (3, 6, 12)
PEAK = 180.0
BLOCK = 20

Frames = list[NDArray[Any]]


def swinging() -> NDArray[np.float64]:
    """Places of a spot that moves as a pendulum does."""
    phase = 0.05 * np.arange(RING)
    return np.column_stack((640.3 + 8 * np.sin(phase), 512.6 + np.cos(phase)))


def ring(sigma: float, truth: NDArray[np.float64], rng: np.random.Generator, hot_pixels: int) -> Frames:
    """Full frames with a spot."""
    frames: Frames = []
    reach = int(6 * sigma)
    side = 2 * reach + 1
    for x, y in truth:
        frame = np.rint(6 + rng.normal(0, 0.18, SHAPE)).astype(np.uint8)
        column, row = int(x) - reach, int(y) - reach
        spot = light((side, side), x - column, y - row, sigma, PEAK)
        frame[row : row + side, column : column + side] = exposed(spot, rng)
        frame[rng.integers(0, SHAPE[0], hot_pixels), rng.integers(0, SHAPE[1], hot_pixels)] = 220
        frames.append(frame)
    return frames


def against_sums(rounds: int) -> list[dict[str, float]]:
    """All widths, without and with hot pixels."""
    cv2.setNumThreads(1)
    return [against_sum(sigma, hot, rounds) for sigma in SIGMAS for hot in (0, 200)]


def against_sum(sigma: float, hot_pixels: int, rounds: int) -> dict[str, float]:
    """Ratios to the time cv2.sumElems needs for as many frames of the same ring.

    The methods take turns, each with the next frames of the ring: no frame is read again before the
    whole ring has been. The median over the rounds of each round's ratio is taken.
    """
    frames = ring(sigma, swinging(), np.random.default_rng(31), hot_pixels)
    follower = SpotTracker(EIGHT_BIT)
    actions: dict[str, Callable[[NDArray[Any]], object]] = {
        "cv2.sumElems": cv2.sumElems,
        "following": follower.track,
    }
    for action in actions.values():
        action(frames[0])
    times: dict[str, list[float]] = {name: [] for name in actions}
    place = 0
    for _ in range(rounds):
        for name, action in actions.items():
            if name == "following":
                # two frames before its turn, untimed: where the spot is and how it moves
                follower.reset()
                for frame in (frames[place - 2], frames[place - 1]):
                    follower.track(frame)
            turn = frames[place : place + TURN]
            begin_s = time.perf_counter()
            for frame in turn:
                action(frame)
            times[name].append((time.perf_counter() - begin_s) / TURN * 1e6)
            place = (place + TURN) % RING
        # so that the next round gives each method other frames
        place = (place + TURN) % RING
    sum_us = np.array(times.pop("cv2.sumElems"))
    result: dict[str, float] = {"sigma_px": sigma, "hot_pixels": hot_pixels}
    result["sum_us"] = float(np.median(sum_us))
    for name, values in times.items():
        result[f"{name}, us"] = median(values)
        result[f"{name}, ratio"] = float(np.median(np.array(values) / sum_us))
    return result


def windows(sigma: float, count: int, seed: int) -> tuple[NDArray[Any], NDArray[np.float64]]:
    """Stack of windows with a spot at random phases."""
    rng = np.random.default_rng(seed)
    n = side_of(sigma)
    truth = n / 2 + rng.uniform(-0.5, 0.5, (count, 2))
    return np.array([exposed(light((n, n), x, y, sigma, PEAK), rng) for x, y in truth]), truth


Place = tuple[float, float]


def _picasso(image: NDArray[Any]) -> Place:
    from picasso import gaussmle

    n = min(image.shape) // 2 * 2 - 1
    # photons, as the method wants them: the background's pedestal has no shot noise to speak of
    spot = ((image[:n, :n].astype(np.float32) - 6) * 39.2).clip(min=0)[None]
    theta = gaussmle.gaussmle(spot, eps=1e-3, max_it=100, method="sigmaxy")[0][0]
    return float(theta[0]), float(theta[1])


def _photutils(image: NDArray[Any]) -> Place:
    from photutils.centroids import centroid_2dg

    x, y = centroid_2dg(image - 6.0)
    return float(x), float(y)


def _trackpy(image: NDArray[Any]) -> Place:
    import trackpy

    trackpy.quiet()
    found = trackpy.locate(image, 37, topn=1, preprocess=True)
    return float(found.x.iloc[0]), float(found.y.iloc[0])


def _laserbeamsize(image: NDArray[Any]) -> Place:
    import laserbeamsize

    x, y = laserbeamsize.beam_size(image)[:2]
    return float(x), float(y)


def _astropy(image: NDArray[Any]) -> Place:
    from astropy.modeling import fitting, models

    ny, nx = image.shape
    y, x = np.mgrid[:ny, :nx]
    start = models.Gaussian2D(PEAK, nx / 2, ny / 2, 6, 6) + models.Const2D(6.0)
    fit = fitting.TRFLSQFitter()(start, x, y, image.astype(float))
    return float(fit.x_mean_0.value), float(fit.y_mean_0.value)


def _lmfit(image: NDArray[Any]) -> Place:
    from lmfit.models import ConstantModel, Gaussian2dModel

    model = Gaussian2dModel() + ConstantModel()
    ny, nx = image.shape
    y, x = np.mgrid[:ny, :nx]
    start = model.make_params(amplitude=PEAK * 226, centerx=nx / 2, centery=ny / 2, sigmax=6, sigmay=6, c=6)
    fit = model.fit(image.ravel().astype(float), start, x=x.ravel(), y=y.ravel())
    return fit.params["centerx"].value, fit.params["centery"].value


def _cv2_moments(image: NDArray[Any]) -> Place:
    # the background is subtracted, and what then is negative stays so
    m = cv2.moments(image.astype(np.float32) - 6.0)
    return m["m10"] / m["m00"], m["m01"] / m["m00"]


PEERS = {
    "picasso gaussmle": _picasso,
    "photutils centroid_2dg": _photutils,
    "trackpy locate": _trackpy,
    "laserbeamsize": _laserbeamsize,
    "astropy Gaussian2D": _astropy,
    "lmfit Gaussian2d": _lmfit,
    "cv2.moments": _cv2_moments,
}


def peers(quick: bool) -> dict[str, Any]:
    """Time and RMS error of each peer that can be imported, on the same windows as the tracker."""
    images, truth = windows(6, 40 if quick else 200, 51)
    tracker = SpotTracker(EIGHT_BIT)

    def ours(image: NDArray[Any]) -> tuple[float, float]:
        spot = tracker.track(image)
        return spot.x_px, spot.y_px

    methods: dict[str, Callable[[NDArray[Any]], tuple[float, float]]] = {"this tracker": ours}
    result: dict[str, Any] = {}
    for name, peer in PEERS.items():
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                peer(images[0])
            methods[name] = peer
        except Exception as error:  # a peer's own failure is what is reported
            result[name] = {"skipped": f"{type(error).__name__}: {error}".splitlines()[0][:120]}
    times: dict[str, list[float]] = {name: [] for name in methods}
    errors: dict[str, list[tuple[float, float]]] = {name: [] for name in methods}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        # whole blocks, so that no method pays for the cache that another one filled
        for start in range(0, len(images), BLOCK):
            block = images[start : start + BLOCK]
            for name, locate in methods.items():
                locate(block[0])
                begin_s = time.perf_counter()
                found = [locate(image) for image in block]
                times[name].append((time.perf_counter() - begin_s) / len(block) * 1e6)
                errors[name].extend(
                    (px - x, py - y) for (px, py), (x, y) in zip(found, truth[start:], strict=False)
                )
    own_us = median(times["this tracker"])
    for name in methods:
        # the mean is a matter of convention (pixel corner or centre) or a bias; the scatter is compared
        result[name] = {
            "us": median(times[name]),
            "times_slower": median(times[name]) / own_us,
            "scatter_mpx": 1e3 * math.sqrt(np.mean(np.var(np.array(errors[name]), axis=0))),
        }
    return result


def run(quick: bool = False) -> dict[str, Any]:
    """All of it; numbers as plain values."""
    cv2.setNumThreads(1)
    return {"against_sum": against_sums(20 if quick else 200), "peers": peers(quick)}
