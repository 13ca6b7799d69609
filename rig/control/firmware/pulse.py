"""One pulse of the laser's gate in each exposure of the camera, by a state machine of the RP2040.

It runs beside the processor, so that neither the loop nor the USB port moves a pulse. The names in the
program are those of MicroPython's assembler.
"""
# ruff: noqa: F821
# mypy: disable-error-code="name-defined, call-overload, no-untyped-def"

import rp2  # type: ignore[import-not-found]

TICKS_PER_US = 10
DELAY_OVERHEAD = 4
WIDTH_OVERHEAD = 2
"""Ticks that the instructions take themselves."""


@rp2.asm_pio(set_init=rp2.PIO.OUT_LOW)
def _program():
    pull(block)
    mov(isr, osr)
    pull(block)
    wrap_target()
    wait(0, pin, 0)
    wait(1, pin, 0)
    mov(x, isr)
    label("delay")
    jmp(x_dec, "delay")
    mov(x, osr)
    set(pins, 1)
    label("width")
    jmp(x_dec, "width")
    set(pins, 0)
    wrap()


class Pulses:
    """Pulses on the pin `gate`, `delay_us` after each rising edge of the pin `exposure`, until `end`."""

    def __init__(self, exposure: object, gate: object, delay_us: float, width_us: float) -> None:
        self._machine = rp2.StateMachine(
            0, _program, freq=TICKS_PER_US * 1_000_000, in_base=exposure, set_base=gate
        )
        self._machine.put(max(round(delay_us * TICKS_PER_US) - DELAY_OVERHEAD, 0))
        self._machine.put(round(width_us * TICKS_PER_US) - WIDTH_OVERHEAD)
        self._machine.active(1)

    def end(self) -> None:
        """Stop the pulses; the caller must take the pin back."""
        self._machine.active(0)
