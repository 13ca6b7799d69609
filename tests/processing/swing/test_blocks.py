"""Swings do not depend on the division into blocks, come in time, and memory does not grow."""

import tracemalloc
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from processing.swing import HalfCycle, TurningPointDetector, compile_kernels
from processing.swing.arc import _walk_kernel
from processing.swing.half_cycle_fit import fit_half_cycle
from processing.swing.mode_fit import _equations
from processing.swing.prediction import predict
from tests.processing.swing.truth import Record, contact_decay, damped_sinusoid, detect


@cache
def troubled_record() -> Record:
    """A release, friction, a gap, a burst, lost spots, a kick: every path of the detector."""
    rng = np.random.default_rng(21)
    record = contact_decay("steel", 34, noise=0.02, rng=rng, frames_per_s=40.0, start_s=9.0, hold=True)
    t = record.time_s
    record = record.keep((t < 40.0) | (t > 41.0))
    t = record.time_s
    burst = np.where((t > 24.0) & (t < 32.0), 90.0 * np.sin(31.0 * t), 0.0)
    lost = np.where(rng.random(len(t)) < 0.05, np.nan, 0.0)
    kick = np.where(t > 55.1, 30.0 * np.cos(1.5 * t), 0.0)
    return record.plus(burst + lost + kick)


@cache
def whole() -> list[HalfCycle]:
    """Its half-cycles, of one block."""
    return detect(troubled_record(), block=len(troubled_record().times_ns))


def same(a: list[HalfCycle], b: list[HalfCycle]) -> bool:
    """Bit for bit (NaN equals NaN)."""
    return repr(a) == repr(b)


@settings(max_examples=5, deadline=None)
@example([*range(5000)])
@example([*range(0, 5000, 7)])
@given(st.deferred(lambda: st.lists(st.integers(0, len(troubled_record().times_ns)), max_size=30)))
def test_any_blocks(cuts: list[int]) -> None:
    record = troubled_record()
    edges = [0, *sorted(cut for cut in cuts if cut < len(record.times_ns)), len(record.times_ns)]
    detector = TurningPointDetector()
    half_cycles: list[HalfCycle] = []
    for i, j in pairwise(edges):
        half_cycles += detector.update(record.times_ns[i:j], record.deflection[i:j], record.u_deflection[i:j])
    # the record is troublesome
    assert len({s.flags for s in whole()}) >= 3
    assert len(whole()) > 25
    assert same(half_cycles + detector.finish(), whole())


def test_a_swing_is_out_within_a_quarter_period_of_its_end() -> None:
    record = damped_sinusoid(np.random.default_rng(22), 300.0, 100.0, 40)
    detector = TurningPointDetector()
    waits = []
    for i in range(len(record.times_ns)):
        for half_cycle in detector.update(
            record.times_ns[i : i + 1], record.deflection[i : i + 1], record.u_deflection[i : i + 1]
        ):
            # the half-cycle ends a quarter period (1 s) after its turning point
            end_ns = half_cycle.turn_time_ns + 1_000_000_000
            waits.append((half_cycle.index, (record.times_ns[i] - end_ns) * 1e-9))
    later = [wait for index, wait in waits if index > 4]
    assert max(later) < 0.05
    # the first ones come together, when the fourth whole one is complete
    assert max(wait for _, wait in waits) < 4 * 2.0 + 1.0


@pytest.mark.parametrize("swing_px", [300.0, 0.0])
def test_memory_stays_flat_on_an_endless_stream(swing_px: float) -> None:
    """Also while nothing swings."""
    detector, rng, per_block = TurningPointDetector(), np.random.default_rng(23), 4000
    u, peaks, count = np.full(per_block, 0.02), [], 0
    tracemalloc.start()
    for k in range(40):
        t = (np.arange(per_block) + k * per_block) * 0.01
        deflection = swing_px * np.cos(0.5 * np.pi * t) + 0.02 * rng.standard_normal(per_block)
        count += len(detector.update(np.round(t * 1e9).astype(np.int64), deflection, u))
        peaks.append(tracemalloc.get_traced_memory()[0])
    tracemalloc.stop()
    assert count > 750 or not swing_px
    assert max(peaks[20:]) < max(peaks[:20]) + 100_000


def test_compiles_all_that_a_measurement_needs() -> None:
    compile_kernels()
    kernels: tuple[Any, ...] = (fit_half_cycle, predict, _walk_kernel, _equations)
    before = [len(kernel.signatures) for kernel in kernels]
    assert min(before) > 0
    detect(damped_sinusoid(np.random.default_rng(25), 300.0, 100.0, 40))
    assert [len(kernel.signatures) for kernel in kernels] == before
