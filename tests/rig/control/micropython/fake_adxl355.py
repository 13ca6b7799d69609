"""An ADXL355 on an I2C bus, as its data sheet describes it: registers, standby, a memory of 96 words.

It runs on MicroPython beside the test board, and on CPython. Nothing of the driver is imported.
"""

_IDENTITY = {0x00: 0xAD, 0x01: 0x1D, 0x02: 0xED, 0x03: 0x01}
_AT_RESET = {0x28: 0x00, 0x29: 0x60, 0x2C: 0x81, 0x2D: 0x01}
_WORDS = 96


class FakeAdxl355:
    """Answers at 1Dh as `machine.I2C` does; `ticks_ms` is its clock, which `fast` times 1 + 1e-6 ppm runs.

    Its first axis counts the samples since it was powered, the second counts down, the third is 1 g.
    """

    def __init__(self, ticks_ms, ppm=0):
        self._ticks_ms = ticks_ms
        self._ppm = ppm
        self.present = self.hangs = self.slips = False
        self.power()

    def power(self):
        """As after its supply was interrupted."""
        self.present = True
        self._registers = dict(_AT_RESET)
        self._words = []
        self._pointer = 0
        self._overrun = False
        self._due_us = None
        self.taken = 0
        self.taken_ms = []

    # -- as machine.I2C --------------------------------------------------------

    def readfrom_mem(self, address, register, count):
        self._answer(address)
        self._measure()
        data = []
        for k in range(count):
            if register == 0x11:
                data.append(self._pop())
            else:
                data.append(self._read(register + k))
        return bytes(data)

    def writeto_mem(self, address, register, data):
        self._answer(address)
        self._measure()
        for k, value in enumerate(data):
            self._write(register + k, value)

    # -- the chip --------------------------------------------------------------

    def _answer(self, address):
        if self.hangs or not self.present or address != 0x1D:
            raise OSError(110 if self.hangs else 5)

    def _read(self, register):
        if register in _IDENTITY:
            return _IDENTITY[register]
        if register == 0x04:
            overrun, self._overrun = self._overrun, False
            return (len(self._words) >= 3) | (len(self._words) >= _WORDS) << 1 | overrun << 2
        if register == 0x05:
            return len(self._words)
        return self._registers.get(register, 0)

    def _write(self, register, value):
        measures = not self._registers[0x2D] & 1
        if register in (0x28, 0x2C) and measures:
            raise AssertionError("filter and range are to be set in standby")
        if register == 0x2F and value == 0x52:
            self.power()
            return
        self._registers[register] = value
        if register == 0x2D and measures == bool(value & 1):
            self._words, self._pointer, self._overrun = [], 0, False
            self._due_us = None if value & 1 else self._now_us() + self._period_us()

    def _period_us(self):
        return 1e6 / (4000.0 / (1 << (self._registers[0x28] & 15))) / (1 + 1e-6 * self._ppm)

    def _now_us(self):
        return 1000 * self._ticks_ms()

    def _measure(self):
        while self._due_us is not None and self._due_us <= self._now_us():
            if len(self._words) >= _WORDS:
                self._words = self._words[3:]
                self._pointer, self._overrun = 0, True
            for axis, value in enumerate((self.taken, -self.taken, 256000)):
                word = (value & 0xFFFFF) << 4 | (axis == 0)
                self._words.append((word >> 16 & 255, word >> 8 & 255, word & 255))
            self.taken_ms.append(self._due_us / 1000)
            self.taken += 1
            self._due_us += self._period_us()
        if self.slips and self._words:
            self.slips = False
            self._words = self._words[1:]

    def _pop(self):
        """A byte of the memory; each third one takes a word out."""
        if not self._words:
            return 2 if self._pointer == 2 else 0
        value = self._words[0][self._pointer]
        self._pointer += 1
        if self._pointer == 3:
            self._words, self._pointer = self._words[1:], 0
        return value
