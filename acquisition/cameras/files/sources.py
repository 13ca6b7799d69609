"""Sources of recorded frames: folder of images, file of several images, .npy stack, film."""

import contextlib
import math
import re
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import TiffImagePlugin as TIFF

from acquisition.cameras.files.film import FilmSource
from acquisition.cameras.files.frame_source import ONE_IMAGE, FrameSource, StoredImage, listed_gaps
from acquisition.cameras.files.frame_source import UnreadableFrame as UnreadableFrame
from processing.errors import DeviceError

_PORTABLE = (".pgm", ".ppm", ".pnm")
_STACKS = (".tif", ".tiff")
_LOSSY = (".jpg", ".jpeg")
IMAGES = (".png", *_PORTABLE, *_STACKS, ".bmp", *_LOSSY)
_FILMS = (
    ".mp4", ".mov", ".m4v", ".mkv", ".webm", ".avi", ".mpg", ".mpeg", ".ts", ".mts", ".m2ts", ".wmv", ".flv",
    ".3gp", ".nut", ".gif",
)  # fmt: skip
_RAW = (".raw", ".bin", ".gray", ".y8", ".y16")


def open_source(path: Path) -> FrameSource:
    """The source for `path`. Raises DeviceError if it is missing, empty or of an unknown kind."""
    if path.is_dir():
        return ImageSource(path)
    if not path.exists():
        raise DeviceError(f"{path}: no such file or folder of frames; name another")
    if path.suffix.lower() == ".npy":
        return StackSource(path)
    if path.suffix.lower() in _RAW:
        raise DeviceError(
            f"{path}: states neither size nor depth of its pixels; save them with both, in Python by "
            f"numpy.save('{path.stem}.npy', numpy.fromfile('{path.name}', 'u1').reshape(-1, HEIGHT, WIDTH))"
        )
    if path.suffix.lower() in IMAGES:
        return ImageSource(path)
    return FilmSource(path)


def is_film(path: Path) -> bool:
    """Whether a file is a film, or raw pixels, by its name."""
    return path.suffix.lower() in (*_FILMS, *_RAW)


def natural_key(name: str) -> list[tuple[int, int, str]]:
    """Sort key that compares digits as numbers: frame2 before frame10."""
    parts = re.split(r"(\d+)", name)
    return [(0, int(part), part) if part.isdecimal() else (1, 0, part.lower()) for part in parts if part]


def numbers_in(names: Sequence[str]) -> list[int] | None:
    """The number of each image by its name, counted from 0 in steps of 1; None if names are not usable.

    Usable names differ in one number only, which rises evenly except where images are missing.
    """
    rows = [re.split(r"(\d+)", name) for name in names]
    if len(names) < 3 or len({len(row) for row in rows}) > 1:
        return None
    # a number with and without leading zeros is the same number
    changing = [k for k, column in enumerate(zip(*rows, strict=True)) if len(set(column)) > 1]
    if len(changing) != 1 or changing[0] % 2 == 0:
        return None
    numbers = [int(row[changing[0]]) for row in rows]
    steps = Counter(later - earlier for earlier, later in pairwise(numbers))
    usual, times = steps.most_common(1)[0]
    if usual <= 0 or 2 * times < len(names) - 1 or any(step % usual for step in steps):
        return None
    return [(number - numbers[0]) // usual for number in numbers]


class _Images:
    """The images of one file, which holds a single image unless it is of a subclass."""

    count = 1
    warnings: Sequence[str] = ()

    def __init__(self, path: Path) -> None:
        self._path = path

    def read(self, page: int) -> StoredImage:
        """Raises UnreadableFrame for a damaged image, OSError if the file is not accessible."""
        assert page == 0
        data = self._path.read_bytes()
        return (_portable if self._path.suffix.lower() in _PORTABLE else _decoded)(data)


class _TiffImages(_Images):
    """Images of a TIFF file, one more if it is cut off. ImageJ, and optionally tifffile, writes one directory
    for all images, whose pixels follow each other, and states their number in a note (ImageDescription).
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        directories, tags, order = _tiff_directories(path)
        with _quiet():
            self._decoded = int(cv2.imcount(str(path), cv2.IMREAD_UNCHANGED))
        self.count = max(self._decoded, directories, 1)
        shape = [tags.get(tag, 0) for tag in (TIFF.IMAGELENGTH, TIFF.IMAGEWIDTH)]
        note_count = _images_by_note(path, str(tags.get(TIFF.IMAGEDESCRIPTION, "")), shape)
        self._pixels_at, self._shape = -1, shape
        if note_count <= self.count:
            return
        if directories > self._decoded:
            self.count = note_count
        elif directories > 1:
            self.warnings = [f"{path}: its note states {note_count} images, of which it holds {self.count}"]
        else:
            bits = tags.get(TIFF.BITSPERSAMPLE, (1,))
            plain = tags.get(TIFF.COMPRESSION, 1) == 1 and bits in ((8,), (16,))
            if not plain or TIFF.STRIPOFFSETS not in tags:
                raise DeviceError(
                    f"{path}: its note states {note_count} images and it has one directory, whose pixels are "
                    "not plain grey values of 8 or 16 bits; save it as a sequence of images"
                )
            self.count, self._pixels_at = note_count, tags[TIFF.STRIPOFFSETS][0]
            self._dtype = np.dtype(f"{order}u{bits[0] // 8}")

    def read(self, page: int) -> StoredImage:
        if self._pixels_at >= 0:
            image_bytes = math.prod(self._shape) * self._dtype.itemsize
            with self._path.open("rb") as file:
                file.seek(self._pixels_at + page * image_bytes)
                raster = file.read(image_bytes)
            if len(raster) < image_bytes:
                raise UnreadableFrame("the file is cut off before this image; copy it again")
            stored = np.frombuffer(raster, self._dtype).reshape(self._shape)
            return _stored(stored.astype(self._dtype.newbyteorder("=")))
        if page >= self._decoded > 0:
            raise UnreadableFrame("the file is cut off before this image; copy it again")
        try:
            with _quiet():
                decoded, pages = cv2.imreadmulti(str(self._path), page, 1, flags=cv2.IMREAD_UNCHANGED)
        except cv2.error:
            # a damaged page may state a size that is impossible for an array
            decoded = False
        if not decoded or len(pages) != 1:
            self._path.stat()
            raise UnreadableFrame("the image cannot be decoded")
        return _stored(pages[0])


def _tiff_directories(path: Path) -> tuple[int, dict[int, Any], str]:
    """Number of directories of a TIFF file, one beyond the end of a cut file included (0: unknown), tags of
    the first, and numpy's order of bytes.
    """
    count, tags, order = 0, dict[int, Any](), "<"
    try:
        with warnings.catch_warnings(action="ignore"), TIFF.TiffImageFile(path) as image:
            tags, order = dict(image.tag_v2), ">" if image.tag_v2.prefix == b"MM" else "<"
            while True:
                count += 1
                image.seek(count)
    except EOFError:
        return count, tags, order
    # Pillow has no error of its own for a directory that is damaged, or beyond the end
    except Exception:
        return (count + 1 if count else 0), tags, order


def _images_by_note(path: Path, note: str, shape: Sequence[int]) -> int:
    """Number of images that a TIFF's note states, or 0. Raises DeviceError for other than a time series."""
    if note.startswith("ImageJ"):
        counts = {name: int(number) for name, number in re.findall(r"^(\w+)=(\d+)\s*$", note, re.MULTILINE)}
        axes = [name for name in ("channels", "slices", "frames") if counts.get(name, 1) > 1]
        if "channels" in axes or len(axes) > 1:
            raise DeviceError(
                f"{path}: holds {' of '.join(f'{counts[name]} {name}' for name in axes)} by ImageJ's note; "
                "save the images of one channel and slice"
            )
        return counts.get("images", 0)
    if match := re.match(r'{"shape": \[([\d, ]+)\]', note):
        lengths = [int(length) for length in match.group(1).split(",")]
        return math.prod(lengths) // max(math.prod(shape), 1) if lengths[-2:] == shape else 0
    return 0


def images_in(names: Sequence[str]) -> list[str]:
    """Names of the images in a folder, in natural order; JPEG only where there are no others and no film."""
    images = [name for name in names if Path(name).suffix.lower() in IMAGES and not name.startswith(".")]
    lossless = [name for name in images if Path(name).suffix.lower() not in _LOSSY]
    films = any(Path(name).suffix.lower() in _FILMS for name in names)
    return sorted(lossless or ([] if films else images), key=natural_key)


class ImageSource(FrameSource):
    """A folder of images, in natural order of their names, or one file of several."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._folder, files, warnings = path, [""], list[str]()
        if path.is_dir():
            try:
                names = [entry.name for entry in path.iterdir()]
            except OSError as error:
                raise DeviceError(f"{path}: cannot be listed: {error.strerror}") from None
            files = images_in(names)
            warnings = _ignored_files(path, names, files)
        self._files = [path / name for name in files]
        self._images = [
            (_TiffImages if file.suffix.lower() in _STACKS else _Images)(file) for file in self._files
        ]
        self._pages = [(k, page) for k, images in enumerate(self._images) for page in range(images.count)]
        self.count = len(self._pages)
        if path.is_dir():
            self.names = [files[k] for k, _ in self._pages]
            warnings += self._number_by_names(files)
        elif self.count == 1:
            self._refuse_single_image()
        if self.count > len(files):
            self.summary = f"{self.count} images in {len(files)} file{'s' if len(files) > 1 else ''}"
        self.warnings = [*warnings, *(line for images in self._images for line in images.warnings)]
        self.lossy = "jpeg" if self._files[0].suffix.lower() in _LOSSY else ""

    def read(self, index: int) -> StoredImage:
        file, page = self._pages[index]
        try:
            return self._images[file].read(page)
        except OSError as error:
            if not self._path.exists():
                raise
            raise UnreadableFrame(str(error.strerror)) from None

    def label(self, index: int) -> str:
        file, page = self._pages[index]
        return str(self._files[file]) + (f", image {page + 1}" if self._images[file].count > 1 else "")

    def _refuse_single_image(self) -> None:
        """Raise DeviceError for a source of a single image, which has no motion."""
        try:
            self.read(0)
        except UnreadableFrame as error:
            raise DeviceError(f"{self._path}: cannot be read as an image: {error}") from None
        raise DeviceError(f"{self._path}: {ONE_IMAGE}")

    def _number_by_names(self, files: Sequence[str]) -> list[str]:
        """Number the images by their files' names; returns warnings about missing images."""
        if len(files) < 3:
            # in fewer than three files no gap can be recognised
            return []
        numbers, counts = numbers_in(files), [images.count for images in self._images]
        # the last file may hold fewer images than the others
        if numbers is None or len(set(counts[:-1])) > 1 or counts[-1] > counts[0]:
            return ["the numbers in the images' names are uneven: no gap can be found"]
        self.numbers = [numbers[k] * counts[0] + page for k, page in self._pages]
        gaps = [i for i, (earlier, later) in enumerate(pairwise(numbers)) if later - earlier > 1]
        count = counts[0] * sum(numbers[i + 1] - numbers[i] - 1 for i in gaps)
        listed = listed_gaps([f"{files[i]} to {files[i + 1]}" for i in gaps])
        return [f"{count} images are missing by the numbers in their names: between {listed}"] if gaps else []


def _ignored_files(path: Path, names: Sequence[str], images: Sequence[str]) -> list[str]:
    """Warnings about other files in the folder; raises DeviceError if there are no images."""
    others = [name for name in names if name not in set(images) and not name.startswith(".")]
    films = sum(is_film(path / name) for name in others)
    if not images and films:
        raise DeviceError(f"{path}: holds {films} films and no images; name one of the films")
    if not images:
        kinds = Counter(Path(name).suffix.lower() or "files without an ending" for name in others)
        listed = ", ".join(f"{count} {kind}" for kind, count in kinds.most_common(3))
        raise DeviceError(
            f"{path}: holds no image ({', '.join(IMAGES)}), but {listed or 'nothing'}; name another, or "
            "convert them"
        )
    photographs = sum(Path(name).suffix.lower() in _LOSSY for name in others)
    ignored = [(films, "films"), (photographs, "JPEG pictures")]
    return [f"{count} {kind} lie beside the images, and are left out" for count, kind in ignored if count]


class StackSource(FrameSource):
    """A .npy array (n, ny, nx), memory-mapped, so that it may be larger than memory."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        try:
            stack = np.load(path, mmap_mode="r", allow_pickle=False)
        # numpy parses the header with Python's own parser, which raises many kinds of errors
        except Exception as error:
            raise DeviceError(f"{path}: cannot be read as a .npy stack: {error}") from None
        if stack.ndim != 3 or stack.dtype not in (np.uint8, np.uint16) or 0 in stack.shape:
            raise DeviceError(
                f"{path}: is an array of shape {stack.shape} and type {stack.dtype}; "
                "(n, ny, nx) of uint8 or uint16 is needed"
            )
        self._stack: NDArray[Any] = stack
        self.count = len(stack)

    def read(self, index: int) -> StoredImage:
        return _stored(np.array(self._stack[index]))


_GAP = rb"(?:\s|#[^\n\r]*[\n\r])+"
_HEADER = re.compile(rb"\s*P([56])" + 3 * (_GAP + rb"(\d+)") + rb"\s")


def _portable(data: bytes) -> StoredImage:
    """Image of a binary PGM or PPM file, blue first; OpenCV rescales some of them."""
    header = _HEADER.match(data)
    if header is None:
        raise UnreadableFrame("no header of a binary PGM or PPM file (P5, P6); save it as one, or as PNG")
    kind, nx, ny, largest = map(int, header.groups())
    if not 0 < largest < 65536 or nx * ny == 0:
        raise UnreadableFrame(f"the header states {nx}x{ny} pixels up to {largest}")
    channels, dtype = 3 if kind == 6 else 1, np.dtype(np.uint8 if largest < 256 else ">u2")
    size, raster = channels * nx * ny * dtype.itemsize, data[header.end() :]
    if len(raster) < size:
        raise UnreadableFrame(f"the file ends after {len(raster)} of {size} bytes of pixels")
    if _HEADER.match(raster, size):
        raise UnreadableFrame("the file holds several images; give each a file of its own: pamsplit")
    values: NDArray[Any] = np.frombuffer(raster, dtype, channels * nx * ny)
    if values.max() > largest:
        raise UnreadableFrame(f"a pixel of {values.max()} is above the stated largest value {largest}")
    pixels = values.astype(dtype.newbyteorder("=")).reshape(ny, nx, channels)
    # some programs write the maximum of the image; the full scale is the next 2^bits - 1
    full_scale = max(2 ** largest.bit_length() - 1, 255)
    return StoredImage(pixels[:, :, ::-1] if channels == 3 else pixels[:, :, 0], full_scale)


def _decoded(data: bytes) -> StoredImage:
    if not data:
        raise UnreadableFrame("the file is empty")
    with _quiet():
        try:
            pixels = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
        except cv2.error as error:
            raise UnreadableFrame(f"the file is damaged or too large ({error.err})") from None
    if pixels is None:
        raise UnreadableFrame("the file is damaged or no image")
    return _stored(pixels)


def _stored(pixels: NDArray[Any]) -> StoredImage:
    if pixels.dtype not in (np.uint8, np.uint16):
        raise UnreadableFrame(f"pixels of type {pixels.dtype}; 8 or 16 bits without sign are needed")
    return StoredImage(pixels, int(np.iinfo(pixels.dtype).max))


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
