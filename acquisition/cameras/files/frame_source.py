"""What every source of recorded frames offers."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from numpy.typing import NDArray

from acquisition.cameras.files.timestamps import FrameTimes

ONE_IMAGE = "is one image; name the folder that holds the images, or a film"


class Unreadable(Exception):
    """One frame cannot be read; the message gives the reason."""


class Stored(NamedTuple):
    """Pixels as stored, (ny, nx) or (ny, nx, channels), and their largest possible value.

    `coloured`: the pixels are the luminance of a picture that has colour beside it.
    """

    pixels: NDArray[Any]
    full_scale: int
    coloured: bool = False


class FrameSource(ABC):
    """A source of frames."""

    count: int
    """Number of frames."""
    names: Sequence[str] = ()
    """Name of each frame's file; empty if the frames have no files of their own."""
    numbers: Sequence[int] | None = None
    """Number of each frame by its file's name, from 0; a gap is a missing file. None where names do not
    count.
    """
    times: FrameTimes | None = None
    """Times that the frames have by themselves, in ns from the first, and their numbers."""
    tick_s: float = 0.0
    """Resolution of these times."""
    said: Sequence[str] = ()
    """Lines on what is not as it should be: missing, cut off, out of order."""
    summary: str = ""
    """One line on what was found, for a person; may be empty."""
    pixel_aspect: float = 1.0
    """Width of a pixel over its height, as the source itself states it."""
    lossy: str = ""
    """Name of the codec if it is lossy, otherwise empty."""

    def __init__(self, path: Path) -> None:
        self._path = path

    @abstractmethod
    def read(self, index: int) -> Stored:
        """Frame `index`. Raises Unreadable for a damaged frame, OSError if the source is not accessible."""

    def label(self, index: int) -> str:
        """Name of the frame in messages."""
        return f"{self._path}, frame {index}"

    def close(self) -> None:  # noqa: B027 most hold nothing
        """Close the files; a later `read` opens them again."""
