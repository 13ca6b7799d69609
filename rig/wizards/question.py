"""What a wizard asks, as plain values; the terminal and the operator's page show the same questions."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal, Protocol


@dataclass(frozen=True, slots=True)
class Choice:
    """One of the answers to choose from; `text` says what it is."""

    answer: str
    text: str


@dataclass(frozen=True, slots=True)
class RecordedAnswer:
    """What the rig can record as an answer, which is then the path of what was recorded.

    `name` becomes part of the name of the file or folder. A record lasts `seconds`; of single frames
    `frames` are taken, at `exposure_us` if that is stated.
    """

    kind: Literal["record", "frames"]
    name: str
    seconds: float = 0.0
    frames: int = 0
    exposure_us: float | None = None


@dataclass(frozen=True, slots=True)
class Question:
    """One question.

    Parameters
    ----------
    name
        By which the answer is kept; unique in a wizard.
    text
        The question, in one line.
    read
        The value of an answer as typed; raises a RigError with one line that says what is wrong.
    do
        What is to be done before it can be answered.
    suggested
        The answer that Enter gives; None: one must be stated.
    says_enter
        The text itself says what Enter does.
    choices
        If there are any, what can be answered; `open_choice` takes other answers, too.
    recording
        What the rig can record for it, where a configuration is at hand.
    """

    name: str
    text: str
    read: Callable[[str], Any]
    do: str = ""
    suggested: str | None = None
    says_enter: bool = False
    choices: tuple[Choice, ...] = ()
    open_choice: bool = False
    recording: RecordedAnswer | None = None


class Wizard(Protocol):
    """Questions, of which each may depend on the values given before."""

    @property
    def title(self) -> str:
        """What it is for."""

    @property
    def questions(self) -> Callable[[Mapping[str, Any]], Iterator[Question]]:
        """The questions in their order; `values` holds those of all earlier ones, by name."""
