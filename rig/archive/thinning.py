"""`rig archive thin`: pixels of old records dropped or stored in fewer bytes, of runs that have results."""

import contextlib
import datetime
import hashlib
import json
import platform
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from acquisition.record.proof import Thinning, measured_sha256_of
from acquisition.record.reader import RecordReader
from acquisition.record.thin import Thinned, thin, why_not_thinned
from processing.errors import ConfigurationError, RecordError
from rig.analysis import RunResults, SessionResults, encoded, recorded_results
from rig.archive.adding import add_sessions
from rig.archive.chosen import chosen_runs
from rig.archive.refits import read_refit
from rig.archive.remarks import user_name
from rig.archive.store import Archive, reads_archive
from rig.presentation import say


class _NoSmaller(RecordError):
    """Recompressing gains nothing."""


class _Due(NamedTuple):
    """A record that is to be thinned, and the results that its pixels have given."""

    record: Path
    sha256: str
    thinning: Thinning
    rule: str
    source: str
    results: RunResults


@reads_archive
def thin_runs(
    archive: Path,
    names: Sequence[str],
    where: str,
    *,
    drop_after: int | None,
    recompress_after: int | None,
    agreed: Callable[[str], bool],
    today: datetime.date | None = None,
) -> int:
    """Thin runs that are named or meet a condition (neither: all) and are older than a rule's months.

    Only records that prove themselves and have results are thinned; the results go into the record. The
    thinned record takes the place of the one that was measured when it has been read again and proved, at
    once; killed at any moment, one of the two is there. `agreed` is asked first.

    Returns the exit status: 1 where a record that is due was left as it is. Raises ConfigurationError without
    a rule.
    """
    if drop_after is None and recompress_after is None:
        raise ConfigurationError("state what to do and when: --drop-after MONTHS, --recompress-after MONTHS")
    today = today or datetime.datetime.now(datetime.UTC).date()
    runs = chosen_runs(archive, names, where or ("" if names else "true"))
    ages = _ages_months(archive, today)
    due, left = [], 0
    for sha256, record in runs.items():
        rule = _rule(ages.get(sha256), drop_after, recompress_after)
        if rule is None:
            continue
        found = _due(archive, record, sha256, rule)
        if isinstance(found, _Due):
            due.append(found)
        elif found:
            left += 1
            say(found)
    if not due:
        print(f"nothing to thin; {left} left as they are")
        return 1 if left else 0
    size_mb = sum(item.record.stat().st_size for item in due) / 1e6
    counts = {kind: sum(item.thinning == kind for item in due) for kind in Thinning}
    what = " and ".join(f"of {count} {kind}" for kind, count in counts.items() if count)
    if not agreed(
        f"{len(due)} records, {size_mb:.1f} MB: pixels {what}; dropped ones never come back. Thin?"
    ):
        print("nothing was changed")
        return 0
    saved_mb, thinned = 0.0, []
    for number, item in enumerate(due, 1):
        try:
            done = _replace(item)
        except (RecordError, OSError) as error:
            left += 1
            say(f"{item.record}: left as it is: {error}")
            continue
        thinned.append(item.record.parent)
        saved_mb += (done.source_bytes - done.bytes) / 1e6
        sizes = f"{done.source_bytes / 1e6:.1f} → {done.bytes / 1e6:.1f} MB"
        say(f"{number} of {len(due)}: {item.record}: {sizes}")
    if thinned:
        add_sessions(archive, sorted(set(thinned)))
    print(f"{len(thinned)} records thinned, {saved_mb:.1f} MB less; {left} left as they are")
    return 1 if left else 0


def _ages_months(archive: Path, today: datetime.date) -> dict[str, int]:
    """Whole months since runs began, by their SHA-256."""
    question = (
        "select sha256, date_diff('month', began_utc::date, $1) - (day($1) < day(began_utc))::int "
        "from runs where began_utc is not null"
    )
    return dict(Archive(archive).connection().execute(question, [today]).fetchall())


def _rule(
    age: int | None, drop_after: int | None, recompress_after: int | None
) -> tuple[Thinning, str] | None:
    """What is due at an age in months, and the rule that says so."""
    if age is not None and drop_after is not None and age >= drop_after:
        return Thinning.DROPPED, f"dropped after {drop_after} months"
    if age is not None and recompress_after is not None and age >= recompress_after:
        return Thinning.RECOMPRESSED, f"recompressed after {recompress_after} months"
    return None


def _due(archive: Path, record: Path, sha256: str, rule: tuple[Thinning, str]) -> _Due | str:
    """What is to be done with a record; else why it is left, or nothing where nothing is to be done."""
    if not record.is_file():
        return f"{record}: is not here; thin it on the computer where it lies"
    try:
        with RecordReader(record) as reader:
            why = why_not_thinned(reader, rule[0])
            if why is not None:
                return f"{record}: {why}" if why.is_fault else ""
        if measured_sha256_of(record) != sha256:
            return f"{record}: has changed since it was added; rig archive add"
    except RecordError as error:
        return str(error)
    source, results = _results(archive, record, sha256)
    if results is None:
        return f"{record}: has no results from its pixels; rig fit {record.parent} makes them"
    return _Due(record, sha256, *rule, source, results)


def thin_copy(archive: Path, record: Path, copy: Path, sha256: str, thinning: Thinning, rule: str) -> None:
    """Thin a copy of a record, with the record's results.

    One that has no windows, or would be no smaller, stays as it is. Raises RecordError where the record must
    not be thinned.
    """
    found = _due(archive, record, sha256, (thinning, rule))
    if isinstance(found, _Due):
        with contextlib.suppress(_NoSmaller):
            _replace(found._replace(record=copy))
    elif found:
        raise RecordError(found)


def _results(archive: Path, record: Path, sha256: str) -> tuple[str, RunResults | None]:
    """The newest results of a record that hold a fit: those beside it, else those that `refit` made."""
    name, found = recorded_results(record, sha256)
    if found is not None and _tells(found):
        return name, found
    shelf = Archive(archive).refits
    refits = [
        read_refit(shelf.path(version)) for version in shelf.names() if version.startswith(f"{sha256[:16]}-")
    ]
    for refit in sorted(refits, key=lambda refit: refit.order, reverse=True):
        if refit.results is not None and refit.results.sha256 == sha256 and _tells(refit.results):
            return refit.name, refit.results
    return "", None


def _tells(results: RunResults) -> bool:
    # of a sealed run it is known that there is a fit, where nothing is said against it
    return (
        bool(results.fits) or results.instrument is not None or bool(results.sealed and not results.problem)
    )


def _replace(item: _Due) -> Thinned:
    """Put the thinned record in the place of the other one, whose name may be a link to it."""
    path = item.record.resolve()
    said = {
        "rule": item.rule,
        "results": item.source,
        "utc": datetime.datetime.now(datetime.UTC).isoformat(),
        "user": user_name(),
        "computer": platform.node(),
    }
    results = json.dumps(encoded(SessionResults(runs=(item.results,)))).encode()
    attached = f"thinned/results-{hashlib.sha256(results).hexdigest()[:8]}.json"

    def agreed(done: Thinned) -> None:
        if done.measured_sha256 != item.sha256:
            raise RecordError("it has changed while it was thinned")
        if item.thinning is Thinning.RECOMPRESSED and done.bytes >= done.source_bytes:
            raise _NoSmaller("thinned it would be no smaller")

    return thin(path, path, item.thinning, said, {attached: results}, agreed=agreed, replaces=True)
