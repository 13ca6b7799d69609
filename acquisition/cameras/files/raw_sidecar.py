"""What stands beside a file of raw pixels: their layout and times, in a small TOML or JSON file."""

import json
import tomllib
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, Self

from pydantic import BaseModel, Field, ValidationError, model_validator

from acquisition.cameras.pixel_formats import BY_NAME
from processing.errors import DeviceError
from processing.ticks import NS_PER_S

_ENDINGS = (".toml", ".json")
COLOURED = ("RGB8", "BGR8")
_FORMATS = (*BY_NAME, *COLOURED)


class RawSidecar(BaseModel, frozen=True, extra="forbid", strict=True):
    """Layout of a file of raw pixels, one frame after another, rows from the top, without gaps.

    `frames` is their number, needed where the file is cut off. Of `frame_rate_hz`, `times_s` and `times_ns`
    (one a frame, rising) at most one is stated; without any the times come from elsewhere, as for images.
    """

    width_px: int = Field(gt=0, le=65536)
    height_px: int = Field(gt=0, le=65536)
    pixel_format: str
    byte_order: Literal["little", "big"] = "little"
    header_bytes: int = Field(default=0, ge=0)
    frames: int | None = Field(default=None, gt=0)
    frame_rate_hz: float | None = Field(default=None, gt=0, le=1e6, allow_inf_nan=False)
    times_s: list[float] | None = Field(default=None, min_length=1)
    times_ns: list[int] | None = Field(default=None, min_length=1)

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.pixel_format not in _FORMATS:
            raise ValueError(f"pixel_format = {self.pixel_format!r}: should be one of {', '.join(_FORMATS)}")
        if self.byte_order == "big" and self.sample_bits != 16:
            raise ValueError(f"byte_order: pixels of {self.pixel_format} have none; leave it out")
        stated = [
            name for name in ("frame_rate_hz", "times_s", "times_ns") if getattr(self, name) is not None
        ]
        if len(stated) > 1:
            raise ValueError(f"{' and '.join(stated)}: state one of them")
        times_ns = self.stated_times_ns
        if times_ns is None:
            return self
        if self.frames is not None and len(times_ns) != self.frames:
            raise ValueError(f"{stated[0]}: has {len(times_ns)} entries for frames = {self.frames}")
        if later := next((k for k, (a, b) in enumerate(pairwise(times_ns), 1) if b <= a), 0):
            raise ValueError(f"{stated[0]}: entry {later + 1} is not later than the one before it")
        if times_ns[-1] - times_ns[0] >= 2**63:
            raise ValueError(f"{stated[0]}: goes over more than 9.2e18 ns, which cannot be kept")
        return self

    @property
    def sample_bits(self) -> int:
        """Bits of a sample in the file."""
        return 8 if self.pixel_format in COLOURED else BY_NAME[self.pixel_format].transport_bits

    @property
    def frame_bytes(self) -> int:
        """Bytes of a frame."""
        if self.pixel_format in COLOURED:
            return 3 * self.width_px * self.height_px
        return BY_NAME[self.pixel_format].byte_count(self.width_px, self.height_px)

    @property
    def stated_times_ns(self) -> list[int] | None:
        """The times that are listed, in ns; None where there are none. ValueError: infinite ones."""
        if self.times_s is None:
            return self.times_ns
        try:
            return [round(time_s * NS_PER_S) for time_s in self.times_s]
        except (ValueError, OverflowError):
            raise ValueError("times_s: all should be finite numbers") from None


def possible_sidecars(path: Path) -> list[Path]:
    """Where the sidecar of a file may be: ``swing.raw.toml`` or ``swing.toml``, and with ``.json``."""
    return [path.with_name(path.name + end) for end in _ENDINGS] + [path.with_suffix(end) for end in _ENDINGS]


def read_sidecar(path: Path) -> tuple[Path, RawSidecar]:
    """The sidecar of a file of raw pixels, and where it is. Raises DeviceError with one line."""
    there = [one for one in possible_sidecars(path) if one.is_file()]
    if not there:
        raise DeviceError(
            f"{path}: raw pixels need a file beside them that describes their layout: write "
            f"{possible_sidecars(path)[0].name} with width_px, height_px, pixel_format "
            "(Mono8, Mono12p, Mono16, ...) and frame_rate_hz"
        )
    if len(there) > 1:
        raise DeviceError(f"{path}: {' and '.join(one.name for one in there)} describe it; keep one of them")
    sidecar = there[0]
    try:
        return sidecar, RawSidecar.model_validate(_tree(sidecar))
    except ValidationError as error:
        raise DeviceError(f"{sidecar}: {_in_words(error)}") from None


def _tree(sidecar: Path) -> Any:
    kind = sidecar.suffix[1:].upper()
    try:
        text = sidecar.read_text(encoding="utf-8-sig")
        return json.loads(text, object_pairs_hook=_once) if kind == "JSON" else tomllib.loads(text)
    except OSError as error:
        raise DeviceError(f"{sidecar}: cannot be read: {error.strerror or error}") from None
    # of TOML and JSON, and bytes that are no text
    except (ValueError, RecursionError) as error:
        raise DeviceError(f"{sidecar}: is not {kind}: {str(error).splitlines()[0]}") from None


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """The object; JSON itself would take the last of two values."""
    found = dict(pairs)
    if len(found) < len(pairs):
        raise ValueError("a key is stated twice")
    return found


def _in_words(error: ValidationError) -> str:
    """The first fault, unknown keys before missing ones: a slip of the pen makes both."""
    fault = min(error.errors(), key=lambda one: one["type"] != "extra_forbidden")
    place = ".".join(str(part) for part in fault["loc"])
    said = fault["msg"].removeprefix("Value error, ").replace("Input should", "should")
    if fault["type"] == "extra_forbidden":
        return f"{place}: unknown key; known here: {', '.join(RawSidecar.model_fields)}"
    if fault["type"] == "missing":
        return f"{place}: is missing; state a value"
    return f"{place} = {fault['input']!r}: {said}" if place else said
