"""After the preparation no kernel is compiled while frames arrive."""

import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest

from processing.spot import SensorModel
from rig.instrument import provenance

# A process of its own: here other tests have compiled things already.
PROGRAM = """
import gc, json, sys
import numpy as np
from numba.core.dispatcher import Dispatcher
from acquisition.camera import Frame
from acquisition.record.codec import encode_window
from calibration.axes_fit import Axes
from processing.spot import SensorModel
from rig.instrument.provenance import prepare_kernels
from rig.instrument.pipeline import Optics, Pipeline

def compiled():
    return sorted(
        f"{item.py_func.__module__}.{item.py_func.__name__}{signature}"
        for item in gc.get_objects() if isinstance(item, Dispatcher) for signature in item.signatures
    )

def followed(full_scale):
    sensor = SensorModel(gain_e_per_dn=10_000.0 / full_scale, read_noise_e=7.0, full_scale_dn=full_scale)
    prepare_kernels(sensor, lambda text: None)
    before = compiled()
    pipeline = Pipeline(Optics(sensor, None, Axes()), (120, 160))
    y, x = np.mgrid[0:120, 0:160]
    random = np.random.default_rng(1)
    swings = 0
    frames = []
    for k in range(900):
        phase = 2 * np.pi * k * 0.05 / 4.071
        centre = 59.5 + 25 * 0.97 ** (k * 0.05 / 4.071) * np.cos(phase)
        off = (x - 79.5 - 0.3 * np.cos(5 * phase)) ** 2 + (y - centre) ** 2
        image = 0.7 * full_scale * np.exp(-0.5 * off / 16.0)
        image = np.round(image + random.normal(0, 0.003 * full_scale, image.shape)).clip(0, full_scale)
        image = image.astype(np.uint8 if full_scale < 256 else np.uint16)
        frames.append(Frame(image, k, k * 50_000_000, k * 50_000_000))
    for start in range(0, len(frames), 50):
        block = pipeline.process(frames[start : start + 50])
        swings += len(block.half_cycles)
        for frame, spot in zip(frames[start : start + 50], block.spots):
            encode_window(0, 0, frame.image[10:-10, 40:-40].copy(), 40, 10, spot)
    swings += len(pipeline.finish()[0])
    return swings, len(before), [name for name in compiled() if name not in before]

print(json.dumps([followed(255.0), followed(4095.0)]))
"""


@pytest.mark.slow
def test_nothing_is_compiled_while_frames_come() -> None:
    """Of 8 bits, then of 12: what depends on no width of the pixels is found with the first."""
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], capture_output=True, text=True, timeout=600, check=False
    )
    assert done.returncode == 0, done.stderr
    for half_cycles, known, late in json.loads(done.stdout):
        assert half_cycles > 15
        assert known > 10
        assert late == []


def test_a_compilation_that_is_not_kept_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []

    @contextmanager
    def compiling(call: Callable[[bool], None]) -> Iterator[None]:
        call(False)
        yield

    monkeypatch.setattr(provenance, "notify_of_compilation", compiling)
    sensor = SensorModel(gain_e_per_dn=40.0, read_noise_e=7.0, full_scale_dn=255.0)
    provenance.prepare_kernels(sensor, said.append)
    (line,) = said
    assert "at every start: no cache can be written; NUMBA_CACHE_DIR can name one" in line
