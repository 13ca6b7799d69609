"""Decays with known turning points: damped sinusoids and the integrated equation of motion."""

import math
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np
from numpy.typing import NDArray

from processing.swing import HalfCycle, KnownMotion, TurningPointDetector
from processing.units import ARCSEC_RAD
from tests.processing.fit.decays import paper_pair
from tests.processing.fit.driven import driven_path

Floats = NDArray[np.float64]
PX_PER_RAD = 250.0 / (124.0 * ARCSEC_RAD)


@dataclass(frozen=True)
class Record:
    """Samples with their noise, and the true turning points."""

    times_ns: NDArray[np.int64]
    deflection: Floats
    u_deflection: Floats
    turn_time_s: Floats
    turn_amplitude: Floats

    @cached_property
    def time_s(self) -> Floats:
        return self.times_ns * 1e-9

    def keep(self, kept: NDArray[np.bool_]) -> "Record":
        """Only these samples."""
        of_samples = {name: getattr(self, name)[kept] for name in ("times_ns", "deflection", "u_deflection")}
        return replace(self, **of_samples)

    def plus(self, extra: Floats) -> "Record":
        """Something added to the deflection."""
        return replace(self, deflection=self.deflection + extra)


def sample_times_ns(duration_s: float, frames_per_s: float) -> NDArray[np.int64]:
    return np.round(np.arange(math.floor(duration_s * frames_per_s)) * (1e9 / frames_per_s)).astype(np.int64)


def damped_sinusoid(
    rng: np.random.Generator,
    first: float,
    last: float,
    half_cycles: int,
    frames_per_s: float = 100.0,
    noise: float = 0.02,
    period_s: float = 4.0,
) -> Record:
    """From amplitude `first` to `last` in so many half-cycles, about 12.3, with a turning point at 0.3 s."""
    rate = 2.0 * math.pi / period_s
    damping = math.log(first / last) / (half_cycles * period_s / 2.0)
    times_ns = sample_times_ns((half_cycles + 1) * period_s / 2.0, frames_per_s)
    t = times_ns * 1e-9 - 0.3
    lag = math.atan(damping / rate)
    turns = (np.arange(half_cycles + 2) * math.pi - lag) / rate
    return Record(
        times_ns,
        12.3 + first * np.exp(-damping * t) * np.cos(rate * t) + noise * rng.standard_normal(len(t)),
        np.full(len(t), noise),
        turns + 0.3,
        first * np.exp(-damping * turns) * math.cos(lag),
    )


def contact_decay(
    contact: str,
    half_cycles: int,
    frames_per_s: float = 100.0,
    noise: float = 0.0,
    rng: np.random.Generator | None = None,
    start_s: float = 0.37,
    hold: bool = False,
) -> Record:
    """Eq. 4 with the moments of Eqs. 1 and 3, integrated, in px; held before `start_s`, a whole frame."""
    times_s, turns_rad, path_rad = _integrated(contact, frames_per_s)
    ahead = round(start_s * frames_per_s)
    turn_time_s = start_s + times_s[: half_cycles + 1]
    count = math.floor(turn_time_s[-1] * frames_per_s) + 1
    deflection = PX_PER_RAD * np.concatenate([np.full(ahead, path_rad[0]), path_rad])[:count]
    if rng is not None:
        deflection = deflection + 7.0 + noise * rng.standard_normal(count)
    whole = Record(
        np.round(np.arange(count) * (1e9 / frames_per_s)).astype(np.int64),
        deflection,
        np.full(count, noise if noise else 1e-3),
        turn_time_s,
        PX_PER_RAD * np.abs(turns_rad[: half_cycles + 1]),
    )
    return whole if hold else whole.keep(np.arange(count) >= ahead)


@cache
def _integrated(contact: str, frames_per_s: float) -> tuple[Floats, Floats, Floats]:
    """Turning times (s) and points (rad), and positions (rad) in frames, of a whole decay without noise."""
    return driven_path(
        *paper_pair(contact), q=0.0, seed=0, first_arcsec=124.0, last_arcsec=1.0, frames_per_s=frames_per_s
    )


def air(count: int, rate_hz: float, rng: np.random.Generator) -> Floats:
    """0.02 arcsec of 1/f noise from 0.01 to 10 Hz."""
    frequencies_hz = np.fft.rfftfreq(2 * count, 1 / rate_hz)
    inside = (frequencies_hz > 0.01) & (frequencies_hz < 10.0)
    size = np.zeros(len(frequencies_hz))
    size[inside] = 0.02 * np.sqrt(count * rate_hz / 2 / (math.log(1000.0) * frequencies_hz[inside]))
    normals = rng.standard_normal((2, len(size)))
    return np.asarray(np.fft.irfft(size * (normals[0] + 1j * normals[1]), 2 * count)[:count])


def half_cycle(index: int, **changed: float) -> HalfCycle:
    """One of an even swing with half-periods of 2 s."""
    even = HalfCycle(
        index=index, turn_time_ns=2_000_000_000 * index, u_turn_time_s=1e-4, amplitude=0.1, u_amplitude=1e-5,
        half_period_s=2.0, u_half_period_s=1e-4, centre=0.0, side=1 - 2 * (index % 2), flags=0,
    )  # fmt: skip
    return replace(even, **changed)  # type: ignore[arg-type]


def detect(record: Record, block: int = 10_000, known: KnownMotion | None = None) -> list[HalfCycle]:
    """All swings of a record."""
    detector = TurningPointDetector(known)
    half_cycles: list[HalfCycle] = []
    for i in range(0, len(record.times_ns), block):
        j = i + block
        half_cycles += detector.update(record.times_ns[i:j], record.deflection[i:j], record.u_deflection[i:j])
    return half_cycles + detector.finish()


@dataclass(frozen=True)
class Errors:
    """Unflagged swings against the truth: errors over claimed uncertainties and over the CRLB."""

    index: NDArray[np.int64]
    amplitude: Floats
    time: Floats
    amplitude_to_crlb: Floats
    time_to_crlb: Floats

    def __len__(self) -> int:
        return len(self.index)


def errors(record: Record, half_cycles: list[HalfCycle]) -> Errors:
    """Errors of the unflagged swings.

    The Cramer-Rao bound is that of one half-cycle's own samples with all else known: for noise s and
    n samples u(A) = s sqrt(2/n), u(t) = u(A) / (A w).
    """
    rows = []
    for half_cycle in half_cycles:
        if half_cycle.flags:
            continue
        k = int(np.argmin(np.abs(record.turn_time_s - half_cycle.turn_time_ns * 1e-9)))
        neighbour = k + 1 if k + 1 < len(record.turn_time_s) else k - 1
        half_period = abs(record.turn_time_s[neighbour] - record.turn_time_s[k])
        inside = np.abs(record.time_s - record.turn_time_s[k]) < half_period / 2.0
        inside &= np.isfinite(record.deflection)
        crlb = float(record.u_deflection[inside].mean()) * math.sqrt(2.0 / max(int(inside.sum()), 1))
        amplitude_error = half_cycle.amplitude - record.turn_amplitude[k]
        time_error = half_cycle.turn_time_ns * 1e-9 - record.turn_time_s[k]
        rows.append(
            (
                k,
                amplitude_error / half_cycle.u_amplitude,
                time_error / half_cycle.u_turn_time_s,
                amplitude_error / crlb,
                time_error / (crlb * half_period / (math.pi * record.turn_amplitude[k])),
            )
        )
    table = np.array(rows).reshape(-1, 5)
    return Errors(table[:, 0].astype(np.int64), *table[:, 1:].T)


def rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
