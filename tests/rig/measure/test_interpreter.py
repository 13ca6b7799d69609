"""What Python does while frames arrive, and that it does as before afterwards."""

import gc
import sys
from pathlib import Path

import pytest

from processing.errors import DeviceError
from rig.measure import session
from rig.measure.run_parts import ready_for_frames
from tests.rig.command_line import CONFIGS, rig


@pytest.fixture(autouse=True)
def all_objects_are_searched() -> None:
    """Also those that the tests' own process leaves out."""
    gc.unfreeze()


@pytest.mark.slow
def test_libraries_are_left_out_of_searches_while_a_camera_is_live() -> None:
    usual_turn_s = sys.getswitchinterval()
    # what other tests have left is no library; what a search sets free may hold more
    while gc.collect():
        pass
    libraries = len(gc.get_objects())
    with ready_for_frames(live=True):
        assert gc.get_freeze_count() > 0.9 * libraries
        assert len(gc.get_objects()) < 0.1 * libraries
        assert sys.getswitchinterval() < usual_turn_s
    with pytest.raises(ValueError, match="ended"), ready_for_frames(live=True):
        raise ValueError("ended")
    assert gc.get_freeze_count() == 0
    assert sys.getswitchinterval() == usual_turn_s
    # frames on demand pay for no search
    with ready_for_frames(live=False):
        assert gc.get_freeze_count() == 0


def test_the_search_is_over_before_a_controller_waits_for_heartbeats(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a busy machine it lasted longer than the watchdog, with the laser lit: the run made no record."""

    def opened(*_: object) -> None:
        raise DeviceError(f"libraries are left out: {gc.get_freeze_count() > 0}")

    monkeypatch.setattr(session, "Devices", opened)
    assert "libraries are left out: True" in rig("run", CONFIGS / "live.toml", "-o", tmp_path / "out").stderr
    assert gc.get_freeze_count() == 0
