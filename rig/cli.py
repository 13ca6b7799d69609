"""The command line: parses arguments, calls commands, turns errors into one line and an exit status.

Heavy imports are made inside the commands, so that ``rig --help`` responds immediately.
"""

import gc
import logging
import os
import re
import sys
from collections.abc import Callable, Mapping
from difflib import get_close_matches
from itertools import chain, pairwise
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from processing.errors import ConfigurationError, RigError
from rig.commands import archive, calibration, camera, fitting, init, measure, records, reporting, session
from rig.commands.arguments import ListingCommand
from rig.interruption import reason_of, replace_missing_characters, terminated_by_signals

_OBJECTS_BETWEEN_COLLECTIONS = 10_000

_COMMANDS: Mapping[str, tuple[typer.Typer | Callable[..., None], ...]] = {
    "Measure": (
        measure.run,
        measure.demo,
        session.desk,
        session.balance,
        camera.commands,
        calibration.commands,
        session.light,
    ),
    "Look": (measure.view, measure.replay, records.commands),
    "Results": (
        fitting.fit,
        reporting.report,
        reporting.export,
        reporting.compare,
        reporting.plan,
        reporting.paper,
        archive.commands,
    ),
    "Care": (init.init, session.doctor),
}
"""The commands and groups of commands, under the headings of `rig --help` and in its order."""


def _name(command: typer.Typer | Callable[..., None]) -> str:
    return str(command.info.name) if isinstance(command, typer.Typer) else command.__name__


GROUPS = {heading: tuple(map(_name, commands)) for heading, commands in _COMMANDS.items()}
"""Names of the commands under each heading."""


class _GroupedCommands(TyperGroup):
    """Lists the commands under the headings of `GROUPS`."""

    def list_commands(self, ctx: Any) -> list[str]:
        return [name for names in GROUPS.values() for name in names]

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        for heading, names in GROUPS.items():
            with formatter.section(heading):
                limit = formatter.width - 6 - max(map(len, self.commands))
                formatter.write_dl([(name, self.commands[name].get_short_help_str(limit)) for name in names])


app = typer.Typer(
    name="rig",
    cls=_GroupedCommands,
    help=(
        "Optical pendulum rig: measure, replay, view and analyse the free decay of a pendulum on one ball."
        "\n\nBegin with rig demo, a whole measurement on a simulated rig, or with rig init for your own."
    ),
    context_settings={"help_option_names": ["-h", "--help"]},
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
for _command in chain.from_iterable(_COMMANDS.values()):
    if isinstance(_command, typer.Typer):
        app.add_typer(_command)
    else:
        app.command(cls=ListingCommand)(_command)


def _version(is_requested: bool) -> None:
    if is_requested:
        # imported here: it imports the parser of e-mail headers, which takes longer than the rest
        from importlib import metadata

        print(f"optical-pendulum-rig {metadata.version('optical-pendulum-rig')}")
        raise typer.Exit


@app.callback()
def _options(
    debug: Annotated[bool, typer.Option("--debug", help="Show tracebacks and debug messages.")] = False,
    verbose: Annotated[
        bool, typer.Option("--verbose", "-v", help="Show tables and remarks of every run of a series.")
    ] = False,
    version: Annotated[
        bool, typer.Option("--version", help="Show the version and exit.", is_eager=True, callback=_version)
    ] = False,
) -> None:
    logging.getLogger("rig").setLevel(logging.INFO if verbose else logging.NOTSET)
    logging.basicConfig(
        level=logging.DEBUG if debug else logging.WARNING,
        format="%(levelname)s %(name)s: %(message)s" if debug else "%(message)s",
        handlers=[_CurrentStderr()],
    )


class _CurrentStderr(logging.Handler):
    """Logs to the current `sys.stderr`; a live screen replaces it, so that lines appear above the screen."""

    def emit(self, record: logging.LogRecord) -> None:
        try:
            print(self.format(record), file=sys.stderr)
        except Exception:
            self.handleError(record)


def main() -> None:
    """Entry point of the ``rig`` script.

    The exit status is 2 if nothing was begun (wrong usage, no such file), 1 after a failure, and 130 after
    Ctrl-C, SIGTERM or SIGHUP.
    """
    # For matrices of a few columns OpenBLAS's threads only take time from those of the frames, and make the
    # last digits depend on the number of cores.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Imports make a hundred thousand objects that stay: searching them for garbage as often as Python does
    # by default takes a twentieth of the time of `rig fit`.
    gc.set_threshold(_OBJECTS_BETWEEN_COLLECTIONS)
    replace_missing_characters()
    debug = "--debug" in sys.argv
    # accepted anywhere, because users append them to the command that has just said too little
    global_options = [word for word in sys.argv[1:] if word in ("--debug", "-v", "--verbose")]
    words = [word for word in sys.argv[1:] if word not in global_options]
    try:
        sys.argv = [sys.argv[0], *global_options, *_checked_words(words)]
        with terminated_by_signals():
            status = app(prog_name="rig", standalone_mode=False)
    except (typer.Abort, KeyboardInterrupt) as error:
        # typer turns KeyboardInterrupt into Abort
        interrupt = error.__cause__ if isinstance(error, typer.Abort) else error
        reason = reason_of(interrupt if isinstance(interrupt, KeyboardInterrupt) else KeyboardInterrupt())
        print(f"rig: {reason}", file=sys.stderr)
        status = 130
    except BrokenPipeError:
        sys.stderr.close()
        status = 0
    except Exception as error:
        if debug:
            raise
        status = _report_error(error)
    sys.exit(status if isinstance(status, int) else 0)


def _checked_words(words: list[str]) -> list[str]:
    """The words after `rig`, with the value `window` after a `--view` without a value.

    Raises ConfigurationError for an empty word; conditions of the archive may be empty.
    """
    result: list[str] = []
    for previous, word, following in zip(["", *words], words, [*words[1:], "--"], strict=False):
        if not word.strip() or re.fullmatch(r"--[\w-]+=\s*", word):
            option = f" after {previous}" if previous.startswith("-") else ""
            if option or "archive" not in words:
                raise ConfigurationError(f"an argument{option} is empty; state a value, or leave it out")
        result += [word, "window"] if word == "--view" and not _is_view_mode(following) else [word]
    return result


def _is_view_mode(word: str) -> bool:
    """Whether a word after `--view` is its value, valid or not; an option or a file is not."""
    return word in ("window", "web") or (word.isalpha() and not os.path.lexists(word))


def _example(words: list[str]) -> str:
    """The first example of the command's own help; empty where it has none."""
    command: object = typer.main.get_command(app)
    for word in (word for word in words[1:] if not word.startswith("-")):
        subcommand = getattr(command, "commands", {}).get(word)
        if subcommand is None:
            break
        command = subcommand
    lines = [line.strip() for line in (getattr(command, "help", None) or "").splitlines()]
    example = next((line for line in lines if line.startswith("rig ")), "")
    return f", for example {example}" if example else ""


def _usage_message(text: str, words: list[str]) -> str:
    """Typer's message on a wrong call, with the value received and without the names of typer's classes."""
    text = (
        text.removeprefix("Invalid value: ")
        .replace("Input should be", "should be")
        .replace("greater than or equal to", "at least")
        .replace("less than or equal to", "at most")
        .replace("a valid number", "a number")
        .replace("a valid integer", "a whole number")
        .replace("Value error, ", "")
    )
    text = re.sub(r", unable to parse string as an? \w+", "", text)
    if text.startswith("Missing argument"):
        text = re.sub(r"'.*'", lambda name: name[0].upper(), text)
    if text.startswith("Missing "):
        text = text.rstrip(".")
        return f"{text}; --help shows what is needed{_example(words)}"
    if re.fullmatch(r"No such (option|command)[^(]*", text):
        return f"{text.rstrip('.')}; --help lists the choices"
    if text.startswith("Got unexpected extra argument"):
        return f"{text.replace('(s)', '')}; put a name with spaces in quotes"
    match = re.match(r"Invalid value for ([^:]*): (.*)", text, re.DOTALL)
    if match is None:
        return text
    names = re.findall(r"'(-[^']*)'", match[1])
    for word, following in pairwise([*words, ""]):
        option, equals, value = word.partition("=")
        if option in names:
            reason = match[2].rstrip(".")
            choices = reason.partition(" is not one of ")[2]
            stated = value if equals else following
            close = get_close_matches(stated.lower(), re.findall(r"'([^']*)'", choices), 1)
            reason += f"; did you mean {close[0]}?" if close else ""
            return f"{option} {stated}: {reason}"
    return text


def _report_error(error: Exception) -> int:
    """Print a line on stderr for an error, or for each fault of a file; returns the exit status."""
    if type(error).__name__ == "NoArgsIsHelpError":
        # click's private exception for the help of a command without arguments
        print(str(error), file=sys.stderr)
        return 2
    if isinstance(error, RigError):
        text, status = str(error), 2 if isinstance(error, ConfigurationError) else 1
    elif isinstance(error, OSError) and error.strerror:
        # an error that no command handles: a full disk, a removed folder
        text, status = f"{error.filename or 'a file or device'}: {error.strerror} (--debug shows where)", 1
    elif hasattr(error, "format_message"):
        # wrong usage, reported by typer
        text, status = _usage_message(error.format_message(), sys.argv), 2
    else:
        text, status = f"{type(error).__name__}: {error} (--debug shows where)", 1
    for line in text.splitlines() if isinstance(error, ConfigurationError) else [text]:
        print(f"rig: {' '.join(line.split())}", file=sys.stderr)
    return status
