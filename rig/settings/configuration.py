"""Reads a TOML configuration into frozen models; every error is reported in one line.

A file may begin with ``extends = "other.toml"`` (relative to itself) and then states only what
differs. On the command line ``--set a.b.c=value`` replaces any key by its dotted path.
"""

import difflib
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import is_dataclass
from pathlib import Path
from typing import Any, Literal, Self, cast, get_args, get_origin

from pydantic import BaseModel, Field, ValidationError, model_validator
from pydantic.dataclasses import dataclass, is_pydantic_dataclass
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from acquisition.cameras.drivers import find_driver
from acquisition.simulation.faults import FaultSettings
from acquisition.simulation.settings import SimulationSettings
from calibration import Axes, Lever, Shutter, deflection_unit
from processing.contact import STANDARD_GRAVITY_M_PER_S2, Material
from processing.deflections import DeflectionUnit
from processing.errors import ConfigurationError
from processing.spot import SensorModel
from rig.control import ControllerSettings, EnvironmentSettings, LaserSettings
from rig.settings.balance import BalanceSettings
from rig.settings.calibration import CalibrationSettings, TimebaseSettings
from rig.settings.camera import CameraSection
from rig.settings.instrument import InstrumentSettings
from rig.settings.phases import PhaseSettings, PreflightSettings, StartSettings


class Section(BaseModel, frozen=True, extra="forbid"):
    """A table of the configuration; an unknown key is an error."""


class SessionSettings(Section, frozen=True):
    """The sample, the operator, the number of runs, and when a run ends."""

    operator: str = ""
    sample: str = ""
    notes: str = ""
    contact_history: str = Field(default="", description="age, cleaning and earlier loads of the contact")
    runs: int = Field(default=1, ge=1, le=1000)
    initial_amplitude_arcsec: float = Field(
        default=124.0, gt=0, description="wanted at the start of a run; see [start]"
    )
    final_amplitude_arcsec: float = Field(default=2.0, gt=0, description="a run ends below this amplitude")
    max_duration_s: float = Field(default=7200.0, gt=0, description="a run ends after this time in any case")
    output: Path = Field(default=Path("runs"), description="each session makes a folder in it")
    notify_command: tuple[str, ...] = Field(
        default=(), description="called on alarm, end and failure, with kind, text and folder behind it"
    )
    notify_webhook_file: Path | None = Field(
        default=None, description="holds the address to which the same is posted; none is kept in records"
    )


class EnvironmentConditions(Section, frozen=True):
    """Conditions in the laboratory as stated by the user; stored in the record."""

    temperature_c: float | None = Field(default=None, gt=-100, lt=200)
    humidity_percent: float | None = Field(default=None, ge=0, le=100)
    pressure_pa: float | None = Field(default=None, gt=1e3, lt=2e5)


class PendulumSettings(Section, frozen=True):
    """The pendulum, its ball and the plate it stands on. `u_...` are standard uncertainties."""

    mass_kg: float = Field(gt=0, lt=1e4)
    u_mass_kg: float = Field(default=0.0, ge=0)
    ball_radius_m: float = Field(gt=0, lt=1)
    u_ball_radius_m: float = Field(default=0.0, ge=0)
    ball_material: str = "steel"
    flat_material: str = "glass_k8"
    contact_radius_m: float | None = Field(
        default=None, gt=0, lt=1e-2, description="of the contact; if left out, Hertz's radius"
    )
    mass_centre_height_m: float | None = Field(
        default=None,
        gt=-1,
        lt=1,
        description="of the pendulum over the point of contact (below it: negative); if stated, the results "
        "say which acceleration of the ground drives it",
    )
    gravity_m_per_s2: float = Field(default=STANDARD_GRAVITY_M_PER_S2, gt=0, lt=100)
    u_gravity_m_per_s2: float = Field(default=0.0, ge=0)


class RecordSettings(Section, frozen=True):
    """Image data that a record keeps."""

    windows: bool = Field(
        default=True,
        description="pixels around the spot of every frame, lossless; needed by rig replay --retrack",
    )
    full_frame_interval_s: float = Field(default=10.0, gt=0)


class ViewSettings(Section, frozen=True):
    """The live view in Rerun. If `file` is true, an .rrd file is written next to the record."""

    mode: Literal["none", "spawn", "web"] = "none"
    layout: Literal["balancing", "measuring", "analysing"] = "measuring"
    file: bool = True
    image_interval_s: float = Field(default=1.0, gt=0)


class FitSettings(Section, frozen=True):
    """Options of the fits."""

    printed_055: bool = Field(
        default=False, description="use the factor 0.55 printed in Eq. 6, not the computed one"
    )
    robust: bool = Field(
        default=False, description="use a loss function that is robust to outlying half-cycles"
    )
    drag: bool = Field(default=False, description="also report the fits with a linear drag term")


class Configuration(Section, frozen=True):
    """The whole configuration of one session."""

    session: SessionSettings = SessionSettings()
    environment: EnvironmentConditions = EnvironmentConditions()
    camera: CameraSection = CameraSection()
    sensor: SensorModel | None = None
    shutter: Shutter | None = None
    lever: Lever | None = None
    axes: Axes | None = None
    timebase: TimebaseSettings | None = None
    calibration: CalibrationSettings = CalibrationSettings()
    instrument: InstrumentSettings = InstrumentSettings()
    pendulum: PendulumSettings | None = None
    materials: dict[str, Material] = Field(default_factory=dict)
    record: RecordSettings = RecordSettings()
    view: ViewSettings = ViewSettings()
    fit: FitSettings = FitSettings()
    controller: ControllerSettings = ControllerSettings()
    laser: LaserSettings = LaserSettings()
    environment_sensor: EnvironmentSettings = EnvironmentSettings()
    preflight: PreflightSettings = PreflightSettings()
    phases: PhaseSettings = PhaseSettings()
    start: StartSettings = StartSettings()
    balance: BalanceSettings = BalanceSettings()
    simulation: SimulationSettings = SimulationSettings()
    faults: FaultSettings = FaultSettings()

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.session.final_amplitude_arcsec >= self.session.initial_amplitude_arcsec:
            raise ValueError(
                f"session.final_amplitude_arcsec = {self.session.final_amplitude_arcsec:g} must be below "
                f"session.initial_amplitude_arcsec = {self.session.initial_amplitude_arcsec:g}"
            )
        return self

    @property
    def simulated(self) -> bool:
        """True if the camera is the simulated rig, described by [simulation]."""
        return self.camera.driver == "simulated"

    @property
    def on_demand(self) -> bool:
        """True if frames are simulated or read from files on request, so that none can be lost."""
        paced = self.simulated and self.simulation.real_time
        return find_driver(self.camera.driver).on_demand and not paced

    @property
    def deflection_unit(self) -> DeflectionUnit:
        """Unit of deflections and amplitudes: rad, or px without [lever]."""
        return deflection_unit(self.lever)


def load_configuration(path: Path, overrides: Iterable[str] = ()) -> Configuration:
    """Read a configuration file and apply ``KEY=VALUE`` overrides.

    Raises ConfigurationError, in one line, for a missing file, invalid TOML, an unknown key (naming
    the nearest known one), or a value of the wrong type or out of range.
    """
    tree = read_toml_tree(path)
    apply_overrides(tree, overrides)
    return validate_configuration(tree, str(path))


def read_toml_tree(path: Path, seen: tuple[Path, ...] = ()) -> dict[str, Any]:
    """Read a file as nested dictionaries, merged over the file that it extends."""
    try:
        if path.resolve() in seen:
            raise ConfigurationError(f"{path}: extends itself; remove one of the 'extends' lines")
        tree = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ConfigurationError(f"{path}: no such configuration file") from None
    except IsADirectoryError:
        raise ConfigurationError(f"{path}: is a folder; name a TOML file") from None
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigurationError(f"{path}: cannot be read: {error}") from None
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise ConfigurationError(f"{path}: is not TOML: {error}") from None
    except ValueError as error:
        raise ConfigurationError(f"{str(path)!r}: is not the name of a file ({error})") from None
    base = tree.pop("extends", None)
    if base is None:
        return tree
    if not isinstance(base, str):
        raise ConfigurationError(f"{path}: extends = {base!r} must be the name of a file")
    return _merged(read_toml_tree(path.parent / base, (*seen, path.resolve())), tree)


def validate_configuration(tree: Mapping[str, Any], source: str) -> Configuration:
    """Validate nested dictionaries; a ConfigurationError names the first fault and counts the others."""
    try:
        return Configuration.model_validate(tree)
    except ValidationError as error:
        faults = error.errors()
        more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
        raise ConfigurationError(f"{source}: {_one_line(faults[0])}{more}") from None


def _merged(below: dict[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    result = dict(below)
    for key, value in above.items():
        under = result.get(key)
        result[key] = _merged(under, value) if isinstance(under, dict) and isinstance(value, dict) else value
    return result


def apply_overrides(tree: dict[str, Any], overrides: Iterable[str]) -> None:
    """Set ``KEY=VALUE`` (dotted path, TOML value or bare word) in nested dictionaries, in place."""
    for override in overrides:
        _apply_override(tree, override)


def _apply_override(tree: dict[str, Any], override: str) -> None:
    key, equals, text = override.partition("=")
    if not equals or not key.strip():
        raise ConfigurationError(f"--set {override}: must read KEY=VALUE, for example --set session.runs=3")
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        value = text.strip()
    parts = key.strip().split(".")
    place = tree
    for part in parts[:-1]:
        place = place.setdefault(part, {})
        if not isinstance(place, dict):
            raise ConfigurationError(f"--set {override}: {part} is a value, not a table")
    place[parts[-1]] = value


def _one_line(fault: ErrorDetails) -> str:
    path = ".".join(str(part) for part in fault["loc"])
    if fault["type"] in ("extra_forbidden", "unexpected_keyword_argument"):
        known = _known_keys(fault["loc"][:-1])
        near = difflib.get_close_matches(str(fault["loc"][-1]), known, n=1, cutoff=0.5)
        hint = f"did you mean {near[0]}?" if near else f"known here: {', '.join(sorted(known))}"
        return f"{path}: unknown key; {hint}"
    if fault["type"] == "missing":
        return f"{path}: is missing; state a value"
    message = fault["msg"].removeprefix("Value error, ").removeprefix("Input should be ")
    if not path:
        return message
    expected = message if fault["type"].startswith("value_error") else f"should be {message}"
    return f"{path} = {fault['input']!r}: {expected}"


def section_fields(section: type) -> dict[str, FieldInfo]:
    """Fields of a section, which is a pydantic model or a plain dataclass of `processing`."""
    if issubclass(section, BaseModel):
        return section.model_fields
    if not is_pydantic_dataclass(section):
        section = dataclass(section, frozen=True)
    return cast(dict[str, FieldInfo], vars(section)["__pydantic_fields__"])


def section_of(field: FieldInfo) -> type | None:
    """The section class of a field that holds a section or a table of sections; None for a plain value."""
    found = (c for c in _parts(field.annotation) if isinstance(c, type) and get_origin(c) is None)
    return next((c for c in found if issubclass(c, BaseModel) or is_dataclass(c)), None)


def _parts(annotation: Any) -> Iterator[Any]:
    yield annotation
    for inner in get_args(annotation):
        yield from _parts(inner)


def _known_keys(place: tuple[int | str, ...]) -> list[str]:
    section: type = Configuration
    for part in place:
        field = section_fields(section).get(str(part))
        inner = None if field is None else section_of(field)
        if inner is None:
            break
        section = inner
    return list(section_fields(section))
