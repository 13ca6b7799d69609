"""Base classes for drivers of GenICam cameras: settings applied in order, pixel format, wiring."""

from typing import Final, TypeVar

from acquisition.camera import (
    PTP_STATUS_FEATURES,
    CameraSettings,
    ColourPlane,
    Edge,
    FeatureValue,
    PixelFormat,
)
from acquisition.cameras.genicam_access import RATE_SWITCH, FeatureAccess, NumericFeature, is_on
from acquisition.cameras.pixel_formats import (
    ExpectedFrames,
    Format,
    format_of,
    names_by_depth,
    preferred_name,
    region_to_plane_px,
    region_to_sensor_px,
)
from acquisition.cameras.reading import DeviceCamera
from processing.errors import DeviceError

_STICKY: Final = ("trigger", "trigger_edge", "exposure_output", "ptp", "binning", "colour_plane")
"""Settings that keep their last requested value if left out."""
_FRAME_TRIGGERS: Final = ("FrameStart", "ExposureStart", "AcquisitionStart")
_EDGES: Final[dict[Edge, str]] = {"rising": "RisingEdge", "falling": "FallingEdge"}
_EXPOSURE_SIGNAL: Final = "ExposureActive"
_PTP: Final = ("PtpEnable", "GevIEEE1588")
_PTP_LATCHES: Final = ("PtpDataSetLatch", "GevIEEE1588DataSetLatch")
_BINNING: Final = ("BinningHorizontal", "BinningVertical")
_DECIMATION: Final = ("DecimationHorizontal", "DecimationVertical")
_AUTOMATIC: Final = (
    "ExposureAuto",
    "GainAuto",
    "BalanceWhiteAuto",
    "BlackLevelAuto",
    "GammaAuto",
    "AutoExposureControl",
)
"""Enumerations that are set to "Off", in this order."""
_NONLINEAR: Final = ("GammaEnable", "GammaEnabled", "LUTEnable", "SharpnessEnable", "SharpeningEnable")
"""Switches that make DN no longer proportional to light; set to false."""


class GenicamFeatures(FeatureAccess):
    """The settings of an open camera, by its features."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self._requested = CameraSettings()

    @property
    def plane(self) -> ColourPlane | None:
        """The colour whose pixels are used, of a sensor with a Bayer mosaic; None: all pixels."""
        return self._requested.colour_plane

    def apply(self, settings: CameraSettings) -> CameraSettings:
        """Apply the settings that are not None, in the order that cameras require; return all as read back.

        Wiring, binning and colour plane that the settings leave out stay as they were requested before.
        """
        self.renew()
        self._switch_off_processing()
        sticky = {name: getattr(self._requested, name) for name in _STICKY if getattr(settings, name) is None}
        requested = settings.model_copy(update=sticky)
        self._set_binning(requested.binning or 1)
        self._wire(requested)
        self._requested, settings = requested, region_to_sensor_px(requested)
        self.set_format(settings.pixel_format)
        self.set_region(settings)
        self._set_times(settings)
        if settings.gain_db is not None:
            self.set_number("gain_db", settings.gain_db)
        for name, value in settings.features.items():
            self.set_feature(name, value)
        self.renew()
        return self._read_back(settings)

    # ---- pixel formats

    def present_format(self) -> Format | None:
        """The present pixel format; None if the rig does not support it."""
        return format_of(self.format_name(), self.plane)

    def pixel_format(self) -> Format:
        """The present pixel format; DeviceError if the rig does not support it."""
        present = self.present_format()
        if present is not None:
            return present
        is_mosaic = not self.plane and format_of(self.format_name(), "red") is not None
        depths = ", ".join(names_by_depth(self.offered_formats(), self.plane))
        raise DeviceError(
            f"{self.name}: pixel format {self.format_name()} is not supported; "
            f"set one of: {depths or '(this camera has none)'}"
            + (", or camera.colour_plane to the laser's colour" if is_mosaic else "")
        )

    def expected_frames(self, *, has_clock: bool) -> ExpectedFrames:
        """The frames of a run with the present settings; DeviceError if their format is not supported."""
        pixel_format = self.pixel_format()
        pixel_format.prepare()
        _, _, width_px, height_px = self.region()
        return ExpectedFrames(pixel_format, width_px, height_px, has_clock, self.plane)

    def choose_usable_format(self) -> None:
        """Keep a supported pixel format (a Bayer mosaic, too), else set the first supported."""
        if format_of(self.format_name(), "red") is None:
            self.set_format(None)

    def set_format(self, depth: PixelFormat | None) -> None:
        """Set a format of this depth, unless the present one has it; None: keep any supported one."""
        offered, present = self.offered_formats(), self.present_format()
        if present is not None and depth in (None, present.depth) and present.name in offered:
            return
        self.put("PixelFormat", preferred_name(self.name, offered, depth, self.plane))

    # ---- wiring

    def select_continuous(self) -> None:
        """Select continuous acquisition, without a trigger unless one was requested."""
        self._choose_if_possible("AcquisitionMode", "Continuous")
        by_feature = any("Trigger" in name for name in self._requested.features)
        if self._requested.trigger is None and not by_feature:
            self.run_freely()

    def run_freely(self) -> None:
        """Switch all triggers off."""
        selectors = self.choices("TriggerSelector") if self.writable("TriggerSelector") else ()
        old_selector = self.read("TriggerSelector") if selectors else None
        for selector in selectors or ("",):
            if selector:
                self.write("TriggerSelector", selector)
            if self.writable("TriggerMode") and self.read("TriggerMode") != "Off":
                self.write("TriggerMode", "Off")
        if old_selector is not None:
            self.write("TriggerSelector", old_selector)

    def latch_clock_state(self) -> None:
        """Have the camera renew its `PTP_STATUS_FEATURES`, which some do on command only."""
        if latch := next(filter(self.writable, _PTP_LATCHES), ""):
            self.write(latch, True)

    def _wire(self, settings: CameraSettings) -> None:
        """Set trigger, exposure output and network clock; without a trigger the camera runs freely."""
        self.run_freely()
        if settings.trigger is not None:
            offered = self.choices("TriggerSelector")
            selector = next((name for name in _FRAME_TRIGGERS if name in offered), None)
            if selector is not None and self.writable("TriggerSelector"):
                self.write("TriggerSelector", selector)
            self._choose("TriggerSource", settings.trigger, "trigger")
            self._choose_if_possible("TriggerActivation", _EDGES[settings.trigger_edge or "rising"])
            self._choose("TriggerMode", "On", "trigger")
        if settings.exposure_output is not None:
            self._choose("LineSelector", settings.exposure_output, "exposure_output")
            self._choose_if_possible("LineMode", "Output")
            self._choose("LineSource", _EXPOSURE_SIGNAL, "exposure_output")
        if settings.ptp is not None:
            switch = next(filter(self.writable, _PTP), "")
            if switch:
                self.write(switch, settings.ptp)
            elif settings.ptp:
                raise DeviceError(f"{self.name}: has no {_PTP[0]}; leave camera.ptp out")

    def _read_wiring(self, settings: CameraSettings) -> dict[str, str | bool]:
        """Trigger, exposure output and network clock as the camera reports them, if `settings` state them."""
        wiring: dict[str, str | bool] = {}
        if settings.trigger is not None and self.read("TriggerMode") == "On":
            wiring["trigger"] = str(self.read("TriggerSource"))
            for edge, name in _EDGES.items():
                if self.read("TriggerActivation") == name:
                    wiring["trigger_edge"] = edge
        if settings.exposure_output is not None and self.read("LineSource") == _EXPOSURE_SIGNAL:
            wiring["exposure_output"] = str(self.read("LineSelector"))
        if settings.ptp is not None:
            wiring["ptp"] = any(is_on(self.read(name)) for name in _PTP)
        return wiring

    # ---- inside

    def _switch_off_processing(self) -> None:
        """Switch off the camera's automatic changes of images, which another program may have left on, and
        let exposure_us set the exposure.
        """
        for name in _AUTOMATIC:
            self._choose_if_possible(name, "Off")
        for name in _NONLINEAR:
            if self.writable(name) and is_on(self.read(name)):
                self.write(name, False)
        self._choose_if_possible("ExposureMode", "Timed")

    def _set_binning(self, binning: int) -> None:
        """Set the binning in both directions, without decimation; 1 undoes another program's binning."""
        requested = dict.fromkeys(_BINNING, binning) | dict.fromkeys(_DECIMATION, 1)
        for name, value in requested.items():
            present = self.read(name)
            if present is None and value == 1:
                continue
            if present is None:
                raise DeviceError(f"{self.name}: has no {name}; leave camera.binning out")
            if float(present) != value and self.writable(name):
                self.write(name, value)
                present = self.read(name)
            if present is None or float(present) != value:
                raise DeviceError(
                    f"{self.name}: {name} = {value} was requested, the camera reports {present}; "
                    "set camera.binning to what it can do"
                )

    def _set_times(self, settings: CameraSettings) -> None:
        """Set exposure and frame rate (not with a trigger), which limit each other, in the possible order."""
        exposure_us, rate_hz = settings.exposure_us, settings.frame_rate_hz
        if settings.trigger is not None:
            rate_hz = None
            if self.writable(switch := self.local_name(RATE_SWITCH)):
                self.put(switch, False)
        present_us = None if exposure_us is None else self.number("exposure_us")
        times: list[tuple[NumericFeature, float | None]] = [
            ("exposure_us", exposure_us),
            ("frame_rate_hz", rate_hz),
        ]
        if exposure_us is not None and present_us is not None and exposure_us > present_us:
            times.reverse()
        for key, value in times:
            if value is not None:
                self.set_number(key, value)

    def _read_back(self, settings: CameraSettings) -> CameraSettings:
        """The camera's present settings, in pixels of the colour plane; None for those that it lacks."""
        # a triggered camera is expected to be triggered at the requested rate
        triggered_hz = min(filter(None, (settings.frame_rate_hz, self.max_rate_hz())), default=None)
        x, y, width_px, height_px = self.region()
        applied = CameraSettings(
            exposure_us=self.number("exposure_us") or None,
            gain_db=self.number("gain_db"),
            frame_rate_hz=self.free_rate_hz() if settings.trigger is None else triggered_hz,
            pixel_format=self.pixel_format().depth,
            binning=None if (binned := self.read(_BINNING[0])) is None else round(float(binned)),
            width_px=width_px,
            height_px=height_px,
            offset_x_px=x,
            offset_y_px=y,
            features={name: self.displayed_value(name) for name in settings.features},
        )
        return region_to_plane_px(
            applied.model_copy(update=self._read_wiring(settings)), settings.colour_plane
        )


_Features = TypeVar("_Features", bound=GenicamFeatures)


class GenicamCamera(DeviceCamera[_Features]):
    """A camera whose features can be read by name."""

    def feature_values(self) -> dict[str, FeatureValue]:
        with self._lock, self._translate_errors():
            features = self._open_device()
            features.latch_clock_state()
            return features.values(self._library_error())

    def feature_value(self, name: str) -> FeatureValue | None:
        with self._lock, self._translate_errors():
            features = self._open_device()
            features.renew()
            if name in PTP_STATUS_FEATURES:
                features.latch_clock_state()
            return features.read(name)
