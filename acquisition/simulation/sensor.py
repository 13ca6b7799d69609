"""The image sensor: conversion of light into electrons with noise, and into DN.

A pixel holds ``min(Poisson(light), full well)`` electrons, read noise is added, and the sum over
the gain plus the black level is rounded and clipped to 0 ... full scale. Pixels without light have only the
black level with read noise, with one distribution of DN for all of them, and are drawn from a table.
Pixels with light are drawn one by one.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from acquisition.simulation import randomness
from acquisition.simulation.optics import MIN_LIGHT_E, GaussianBeam, add_beam, beam_box
from acquisition.simulation.randomness import fill_normals, poisson, scramble, stream_key, uniform
from acquisition.simulation.settings import SensorState, SensorTruth
from processing.kernel import kernel

_MAP, _HOT, FRAME = 1, 2, 3
"""Purposes of the random numbers; each purpose has numbers of its own."""
_MAX_COLUMNS = 2**14
_MIN_PROBABILITY = 2.0**-34
"""Probability of a value below which 32 random bits cannot represent it."""
_MIN_SPARSE_PROBABILITY = 0.94
"""Probability of the most frequent value from which on the rare values alone are drawn."""
_CLIP_SD = 7.0
"""Distance from the full well in standard deviations below which pixels are drawn exactly."""

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_U32 = np.uint64(32)
_LOW32 = np.uint64(0xFFFFFFFF)


class DarkTable(NamedTuple):
    """Distribution of a dark pixel's DN, drawn in one of two ways.

    If `sparse`, nearly all pixels have one value. The others follow each other at geometrically distributed
    distances. Otherwise every pixel is drawn by Walker's alias method from 32 random bits: the upper bits
    are the number of a column, the lower bits decide between the two values of the column.
    """

    sparse: bool
    common_dn: int
    common: float
    """Probability of the most frequent value `common_dn`."""
    rare_dn: NDArray[np.int64]
    rare_below: NDArray[np.float64]
    """Cumulative probabilities of the other values `rare_dn`."""
    first: NDArray[np.uint16]
    second: NDArray[np.uint16]
    threshold: NDArray[np.uint32]
    """Number that is compared with the `shift` lower bits: below it the first value of a column is drawn."""
    shift: int


class Pixels(NamedTuple):
    """Properties of single pixels in the region that is read out."""

    response: NDArray[np.float32]
    """Relative response (ny, nx); shape (0, 0) if it is 1 everywhere."""
    hot_row: NDArray[np.int64]
    hot_column: NDArray[np.int64]
    hot_e: NDArray[np.float64]
    """Mean dark signal of the hot pixels in e-."""


def dark_probabilities(state: SensorState) -> NDArray[np.float64]:
    """Probability of each DN, 0 ... full scale, for a pixel without light."""
    spread_dn = max(state.read_noise_e / state.gain_e_per_dn, 1e-9)
    edges = (np.arange(state.full_scale_dn) + 0.5 - state.black_level_dn) / (spread_dn * math.sqrt(2))
    near = np.clip(edges, -30, 30)
    # differences are taken of the smaller tail on either side, which loses no digits
    upper = np.array([0.5 * math.erfc(edge) for edge in near])
    lower = np.array([0.5 * math.erfc(-edge) for edge in near])
    p = np.where(near[:-1] > 0, upper[:-1] - upper[1:], lower[1:] - lower[:-1])
    return np.concatenate(([lower[0]], p, [upper[-1]]))


def dark_table(state: SensorState) -> DarkTable:
    """Tables from which the values of dark pixels are drawn."""
    p = dark_probabilities(state)
    common = int(np.argmax(p))
    rare = np.flatnonzero(p)
    rare = rare[rare != common]
    weights = p[rare]
    below = np.cumsum(weights) / weights.sum() if len(rare) else np.ones(1)
    sparse = bool(p[common] >= _MIN_SPARSE_PROBABILITY)
    first, second, threshold, shift = _alias(p) if not sparse else _alias(np.ones(1))
    return DarkTable(
        sparse=sparse,
        common_dn=common,
        common=float(p[common]),
        rare_dn=rare.astype(np.int64) if len(rare) else np.array([common], dtype=np.int64),
        rare_below=below,
        first=first,
        second=second,
        threshold=threshold,
        shift=shift,
    )


def _alias(
    p: NDArray[np.float64],
) -> tuple[NDArray[np.uint16], NDArray[np.uint16], NDArray[np.uint32], int]:
    """Walker's alias table (first, second, threshold, shift) of values that 32 random bits can represent."""
    values = np.flatnonzero(p > _MIN_PROBABILITY)
    values = np.sort(values[np.argsort(p[values])[::-1][:_MAX_COLUMNS]])
    columns = 1 << max(8, (len(values) - 1).bit_length())
    shift = 32 - (columns.bit_length() - 1)
    share = np.zeros(columns)
    share[: len(values)] = p[values] / p[values].sum() * columns
    first = np.zeros(columns, dtype=np.uint16)
    first[: len(values)] = values
    second = first.copy()
    keep = np.ones(columns)
    small = [i for i in range(columns) if share[i] < 1]
    large = [i for i in range(columns) if share[i] >= 1]
    while small and large:
        less, more = small.pop(), large.pop()
        keep[less] = share[less]
        second[less] = first[more]
        share[more] -= 1 - share[less]
        (small if share[more] < 1 else large).append(more)
    return first, second, np.rint(keep * 2**shift).astype(np.uint32), shift


def pixels(truth: SensorTruth, seed: int, x0: int, y0: int, nx: int, ny: int, binning: int = 1) -> Pixels:
    """Response and hot pixels of a region; they depend on the position on the sensor, not on the region.

    The region is in pixels of the image, which combine `binning` pixels of the sensor in each direction.
    """
    empty = np.empty((0, 0), dtype=np.float32)
    response = empty
    if truth.prnu > 0:
        noise = randomness.normals(seed, 0, _MAP, 0, (truth.height_px, truth.width_px))
        region = np.s_[y0 * binning : (y0 + ny) * binning, x0 * binning : (x0 + nx) * binning]
        blocks = np.maximum(1 + truth.prnu * noise, 0)[region].reshape(ny, binning, nx, binning)
        response = blocks.mean(axis=(1, 3)).astype(np.float32)
    generator = np.random.Generator(np.random.PCG64([seed, _HOT]))
    count = min(truth.hot_pixels, truth.width_px * truth.height_px)
    index = generator.choice(truth.width_px * truth.height_px, size=count, replace=False)
    hot_e: NDArray[np.float64] = generator.exponential(truth.hot_pixel_dn * truth.gain_e_per_dn, size=count)
    row, column = index // truth.width_px // binning, index % truth.width_px // binning
    inside = (row >= y0) & (row < y0 + ny) & (column >= x0) & (column < x0 + nx)
    row, column, hot_e = row[inside] - y0, column[inside] - x0, hot_e[inside]
    if binning > 1:  # one pixel of the image may combine two hot pixels of the sensor
        indices, owners = np.unique(row * nx + column, return_inverse=True)
        row, column = indices // nx, indices % nx
        hot_e = np.bincount(owners, weights=hot_e, minlength=len(indices)).astype(np.float64)
    return Pixels(np.ascontiguousarray(response), row, column, hot_e)


@kernel
def expose_frames(
    images: NDArray[np.uint8],
    light_e: NDArray[np.float64],
    shapes: NDArray[np.float64],
    mains: NDArray[np.float64],
    ghosts: NDArray[np.float64],
    readout: SensorState,
    dark: DarkTable,
    pixel: Pixels,
    edges: NDArray[np.float64],
    seed: int,
    run: int,
    first: int,
) -> None:
    """Draw consecutive frames into `images` (n, ny, nx).

    `mains` and `ghosts` (n, 3) are the centres (x, y) in px and the peaks in e- of the beams, `shapes` (n, 3)
    the standard deviations in px and the rotation in rad of both. `light_e` (ny, nx) is working memory, zero
    before and after.
    """
    ny, nx = light_e.shape
    number = np.empty(1)
    for n in range(images.shape[0]):
        image = images[n]
        sigma_x_px, sigma_y_px, rotation_rad = shapes[n, 0], shapes[n, 1], shapes[n, 2]
        main = GaussianBeam(mains[n, 0], mains[n, 1], sigma_x_px, sigma_y_px, rotation_rad, mains[n, 2])
        ghost = GaussianBeam(ghosts[n, 0], ghosts[n, 1], sigma_x_px, sigma_y_px, rotation_rad, ghosts[n, 2])
        state = stream_key(seed, run, first + n, FRAME)
        ay0, ay1, ax0, ax1 = beam_box(main, ny, nx)
        by0, by1, bx0, bx1 = beam_box(ghost, ny, nx)
        if readout.ambient_e > 0.0:
            y0, y1, x0, x1 = 0, ny, 0, nx
            light_e[:, :] = readout.ambient_e
        elif by0 == by1:
            y0, y1, x0, x1 = ay0, ay1, ax0, ax1
        elif ay0 == ay1:
            y0, y1, x0, x1 = by0, by1, bx0, bx1
        else:
            y0, y1, x0, x1 = min(ay0, by0), max(ay1, by1), min(ax0, bx0), max(ax1, bx1)
        add_beam(light_e, main, ay0, ay1, ax0, ax1)
        add_beam(light_e, ghost, by0, by1, bx0, bx1)
        state = _draw_dark(image, dark, state)
        state = _draw_lit(image, light_e, y0, y1, x0, x1, readout, pixel.response, edges, state)
        for i in range(pixel.hot_e.shape[0]):
            y = pixel.hot_row[i]
            x = pixel.hot_column[i]
            e = (
                light_e[y, x] * (pixel.response[y, x] if pixel.response.shape[0] > 0 else 1.0)
                + pixel.hot_e[i]
            )
            state, value = _read_exactly(e, readout, edges, number, state)
            image[y, x] = value
        light_e[y0:y1, x0:x1] = 0.0


@kernel
def _draw_dark(image: NDArray[np.uint8], dark: DarkTable, state: np.uint64) -> np.uint64:
    """Draw every pixel as if without light; returns the state of the random numbers."""
    flat = image.reshape(-1)
    size = flat.shape[0]
    if dark.sparse:
        flat[:] = dark.common_dn
        if dark.common >= 1.0:
            return state
        scale = 1.0 / math.log(dark.common)
        place = -1.0
        while True:
            state, u = uniform(state)
            place += 1.0 + math.floor(math.log(u) * scale)
            if place >= size:
                return state
            state, u = uniform(state)
            i = 0
            while i < dark.rare_below.shape[0] - 1 and u > dark.rare_below[i]:
                i += 1
            flat[int(place)] = dark.rare_dn[i]
    shift = np.uint64(dark.shift)
    mask = (np.uint64(1) << shift) - np.uint64(1)
    for i in range(size // 2):
        bits = scramble(state + np.uint64(i + 1) * _GOLDEN)
        flat[2 * i] = _column_value(bits & _LOW32, dark, shift, mask)
        flat[2 * i + 1] = _column_value(bits >> _U32, dark, shift, mask)
    state = state + np.uint64(size // 2 + 1) * _GOLDEN
    if size % 2:
        flat[size - 1] = _column_value(scramble(state) & _LOW32, dark, shift, mask)
    return state


@kernel
def _column_value(bits: np.uint64, dark: DarkTable, shift: np.uint64, mask: np.uint64) -> int:
    column = bits >> shift
    return int(dark.first[column] if (bits & mask) < dark.threshold[column] else dark.second[column])


@kernel
def _draw_lit(
    image: NDArray[np.uint8],
    light_e: NDArray[np.float64],
    y0: int,
    y1: int,
    x0: int,
    x1: int,
    readout: SensorState,
    response: NDArray[np.float32],
    edges: NDArray[np.float64],
    state: np.uint64,
) -> np.uint64:
    """Draw the pixels with light.

    Where the sum of shot noise and read noise is nearly normal, it is one normal number, transformed to the
    correct skewness and kurtosis (Cornish and Fisher); the error of the distribution function is below 1e-4.
    Otherwise, and near the full well, both are drawn. A row in which every pixel is transformed is drawn in
    steps over the whole row, which the compiler turns into vector instructions.
    """
    read_variance = readout.read_noise_e**2
    uneven = response.shape[0] > 0
    smooth = readout.read_noise_e >= 2.0
    place = np.empty(x1 - x0, np.int64)
    mean_e = np.empty(x1 - x0)
    number = np.empty(x1 - x0)
    for y in range(y0, y1):
        count = 0
        least, most = math.inf, 0.0
        for x in range(x0, x1):
            mean = light_e[y, x]
            if mean < MIN_LIGHT_E:
                continue
            if uneven:
                mean *= response[y, x]
            place[count] = x
            mean_e[count] = mean
            count += 1
            least, most = min(least, mean), max(most, mean)
        bends = smooth and not _is_exact(least, read_variance, readout)
        if bends and not _is_exact(most, read_variance, readout):
            state = fill_normals(state, edges, number[:count])
            _bend(mean_e[:count], number[:count], readout)
            for i in range(count):
                image[y, place[i]] = int(number[i])
            continue
        for i in range(count):
            if not smooth or _is_exact(mean_e[i], read_variance, readout):
                state, value = _read_exactly(mean_e[i], readout, edges, number, state)
            else:
                state = fill_normals(state, edges, number[i : i + 1])
                _bend(mean_e[i : i + 1], number[i : i + 1], readout)
                value = int(number[i])
            image[y, place[i]] = value
    return state


@kernel
def _is_exact(mean_e: float, read_variance: float, readout: SensorState) -> bool:
    """Whether a pixel needs the exact noise, being too far from normal or too near to the full well."""
    variance = mean_e + read_variance
    return variance < 36.0 or mean_e + _CLIP_SD * math.sqrt(variance) > readout.full_well_e


# numpy's error model is needed: checks of each division for zero would prevent vector instructions
@kernel
def _bend(mean_e: NDArray[np.float64], number: NDArray[np.float64], readout: SensorState) -> None:
    """Turn standard normal numbers into the DN of pixels with these means."""
    read_variance = readout.read_noise_e**2
    per_e = 1.0 / readout.gain_e_per_dn
    offset = readout.black_level_dn + 0.5
    for i in range(number.shape[0]):
        mean, z = mean_e[i], number[i]
        variance = mean + read_variance
        sd = math.sqrt(variance)
        skew = mean / (variance * sd)
        excess = mean / (variance * variance)
        zz = z * z
        bent = z + skew * (zz - 1.0) / 6.0
        bent += z * (excess * (zz - 3.0) / 24.0 - skew * skew * (2.0 * zz - 5.0) / 36.0)
        dn = np.floor((mean + sd * bent) * per_e + offset)
        number[i] = min(max(dn, 0.0), readout.full_scale_dn)


@kernel
def _read_exactly(
    mean_e: float,
    readout: SensorState,
    edges: NDArray[np.float64],
    number: NDArray[np.float64],
    state: np.uint64,
) -> tuple[np.uint64, int]:
    """DN of one pixel, from electrons, full well and read noise; `number` (1,) is working memory."""
    state, electrons = poisson(state, mean_e)
    state = fill_normals(state, edges, number[:1])
    electrons = min(electrons, readout.full_well_e) + readout.read_noise_e * number[0]
    dn = math.floor(electrons / readout.gain_e_per_dn + readout.black_level_dn + 0.5)
    return state, int(min(max(dn, 0.0), readout.full_scale_dn))
