"""The panels Calibrate and Runs in a real browser: a lever typed in, a record named, old sessions."""

import contextlib
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("nicegui", reason="rig desk is not installed: pip install '.[desk]'")

from calibration import read_calibration
from rig.desk.sessions import SessionIndex, served_file
from rig.measure.session_file import RunState, SessionFile
from rig.settings import load_configuration
from tests.rig.command_line import SAMPLES, rig
from tests.rig.desk.desk_page import Page, desk_page
from tests.rig.view.headless_browser import HeadlessBrowser

pytestmark = [pytest.mark.slow, pytest.mark.timeout(180)]
RIG = """
[session]
output = "runs"
sample = "steel on K8"
operator = "A. Person"
[camera]
driver = "simulated"
frame_rate_hz = 25
exposure_us = 100.0
[instrument]
# no fit of a contact, and none of its figures
kind = "tomlinson"
[simulation]
max_duration_s = 4
[simulation.sensor]
width_px = 160
height_px = 640
[simulation.release]
way = "by command"
[simulation.fast]
amplitude_arcsec = 0.0
"""


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a rig at rest, a session that was made, and one that was interrupted."""
    place = tmp_path_factory.mktemp("desk")
    (place / "rig.toml").write_text(RIG, encoding="utf-8")
    done = rig("run", place / "rig.toml", "--record-only", "-o", place / "clamped.mcap", "--seconds", "4")
    assert done.returncode == 0, done.stderr
    # without a lever: of a fit of a contact there would be figures, which nobody looks at
    shutil.copytree(SAMPLES / "uncalibrated", place / "runs" / "older")
    shutil.copy(SAMPLES / "first" / "session.json", place / "runs" / "older")
    # a session of two runs, of which Rerun shows one
    shutil.copy(SAMPLES / "first" / "run-1.mcap", place / "runs" / "older" / "run-2.mcap")
    config = load_configuration(place / "rig.toml").model_dump(mode="json")
    broken = place / "runs" / "broken"
    broken.mkdir()
    killed = SessionFile.create(broken, place / "rig.toml", 1, config)
    killed.note(1, "run-1.mcap", RunState.RECORDING)
    killed.close()
    return place


@pytest.fixture(scope="module")
def page(place: Path, browser: HeadlessBrowser) -> Iterator[Page]:
    with contextlib.chdir(place), desk_page(browser, place / "rig.toml") as (_, page):
        yield page


def test_a_lever_is_typed_in_and_a_record_is_named(page: Page, place: Path) -> None:
    page.click("Calibrate")
    page.wait_text("Lever: from px to radians")
    ladder = place / "geometry.toml"
    ladder.write_text("[geometry]\narm_m = -1.0\npixel_pitch_m = 4.8e-6\n")
    page.fill("lever given", ladder.name)
    page.click("File it")
    page.wait_text("arm_m = -1.0: should be greater than 0")
    page.click("close")
    page.wait("document.querySelector('.errors > *') === null")
    ladder.write_text("[geometry]\narm_m = 1.0\nu_arm_m = 1e-3\npixel_pitch_m = 4.8e-6\n")
    for typed, said in (
        ("soon", "--valid-days soon: should be a number"),
        ("1e9", "should be from 0.01"),
    ):
        page.fill("lever days", typed)
        page.click("File it")
        page.wait_text(said)
        assert "lever-001.toml" not in page.text()
        page.click("close")
        # one that is just going away would be closed in place of the next
        page.wait("document.querySelector('.errors > *') === null")
    page.fill("lever days", "30")
    page.click("File it")
    page.wait_text("lever-001.toml")
    page.wait_text("contribution, %")
    found = read_calibration(place / "calibrations" / "lever-001.toml", "lever")
    assert found.made_by == "A. Person"
    assert (found.valid_until - found.measured_at).days == 30
    assert found.values["arm_m"] == pytest.approx(1.0)
    page.click("pointing")
    page.wait_text("Clamp the pendulum, close the cover")
    page.click("File it")
    page.wait_text("name its file or record")
    page.fill("pointing given", "clamped.mcap")
    page.click("File it")
    page.wait_text("x.claimed_ratio")
    assert read_calibration(place / "calibrations" / "pointing-001.toml", "pointing").sources


def test_sessions_are_listed_reported_and_resumed(page: Page, place: Path) -> None:
    page.click("Runs")
    page.wait_text("older")
    page.wait_text("interrupted")
    page.wait_text("mark a session")
    page.key("o")
    page.wait_text("no session is marked; mark one in the list")
    page.mark("broken")
    page.click("Resume")
    page.wait_text("The laser will be lit")
    page.in_dialog()
    page.wait_text("1 of 1")
    page.wait_text("last session complete: broken")
    policy = page.ask(
        "fetch('/sessions/broken/report.html').then(r => r.headers.get('content-security-policy'))"
    )
    assert "sandbox" in policy, "a report that came from elsewhere runs no script at the desk"
    assert page.ask("fetch('/sessions/broken/run-1.mcap').then(r => r.status)") == 404
    page.mark("older")
    page.wait_text("older is marked")
    page.click("Report")
    page.wait_text("rig report: ")
    assert page.wait("!document.body.innerText.includes('rig report: runs')")
    page.click("Rerun")
    page.wait_text("open what rig view shows")
    with page.browser.another() as tab:
        around = Page(tab)
        tab.open(str(page.ask("location.origin")) + "/rerun")
        around.wait("document.querySelector('iframe') && document.getElementById('light-off')")
        page.click("End it")
        # Rerun's own page says nothing when its server is gone
        around.wait_text("not connected: rig view has ended")
    page.browser.open(str(page.ask("location.origin")) + "/sessions/broken/report.html")
    page.wait("document.images.length > 0 && [...document.images].every(image => image.naturalWidth > 0)")


def test_only_reports_below_the_folder_are_served(tmp_path: Path) -> None:
    output = tmp_path / "runs"
    (output / "a").mkdir(parents=True)
    (output / "a" / "report.html").touch()
    (output / "a" / "run-1.mcap").touch()
    (tmp_path / "secret.html").touch()
    (output / "link.html").symlink_to(tmp_path / "secret.html")
    assert served_file(output, "a/report.html") == (output / "a" / "report.html").resolve()
    for name in (
        "a/run-1.mcap",
        "../secret.html",
        "link.html",
        "a",
        "none.html",
        str(tmp_path / "secret.html"),
        "a/\0report.html",
        "a" * 5000 + ".html",
        "a/" * 3000 + "b.html",
    ):
        assert served_file(output, name) is None


@pytest.mark.parametrize(
    ("states", "shown"),
    [
        ([], "no run made"),
        (["recording"], "interrupted"),
        (["stopped"], "stopped"),
        (["complete", "stopped"], "stopped"),
        (["complete", "failed"], "failed"),
        (["complete"], "interrupted"),
        (["interrupted"], "interrupted"),
        (["stopped", "recording"], "interrupted"),
        (["complete", "complete"], "complete"),
    ],
)
def test_only_what_was_killed_is_called_interrupted_and_whatever_lacks_runs_is_resumed(
    tmp_path: Path, states: list[Any], shown: str
) -> None:
    folder = tmp_path / "session"
    folder.mkdir()
    file = SessionFile.create(folder, tmp_path / "rig.toml", 2, {})
    for number, state in enumerate(states, 1):
        file.note(number, f"run-{number}.mcap", state)
    file.close()
    index = SessionIndex(tmp_path)
    index.look()
    (row,) = index.rows(None)
    assert row.state == shown
    # as rig run --resume does; one that was frozen and then stopped, too
    assert row.resumable is (shown not in ("no run made", "complete"))
    (row,) = index.rows(folder)
    assert row.state == "running"


def test_sessions_are_found_by_words(tmp_path: Path) -> None:
    for number in range(30):
        folder = tmp_path / f"s{number:02d}"
        folder.mkdir()
        stated = {
            "session": {"sample": "Steel" if number % 2 else "ruby", "operator": f"Person-{number:02d}-x"}
        }
        file = SessionFile.create(folder, tmp_path / "rig.toml", 1, stated)
        file.note(1, "run-1.mcap", RunState.COMPLETE)
        file.close()
        os.utime(folder / "session.json", (number, number))
    index = SessionIndex(tmp_path)
    index.look()
    assert [row.name for row in index.rows(None, "steel")][-3:] == ["s05", "s03", "s01"]
    assert len(index.rows(None, "steel")) == 15
    assert [row.name for row in index.rows(None, "PERSON-12-X complete")] == ["s12"]
    assert index.rows(None, "person-12-x failed") == []
    shutil.rmtree(tmp_path / "s12")
    os.utime(tmp_path / "s00" / "session.json", (99, 99))
    shutil.copy(SAMPLES / "series" / "results.json", tmp_path / "s00")
    index.look()
    rows = index.rows(None)
    assert len(rows) == 29
    assert rows[0].name == "s00", "what was written last is the newest"
    assert rows[0].b == "0.0299 ± 0.0026", "results come after their session"


def test_a_file_that_is_no_session_is_listed_with_what_is_wrong(tmp_path: Path) -> None:
    (tmp_path / "odd").mkdir()
    (tmp_path / "odd" / "session.json").write_text("{", encoding="utf-8")
    index = SessionIndex(tmp_path)
    index.look()
    (row,) = index.rows(None)
    assert "cannot be read" in row.state
