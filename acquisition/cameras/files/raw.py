"""Frames as raw pixels in one file, whose layout and times a sidecar states (`raw_sidecar`)."""

from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from acquisition.cameras.files.frame_source import FrameSource, Stored, Unreadable
from acquisition.cameras.files.raw_sidecar import COLOURED, RawSidecar, possible_sidecars, read_sidecar
from acquisition.cameras.files.timestamps import FrameTimes, missing_frames, numbers_by_steps
from acquisition.cameras.pixel_formats import BY_NAME
from processing.errors import DeviceError
from processing.ticks import NS_PER_S

_RAW: Final = (".raw", ".bin", ".gray", ".y8", ".y16")
_SHORTEST_ROW: Final = 16
_ALIKE: Final = 0.5
"""Of the whole, how alike rows must be that are taken for neighbours; noise alone is not alike at all."""
_BETTER: Final = 0.5
"""How much less neighbouring rows of another length differ where the stated length is doubted."""


def is_raw(path: Path) -> bool:
    """Whether a file holds raw pixels, by its name or because a sidecar with all of its name lies beside."""
    return path.suffix.lower() in _RAW or any(
        one.name.startswith(path.name) and one.is_file() for one in possible_sidecars(path)
    )


class RawSource(FrameSource):
    """One frame after another; those that a file cut off lacks are counted, and cannot be read."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._sidecar, self._layout = read_sidecar(path)
        layout = self._layout
        self._whole, self.count = self._counted()
        missing = self.count - self._whole
        said = [f"ends {missing} frames before the {self.count} that {self._sidecar.name} states"]
        self.times = _times(layout, self.count)
        gaps = [] if self.times is None else missing_frames(*self.times, f"the times in {self._sidecar.name}")
        self.said = [*(said if missing else []), *gaps, *self._doubted_rows()]
        when = "" if layout.frame_rate_hz is None else f"{layout.frame_rate_hz:.9g} frames/s, "
        self.summary = (
            f"{self.count} frames, {when}raw {layout.pixel_format}, {layout.width_px}x{layout.height_px} px"
        )

    def read(self, index: int) -> Stored:
        if index >= self._whole:
            raise Unreadable("the file is cut off before the end of this frame; copy it again")
        layout = self._layout
        with self._path.open("rb") as file:
            file.seek(layout.header_bytes + index * layout.frame_bytes)
            data = file.read(layout.frame_bytes)
        if len(data) < layout.frame_bytes:
            raise Unreadable("the file became shorter")
        raw = np.frombuffer(data, np.uint8)
        if layout.pixel_format in COLOURED:
            pixels = raw.reshape(layout.height_px, layout.width_px, 3)
            # blue first, as all colours here
            return Stored(pixels[:, :, ::-1] if layout.pixel_format == "RGB8" else pixels, 255)
        known = BY_NAME[layout.pixel_format]
        if layout.byte_order == "big":
            raw = raw.view(">u2").astype(np.uint16).view(np.uint8)
        image = known.image(raw, layout.width_px, layout.height_px)
        if image.max() > known.full_scale_dn:
            raise Unreadable(
                f"a pixel of {image.max()} is above {known.full_scale_dn}, the largest of {known.name}; "
                f"{self._sidecar.name} states another pixel_format or byte_order than the file has"
            )
        return Stored(image, known.full_scale_dn)

    def _counted(self) -> tuple[int, int]:
        """Whole frames in the file, and frames that it should hold."""
        layout = self._layout
        size = self._path.stat().st_size - layout.header_bytes
        whole, rest = divmod(max(size, 0), layout.frame_bytes)
        listed = layout.stated_times_ns
        stated = layout.frames or (None if listed is None else len(listed))
        a_frame = f"{layout.width_px}x{layout.height_px} px in {layout.pixel_format}"
        if stated is None and (rest or not whole):
            raise DeviceError(
                f"{self._path}: its {size} bytes of pixels are not a whole number of frames of {a_frame} "
                f"({layout.frame_bytes} bytes), as {self._sidecar.name} states them; correct it, or state "
                "frames there if the file is cut off"
            )
        if stated is not None and (whole, rest) > (stated, 0):
            raise DeviceError(
                f"{self._path}: holds {size - stated * layout.frame_bytes} bytes more than the {stated} "
                f"frames of {a_frame} that {self._sidecar.name} states; correct it"
            )
        return whole, whole if stated is None else stated

    def _doubted_rows(self) -> list[str]:
        """A line where the first or the middle picture has rows of another length than stated."""
        for index in {0, self._whole // 2}:
            try:
                pixels = self.read(index).pixels
            except Unreadable:
                continue
            if other := other_row_length(pixels if pixels.ndim == 2 else pixels[:, :, 1]):
                stated = f"the {self._layout.width_px} that {self._sidecar.name} states"
                return [f"its pictures fit rows of {other} px better than {stated}: check width_px"]
        return []


def other_row_length(image: NDArray[Any]) -> int:
    """The length of rows with which neighbours are far more alike than with the length they have; 0: none.

    Where the picture is not read in its own rows, what is below a pixel lies elsewhere.
    """
    flat = image.ravel().astype(np.float64)
    flat -= flat.mean()
    width = image.shape[1]
    lags = np.arange(min(4 * width + 1, flat.size // 4))
    power = np.abs(np.fft.rfft(flat, 2 * flat.size)) ** 2
    alike = np.fft.irfft(power)[: len(lags)] / (flat.size - lags)
    if len(lags) <= max(width, _SHORTEST_ROW) or not alike[0] > 0.0:
        return 0
    peaks = 1 + np.flatnonzero((alike[1:-1] > alike[:-2]) & (alike[1:-1] >= alike[2:]))
    peaks = peaks[peaks >= _SHORTEST_ROW]
    if not len(peaks):
        return 0
    best = int(peaks[np.argmax(alike[peaks])])
    differs = alike[0] - alike
    clear = alike[best] > _ALIKE * alike[0] and differs[best] < _BETTER * differs[width]
    return best if clear and best != width else 0


def _times(layout: RawSidecar, count: int) -> FrameTimes | None:
    listed = layout.stated_times_ns
    if listed is not None:
        since_ns = [time_ns - listed[0] for time_ns in listed]
        return FrameTimes(since_ns, numbers_by_steps(since_ns))
    if layout.frame_rate_hz is None:
        return None
    return FrameTimes([round(k * NS_PER_S / layout.frame_rate_hz) for k in range(count)], range(count))
