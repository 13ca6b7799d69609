"""Bosch BME280 over I2C: temperature, humidity, pressure.

The compensation follows section 4.2.3 and appendix 8.1 (floating point) of the BME280 data
sheet. MicroPython's single-precision floats leave about 0.001 K, 0.01 % and 3 Pa.
"""

from struct import unpack


class Calibration:
    """Trimming values as the chip stores them: 26 bytes from 88h and 7 bytes from E1h."""

    def __init__(self, low: bytes, high: bytes) -> None:
        (self.t1, self.t2, self.t3) = unpack("<Hhh", low[0:6])
        self.p = unpack("<Hhhhhhhhh", low[6:24])
        self.h1 = low[25]
        (self.h2, self.h3) = unpack("<hB", high[0:3])
        # H4 and H5 are signed 12-bit values that share the byte E5h.
        h4, h5 = (high[3] << 4) | (high[4] & 15), (high[5] << 4) | (high[4] >> 4)
        self.h4 = h4 - 4096 if h4 & 2048 else h4
        self.h5 = h5 - 4096 if h5 & 2048 else h5
        (self.h6,) = unpack("<b", high[6:7])


def compensate(c: Calibration, raw_t: int, raw_p: int, raw_h: int) -> tuple[float, float, float]:
    """Temperature in degrees Celsius, relative humidity in per cent, pressure in Pa."""
    x = raw_t / 16384.0 - c.t1 / 1024.0
    y = raw_t / 131072.0 - c.t1 / 8192.0
    fine = x * c.t2 + y * y * c.t3
    return fine / 5120.0, _humidity(c, fine, raw_h), _pressure(c, fine, raw_p)


def _pressure(c: Calibration, fine: float, raw_p: int) -> float:
    p1, p2, p3, p4, p5, p6, p7, p8, p9 = c.p
    x = fine / 2.0 - 64000.0
    y = x * x * p6 / 32768.0 + x * p5 * 2.0
    y = y / 4.0 + p4 * 65536.0
    x = (p3 * x * x / 524288.0 + p2 * x) / 524288.0
    x = (1.0 + x / 32768.0) * p1
    if x == 0.0:
        return float("nan")
    p = (1048576.0 - raw_p - y / 4096.0) * 6250.0 / x
    return float(p + (p9 * p * p / 2147483648.0 + p * p8 / 32768.0 + p7) / 16.0)


def _humidity(c: Calibration, fine: float, raw_h: int) -> float:
    h = fine - 76800.0
    h = (raw_h - (c.h4 * 64.0 + c.h5 / 16384.0 * h)) * (
        c.h2 / 65536.0 * (1.0 + c.h6 / 67108864.0 * h * (1.0 + c.h3 / 67108864.0 * h))
    )
    return float(min(max(h * (1.0 - c.h1 * h / 524288.0), 0.0), 100.0))


class Bme280:
    """The sensor in its normal mode: it measures continuously, `read` returns the latest result."""

    def __init__(self, i2c, address: int = 0x76) -> None:  # type: ignore[no-untyped-def]
        self.i2c, self.address = i2c, address
        self._begin()

    def _begin(self) -> None:
        i2c, address = self.i2c, self.address
        if i2c.readfrom_mem(address, 0xD0, 1)[0] != 0x60:
            raise OSError("no BME280 at this address")
        self.calibration = Calibration(
            i2c.readfrom_mem(address, 0x88, 26), i2c.readfrom_mem(address, 0xE1, 7)
        )
        # Humidity x1; standby 500 ms and filter 4; then temperature x2, pressure x4, normal mode.
        i2c.writeto_mem(address, 0xF2, b"\x01")
        i2c.writeto_mem(address, 0xF5, b"\x88")
        i2c.writeto_mem(address, 0xF4, b"\x4f")

    def read(self) -> tuple[float, float, float]:
        """Temperature in degrees Celsius, relative humidity in per cent, pressure in Pa.

        OSError if there is no measurement: the first one is not ready, the sensor has lost its settings
        (its supply was interrupted; it is set up again), or the values are outside its range.
        """
        settings = self.i2c.readfrom_mem(self.address, 0xF2, 4)
        if (settings[0] & 7, settings[2], settings[3]) != (0x01, 0x4F, 0x88):
            self._begin()
            raise OSError("BME280 had lost its settings")
        d = self.i2c.readfrom_mem(self.address, 0xF7, 8)
        raw_p = (d[0] << 12) | (d[1] << 4) | (d[2] >> 4)
        raw_t = (d[3] << 12) | (d[4] << 4) | (d[5] >> 4)
        raw_h = (d[6] << 8) | d[7]
        # contents of the registers before the first measurement, and for a quantity that is not measured
        if raw_p == 0x80000 or raw_t == 0x80000 or raw_h == 0x8000:
            raise OSError("BME280 has not measured yet")
        t, h, p = compensate(self.calibration, raw_t, raw_p, raw_h)
        if not (-40.0 <= t <= 85.0 and 30000.0 <= p <= 110000.0):
            raise OSError("BME280 reads values outside its range")
        return t, h, p
