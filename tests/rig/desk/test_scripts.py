"""What the page judges by itself, without a browser."""

import json
import shutil
import subprocess
from pathlib import Path

import pytest

from rig.desk import theme

STATIC = Path(theme.__file__).with_name("static")
LIMITS = {"staleS": 2, "deadS": 30}


def judged(**seen: object) -> dict[str, object]:
    """What the watchdog makes of this."""
    if shutil.which("node") is None:
        pytest.skip("node runs the page's scripts here; install it for this test")
    program = f"""
    const window = globalThis;
    globalThis.document = {{addEventListener() {{}}}};
    globalThis.setInterval = () => 0;
    {(STATIC / "watchdog.js").read_text("utf-8")}
    console.log(JSON.stringify(rigJudge({json.dumps(seen)}, {json.dumps(LIMITS)})));
    """
    done = subprocess.run(["node", "-e", program], capture_output=True, text=True, check=True)
    found: dict[str, object] = json.loads(done.stdout)
    return found


@pytest.mark.parametrize(
    ("since", "answers", "session_age_s", "state", "behind_s"),
    [
        (0.3, None, None, "live", 0),
        (0.3, None, 1.0, "live", 0),
        (0.3, None, 8.7, "behind", 9.0),
        # before the other port has said anything, and while it answers, it is slow
        (3.0, None, None, "slow", 3.0),
        (3.0, True, 8.0, "slow", 3.0),
        (3.0, False, None, "dead", 3.0),
        (31.0, True, None, "dead", 31.0),
    ],
)
def test_slow_comes_before_dead(
    since: float, answers: bool | None, session_age_s: float | None, state: str, behind_s: float
) -> None:
    session = None if session_age_s is None else {"age_s": session_age_s}
    assert judged(since=since, answers=answers, session=session) == {"state": state, "behindS": behind_s}
