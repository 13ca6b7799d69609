"""A desk of the simulated rig with controller and laser, in real time, and a tab that shows it."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.rig.command_line import CONFIGS
from tests.rig.desk.desk_page import DeskProcess, Page, desk_page
from tests.rig.view.headless_browser import HeadlessBrowser, headless_browser

RIG = f"""
extends = "{(CONFIGS / "live.toml").as_posix()}"
[session]
output = "OUTPUT"
max_duration_s = 600.0
[camera]
driver = "simulated"
frame_rate_hz = 25
[start]
way = "at once"
[simulation.sensor]
width_px = 160
height_px = 640
[simulation.release]
way = "let go"
"""


def simulated_rig(folder: Path, more: str = "") -> Path:
    """The configuration of a simulated rig with more tables, whose sessions go into `runs` beside it."""
    path, output = folder / "rig.toml", (folder / "runs").as_posix()
    path.write_text(
        f'[camera]\ndriver = "simulated"\n[session]\noutput = "{output}"\n{more}', encoding="utf-8"
    )
    return path


def write_rig(folder: Path, more: str = "") -> Path:
    """The configuration of RIG in a folder with more tables, whose sessions go into `runs` beside it."""
    path = folder / "rig.toml"
    path.write_text(RIG.replace("OUTPUT", (folder / "runs").as_posix()) + more, encoding="utf-8")
    return path


@pytest.fixture(scope="session")
def desk_configuration(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Writes a configuration with more tables, in a folder of its own, where its sessions go, too."""
    pytest.importorskip("nicegui", reason="rig desk is not installed: pip install '.[desk]'")

    def write(more: str = "") -> Path:
        return write_rig(tmp_path_factory.mktemp("desk"), more)

    return write


@pytest.fixture(scope="session")
def browser() -> Iterator[HeadlessBrowser]:
    """One browser for all tests of the desk; each page is a tab of its own."""
    with headless_browser() as opened:
        yield opened


@pytest.fixture(scope="session")
def desk_file(desk_configuration: Callable[[str], Path]) -> Path:
    """The configuration of `shown`."""
    return desk_configuration("")


@pytest.fixture(scope="session")
def desk_output(desk_file: Path) -> Path:
    """Where `shown` looks for sessions."""
    return desk_file.parent / "runs"


@pytest.fixture(scope="session")
def shown(desk_file: Path, browser: HeadlessBrowser) -> Iterator[tuple[DeskProcess, Page]]:
    """A desk with its page, on which nothing is measured; one for the tests of several files."""
    with desk_page(browser, desk_file) as opened:
        yield opened
