"""Analog Devices ADXL355 over I2C: acceleration along three axes, which feels the ground and its tilt.

Registers as in the data sheet of ADXL354/ADXL355, "Register map" and "FIFO". Samples are passed on as the
chip gives them, nine bytes each: whoever wants numbers has the time for it.
"""

NAME = "ADXL355"
RATE_HZ = 15.625
"""The chip's filter passes a quarter of it."""
PER_G = 256000
"""Counts in the range of 2 g."""
STEP_MS = 64

_MOST = 4
"""Samples of one call, 1 ms on the bus: the loop has more to look after."""


class Adxl355:
    """The sensor, which measures on its own clock into a memory of 32 samples."""

    def __init__(self, i2c, address: int = 0x1D) -> None:  # type: ignore[no-untyped-def]
        self.i2c, self.address = i2c, address
        i2c_read, i2c_write = i2c.readfrom_mem, i2c.writeto_mem
        if i2c_read(address, 0x00, 3) != b"\xad\x1d\xed":
            raise OSError("no ADXL355 at this address")
        # filter and range are set in standby, which empties its memory; no high pass, as a tilt is wanted
        i2c_write(address, 0x2D, b"\x01")
        i2c_write(address, 0x28, b"\x08")
        i2c_write(address, 0x2C, b"\x81")
        i2c_write(address, 0x2D, b"\x00")

    def read(self) -> "tuple[bool, list[bytes], int]":
        """Whether samples were lost, the oldest few that wait, and how many later ones wait still.

        OSError if the sensor does not answer, or its memory is not in step: set it up again.
        """
        status, entries = self.i2c.readfrom_mem(self.address, 0x04, 2)
        samples = []
        waiting = entries // 3
        for _ in range(min(waiting, _MOST)):
            raw = self.i2c.readfrom_mem(self.address, 0x11, 9)
            # the lowest bits mark the first axis, and a memory that was empty
            if (raw[2] & 3, raw[5] & 3, raw[8] & 3) != (1, 0, 0):
                raise OSError("ADXL355 is out of step")
            samples.append(raw)
        return bool(status & 4), samples, waiting - len(samples)
