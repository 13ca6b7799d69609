"""The only file that accesses hardware: a Raspberry Pi Pico with the rig's usual wiring.

Another board needs another file with the same names. Pins (all outputs active high, each with
a pull-down resistor, so that all outputs are off while the board is in reset):

    GP2 laser, PWM into the driver's modulation input     GP3 laser enable relay (external interlock)
    GP4 holding magnet   GP5 starter   GP6 clamp   GP7 brake
    GP8 interlock loop to ground, closed = low            GP9 maintenance jumper to ground
    GP10 exposure output of the camera, high while it exposes
    GP11 laser gate: the driver's digital modulation, high lets light out
    GP12 button to ground that acknowledges a trip
    GP13 comparator of a photodiode in the laser's stray light, high in light ("photodiode" in limits.json)
    GP16 SDA, GP17 SCL: BME280
"""

import json
import os
import select
import sys
import time

import machine  # type: ignore[import-not-found]
import micropython  # type: ignore[import-not-found]
from bme280 import Bme280  # type: ignore[import-not-found]
from pulse import Pulses  # type: ignore[import-not-found]

LIMITS_FILE = "limits.json"
LATCH_FILE = "latch.json"
PWM_HZ = 100_000


class Board:
    """Pins, clock and bytes for `core.Firmware`."""

    def __init__(self) -> None:
        self._laser = machine.PWM(machine.Pin(2), freq=PWM_HZ, duty_u16=0)
        self._enable = machine.Pin(3, machine.Pin.OUT, value=0)
        self._exposure = machine.Pin(10, machine.Pin.IN, machine.Pin.PULL_DOWN)
        self._gate = machine.Pin(11, machine.Pin.OUT, value=0)
        self._pulses: Pulses | None = None
        self._pulse_us = (0.0, 0.0)
        self._magnet = machine.Pin(4, machine.Pin.OUT, value=0)
        self._starter = machine.Pin(5, machine.Pin.OUT, value=0)
        self._clamp = machine.Pin(6, machine.Pin.OUT, value=0)
        self._brake = machine.Pin(7, machine.Pin.OUT, value=0)
        self._interlock = machine.Pin(8, machine.Pin.IN, machine.Pin.PULL_UP)
        self._opened = False
        self._interlock.irq(self._note_opening, machine.Pin.IRQ_RISING)
        self._maintenance = machine.Pin(9, machine.Pin.IN, machine.Pin.PULL_UP)
        self._button = machine.Pin(12, machine.Pin.IN, machine.Pin.PULL_UP)
        self._light = machine.Pin(13, machine.Pin.IN, machine.Pin.PULL_DOWN)
        self._has_photodiode = False
        self.serial = machine.unique_id().hex().upper()
        self.clamp_closed = False
        self.latches_at_start = True
        self.fault = ""
        # without a valid limits.json the limit is 0, so that the laser stays off
        self.laser_max_w = 0.0
        self._full_scale_w = 1.0
        self.starter_max_ms = 5000
        self.brake_max_ms = 60000
        self._read_limits()
        self._i2c = machine.I2C(0, sda=machine.Pin(16), scl=machine.Pin(17), freq=400_000)
        self._sensor = None
        try:
            self._sensor = Bme280(self._i2c)
        except OSError:
            self.fault = self.fault or "no BME280 on I2C 0"
        self._poll = select.poll()
        self._poll.register(sys.stdin, select.POLLIN)
        self._watchdog = None

    def _read_limits(self) -> None:
        try:
            with open(LIMITS_FILE) as file:
                limits = json.load(file)
            full_scale_w = float(limits["laser_full_scale_w"])
            max_w = float(limits["laser_max_w"])
            starter_max_ms, brake_max_ms = int(limits["starter_max_ms"]), int(limits["brake_max_ms"])
        except (OSError, ValueError, KeyError, TypeError):
            self.fault = LIMITS_FILE + " is missing or wrong; the laser stays off"
            return
        if not 0.0 <= max_w <= full_scale_w or full_scale_w == 0.0:
            self.fault = (
                LIMITS_FILE + ": laser_max_w is not within 0 and laser_full_scale_w; the laser stays off"
            )
            return
        self.laser_max_w, self._full_scale_w = max_w, full_scale_w
        self.starter_max_ms, self.brake_max_ms = starter_max_ms, brake_max_ms
        self._has_photodiode = limits.get("photodiode") is True

    def maintenance(self) -> bool:
        """True if the jumper is set: the program ends, and the board shows MicroPython's prompt."""
        if not self._maintenance.value():
            return True
        # no byte on the line may act as Ctrl-C; a loop that hangs must not leave the laser on
        micropython.kbd_intr(-1)
        self._watchdog = machine.WDT(timeout=1000)
        return False

    def set_laser(self, on: bool, power_w: float) -> None:
        """Close or open the enable relay and set the power, rounded down so that it is not exceeded.

        The relay also closes at 0 W, for a laser that has its own power control.
        """
        if on:
            self._laser.duty_u16(int(65535 * power_w / self._full_scale_w))
            self._open_gate()
            self._enable.value(1)
        else:
            self._enable.value(0)
            self._laser.duty_u16(0)
            self._close_gate()

    def set_pulse(self, delay_us: float, width_us: float) -> None:
        """Set the pulse after each exposure's beginning, from the next time on when the laser is switched on.

        With width 0 there are no pulses, and light all the time.
        """
        self._pulse_us = (delay_us, width_us)

    def _open_gate(self) -> None:
        delay_us, width_us = self._pulse_us
        if not width_us:
            self._gate.value(1)
        elif self._pulses is None:
            self._pulses = Pulses(self._exposure, self._gate, delay_us, width_us)

    def _close_gate(self) -> None:
        if self._pulses is not None:
            self._pulses.end()
            self._pulses = None
        # this also returns the pin from the state machine of the pulses
        self._gate.init(machine.Pin.OUT, value=0)

    def laser_enabled(self) -> bool:
        """True if the enable relay's pin is high, as read back from the pin itself."""
        return bool(self._enable.value())

    def set_magnet(self, on: bool) -> None:
        """Energise the holding magnet."""
        self._magnet.value(on)

    def set_starter(self, on: bool) -> None:
        """Switch the starter, which tilts the pendulum."""
        self._starter.value(on)

    def set_clamp(self, on: bool) -> None:
        """Close the clamp."""
        self._clamp.value(on)

    def set_brake(self, on: bool) -> None:
        """Apply the eddy-current brake."""
        self._brake.value(on)

    def all_off(self) -> None:
        """All outputs off, except the clamp, which does not move."""
        self.set_laser(False, 0.0)
        for pin in (self._magnet, self._starter, self._brake):
            pin.value(0)

    def interlock_closed(self) -> bool:
        """True if the loop pulls the pin low."""
        return not self._interlock.value()

    def _note_opening(self, _: object) -> None:
        self._opened = True

    def interlock_opened(self) -> bool:
        """True once after the loop has opened, however short."""
        opened, self._opened = self._opened, False
        return opened

    def button_pressed(self) -> bool:
        """True while the button is held."""
        return not self._button.value()

    def light_seen(self) -> "bool | None":
        """Whether the photodiode sees light; None without one."""
        return bool(self._light.value()) if self._has_photodiode else None

    def stored_latch(self) -> tuple[int, str]:
        """Number and cause of the last trip, cause NONE once acknowledged; a damaged file counts as POWER."""
        try:
            with open(LATCH_FILE) as file:
                number, cause = json.load(file)
            return int(number), str(cause)
        except (OSError, ValueError, TypeError):
            return 0, "POWER"

    def store_latch(self, number: int, cause: str) -> None:
        """Store number and cause so that they survive a reset: a new file replaces the old one at once."""
        try:
            with open(LATCH_FILE + ".new", "w") as file:
                json.dump([number, cause], file)
            os.rename(LATCH_FILE + ".new", LATCH_FILE)
        except OSError:
            # where the flash is full, the next start latches POWER in any case
            self.fault = LATCH_FILE + " cannot be written"

    def environment(self) -> tuple[float, float, float]:
        """Degrees Celsius, per cent of relative humidity and Pa; OSError without a sensor."""
        if self._sensor is None:
            # it may have been plugged in since
            self._sensor = Bme280(self._i2c)
        return self._sensor.read()  # type: ignore[no-any-return]

    def ticks_ms(self) -> int:
        """The board's clock in ms."""
        return time.ticks_ms()  # type: ignore[attr-defined, no-any-return]

    def ticks_diff(self, later: int, earlier: int) -> int:
        """Difference of two clock readings in ms; the clock overflows."""
        return time.ticks_diff(later, earlier)  # type: ignore[attr-defined, no-any-return]

    def ticks_add(self, start: int, delta_ms: int) -> int:
        """A clock reading later by delta_ms."""
        return time.ticks_add(start, delta_ms)  # type: ignore[attr-defined, no-any-return]

    def read(self) -> bytes:
        """Received bytes, without waiting; b"" if there are none."""
        data = b""
        while len(data) < 64 and self._poll.poll(0):
            byte = sys.stdin.buffer.read(1)
            if not byte:
                break
            data += byte
        return data

    def write(self, data: bytes) -> None:
        """Send; the USB stack discards the bytes if no host reads them."""
        sys.stdout.buffer.write(data)

    def idle(self) -> None:
        """Called once per turn of the loop; the hardware watchdog resets a board whose loop hangs."""
        if self._watchdog is not None:
            self._watchdog.feed()

    def restart(self) -> None:
        """Reset the board."""
        machine.reset()
