"""Pixels as messages: windows around the spot, and whole frames, both compressed without loss."""

import numpy as np
import zstandard

from acquisition.camera import Image
from acquisition.record.schemas import MessageType
from acquisition.record.topics import WINDOW, RecordedWindow
from acquisition.record.window_residual import IntegerGaussian, from_planes, spot_model, to_planes
from processing.spot import Spot

_ZSTD_LEVEL = 1
_LARGE_BYTES = 64 * 1024
"""From here on a message is compressed by itself, faster than the file compresses a chunk of small ones."""
_NO_MODEL = IntegerGaussian(0, 0, 0, 0, 0, 0)


class PixelEncoder:
    """Makes messages of pixels."""

    def __init__(self) -> None:
        self._zstd = zstandard.ZstdCompressor(level=_ZSTD_LEVEL)

    def encode(
        self, sequence: int, time_ns: int, image: Image, x0_px: int, y0_px: int, spot: Spot | None = None
    ) -> bytes:
        """Message of type `WINDOW` with an image (ny, nx); (x0, y0) is its first pixel on the sensor.

        With the fitted `spot` the pixels minus a model of it are stored, without loss, in about half the
        bytes.
        """
        height, width = image.shape
        large = image.nbytes >= _LARGE_BYTES
        head = (sequence, time_ns, x0_px, y0_px, width, height, image.itemsize, int(large))
        model = None if spot is None else spot_model(spot, x0_px, y0_px, (height, width))
        if model is not None:
            count, planes = to_planes(image, model)
            if count < 8 * image.itemsize:
                return WINDOW.encode(*head, *model, count, self._zstd.compress(planes) if large else planes)
        pixels = np.ascontiguousarray(image, dtype=f"<u{image.itemsize}").view(np.uint8)
        # high bytes vary little from pixel to pixel: stored apart from the low bytes they compress well
        planes = pixels.reshape(-1, image.itemsize).T.tobytes()
        return WINDOW.encode(*head, *_NO_MODEL, 0, self._zstd.compress(planes) if large else planes)


def decode_window(kind: MessageType, data: bytes) -> RecordedWindow:
    """Window from a message of the type `kind`. Raises ValueError if the number of pixels is wrong."""
    field = dict(zip(kind.names, kind.decode(data), strict=True))
    shape, size = (field["height_px"], field["width_px"]), field["bytes_per_pixel"]
    modelled = bool(field["model_inverse_x"])
    expected = (
        field["bit_planes"] * ((shape[0] * shape[1] + 7) // 8) if modelled else shape[0] * shape[1] * size
    )
    pixels = field["pixels"]
    held = zstandard.get_frame_parameters(pixels).content_size if field["compressed"] else len(pixels)
    if held != expected:
        raise ValueError(f"{kind.full_name}: its pixels are not {shape[1]} x {shape[0]}")
    pixels = zstandard.decompress(pixels) if field["compressed"] else pixels
    image: Image
    if modelled:
        model = IntegerGaussian(*(field[f"model_{name}"] for name in IntegerGaussian._fields))
        image = from_planes(pixels, field["bit_planes"], model, shape, size)
    else:
        planes = np.frombuffer(pixels, dtype=np.uint8).reshape(size, -1)
        image = np.ascontiguousarray(planes.T).view(f"<u{size}").reshape(shape)
    image.flags.writeable = False
    return RecordedWindow(field["sequence"], field["time_ns"], image, (field["x0_px"], field["y0_px"]))
