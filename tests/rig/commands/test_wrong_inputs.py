"""Wrong inputs: each is refused in clean lines that name it, with the right exit status.

Some hundreds are tried here, all of them by the benchmark `bench_inputs`.
"""

import re
from pathlib import Path

from processing.errors import ConfigurationError
from rig.settings import load_configuration
from tests.rig.command_line import CONFIGS, rig
from tests.rig.commands.wrong_inputs import WrongKey, WrongWords, wrong_keys, wrong_words

FOREIGN = re.compile(
    r"Input should|validation error|pydantic|\[type=|NoneType|Traceback|--debug shows|Errno|instance of"
    r"|or equal to|String should|match pattern"
)


def faults_of_key(wrong: WrongKey) -> list[str]:
    """What is not as it should be in the answer to a wrong key."""
    demo = CONFIGS / "demo.toml"
    try:
        load_configuration(demo, wrong.overrides)
    except ConfigurationError as error:
        lines = str(error).splitlines()
    else:
        return [f"{wrong} is taken"]
    found = [
        f"{wrong}: {line}" for line in lines if not line.startswith(("--set ", f"{demo}: ")) or unclean(line)
    ]
    return found if any(wrong.key in line for line in lines) else [*found, f"{wrong} is not named: {lines}"]


def faults_of_words(wrong: WrongWords, folder: Path) -> list[str]:
    """What is not as it should be in the answer to a wrong call."""
    done = rig(*wrong.words, cwd=folder)
    lines = done.stderr.splitlines() or [""]
    # a command that is given nothing prints its help
    said = "Usage:" in lines[0] or all(line.startswith("rig: ") for line in lines)
    if said and done.returncode == wrong.status and not done.stdout and not any(map(unclean, lines)):
        return []
    return [f"{wrong}: {done}"]


def unclean(line: str) -> bool:
    """Whether a line is too long, or in the words of a library."""
    return len(line) > 400 or FOREIGN.search(line) is not None


def test_a_wrong_key_is_named_in_clean_lines() -> None:
    wrong = list(wrong_keys())[::5]
    assert {each.kind for each in wrong} == {"type", "range", "unit", "missing", "doubled", "unknown"}
    assert len(wrong) >= 400
    assert [fault for each in wrong for fault in faults_of_key(each)] == []


def test_a_command_called_wrongly_says_so(tmp_path: Path) -> None:
    wrong = list(wrong_words(tmp_path))[::7]
    assert {each.kind for each in wrong} == {"unknown", "missing", "type", "range", "unreadable"}
    assert [fault for each in wrong for fault in faults_of_words(each, tmp_path)] == []
    assert sorted(path.name for path in tmp_path.iterdir()) == ["empty", "noise"]
