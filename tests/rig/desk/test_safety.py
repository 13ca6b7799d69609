"""The light's last confirmed state is kept, and stated with its time and with who has confirmed it."""

import re
import time
from pathlib import Path

import pytest

from rig.control import LatchedTrip, Light, Loop, SafetyNow, SafetyState, TripCause
from rig.desk.follower import RigFollower
from rig.desk.lighting import Safety, lamps


@pytest.fixture
def safety(tmp_path: Path) -> Safety:
    return Safety(SafetyState(), RigFollower(tmp_path), "board")


def seen(light: Light, spot: bool | None, age_s: float = 0.1) -> SafetyNow:
    return SafetyNow(
        light=light,
        light_age_s=age_s,
        interlock=Loop.CLOSED,
        interlock_age_s=age_s,
        spot_visible=spot,
        spot_age_s=age_s,
    )


@pytest.mark.parametrize(
    ("now", "fact"),
    [
        (seen(Light.OFF, spot=False), "off, confirmed {} by board and camera"),
        (seen(Light.OFF, spot=None), "off, confirmed {} by board"),
        (
            seen(Light.INTERLOCK_OPEN, spot=False),
            "off, its interlock is open, confirmed {} by board and camera",
        ),
        # it may be off by now
        (seen(Light.ON, spot=True), "unknown; on, confirmed {} by board and camera"),
        (seen(Light.OFF, spot=True), "off, confirmed {} by board"),
    ],
)
def test_what_was_confirmed_last(safety: Safety, now: SafetyNow, fact: str) -> None:
    safety.confirm(now)
    # nothing is heard of it any more
    safety.confirm(SafetyNow())
    safety.confirm(seen(Light.ON, spot=True, age_s=9.0))
    safety.confirm(SafetyNow(light=Light.SILENT, light_age_s=0.1))
    shown = lamps(safety, "")
    assert shown["laser"]["age_s"] is None
    assert re.fullmatch(fact.format(r"\d\d:\d\d:\d\d"), str(shown["laser"]["last"]))
    assert shown["interlock"]["last"] == f"closed, confirmed {clock(safety)} by board"
    assert 0 <= float(str(shown["laser"]["last_age_s"])) < 5


def clock(safety: Safety) -> str:
    assert safety.interlock is not None
    return time.strftime("%H:%M:%S", time.localtime(safety.interlock.time_s))


def test_light_that_is_forbidden_is_said_to_be(tmp_path: Path) -> None:
    rig = SafetyState()
    safety = Safety(rig, RigFollower(tmp_path), "laser")
    assert lamps(safety, "")["laser"]["more"] == ""
    rig.latch(TripCause.PERSON, "LIGHT OFF was pressed at the desk", lit=True)
    assert isinstance(safety.trip, LatchedTrip)
    assert lamps(safety, "")["laser"]["more"] == "light forbidden until acknowledged"
