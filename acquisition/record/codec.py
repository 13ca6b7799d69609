"""Encoding of pixels as messages, and decoding, and the types of Foxglove's messages.

Windows around the spot and whole frames are both compressed without loss. Windows are stored in about half
the bytes as the pixels minus a model of the fitted spot. The model is computed from six integers by integer
arithmetic only, so that every computer computes the same; docs/reference/record.md states the rule.
Differences are stored as bit planes, which zstd compresses best.
"""

import functools
import math

import numpy as np
import zstandard
from numpy.typing import NDArray

from acquisition.camera import Image
from acquisition.record.schemas import MessageType
from acquisition.record.topics import WINDOW, IntegerGaussian, RecordedWindow
from processing.kernel import kernel
from processing.spot import Spot

_ZSTD_LEVEL = 1
_LARGE_BYTES = 64 * 1024
"""Minimum size of an image compressed by itself, which is faster than in a chunk of small messages."""
_NO_MODEL = IntegerGaussian(0, 0, 0, 0, 0, 0)

_LAST_TABLE_ENTRY = 9216
"""Last entry of the table: 6 standard deviations, where less than one part in 4096 is left."""
_DECAY = 1150671902385460292
"""exp(-1/512) times 2^60, rounded down."""
_VALUE_LIMIT = 2**16
"""Upper limit of all numbers in px and DN, so that the pixels of the model fit into 32 bits."""
_MAX_CORRELATION = 0.05
"""Correlation of x and y in the beam above which the upright model leaves more than noise."""
_LOWEST_BITS = np.uint64(0x0101010101010101)
_GATHER = np.uint64(0x8040201008040201)
_TOP_BYTE = np.uint64(56)


def encode_window(
    sequence: int, time_ns: int, image: Image, x0_px: int, y0_px: int, spot: Spot | None = None
) -> bytes:
    """Message of type `WINDOW` with an image (ny, nx); (x0, y0) is its first pixel on the sensor.

    With the fitted `spot` the pixels minus a model of it are stored, without loss, in about half the bytes.
    """
    height, width = image.shape
    is_large = image.nbytes >= _LARGE_BYTES
    model, count = None if spot is None else _spot_model(spot, x0_px, y0_px, (height, width)), 0
    if model is not None:
        # a copy where it is not writable: for such arrays numba would compile the kernel a second time
        writable = np.require(image, f"u{image.itemsize}", ("C", "W"))
        filled = np.empty((8 * image.itemsize, (image.size + 7) // 8), dtype=np.uint8)
        count = _fill_planes(writable, _table(), *model, filled)
        planes = filled[:count].tobytes()
    if model is None or count >= 8 * image.itemsize:
        model, count = _NO_MODEL, 0
        pixels = np.ascontiguousarray(image, dtype=f"<u{image.itemsize}").view(np.uint8)
        # high bytes vary little from pixel to pixel: stored apart from the low bytes they compress well
        planes = pixels.reshape(-1, image.itemsize).T.tobytes()
    if is_large:
        planes = zstandard.compress(planes, _ZSTD_LEVEL)
    head = (sequence, time_ns, x0_px, y0_px, width, height, image.itemsize, int(is_large))
    return WINDOW.encode(*head, *model, count, planes)


def decode_window(kind: MessageType, data: bytes) -> RecordedWindow:
    """Window from a message of the type `kind`. Raises ValueError if the number of pixels is wrong."""
    fields = dict(zip(kind.names, kind.decode(data), strict=True))
    shape, size = (fields["height_px"], fields["width_px"]), fields["bytes_per_pixel"]
    count, has_model = shape[0] * shape[1], bool(fields["model_inverse_x"])
    expected_bytes = fields["bit_planes"] * ((count + 7) // 8) if has_model else count * size
    pixels = fields["pixels"]
    is_compressed = fields["compressed"]
    pixels_bytes = zstandard.get_frame_parameters(pixels).content_size if is_compressed else len(pixels)
    if pixels_bytes != expected_bytes:
        raise ValueError(f"{kind.full_name}: its pixels are not {shape[1]} x {shape[0]}")
    pixels = zstandard.decompress(pixels) if is_compressed else pixels
    image: Image
    if has_model:
        model = IntegerGaussian(*(fields[f"model_{name}"] for name in IntegerGaussian._fields))
        image = _from_planes(pixels, fields["bit_planes"], model, shape, size)
    else:
        planes = np.frombuffer(pixels, dtype=np.uint8).reshape(size, -1)
        image = np.ascontiguousarray(planes.T).view(f"<u{size}").reshape(shape)
    image.flags.writeable = False
    return RecordedWindow(fields["sequence"], fields["time_ns"], image, (fields["x0_px"], fields["y0_px"]))


def _spot_model(spot: Spot, x0_px: int, y0_px: int, shape: tuple[int, int]) -> IntegerGaussian | None:
    """Model of a spot in a window (ny, nx); None where it was lost, is too tilted, or too large."""
    x_px, y_px = spot.x_px - x0_px, spot.y_px - y0_px
    numbers = (x_px, y_px, *spot[4:9])
    if not all(abs(number) < _VALUE_LIMIT for number in numbers):
        return None
    cos, sin = math.cos(spot.rotation_rad), math.sin(spot.rotation_rad)
    # pixels integrate over the light, which widens the spot by the variance of their width
    variance_1, variance_2 = spot.sigma_x_px**2, spot.sigma_y_px**2
    variance_x = variance_1 * cos**2 + variance_2 * sin**2 + 1 / 12
    variance_y = variance_1 * sin**2 + variance_2 * cos**2 + 1 / 12
    root = math.sqrt(variance_x * variance_y)
    amplitude_dn = spot.amplitude_dn * abs(spot.sigma_x_px * spot.sigma_y_px) / root
    if abs((variance_1 - variance_2) * sin * cos) > _MAX_CORRELATION * root:
        return None
    model = IntegerGaussian(
        round(256 * x_px),
        round(256 * y_px),
        round(2**32 / variance_x),
        round(2**32 / variance_y),
        round(8 * amplitude_dn),
        max(0, round(8 * spot.background_dn)),
    )
    if min(model[2:]) < 0 or model.inverse_x == 0 or model.amplitude + model.background >= 8 * _VALUE_LIMIT:
        return None
    reach_x = max(abs(model.x), abs(256 * shape[1] - model.x))
    reach_y = max(abs(model.y), abs(256 * shape[0] - model.y))
    return model if max(reach_x**2 * model.inverse_x, reach_y**2 * model.inverse_y) < 2**63 else None


def _from_planes(
    data: bytes, count: int, model: IntegerGaussian, shape: tuple[int, int], bytes_per_pixel: int
) -> Image:
    """Image of this shape (ny, nx) from `count` bit planes. Raises ValueError where sizes differ."""
    dtype = np.dtype(f"u{bytes_per_pixel}")
    size = shape[0] * shape[1]
    planes = np.frombuffer(data, dtype=np.uint8).reshape(count, (size + 7) // 8)
    folded = np.zeros(size, dtype=dtype)
    for plane, bits in enumerate(np.unpackbits(planes, axis=1, count=size)):
        folded |= bits.astype(dtype) << dtype.type(plane)
    residuals = (folded >> dtype.type(1)) ^ -(folded & dtype.type(1))
    y_profile = model.amplitude * _profile(shape[0], model.y, model.inverse_y) >> 12
    x_profile = _profile(shape[1], model.x, model.inverse_x)
    modelled = (np.multiply.outer(y_profile, x_profile) + ((model.background << 12) + (1 << 14))) >> 15
    image: Image = modelled.astype(dtype) + residuals.reshape(shape)
    return image


def _profile(count: int, centre: int, inverse: int) -> NDArray[np.int64]:
    """Gaussian of height 4096 at the pixels 0, 1, ... of a line."""
    distance = 256 * np.arange(count, dtype=np.int64) - centre
    return _table().take(distance * distance * inverse >> 40, mode="clip")


@kernel
def _fill_planes(
    image: Image,
    table: NDArray[np.int64],
    x: int,
    y: int,
    inverse_x: int,
    inverse_y: int,
    amplitude: int,
    background: int,
    planes: NDArray[np.uint8],
) -> int:
    """Write the bit planes of the image minus the model; returns how many are not empty."""
    ny, nx = image.shape
    bits, in_plane = planes.shape
    modulus = (1 << bits) - 1
    offset = (background << 12) + (1 << 14)
    across = np.empty(nx, dtype=np.int64)
    for column in range(nx):
        across[column] = table[min((256 * column - x) ** 2 * inverse_x >> 40, _LAST_TABLE_ENTRY)]
    low = np.zeros(8 * in_plane, dtype=np.uint8)
    high = np.zeros(8 * in_plane if bits > 8 else 0, dtype=np.uint8)
    used = 0
    for row in range(ny):
        height = amplitude * table[min((256 * row - y) ** 2 * inverse_y >> 40, _LAST_TABLE_ENTRY)] >> 12
        for column in range(nx):
            rest = (np.int64(image[row, column]) - ((height * across[column] + offset) >> 15)) & modulus
            # 0, -1, 1, -2, ... become 0, 1, 2, 3, ...: twice the number, all bits turned where it is negative
            number = ((rest << 1) ^ -(rest >> (bits - 1))) & modulus
            used |= number
            low[row * nx + column] = number & 255
            if bits > 8:
                high[row * nx + column] = number >> 8
    count = 0
    while used >> count:
        eights = (low if count < 8 else high).view(np.uint64)
        shift = np.uint64(count % 8)
        for i in range(in_plane):
            # the product brings the lowest bits of eight bytes together, the first byte's to the top
            planes[count, i] = (((eights[i] >> shift) & _LOWEST_BITS) * _GATHER) >> _TOP_BYTE
        count += 1
    return count


@functools.cache
def _table() -> NDArray[np.int64]:
    """exp(-i/512) times 4096, rounded, from repeated products of integers; the last entry is 0."""
    entries, value = [], 1 << 60
    for _ in range(_LAST_TABLE_ENTRY):
        entries.append(((value >> 47) + 1) >> 1)
        value = value * _DECAY >> 60
    return np.array([*entries, 0], dtype=np.int64)


_PREVIEW_PX = 480
"""Longest side of a preview; larger images are reduced by a whole number."""


def preview_step(shape: tuple[int, int]) -> int:
    """Whole number by which an image (ny, nx) is reduced for its preview."""
    return -(-max(shape) // _PREVIEW_PX)
