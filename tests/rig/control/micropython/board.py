"""The test board: outputs are logged, inputs and bytes come from the bridge (MicroPython only)."""

import time
from binascii import hexlify, unhexlify

import wires


class ResetWanted(Exception):
    """The test pulled the reset pin."""


class Board:
    """What `core.Firmware` needs of a board; see the firmware's own board.py."""

    def __init__(self):
        self.serial = "TEST0001"
        self.fault = ""
        self.clamp_closed = False
        self.latches_at_start = False
        self.laser_max_w = 0.001
        self.starter_max_ms = 5000
        self.brake_max_ms = 300
        self._turning = False
        self._enabled = False
        self._log("boot 1")

    def _log(self, line):
        wires.log(str(time.ticks_ms()) + " " + line)

    def maintenance(self):
        return False

    def set_laser(self, on, power_w):
        self._enabled = on
        self._log(f"laser {int(on)} {power_w:.9g}")

    def laser_enabled(self):
        return (self._enabled and not wires.stuck()) or wires.stuckOn()

    def set_pulse(self, delay_us, width_us):
        self._log(f"pulse {delay_us:.9g} {width_us:.9g}")

    def set_magnet(self, on):
        self._log(f"magnet {int(on)}")

    def set_starter(self, on):
        self._log(f"starter {int(on)}")

    def set_clamp(self, on):
        self._log(f"clamp {int(on)}")

    def set_brake(self, on):
        self._log(f"brake {int(on)}")

    def all_off(self):
        self._log("all_off 1")

    def interlock_closed(self):
        return wires.interlock()

    def interlock_opened(self):
        return wires.opened()

    def button_pressed(self):
        return wires.pressed()

    def light_seen(self):
        light = wires.light()
        return None if light < 0 else light > 0

    def stored_latch(self):
        number, _, cause = wires.latch().partition(" ")
        return int(number), cause

    def store_latch(self, number, cause):
        wires.storeLatch(str(number) + " " + cause)

    def environment(self):
        if not wires.sensor():
            raise OSError("no sensor")
        return (20.125, 45.5, 101325.0)

    def ticks_ms(self):
        return time.ticks_ms()

    def ticks_diff(self, later, earlier):
        return time.ticks_diff(later, earlier)

    def ticks_add(self, start, delta_ms):
        return time.ticks_add(start, delta_ms)

    def read(self):
        return unhexlify(wires.read())

    def write(self, data):
        wires.write(hexlify(data).decode())

    def idle(self):
        if not self._turning:
            self._turning = True
            self._log("turning 1")
        wires.idle()
        if wires.marked():
            self._log("mark 1")
        if wires.resetWanted():
            raise ResetWanted()

    def restart(self):
        self._log("restart 1")
