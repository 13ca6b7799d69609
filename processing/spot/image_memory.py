"""Images as the kernels take them, and the memory of a search in them."""

from typing import Any

import numpy as np

from processing.errors import DataError
from processing.spot.scan import BAND_ROWS, BAND_STEP
from processing.spot.spot import Image


class _Writable:
    """Array interface to a read-only array's memory that does not declare it read-only.

    numba treats read-only arrays as a separate type and would compile every kernel a second time for them.
    The kernels do not write to the image.
    """

    def __init__(self, image: Image) -> None:
        self._image = image
        interface = dict(image.__array_interface__)
        interface["data"] = (interface["data"][0], False)
        self.__array_interface__ = interface


def plain(images: Image) -> Image:
    """The image in C order, aligned, and of the array type that the kernels are compiled for."""
    if not (images.flags.c_contiguous and images.flags.aligned):
        return images.copy(order="C")
    memory: Any = _Writable(images)
    writable: Image = np.asarray(memory)
    return writable


class SearchMemory:
    """Working memory of a search in images of one shape and type."""

    def __init__(self, image: Image) -> None:
        ny, nx = image.shape
        if min(ny, nx) < 5:
            raise DataError(f"image has shape {image.shape}; at least 5 x 5 pixels are needed")
        self.mask = np.zeros((ny, nx), dtype=np.uint8)
        self.stack = np.zeros(ny * nx, dtype=np.int64)
        rows = (ny + BAND_ROWS - 1) // BAND_ROWS
        columns = (nx + BAND_STEP - 1) // BAND_STEP * BAND_STEP + 2
        self.bands: Image = np.zeros((rows, columns), dtype=image.dtype)

    def fits(self, image: Image) -> bool:
        """Whether it is for such images."""
        return image.shape == self.mask.shape and image.dtype == self.bands.dtype
