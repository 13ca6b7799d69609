"""Whether a report shows the results that lie beside it."""

from pathlib import Path

from acquisition.record.check import Finding
from acquisition.record.digest import sha256_of
from processing.errors import RecordError
from rig.report.html import stated_results_sha256


def check_report(results: Path) -> list[Finding]:
    """Compare the SHA-256 in the report of a results file with the file; nothing without a report."""
    report = results.with_name(results.stem.replace("results", "report", 1) + ".html")
    if not report.is_file():
        return []
    try:
        stated = stated_results_sha256(report.read_text(encoding="utf-8", errors="replace"))
    except OSError as error:
        raise RecordError(f"{report}: cannot be read: {error.strerror or error}") from None
    if not stated:
        return [Finding("note", f"{report.name} does not say which results it was made from")]
    if stated != sha256_of(results):
        return [
            Finding("error", f"{report.name} was made from other results than {results.name}; run rig report")
        ]
    return [Finding("note", f"{report.name} was made from {results.name}")]
