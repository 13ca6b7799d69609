"""A Chromium browser without a screen, controlled over its debugging pipe without further packages."""

import base64
import contextlib
import json
import os
import select
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from itertools import count
from pathlib import Path
from typing import IO, Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

NAMES = ("chromium", "chromium-browser", "google-chrome")
OPTIONS = (
    "--headless",
    "--remote-debugging-pipe",
    "--no-sandbox",
    "--no-first-run",
    "--disable-quic",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--window-size=1200,760",
)
WITH_WEBGL = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader")
WITHOUT = ("--disable-gpu",)
"""A page that draws on no graphics card takes half the time without an imitation of one."""

LONGEST_SILENCE_S = 150.0

# The browser takes orders on descriptor 3 and answers on 4.
REDIRECTED = 'exec "$0" "$@" 3<&0 4>&1 0</dev/null 1>&2'


class HeadlessBrowser:
    """One page of a browser; `requested`: every address it asked for, but for those its policy forbade."""

    def __init__(
        self, orders: IO[bytes], answers: IO[bytes], beside: "HeadlessBrowser | None" = None
    ) -> None:
        self._orders = orders
        self._answers = answers
        self._unread = bytearray() if beside is None else beside._unread
        self._numbers = count(1) if beside is None else beside._numbers
        self._session: str | None = None
        self._requests: dict[str, str] = {}
        self._target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=self._target, flatten=True)["sessionId"]
        self.call("Network.enable")

    @contextlib.contextmanager
    def another(self) -> Iterator["HeadlessBrowser"]:
        """A second page of the same browser, until the context ends."""
        page = HeadlessBrowser(self._orders, self._answers, self)
        try:
            yield page
        finally:
            page._session = None
            page.call("Target.closeTarget", targetId=page._target)

    @property
    def requested(self) -> list[str]:
        return list(self._requests.values())

    def open(self, address: str) -> None:
        """Go to an address; returns before everything is loaded."""
        self.call("Page.navigate", url=address)

    def picture(self) -> NDArray[np.uint8]:
        """Photograph the page as (ny, nx, 3) RGB."""
        data = base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])
        picture = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_COLOR)
        assert picture is not None
        return np.ascontiguousarray(picture[..., ::-1]).astype(np.uint8)

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """One call of the DevTools protocol."""
        number = next(self._numbers)
        order: dict[str, Any] = {"id": number, "method": method, "params": parameters}
        if self._session is not None:
            order["sessionId"] = self._session
        self._orders.write(json.dumps(order).encode() + b"\0")
        self._orders.flush()
        while True:
            answer = json.loads(self._next_answer())
            event, told = answer.get("method"), answer.get("params", {})
            if answer.get("sessionId") != self._session:
                event = None
            if event == "Network.requestWillBeSent":
                self._requests[told["requestId"]] = told["request"]["url"]
            elif event == "Network.loadingFailed" and told.get("blockedReason") == "csp":
                self._requests.pop(told["requestId"], None)
            if answer.get("id") == number:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']['message']}")
                result: dict[str, Any] = answer["result"]
                return result

    def _next_answer(self) -> bytes:
        while (end := self._unread.find(b"\0")) < 0:
            ready, _, _ = select.select([self._answers], [], [], LONGEST_SILENCE_S)
            if not ready:
                raise RuntimeError(f"the browser has said nothing for {LONGEST_SILENCE_S:g} s")
            data = os.read(self._answers.fileno(), 1 << 20)
            if not data:
                raise ConnectionError("the browser has ended")
            self._unread += data
        answer = bytes(self._unread[:end])
        del self._unread[: end + 1]
        return answer


@contextlib.contextmanager
def headless_browser(*, webgl: bool = False) -> Iterator[HeadlessBrowser]:
    """A browser with an empty profile; skips the test where none is installed."""
    options = (*OPTIONS, *(WITH_WEBGL if webgl else WITHOUT))
    executable = next((found for name in NAMES if (found := shutil.which(name))), None)
    if executable is None or os.name != "posix":
        pytest.skip(f"no browser: none of {', '.join(NAMES)} is installed (Debian: chromium)")
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        process = subprocess.Popen(
            ["sh", "-c", REDIRECTED, executable, *options, f"--user-data-dir={profile}"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            bufsize=0,
            start_new_session=True,
        )
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            yield HeadlessBrowser(process.stdin, process.stdout)
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            process.stdin.close()
            process.stdout.close()


def wait_for_picture(
    browser: HeadlessBrowser, good: Callable[[NDArray[np.uint8]], bool], limit_s: float, keep: Path
) -> NDArray[np.uint8]:
    """Photograph until `good` says so; the last picture is kept as a file, good or not."""
    deadline = time.monotonic() + limit_s
    while True:
        try:
            picture = browser.picture()
        except RuntimeError:  # the page has not begun to load, or the browser is silent
            if time.monotonic() > deadline:
                raise
        else:
            if good(picture) or time.monotonic() > deadline:
                cv2.imwrite(str(keep), picture[..., ::-1])
                return picture
        time.sleep(1.0)
