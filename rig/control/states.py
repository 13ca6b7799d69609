"""States of laser and controller as values, for threads, displays and the desk; their texts are made here."""

from dataclasses import dataclass
from enum import StrEnum

from rig.control.controller import ControllerStatus
from rig.control.service import ControlState


class Light(StrEnum):
    """Whether the laser emits, as far as is known."""

    ON = "on"
    OFF = "off"
    INTERLOCK_OPEN = "off, its interlock is open"
    SILENT = "does not answer"
    CONTROLLER_SILENT = "the controller does not answer"


@dataclass(frozen=True, slots=True)
class LaserNow:
    """The laser's last known state; `set_w` is what the controller was set to, the others are measured."""

    light: Light
    set_w: float | None = None
    power_w: float | None = None
    current_a: float | None = None

    @property
    def on(self) -> bool:
        """False also if it does not answer."""
        return self.light is Light.ON

    @property
    def text(self) -> str:
        """`on, 0.5 mW`."""
        if not self.on:
            return self.light
        shown = "on" if self.set_w is None else f"on, {self.set_w * 1e3:g} mW"
        shown += f", {self.power_w * 1e3:.3g} mW" if self.power_w else ""
        return shown + (f", {self.current_a * 1e3:.4g} mA" if self.current_a else "")


@dataclass(frozen=True, slots=True)
class DevicesNow:
    """The last known state of laser and controller, None for what the program does not control.

    `status` is None, too, while the controller does not answer.
    """

    laser: LaserNow | None = None
    controller: ControlState | None = None
    status: ControllerStatus | None = None

    @property
    def interlock_closed(self) -> bool:
        """The controller answers, and says so."""
        return self.status is not None and self.status.interlock_closed

    @property
    def text(self) -> str:
        """`laser on, brake, interlock closed`; empty without devices."""
        words = []
        if self.laser is not None:
            words.append("laser on" if self.laser.on else f"laser {self.laser.text}")
        if self.controller is None:
            return ", ".join(words)
        if self.status is None:
            return str(self.controller)
        outputs = {
            "magnet": self.status.magnet_on,
            "starter": self.status.starter_on,
            "clamp": self.status.clamp_closed,
            "brake": self.status.brake_on,
        }
        words += [name for name, on in outputs.items() if on]
        return ", ".join([*words, "interlock closed" if self.interlock_closed else "INTERLOCK OPEN"])
