"""The option ``--json``, the same for every command that prints results once."""

import functools
import inspect
from collections.abc import Callable
from typing import Annotated, Any

import typer

_AsJson = Annotated[
    bool, typer.Option("--json", help="Print one JSON object on stdout, everything else on stderr.")
]


def in_json(command: Callable[..., None]) -> Callable[..., None]:
    """The command with ``--json``, which prints what it hands to `rig.presentation.answer`."""

    @functools.wraps(command)
    def with_option(*words: Any, as_json: bool = False, **named: Any) -> None:
        if not as_json:
            command(*words, **named)
            return
        from rig.presentation import one_json_object

        status = 0
        with one_json_object():
            try:
                command(*words, **named)
            except typer.Exit as end:
                status = end.exit_code
        raise typer.Exit(status)

    stated = inspect.signature(command)
    option = inspect.Parameter("as_json", inspect.Parameter.KEYWORD_ONLY, default=False, annotation=_AsJson)
    vars(with_option)["__signature__"] = stated.replace(parameters=[*stated.parameters.values(), option])
    return with_option
