"""Sessions used by several tests of reports and exports."""

import contextlib
import os
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest

from rig.analysis import AnalysedRun, analyse_record
from rig.measure.session import measure_session
from rig.settings import load_configuration
from tests.rig.command_line import CONFIGS, SMALL, figures_are_drawn, verdicts_are_made

APPARATUS = (
    "lever.arm_m=1.0",
    "lever.u_arm_m=0.001",
    "lever.pixel_pitch_m=4.8e-6",
    "pendulum.mass_kg=0.406",
    "pendulum.u_mass_kg=0.0002",
    "pendulum.ball_radius_m=6.05e-3",
    "pendulum.u_ball_radius_m=2e-6",
)
"""The demonstration's own apparatus, with uncertainties stated."""


@pytest.fixture(autouse=True)
def rig_states(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where the states of rigs are kept: what one test has latched is nothing to another."""
    place = tmp_path_factory.mktemp("state")
    monkeypatch.setenv("XDG_STATE_HOME", str(place))
    monkeypatch.setenv("XDG_DATA_HOME", str(place / "data"))
    return place


@pytest.fixture(autouse=True, scope="module")
def what_nobody_looks_at() -> Iterator[None]:
    """A fit's verdicts, and figures, are made for tests that want `verdicts` or `figures`."""
    with verdicts_are_made(False), figures_are_drawn(False):
        yield


@pytest.fixture
def verdicts() -> Iterator[None]:
    """For a test that looks at them."""
    with verdicts_are_made(True):
        yield


@pytest.fixture
def figures() -> Iterator[None]:
    """For a test that looks at them."""
    with figures_are_drawn(True):
        yield


@pytest.fixture
def no_fits_meanwhile(monkeypatch: pytest.MonkeyPatch) -> None:
    """For a test that looks at results alone: nothing is fitted while the run goes on."""
    monkeypatch.setattr("rig.measure.run.live_posterior", lambda _: None)


@pytest.fixture(scope="session")
def measured_series(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A session of two runs of 70 simulated seconds from (small) frames on, as `rig run` leaves it.

    All workers share it: nobody writes there.
    """
    shared = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        shared = shared.parent
    folder = shared / "series"
    with alone(shared / "series.lock"):
        if not (shared / "series-is-whole").exists():
            source = CONFIGS / "demo.toml"
            small = (f"{key}={value}" for key, value in SMALL.items())
            wanted = (*small, "session.max_duration_s=70", "session.runs=2", *APPARATUS)
            with verdicts_are_made(True), figures_are_drawn(True):
                assert measure_session(load_configuration(source, wanted), source, folder) == 0
            (shared / "series-is-whole").touch()
    return folder


@pytest.fixture(scope="session")
def analysed_run(measured_series: Path) -> AnalysedRun:
    """The first run of the measured series as `rig fit` finds it, without verdicts."""
    with verdicts_are_made(False):
        return analyse_record(measured_series / "run-1.mcap")


@pytest.fixture(scope="session")
def analysed_series(measured_series: Path, analysed_run: AnalysedRun) -> Sequence[AnalysedRun]:
    """Both runs."""
    with verdicts_are_made(False):
        return analysed_run, analyse_record(measured_series / "run-2.mcap")


@contextlib.contextmanager
def alone(lock: Path) -> Iterator[None]:
    """One process at a time, where the system has such locks; elsewhere tests run in one process."""
    with lock.open("w") as file:
        with contextlib.suppress(ImportError):
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX)
        yield
