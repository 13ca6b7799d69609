"""Sources of recorded frames: folder of images, TIFF file, .npy stack, video."""

import contextlib
import logging
import math
import re
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from acquisition.cameras.files.formats import Ffv1Checksums, is_cut_off, read_pgm
from processing.errors import DeviceError

_log = logging.getLogger(__name__)
IMAGES = (".png", ".pgm", ".tif", ".tiff", ".bmp")
_STACKS = (".tif", ".tiff")
_LOSSLESS = ("FFV1", "HFYU", "FFVH", "GREY", "Y800", "Y8  ", "Y16 ", "RAW ", "\0\0\0\0")


class Unreadable(Exception):
    """One frame cannot be read; the message gives the reason."""


class Stored(NamedTuple):
    """Pixels as stored, (ny, nx) or (ny, nx, channels), and their largest possible value."""

    pixels: NDArray[Any]
    full_scale: int


class FrameSource(ABC):
    """A source of frames."""

    count: int
    """Number of frames."""
    names: Sequence[str] = ()
    """Name of each frame's file; empty if the frames have no files of their own."""
    hint: str = ""
    """Frame rate stated by the container, for a message; may be empty."""
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


def open_source(path: Path) -> FrameSource:
    """The source for `path`. Raises DeviceError if it is missing, empty or of an unknown kind."""
    if path.is_dir():
        return FolderSource(path)
    if not path.exists():
        raise DeviceError(f"{path}: no such file or folder of frames; name another")
    if path.suffix.lower() == ".npy":
        return StackSource(path)
    if path.suffix.lower() in _STACKS:
        return TiffSource(path)
    if path.suffix.lower() in IMAGES:
        raise DeviceError(f"{path}: is one image; name the folder that holds the images")
    return VideoSource(path)


def natural_key(name: str) -> list[tuple[int, int, str]]:
    """Sort key that counts digits as numbers: frame2 before frame10."""
    parts = re.split(r"(\d+)", name)
    return [(0, int(part), part) if part.isdigit() else (1, 0, part.lower()) for part in parts if part]


class FolderSource(FrameSource):
    """A folder of images, in natural order of their names."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        try:
            inside = [entry.name for entry in path.iterdir()]
        except OSError as error:
            raise DeviceError(f"{path}: cannot be listed: {error.strerror}") from None
        images = (name for name in inside if Path(name).suffix.lower() in IMAGES and not name.startswith("."))
        self.names = sorted(images, key=natural_key)
        self.count = len(self.names)
        if not self.names:
            raise DeviceError(
                f"{path}: holds no image ({', '.join(IMAGES)}) among its {len(inside)} files; name another"
            )

    def read(self, index: int) -> Stored:
        path = self._path / self.names[index]
        try:
            data = path.read_bytes()
        except OSError as error:
            if not self._path.is_dir():
                raise
            raise Unreadable(str(error.strerror)) from None
        if path.suffix.lower() == ".pgm":
            try:
                pixels, largest = read_pgm(data)
            except ValueError as error:
                raise Unreadable(str(error)) from None
            # some programs write the maximum of the image; the full scale is the next 2^bits - 1
            return Stored(pixels, max(2 ** largest.bit_length() - 1, 255))
        if path.suffix.lower() in _STACKS and _pages(path) > 1:
            raise DeviceError(
                f"{path}: holds several images; name it itself as camera.files.path, as a stack"
            )
        return _stored(_decode(data))

    def label(self, index: int) -> str:
        return str(self._path / self.names[index])


class TiffSource(FrameSource):
    """A multi-page TIFF file; one that is cut off counts one page more, which cannot be read."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._pages = self.count = _pages(path)
        if self.count == 0:
            raise DeviceError(f"{path}: is no TIFF stack that can be read")
        if is_cut_off(path):
            self.count += 1

    def read(self, index: int) -> Stored:
        if index == self._pages:
            raise Unreadable("the file is cut off before this page; copy it again")
        try:
            with _quiet():
                good, pages = cv2.imreadmulti(str(self._path), index, 1, flags=cv2.IMREAD_UNCHANGED)
        except cv2.error:
            # a changed page may state a size that no array has
            good = False
        if not good or len(pages) != 1:
            self._path.stat()
            raise Unreadable("the page cannot be decoded")
        return _stored(pages[0])

    def label(self, index: int) -> str:
        return f"{self._path}, page {index + 1}"


class StackSource(FrameSource):
    """A .npy array (n, ny, nx), memory-mapped, so that it may be larger than memory."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        try:
            stack = np.load(path, mmap_mode="r", allow_pickle=False)
        # whatever Python's own parser raises at a changed header
        except Exception as error:
            raise DeviceError(f"{path}: is no .npy stack that can be read: {error}") from None
        if stack.ndim != 3 or stack.dtype not in (np.uint8, np.uint16) or 0 in stack.shape:
            raise DeviceError(
                f"{path}: is an array of shape {stack.shape} and type {stack.dtype}; "
                "(n, ny, nx) of uint8 or uint16 is needed"
            )
        self._stack: NDArray[Any] = stack
        self.count = len(stack)

    def read(self, index: int) -> Stored:
        return _stored(np.array(self._stack[index]))


class VideoSource(FrameSource):
    """A lossless video, read through OpenCV without conversion."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._capture: cv2.VideoCapture | None = None
        self._position = 0
        capture = self._opened()
        self.count = int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
        rate_hz = capture.get(cv2.CAP_PROP_FPS)
        codec = int(capture.get(cv2.CAP_PROP_FOURCC)).to_bytes(4, "little").decode("latin-1").upper()
        self.lossy = "" if codec in _LOSSLESS else codec.strip()
        self._checksums: Ffv1Checksums | None = None
        if codec == "FFV1" and self.count > 0:
            with _quiet():
                self._checksums = Ffv1Checksums(path)
            if not self._checksums.present:
                _log.warning("%s: was written without checksums; damaged frames cannot be told", path)
        if math.isfinite(rate_hz) and rate_hz > 0:
            self.hint = f" (the file itself says {rate_hz:g} frames/s)"
        if self.count <= 0:
            self.close()
            raise DeviceError(
                f"{path}: the video does not say how many frames it holds; convert it to FFV1 in mkv"
            )

    def read(self, index: int) -> Stored:
        if self._capture is None or index < self._position:
            self.close()
            self._opened()
            if self._checksums is not None:
                self._checksums.rewind()
        while True:
            capture = self._capture
            good, pixels = capture.read() if capture is not None else (False, None)
            whole = self._checksums is None or self._checksums.next_is_whole()
            self._position += 1
            if not good or pixels is None:
                raise Unreadable("the video ends here or is damaged")
            if self._position > index:
                if not whole:
                    raise Unreadable("its checksum, or that of a frame it builds on, does not match")
                return _stored(pixels)

    def close(self) -> None:
        if self._capture is not None:
            self._capture.release()
        if self._checksums is not None:
            self._checksums.close()
        self._capture = None
        self._position = 0

    def _opened(self) -> cv2.VideoCapture:
        with _quiet():
            capture = cv2.VideoCapture(str(self._path), cv2.CAP_FFMPEG)
        if not capture.isOpened():
            raise DeviceError(
                f"{self._path}: is no video that OpenCV can read; folders of images "
                f"({', '.join(IMAGES)}), .tif and .npy stacks are the other choices"
            )
        capture.set(cv2.CAP_PROP_CONVERT_RGB, 0)
        self._capture = capture
        return capture


def _decode(data: bytes) -> NDArray[Any]:
    if not data:
        raise Unreadable("the file is empty")
    with _quiet():
        try:
            pixels = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
        except cv2.error as error:
            raise Unreadable(f"the file is damaged or too large ({error.err})") from None
    if pixels is None:
        raise Unreadable("the file is damaged or no image")
    return pixels


def _stored(pixels: NDArray[Any]) -> Stored:
    if pixels.dtype not in (np.uint8, np.uint16):
        raise Unreadable(f"pixels of type {pixels.dtype}; 8 or 16 bits without sign are needed")
    return Stored(pixels, int(np.iinfo(pixels.dtype).max))


def _pages(path: Path) -> int:
    with _quiet():
        return int(cv2.imcount(str(path), cv2.IMREAD_UNCHANGED))


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Suppress OpenCV's messages on stderr about unreadable frames, which the caller reports."""
    messages = cv2.utils.logging
    level = messages.getLogLevel()
    messages.setLogLevel(messages.LOG_LEVEL_SILENT)
    try:
        yield
    finally:
        messages.setLogLevel(level)
