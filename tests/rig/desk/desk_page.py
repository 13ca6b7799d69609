"""A desk in a process of its own, and a tab of a headless browser that looks at it."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2

from tests.rig.view.headless_browser import HeadlessBrowser

LIMIT_S = 50.0
_ANSWER_S = 15.0
"""Time after which a press in a dialog that had no answer is made again."""
IN_DIALOG = "[...document.querySelectorAll('.q-dialog [data-deliberate]')].at(-1)"
HIT = "window.__hit"
SIZE = {"width": 1280, "height": 800, "deviceScaleFactor": 1, "mobile": False}


class Page:
    """A tab with the desk in it; waits for states of the page, never for durations."""

    def __init__(self, browser: HeadlessBrowser) -> None:
        self.browser = browser
        browser.call("Emulation.setDeviceMetricsOverride", **SIZE)
        self.prefer("dark")

    def prefer(self, scheme: str) -> None:
        """The system's preference, dark or light."""
        preference = {"name": "prefers-color-scheme", "value": scheme}
        self.browser.call("Emulation.setEmulatedMedia", features=[preference])

    def open(self, address: str) -> None:
        self.browser.open(address)
        self.wait("document.querySelector('.q-tab') !== null && window.socket?.connected !== false")

    def ask(self, script: str) -> Any:
        """The value of a JavaScript expression."""
        told = self.browser.call("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        return told.get("result", {}).get("value")

    def wait(self, script: str, limit_s: float = LIMIT_S) -> Any:
        """Until an expression is true; returns its value, of an element that it is there."""
        # what the page hangs on an element may be more than the browser tells by value
        told = f"(() => {{ const found = ({script}); return found instanceof Element || found }})()"
        deadline_s = time.monotonic() + limit_s
        while True:
            found = self.ask(f"(() => {{ try {{ return {told} }} catch (e) {{ return null }} }})()")
            if found:
                return found
            assert time.monotonic() < deadline_s, f"never came true: {script}\n{self.text()}"
            time.sleep(0.1)

    def wait_text(self, text: str, limit_s: float = LIMIT_S) -> None:
        """Until the page shows a text."""
        self.wait(f"document.body.innerText.includes({text!r})", limit_s)

    def text(self) -> str:
        return str(self.ask("document.body.innerText"))

    def click(self, words: str) -> None:
        """Click the visible button, tab or box with these words."""
        found = (
            "[...document.querySelectorAll('button, .q-tab, .q-checkbox, a')]"
            f".find(b => b.offsetParent && b.innerText.trim().toLowerCase().startsWith({words.lower()!r}))"
        )
        # one that is grey does nothing, and one that is not there any more must not be taken for pressed
        press = "b.dataset.deliberate ? 'aim' : (b.click(), 'pressed')"
        if self.wait(f"(b => b && !b.disabled && ({press}))({found})") == "aim":
            self.point_at(found)

    def point_at(self, element: str) -> None:
        """Click an element (an expression) with the mouse, as a person does, until it has been hit.

        What stands above it may go away between the look and the click, and move it.
        """
        self.wait_while(f"{HIT} === 1", lambda: self._aim_at(element))
        self.ask(f"delete {HIT}")

    def _aim_at(self, element: str) -> None:
        # a dialog that is just opening still moves
        middle = "[Math.round(r.x + r.width / 2), Math.round(r.y + r.height / 2)]"
        spot = f"(r => {middle})({element}.getBoundingClientRect())"
        self.ask(f"{element}?.scrollIntoView({{block: 'center'}})")
        is_free = (
            "!document.querySelector('[class*=enter-active]') && "
            f"{element}.contains(document.elementFromPoint(...{spot}))"
        )
        # the click before may be heard only now; and a click beside a dialog that moved closes it
        if self.wait(f"{HIT} === 1 || {element} == null ? 'over' : {is_free} && 'free'") == "over":
            return
        self.ask(f"{element}.addEventListener('click', () => {{ {HIT} = 1 }}, {{capture: true, once: true}})")
        x, y = self.ask(spot)
        for kind in ("mousePressed", "mouseReleased"):
            self.browser.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    def in_dialog(self) -> None:
        """Press the button of the open dialog that lights, or allows light."""
        self.wait(f"{IN_DIALOG} != null")
        self.point_at(IN_DIALOG)

    def mark(self, folder: str) -> None:
        """Mark a session of the list, or take its mark away."""
        box = (
            "[...document.querySelectorAll('.q-table tbody tr')]"
            f".find(row => row.innerText.includes({folder!r})).querySelector('.q-checkbox')"
        )
        before = self.wait(f"{box}.getAttribute('aria-checked')")
        self.ask(f"{box}.click()")
        self.wait(f"{box}.getAttribute('aria-checked') !== {before!r}")

    def acknowledge(self) -> None:
        """Acknowledge what is latched, again and again while that is refused."""
        button = (
            "[...document.querySelectorAll('.cries button')].find(b => b.offsetParent && "
            "b.innerText.startsWith('ACKNOWLEDGE'))"
        )

        def ask() -> None:
            # what was said of the try before
            self.ask("document.querySelectorAll('.errors button').forEach(b => b.click())")
            self.wait("!document.querySelector('.errors > *, .q-notification')")
            # grey while it would be refused
            self.wait(f"!{button}?.disabled")
            self.ask(f"{button}?.click()")
            # the try before may have done it meanwhile, and there is nothing more to ask
            if self.wait(f"{IN_DIALOG} != null ? 'ask' : {button} == null ? 'done' : null") == "ask":
                self.wait_while(f"{HIT} === 1 || {IN_DIALOG} == null", lambda: self._aim_at(IN_DIALOG))
                if self.ask(f"(hit => (delete {HIT}, hit))({HIT} === 1)"):
                    # a person presses again, too, where nothing follows
                    answer = f"document.querySelector('.errors > *, .q-notification') || {button} == null"
                    deadline_s = time.monotonic() + _ANSWER_S
                    while not self.ask(answer) and time.monotonic() < deadline_s:
                        time.sleep(0.1)

        # news of the trip may come later than what follows from it
        self.wait(f"{button} != null")
        self.wait_while(f"{button} == null", ask, 2 * LIMIT_S)

    def type(self, text: str) -> None:
        """Type a text wherever the focus is; `\\r` is the key Enter."""
        for one in text:
            names = {"\r": ("Enter", "Enter", 13), " ": (" ", "Space", 32)}
            key, code, number = names.get(one, (one, "", ord(one.upper())))
            for kind in ("keyDown", "keyUp"):
                self.browser.call(
                    "Input.dispatchKeyEvent",
                    type=kind,
                    key=key,
                    code=code,
                    windowsVirtualKeyCode=number,
                    text=one if kind == "keyDown" else "",
                )

    def fill(self, key: str, text: str) -> None:
        """Type into the field of a key of the configuration."""
        field = f"document.querySelector('[data-key=\"{key}\"]')"
        # a panel that is just opening takes no focus yet
        self.wait(f"({field}.focus(), {field}.select(), document.activeElement === {field})")
        self.browser.call("Input.insertText", text=text)
        self.wait(f"{field}.value === {text!r}")

    def key(self, key: str) -> None:
        """Press a key where no field has the focus."""
        self.ask("document.activeElement.blur()")
        for kind in ("keyDown", "keyUp"):
            self.browser.call(
                "Input.dispatchKeyEvent", type=kind, key=key, text=key if kind == "keyDown" else ""
            )

    def drag(self, element: str, begin: tuple[float, float], end: tuple[float, float]) -> None:
        """Draw with the mouse over an element, from one place in it to another, in parts of its size."""
        x, y, width, height = self.ask(
            "(r => [r.x, r.y, r.width, r.height])"
            f"(document.querySelector({element!r}).getBoundingClientRect())"
        )
        for kind, place in (("mousePressed", begin), ("mouseMoved", end), ("mouseReleased", end)):
            self.browser.call(
                "Input.dispatchMouseEvent",
                type=kind,
                x=x + place[0] * width,
                y=y + place[1] * height,
                button="left",
                buttons=0 if kind == "mouseReleased" else 1,
                clickCount=1,
            )

    def wait_while(self, script: str, doing: Callable[[], None], limit_s: float = LIMIT_S) -> None:
        """Until an expression is true, doing something again and again meanwhile."""
        deadline_s = time.monotonic() + limit_s
        while not self.ask(script):
            doing()
            assert time.monotonic() < deadline_s, f"never came true: {script}\n{self.text()}"
            time.sleep(0.1)

    def picture(self, path: Path) -> None:
        """Photograph the page, once what it was told last is drawn."""
        self.ask("new Promise(drawn => requestAnimationFrame(() => requestAnimationFrame(drawn)))")
        cv2.imwrite(str(path), self.browser.picture()[..., ::-1])


class DeskProcess:
    """`rig desk` of a configuration, by a `program` that takes the command line."""

    def __init__(self, config: Path, *words: str, program: tuple[str, str] = ("-m", "rig")) -> None:
        self._process = subprocess.Popen(
            [sys.executable, *program, "desk", str(config.absolute()), "--no-browser", *words],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            # calibrations and their recordings are kept in the current folder
            cwd=config.parent,
            env={**os.environ, "COLUMNS": "200"},
        )
        assert self._process.stdout is not None
        self.address = self._process.stdout.readline().strip()
        if not self.address.startswith("http"):
            raise AssertionError(self._process.communicate()[1])

    @property
    def pid(self) -> int:
        return self._process.pid

    def send(self, number: signal.Signals) -> None:
        self._process.send_signal(number)

    def ended(self, by: signal.Signals = signal.SIGINT) -> tuple[int, list[str]]:
        """Ends it, if it still runs; exit status, and the lines that it has written on stderr."""
        if self._process.poll() is None:
            self._process.send_signal(by)
        _, said = self._process.communicate(timeout=40)
        return self._process.returncode, [line for line in said.splitlines() if line]

    def kill(self) -> None:
        self._process.kill()
        with contextlib.suppress(ValueError):
            # what it has said may have been read already
            self._process.communicate()


@contextlib.contextmanager
def desk_page(browser: HeadlessBrowser, config: Path, *words: str) -> Iterator[tuple[DeskProcess, Page]]:
    """A desk, and a tab of the browser that shows it."""
    desk = DeskProcess(config, *words)
    try:
        with browser.another() as tab:
            page = Page(tab)
            page.open(desk.address)
            yield desk, page
    except Exception as error:
        with contextlib.suppress(subprocess.TimeoutExpired):
            error.add_note("\n".join(["the desk has said:", *desk.ended()[1]]))
        raise
    finally:
        with contextlib.suppress(subprocess.TimeoutExpired, ValueError):
            desk.ended()
        desk.kill()
