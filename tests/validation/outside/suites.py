"""Tests that have their judge outside: run by pytest, the number is that of those that fail."""

import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ElementTree
from functools import partial
from pathlib import Path

from tests.validation.row import Found, Measurement, Missing

ROOT = Path(__file__).resolve().parents[3]


def _failures(*nodes: str) -> dict[str, Found]:
    with tempfile.TemporaryDirectory() as name:
        report = Path(name) / "report.xml"
        words = [sys.executable, "-m", "pytest", "-q", "-n", "0", "-m", "not bench and not kernel"]
        subprocess.run(
            [*words, f"--junitxml={report}", *nodes], cwd=ROOT, capture_output=True, check=False, text=True
        )
        if not report.exists():
            raise Missing(f"pytest did not run {' '.join(nodes)}")
        suite = ElementTree.parse(report).getroot().find("testsuite")
    assert suite is not None
    count = {key: int(suite.get(key, "0")) for key in ("tests", "failures", "errors", "skipped")}
    if count["tests"] == count["skipped"]:
        reason = suite.find(".//skipped")
        raise Missing(reason.get("message", "") if reason is not None else "no such tests")
    skipped = f", {count['skipped']} skipped" if count["skipped"] else ""
    detail = f"of {count['tests'] - count['skipped']} tests{skipped}"
    return {"failures": Found((float(count["failures"] + count["errors"]),), detail)}


def failures_of(*nodes: str) -> Measurement:
    """A measurement that runs these tests."""
    return partial(_failures, *nodes)
