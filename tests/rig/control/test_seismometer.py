"""An auxiliary seismometer at a pseudo-terminal."""

import math
import os
import pty
import tty

import pytest

from rig.control import SeismometerReader, SeismometerSettings
from rig.control.sensors import sample_of
from rig.settings import key_faults
from tests.waiting import until

LIMIT_S = 60.0


@pytest.mark.parametrize(
    ("line", "columns", "own_s", "value"),
    [
        ("12 -3.5e2", ("a", "b"), math.nan, (12.0, -350.0)),
        ("t=1.25; N=+4, E=.5", ("time_s", "n", "e"), 1.25, (4.0, 0.5)),
        ("7", ("z",), math.nan, (7.0,)),
    ],
)
def test_numbers_are_taken_in_the_order_of_the_columns(
    line: str, columns: tuple[str, ...], own_s: float, value: tuple[float, ...]
) -> None:
    sample = sample_of(line, columns, 5)
    assert sample is not None
    assert sample.host_time_ns == 5
    assert sample.components == value
    assert sample.own_time_s == own_s or (math.isnan(own_s) and math.isnan(sample.own_time_s))


@pytest.mark.parametrize("line", ["", "ready", "1 2 3", "1", "1 1e999"])
def test_a_line_of_other_numbers_is_no_sample(line: str) -> None:
    assert sample_of(line, ("a", "b"), 0) is None


def test_a_serial_instrument_is_read_line_by_line() -> None:
    master, slave = pty.openpty()
    tty.setraw(slave)
    settings = SeismometerSettings(
        kind="serial", port=os.ttyname(slave), columns=("time_s", "z"), stale_after_s=LIMIT_S
    )
    service = SeismometerReader(settings)
    assert service.stale
    samples = []

    def three() -> bool:
        # the first line may be taken for the rest of one
        os.write(master, b"0.1 5\r\n0.2 6\r\nhello\r\n")
        samples.extend(service.take_samples())
        return len(samples) >= 3 and service.lines_without_reading > 0

    with service:
        until(three)
        assert not service.stale
    os.close(master)
    os.close(slave)
    assert {(sample.own_time_s, sample.components) for sample in samples} == {(0.1, (5.0,)), (0.2, (6.0,))}
    arrived = [one.host_time_ns for one in samples]
    assert arrived == sorted(arrived)


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"seismometer.kind": "serial"}, "port is missing"),
        ({"seismometer.columns": ("time_s",)}, "one to 3 different names"),
        ({"seismometer.columns": ("a", "a")}, "one to 3 different names"),
    ],
)
def test_what_is_missing_is_said(keys: dict[str, object], said: str) -> None:
    assert said in " ".join(key_faults(keys, "seismometer"))
