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
from itertools import pairwise
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from processing.errors import ConfigurationError, RigError
from rig.commands import archive, calibration, camera, fitting, init, measure, records, reporting, session
from rig.commands.arguments import ListingCommand
from rig.interruption import reason_of, replace_missing_characters, terminated_by_signals

_MADE_BETWEEN_COLLECTIONS = 10_000

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
"""The commands, and those with commands of their own, in the order and under the headings of `rig --help`."""


def _name(command: typer.Typer | Callable[..., None]) -> str:
    return str(command.info.name) if isinstance(command, typer.Typer) else command.__name__


GROUPS = {heading: tuple(map(_name, commands)) for heading, commands in _COMMANDS.items()}
"""Names of the commands under each heading."""


class _InGroups(TyperGroup):
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
    cls=_InGroups,
    help=(
        "Optical pendulum rig: measure, replay, view and analyse the free decay of a pendulum on one ball."
        "\n\nBegin with rig demo, a whole measurement on a simulated rig, or with rig init for your own."
    ),
    context_settings={"help_option_names": ["-h", "--help"]},
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
for _each in (each for commands in _COMMANDS.values() for each in commands):
    if isinstance(_each, typer.Typer):
        app.add_typer(_each)
    else:
        app.command(cls=ListingCommand)(_each)


def _version(asked: bool) -> None:
    if asked:
        # imported here because it reads e-mail headers, which takes longer than the rest of this module
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
        handlers=[_PresentStderr()],
    )


class _PresentStderr(logging.Handler):
    """Logs to the current `sys.stderr`, which a live screen replaces in order to print above itself."""

    def emit(self, record: logging.LogRecord) -> None:
        try:
            print(self.format(record), file=sys.stderr)
        except Exception:
            self.handleError(record)


def main() -> None:
    """Entry point of the ``rig`` script.

    Exit status 2 for what was not begun (wrong usage, no such file), 1 for what failed, 130 after Ctrl-C,
    SIGTERM or SIGHUP.
    """
    # Matrices here have a few columns: OpenBLAS's threads only spin, at the expense of the frames', and
    # make the last digits depend on the number of cores.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Imports make a hundred thousand objects that stay: to look through them for garbage as often as Python
    # does by itself takes a twentieth of the time of `rig fit`.
    gc.set_threshold(_MADE_BETWEEN_COLLECTIONS)
    replace_missing_characters()
    debug = "--debug" in sys.argv
    # accepted anywhere, because users append them to the command that has just said too little
    moved = [word for word in sys.argv[1:] if word in ("--debug", "-v", "--verbose")]
    sys.argv = [sys.argv[0], *moved, *(word for word in sys.argv[1:] if word not in moved)]
    try:
        sys.argv = _complete(sys.argv)
        with terminated_by_signals():
            status = app(prog_name="rig", standalone_mode=False)
    except (typer.Abort, KeyboardInterrupt) as ended:
        # typer turns KeyboardInterrupt into Abort
        interrupt = ended.__cause__ if isinstance(ended, typer.Abort) else ended
        reason = reason_of(interrupt if isinstance(interrupt, KeyboardInterrupt) else KeyboardInterrupt())
        print(f"rig: {reason}", file=sys.stderr)
        status = 130
    except BrokenPipeError:
        sys.stderr.close()
        status = 0
    except Exception as error:
        if debug:
            raise
        status = _say(error)
    sys.exit(status if isinstance(status, int) else 0)


def _complete(words: list[str]) -> list[str]:
    """The words, with `--view` alone said in full; raises ConfigurationError for an empty one.

    Conditions of the archive may be empty.
    """
    found: list[str] = []
    for word, following in pairwise([*words, "--"]):
        if not word.strip() or re.fullmatch(r"--[\w-]+=\s*", word):
            before = f" after {found[-1]}" if found[-1].startswith("-") else ""
            if before or "archive" not in words[1:]:
                raise ConfigurationError(f"an argument{before} is empty; state a value, or leave it out")
        found += [word, "window"] if word == "--view" and not _is_way_to_view(following) else [word]
    return found


def _is_way_to_view(word: str) -> bool:
    """Whether a word behind `--view` is meant as its value, right or wrong: no option, no file."""
    return word in ("window", "web") or (word.isalpha() and not os.path.lexists(word))


def _example(words: list[str]) -> str:
    """The first example of the command's own help; empty where it has none."""
    named = [word for word in words[1:] if not word.startswith("-")]
    command: object = typer.main.get_command(app)
    for word in named:
        inner = getattr(command, "commands", {}).get(word)
        if inner is None:
            break
        command = inner
    lines = [line.strip() for line in (getattr(command, "help", None) or "").splitlines()]
    shown = next((line for line in lines if line.startswith("rig ")), "")
    return f", for example {shown}" if shown else ""


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
    found = re.match(r"Invalid value for ([^:]*): (.*)", text, re.DOTALL)
    if found is None:
        return text
    names = re.findall(r"'(-[^']*)'", found[1])
    for word, following in pairwise([*words, ""]):
        option, equals, value = word.partition("=")
        if option in names:
            reason = found[2].rstrip(".")
            choices = reason.partition(" is not one of ")[2]
            meant = get_close_matches((value or following).lower(), re.findall(r"'([^']*)'", choices), 1)
            reason += f"; did you mean {meant[0]}?" if meant else ""
            return f"{option} {value if equals else following}: {reason}"
    return text


def _say(error: Exception) -> int:
    """Print a line on stderr for an error, or for each fault of a file; returns the exit status."""
    if type(error).__name__ == "NoArgsIsHelpError":
        # click's private way to ask for the help of a command that was given nothing
        print(str(error), file=sys.stderr)
        return 2
    if isinstance(error, RigError):
        text, status = str(error), 2 if isinstance(error, ConfigurationError) else 1
    elif isinstance(error, OSError) and error.strerror:
        # what no command foresaw: a disk that fills up, a folder that is taken away
        text, status = f"{error.filename or 'a file or device'}: {error.strerror} (--debug shows where)", 1
    elif hasattr(error, "format_message"):
        # wrong usage, reported by typer
        text, status = _usage_message(error.format_message(), sys.argv), 2
    else:
        text, status = f"{type(error).__name__}: {error} (--debug shows where)", 1
    for line in text.splitlines() if isinstance(error, ConfigurationError) else [text]:
        print(f"rig: {' '.join(line.split())}", file=sys.stderr)
    return status
