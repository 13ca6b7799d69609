"""The controller's protocol, limits and watchdog, independent of the hardware.

It runs on MicroPython and, for the simulated controller, on CPython: clock, pins and bytes are those of the
board object (see `board.py` for its methods). The commands are documented in docs/controller.md.
"""

try:
    from rig.control.firmware.lines import Lines, Refused, spelled
except ImportError:
    # on the board the files are in no package
    from lines import Lines, Refused, spelled  # type: ignore[import-not-found, no-redef]

VERSION = "1.4"
DEADLINE_MIN_MS = 100
DEADLINE_MAX_MS = 5000
PULSE_MAX_US = 1000000
CAUSES = ("NONE", "INTERLOCK", "OUTPUT", "WATCHDOG", "POWER")
# a photodiode and a laser's electronics respond within some ms
LIGHT_MS = 200
# a press lasts longer than a contact bounces
BUTTON_MS = 500


def _on_off(argument: str) -> bool:
    if argument in ("ON", "1"):
        return True
    if argument in ("OFF", "0"):
        return False
    raise Refused(-224, "Illegal parameter value; ON or OFF")


def _number(argument: str) -> float:
    try:
        return float(argument)
    except ValueError:
        raise Refused(-104, "Data type error; a number is wanted") from None


class Firmware(Lines):
    """State of the controller. The board's loop calls `step` as often as possible.

    The laser is on only while a session is open, heartbeats arrive in time and the interlock is closed. As
    soon as one of these conditions fails, every output is put into its safe state, and only a new command
    switches the laser on again. The power is limited by the value stored on the board. A trip is latched, lit
    or dark, over sessions and hosts: light is refused until its number is acknowledged.
    """

    def __init__(self, board):  # type: ignore[no-untyped-def]
        super().__init__(board)  # type: ignore[no-untyped-call]
        self.deadline_ms = 0
        self.heard_ms = 0
        self.number, self.trip = board.stored_latch()
        if self.trip not in CAUSES:
            self.trip = "POWER"
        self._trip_ms = 0
        self._trip_lit = False
        self._was_closed = True
        self._may_press = False
        self._pressed_ms = -1
        self._contradicted_ms = -1
        self._is_reported = False
        self.limit_w = board.laser_max_w
        self.power_w = 0.0
        self.laser = False
        # delay and width after each edge of the camera's exposure output; width 0 is light all the time
        self.pulse_us = (0.0, 0.0)
        self.magnet = False
        self.starter = False
        self.clamp = board.clamp_closed
        self.brake = False
        self._disagrees = False
        self._starter_end_ms = 0
        self._brake_end_ms = 0
        free = (
            ("*IDN?", self._identify),
            ("SYSTem:ERRor?", self._next_error),
            ("SYSTem:STATus?", self._status),
            ("SYSTem:TRIP?", self._report_trip),
            ("SYSTem:SESSion", self._open_session),
            ("SYSTem:SAFE", self._safe_now),
            ("*RST", self._safe_now),
            ("LASer:STATe?", lambda _: str(int(self.laser))),
            ("LASer:POWer?", lambda _: f"{self.power_w:.7g}"),
            ("LASer:POWer:LIMit?", lambda _: f"{self.limit_w:.7g}"),
            ("LASer:PULSe?", lambda _: f"{self.pulse_us[0]:.7g},{self.pulse_us[1]:.7g}"),
            ("INTerlock?", lambda _: "CLOSED" if board.interlock_closed() else "OPEN"),
            ("MAGNet?", lambda _: str(int(self.magnet))),
            ("STARter?", lambda _: str(int(self.starter))),
            ("CLAMp?", lambda _: str(int(self.clamp))),
            ("BRAKe?", lambda _: str(int(self.brake))),
            ("ENVironment?", lambda _: ",".join([f"{v:.7g}" for v in self._environment()])),
            ("TEMPerature?", lambda _: f"{self._environment()[0]:.7g}"),
            ("HUMidity?", lambda _: f"{self._environment()[1]:.7g}"),
            ("PRESsure?", lambda _: f"{self._environment()[2]:.7g}"),
        )
        # these act on the rig, and need a session
        acting = (
            ("SYSTem:HEARtbeat?", self._heartbeat),
            ("SYSTem:SESSion:END", self._end_session),
            ("SYSTem:TRIP:ACKnowledge", self._acknowledge),
            ("LASer:STATe", self._set_laser),
            ("LASer:POWer", self._set_power),
            ("LASer:POWer:LIMit", self._set_limit),
            ("LASer:PULSe", self._set_pulse),
            ("MAGNet", self._set_magnet),
            ("MAGNet:RELease", self._release),
            ("STARter:PULSe", self._pulse),
            ("CLAMp", self._set_clamp),
            ("BRAKe", self._set_brake),
        )
        self._free, self._acting = spelled(free), spelled(acting)  # type: ignore[no-untyped-call]
        self.safe()
        if board.fault:
            self._fail(-240, "Hardware error; " + board.fault)
        self._event("BOOT " + VERSION)
        if board.latches_at_start:
            self._trip("POWER", 104)

    # -- called by the board's loop -------------------------------------------

    def step(self) -> None:
        """One turn of the loop; deadlines first, so that a late heartbeat cannot prevent a trip."""
        self._tick()
        data = self.board.read()
        if data:
            self._receive(data)

    def safe(self) -> None:
        """Switch laser, magnet, starter and brake off; the clamp stays, as it could hit the ball."""
        self.laser = self.magnet = self.starter = self.brake = False
        board = self.board
        board.set_laser(False, 0.0)
        board.set_magnet(False)
        board.set_starter(False)
        board.set_brake(False)

    def _tick(self) -> None:
        board = self.board
        now = board.ticks_ms()
        if self.token and board.ticks_diff(now, self.heard_ms) > self.deadline_ms:
            self._trip("WATCHDOG", 101)
        closed = board.interlock_closed()
        # an opening that was shorter than a turn is reported by the pin's interrupt
        opened = board.interlock_opened()
        if opened or (self._was_closed and not closed):
            self._trip("INTERLOCK", 102)
        self._was_closed = closed
        # a pin that does not follow its setting is wired wrongly, or broken
        disagrees = board.laser_enabled() != self.laser
        if disagrees and not self._disagrees:
            self._trip("OUTPUT", 103)
        self._disagrees = disagrees
        if self._light_contradicts(now):
            self._trip("OUTPUT", 103)
        self._watch_button(now)
        if self.starter and board.ticks_diff(now, self._starter_end_ms) >= 0:
            self.starter = False
            board.set_starter(False)
        if self.brake and board.ticks_diff(now, self._brake_end_ms) >= 0:
            self.brake = False
            board.set_brake(False)

    def _light_contradicts(self, now: int) -> bool:
        """Whether a photodiode has just contradicted the laser's state for long enough."""
        light = self.board.light_seen()
        # no light is due between pulses; a laser with its own power control may light at a set power of 0 W
        light_due = self.laser and self.power_w > 0.0 and not self.pulse_us[1]
        if light is None or (self.laser if light else not light_due):
            self._contradicted_ms, self._is_reported = -1, False
        elif self._contradicted_ms < 0:
            self._contradicted_ms = now
        elif not self._is_reported and self.board.ticks_diff(now, self._contradicted_ms) > LIGHT_MS:
            self._is_reported = True
            return True
        return False

    def _watch_button(self, now: int) -> None:
        """Acknowledge by the button, which must be released, then held, so that a stuck one has no effect."""
        if not self.board.button_pressed():
            self._may_press, self._pressed_ms = True, -1
        elif self._may_press and self._pressed_ms < 0:
            self._pressed_ms = now
        elif self._may_press and self.board.ticks_diff(now, self._pressed_ms) > BUTTON_MS:
            self._may_press = False
            if self.trip != "NONE" and not self._cause_persists():
                self._clear()

    def _cause_persists(self) -> str:
        if not self.board.interlock_closed():
            return "interlock open"
        if self.board.laser_enabled() != self.laser:
            return "the output does not follow"
        return "light is seen" if self.board.light_seen() and not self.laser else ""

    def _clear(self) -> None:
        self.trip = "NONE"
        self.board.store_latch(self.number, self.trip)
        self._event("ACK " + str(self.number))

    def _trip(self, cause: str, code: int) -> None:
        lit = self.laser
        self.safe()
        # a button that is held through a trip does not acknowledge it
        self._may_press = False
        self.number += 1
        self._trip_ms, self._trip_lit = self.board.ticks_ms(), lit
        self.board.store_latch(self.number, cause)
        if cause == "WATCHDOG":
            self.token = ""
        self.trip = cause
        self._fail(code, "Tripped; " + cause)
        self._event("TRIP " + cause)

    # -- commands -------------------------------------------------------------

    def _identify(self, _: str) -> str:
        return f"optical-pendulum-rig,controller,{self.board.serial},{VERSION}"

    def _status(self, _: str) -> str:
        sees = self.board.light_seen()
        return (
            f"{self.board.ticks_ms()},{int(self.board.interlock_closed())},{int(self.laser)},{self.power_w:.7g},"
            f"{int(self.magnet)},{int(self.starter)},{int(self.clamp)},{int(self.brake)},"
            f"{self.trip},{len(self._errors)},{self._latched_number()},{int(self._trip_lit)},"
            f"{int(self.board.laser_enabled())},{'-' if sees is None else int(sees)}"
        )

    def _latched_number(self) -> int:
        return 0 if self.trip == "NONE" else self.number

    def _report_trip(self, _: str) -> str:
        return f"{self._latched_number()},{self.trip},{self._trip_ms},{'lit' if self._trip_lit else 'dark'}"

    def _acknowledge(self, argument: str) -> str:
        if self.trip == "NONE" or argument != str(self.number):
            raise Refused(-222, f"Data out of range; trip {self._latched_number()} is latched")
        if persists := self._cause_persists():
            raise Refused(-221, "Settings conflict; " + persists)
        self._clear()
        return ""

    def _heartbeat(self, argument: str) -> str:
        self.heard_ms = self.board.ticks_ms()
        return self._status(argument)

    def _open_session(self, argument: str) -> str:
        token, _, deadline = argument.partition(",")
        deadline_ms = _number(deadline)
        if not token:
            raise Refused(-109, "Missing parameter; token,deadline_ms")
        if not DEADLINE_MIN_MS <= deadline_ms <= DEADLINE_MAX_MS:
            raise Refused(-222, "Data out of range; deadline 100 to 5000 ms")
        self.safe()
        self._replies = []
        self.token = token
        self.deadline_ms = int(deadline_ms)
        self.heard_ms = self.board.ticks_ms()
        self.power_w = 0.0
        self._apply_pulse(0.0, 0.0)
        self.limit_w = self.board.laser_max_w
        return f"{self.limit_w:.7g}"

    def _end_session(self, _: str) -> str:
        self.safe()
        self.token = ""
        return ""

    def _safe_now(self, _: str) -> str:
        self.safe()
        return ""

    def _set_laser(self, argument: str) -> str:
        on = _on_off(argument)
        if on:
            if not self.board.interlock_closed():
                raise Refused(-221, "Settings conflict; interlock open")
            if self.trip != "NONE":
                raise Refused(105, f"Latched; trip {self.number}, {self.trip}, is not acknowledged")
        self.laser = on
        self.board.set_laser(on, self.power_w)
        return ""

    def _set_power(self, argument: str) -> str:
        power_w = _number(argument)
        # this form of the condition also rejects NaN, for which every comparison is false
        if not 0.0 <= power_w <= self.limit_w:
            raise Refused(-222, f"Data out of range; 0 to {self.limit_w:.7g} W")
        self.power_w = power_w
        if self.laser:
            self.board.set_laser(True, power_w)
        return ""

    def _set_limit(self, argument: str) -> str:
        limit_w = _number(argument)
        # the stored limit can be changed only on the board itself
        if not 0.0 <= limit_w <= self.board.laser_max_w:
            raise Refused(-222, f"Data out of range; 0 to {self.board.laser_max_w:.7g} W")
        self.limit_w = limit_w
        if self.power_w > limit_w:
            self._set_power(argument)
        return ""

    def _set_pulse(self, argument: str) -> str:
        if self.laser:
            raise Refused(-221, "Settings conflict; the laser is on")
        if argument == "OFF":
            self._apply_pulse(0.0, 0.0)
            return ""
        delay, _, width = argument.partition(",")
        delay_us, width_us = _number(delay), _number(width)
        # written so that NaN is refused
        if not (0.0 <= delay_us <= PULSE_MAX_US and 1.0 <= width_us <= PULSE_MAX_US):
            raise Refused(-222, "Data out of range; 0 to 1e6 us delay, 1 to 1e6 us width")
        self._apply_pulse(delay_us, width_us)
        return ""

    def _apply_pulse(self, delay_us: float, width_us: float) -> None:
        self.pulse_us = (delay_us, width_us)
        self.board.set_pulse(delay_us, width_us)

    def _set_magnet(self, argument: str) -> str:
        self.magnet = _on_off(argument)
        self.board.set_magnet(self.magnet)
        return ""

    def _release(self, _: str) -> str:
        if not self.magnet:
            raise Refused(-221, "Settings conflict; the magnet holds nothing")
        self.magnet = False
        self.board.set_magnet(False)
        return ""

    def _pulse(self, argument: str) -> str:
        length_ms = _number(argument)
        longest_ms = self.board.starter_max_ms
        if not 1 <= length_ms <= longest_ms:
            raise Refused(-222, f"Data out of range; 1 to {longest_ms} ms")
        if self.starter:
            raise Refused(-221, "Settings conflict; a pulse is running")
        self.starter = True
        self._starter_end_ms = self.board.ticks_add(self.board.ticks_ms(), int(length_ms))
        self.board.set_starter(True)
        return ""

    def _set_clamp(self, argument: str) -> str:
        self.clamp = _on_off(argument)
        self.board.set_clamp(self.clamp)
        return ""

    def _set_brake(self, argument: str) -> str:
        self.brake = _on_off(argument)
        self._brake_end_ms = self.board.ticks_add(self.board.ticks_ms(), self.board.brake_max_ms)
        self.board.set_brake(self.brake)
        return ""

    def _environment(self) -> tuple[float, float, float]:
        try:
            temperature_c, humidity_percent, pressure_pa = self.board.environment()
            return (temperature_c, humidity_percent, pressure_pa)
        except OSError:
            self._fail(-240, "Hardware error; environment sensor")
            nan = float("nan")
            return (nan, nan, nan)
