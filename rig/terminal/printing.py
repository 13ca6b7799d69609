"""Output on the terminal and as JSON: tables, lines, progress, messages on files."""

import contextlib
import dataclasses
import datetime
import json
import math
import os
import re
import sys
import textwrap
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextvars import ContextVar
from dataclasses import dataclass
from enum import Enum
from itertools import zip_longest
from pathlib import Path
from typing import IO, Any, Final

import numpy as np
from pydantic import BaseModel
from rich.cells import cell_len

from processing.errors import ConfigurationError, RecordError

_FORMULA_STARTS = ("=", "+", "-", "@", "\t", "\r")


@dataclass(frozen=True)
class Table:
    """A table of texts as a person reads it."""

    name: str
    title: str
    head: Sequence[str]
    """Headings of the columns."""
    shown: Sequence[Sequence[str]]
    """Texts of the cells of each line."""
    note: str = ""


def harmless_text(text: str) -> str:
    """A text for a cell of a CSV file, after ``'`` if a spreadsheet would take it for a formula."""
    return f"'{text}" if text.startswith(_FORMULA_STARTS) else text


DEFAULT_COLUMNS: Final = 80
"""Assumed width of a terminal that does not report it."""
_MAX_INDENT = 0.4
"""Largest indent of continued text, as a fraction of the width; after a longer name it is small."""
_WITHIN_NUMBER = re.compile(r"(?<=\d) (?=[%±×°])|(?<=[±×]) (?=[\d(])|(?<=\d\)) (?=[×%])")
_TERMINAL_INTERVAL_S, _LINE_INTERVAL_S = 1.0, 10.0
"""Intervals of the reports of progress at a terminal and elsewhere."""
_ERASE_LINE = "\r\x1b[K"
_NO_BREAK_SPACE = "\u00a0"


def print_line(text: str) -> None:
    """Print a line of results on stdout; at a terminal it is wrapped at words and indented."""
    _print(text, sys.stdout)


def say(text: str, *, error: bool = False) -> None:
    """Print one line on stderr, because programs read stdout; at a terminal it is wrapped, too."""
    _print(f"rig: {text}" if error else text, sys.stderr)


def loud(text: str) -> str:
    """A request in capitals up to its first colon, because a command may follow."""
    head, colon, rest = text.partition(": ")
    return head.upper() + colon + rest


class ProgressLine:
    """Reports the progress of long work on stderr: at a terminal in one line, else a line at intervals."""

    def __init__(self, work: str, *, clock: Callable[[], float] = time.monotonic) -> None:
        self._work, self._clock = work, clock
        self._start: tuple[float, int] | None = None
        self._last_report_s = 0.0

    def __call__(self, done: int, count: int) -> None:
        """Report that `done` of `count` parts are done; work that ends soon is not reported."""
        now_s, is_terminal = self._clock(), sys.stderr.isatty()
        if self._start is None or done <= self._start[1]:
            # the first part includes loading and compiling, so its time does not count
            self._start, self._last_report_s = (now_s, done), now_s
        start_s, start_done = self._start
        if done >= count and is_terminal and self._last_report_s > start_s:
            print(_ERASE_LINE, end="", file=sys.stderr, flush=True)
        interval_s = _TERMINAL_INTERVAL_S if is_terminal else _LINE_INTERVAL_S
        if done >= count or now_s - self._last_report_s < interval_s:
            return
        self._last_report_s = now_s
        remaining_s = round((now_s - start_s) * (count - done) / max(done - start_done, 1))
        minutes, seconds = divmod(remaining_s, 60)
        text = f"{self._work}: {done} of {count}, about {minutes}:{seconds:02d} min left"
        print(f"{_ERASE_LINE}{text}" if is_terminal else f"{text}\n", end="", file=sys.stderr, flush=True)


def _print(text: str, stream: IO[str]) -> None:
    columns = terminal_columns(stream)
    lines = text.split("\n") if columns else [text]
    print("\n".join(_wrap(line, columns) for line in lines), file=stream, flush=True)


def terminal_columns(stream: IO[str]) -> int:
    """The width of a terminal; 0 for a file or a pipe, whose lines are for programs and stay whole."""
    if not stream.isatty():
        return 0
    try:
        return os.get_terminal_size(stream.fileno()).columns or DEFAULT_COLUMNS
    except (OSError, ValueError):
        return DEFAULT_COLUMNS


def _wrap(line: str, columns: int) -> str:
    if not columns or len(line) <= columns:
        return line
    # text after a name and two spaces is continued below its beginning
    name = re.match(r" *(?:\S+(?: \S+)* {2,})?", line)
    indent = len(name[0]) if name is not None else 0
    if indent > _MAX_INDENT * columns:
        indent = len(line) - len(line.lstrip())
    return folded(line, columns, indent or 2)


def folded(text: str, columns: int, indent: int = 0) -> str:
    """A text broken between words, but not within a number such as `29 %` or `(1.2 ± 0.3) × 10⁻⁵`."""
    if len(text) <= columns:
        return text
    filled = textwrap.fill(
        _WITHIN_NUMBER.sub(_NO_BREAK_SPACE, text),
        columns,
        subsequent_indent=" " * indent,
        break_long_words=False,
        break_on_hyphens=False,
        replace_whitespace=False,
    )
    return filled.replace(_NO_BREAK_SPACE, " ")


def unbroken_words(text: str) -> list[str]:
    """The parts of a text between which `folded` may break it."""
    return [
        word.replace(_NO_BREAK_SPACE, " ")
        for word in _WITHIN_NUMBER.sub(_NO_BREAK_SPACE, text).split(" ")
        if word
    ]


@contextlib.contextmanager
def translated_file_errors(path: Path, alternative: str = "folder") -> Iterator[None]:
    """A context for writing files, which turns errors of the system into messages for the user.

    Raises ConfigurationError if a file exists (the message asks for another `alternative`), else RecordError.
    """
    try:
        yield
    except FileExistsError as error:
        raise ConfigurationError(
            f"{error.filename or path}: exists already and is not overwritten; choose another {alternative}"
        ) from None
    except OSError as error:
        raise RecordError(f"{path}: cannot be written: {error.strerror or error}") from None


def print_json_line(kind: str, values: Mapping[str, Any]) -> None:
    """Print one JSON object on one line of stdout; NaN and infinity become null."""
    print(json.dumps({"kind": kind, **plain_values(values)}), flush=True)


def plain_values(value: Any) -> Any:
    """Nested values as plain JSON values; NaN and infinity become null (not determined)."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, BaseModel):
        return plain_values(value.model_dump(mode="json"))
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {item.name: plain_values(getattr(value, item.name)) for item in dataclasses.fields(value)}
    if isinstance(value, tuple) and hasattr(value, "_asdict"):
        return plain_values(value._asdict())
    if isinstance(value, Mapping):
        return {str(key): plain_values(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [plain_values(inner) for inner in value]
    if isinstance(value, np.ndarray | np.generic):
        return plain_values(value.tolist())
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, datetime.datetime | datetime.date):
        return value.isoformat()
    return str(value) if isinstance(value, Path) else value


_JSON_ANSWER: ContextVar[dict[str, Any] | None] = ContextVar("json_answer", default=None)


def answer(**values: object) -> None:
    """Add values to the JSON object that ``--json`` prints; without that option nothing happens.

    A function is called for its value. A list that is stated again is extended: records, files, tables.
    """
    answers = _JSON_ANSWER.get()
    if answers is None:
        return
    for name, value_or_function in values.items():
        value = value_or_function() if callable(value_or_function) else value_or_function
        if isinstance(value, list) and name in answers:
            answers[name] += value
        else:
            answers[name] = value


@contextlib.contextmanager
def one_json_object() -> Iterator[None]:
    """A context in which printing goes to stderr; at its end one JSON object is printed on stdout.

    After an error there is no object: the line on stderr and the exit status report it.
    """
    answers: dict[str, Any] = {}
    token = _JSON_ANSWER.set(answers)
    try:
        with contextlib.redirect_stdout(sys.stderr):
            yield
    finally:
        _JSON_ANSWER.reset(token)
    print(json.dumps(plain_values(answers), ensure_ascii=False), flush=True)


_NUMBER_STARTS = tuple("0123456789−-+(<>–")
_FILE_WIDTH = 170
"""Width of a table in a file or a pipe, in characters."""
_GAP = 2
"""Gap between columns, which is also counted after the last one."""
_BOLD = "\x1b[1m{}\x1b[0m"


def screen_width() -> int:
    """Width of the terminal in characters, or of a table in a file or pipe."""
    return terminal_columns(sys.stdout) or _FILE_WIDTH


def print_tables(tables: Sequence[Table]) -> None:
    """Print tables; columns that consist mostly of numbers are right-aligned.

    Numbers are never broken, texts only between words; columns that do not fit follow below, after the first
    column again. A table without lines is its title and its note.
    """
    answer(tables=list(tables))
    width = screen_width()
    for content in tables:
        if content.title and content.head:
            print_line(content.title)
        for columns in _column_groups(content, width) if content.shown else ():
            print("\n".join(_aligned_lines(content, columns, width)))
        if content.note:
            print_line(content.note)
        print()


def _column_groups(content: Table, width: int) -> list[list[int]]:
    """Indices of the columns that are printed side by side; every group begins with the first column."""
    min_widths = _min_widths(content)
    if not min_widths:
        return []
    groups = [[0]]
    for column in range(1, len(min_widths)):
        used = sum(min_widths[k] + _GAP for k in groups[-1])
        if len(groups[-1]) > 1 and used + min_widths[column] + _GAP > width:
            groups.append([0])
        groups[-1].append(column)
    return groups


def _aligned_lines(content: Table, columns: Sequence[int], width: int) -> Iterator[str]:
    """The lines of a group of columns, the headings first, bold at a terminal."""
    min_widths, widths = _min_widths(content), _natural_widths(content)
    while sum(widths[column] + _GAP for column in columns) > width:
        shrinkable = [column for column in columns if widths[column] > min_widths[column]]
        if not shrinkable:
            break
        widths[max(shrinkable, key=lambda column: widths[column])] -= 1
    numeric = {column for column in columns if _is_numeric(content, column)}
    emphasis = _BOLD if sys.stdout.isatty() else "{}"
    for row in (content.head, *content.shown):
        cells = [
            [line for text in row[column].split("\n") for line in folded(text, widths[column]).split("\n")]
            for column in columns
        ]
        for texts in zip_longest(*cells, fillvalue=""):
            line = ""
            for column, text in zip(columns, texts, strict=True):
                padding = " " * (widths[column] - cell_len(text))
                line += (padding + text if column in numeric else text + padding) + " " * _GAP
            yield emphasis.format(line.rstrip())
        emphasis = "{}"


def _is_numeric(content: Table, column: int) -> bool:
    return 2 * sum(row[column].startswith(_NUMBER_STARTS) for row in content.shown) > len(content.shown)


def _natural_widths(content: Table) -> list[int]:
    return [
        max(map(cell_len, (heading, *(row[column] for row in content.shown))), default=0)
        for column, heading in enumerate(content.head)
    ]


def _min_widths(content: Table) -> list[int]:
    """Smallest widths of the columns with which no word, and no cell of numbers, is broken."""
    widths = []
    for column, heading in enumerate(content.head):
        texts = [row[column] for row in content.shown]
        if not _is_numeric(content, column):
            texts = [word for cell in texts for line in cell.split("\n") for word in unbroken_words(line)]
        widths.append(max(map(cell_len, (*texts, *heading.split())), default=0))
    return widths
