"""Runs suite.py in a network namespace; skips with the reason if that is not possible."""

import sys
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from xml.etree import ElementTree

import pytest

from acquisition.cameras.aravis.camera import AravisCamera
from processing.errors import DeviceError
from tests.acquisition.cameras.aravis.namespace import PROJECT, Missing, run_alone

TIME_LIMIT_S = 420.0
SUITE = PROJECT / "tests" / "acquisition" / "cameras" / "aravis" / "suite.py"


GONE = "(refused or dead or listed or lost)"
PARTS = (f"TestConformance or {GONE}", f"not TestConformance and not {GONE}")


@pytest.mark.slow
@pytest.mark.timeout(TIME_LIMIT_S)
def test_the_suite_passes_against_the_fake_gige_camera(tmp_path: Path) -> None:
    """Each part has a network and a camera of its own; they mostly wait."""
    with ThreadPoolExecutor() as together:
        passed = {name for names in together.map(partial(passed_of, tmp_path), PARTS) for name in names}
    assert {
        "test_unplugging_is_noticed_and_survived",
        "test_start_and_stop_fifty_times",
        "test_frames_come_whole_while_their_ids_roll_over",
        "test_the_run_goes_on_when_the_camera_comes_back",
    } <= passed
    assert len(passed) >= 35


def passed_of(folder: Path, part: str) -> set[str]:
    """Names of the tests that passed, none having failed."""
    own = folder / str(PARTS.index(part))
    own.mkdir()
    report = own / "report.xml"
    options = ["-q", "-p", "no:cacheprovider", "-m", "", "-k", part, f"--junitxml={report}"]
    try:
        done = run_alone(["-m", "pytest", str(SUITE), *options], own, TIME_LIMIT_S)
    except Missing as missing:
        pytest.skip(str(missing))
    assert done.returncode == 0, done.stdout[-6000:] + done.stderr[-2000:]
    outcomes = {
        case.get("name", ""): [kind.tag for kind in case]
        for case in ElementTree.parse(report).iter("testcase")
    }
    return {name for name, kinds in outcomes.items() if not kinds}


def test_what_is_missing_is_said_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "gi", None)  # as if it were not installed
    with pytest.raises(DeviceError, match=r"apt install gir1\.2-aravis-0\.8 python3-gi") as refused:
        AravisCamera().open()
    assert "\n" not in str(refused.value)
