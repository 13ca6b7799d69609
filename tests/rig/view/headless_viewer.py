"""The Rerun viewer without a screen, drawn by Mesa's software Vulkan."""

import contextlib
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from rerun.experimental import ViewerClient, ViewerState

from rig.interruption import LOOPBACK, free_port, process_group_options
from rig.view.rerun_program import program, quiet_environment

ICD_FOLDERS = ("/usr/share/vulkan/icd.d", "/usr/local/share/vulkan/icd.d", "/etc/vulkan/icd.d")
CLEAR_WITHIN_S = 60.0
"""The viewer's start-up messages cover a corner for some 9 s, and for longer on a busy machine."""


def software_vulkan() -> Path | None:
    """Description of Mesa's software Vulkan driver, where it is installed."""
    found = [path for folder in ICD_FOLDERS for path in sorted(Path(folder).glob("lvp_icd*.json"))]
    return found[0] if found else None


def require_software_vulkan() -> None:
    """Skip the test where no picture can be drawn."""
    if not sys.platform.startswith("linux"):
        pytest.skip("the headless viewer is tested on Linux, with Mesa's software Vulkan")
    if software_vulkan() is None:
        pytest.skip("Mesa's software Vulkan is not installed (Debian: mesa-vulkan-drivers, libvulkan1)")


class HeadlessViewer:
    """A running viewer without a window."""

    def __init__(self, process: subprocess.Popen[bytes], client: ViewerClient) -> None:
        self.process = process
        self.client = client

    def wait_loaded(self, limit_s: float = 40.0) -> ViewerState:
        """The viewer's state once a recording and its layout have arrived."""
        deadline = time.monotonic() + limit_s
        while True:
            state = self.client.get_state()
            if state.views and state.recordings and state.recordings[0].timelines and not state.loading:
                return state
            if time.monotonic() > deadline:
                raise TimeoutError(f"the viewer shows nothing: {state}")
            time.sleep(0.2)

    def picture_once(
        self, path: Path, good: Callable[[NDArray[np.uint8]], bool], view: str | None = None
    ) -> NDArray[np.uint8]:
        """Photograph again and again until the picture is good; the last one where it never is."""
        deadline = time.monotonic() + CLEAR_WITHIN_S
        while True:
            path.unlink(missing_ok=True)
            shown = self.picture(path, view)
            if good(shown) or time.monotonic() > deadline:
                return shown
            # a picture is drawn by the processors
            time.sleep(1.0)

    def picture(self, path: Path, view: str | None = None) -> NDArray[np.uint8]:
        """Photograph the window, or one view by its name, as (ny, nx, 3) RGB."""
        view_id = None
        if view is not None:
            view_id = next(known.view_id for known in self.client.get_state().views if known.name == view)
        self.client.save_screenshot(str(path), view_id)
        deadline = time.monotonic() + CLEAR_WITHIN_S
        picture = None
        while picture is None and time.monotonic() < deadline:
            time.sleep(0.1)
            # A file that is only half written is not a picture yet.
            picture = cv2.imread(str(path), cv2.IMREAD_COLOR) if path.exists() else None
        assert picture is not None, f"no picture at {path}"
        return np.ascontiguousarray(picture[..., ::-1]).astype(np.uint8)

    def problems(self) -> list[str]:
        """Warnings and errors that the viewer logged, but for those about drawing in software."""
        entries = (entry for entry in self.client.get_logs() if entry.level in {"WARN", "ERROR"})
        return [entry.message for entry in entries if "Software rasterizer" not in entry.message]


@contextlib.contextmanager
def headless_viewer(*arguments: str, size: str = "1500x950") -> Iterator[HeadlessViewer]:
    """A viewer with these arguments (files, ``--connect URL``), ended with the block."""
    with tempfile.TemporaryDirectory() as runtime:
        port = free_port(0)
        process = subprocess.Popen(
            [
                *(program(), "--headless", "--bind", LOOPBACK, "--port", str(port)),
                *("--window-size", size, "--hide-welcome-screen", *arguments),
            ],
            env=headless_environment(runtime),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            **process_group_options(),
        )
        try:
            yield HeadlessViewer(process, connected(port, time.monotonic() + 40.0))
        finally:
            process.kill()
            process.wait()


def headless_environment(runtime: str) -> dict[str, str]:
    """What the viewer needs to draw in software; `runtime` is a folder of its own."""
    return {
        **quiet_environment(),
        "VK_ICD_FILENAMES": str(software_vulkan()),
        "WGPU_BACKEND": "vulkan",
        "XDG_RUNTIME_DIR": os.environ.get("XDG_RUNTIME_DIR", runtime),
    }


def connected(port: int, deadline: float) -> ViewerClient:
    """A viewer's remote control, as soon as it answers on its port."""
    while True:
        try:
            client = ViewerClient.connect(f"rerun+http://{LOOPBACK}:{port}/proxy")
            client.get_state()
        except (RuntimeError, OSError):
            if time.monotonic() > deadline:
                raise
            time.sleep(0.2)
        else:
            return client


def pixels_of(picture: NDArray[np.uint8], colour: str, tolerance: int = 40) -> int:
    """How many pixels of an RGB picture have the ``#RRGGBB`` colour, within a tolerance a channel."""
    wanted = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)])
    return int(np.count_nonzero((np.abs(picture.astype(int) - wanted) <= tolerance).all(axis=2)))
