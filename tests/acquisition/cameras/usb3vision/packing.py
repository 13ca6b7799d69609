"""Pixels as bytes on the bus, by the names of their formats."""

import numpy as np

from tests.acquisition.cameras.usb3vision import description as layout

# Bits of a pixel by the format's number (not the same as what it takes on the bus)
DEPTHS = {code: int("".join(filter(str.isdigit, name))) for name, code in layout.FORMATS.items()}


def pack(pixels: np.ndarray, pixel_format: int) -> bytes:
    """An image's bytes on the bus."""
    name = {code: name for name, code in layout.FORMATS.items()}[pixel_format]
    values = pixels.ravel()
    if name.endswith("Packed"):
        values = np.append(values, 0) if values.size % 2 else values
        one, two = values[0::2].astype(np.uint16), values[1::2].astype(np.uint16)
        low = DEPTHS[pixel_format] - 8
        rest = (1 << low) - 1
        triple = np.stack([one >> low, (one & rest) | (two & rest) << 4, two >> low], axis=1).astype(np.uint8)
        return triple.tobytes()[: -(-pixels.size * 12 // 8)]
    if name.endswith("p"):
        bits = DEPTHS[pixel_format]
        spread = np.unpackbits(values.astype("<u2").view(np.uint8).reshape(-1, 2), axis=1, bitorder="little")
        return np.packbits(spread[:, :bits].ravel(), bitorder="little").tobytes()
    return values.astype(np.uint8 if layout.BITS[name] == 8 else "<u2").tobytes()
