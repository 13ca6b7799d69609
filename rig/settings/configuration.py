"""The configuration as frozen models: one for each section, and one for the whole."""

import shlex
from collections.abc import Iterable
from pathlib import Path
from typing import Literal, Self

from pydantic import AwareDatetime, BaseModel, Field, PrivateAttr, model_validator

from acquisition.cameras.drivers import find_driver
from acquisition.simulation.inputs import FaultSettings
from acquisition.simulation.settings import SimulationSettings
from calibration import Axes, Lever, Shutter, deflection_unit
from processing.ambient import POSSIBLE_READINGS
from processing.contact import STANDARD_GRAVITY_M_PER_S2, Material
from processing.deflections import DeflectionUnit
from processing.spot import SensorModel
from rig.control import LASERS, ControllerSettings, EnvironmentSettings, LaserSettings, SeismometerSettings
from rig.settings.number_input import StopCondition, stop_conditions
from rig.settings.sections import (
    BalanceSettings,
    CalibrationSettings,
    CameraSection,
    InstrumentSettings,
    PhaseSettings,
    PreflightSettings,
    StartSettings,
    TimebaseSettings,
)

_DEVICE_KEYS = ("controller.", "laser.", "session.output")
"""Prefixes of the keys of devices and output folder: a command for this rig must state them again."""


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
        description="a run also ends once all of these hold, for example u(c)/c < 0.03 and u(b)/b < 0.01",
    )
    max_duration_s: float = Field(default=7200.0, gt=0, description="a run ends after this time in any case")
    output: Path = Field(default=Path("runs"), description="each session makes a folder in it")
    notify_command: tuple[str, ...] = Field(
        default=(), description="called on alarm, end and failure, followed by kind, text and folder"
    )


_TEMPERATURE_C, _PRESSURE_PA = POSSIBLE_READINGS["temperature_c"], POSSIBLE_READINGS["pressure_pa"]


class EnvironmentConditions(Section, frozen=True):
    """Conditions in the laboratory as stated by the user; stored in the record."""

    temperature_c: float | None = Field(default=None, gt=_TEMPERATURE_C[0], lt=_TEMPERATURE_C[1])
    humidity_percent: float | None = Field(default=None, ge=0, le=100)
    pressure_pa: float | None = Field(default=None, gt=_PRESSURE_PA[0], lt=_PRESSURE_PA[1])


class PendulumSettings(Section, frozen=True):
    """The pendulum, its ball and the plate it stands on. `u_...` are standard uncertainties."""

    mass_kg: float = Field(gt=0, lt=100)
    u_mass_kg: float = Field(default=0.0, ge=0)
    ball_radius_m: float = Field(gt=1e-5, lt=1)
    u_ball_radius_m: float = Field(default=0.0, ge=0)
    ball_material: str = "steel"
    flat_material: str = "glass_k8"
    contact_radius_m: float | None = Field(
        default=None, gt=0, lt=1e-2, description="if left out, Hertz's radius is taken"
    )
    u_contact_radius_m: float = Field(default=0.0, ge=0)
    length_m: float | None = Field(
        default=None, gt=0, lt=10, description="across its axis of swing; for the estimate of the air's drag"
    )
    width_m: float | None = Field(
        default=None, gt=0, lt=10, description="along the axis of swing; without both: from the inertia"
    )
    expansion_per_k: float = Field(
        default=1.15e-5,
        ge=0,
        lt=1e-3,
        description="of the pendulum's body; it changes the period",
    )
    gravity_m_per_s2: float = Field(default=STANDARD_GRAVITY_M_PER_S2, gt=0, lt=30)
    u_gravity_m_per_s2: float = Field(default=0.0, ge=0)


class ReferenceSettings(Section, frozen=True):
    """A second spot on the sensor, from a mirror that is fixed to the base: it sees pointing and air alone.

    It lies in the rows from `from_row_px` on; the pendulum's spot lies in the rows above.
    """

    from_row_px: int = Field(
        ge=8, description="first row of the part of the frame reserved for the reference spot"
    )
    gain: float | None = Field(
        default=None,
        gt=0,
        lt=100,
        description="the beam's motion moves the pendulum's spot this many times as far as the reference (1 "
        "for equal paths from the laser); if left out, it is found from each run, along both axes of the "
        "sensor",
    )
    u_gain: float = Field(default=0.0, ge=0, lt=100)

    @model_validator(mode="after")
    def _check_gain(self) -> Self:
        if self.u_gain and self.gain is None:
            raise ValueError(f"u_gain = {self.u_gain:g}: has no effect without gain; state both, or neither")
        return self


class RecordSettings(Section, frozen=True):
    """Image data that a record keeps."""

    windows: bool = Field(
        default=True,
        description="pixels around the spot of every frame, lossless; needed by rig replay --retrack",
    )
    full_frame_interval_s: float = Field(default=10.0, gt=0)


class ViewSettings(Section, frozen=True):
    """The live view in Rerun."""

    mode: Literal["none", "spawn", "web"] = "none"
    layout: Literal["balancing", "measuring", "analysing"] = "measuring"
    image_interval_s: float = Field(default=1.0, gt=0)


class FitSettings(Section, frozen=True):
    """Options of the fits."""

    robust: bool = Field(
        default=False, description="use a loss function that is robust to outlying half-cycles"
    )
    drag: Literal["air", "open", "vacuum"] = Field(
        default="air",
        description="drag in the fit: air, with its estimate as prior; open, free; vacuum, none",
    )
    drag_s: float | None = Field(
        default=None,
        ge=0,
        description="measured; replaces the air's estimate; moment -m g R drag phi'",
    )
    u_drag_s: float = Field(default=0.0, ge=0)
    u_ageing: float = Field(
        default=0.01,
        ge=0,
        lt=1,
        description="by how much the contact's friction may change over a run, as a fraction of it",
    )
    u_adhesion_ageing: float | None = Field(
        default=None, ge=0, lt=1, description="as u_ageing, for c (adhesion); equal to it if not stated"
    )
    u_drag_drift: float | None = Field(
        default=None, ge=0, lt=1, description="as u_ageing, for drag; from temperature if not stated"
    )
    u_temperature_change_k: float = Field(
        default=1.0, ge=0, lt=100, description="change over a run without a sensor"
    )
    drifts: bool = Field(
        default=False,
        description="fit drifts of friction, drag and period; otherwise the budget includes them",
    )

    @property
    def fits_drag(self) -> bool:
        """Whether the drag is a parameter of the fit."""
        return self.drag != "vacuum"

    @property
    def with_free_drag(self) -> "FitSettings":
        """These settings with a free drag, for a measurement of it."""
        return self.model_copy(update={"drag": "open", "drag_s": None, "u_drag_s": 0.0})

    @model_validator(mode="after")
    def _check_drag(self) -> Self:
        if self.drag_s is None:
            return self
        if self.drag != "air":
            raise ValueError(
                f"drag_s = {self.drag_s:g} goes with drag = 'air', not {self.drag!r}: leave one out"
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
    seismometer: SeismometerSettings = SeismometerSettings()
    preflight: PreflightSettings = PreflightSettings()
    phases: PhaseSettings = PhaseSettings()
    start: StartSettings = StartSettings()
    balance: BalanceSettings = BalanceSettings()
    simulation: SimulationSettings = SimulationSettings()
    faults: FaultSettings = FaultSettings()
    _command_words: str = PrivateAttr(default="CONFIG")

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.session.final_amplitude_arcsec >= self.session.initial_amplitude_arcsec:
            raise ValueError(
                f"session.final_amplitude_arcsec = {self.session.final_amplitude_arcsec:g} must be below "
                f"session.initial_amplitude_arcsec = {self.session.initial_amplitude_arcsec:g}"
            )
        balls, model = self.simulation.contact.balls, self.instrument.description()
        if self.simulated and model.report == "contact" and balls != model.supports:
            raise ValueError(
                f"simulation.contact.balls = {balls} with instrument.kind = {model.kind!r}, which stands on "
                f"{model.supports}: the fit would take the contact for another; state another kind, or "
                f"simulation.contact.balls = {model.supports}"
            )
        try:
            stop_conditions(self.session.stop_when, drag=self.fit.fits_drag)
        except ValueError as error:
            raise ValueError(f"session.stop_when: {error}") from None
        return self

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Configuration) and all(
            getattr(self, name) == getattr(other, name) for name in Configuration.model_fields
        )

    @property
    def command_words(self) -> str:
        """Words of the command line that select this rig: its file, and --set of its devices."""
        return self._command_words

    def remember_file(self, path: Path, overrides: Iterable[str] = ()) -> Self:
        """Store file and overrides for `command_words`."""
        words = [str(path)]
        for text in overrides:
            words += ["--set", text] if text.strip().startswith(_DEVICE_KEYS) else []
        # a private attribute, because it is the origin of the values and not one of them
        self._command_words = shlex.join(words)  # type: ignore[misc]
        return self

    @property
    def rehearsal_hint(self) -> str:
        """Message with the --set options by which a simulated camera runs without devices; else empty."""
        has_board = self.controller.kind == "serial"
        if not (self.simulated and (has_board or self.laser.kind in LASERS)):
            return ""
        keys = ["controller.kind=none"] if has_board else []
        keys += ["laser.kind=none"] if self.laser.kind != "none" else []
        keys += ["start.way=at once"] if has_board and self.start.way != "at once" else []
        words = shlex.join(word for key in keys for word in ("--set", key))
        return f"the camera is simulated, and runs without: {words}"

    @property
    def simulated(self) -> bool:
        """Whether the camera is the simulated rig, described by [simulation]."""
        return self.camera.driver == "simulated"

    @property
    def on_demand(self) -> bool:
        """Whether frames are simulated or read from files on request, so that none can be lost."""
        real_time = self.simulated and self.simulation.real_time
        return find_driver(self.camera.driver).on_demand and not real_time

    @property
    def stop_conditions(self) -> tuple[StopCondition, ...]:
        """`session.stop_when`, parsed."""
        return stop_conditions(self.session.stop_when, drag=self.fit.fits_drag)

    @property
    def deflection_unit(self) -> DeflectionUnit:
        """Unit of deflections and amplitudes: rad, or px without [lever]."""
        return deflection_unit(self.lever)
