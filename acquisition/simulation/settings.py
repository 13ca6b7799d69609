"""Section [simulation]: true values of the simulated rig.

The defaults are those of the demonstration: a steel ball on K8 glass with the parameters of the paper, on a
sensor of 320x640 pixels at 100 frames/s.
"""

import math
from pathlib import Path
from typing import Literal, NamedTuple, Self

from pydantic import BaseModel, Field, model_validator

ARCSEC_RAD = math.pi / (180 * 3600)


class SimulationSection(BaseModel, frozen=True, extra="forbid"):
    """Base class of the settings; an unknown key is an error."""


class ContactTruth(SimulationSection, frozen=True):
    """Pendulum and contact of the slow mode, angles in rad (Eqs. 1, 3 and 4)."""

    b: float = Field(default=37.33e-4, ge=0, description="friction that grows with the angle, rad^-p")
    p: float = Field(default=0.944, gt=0, lt=4, description="its exponent")
    c: float = Field(default=10.51e-9, ge=0, description="constant friction over m g R, adhesive")
    n: float = Field(default=0.092, ge=0, lt=4, description="exponent of the elastic adhesion")
    period0_s: float = Field(default=4.071, gt=0, description="period at vanishing amplitude, elasticity off")
    gamma_pa: float = Field(default=28.97e6, ge=0, description="elastic adhesion, Eq. 3")
    drag_s: float = Field(default=0.0, ge=0, description="linear drag; moment -m g R drag_s phi'")
    vane_area_m2: float = Field(default=0.0, ge=0, lt=10, description="of vanes on the pendulum")
    vane_drag_s_per_m2: float = Field(default=0.025, ge=0, description="what they add to the drag")
    exact_pendulum: bool = Field(
        default=False,
        description="for amplitudes of degrees: sine of the angle, rolling support of ball_radius_m; "
        "friction and adhesion are then relative to m g times the distance of the mass centre from the axis",
    )
    balls: Literal[1, 2] = Field(default=1, description="equal balls that share the weight")
    mass_kg: float = Field(default=0.406, gt=0, lt=100)
    ball_radius_m: float = Field(default=6.05e-3, gt=0, lt=1)
    contact_radius_m: float | None = Field(
        default=None, gt=0, description="radius of the contact spot; None: Hertz, from the constants below"
    )
    ball_youngs_modulus_pa: float = Field(default=2.11e11, gt=0)
    ball_poisson_ratio: float = Field(default=0.28, gt=-1, lt=0.5)
    flat_youngs_modulus_pa: float = Field(default=0.82e11, gt=0)
    flat_poisson_ratio: float = Field(default=0.206, gt=-1, lt=0.5)
    gravity_m_per_s2: float = Field(default=9.80665, gt=0, lt=30)

    @property
    def whole_drag_s(self) -> float:
        """The drag of the pendulum and its vanes."""
        return self.drag_s + self.vane_drag_s_per_m2 * self.vane_area_m2


class FastModeTruth(SimulationSection, frozen=True):
    """The mode about the other axis, X(t). It follows the same laws with its own moment of inertia."""

    period_ratio: float = Field(default=5.0, gt=1, description="slow period0 over fast period0")
    amplitude_arcsec: float = Field(default=0.3, ge=0, description="at release; by the starter, at most")
    phase_rad: float = Field(default=0.0, description="at release; 0: at a turning point")
    friction_factor: float = Field(default=1.0, ge=0, description="times b and c of the slow mode")
    drag_s: float = Field(default=0.0, ge=0, description="linear drag of this mode")


class ReleaseTruth(SimulationSection, frozen=True):
    """Release of the pendulum."""

    amplitude_arcsec: float = Field(default=124.0, gt=0, lt=200000, description="of the slow mode")
    at_s: float = Field(default=0.0, ge=0, description="simulated time of the release; at rest before")
    way: Literal["let go", "push", "by command"] = Field(
        default="let go",
        description="'let go': held at the amplitude, then released; 'push': at rest at zero, then given the "
        "velocity with which it would reach the amplitude without losses and elasticity; 'by command': at "
        "rest until a controller's magnet or starter moves it",
    )
    starter_arcsec: float = Field(
        default=150.0, description="shift of the rest position while the starter pushes"
    )
    brake_drag_s: float = Field(default=0.5, ge=0, description="linear drag while the brake is on")


class AxesTruth(SimulationSection, frozen=True):
    """Directions of the pendulum's axes on the sensor, and the effects of an imbalance.

    The sensor's x points to the right, its y down. `slow_angle_rad` is the angle of the slow mode's positive
    direction from the sensor's upward vertical, positive towards +x. That of the fast mode is at that angle
    plus a right angle plus `non_orthogonality_rad`; if `mirrored`, it has the opposite sign.
    """

    slow_angle_rad: float = Field(default=0.0, ge=-3.2, le=3.2)
    non_orthogonality_rad: float = Field(default=0.0, gt=-0.5, lt=0.5)
    mirrored: bool = False
    leakage: float = Field(default=0.002, gt=-1, lt=1, description="part of the slow tilt that appears in X")
    leakage_quadrature: float = Field(
        default=0.0, gt=-1, lt=1, description="the same with a phase of a quarter period: an ellipse"
    )
    spin_rad_per_s: float = Field(default=0.0, description="rotation of both axes about the vertical")
    rest_slow_arcsec: float = Field(default=0.0, description="rest position, slow axis")
    rest_fast_arcsec: float = Field(default=0.0, description="rest position, fast axis")
    rest_drift_slow_arcsec_per_min: float = 0.0
    rest_drift_fast_arcsec_per_min: float = 0.0


class OpticsTruth(SimulationSection, frozen=True):
    """Light lever and laser spot. A tilt phi moves the spot by ``arm tan(2 phi)``, axis by axis."""

    arm_m: float = Field(default=1.0, gt=0, description="mirror to sensor, along the beam")
    reference_x_px: float | None = Field(
        default=None, description="spot of the untilted pendulum; None: the sensor's middle"
    )
    reference_y_px: float | None = None
    sigma_x_px: float = Field(default=6.0, ge=1, le=200, description="along the axis at rotation_rad from x")
    sigma_y_px: float = Field(default=6.0, ge=1, le=200, description="across that axis")
    rotation_rad: float = Field(default=0.0, description="from x towards y (clockwise as seen)")
    peak_dn: float = Field(
        default=174.0, ge=0, description="light of the spot's brightest point above the background, in DN, "
        "at the exposure stated for the sensor; more than full scale saturates"
    )  # fmt: skip
    laser_w: float = Field(default=1e-3, gt=0, description="optical power at which peak_dn holds")
    power_noise: float = Field(default=0.0, ge=0, lt=0.2, description="relative, from frame to frame")
    ghost_relative: float = Field(default=0.0, ge=0, lt=1, description="light of a second-surface ghost")
    ghost_dx_px: float = 40.0
    ghost_dy_px: float = 0.0


class ReferenceTruth(SimulationSection, frozen=True):
    """A second spot, by a mirror that is fixed to the base: beam, camera and base move it, no pendulum."""

    relative: float = Field(
        default=0.0, ge=0, le=1, description="its light over that of the pendulum's spot; 0: none"
    )
    x_px: float = Field(default=160.0, description="its place on the sensor")
    y_px: float = 684.0
    gain: float = Field(
        default=1.0, gt=0, description="how many times as far the beam moves the pendulum's spot"
    )
    air_common: float = Field(
        default=1.0, ge=0, le=1, description="correlation of the air in both ways of the beam"
    )


class SensorState(NamedTuple):
    """Properties of the sensor at one bit depth and gain, for the kernels."""

    gain_e_per_dn: float
    read_noise_e: float
    full_scale_dn: int
    black_level_dn: float
    full_well_e: float
    ambient_e: float = 0.0
    """Uniform background light of an exposure."""

    def binned(self, binning: int) -> "SensorState":
        """Properties of the mean of `binning` squared pixels, each of which is read with its own noise."""
        return self._replace(
            gain_e_per_dn=self.gain_e_per_dn * binning**2,
            read_noise_e=self.read_noise_e * binning,
            full_well_e=self.full_well_e * binning**2,
        )


class SensorTruth(SimulationSection, frozen=True):
    """The image sensor. The black level is not due to light and has read noise only."""

    width_px: int = Field(default=320, ge=16, le=8192)
    height_px: int = Field(default=640, ge=16, le=8192)
    pixel_pitch_m: float = Field(default=4.8e-6, gt=0, lt=1e-3)
    bit_depth: Literal[8, 10, 12, 16] = 8
    gain_e_per_dn: float = Field(default=39.2, gt=0, description="at the bit depth stated here")
    full_well_e: float = Field(default=10_000.0, gt=0)
    read_noise_e: float = Field(default=7.0, ge=0)
    black_level_dn: float = Field(default=6.0, ge=0, description="at the bit depth stated here")
    ambient_dn: float = Field(default=0.0, ge=0, description="uniform background light in DN (slow to draw)")
    prnu: float = Field(default=0.0, ge=0, lt=0.2, description="relative spread of the pixels' response")
    hot_pixels: int = Field(default=0, ge=0, le=100_000, description="how many, anywhere")
    hot_pixel_dn: float = Field(
        default=120.0, gt=0, description="mean dark signal of a hot pixel, exponential"
    )
    exposure_us: float = Field(default=100.0, gt=0, description="at which optics.peak_dn holds")
    row_time_s: float = Field(
        default=0.0, ge=0, lt=1e-3, description="from one row to the next; 0: a global shutter"
    )
    first_row: Literal["top", "bottom"] = Field(
        default="top", description="of the region that is read out, the row that is exposed first"
    )

    def at(self, bit_depth: int, gain_db: float = 0.0) -> SensorState:
        """Properties at another bit depth and gain; at 0 dB full scale is the same number of electrons."""
        scale = (2**self.bit_depth - 1) / (2**bit_depth - 1) * 10 ** (-gain_db / 20)
        return SensorState(
            gain_e_per_dn=self.gain_e_per_dn * scale,
            read_noise_e=self.read_noise_e,
            full_scale_dn=2**bit_depth - 1,
            black_level_dn=self.black_level_dn * (2**bit_depth - 1) / (2**self.bit_depth - 1),
            full_well_e=self.full_well_e,
        )


class ClockTruth(SimulationSection, frozen=True):
    """Frame rate, and the camera's clock."""

    frame_rate_hz: float = Field(default=100.0, gt=0, le=100_000)
    start_s: float = Field(default=1.0, ge=0, description="reading of the camera's clock at simulated time 0")
    drift_ppm: float = Field(
        default=0.0, gt=-1e4, lt=1e4, description="rate of the camera's clock against true time"
    )
    jitter_s: float = Field(
        default=0.0, ge=0, description="of timestamps, normal, truncated at 0.4 of the frame period"
    )


class MicrophonicTruth(SimulationSection, frozen=True):
    """One frequency at which laser or camera shake: the spot's place in x and y, each at its own phase."""

    frequency_hz: float = Field(gt=0, le=10_000)
    amplitude_px: float = Field(ge=0, le=100)


class DisturbanceTruth(SimulationSection, frozen=True):
    """Disturbances by the laboratory; positions on the sensor in px."""

    pointing_jitter_px: float = Field(default=0.0, ge=0, description="white, per frame and axis")
    pointing_drift_x_px_per_min: float = 0.0
    pointing_drift_y_px_per_min: float = 0.0
    pointing_walk_px_per_sqrt_s: float = Field(default=0.0, ge=0, description="random walk, per axis")
    camera_creep_x_px_per_min: float = Field(
        default=0.0, description="of the camera against the beams: every spot on its sensor moves alike"
    )
    camera_creep_y_px_per_min: float = 0.0
    camera_slips_at_s: float | None = Field(default=None, ge=0, description="a sudden slip of the camera")
    camera_slip_x_px: float = 0.0
    camera_slip_y_px: float = 0.0
    air_arcsec: float = Field(
        default=0.0,
        ge=0,
        le=100,
        description="bending of the beam by air, per axis, rms of its 1/f spectrum between the frequencies "
        "below, as the tilt of the pendulum that it looks like",
    )
    air_from_hz: float = Field(default=0.01, gt=0, description="at least a thousandth of air_to_hz")
    air_to_hz: float = Field(default=10.0, gt=0, le=1000)
    dropped_fraction: float = Field(
        default=0.0, ge=0, lt=1, description="frames lost by the camera, at random"
    )
    microphonics: tuple[MicrophonicTruth, ...] = Field(
        default=(), description="frequencies at which mounts shake the spot"
    )

    @model_validator(mode="after")
    def _air_has_a_band(self) -> Self:
        if not 1 < self.air_to_hz / self.air_from_hz <= 1000:
            raise ValueError(
                f"disturbances.air_from_hz = {self.air_from_hz:g} must lie below air_to_hz = "
                f"{self.air_to_hz:g}, by a factor of 1000 at most"
            )
        return self


class StatedTruth(SimulationSection, frozen=True):
    """Standard uncertainties of the rig's constants, as they are stated to the analysis.

    The stated values themselves are the true ones.
    """

    u_mass_kg: float = Field(default=0.0, ge=0)
    u_ball_radius_m: float = Field(default=0.0, ge=0)
    u_ball_youngs_modulus_pa: float = Field(default=0.0, ge=0)
    u_flat_youngs_modulus_pa: float = Field(default=0.0, ge=0)
    u_poisson_ratio: float = Field(default=0.0, ge=0, description="of ball and flat")
    u_gravity_m_per_s2: float = Field(default=0.0, ge=0)
    u_arm_m: float = Field(default=0.0, ge=0)
    u_pixel_pitch_m: float = Field(default=0.0, ge=0)


class GroundTruth(SimulationSection, frozen=True):
    """Motion of the ground: horizontal acceleration, through the mass centre's height, and tilt.

    The two horizontal components, along the slow and the fast swing, are independent and equal in
    level. A file's first column of accelerations moves the slow mode, its second the fast one.
    """

    model: Literal["none", "white", "peterson", "file"] = Field(
        default="none",
        description="of the acceleration: 'white' as stated below; 'peterson': between the new low and high "
        "noise models of 1993; 'file': as recorded",
    )
    white_m_per_s2_per_sqrt_hz: float = Field(
        default=1e-6, ge=0, description="white level, one-sided amplitude spectral density"
    )
    between_noise_models: float = Field(
        default=0.5, ge=0, le=1, description="place in dB between the low (0) and the high (1) noise model"
    )
    above_low_noise_db: float | None = Field(
        default=None, gt=-100, lt=200, description="instead: so many dB above the low noise model"
    )
    file: Path | None = Field(
        default=None,
        description="CSV of time_s and one or two accelerations at even times; a column's name ends in its "
        "unit: _m_per_s2, _um_per_s2 or _nm_per_s2",
    )
    file_offset_s: float = Field(default=0.0, ge=0, description="place in the file at which a run begins")
    tilt_rad_per_sqrt_hz: float = Field(
        default=0.0, ge=0, description="tilt of the base: white level, one-sided, with any model"
    )
    tilt_slow_arcsec_per_min: float = Field(
        default=0.0, description="steady tilt of the base along the slow swing, as of one that settles"
    )
    tilt_fast_arcsec_per_min: float = 0.0
    tilt_step_at_s: float | None = Field(default=None, ge=0, description="someone steps beside the base")
    tilt_step_slow_arcsec: float = Field(default=0.0, description="from then on; it takes a second")
    tilt_step_fast_arcsec: float = 0.0
    mass_centre_height_m: float = Field(
        default=2e-4, ge=-1, le=1, description="of the pendulum over the point of contact; below it: negative"
    )
    bandwidth_hz: float = Field(
        default=5.0, gt=0, le=200, description="the spectrum holds up to here, well above both modes"
    )
    seed: int = Field(
        default=0, ge=0, lt=2**31, description="another one: other ground, all other noise as before"
    )

    @property
    def base_tilts(self) -> bool:
        """Whether the base ever tilts."""
        steady = self.tilt_slow_arcsec_per_min, self.tilt_fast_arcsec_per_min
        return self.tilt_rad_per_sqrt_hz > 0 or any(steady) or self.tilt_step_at_s is not None

    @model_validator(mode="after")
    def _file_is_named(self) -> Self:
        if self.model == "file" and self.file is None:
            raise ValueError("ground.model = 'file' needs ground.file, a CSV file of accelerations")
        return self


class SeismometerTruth(SimulationSection, frozen=True):
    """An instrument beside the rig that feels the ground; for seismometer.kind = 'simulated'."""

    rate_hz: float = Field(default=20.0, gt=0, le=1000, description="of its samples")
    counts_per_m_per_s2: float = Field(default=1e9, gt=0, description="what it writes")
    noise_m_per_s2_per_sqrt_hz: float = Field(
        default=1e-10, ge=0, description="of its own: white level, one-sided"
    )
    delay_s: float = Field(default=0.0, ge=0, le=10, description="by which it is late")


class SimulationSettings(SimulationSection, frozen=True):
    """The simulated rig; the same settings give identical frames."""

    seed: int = Field(default=1, ge=0, lt=2**63, description="of all random numbers")
    first_run: int = Field(
        default=0, ge=0, description="number of the first run; runs differ only in their noise"
    )
    max_duration_s: float | None = Field(
        default=None, gt=0, description="the frames end after this simulated time; None: no end"
    )
    real_time: bool = Field(
        default=False,
        description="frames come at the frame rate, and a slow reader loses some; otherwise on demand",
    )
    buffer_frames: int = Field(default=64, ge=1, description="in real time: frames kept for a slow reader")
    contact: ContactTruth = ContactTruth()
    fast: FastModeTruth = FastModeTruth()
    release: ReleaseTruth = ReleaseTruth()
    axes: AxesTruth = AxesTruth()
    optics: OpticsTruth = OpticsTruth()
    reference: ReferenceTruth = ReferenceTruth()
    sensor: SensorTruth = SensorTruth()
    clock: ClockTruth = ClockTruth()
    disturbances: DisturbanceTruth = DisturbanceTruth()
    ground: GroundTruth = GroundTruth()
    seismometer: SeismometerTruth = SeismometerTruth()
    stated: StatedTruth = StatedTruth()

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.reference.relative > 0 and self.optics.ghost_relative > 0:
            raise ValueError(
                "simulation.reference.relative and simulation.optics.ghost_relative: one further spot is "
                "drawn, not two"
            )
        if self.clock.jitter_s * self.clock.frame_rate_hz > 0.4:
            raise ValueError(
                f"clock.jitter_s = {self.clock.jitter_s:g} is more than 0.4 of a frame "
                f"({1 / self.clock.frame_rate_hz:g} s); frames would be out of order"
            )
        return self
