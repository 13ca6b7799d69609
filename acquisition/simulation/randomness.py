"""Random numbers that depend only on a key, so that a frame's noise is independent of the order of calls.

SplitMix64 (Steele, Lea, Flood 2014) increments a key by a fixed odd number and scrambles the bits; its 64-bit
state is an argument and a return value of the functions. Normal numbers are drawn by the ziggurat method
(Marsaglia, Tsang 2000, in Doornik's form), Poisson numbers by Hörmann's transformed rejection (1993) for
means above 10 and by multiplication below.
"""

import functools
import math

import numpy as np
from numpy.typing import NDArray

from processing.kernel import kernel

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_MIX1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX2 = np.uint64(0x94D049BB133111EB)
_S30 = np.uint64(30)
_S27 = np.uint64(27)
_S31 = np.uint64(31)
_S11 = np.uint64(11)
_LAYER = np.uint64(255)
_TO_UNIT = 2.0**-53
_LAYERS = 256
_LAYER_EDGE = 3.6541528853610088
"""Beginning of the tail of the ziggurat with 256 layers of equal area."""


@functools.cache
def ziggurat() -> NDArray[np.float64]:
    """Edges (257,) of layers of equal area under exp(-x^2/2), from the width of the lowest layer to 0."""
    x = np.zeros(_LAYERS + 1)
    density = math.exp(-0.5 * _LAYER_EDGE**2)
    area = _LAYER_EDGE * density + math.sqrt(0.5 * math.pi) * math.erfc(_LAYER_EDGE / math.sqrt(2))
    x[0] = area / density
    x[1] = _LAYER_EDGE
    for layer in range(2, _LAYERS):
        density += area / x[layer - 1]
        x[layer] = math.sqrt(-2.0 * math.log(density))
    return x


@kernel
def scramble(z: np.uint64) -> np.uint64:
    """Scrambled bits: a one-to-one mapping of 64 bits to 64 bits that look random."""
    z = (z ^ (z >> _S30)) * _MIX1
    z = (z ^ (z >> _S27)) * _MIX2
    return z ^ (z >> _S31)


@kernel
def stream_key(seed: int, run: int, frame: int, purpose: int) -> np.uint64:
    """Initial state of the random numbers of one frame of one run for one purpose."""
    key = scramble(np.uint64(seed) + _GOLDEN)
    key = scramble(key ^ (np.uint64(run) * _MIX1 + _GOLDEN))
    key = scramble(key ^ (np.uint64(purpose) * _MIX2 + _GOLDEN))
    return scramble(key ^ (np.uint64(frame) * _GOLDEN + _MIX2))


@kernel
def uniform(state: np.uint64) -> tuple[np.uint64, float]:
    """Next state and a number in (0, 1)."""
    state = state + _GOLDEN
    return state, (np.float64(scramble(state) >> _S11) + 0.5) * _TO_UNIT


@kernel
def _normal_beyond(
    state: np.uint64, z: float, layer: int, edges: NDArray[np.float64]
) -> tuple[np.uint64, float]:
    """The rare cases of the ziggurat method: tail, edges of the layers, new numbers until one is accepted."""
    while True:
        if layer == 0:
            while True:
                state, first = uniform(state)
                state, second = uniform(state)
                step = -math.log(first) / _LAYER_EDGE
                if -2.0 * math.log(second) >= step * step:
                    beyond = _LAYER_EDGE + step
                    return state, (beyond if z > 0 else -beyond)
        low = math.exp(-0.5 * (edges[layer] ** 2 - z * z))
        high = math.exp(-0.5 * (edges[layer + 1] ** 2 - z * z))
        state, level = uniform(state)
        if low + level * (high - low) < 1.0:
            return state, z
        state = state + _GOLDEN
        bits = scramble(state)
        layer = int(bits & _LAYER)
        z = (np.float64(np.int64(bits >> _S11)) * (2.0 * _TO_UNIT) - 1.0) * edges[layer]
        if abs(z) < edges[layer + 1]:
            return state, z


@kernel
def fill_normals(state: np.uint64, edges: NDArray[np.float64], numbers: NDArray[np.float64]) -> np.uint64:
    """Fill `numbers` with the standard normal distribution; returns the next state."""
    # not a function of its own, because passing `edges` to one counts references at every number
    for i in range(numbers.shape[0]):
        state = state + _GOLDEN
        bits = scramble(state)
        layer = int(bits & _LAYER)
        z = (np.float64(np.int64(bits >> _S11)) * (2.0 * _TO_UNIT) - 1.0) * edges[layer]
        if not abs(z) < edges[layer + 1]:
            state, z = _normal_beyond(state, z, layer, edges)
        numbers[i] = z
    return state


@kernel
def poisson(state: np.uint64, mean: float) -> tuple[np.uint64, float]:
    """Next state and a number of the Poisson distribution, exact for any mean."""
    if mean < 10.0:
        limit = math.exp(-mean)
        count = -1
        product = 1.0
        while product > limit or count < 0:
            state, factor = uniform(state)
            product *= factor
            count += 1
        return state, float(count)
    root = math.sqrt(mean)
    b = 0.931 + 2.53 * root
    a = -0.059 + 0.02483 * b
    inverse_alpha = 1.1239 + 1.1328 / (b - 3.4)
    quick = 0.9277 - 3.6224 / (b - 2.0)
    log_mean = math.log(mean)
    while True:
        state, first = uniform(state)
        state, v = uniform(state)
        u = first - 0.5
        us = 0.5 - abs(u)
        k = math.floor((2.0 * a / us + b) * u + mean + 0.43)
        if us >= 0.07 and v <= quick:
            return state, k
        if k < 0 or (us < 0.013 and v > us):
            continue
        if math.log(v * inverse_alpha / (a / (us * us) + b)) <= k * log_mean - mean - math.lgamma(k + 1.0):
            return state, k


def normals(
    seed: int, run: int, purpose: int, first_frame: int, shape: tuple[int, int]
) -> NDArray[np.float64]:
    """Standard normal numbers of this shape, one row a frame; see `frame_normals`."""
    out = np.empty(shape)
    frame_normals(seed, run, purpose, first_frame, ziggurat(), out)
    return out


@kernel
def frame_normals(
    seed: int, run: int, purpose: int, first_frame: int, edges: NDArray[np.float64], out: NDArray[np.float64]
) -> None:
    """Standard normal numbers, one row a frame: `out` is (frames, numbers)."""
    for row in range(out.shape[0]):
        state = stream_key(seed, run, first_frame + row, purpose)
        fill_normals(state, edges, out[row])
