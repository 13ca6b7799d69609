"""A changed key has an effect if it is read where the work is done; to copy it reads nothing."""

from functools import cache

import pytest

from processing.errors import ConfigurationError
from rig.settings import Configuration, KeyUseMonitor, validate_configuration
from tests.rig.settings.test_every_key import STATED, leaves, value_of

KEYS = [key for key, _ in leaves() if key.partition(".")[0] in STATED]


@cache
def stated() -> Configuration:
    return validate_configuration({"camera": {"driver": "files"}, **STATED}, "test")


@pytest.mark.parametrize("key", KEYS)
def test_a_key_is_read_when_its_value_is_taken(key: str) -> None:
    config = stated()
    key_monitor = KeyUseMonitor(config, [f"{key}=1", "camera.driver=files"], "")
    assert key_monitor.config.model_copy().camera is key_monitor.config.camera
    assert key_monitor.unread == [key, "camera.driver"]
    assert value_of(key_monitor.config, key) == value_of(config, key)
    assert key_monitor.unread == ["camera.driver"]
    assert key_monitor.config == config


def test_what_a_section_calculates_reads_its_keys() -> None:
    key_monitor = KeyUseMonitor(stated(), ["lever.arm_m=1", "lever.u_skew=0", "instrument.period_s=2"], "")
    assert key_monitor.config.lever is not None
    assert key_monitor.config.lever.without_skew().rad_per_px() > 0
    assert key_monitor.unread == ["lever.u_skew", "instrument.period_s"]
    key_monitor.config.instrument.description()
    assert key_monitor.unread == ["lever.u_skew"]


def test_a_whole_section_is_read_with_any_of_its_keys() -> None:
    key_monitor = KeyUseMonitor(stated(), ["materials={}", "timebase={}", "shutter={}"], "")
    assert key_monitor.config.timebase is not None
    assert key_monitor.config.materials["mine"].poisson_ratio == 0.3
    assert key_monitor.config.timebase.camera_rate == 1.0
    assert key_monitor.unread == ["shutter"]


def test_every_key_without_effect_gets_a_line() -> None:
    keys = ("lever.arm_m", "session.runs", "fit.robust")
    here, there = (KeyUseMonitor(stated(), [f"{key}=1" for key in keys], "try elsewhere") for _ in range(2))
    here.refuse_read()
    assert not here.config.fit.robust
    assert there.config.session.runs == 1
    with pytest.raises(ConfigurationError) as error:
        here.refuse_unread()
    assert str(error.value).splitlines() == [
        f"--set {key}: has no effect here; try elsewhere" for key in keys[:2]
    ]
    with pytest.raises(ConfigurationError, match=r"^--set lever.arm_m: has no effect here; try elsewhere$"):
        here.refuse_unread([there])
    with pytest.raises(ConfigurationError, match=r"^--set session.runs: has no effect here"):
        there.refuse_read()
