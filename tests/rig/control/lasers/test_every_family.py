"""Every laser driver passes the same tests, each with a simulated instrument of its family."""

import itertools
import re
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from processing.errors import DeviceError
from rig.control.controller import InterlockOpen, PowerLimit
from rig.control.lasers import LASERS, LaserRefused
from rig.control.serial_port import PortLost, ReplyTimeout
from tests.rig.control.lasers.pairs import FAMILIES, LIMIT, STRAYED, Pair, Ports, laser_for


def test_opened_dark_lit_set_read_dark_again_and_closed(pair: Pair) -> None:
    identity = pair.laser.open()
    assert (identity.model, identity.serial) == FAMILIES[pair.kind][1:]
    assert not pair.instrument.on
    pair.set(0.020)
    pair.laser.enable()
    assert pair.instrument.on
    assert pair.instrument.set_value == pytest.approx(0.020, rel=1e-6)
    state = pair.laser.state()
    assert state.on
    assert state.interlock_closed
    assert state.fault == ""
    read = state.current_a if pair.kind in ("thorlabs4000", "ldc500") else state.power_w
    assert read == pytest.approx(0.020, rel=1e-4)
    pair.laser.off()
    assert not pair.instrument.on
    assert not pair.laser.state().on
    pair.laser.enable()
    pair.laser.close()
    assert not pair.instrument.on
    with pytest.raises(PortLost, match="not open"):
        pair.laser.state()
    pair.laser.close()


def test_open_interlock_forbids(pair: Pair) -> None:
    pair.laser.open()
    pair.instrument.interlock_closed = False
    pair.instrument.received.clear()
    with pytest.raises(InterlockOpen):
        pair.laser.enable()
    # Read before enabling: the command that lights was not sent at all.
    assert not any(command.endswith("ON") or command == "l1" for command in pair.instrument.received)
    assert not pair.laser.state().interlock_closed


def test_never_above_the_limit_whatever_is_asked(pair: Pair) -> None:
    pair.laser.open()
    pair.laser.enable()

    @settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck), database=None)
    @given(st.one_of(st.floats(), st.floats(0.0, 2 * LIMIT), st.floats(LIMIT * 0.999999, LIMIT * 1.000001)))
    @example(LIMIT)
    @example(1.5e-5)
    @example(1.99e-5)
    def check(value: float) -> None:
        if 0.0 <= value <= LIMIT:
            pair.set(value)
        else:
            with pytest.raises(PowerLimit, match="is allowed by max_"):
                pair.set(value)

    check()
    assert pair.instrument.highest_lit <= LIMIT
    assert pair.instrument.highest_lit == pytest.approx(LIMIT, rel=1e-6)


def test_the_other_unit_a_stuck_output_and_silence_are_said(pair: Pair) -> None:
    pair.laser.open()
    if pair.kind in ("thorlabs4000", "ldc500"):
        with pytest.raises(LaserRefused, match="current_a, not power_w"):
            pair.laser.set_power_w(0.001)
    else:
        with pytest.raises(LaserRefused, match="power_w, not current_a"):
            pair.laser.set_current_a(0.001)
    pair.laser.enable()
    pair.instrument.stuck_on = True
    with pytest.raises(LaserRefused, match="still emits"):
        pair.laser.off()
    pair.instrument.silent = True
    with pytest.raises(ReplyTimeout, match="check port"):
        pair.laser.state()


@pytest.mark.parametrize(("kind", "there"), sorted(itertools.permutations(LASERS, 2)))
def test_the_wrong_family_is_not_driven(ports: Ports, kind: str, there: str) -> None:
    instrument = FAMILIES[there][0]()
    laser = laser_for(kind, ports.plug_in(instrument))
    with pytest.raises(DeviceError):
        laser.open()
    assert not any(word.upper().endswith((" ON", " 1")) for word in instrument.received)


CASES = [(kind, change, named) for kind, changes in STRAYED.items() for change, named in changes]


@pytest.mark.parametrize(("kind", "change", "named"), CASES)
def test_what_changes_light_behind_the_program_is_set_and_later_refused(
    ports: Ports, kind: str, change: Callable[[Any], None], named: str
) -> None:
    instrument = FAMILIES[kind][0]()
    laser = laser_for(kind, ports.plug_in(instrument))
    laser.open()
    assert laser.state().dark_reason == ""
    change(instrument)
    assert named in laser.state().dark_reason
    with pytest.raises(LaserRefused, match=f"{named}.*not switched on"):
        laser.enable()
    assert not instrument.on
    laser.close()


def test_more_light_or_current_than_allowed_is_seen_and_not_lit(pair: Pair) -> None:
    pair.laser.open()
    pair.set(0.020)
    pair.laser.enable()
    # a meter errs by some percent
    for measured in (None, LIMIT * 1.03):
        pair.instrument.measures = measured
        assert pair.laser.state().dark_reason == ""
    pair.instrument.measures = LIMIT * 1.1
    assert "allowed by max_" in pair.laser.state().dark_reason
    pair.instrument.measures = 0.050
    what = r"50 m[AW] measured, 30 m[AW] allowed by max_"
    assert re.search(what, pair.laser.state().dark_reason)
    pair.laser.off()
    with pytest.raises(LaserRefused, match=what):
        pair.laser.enable()
    assert not pair.instrument.on
