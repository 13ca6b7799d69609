"""Of all sources: one way to write a file, stated encodings, and no text for people that is read back."""

import ast
import gc
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
_CALLS = {
    "write_text", "write_bytes", "touch", "copyfile", "copy2", "copyfileobj", "copytree", "move",
    "imwrite", "FileSink", "NamedTemporaryFile", "mkstemp", "rename", "symlink_to", "hardlink_to",
}  # fmt: skip
"""Names of calls that write or name a file whatever is given to them."""
_CREATES = {"O_WRONLY", "O_RDWR", "O_CREAT"}

ALLOWED = {
    # the way itself, and records, which grow while they are measured and are proved by their own sums
    "acquisition/atomic_write.py": "is the way",
    "acquisition/record/mcap_file.py": "a record while it is measured, which a cut must leave readable",
    # names that atomic_file or atomic_folder gave
    "rig/report/export.py": "under the name that atomic_file gives",
    "rig/settings/configuration_writer.py": "under the name that atomic_file gives",
    "rig/measure/plain_record.py": "in the folder that atomic_folder gives",
    # lines that are added, never changed
    "rig/prepare/learned_turns.py": "a history to which lines are added",
    "rig/measure/session_orders.py": "lines of a file beside the record, which holds them too",
    "rig/devices/audit.py": "lines that are added, each forced to the disk",
    "rig/desk/jobs.py": "what a program prints",
    # no content that anybody keeps
    "rig/devices/order_socket.py": "a live port, gone with its process",
    "processing/kernel_compiler.py": "a lock",
    "rig/control/safety_state.py": "a lock",
    "rig/desk/store.py": "a lock",
    "rig/measure/session_file.py": "a lock",
    "rig/measure/run_parts.py": "a record set aside under another name",
    "rig/interruption.py": "the null device",
    "rig/measure/screen.py": "the null device",
    # devices
    "rig/control/presses.py": "the time of a file alone, where a full disk takes no content; a device's port",
    "rig/control/usbtmc.py": "a device's port",
    "acquisition/cameras/v4l2/kernel.py": "a device's node",
    # other programs' own
    "rig/view/show.py": "a stream that Rerun's library writes",
    "rig/control/firmware/board.py": "runs on the controller, with a rename of its own",
}  # fmt: skip
"""Modules that write otherwise, and why they may."""


_PROSE = {
    "alarm", "doing", "flaw", "headline", "instruction", "line", "measured", "next_step", "note", "notes",
    "opened_text", "output", "progress", "reason", "refusal", "remedy", "said", "sentence", "text", "title",
    "why", "words",
}  # fmt: skip
"""Attributes that hold texts for people."""
_READING = {
    "endswith", "find", "index", "partition", "removeprefix", "removesuffix", "rpartition", "split",
    "startswith",
}  # fmt: skip
MAY_READ = {
    "rig/archive/session_rows.py": "the path stands in another column, and is not repeated in the flaw",
    "rig/terminal/verdict.py": "a message states its remedy behind a semicolon",
    "processing/least_squares.py": "scipy raises the same class for every fault",
}
"""Where a text is read all the same, and why."""


def _calls(tree: ast.AST) -> Iterator[tuple[str, str, ast.Call]]:
    """Every call: its name, the name of what it is a method of, if that is one, and the call."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            owner = getattr(node.func, "value", None)
            of = "" if owner is None else getattr(owner, "id", "?")
            yield getattr(node.func, "attr", getattr(node.func, "id", "")), of, node


def _mode(call: ast.Call) -> str:
    """The mode in which a call opens a file, as far as one is written there."""
    given = [*call.args, *(key.value for key in call.keywords)]
    texts = [part.value for part in given if isinstance(part, ast.Constant) and isinstance(part.value, str)]
    return next((text for text in texts if text and set(text) <= set("rwxabt+")), "")


_IN_MEMORY = {"buffer", "out", "data", "file", "beside", "run"}
"""Variables that name no file on a disk, or what the one writer has opened."""


def _writes(tree: ast.AST) -> Iterator[str]:
    """The names of calls that write a file."""
    for name, of, call in _calls(tree):
        ends = call.args[:1] + call.args[-1:]
        if any(getattr(getattr(end, "func", None), "attr", "") == "dup" for end in ends):
            continue  # of what is open
        flags = {part.attr for part in ast.walk(call) if isinstance(part, ast.Attribute)}
        target = getattr(ends[name.startswith("write")], "id", "?") if ends else ""
        if (
            name in _CALLS
            or (of, name) == ("shutil", "copy")
            or ((of, name) == ("os", "open") and flags & _CREATES)
            or (name in ("open", "fdopen", "File") and set(_mode(call)) & set("wxa+"))
            or (name in ("savefig", "write_table", "to_csv", "write_csv") and of and ends
                and target not in _IN_MEMORY)
        ):  # fmt: skip
            yield name


def _unstated(tree: ast.AST) -> Iterator[int]:
    """Lines with a call that reads or writes text and leaves the encoding to the system."""
    for name, of, call in _calls(tree):
        stated = {key.arg for key in call.keywords}
        is_text = bool(_mode(call)) and "b" not in _mode(call)
        if "encoding" not in stated and (
            (name == "read_text" and not call.args)
            or name == "write_text"
            or (name in ("open", "fdopen") and is_text)
            or ((name, of) == ("open", "") and not _mode(call))
            or (name in ("run", "Popen", "check_output") and "text" in stated)
        ):
            yield call.lineno


def _readings(tree: ast.AST) -> Iterator[str]:
    """Expressions that take a text for people apart, or compare it with a literal."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and getattr(node.func, "attr", "") in _READING:
            held = node.func.value  # type: ignore[attr-defined]
            found = _is_prose(held.value if isinstance(held, ast.Subscript) else held)
        elif isinstance(node, ast.Compare):
            sides = [node.left, *node.comparators]
            literals = [
                side for side in sides if isinstance(side, ast.Constant) and side.value not in ("", None)
            ]
            found = bool(literals) and any(map(_is_prose, sides))
        else:
            continue
        if found:
            yield ast.unparse(node)


def _is_prose(node: ast.expr) -> bool:
    if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "str":
        return any(getattr(argument, "id", "") == "error" for argument in node.args)
    return isinstance(node, ast.Attribute) and node.attr in _PROSE


@pytest.fixture(scope="module")
def trees() -> dict[str, ast.Module]:
    """Every module of the program, parsed; searches for garbage meanwhile would take as long again."""
    gc.disable()
    try:
        return {
            path.relative_to(ROOT).as_posix(): ast.parse(path.read_text(encoding="utf-8"))
            for package in ("rig", "acquisition", "calibration", "processing")
            for path in sorted((ROOT / package).rglob("*.py"))
        }
    finally:
        gc.enable()


def test_nothing_writes_a_file_but_the_one_writer_and_what_says_why(trees: dict[str, ast.Module]) -> None:
    found = {name: calls for name, tree in trees.items() if (calls := list(_writes(tree)))}
    others = {name: calls for name, calls in found.items() if name not in ALLOWED}
    assert not others, f"write through acquisition.atomic_write, or say why not: {others}"
    # a reason that has nothing to say any more
    assert not ALLOWED.keys() - found.keys()


def test_text_has_the_same_encoding_on_every_system(trees: dict[str, ast.Module]) -> None:
    """Windows would take the one of the country, and a log of an operator's name could not be read again."""
    # firmware runs on the controller
    found = [f"{name}:{line}" for name, tree in trees.items() if "/firmware/" not in name
             for line in _unstated(tree)]  # fmt: skip
    assert not found


def test_no_text_for_people_is_read_back(trees: dict[str, ast.Module]) -> None:
    """States are told apart by values, texts are only shown."""
    found = {name: read for name, tree in trees.items() if (read := list(_readings(tree)))}
    unexpected = {name: read for name, read in found.items() if name not in MAY_READ}
    assert not unexpected, "give what is told apart a value (an enumeration, a field); show the text only"
    # these read no text any more
    assert not MAY_READ.keys() - found.keys()


def test_what_writes_and_what_implies_an_encoding_is_found() -> None:
    writes = [
        "path.write_text('x')", "open(path, 'w')", "path.open('ab')", "os.open(path, os.O_WRONLY)",
        "figure.savefig(path)", "h5py.File(path, 'x')", "parquet.write_table(table, path)",
    ]  # fmt: skip
    assert [len(list(_writes(ast.parse(text)))) for text in writes] == [1] * len(writes)
    assert not list(_writes(ast.parse("path.open('rb'); open(path); path.read_text(); figure.savefig(out)")))
    lines = [
        "path.read_text()", "open(path)", "open(path, 'w')", "path.open('a')", "os.fdopen(1, 'w')",
        "run(words, text=True)", "path.read_text(encoding='utf-8')", "path.read_text('utf-8')",
        "open(path, 'rb')", "path.open('xb')", "camera.open()", "archive.open(name)",
    ]  # fmt: skip
    assert list(_unstated(ast.parse("\n".join(lines)))) == [1, 2, 3, 4, 5, 6]


@pytest.mark.parametrize(
    ("source", "is_read"),
    [
        ("ok = 'interlock closed' in now.text", True),
        ("head = drag.text.split(':')[0]", True),
        ("ended = stops[-1].text.startswith(NOT_ACCEPTED)", True),
        ("told = snapshot.reason == 'stopped by the user'", True),
        ("known = 'no such row' in str(error)", True),
        ("ok = now.interlock_closed", False),
        ("shown = f'{verdict.text}: {drag.p_value}'", False),
        ("quiet = snapshot.alarm == ''", False),
        ("fields = line.split(',')", False),
    ],
)
def test_what_reads_a_text_is_found(source: str, is_read: bool) -> None:
    assert bool(list(_readings(ast.parse(source)))) is is_read
