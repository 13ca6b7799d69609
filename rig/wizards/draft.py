"""The answers given so far, kept in a file so that a wizard goes on after a break."""

import json
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from acquisition import atomic_write
from processing.errors import ConfigurationError, RecordError, RigError
from rig.wizards.question import Question, Wizard


@dataclass(frozen=True, slots=True)
class Draft:
    """Answers as they were typed, each with the name of its question, in their order."""

    answers: tuple[tuple[str, str], ...] = ()

    def without_last(self) -> "Draft":
        """One question back."""
        return replace(self, answers=self.answers[:-1])


@dataclass(frozen=True, slots=True)
class Progress:
    """Where a wizard stands: the values so far by the names of their questions, and the next question.

    `asked` are the questions answered so far; `question` is None after the last.
    """

    values: Mapping[str, Any]
    asked: tuple[Question, ...]
    question: Question | None


def progress(wizard: Wizard, draft: Draft) -> Progress:
    """Read the answers; raises RigError for one that does not hold (any more)."""
    given = dict(draft.answers)
    values: dict[str, Any] = {}
    asked: list[Question] = []
    for question in wizard.questions(values):
        if question.name not in given:
            return Progress(values, tuple(asked), question)
        values[question.name] = question.read(given[question.name])
        asked.append(question)
    return Progress(values, tuple(asked), None)


def answered(wizard: Wizard, draft: Draft, text: str) -> Draft:
    """The draft with one more answer; raises RigError, one line, for one that cannot be."""
    question = progress(wizard, draft).question
    if question is None:
        raise ConfigurationError(f"{text!r}: everything was answered already")
    text = text.strip()
    if not text:
        if question.suggested is None:
            raise ConfigurationError("an answer is needed here")
        text = question.suggested
    answers = [choice.answer for choice in question.choices]
    if answers and text not in answers:
        if text.isdecimal() and 1 <= int(text) <= len(answers):
            text = answers[int(text) - 1]
        elif not question.open_choice:
            raise ConfigurationError(f"{text!r}: choose one of {', '.join(answers)}, or its number")
    question.read(text)
    return replace(draft, answers=(*draft.answers, (question.name, text)))


def as_far_as_it_holds(wizard: Wizard, draft: Draft) -> Draft:
    """The draft without the first answer that does not hold any more, and those after it.

    A record named in it may have been moved since.
    """
    while draft.answers:
        try:
            progress(wizard, draft)
        except RigError:
            draft = draft.without_last()
        else:
            break
    return draft


def keep_draft(path: Path, draft: Draft) -> None:
    """Write the draft; raises RecordError if that is not possible."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        atomic_write.replace(path, json.dumps(draft.answers, ensure_ascii=False, indent=1).encode())
    except OSError as error:
        raise RecordError(f"{path}: the answers cannot be kept: {error.strerror or error}") from None


def kept_draft(path: Path) -> Draft:
    """The draft that was kept there; an empty one if there is none.

    Raises ConfigurationError for a file that is something else.
    """
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        return Draft(tuple((str(name), str(text)) for name, text in found))
    except FileNotFoundError:
        return Draft()
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be read: {error.strerror or error}") from None
    except (ValueError, TypeError):
        raise ConfigurationError(f"{path}: holds no answers of a wizard; move it away") from None


def drop_draft(path: Path) -> None:
    """Remove the draft, whose answers are filed now."""
    with suppress(FileNotFoundError):
        path.unlink()
