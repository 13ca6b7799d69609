"""What the controller answers, as values: its state, its latch, the air around it."""

import math
from dataclasses import asdict, dataclass
from enum import StrEnum

from processing.errors import DeviceError
from processing.surroundings import is_possible


class Trip(StrEnum):
    """Why the board switched its outputs off by itself, in the words of its protocol."""

    NONE = "NONE"
    WATCHDOG = "WATCHDOG"
    INTERLOCK = "INTERLOCK"
    OUTPUT = "OUTPUT"
    """The laser's output did not follow what it was set to."""
    POWER = "POWER"
    """The board has started."""


@dataclass(frozen=True, slots=True)
class Latch:
    """A trip that waits on the board for its acknowledgement; `lit` as the laser was when it came."""

    number: int
    cause: Trip
    lit: bool


@dataclass(frozen=True, slots=True)
class ControllerIdentity:
    """Identity of the controller, and the power limit stored on it."""

    serial: str
    firmware: str
    laser_max_w: float


@dataclass(frozen=True, slots=True)
class ControllerStatus:
    """The board's outputs and inputs in its last reply to a heartbeat.

    `latch` is the trip that waits for its acknowledgement, `readback` whether the pin of the laser's relay is
    high, `light_seen` whether a photodiode sees light (None without one), `errors_waiting` the number
    of entries in its error queue.
    """

    uptime_ms: int
    interlock_closed: bool
    laser_on: bool
    laser_power_w: float
    magnet_on: bool
    starter_on: bool
    clamp_closed: bool
    brake_on: bool
    errors_waiting: int
    latch: Latch | None = None
    readback: bool = False
    light_seen: bool | None = None

    @property
    def trip(self) -> Trip:
        """Cause of the latched trip."""
        return Trip.NONE if self.latch is None else self.latch.cause


@dataclass(frozen=True, slots=True)
class AirReading:
    """Temperature, humidity and pressure of the air; NaN without a sensor."""

    temperature_c: float = math.nan
    humidity_percent: float = math.nan
    pressure_pa: float = math.nan

    @property
    def possible(self) -> "AirReading":
        """The same without what no air has: NaN for what a broken sensor or wire says."""
        return AirReading(
            **{name: value if is_possible(name, value) else math.nan for name, value in asdict(self).items()}
        )


def floats_of(values: str, count: int) -> list[float]:
    """So many numbers; raises DeviceError for anything else."""
    try:
        numbers = [float(value) for value in values.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != count:
        raise DeviceError(f"the controller answered {values!r}; {count} numbers were expected")
    return numbers


def status_of(values: str) -> ControllerStatus:
    """The answer to a heartbeat; raises DeviceError for anything else."""
    fields = values.split(",")
    if len(fields) != 14:
        raise DeviceError(f"the controller answered {values!r}; a status of 14 fields was expected")
    uptime_ms, interlock, laser, power_w, magnet, starter, clamp, brake, trip, errors, *latch = fields
    number, lit, readback, light = latch
    try:
        return ControllerStatus(
            latch=Latch(int(number), Trip(trip), _is_one(lit)) if number != "0" else None,
            readback=_is_one(readback),
            light_seen=None if light == "-" else _is_one(light),
            uptime_ms=int(uptime_ms),
            interlock_closed=_is_one(interlock),
            laser_on=_is_one(laser),
            laser_power_w=_power(power_w),
            magnet_on=_is_one(magnet),
            starter_on=_is_one(starter),
            clamp_closed=_is_one(clamp),
            brake_on=_is_one(brake),
            errors_waiting=int(errors),
        )
    except ValueError:
        raise DeviceError(f"the controller answered {values!r}, which is not a status") from None


def _power(field: str) -> float:
    """Raises ValueError for what no power is: NaN would compare with nothing."""
    power_w = float(field)
    if not (math.isfinite(power_w) and power_w >= 0.0):
        raise ValueError(field)
    return power_w


def _is_one(field: str) -> bool:
    """Raises ValueError for anything but 0 and 1: an unknown state must not pass for dark or closed."""
    if field not in ("0", "1"):
        raise ValueError(field)
    return field == "1"
