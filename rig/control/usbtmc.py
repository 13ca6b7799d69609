"""Lines to and from a USB Test & Measurement instrument, over the Linux kernel's own driver (/dev/usbtmc*).

The kernel's driver is maintained with the kernel and needs no package, so it was preferred to pyvisa-py and
python-usbtmc, which use a USB library of their own and detach the instrument from the kernel. Linux only.
"""

import contextlib
import os
import struct
from pathlib import Path

from rig.control.serial_port import PortLost

try:
    import fcntl
except ImportError:  # pragma: no cover
    # without the kernel's driver, a serial port of the same instrument can be used
    fcntl = None  # type: ignore[assignment]

PREFIX = "usbtmc"
"""Port of the only such instrument; ``usbtmc:SERIAL`` is that of the one with this serial number."""
_DEVICES_FOLDER = Path("/sys/class/usbmisc")
_CLEAR, _SET_TIMEOUT = 0x5B02, 0x40045B0A
"""_IO(91, 2) and _IOW(91, 10, __u32) of linux/usb/tmc.h."""
_MIN_TIMEOUT_MS = 100
_MAX_ANSWER_BYTES = 4096


def is_usbtmc(port: str) -> bool:
    """Whether a port names a USBTMC instrument."""
    return port.partition(":")[0] == PREFIX or Path(port).name.startswith(PREFIX)


def find_usbtmc(port: str, vendor: int, devices: Path = _DEVICES_FOLDER) -> str:
    """The device node of an instrument; a path is returned as it is.

    Raises PortLost if there is none of this USB vendor and serial number, or several.
    """
    if port.partition(":")[0] != PREFIX:
        return port
    wanted_serial = port.partition(":")[2]
    paths = {}
    for node in sorted(devices.glob("usbtmc*")):
        # the class device belongs to an interface, whose parent is the USB device
        with contextlib.suppress(OSError, ValueError):
            usb = (node / "device").resolve().parent
            if int((usb / "idVendor").read_text(encoding="utf-8"), 16) == vendor:
                paths[(usb / "serial").read_text(encoding="utf-8").strip()] = f"/dev/{node.name}"
    matching = {serial: path for serial, path in paths.items() if wanted_serial in ("", serial)}
    if len(matching) == 1:
        return next(iter(matching.values()))
    present = ", ".join(f"usbtmc:{serial}" for serial in paths) or "none"
    raise PortLost(
        f"{port}: {len(matching)} USBTMC instruments of vendor {vendor:04x} fit, there is {present};"
        " name one, switch it on, and see that the kernel has its module usbtmc"
    )


class UsbTmcLine:
    """A `SerialLine` over /dev/usbtmc*: one message out, one message in.

    The kernel requests an answer of the instrument at each read, so the device is read only after a query.
    """

    def __init__(self, path: str, timeout_s: float) -> None:
        self._path = path
        self._timeout_ms = 0
        self._answer_due = False
        self._fd = -1
        if fcntl is None:
            raise PortLost(f"{path}: USBTMC instruments are reached on Linux only")
        try:
            self._fd = os.open(path, os.O_RDWR | os.O_CLOEXEC)
            # a second program would receive some of the answers
            fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
            self._set_timeout(timeout_s)
        except OSError as error:
            self.close()
            problem = f"cannot open the instrument: {error.strerror or error}"
            if isinstance(error, PermissionError):
                problem = "no permission; run rig doctor --install-udev, and plug the instrument in again"
            raise PortLost(f"{path}: {problem}") from error

    @property
    def name(self) -> str:
        """The device node."""
        return self._path

    def write(self, data: bytes) -> None:
        """Send one message."""
        try:
            os.write(self._fd, data)
        except TimeoutError:
            # the caller gets no answer, and repeats the query
            self._clear()
        except OSError as error:
            raise self._loss_error("write", error) from error
        self._answer_due = b"?" in data

    def read(self, timeout_s: float) -> bytes:
        """The answer to the last message; b"" after the timeout, or if none was asked for."""
        if not self._answer_due:
            return b""
        try:
            self._set_timeout(timeout_s)
            answer = os.read(self._fd, _MAX_ANSWER_BYTES)
        except TimeoutError:
            self._clear()
            return b""
        except OSError as error:
            raise self._loss_error("read", error) from error
        self._answer_due = False
        return answer

    def discard_input(self) -> None:
        """Discard an answer that was not read."""
        if self._answer_due:
            self._clear()

    def close(self) -> None:
        """Close the device; may be called more than once."""
        if self._fd >= 0:
            fd, self._fd = self._fd, -1
            with contextlib.suppress(OSError):
                os.close(fd)

    def _clear(self) -> None:
        self._answer_due = False
        try:
            fcntl.ioctl(self._fd, _CLEAR)
        except TimeoutError:
            pass
        except OSError as error:
            raise self._loss_error("clear", error) from error

    def _set_timeout(self, timeout_s: float) -> None:
        timeout_ms = max(round(1000 * timeout_s), _MIN_TIMEOUT_MS)
        if timeout_ms != self._timeout_ms:
            fcntl.ioctl(self._fd, _SET_TIMEOUT, struct.pack("@I", timeout_ms))
            self._timeout_ms = timeout_ms

    def _loss_error(self, operation: str, error: OSError) -> PortLost:
        return PortLost(
            f"{self._path}: the instrument is no longer available ({operation}): {error.strerror or error};"
            " check the cable"
        )
