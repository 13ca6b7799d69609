"""Permission to light lasers: only while frames are processed, and after a trip only by acknowledgement."""

import logging
import time
from collections.abc import Callable
from enum import StrEnum
from typing import Final

import numpy as np

from acquisition.camera import Image
from processing.errors import DeviceError
from rig.control.safety_state import LatchedTrip, SafetyState, TripCause

_EXAMINE_INTERVAL_S = 0.4
_MIN_LIT_RATIO = 0.25
"""Smallest ratio of a spot's contrast to that of the lit one; an output that is stuck on gives 1."""
_MIN_NOISE_RATIO = 8.0
"""Smallest ratio of a spot's contrast to the frame's noise."""
_MAX_PIXELS = 500_000
_NOISE_STEP = 8
"""Background and noise are those of every eighth pixel."""
_HOT_PIXELS = 3
"""Number of brightest pixels that are ignored."""
_MAX_FRAME_DELAY_S: Final = 1.0
"""Longest time for which frames that were exposed earlier still arrive after the laser was switched."""
_MAX_UNSEEN_S: Final = 1.5
"""Longest time for which the spot may be out of sight before the laser is switched off; after a longer one it
may have left the sensor, and its absence confirms nothing."""


class SpotWatch:
    """Detects the laser's spot in frames, by comparison with frames that were taken while the laser was lit.

    The code that reads the camera calls `examine`, the code that knows the laser's state calls the other
    methods; each from any thread.
    """

    def __init__(self, clock_s: Callable[[], float] = time.monotonic) -> None:
        self._clock_s = clock_s
        self._examined_s = -np.inf
        self._contrast_dn = 0.0
        self._noise_dn = 0.0
        # the contrast of the spot while the laser is lit
        self._lit_contrast_dn = 0.0
        self._examined_lit_s = self._seen_lit_s = -np.inf
        self._lit: bool | None = None
        self._switched_s = 0.0
        self.exposure_s = 0.0

    def examine(self, image: Image) -> None:
        """Examine a frame, unless one was examined in the last 0.4 s."""
        now_s = self._clock_s()
        if now_s - self._examined_s < _EXAMINE_INTERVAL_S:
            return
        step = max(int(np.ceil(np.sqrt(image.size / _MAX_PIXELS))), 1)
        pixels = image[::step, ::step].ravel()
        if pixels.size <= _HOT_PIXELS:
            return
        sample = pixels[::_NOISE_STEP].astype(np.float32)
        background_dn = float(np.median(sample))
        peak_dn = float(np.partition(pixels, -_HOT_PIXELS - 1)[-_HOT_PIXELS - 1])
        self._noise_dn = max(1.5 * float(np.median(np.abs(sample - background_dn))), 1.0)
        self._contrast_dn, self._examined_s = peak_dn - background_dn, now_s

    def note_laser(self, lit: bool) -> None:
        """Note whether the laser reports now that it is lit."""
        now_s = self._clock_s()
        if lit is not self._lit:
            self._lit, self._switched_s = lit, now_s
            if lit:
                self._lit_contrast_dn = 0.0
        if lit and self._is_settled and self._contrast_dn > _MIN_NOISE_RATIO * self._noise_dn:
            self._lit_contrast_dn = max(self._lit_contrast_dn, self._contrast_dn)
        if lit:
            self._examined_lit_s = self._examined_s
            if self.visible:
                self._seen_lit_s = self._examined_s

    @property
    def age_s(self) -> float:
        """Time since the newest frame that was examined; infinite without one."""
        return self._clock_s() - self._examined_s

    @property
    def visible(self) -> bool | None:
        """Whether the spot is in the newest frame; None if no frame showed it while the laser was lit."""
        if not self._lit_contrast_dn:
            return None
        lit_dn, noise_dn = self._lit_contrast_dn, self._noise_dn
        return self._contrast_dn >= max(_MIN_LIT_RATIO * lit_dn, _MIN_NOISE_RATIO * noise_dn)

    @property
    def contradicts(self) -> bool:
        """Whether the laser reports that it is off, and frames contradict it: they still show the spot."""
        return self._lit is False and self._is_settled and self.visible is True

    @property
    def confirms(self) -> bool:
        """Whether the laser reports that it is off, and frames confirm it: the spot is gone."""
        was_seen = self._examined_lit_s - self._seen_lit_s <= _MAX_UNSEEN_S
        return self._lit is False and self._is_settled and was_seen and self.visible is False

    @property
    def _is_settled(self) -> bool:
        return self._examined_s - self._switched_s > _MAX_FRAME_DELAY_S + 2.0 * self.exposure_s


_log = logging.getLogger(__name__)


class Stage(StrEnum):
    """Stages of the program, which must make progress while a laser is lit."""

    CAMERA = "the camera"
    PROCESSING = "the processing of frames"
    RECORDER = "the writing of the record"


class Interlock(StrEnum):
    """The interlocks, by the device that has them."""

    CONTROLLER = "controller"
    LASER = "laser"

    @property
    def text(self) -> str:
        """The interlock in words."""
        return f"the {self.value}'s interlock"

    @property
    def opened_text(self) -> str:
        """The reason of a trip after this interlock opened."""
        return f"the interlock of the {self.value} opened"


LONGEST_PAUSE_S: Final = {Stage.CAMERA: 5.0, Stage.PROCESSING: 5.0, Stage.RECORDER: 30.0}
"""Longest pause of a stage; after a longer one it has stalled. A slow disk is allowed more, because frames
wait for it in memory, and once they cannot, the processing stalls, too.
"""


class LightRefused(DeviceError):
    """The laser stays dark: a trip is latched, or something else refuses the light."""


_MAX_PRESS_CHECK_INTERVAL_S: Final = 5.0
"""Longest time between two checks for presses of LIGHT OFF; after a longer one light is refused."""
PROCESSING_ENDED: Final = "no frames are processed any more"
NEEDS_REQUEST: Final = "the trip is acknowledged; the laser stays off until a person asks for light"


class LightPermit:
    """Permission to light lasers: refused while a trip is latched, and once a stage of the program stalls.

    The devices' threads read `refusal` before each heartbeat, and `refusal_to_light` immediately before they
    light a laser. The stages report their progress; camera and processing are watched from `begin` on, the
    recorder from its first report until `note_end`.

    All methods may be called from any thread; all but `trip` and `look_for_presses`, which write the rig's
    file, only set plain values. `on_trip` is called with each trip, and whether it happened now, in the
    thread that detected it.
    """

    def __init__(
        self,
        clock_s: Callable[[], float] = time.monotonic,
        state: SafetyState | None = None,
        on_trip: Callable[[LatchedTrip, bool], None] = lambda _trip, _now: None,
    ) -> None:
        self._clock_s = clock_s
        self._state = state or SafetyState()
        self._on_trip = on_trip
        self._progress_s: dict[Stage, float] = {}
        self._expects_light = self._ended = False
        self._final_refusal = ""
        self._needs_request = False
        self._press_check_s: float | None = None
        self.spot = SpotWatch(clock_s)

    def begin(self) -> None:
        """Note that a laser is about to be lit: from now on camera and processing must make progress."""
        now_s = self._clock_s()
        self._progress_s |= {Stage.CAMERA: now_s, Stage.PROCESSING: now_s}
        self._expects_light, self._ended = True, False

    def end(self) -> None:
        """Note that the lasers go dark: no stage needs to make progress, and waiting requests are refused."""
        self._expects_light, self._ended = False, True

    def note_progress(self, stage: Stage) -> None:
        """Note that a stage has made progress."""
        self._progress_s[stage] = self._clock_s()

    def frame_read(self, image: Image) -> None:
        """Note that the camera has delivered a frame, and examine it for the laser's spot."""
        self.note_progress(Stage.CAMERA)
        self.spot.examine(image)

    def note_end(self, stage: Stage) -> None:
        """Note that a stage has ended regularly."""
        self._progress_s.pop(stage, None)

    def withdraw(self, reason: str) -> None:
        """Refuse the light for good, for example after an interrupt; the first reason is kept."""
        self._final_refusal = self._final_refusal or reason

    def trip(self, cause: TripCause, why: str) -> None:
        """Latch a cause, lit or dark: the light is refused until a person has acknowledged it.

        Raises nothing, so that the caller goes on to switch off the light. If the state cannot be written,
        that is logged, and the trip is latched for this program alone.
        """
        self._latch(cause, why, now=True)

    def latch_found(self, cause: TripCause, why: str) -> None:
        """Latch a trip reported on opening, unless its cause is latched already: it may be the same trip."""
        if (trip := self.latched) is None or trip.cause is not cause:
            self._latch(cause, why, now=False)

    def _latch(self, cause: TripCause, why: str, now: bool) -> None:
        self._needs_request = True
        try:
            self._state.latch(cause, why, self._expects_light)
        except DeviceError as error:
            _log.error("%s", error)
        # light may have been asked for meanwhile by a person who did not know of the trip
        self._needs_request = True
        if (trip := self.latched) is not None:
            self._on_trip(trip, now)

    def look_for_presses(self) -> bool:
        """Latch a press of LIGHT OFF that another program noted beside the rig's state; True on one.

        Raises nothing. Waits for the disk; after the first call light is refused unless calls follow.
        """
        if self._state.presses is None:
            return False
        earlier = self.latched
        try:
            trip = self._state.take_press(self._expects_light)
        except DeviceError as error:
            _log.error("%s", error)
            trip = self.latched
        self._press_check_s = self._clock_s()
        if trip is None:
            return False
        self._needs_request = True
        if earlier is None or trip.number != earlier.number:
            self._on_trip(trip, True)
        return True

    def stop_press_checks(self) -> None:
        """Note that presses are not checked any more, because the devices are being closed."""
        self._press_check_s = None

    @property
    def latched(self) -> LatchedTrip | None:
        """The trip that waits for its acknowledgement."""
        return self._state.trip

    @property
    def needs_request(self) -> bool:
        """Whether no person has asked for light since the last trip, acknowledged or not."""
        return self._needs_request

    def request_light(self) -> None:
        """Note that a person asks for light; ignored while a trip is latched, and undone by a later trip."""
        if self.latched is None:
            self._needs_request = False

    @property
    def expects_light(self) -> bool:
        """Whether a laser is, or is about to be, lit."""
        return self._expects_light

    @property
    def refusal(self) -> str:
        """The reason why no laser may be lit; empty while lasers may be lit."""
        trip, check_s = self.latched, self._press_check_s
        late = check_s is not None and self._clock_s() - check_s > _MAX_PRESS_CHECK_INTERVAL_S
        unheard = "LIGHT OFF would not be heard: the disk of the rig's state hangs" if late else ""
        return self._final_refusal or ("" if trip is None else trip.text) or self.stalled or unheard

    @property
    def refusal_to_light(self) -> str:
        """The reason why no laser may be lit now, including a press of LIGHT OFF that was not taken over yet.

        After a trip, a person must not only acknowledge it but also ask for light again.
        """
        self.look_for_presses()
        request = NEEDS_REQUEST if self._needs_request else ""
        return self.refusal or self._state.problem or request or (PROCESSING_ENDED if self._ended else "")

    @property
    def paused_s(self) -> float:
        """Time since the last progress of any stage; 0 before the first."""
        return self._clock_s() - max(self._progress_s.values(), default=self._clock_s())

    @property
    def stalled(self) -> str:
        """The stage that has stalled, in words; empty while all make progress, and while nothing is lit."""
        if not self._expects_light:
            return ""
        now_s = self._clock_s()
        for stage, progress_s in tuple(self._progress_s.items()):
            if now_s - progress_s > LONGEST_PAUSE_S[stage]:
                return f"{stage} has stalled"
        return ""
