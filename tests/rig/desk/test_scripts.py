"""What the page judges by itself, without a browser."""

import json
import shutil
import subprocess
from pathlib import Path

import pytest

from rig.desk import page

WATCHDOG = Path(page.__file__).with_name("static") / "watchdog.js"
CASES = (
    ((0.3, None, None), ("live", 0)),
    ((0.3, None, 1.0), ("live", 0)),
    ((0.3, None, 8.7), ("behind", 9.0)),
    # before the other port has said anything, and while it answers, it is slow
    ((3.0, None, None), ("slow", 3.0)),
    ((3.0, True, 8.0), ("slow", 3.0)),
    ((3.0, False, None), ("dead", 3.0)),
    ((31.0, True, None), ("dead", 31.0)),
)
"""Time since the page was told anything, whether the other port answers, age of the session's news; state."""


def test_slow_comes_before_dead() -> None:
    if shutil.which("node") is None:
        pytest.skip("node runs the page's scripts here; install it for this test")
    seen = [
        {"since": since, "answers": answers, "session": None if age_s is None else {"age_s": age_s}}
        for (since, answers, age_s), _ in CASES
    ]
    program = f"""
    const window = globalThis;
    globalThis.document = {{addEventListener() {{}}}};
    globalThis.setInterval = () => 0;
    {WATCHDOG.read_text("utf-8")}
    const judged = {json.dumps(seen)}.map(one => rigJudge(one, {{staleS: 2, deadS: 30}}));
    console.log(JSON.stringify(judged));
    """
    done = subprocess.run(["node", "-e", program], capture_output=True, text=True, check=True)
    assert [(one["state"], one["behindS"]) for one in json.loads(done.stdout)] == [
        expected for _, expected in CASES
    ]
