"""How a run has ended whose end nobody has noted: its record says it."""

from contextlib import suppress

from acquisition.record.events import EventKind, end_of
from acquisition.record.reader import RecordReader
from processing.errors import RecordError
from rig.measure.session_file import RunEntry, RunState, SessionFile

_ENDS: dict[str, RunState] = {
    EventKind.REJECTED: RunState.REJECTED,
    EventKind.STOPPED: RunState.STOPPED,
    EventKind.FAILED: RunState.FAILED,
}


def end_noted(file: SessionFile, entry: RunEntry) -> str:
    """Note how a run has ended that is still noted as being recorded; returns that in words.

    Empty, with nothing noted, where it has no record, or one that is not whole.
    """
    record = file.folder / entry.record
    if not record.exists():
        return ""
    with suppress(RecordError), RecordReader(record) as reader:
        end = end_of(reader.events())
        if end is not None and not reader.truncated:
            state = _ENDS.get(end.kind, RunState.COMPLETE)
            file.note(entry.number, entry.record, state, end.text)
            how = "whole" if state is RunState.COMPLETE else f"{state}, its run is made again"
            return f"{entry.record} is {how}: {end.text}"
    return ""
