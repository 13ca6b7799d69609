"""States of laser and controller as values, with their texts, for threads, displays and the desk."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from functools import cache
from typing import Any, Final

from pydantic import TypeAdapter

from rig.control.protocol import ControllerStatus
from rig.control.safety_state import LatchedTrip
from rig.control.service import ControlState

STALE_S: Final = 2.0
"""Minimum age of a state that counts as unknown."""


class Light(StrEnum):
    """Whether the laser emits, as far as is known."""

    ON = "on"
    OFF = "off"
    INTERLOCK_OPEN = "off, its interlock is open"
    SILENT = "does not answer"
    CONTROLLER_SILENT = "the controller does not answer"
    UNKNOWN = "unknown, nothing was heard for more than 2 s"
    DISAGREES = "commanded off, but its output or its light is seen to be on"


@dataclass(frozen=True, slots=True)
class LaserReport:
    """The laser's last report."""

    light: Light
    set_w: float | None = None
    """Power that is set at the controller; None for a laser with a port of its own."""
    power_w: float | None = None
    """Measured optical power."""
    current_a: float | None = None
    """Measured diode current."""
    age_s: float = 0.0

    @property
    def on(self) -> bool:
        """Whether the laser is known to be on; False also if it does not answer."""
        return self.light is Light.ON

    @property
    def text(self) -> str:
        """The state in words, such as `on, 0.5 mW`."""
        if not self.on:
            return self.light
        text = "on" if self.set_w is None else f"on, {self.set_w * 1e3:g} mW"
        text += f", {self.power_w * 1e3:.3g} mW" if self.power_w else ""
        return text + (f", {self.current_a * 1e3:.4g} mA" if self.current_a else "")


class Loop(StrEnum):
    """State of all readable interlock loops together: open if one of them is, unknown if one is not known."""

    CLOSED = "closed"
    OPEN = "open"
    UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True)
class SafetyNow:
    """The state of laser, controller and interlock; states older than `STALE_S` are unknown.

    Ages are in s, and infinite for a device that never reported.
    """

    trip: LatchedTrip | None = None
    """The trip that waits for an acknowledgement."""
    refusal: str = ""
    """The reason why no light is allowed; empty while it is."""
    light: Light = Light.UNKNOWN
    light_age_s: float = math.inf
    interlock: Loop = Loop.UNKNOWN
    interlock_age_s: float = math.inf
    spot_visible: bool | None = None
    """Whether the camera's frames show the laser's spot; None where no frames are examined."""
    spot_age_s: float = math.inf
    needs_request: bool = False
    """Whether a person must ask for light before there is any."""
    laser: LaserReport | None = None
    """Report of the laser's device; None without a laser that the program controls."""
    controller: ControlState | None = None
    """State of the connection; None without a controller."""
    status: ControllerStatus | None = None
    """State of the board; None while it does not answer."""

    @property
    def controller_interlock_closed(self) -> bool:
        """Whether the controller answers and reports a closed interlock."""
        return self.status is not None and self.status.interlock_closed

    @property
    def devices_text(self) -> str:
        """Laser and controller in words, such as `laser on, brake, interlock closed`; empty without them."""
        texts = []
        if self.laser is not None:
            texts.append("laser on" if self.laser.on else f"laser {self.laser.text}")
        if self.controller is None:
            return ", ".join(texts)
        if self.status is None:
            return str(self.controller)
        outputs = {
            "magnet": self.status.magnet_on,
            "starter": self.status.starter_on,
            "clamp": self.status.clamp_closed,
            "brake": self.status.brake_on,
        }
        texts += [name for name, on in outputs.items() if on]
        closed = self.controller_interlock_closed
        return ", ".join([*texts, "interlock closed" if closed else "INTERLOCK OPEN"])

    @classmethod
    def from_news(cls, values: Mapping[str, Any]) -> "SafetyNow":
        """The state from the plain values of a session's answer, in which infinite ages are null."""
        return _adapter().validate_python(_without_nulls(values))


def _without_nulls(values: Mapping[str, Any]) -> dict[str, Any]:
    """The values that are not null, at all depths."""
    return {
        key: _without_nulls(value) if isinstance(value, Mapping) else value
        for key, value in values.items()
        if value is not None
    }


@cache
def _adapter() -> TypeAdapter[SafetyNow]:
    """The adapter, built once because that takes many times as long as reading with it."""
    return TypeAdapter(SafetyNow)
