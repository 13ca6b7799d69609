"""Simulated laser instruments, written from their manuals, not from the drivers.

Each keeps the state of a real one: its limit clamps, its interlock forbids, its errors queue. It is heard
within this process, or, by its `port`, on a pseudo-terminal.
"""

import contextlib
import os
import pty
import select
import threading
import time
import tty
from functools import cached_property

from tests.rig.known_rig import known


class Instrument:
    """Reads commands up to a terminator and answers what `answer` returns, if anything."""

    terminator = b"\n"

    def __init__(self) -> None:
        self.on = False
        self.interlock_closed = True
        self.set_value = 0.0
        self.highest_lit = 0.0
        self.received: list[str] = []
        self.silent = False
        self.stuck_on = False
        self.deaf_to_off = 0
        self.measures: float | None = None
        """What its own meter shows, W or A, if that is not what was set."""
        self._heard = b""

    def answer(self, command: str) -> str | None:
        raise NotImplementedError

    def light(self, on: bool) -> None:
        self.on = (on and self.interlock_closed) or self.stuck_on
        self.note()

    @property
    def measured(self) -> float:
        return self.set_value * self.on if self.measures is None else self.measures

    def note(self) -> None:
        if self.on:
            self.highest_lit = max(self.highest_lit, self.set_value)

    def hear(self, data: bytes) -> bytes:
        """Do the commands that these bytes complete; the answers."""
        self._heard += data
        replies = b""
        while self.terminator in self._heard:
            line, self._heard = self._heard.split(self.terminator, 1)
            command = line.decode("ascii").strip()
            self.received.append(command)
            if self.deaf_to_off and command.upper().endswith(("OFF", "L0")):
                self.deaf_to_off -= 1
                continue
            reply = self.answer(command)
            if reply is not None and not self.silent:
                replies += reply.encode("ascii")
        return replies

    @cached_property
    def _terminal(self) -> "_Terminal":
        return _Terminal(self)

    @property
    def port(self) -> str:
        """A pseudo-terminal, at which it is heard from now on."""
        return self._terminal.port

    def close(self) -> None:
        if "_terminal" in self.__dict__:
            self._terminal.close()


class _Terminal:
    """A pseudo-terminal with an instrument behind it."""

    def __init__(self, instrument: Instrument) -> None:
        self._instrument = instrument
        self._master, self._slave = pty.openpty()
        tty.setraw(self._slave)
        self.port = os.ttyname(self._slave)
        known(self.port)
        self._wake_out, self._wake_in = os.pipe()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def close(self) -> None:
        os.write(self._wake_in, b"x")
        self._thread.join()
        for fd in (self._master, self._slave, self._wake_in, self._wake_out):
            with contextlib.suppress(OSError):
                os.close(fd)

    def _serve(self) -> None:
        while True:
            ready, _, _ = select.select([self._master, self._wake_out], [], [])
            if self._wake_out in ready:
                return
            os.write(self._master, self._instrument.hear(os.read(self._master, 1024)))


class FakeThorlabs(Instrument):
    """ITC4001: ampere, upper and lower case, long and short mnemonics, an error queue."""

    hardware_limit_a = 1.0

    def __init__(self) -> None:
        self.limit_a = self.hardware_limit_a
        self.errors: list[str] = []
        self.overheated = False
        self.held_off = False
        """By its input LD ENABLE, at the back."""
        # kept from whoever used it before, over power-off too
        self.kept = {"FUNC:MODE": "POW", "FUNC:SHAP": "PULS", "AM:STAT": "1", "PROT:EXT:MODE": "ENAB"}
        self.deaf_to = ""
        super().__init__()

    def keep(self, key: str, argument: str) -> None:
        """A setting, as words in their short form or as a truth value."""
        choices = {"FUNC:MODE": ("CURR", "POW"), "FUNC:SHAP": ("DC", "PULS"), "AM:STAT": ("OFF", "ON"),
                   "PROT:EXT:MODE": ("OFF", "PROT", "ENAB")}[key]  # fmt: skip
        word = next((word for word in choices if argument.upper().startswith(word)), None)
        if word is None:
            self.errors.append('-224,"Illegal parameter value"')
        elif key != self.deaf_to:
            self.kept[key] = str(choices.index(word)) if key == "AM:STAT" else word

    def answer(self, command: str) -> str | None:
        header, _, argument = command.partition(" ")
        # Short forms are the capitals of the manual's spelling.
        long_to_short = {
            "SOURCE": "SOUR", "CURRENT": "CURR", "LEVEL": "LEV", "AMPLITUDE": "AMPL", "LIMIT": "LIM",
            "OUTPUT": "OUTP", "STATE": "STAT", "PROTECTION": "PROT", "INTLOCK": "INTL", "KEYLOCK": "KEYL",
            "OTEMP": "OTEM", "VOLTAGE": "VOLT", "TRIPPED": "TRIP", "SYSTEM": "SYST", "ERROR": "ERR",
            "MEASURE": "MEAS", "FUNCTION": "FUNC", "SHAPE": "SHAP", "EXTERNAL": "EXT",
        }  # fmt: skip
        query = header.endswith("?")
        words = [long_to_short.get(word, word) for word in header.rstrip("?").upper().split(":")]
        key = ":".join(words) + ("?" if query else "")
        match key:
            case "*IDN?":
                return "Thorlabs,ITC4001,M00277475,1.8.0\n"
            case "*CLS":
                self.errors.clear()
            case "SYST:ERR?":
                return (self.errors.pop(0) if self.errors else '+0,"No error"') + "\n"
            case "OUTP:STAT?":
                return f"{int(self.on)}\n"
            case "OUTP:STAT":
                if argument == "ON" and not self.interlock_closed:
                    self.errors.append('-221,"Settings conflict;interlock open"')
                self.light(argument == "ON")
            case "OUTP:PROT:INTL:TRIP?":
                return f"{int(not self.interlock_closed)}\n"
            case "OUTP:PROT:OTEM:TRIP?":
                return f"{int(self.overheated)}\n"
            case "OUTP:PROT:EXT:TRIP?":
                return f"{int(self.held_off)}\n"
            case "OUTP:PROT:KEYL:TRIP?" | "OUTP:PROT:VOLT:TRIP?":
                return "0\n"
            case "SOUR:CURR:LIM:AMPL":
                self.limit_a = min(float(argument), self.hardware_limit_a)
            case "SOUR:CURR:LIM:AMPL?":
                return f"{self.limit_a:.8E}\n"
            case "SOUR:CURR:LEV:AMPL":
                if float(argument) > self.limit_a:
                    self.errors.append('-222,"Data out of range"')
                else:
                    self.set_value = float(argument)
                    self.note()
            case "SOUR:CURR:LEV:AMPL?":
                return f"{self.set_value:.8E}\n"
            case "MEAS:CURR?":
                return f"{self.measured:.8E}\n"
            case _:
                kept = key.removeprefix("SOUR:").removeprefix("OUTP:")
                if kept in self.kept:
                    self.keep(kept, argument)
                elif kept.rstrip("?") in self.kept:
                    return self.kept[kept.rstrip("?")] + "\n"
                else:
                    self.errors.append('-113,"Undefined header"')
        return None


class FakeObis(Instrument):
    """OBIS LX; with handshaking a line OK or ERR after everything, without it only answers to queries."""

    terminator = b"\r\n"

    def __init__(self) -> None:
        self.delay = 2
        self.faults = 0
        self.handshaking = True
        self.autostart = True
        self.autostart_locked = False
        self.source = "MIXED"
        """Who sets the light: CWP, CWC, DIGITAL, ANALOG, MIXED; kept over power-off."""
        self.warm = True
        super().__init__()

    def answer(self, command: str) -> str | None:
        if command.upper() == "SYSTEM:COMMUNICATE:HANDSHAKING ON":
            self.handshaking = True
        reply = self.shaken(command)
        if self.handshaking:
            return reply
        return None if reply.startswith(("OK", "ERR")) else reply.removesuffix("OK\r\n")

    def shaken(self, command: str) -> str:
        header, _, argument = command.partition(" ")
        match header.upper():
            case "SYSTEM:COMMUNICATE:HANDSHAKING":
                return "OK\r\n"
            case "*IDN?":
                return "Coherent, Inc - OBIS 640nm 100mW C - V1.0.1 - Dec 14 2010\r\nOK\r\n"
            case "SYSTEM:INFORMATION:MODEL?":
                return "OBIS 640nm LX 100mW\r\nOK\r\n"
            case "SYSTEM:INFORMATION:SNUMBER?":
                return "LX123456\r\nOK\r\n"
            case "SYSTEM:FAULT?":
                return f"{self.faults:08X}\r\nOK\r\n"
            case "SYSTEM:LOCK?":
                return f"{'ON' if self.interlock_closed else 'OFF'}\r\nOK\r\n"
            case "SOURCE:AM:STATE?":
                # The delay that class 3B demands between command and light: a few questions long.
                if self.on and self.delay:
                    self.delay -= 1
                    return "OFF\r\nOK\r\n"
                return f"{'ON' if self.on else 'OFF'}\r\nOK\r\n"
            case "SOURCE:AM:STATE":
                if argument == "ON" and not self.interlock_closed:
                    return "ERR-221\r\n"
                self.light(argument == "ON")
                return "OK\r\n"
            case "SOURCE:AM:INTERNAL":
                if argument not in ("CWP", "CWC"):
                    return "ERR-220\r\n"
                self.source = argument
                return "OK\r\n"
            case "SOURCE:AM:SOURCE?":
                return f"{self.source}\r\nOK\r\n"
            case "SYSTEM:AUTOSTART":
                self.autostart = self.autostart_locked or argument == "ON"
                return "OK\r\n"
            case "SYSTEM:AUTOSTART?":
                return f"{'ON' if self.autostart else 'OFF'}\r\nOK\r\n"
            case "SYSTEM:STATUS?":
                return f"{0xC8001002 if self.warm else 0xC8001100:08X}\r\nOK\r\n"
            case "SOURCE:POWER:LEVEL:IMMEDIATE:AMPLITUDE":
                if not 0.0 <= float(argument) <= 0.110:
                    return "ERR-222\r\n"
                self.set_value = float(argument)
                self.note()
                return "OK\r\n"
            case "SOURCE:POWER:LEVEL:IMMEDIATE:AMPLITUDE?":
                return f"{self.set_value:.5f}\r\nOK\r\n"
            case "SOURCE:POWER:LEVEL?":
                return f"{self.measured:.5f}\r\nOK\r\n"
        return "ERR-100\r\n"


class FakeLdc500(Instrument):
    """LDC501: milliampere; the limit clamps and drags the set current down."""

    def __init__(self) -> None:
        self.limit_ma = 500.0
        self.lexe = 0
        self.lcme = 0
        self.obeyed_s = 0.0
        self.error_after_s = 0.05
        self.monitor_mw = 0.0
        self.kept = {"SMOD": "CP", "MODU": "ON", "SCAN": "OFF"}
        """Kept over power-off, except a scan."""
        super().__init__()

    def answer(self, command: str) -> str | None:
        header, _, argument = command.partition(" ")
        if not header.endswith("?"):
            self.obeyed_s = time.monotonic()
        match header:
            case "*IDN?":
                return "Stanford_Research_Systems,LDC501,s/n098023,v1.02\r\n"
            case "LEXE?" | "LCME?":
                # an error is entered some time after the command
                if time.monotonic() - self.obeyed_s < self.error_after_s:
                    return "0\r\n"
                register = header.rstrip("?").lower()
                code = getattr(self, register)
                setattr(self, register, 0)
                return f"{code}\r\n"
            case "ILOC?":
                return "CLOSED\r\n" if self.interlock_closed else "OPEN\r\n"
            case "LDON?":
                return "ON\r\n" if self.on else "OFF\r\n"
            case "LDON":
                self.lexe = 0 if argument != "ON" or self.interlock_closed else 4
                self.light(argument in ("ON", "1"))
            case "SILM":
                self.limit_ma = min(float(argument), 500.0)
                self.set_value = min(self.set_value, self.limit_ma / 1000)
            case "SILM?":
                return f"{self.limit_ma:.3f}\r\n"
            case "SILD":
                if float(argument) > self.limit_ma:
                    self.lexe = 1
                else:
                    self.set_value = float(argument) / 1000
                    self.note()
            case "SILD?":
                return f"{self.set_value * 1000:.3f}\r\n"
            case "RILD?":
                return f"{self.measured * 1000:.3f}\r\n"
            case "RWPD?":
                return f"{self.monitor_mw:.5f}\r\n"
            case "SMOD" | "MODU":
                self.lexe = 0 if argument in ("CC", "CP", "ON", "OFF") else 1
                self.kept[header] = argument
            case "SMOD?" | "MODU?" | "SCAN?":
                return self.kept[header.rstrip("?")] + "\r\n"
            case _:
                self.lcme = 2
        return None


class FakeCobolt(Instrument):
    """06-01 series: CR in, CR LF out, OK or a syntax error."""

    terminator = b"\r"

    def __init__(self) -> None:
        self.fault = 0
        self.autostart = False
        self.direct_input: bool | None = True
        """Whether 5 V at its connector lights it; None for a model that has none."""
        self.mode = 4
        """gom?: 0 off, 1 waits for the key, 2 continuous, 3 on/off modulation, 4 modulation, 5 fault."""
        super().__init__()

    def answer(self, command: str) -> str | None:
        word, _, argument = command.partition(" ")
        answers = {
            "sn?": "12345",
            "@cobas?": str(int(self.autostart)),
            "l?": str(int(self.on)),
            "ilk?": str(int(not self.interlock_closed)),
            "f?": str(self.fault if self.interlock_closed else 3),
            "pa?": f"{self.measured:.6f}",
            "p?": f"{self.set_value:.6f}",
            "gom?": str(self.mode),
        }
        if self.direct_input is not None:
            answers["@cobasdr?"] = str(int(self.direct_input))
        if word in answers:
            return answers[word] + "\r\n"
        if word == "l1" and self.autostart:
            return "Syntax error: not allowed in autostart mode\r\n"
        if word in ("l1", "l0"):
            self.light(word == "l1")
        elif word == "p" and 0.0 <= float(argument) <= 0.05:
            self.set_value = float(argument)
            self.note()
        elif word == "cp":
            self.mode = 2
        elif word == "@cobasdr" and self.direct_input is not None:
            self.direct_input = argument != "0"
        else:
            return "Syntax error: illegal command\r\n"
        return "OK\r\n"
