"""A wizard in the terminal: asks until everything is answered; wrong answers are asked again."""

import sys
from collections.abc import Callable
from pathlib import Path

from processing.errors import ConfigurationError, RigError
from rig.presentation import say
from rig.wizards.draft import Draft, answered, progress
from rig.wizards.question import Question, RecordedAnswer, Wizard

BACK = "<"
Recorder = Callable[[RecordedAnswer], Path]


def ask_in_terminal(
    wizard: Wizard,
    draft: Draft | None = None,
    keep: Callable[[Draft], None] = lambda _: None,
    recorder: Recorder | None = None,
) -> Draft:
    """Ask all questions that have no answer yet; returns all answers.

    `keep` is called with every new draft; `recorder` records what a question wants. ``<`` goes one question
    back. Where nobody sits at the keyboard, each line of the input is an answer, and the first that cannot
    be taken ends it.

    Raises ConfigurationError when the input ends before all is answered, KeyboardInterrupt after Ctrl-C.
    """
    draft = draft or Draft()
    say(f"{wizard.title}. Enter accepts the value in brackets, {BACK} goes back a question, Ctrl-C ends.")
    while True:
        question = progress(wizard, draft).question
        if question is None:
            return draft
        text = _typed(question, recorder is not None)
        try:
            if text == BACK:
                draft = draft.without_last()
            else:
                if not text and recorder is not None and question.recording is not None:
                    text = str(recorder(question.recording))
                draft = answered(wizard, draft, text)
        except RigError as error:
            if not sys.stdin.isatty():
                raise ConfigurationError(f"{question.text} {error}") from None
            say(f"  {error}")
            continue
        keep(draft)


def _typed(question: Question, recorded: bool) -> str:
    if question.do:
        say(f"\n{question.do}")
    for number, choice in enumerate(question.choices, 1):
        say(f"  {number}  {choice.answer}{f': {choice.text}' if choice.text else ''}")
    prompt = f"{question.text}{_in_brackets(question, recorded)} "
    if not sys.stdin.isatty():
        say(prompt)
        prompt = ""
    try:
        return input(prompt).strip()
    except EOFError:
        raise ConfigurationError(f"the answers end at: {question.text}") from None


def _in_brackets(question: Question, recorded: bool) -> str:
    """What Enter does."""
    wanted = question.recording
    if recorded and wanted is not None:
        what = f"{wanted.frames} frames" if wanted.kind == "frames" else f"{wanted.seconds:g} s"
        return f" [record {what} now]"
    if question.suggested is None or (not question.suggested and question.says_enter):
        return ""
    return f" [{question.suggested or 'none'}]"
