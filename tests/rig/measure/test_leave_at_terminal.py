"""At a real terminal: only the number of the trip and Enter acknowledge, only `light` and Enter light."""

import signal
from pathlib import Path

import pytest

from tests.rig.command_line import AT_ONCE, CONFIGS, QUICK, Session, set_words
from tests.rig.pseudo_terminal import Terminal

pytestmark = pytest.mark.timeout(300)

WAITING = {
    **QUICK,
    **AT_ONCE,
    "session.max_duration_s": "60",
    "laser.when_dark": '"wait"',
    # a program that a busy machine holds up for longer than usual is no trip of its own
    "controller.watchdog_s": "5",
    "faults.interlock_opens_at_s": "3",
    "faults.interlock_open_for_s": "0.5",
}


@pytest.mark.slow
def test_no_key_lights_or_acknowledges(tmp_path: Path) -> None:
    session = Session(tmp_path / "out")

    def said() -> list[str]:
        return [entry["what"] for entry in session.audit]

    words = ("run", CONFIGS / "live.toml", "-o", session.folder, *set_words(WAITING))
    terminal = Terminal(*words, on_screen=True)
    try:
        # typed before the question
        terminal.press("1\nlight\n")
        terminal.wait_for("then type 1 and Enter")
        for keys in ("a", "y", "1", " ", "l", "\x1b", "\n", "a\n", "y\n", "light\n", "2\n"):
            terminal.press(keys)
            if keys.endswith("\n") and keys.strip():
                terminal.wait_for("nothing is done")
        assert said() == ["lit", "trip", "latch", "dark"]
        terminal.press("1\n")
        terminal.wait_for("acknowledged")
        terminal.wait_for("Type light and Enter")
        for keys in ("1\n", "yes\n"):
            terminal.press(keys)
            terminal.wait_for("nothing is done")
        assert said() == ["lit", "trip", "latch", "dark", "acknowledge"]
        terminal.press("light\n")
        terminal.wait_for("laser on, 0.9 mW")
        assert said()[-1] == "lit"
        terminal.process.send_signal(signal.SIGINT)
        terminal.end()
    finally:
        terminal.close()
    assert said()[-1] == "dark"
