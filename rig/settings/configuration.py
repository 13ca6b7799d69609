"""Reads a TOML configuration into frozen models; every error is reported in a line of its own.

A file may begin with ``extends = "other.toml"`` (relative to itself) and then states only what
differs. On the command line ``--set a.b.c=value`` replaces any key by its dotted path.
"""

import logging
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, Self

from pydantic import AwareDatetime, BaseModel, Field, model_validator

from acquisition.cameras.drivers import find_driver
from acquisition.simulation.faults import FaultSettings
from acquisition.simulation.settings import SimulationSettings
from calibration import Axes, Lever, Shutter, deflection_unit
from processing.contact import STANDARD_GRAVITY_M_PER_S2, Material
from processing.deflections import DeflectionUnit
from processing.errors import ConfigurationError
from processing.spot import SensorModel
from processing.units import unit_of_name
from rig.control import ControllerSettings, EnvironmentSettings, LaserSettings, WitnessSettings
from rig.settings.balance import BalanceSettings
from rig.settings.calibration import CalibrationSettings, TimebaseSettings
from rig.settings.camera import CameraSection
from rig.settings.instrument import InstrumentSettings
from rig.settings.migrations import SCHEMA, SCHEMA_KEY, migrated
from rig.settings.phases import PhaseSettings, PreflightSettings, StartSettings
from rig.settings.stop_conditions import StopCondition, stop_conditions
from rig.settings.toml_file import read_toml
from rig.settings.typed import quantity, states_unit
from rig.settings.wording import KeyFault, dotted, validated

logger = logging.getLogger(__name__)


class Section(BaseModel, frozen=True, extra="forbid"):
    """A table of the configuration; an unknown key is an error."""


class SessionSettings(Section, frozen=True):
    """The sample, the operator, the number of runs, and when a run ends."""

    operator: str = ""
    sample: str = ""
    notes: str = ""
    contact_history: str = Field(default="", description="age, cleaning and earlier loads of the contact")
    contact_made: AwareDatetime | None = Field(
        default=None, description="when the ball was set on its place: 2026-11-22T09:30:00+01:00"
    )
    surfaces_cleaned: AwareDatetime | None = Field(
        default=None, description="when ball and flat were last cleaned, in the same form"
    )
    runs: int = Field(default=1, ge=1, le=1000)
    initial_amplitude_arcsec: float = Field(
        default=124.0, gt=0, description="wanted at the start of a run; see [start]"
    )
    final_amplitude_arcsec: float = Field(default=2.0, gt=0, description="a run ends below this amplitude")
    stop_when: tuple[str, ...] = Field(
        default=(),
        description="a run ends, too, once all of these hold, for example u(c)/c < 0.03 and u(b)/b < 0.01",
    )
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
    pressure_pa: float | None = Field(default=None, gt=1e4, lt=2e5)


class PendulumSettings(Section, frozen=True):
    """The pendulum, its ball and the plate it stands on. `u_...` are standard uncertainties."""

    mass_kg: float = Field(gt=0, lt=100)
    u_mass_kg: float = Field(default=0.0, ge=0)
    ball_radius_m: float = Field(gt=1e-5, lt=1)
    u_ball_radius_m: float = Field(default=0.0, ge=0)
    ball_material: str = "steel"
    flat_material: str = "glass_k8"
    contact_radius_m: float | None = Field(
        default=None, gt=0, lt=1e-2, description="of the contact; if left out, Hertz's radius"
    )
    u_contact_radius_m: float = Field(default=0.0, ge=0)
    mass_centre_height_m: float | None = Field(
        default=None,
        gt=-1,
        lt=1,
        description="of the pendulum over the point of contact (below it: negative); if stated, the results "
        "say which acceleration of the ground drives it",
    )
    length_m: float | None = Field(
        default=None, gt=0, lt=10, description="across its axis of swing; of the drag expected of the air"
    )
    width_m: float | None = Field(
        default=None, gt=0, lt=10, description="along that axis; both left out: as its inertia says"
    )
    expansion_per_k: float = Field(
        default=1.15e-5,
        ge=0,
        lt=1e-3,
        description="of its body, by which the period grows; of steel if left out",
    )
    gravity_m_per_s2: float = Field(default=STANDARD_GRAVITY_M_PER_S2, gt=0, lt=30)
    u_gravity_m_per_s2: float = Field(default=0.0, ge=0)


class ReferenceSettings(Section, frozen=True):
    """A second spot on the sensor, from a mirror that is fixed to the base: it sees pointing and air alone.

    It has the rows of each frame from `from_row_px` on, the pendulum's spot those before.
    """

    from_row_px: int = Field(
        ge=8, description="first row of the frame that the reference spot has for itself"
    )
    gain: float = Field(
        default=1.0,
        gt=0,
        lt=100,
        description="how many times as far as the reference the beam's motion moves the pendulum's spot: 1 "
        "where both have the same way from the laser",
    )
    u_gain: float = Field(default=0.0, ge=0, lt=100)


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
    drag: Literal["air", "open", "vacuum"] = Field(
        default="air",
        description="the drag: about what the air exerts; open: nothing is known of it; vacuum: none",
    )
    drag_s: float | None = Field(
        default=None,
        ge=0,
        description="measured, in the place of the air's estimate; moment -m g R drag phi'",
    )
    u_drag_s: float = Field(default=0.0, ge=0)
    u_ageing: float = Field(
        default=0.01,
        ge=0,
        lt=1,
        description="by how much the contact's friction may change over a run, as a fraction of it",
    )
    u_temperature_change_k: float = Field(
        default=1.0, ge=0, lt=100, description="over a run, where no sensor has read it"
    )
    drifts: bool = Field(
        default=False,
        description="fit drifts of the contact's friction and of the period; else the budget has them",
    )

    @property
    def fits_drag(self) -> bool:
        """Whether a drag is among the parameters."""
        return self.drag != "vacuum"

    @property
    def opened(self) -> "FitSettings":
        """The same with nothing known of the air, as its drag is measured."""
        return self.model_copy(update={"drag": "open", "drag_s": None, "u_drag_s": 0.0})

    @model_validator(mode="after")
    def _drag_is_one(self) -> Self:
        if self.drag_s is None:
            return self
        if self.drag != "air":
            raise ValueError(
                f"drag_s = {self.drag_s:g} is of the air, and drag = {self.drag!r}: state one of them"
            )
        if not self.u_drag_s > 0:
            raise ValueError(f"drag_s = {self.drag_s:g} needs its standard uncertainty u_drag_s")
        return self


class Configuration(Section, frozen=True):
    """The whole configuration of one session."""

    session: SessionSettings = SessionSettings()
    environment: EnvironmentConditions = EnvironmentConditions()
    camera: CameraSection
    sensor: SensorModel | None = None
    shutter: Shutter | None = None
    reference: ReferenceSettings | None = None
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
    witness: WitnessSettings = WitnessSettings()
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
        try:
            stop_conditions(self.session.stop_when, drag=self.fit.fits_drag)
        except ValueError as error:
            raise ValueError(f"session.stop_when: {error}") from None
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
    def stop_conditions(self) -> tuple[StopCondition, ...]:
        """Those of `session.stop_when`."""
        return stop_conditions(self.session.stop_when, drag=self.fit.fits_drag)

    @property
    def deflection_unit(self) -> DeflectionUnit:
        """Unit of deflections and amplitudes: rad, or px without [lever]."""
        return deflection_unit(self.lever)


def load_configuration(
    path: Path, overrides: Iterable[str] = (), *, needs_camera: bool = True
) -> Configuration:
    """Read a configuration file and apply ``KEY=VALUE`` overrides.

    Without `needs_camera`, for what is calculated from a table, ``camera.driver`` may be left out.

    Raises ConfigurationError for a missing file, invalid TOML, an unknown key (naming the nearest known
    one), or a value of the wrong type or out of range: a line for each, which names the file or --set.
    """
    tree = read_toml_tree(path)
    overrides = tuple(overrides)
    apply_overrides(tree, overrides)
    if not needs_camera and "camera" not in tree:
        tree["camera"] = {"driver": "files"}
    return validate_configuration(tree, str(path), overrides)


def read_toml_tree(path: Path, seen: tuple[Path, ...] = ()) -> dict[str, Any]:
    """Tables of a configuration file, merged over those of the file that it extends."""
    tree = read_toml(path, "configuration file; rig init writes one")
    if path.resolve() in seen:
        raise ConfigurationError(f"{path}: extends itself; remove one of the 'extends' lines")
    # one without a number is a person's, written after today's documents
    tree, note = migrated({SCHEMA_KEY: SCHEMA} | tree, str(path))
    if note:
        logger.warning("%s", note)
    base = tree.pop("extends", None)
    if base is None:
        return tree
    if not isinstance(base, str):
        raise ConfigurationError(f"{path}: extends = {base!r} must be the name of a file")
    if not (path.parent / base).exists():
        raise ConfigurationError(
            f"{path}: extends = {base!r}: no such file in {path.parent.resolve()}, the folder of this one"
        )
    return _merged(read_toml_tree(path.parent / base, (*seen, path.resolve())), tree)


def stored_configuration(config: Configuration) -> dict[str, Any]:
    """The whole configuration as records and sessions keep it, with the number of its schema."""
    return {SCHEMA_KEY: SCHEMA, **config.model_dump(mode="json")}


class FaultyConfiguration(ConfigurationError):
    """A line for each fault of a configuration; `of_overrides` are those of --set, by their keys."""

    def __init__(self, lines: Sequence[str], of_overrides: Sequence[tuple[str, str]]) -> None:
        super().__init__("\n".join(lines))
        self.of_overrides = tuple(of_overrides)


def validate_configuration(
    tree: Mapping[str, Any], source: str, overrides: Iterable[str] = ()
) -> Configuration:
    """Validate nested dictionaries; a ConfigurationError has a line for each fault, unknown keys first.

    A fault of a key that one of `overrides` states is reported as one of --set, any other as one of `source`.
    """
    # so that a missing section is reported as the key that it lacks
    tree = {"camera": {}, **tree}
    config, found_faults = validated(Configuration, tree)
    if config is not None:
        return config
    stated = {f"{override.partition('=')[0].strip()}." for override in overrides}
    with_u = stated | {".u_".join(key.rsplit(".", 2)[:2]) + "." for key in stated if key.count(".") > 1}
    lines, of_overrides = [], []
    for fault in found_faults:
        is_stated, place = _is_of(fault, with_u), fault.place
        beside = [key.rstrip(".") for key in sorted(stated) if place and key.startswith(f"{place[0]}.")]
        why = f" (--set {beside[0]} states this section)" if fault.is_missing and beside else ""
        lines.append(f"{'--set ' if is_stated else f'{source}: '}{fault.line}{why}")
        of_overrides += [(dotted(place), f"{fault.line}{why}")] if is_stated else []
    raise FaultyConfiguration(lines, of_overrides)


def keys_with_faults(
    keys: Mapping[str, Any], whole: str = "", root: type[BaseModel] | None = None
) -> list[str]:
    """A line for each fault of these values, which are by dotted key; other keys may still be missing.

    What holds between the keys of a section is checked of the section `whole` only. `root` is the model of
    the file; None: the configuration.
    """
    tree: dict[str, Any] = {} if root else {"camera": {"driver": "files"}}
    for key, value in keys.items():
        *sections, name = key.split(".")
        place = tree
        for section in sections:
            place = place.setdefault(section, {})
        place[name] = value
    _, found_faults = validated(root or Configuration, tree)
    asked = {*keys, whole} - {""}
    return [fault.line for fault in found_faults if dotted(fault.place) in asked]


def _is_of(fault: KeyFault, stated: set[str]) -> bool:
    """Whether a fault is that of a key that --set states, or inside or around it.

    A fault between several keys has no place; they stand in its line.
    """
    if not fault.place:
        return any(key.rstrip(".") in fault.line for key in stated)
    place = dotted(fault.place)
    return any(key.startswith(f"{place}.") or f"{place}.".startswith(key) for key in stated)


def _merged(below: dict[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    result = dict(below)
    for key, value in above.items():
        under = result.get(key)
        result[key] = _merged(under, value) if isinstance(under, dict) and isinstance(value, dict) else value
    return result


def apply_overrides(tree: dict[str, Any], overrides: Iterable[str]) -> None:
    """Set ``KEY=VALUE`` (dotted path, TOML value or bare word) in nested dictionaries, in place.

    A number may state its unit and its standard uncertainty: ``pendulum.ball_radius_m="6.05 mm ± 1 um"``.
    """
    stated = set()
    for override in overrides:
        key = override.partition("=")[0].strip()
        if key in stated:
            raise ConfigurationError(f"--set {override}: {key} is stated twice; leave one of them out")
        stated.add(key)
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
    name = parts[-1]
    place[name] = value
    if isinstance(value, str) and states_unit(value) and (unit := unit_of_name(name)):
        try:
            place[name], u = quantity(value, unit)
        except ConfigurationError as error:
            raise ConfigurationError(f"--set {key.strip()} = {error}") from None
        if u is not None:
            place[f"u_{name}"] = u
