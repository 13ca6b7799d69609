"""One image with its number and times."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8] | NDArray[np.uint16]


class Frame(NamedTuple):
    """One frame as the camera delivered it.

    Attributes
    ----------
    image
        Shape (ny, nx), uint8 or uint16, in DN; read-only for everyone behind the camera. The
        camera does not write to it again.
    sequence
        The camera's own frame number, counted from 0 at `start`; a gap is a lost frame.
    device_time_ns
        The camera's clock in integer nanoseconds: from a driver at the moment of the exposure that
        `CameraInfo.stamped` states, in a session at its middle; -1 where the camera has no clock of its own.
    host_time_ns
        The host's monotonic clock when the frame arrived, before any processing.
    """

    image: Image
    sequence: int
    device_time_ns: int
    host_time_ns: int

    @property
    def time_ns(self) -> int:
        """The camera's clock where it has one, else the host's monotonic clock."""
        return self.device_time_ns if self.device_time_ns >= 0 else self.host_time_ns
