"""Input files (TOML) of calibrations, frames for them, and the writing of calibration files."""

import datetime
import getpass
import socket
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal, Self, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, Field, model_validator

from acquisition import atomic_write
from acquisition.cameras.files.sources import UnreadableFrame, open_source
from acquisition.record.digest import sha256_of
from acquisition.record.reader import RecordReader
from calibration import CalibrationFile, Kind, LadderSteps, LeverGeometry, Source, write_calibration
from processing.errors import ConfigurationError, DataError
from processing.units import conversion
from rig.instrument import versions
from rig.settings import read_toml, validate

Image = NDArray[np.uint8] | NDArray[np.uint16]
_Model = TypeVar("_Model", bound=BaseModel)
_MAX_FRAMES = 64
LADDER_UNITS = {"tilt": ("arcsec", "arcmin", "rad", "mrad", "urad"), "shift": ("mm", "um", "m")}
"""Units of the readings of the reference, by kind of ladder."""
_SI = {"tilt": "rad", "shift": "m"}


class LadderStep(BaseModel, frozen=True, extra="forbid"):
    """One step of a ladder: the reading of the reference, and a record at rest or the spot's position."""

    reference: float
    record: Path | None = None
    x_px: float = 0.0
    y_px: float = 0.0
    u_px: float = Field(default=0.0, ge=0)

    @model_validator(mode="after")
    def _either(self) -> Self:
        if (self.record is None) == (self.u_px == 0.0):
            raise ValueError("a step needs either a record or x_px, y_px and u_px")
        return self


class LadderFile(BaseModel, frozen=True, extra="forbid"):
    """A ladder of known tilts or shifts, or the geometry of the lever instead.

    Paths of records are relative to the file.
    """

    kind: Literal["tilt", "shift"] = "tilt"
    unit: str = "arcsec"
    u_reference: float = Field(default=0.0, ge=0)
    """Standard uncertainty of one setting of the reference, in `unit`."""
    u_reference_relative: float = Field(default=0.0, ge=0, lt=1)
    """Relative standard uncertainty of the scale of the reference."""
    pixel_pitch_m: float | None = Field(default=None, gt=0, lt=1e-3)
    """Pitch of the sensor's pixels."""
    arm_m: float | None = Field(default=None, gt=0, lt=100)
    u_arm_m: float = Field(default=0.0, ge=0)
    binning: int = Field(default=1, ge=1, le=16)
    """Binning of the camera for stated spots; records state their own."""
    step: tuple[LadderStep, ...] = ()
    """Steps in the order of the measurement."""
    geometry: LeverGeometry | None = None

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.unit not in LADDER_UNITS[self.kind]:
            raise ValueError(f"unit = {self.unit!r}: {', '.join(LADDER_UNITS[self.kind])} for a {self.kind}")
        if bool(self.step) == (self.geometry is not None):
            raise ValueError("state either [[step]] or [geometry]")
        return self

    def in_si(self, reading: float) -> float:
        """A reading in rad or m."""
        return reading * conversion(self.unit, _SI[self.kind])

    def required_value(self, name: Literal["pixel_pitch_m", "arm_m"], path: Path) -> float:
        """A value that this kind of ladder requires; raises ConfigurationError, with `path`, without it."""
        value: float | None = getattr(self, name)
        if value is None:
            raise ConfigurationError(f"{path}: {name} is missing: a ladder of {self.kind}s needs it")
        return value

    def steps(self, rows: list[tuple[float, float, float, float]]) -> LadderSteps:
        """The ladder with the spots (x, y, u_x, u_y in px) of its steps."""
        table = np.array(rows, dtype=np.float64).reshape(-1, 4)
        count = len(table)
        reference = np.array([self.in_si(step.reference) for step in self.step])
        return LadderSteps(reference, np.full(count, self.in_si(self.u_reference)), *table.T)


class VanesOfRun(BaseModel, frozen=True, extra="forbid"):
    """One run with vanes on the pendulum."""

    record: Path
    area_m2: float = Field(ge=0, lt=10)
    """Sum of the areas of all vanes, one face of each; 0 without vanes."""


class VaneFile(BaseModel, frozen=True, extra="forbid"):
    """Runs of one contact, all on the same spot, with vanes of different areas.

    The drag of vanes is proportional to their area, so that only ratios of areas enter the drag of the
    pendulum itself. Paths of records are relative to the file.
    """

    run: tuple[VanesOfRun, ...]

    @model_validator(mode="after")
    def _differ(self) -> Self:
        if len({run.area_m2 for run in self.run}) < 2:
            raise ValueError("runs of two different areas are needed, better of three")
        return self


class ExposureLevel(BaseModel, frozen=True, extra="forbid"):
    """Frames of one exposure and illumination; the first two are used."""

    frames: Path
    exposure_us: float | None = Field(default=None, gt=0)


class TransferFile(BaseModel, frozen=True, extra="forbid"):
    """Dark frames and levels: records, folders of images or .npy stacks, named relative to the file."""

    darks: Path
    level: tuple[ExposureLevel, ...]
    full_scale_dn: int | None = Field(default=None, gt=1, description="None: from the frames' files")


def frames_of(path: Path) -> tuple[list[Image], int]:
    """Whole frames (at most `_MAX_FRAMES`) and full scale in DN of a record, a folder of images or a stack.

    Raises DataError if there are none, or if they are in colour.
    """
    if path.suffix == ".mcap":
        with RecordReader(path) as reader:
            full_scale = reader.full_scale_dn
            images = [frame.image for frame, _ in zip(reader.images(), range(_MAX_FRAMES), strict=False)]
        if not images:
            raise DataError(f"{path}: contains no whole frames")
        return images, full_scale
    source = open_source(path)
    try:
        frames = [source.read(index) for index in range(min(source.count, _MAX_FRAMES))]
    except (UnreadableFrame, OSError) as error:
        raise DataError(f"{path}: {error}") from None
    finally:
        source.close()
    if not frames or any(frame.pixels.ndim != 2 for frame in frames):
        raise DataError(f"{path}: grey frames are needed")
    return [frame.pixels for frame in frames], frames[0].full_scale


def read_input(path: Path, model: type[_Model]) -> _Model:
    """Read the input file of a calibration; raises ConfigurationError, one line with every fault."""
    tree = read_toml(path, "list of measured values; docs/calibrate.md shows one")
    if {"camera", "session"} & set(tree):
        raise ConfigurationError(
            f"{path}: is a configuration of the rig; a list of measured values is needed here, "
            "docs/calibrate.md shows one (rig calibrate air takes a configuration after --config)"
        )
    if {"made_by", "values"} <= set(tree):
        raise ConfigurationError(
            f"{path}: is a calibration that rig calibrate made; the list of values measured for it is "
            "needed here, docs/calibrate.md shows one"
        )
    content, faults = validate(model, tree)
    if content is None:
        problem = "; ".join(fault.line for fault in faults)
        raise ConfigurationError(f"{path}: {problem}; docs/calibrate.md shows such a file")
    return content


_MIN_DAYS, _MAX_DAYS = 0.01, 36_525.0


@dataclass(frozen=True, slots=True)
class Filing:
    """Folder, author and validity of a calibration; raises ConfigurationError for an impossible validity."""

    folder: Path
    valid_days: float = 90.0
    made_by: str = ""

    def __post_init__(self) -> None:
        # in this form NaN is refused, too
        if not _MIN_DAYS <= self.valid_days <= _MAX_DAYS:
            raise ConfigurationError(
                f"valid for {self.valid_days:g} days: should be from {_MIN_DAYS:g} to {_MAX_DAYS:g}"
            )


def file_calibration(
    kind: Kind,
    filing: Filing,
    method: str,
    values: Mapping[str, Any],
    details: Mapping[str, Any],
    sources: Sequence[Path],
    notes: Sequence[str] = (),
    measured_at: datetime.datetime | None = None,
) -> Path:
    """Write one calibration, valid from `measured_at` (None: now) on; returns the file.

    `values` fill a section of the configuration, `details` are shown in a report, `sources` are the files
    used, whose hashes are stored. A detail with the name of a value but another number was fitted and is not
    used; it is stored as ``fitted_NAME``.
    """
    stored_details = {
        f"fitted_{name}" if name in values else name: detail
        for name, detail in details.items()
        if name not in values or detail != values[name]
    }
    now = datetime.datetime.now(datetime.UTC).replace(microsecond=0)
    measured_at = measured_at or now
    valid_until = measured_at + datetime.timedelta(days=filing.valid_days)
    source_files = [Source(name=path.name, sha256=sha256_of(path)) for path in sources if path.is_file()]
    calibration = CalibrationFile(
        kind=kind,
        made_by=filing.made_by or _user(),
        made_at=now,
        valid_until=valid_until.replace(microsecond=0),
        measured_at=measured_at,
        host=socket.gethostname(),
        software=f"optical-pendulum-rig {versions()['optical-pendulum-rig']}",
        method=method,
        sources=tuple(source_files),
        notes=tuple(notes),
        values=dict(values),
        details=stored_details,
    )
    return write_calibration(filing.folder, calibration, atomic_write.write_new)


def next_free(folder: Path, stem: str) -> Path:
    """The first of STEM-001, STEM-002 ... that does not exist."""
    number = 1
    while (path := folder / f"{stem}-{number:03d}").exists():
        number += 1
    return path


def details_of(result: Any, *omitted: str) -> dict[str, Any]:
    """Fields of a dataclass as plain values for a calibration file: arrays are lists, parts tables."""
    return {name: _plain(value) for name, value in asdict(result).items() if name not in omitted}


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, dict):
        return {name: _plain(entry) for name, entry in value.items()}
    return [_plain(entry) for entry in value] if isinstance(value, list | tuple) else value


def _user() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return ""
