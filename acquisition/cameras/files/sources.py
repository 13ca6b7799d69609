"""Sources of recorded frames: folder of images, TIFF file, .npy stack, raw pixels, film."""

import contextlib
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from acquisition.cameras.files.film import FilmSource
from acquisition.cameras.files.formats import is_cut_off, read_pgm
from acquisition.cameras.files.frame_source import FrameSource, Stored
from acquisition.cameras.files.frame_source import Unreadable as Unreadable
from acquisition.cameras.files.raw import RawSource, is_raw
from processing.errors import DeviceError

IMAGES = (".png", ".pgm", ".tif", ".tiff", ".bmp")
_STACKS = (".tif", ".tiff")
_FILMS = (
    ".mp4", ".mov", ".m4v", ".mkv", ".webm", ".avi", ".mpg", ".mpeg", ".ts", ".mts", ".m2ts", ".wmv", ".flv",
    ".3gp", ".nut", ".gif",
)  # fmt: skip
_LISTED = 5
"""Places that a message names one by one."""


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
    if is_raw(path):
        return RawSource(path)
    if path.suffix.lower() in IMAGES:
        raise DeviceError(f"{path}: is one image; name the folder that holds the images")
    return FilmSource(path)


def is_film(path: Path) -> bool:
    """Whether a file is a film, or raw pixels, by its name."""
    return path.suffix.lower() in _FILMS or is_raw(path)


def natural_key(name: str) -> list[tuple[int, int, str]]:
    """Sort key that counts digits as numbers: frame2 before frame10."""
    parts = re.split(r"(\d+)", name)
    return [(0, int(part), part) if part.isdecimal() else (1, 0, part.lower()) for part in parts if part]


def numbers_in(names: Sequence[str]) -> list[int] | None:
    """The number of each image by its name, from 0 in steps of 1; None where names do not count.

    Names count where they differ in one number alone, which rises evenly but for images that are missing.
    """
    parts = [re.split(r"(\d+)", name) for name in names]
    if len(names) < 3 or len({len(one) for one in parts}) > 1:
        return None
    # a number with and without leading zeros is the same number
    changing = [k for k, column in enumerate(zip(*parts, strict=True)) if len(set(column)) > 1]
    if len(changing) != 1 or changing[0] % 2 == 0:
        return None
    numbers = [int(one[changing[0]]) for one in parts]
    steps = Counter(after - before for before, after in pairwise(numbers))
    step, times = steps.most_common(1)[0]
    if step <= 0 or 2 * times < len(names) - 1 or any(one % step for one in steps):
        return None
    return [(number - numbers[0]) // step for number in numbers]


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
        films = sum(is_film(path / name) for name in inside if not name.startswith("."))
        if not self.names and films:
            raise DeviceError(f"{path}: holds {films} films and no images; name one of the films")
        if not self.names:
            raise DeviceError(
                f"{path}: holds no image ({', '.join(IMAGES)}) among its {len(inside)} files; name another"
            )
        self.numbers = numbers_in(self.names)
        beside = [f"{films} films lie beside the images, and are left out"] if films else []
        self.said = [*beside, *self._missing()]

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

    def _missing(self) -> list[str]:
        if self.numbers is None:
            # one image, or two, cannot miss any between them
            return (
                ["the images' names do not count evenly: missing ones cannot be told"]
                if self.count > 2
                else []
            )
        gaps = [i for i, (before, after) in enumerate(pairwise(self.numbers)) if after - before > 1]
        count = sum(self.numbers[i + 1] - self.numbers[i] - 1 for i in gaps)
        places = ", ".join(f"{self.names[i]} to {self.names[i + 1]}" for i in gaps[:_LISTED])
        more = f" and {len(gaps) - _LISTED} more places" if len(gaps) > _LISTED else ""
        return (
            [f"{count} images are missing by the numbers in their names: between {places}{more}"]
            if count
            else []
        )


class TiffSource(FrameSource):
    """A multi-page TIFF file; one that is cut off counts one page more, which cannot be read."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._pages = self.count = _pages(path)
        if self.count == 0:
            raise DeviceError(f"{path}: cannot be read as a TIFF stack")
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
            raise DeviceError(f"{path}: cannot be read as a .npy stack: {error}") from None
        if stack.ndim != 3 or stack.dtype not in (np.uint8, np.uint16) or 0 in stack.shape:
            raise DeviceError(
                f"{path}: is an array of shape {stack.shape} and type {stack.dtype}; "
                "(n, ny, nx) of uint8 or uint16 is needed"
            )
        self._stack: NDArray[Any] = stack
        self.count = len(stack)

    def read(self, index: int) -> Stored:
        return _stored(np.array(self._stack[index]))


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
