"""Whether lasers may be lit: only while frames are processed, and after a trip only by a person's leave."""

import logging
import time
from collections.abc import Callable
from enum import StrEnum
from typing import Final

import numpy as np

from acquisition.camera import Image
from processing.errors import DeviceError
from rig.control.safety_state import LatchedTrip, SafetyState, TripCause

_EVERY_S = 0.4
_OF_LIT = 0.25
"""Part of the spot's contrast that still counts as the spot: a stuck output gives all of it."""
_LEAST_NOISES = 8.0
"""Of the frame's own noise: what a frame needs to be one with a spot at all."""
_MOST_PIXELS = 500_000
_OF_THEM = 8
"""One pixel of so many tells of background and noise."""
_HOT_PIXELS = 3
_SETTLED_S: Final = 1.0
"""After the laser was told off frames on their way still show it."""
_BEFORE_S: Final = 1.5
"""A spot that was seen no later before the laser was told off may have left the sensor instead."""


class SpotSeen:
    """Compares frames with those that were seen while the laser was lit.

    `frame` is called by who reads the camera, the others by who knows the laser; each from any thread.
    """

    def __init__(self, clock_s: Callable[[], float] = time.monotonic) -> None:
        self._clock_s = clock_s
        self._sampled_s = -np.inf
        self._contrast_dn = 0.0
        self._noise_dn = 0.0
        self._lit_dn = 0.0
        self._looked_s = self._seen_lit_s = -np.inf
        self._lit: bool | None = None
        self._since_s = 0.0
        self.exposure_s = 0.0

    def frame(self, image: Image) -> None:
        """A frame was read; it is looked at if none was for a while."""
        now_s = self._clock_s()
        if now_s - self._sampled_s < _EVERY_S:
            return
        step = max(int(np.ceil(np.sqrt(image.size / _MOST_PIXELS))), 1)
        some = image[::step, ::step].ravel()
        if some.size <= _HOT_PIXELS:
            return
        few = some[::_OF_THEM].astype(np.float32)
        middle = float(np.median(few))
        peak = float(np.partition(some, -_HOT_PIXELS - 1)[-_HOT_PIXELS - 1])
        self._noise_dn = max(1.5 * float(np.median(np.abs(few - middle))), 1.0)
        self._contrast_dn, self._sampled_s = peak - middle, now_s

    def told(self, lit: bool) -> None:
        """What the laser says of itself now."""
        now_s = self._clock_s()
        if lit is not self._lit:
            self._lit, self._since_s = lit, now_s
            if lit:
                self._lit_dn = 0.0
        if lit and self._is_settled and self._contrast_dn > _LEAST_NOISES * self._noise_dn:
            self._lit_dn = max(self._lit_dn, self._contrast_dn)
        if lit:
            self._looked_s = self._sampled_s
            if self.seen:
                self._seen_lit_s = self._sampled_s

    @property
    def age_s(self) -> float:
        """Time since the newest frame that was looked at; infinite without one."""
        return self._clock_s() - self._sampled_s

    @property
    def seen(self) -> bool | None:
        """Whether the spot is in the newest frame; None where it never was while the laser was lit."""
        if not self._lit_dn:
            return None
        return self._contrast_dn >= max(_OF_LIT * self._lit_dn, _LEAST_NOISES * self._noise_dn)

    @property
    def disagrees(self) -> bool:
        """Whether the laser says that it is off, and later frames show it lit."""
        return self._lit is False and self._is_settled and self.seen is True

    @property
    def agrees(self) -> bool:
        """Whether the laser says that it is off, and later frames show no spot that was there until then."""
        was_seen = self._looked_s - self._seen_lit_s <= _BEFORE_S
        return self._lit is False and self._is_settled and was_seen and self.seen is False

    @property
    def _is_settled(self) -> bool:
        return self._sampled_s - self._since_s > _SETTLED_S + 2.0 * self.exposure_s


_log = logging.getLogger(__name__)


class Stage(StrEnum):
    """What must go on while a laser is lit."""

    CAMERA = "the camera"
    PROCESSING = "the processing of frames"
    RECORDER = "the writing of the record"


class Interlock(StrEnum):
    """Whose interlock it is."""

    CONTROLLER = "controller"
    LASER = "laser"

    @property
    def text(self) -> str:
        return f"the {self.value}'s interlock"

    @property
    def opened_text(self) -> str:
        """That it opened, in words."""
        return f"the interlock of the {self.value} opened"


LONGEST_PAUSE_S: Final = {Stage.CAMERA: 5.0, Stage.PROCESSING: 5.0, Stage.RECORDER: 30.0}
"""A stage that pauses for longer has stalled. A slow disk is allowed more: frames wait for it in memory,
and once they cannot, the processing stalls too."""


class LightRefused(DeviceError):
    """The laser stays dark: a trip is latched, or something else refuses the light."""


_UNHEARD_S: Final = 5.0
"""So long nobody may have looked whether LIGHT OFF was pressed: as for a stage that has stalled."""
OVER: Final = "no frames are processed any more"
TO_BE_ASKED: Final = "the trip is acknowledged; the laser stays off until a person asks for light"


class LightPermit:
    """Whether lasers may be lit: the rig's latch, and a dead man's switch; a stage that stalls refuses it.

    The threads of the devices ask for `refusal` before each heartbeat, and for `refusal_to_light` at the last
    moment before they light. The stages report their progress;
    camera and processing are watched from `begin` on, the recorder from its first report until `ended`.
    All methods may be called from any thread; all but `trip` and `look_for_presses`, which write the rig's
    file, only set plain values. `tripped` is told of each trip, and whether it happened now, in the thread
    that saw it.
    """

    def __init__(
        self,
        clock_s: Callable[[], float] = time.monotonic,
        state: SafetyState | None = None,
        tripped: Callable[[LatchedTrip, bool], None] = lambda _trip, _now: None,
    ) -> None:
        self._clock_s = clock_s
        self._state = state or SafetyState()
        self._tripped = tripped
        self._moved_s: dict[Stage, float] = {}
        self._begun = self._over = False
        self._withdrawn = ""
        self._asked_before_trip = False
        self._looked_s: float | None = None
        self.spot = SpotSeen(clock_s)

    def begin(self) -> None:
        """A laser is about to be lit: from now on camera and processing must move."""
        now_s = self._clock_s()
        self._moved_s |= {Stage.CAMERA: now_s, Stage.PROCESSING: now_s}
        self._begun, self._over = True, False

    def end(self) -> None:
        """The lasers go dark, and nothing needs to move; what still waits to be lit is refused."""
        self._begun, self._over = False, True

    def moved(self, stage: Stage) -> None:
        """A stage has done something."""
        self._moved_s[stage] = self._clock_s()

    def frame_read(self, image: Image) -> None:
        """The camera has delivered a frame; what it shows is evidence of the light."""
        self.moved(Stage.CAMERA)
        self.spot.frame(image)

    def ended(self, stage: Stage) -> None:
        """A stage has come to its regular end."""
        self._moved_s.pop(stage, None)

    def withdraw(self, why: str) -> None:
        """Refuse the light for good, for example after an interrupt; the first reason is kept."""
        self._withdrawn = self._withdrawn or why

    def trip(self, cause: TripCause, why: str) -> None:
        """Latch a cause, lit or dark: the light is refused until a person has acknowledged it.

        Raises nothing: who has seen it goes on darkening. A state that cannot be written is logged, and holds
        for this program.
        """
        self._latch(cause, why, now=True)

    def found(self, cause: TripCause, why: str) -> None:
        """Latch what a device says on opening, unless it is latched already: it may be the same trip."""
        if (trip := self.latched) is None or trip.cause is not cause:
            self._latch(cause, why, now=False)

    def _latch(self, cause: TripCause, why: str, now: bool) -> None:
        self._asked_before_trip = True
        try:
            self._state.latch(cause, why, self._begun)
        except DeviceError as error:
            _log.error("%s", error)
        # somebody may have asked meanwhile, who has not seen it
        self._asked_before_trip = True
        if (trip := self.latched) is not None:
            self._tripped(trip, now)

    def look_for_presses(self) -> bool:
        """Latch a press of LIGHT OFF that somebody has left beside the rig's state; whether there was one.

        Raises nothing. Waits for the disk; from the first call on the light is refused where none follows.
        """
        if self._state.presses is None:
            return False
        before = self.latched
        try:
            trip = self._state.take_press(self._begun)
        except DeviceError as error:
            _log.error("%s", error)
            trip = self.latched
        self._looked_s = self._clock_s()
        if trip is None:
            return False
        self._asked_before_trip = True
        if before is None or trip.number != before.number:
            self._tripped(trip, True)
        return True

    def stop_looking(self) -> None:
        """Nobody looks for presses any more: the devices are being closed."""
        self._looked_s = None

    @property
    def latched(self) -> LatchedTrip | None:
        """The trip that waits for its acknowledgement."""
        return self._state.trip

    @property
    def waits_for_asking(self) -> bool:
        """Whether a trip was not followed by a person's asking for light, acknowledged or not."""
        return self._asked_before_trip

    def ask(self) -> None:
        """A person asks for light, which a trip that comes later outdates; nothing while one is latched."""
        if self.latched is None:
            self._asked_before_trip = False

    @property
    def begun(self) -> bool:
        """Whether a laser is, or is about to be, lit."""
        return self._begun

    @property
    def refusal(self) -> str:
        """Why no laser may be lit; empty while it may."""
        trip = self.latched
        return self._withdrawn or ("" if trip is None else trip.text) or self.stalled or self._deaf

    @property
    def _deaf(self) -> str:
        looked_s = self._looked_s
        deaf = looked_s is not None and self._clock_s() - looked_s > _UNHEARD_S
        return "nobody hears of LIGHT OFF: the disk of the rig's state hangs" if deaf else ""

    @property
    def refusal_to_light(self) -> str:
        """Why no laser may be lit now, read immediately before: also a press that nobody has taken over yet.

        A trip that came since light was asked for needs more than its acknowledgement.
        """
        self.look_for_presses()
        to_be_asked = TO_BE_ASKED if self._asked_before_trip else ""
        return self.refusal or self._state.problem or to_be_asked or (OVER if self._over else "")

    @property
    def paused_s(self) -> float:
        """Time since any stage has moved; 0 before the first has."""
        return self._clock_s() - max(self._moved_s.values(), default=self._clock_s())

    @property
    def stalled(self) -> str:
        """Which stage has stalled; empty while all move, and while nothing is lit."""
        if not self._begun:
            return ""
        now_s = self._clock_s()
        for stage, moved_s in tuple(self._moved_s.items()):
            if now_s - moved_s > LONGEST_PAUSE_S[stage]:
                return f"{stage} has stalled"
        return ""
