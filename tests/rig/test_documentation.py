"""The commands in README and docs run as they are written."""

import json
import re
import runpy
import shlex
import shutil
import textwrap
import tomllib
from pathlib import Path
from typing import Any, get_origin

import pytest
import typer.main

from rig.cli import app
from rig.prepare.calibration_inputs import TransferFile, read_input
from rig.settings import Configuration, load_configuration, validate_configuration
from rig.settings.validation_messages import section_fields, section_of
from tests.rig.command_line import QUICK, SAMPLES, rig, set_words
from tests.rig.view.replay_record import RATE_HZ, make_record

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
DOCUMENTS = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    ROOT / "SECURITY.md",
    *sorted((ROOT / ".github").rglob("*.*")),
    *sorted(DOCS.glob("*.md")),
    *sorted((DOCS / "reference").glob("*.md")),
]


def text_of(document: Path) -> str:
    return document.read_text(encoding="utf-8")


def files_shown(name: str, folder: Path | None = None) -> dict[str, str]:
    """The files that a page of docs shows, by their names; made in a folder."""
    shown = re.findall(r"^```toml\n# (\S+\.toml)\n(.*?)^```", text_of(DOCS / name), re.M | re.S)
    for file, block in shown if folder else ():
        assert not (folder / file).exists()
        (folder / file).write_text(block, encoding="utf-8")
    return dict(shown)


def ran(line: str, folder: Path, *more: str) -> str:
    """What a command line of a page prints, which succeeds."""
    done = rig(*shlex.split(line)[1:], *more, cwd=folder)
    assert done.returncode == 0, f"{line}: {done.stderr[-500:]}"
    return done.stdout


def measured(line: str, folder: Path, series: Path) -> None:
    """A series that is measured already stands for the one that `rig run` would measure for minutes."""
    words = shlex.split(line)[1:]
    load_configuration(folder / words[1], words[words.index("--set") + 1 :] if "--set" in words else [])
    shutil.copytree(series, folder / words[words.index("-o") + 1])


def indented(document: Path, section: str = "") -> list[str]:
    """Command lines of a page, or of a section: indented by four spaces, comments cut off."""
    text = text_of(document)
    if section:
        _, found, text = text.partition(f"\n## {section}\n")
        assert found, f"{document.name}: has no section {section}"
        text = text.partition("\n## ")[0]
    lines = re.findall(r"^ {4}(?:\$ )?((?:rig|make) .*)$", text, re.MULTILINE)
    return [line.split("  #")[0].strip() for line in lines]


def test_make_targets_and_commands_that_are_named_exist() -> None:
    targets = set(re.findall(r"^([\w-]+):", text_of(ROOT / "Makefile"), re.MULTILINE))
    lines = [line for document in DOCUMENTS for line in indented(document)]
    assert {"demo", "test"} <= {line.split()[1] for line in lines if line.startswith("make ")} <= targets
    known = set(re.findall(r"^  (\w+) ", rig("--help").stdout, re.MULTILINE))
    for document in DOCUMENTS:
        named = set(re.findall(r"`rig (\w+)", text_of(document)))
        assert named <= known, f"{document.name}: {named - known}"


def test_options_that_are_shown_exist() -> None:
    """Of every command line in the documents, also of those that need an instrument."""
    shown, program = 0, typer.main.get_command(app)
    for document in DOCUMENTS:
        for line in re.findall(r"^(?: {4,7})?(?:\$ )?(?:sudo )?(rig [a-z].*)$", text_of(document), re.M):
            words = shlex.split(line, comments=True)[1:]
            command: Any = program
            while inner := getattr(command, "commands", {}):
                assert words[0] in inner, f"{document.name}: {line}"
                command = inner[words.pop(0)]
            known = {name for each in command.params for name in (*each.opts, *each.secondary_opts)}
            given = {word for word in words if re.fullmatch(r"--?[a-z][\w-]*", word)}
            assert given <= known | {"--help"}, f"{document.name}: {line}: {given - known}"
            shown += 1
    assert shown > 80


def test_version_help_and_completion(monkeypatch: pytest.MonkeyPatch) -> None:
    assert re.fullmatch(r"optical-pendulum-rig \d+\.\d+\.\d+\S*\n", rig("--version").stdout)
    alone = rig("camera")
    assert (alone.returncode, alone.stdout) == (2, "")
    assert "Commands:\n  show " in alone.stderr
    monkeypatch.setenv("_RIG_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", "rig cal")
    monkeypatch.setenv("COMP_CWORD", "1")
    assert rig().stdout.split() == ["calibrate"]


def test_pictures_pages_and_files_that_are_linked_or_named_exist() -> None:
    rooms = ("rig/", "acquisition/", "calibration/", "processing/", "tests/", "docs/", "configs/")
    for document in [*DOCUMENTS, *sorted((DOCS / "decisions").glob("*.md"))]:
        text = text_of(document)
        linked = [target for target in re.findall(r"\]\(([^)#]+)", text) if "://" not in target]
        assert [target for target in linked if not (document.parent / target).exists()] == [], document.name
        named = [name for name in re.findall(r"`([\w./-]+)`", text) if name.startswith(rooms)]
        assert [name for name in named if not (ROOT / name).exists()] == [], document.name


def test_configurations_that_are_shown_are_valid() -> None:
    found = 0
    for document in DOCUMENTS:
        text = text_of(document)
        blocks = re.findall(r"^ {4}\[[a-z_.0-9]+\]\n(?:(?: {4}.*)?\n)+", text, re.MULTILINE)
        for block in [*blocks, *re.findall(r"^```toml\n(\[\w.*?)^```", text, re.MULTILINE | re.DOTALL)]:
            if document.name != "calibrate.md":
                tree = tomllib.loads(textwrap.dedent(block))
                assert (ROOT / "configs" / tree.pop("extends", "demo.toml")).exists()
                tree.setdefault("camera", {}).setdefault("driver", "simulated")
                validate_configuration(tree, document.name)
                found += 1
    assert found >= 4


def test_the_files_of_calibrations_are_read_as_they_are_shown(tmp_path: Path) -> None:
    files_shown("calibrate.md", tmp_path)
    levers = []
    for line in ("rig calibrate lever geometry.toml", "rig calibrate lever tilts.toml"):
        assert f"    {line}\n" in text_of(DOCS / "calibrate.md")
        levers.append(ran(line, tmp_path).splitlines()[-1])
    checked = ran(f"rig calibrate check tilts.toml --lever {levers[0]}", tmp_path)
    assert "calibrate again" not in checked
    assert len(read_input(tmp_path / "transfer.toml", TransferFile).level) == 5


@pytest.mark.slow
def test_a_rig_is_built_as_it_is_written(tmp_path: Path, measured_series: Path) -> None:
    """Its rehearsal: the configuration with the simulated camera."""
    ((name, block),) = files_shown("build.md").items()
    assert 'driver = "usb3vision"' in block
    validate_configuration(tomllib.loads(block), name)
    (tmp_path / name).write_text(block.replace("usb3vision", "simulated"), encoding="utf-8")
    files_shown("calibrate.md", tmp_path)
    made = []
    for line in indented(DOCS / "build.md"):
        if line.startswith("rig run "):
            measured(line, tmp_path, measured_series)
        elif not line.startswith("rig calibrate sensor"):
            said = ran(line, tmp_path, *(["--seconds", "1"] if "align" in line else []))
            made += [said.splitlines()[-1]] if line.startswith("rig calibrate") else []
    (section,) = re.findall(r"^```toml\n(\[calibration\]\n.*?)^```", text_of(DOCS / "build.md"), re.M | re.S)
    assert set(made) <= set(tomllib.loads(section)["calibration"].values())


def test_the_notebook_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With a short session in the place of the one of `start.md`; the outputs it keeps are from that."""
    path = DOCS / "notebooks" / "own-law.ipynb"
    shutil.copytree(SAMPLES / "series", tmp_path / "runs" / "tutorial")
    (tmp_path / "docs" / "notebooks").mkdir(parents=True)
    monkeypatch.chdir(tmp_path / "docs" / "notebooks")
    cells = runpy.run_path(str(path.parent / "fill.py"))["run_cells"](path)["cells"]
    for cell, shown in zip(cells, json.loads(text_of(path))["cells"], strict=True):
        kinds = ([output["output_type"] for output in one.get("outputs", [])] for one in (cell, shown))
        assert next(kinds) == next(kinds)
    printed = "".join(str(cell.get("outputs", "")) for cell in cells)
    assert float(re.findall(r"paper: chi2/dof ([\d.]+)", printed)[0]) < 3


def test_messages_that_are_explained_exist() -> None:
    """What the page of troubles quotes in the first column is said by the program, word for word."""
    text = text_of(DOCS / "troubleshooting.md")
    quoted = re.findall(r'"([^"|]+)"', " ".join(re.findall(r"^\|([^|]+)\|", text, re.MULTILINE)))
    assert len(quoted) >= 15
    sources = [ROOT / "Makefile"]
    for package in ("rig", "acquisition", "calibration", "processing"):
        sources += sorted((ROOT / package).rglob("*.py"))
    said = "\n".join(text_of(path) for path in sources)
    assert [words for words in quoted if words not in said] == []


def test_sections_that_are_named_exist() -> None:
    """In README and docs; an example of `extending.md` adds a section of its own."""
    found = set()
    others = set(DOCS.rglob("*.md")) - {DOCS / "extending.md"}
    for document in [ROOT / "README.md", *sorted(others)]:
        for name in re.findall(r"`\[([\w.]+)\]`", text_of(document)):
            assert is_section(name), f"{document.name}: [{name}] is no section of a configuration"
            found.add(name)
    assert len(found) >= 5


def test_a_section_that_does_not_exist_is_found() -> None:
    names = ("start", "simulation.release", "materials.mine", "starts", "start.release", "start.way")
    assert [is_section(name) for name in names] == 3 * [True] + 3 * [False]


def is_section(name: str) -> bool:
    """Whether a dotted name is a section of the configuration, or one of a table of sections."""
    section: type = Configuration
    parts = iter(name.split("."))
    for part in parts:
        field = section_fields(section).get(part)
        inner = None if field is None else section_of(field)
        if field is None or inner is None:
            return False
        if get_origin(field.annotation) is dict:
            next(parts, None)
        section = inner
    return True


def test_the_snippet_about_records_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = text_of(DOCS / "reference" / "record.md")
    (block,) = re.findall(r"(?:^ {4}.*\n|^\n)*^ {4}from pathlib.*\n(?:^ {4}.*\n|^\n)*", text, re.MULTILINE)
    monkeypatch.chdir(tmp_path)
    make_record(tmp_path / "run-1.mcap", 20.0, windows=True)
    names: dict[str, Any] = {}
    exec(textwrap.dedent(block), names)
    assert len(names["spots"]) == 20 * RATE_HZ - 1
    assert len(names["half_cycles"]) >= 5
    assert names["window"].image.shape == (84, 84)


@pytest.mark.slow
def test_the_commands_of_the_start(tmp_path: Path, measured_series: Path) -> None:
    """The demonstration is README's, whose test measures it."""
    lines = [line for line in indented(DOCS / "start.md") if line.startswith("rig ")]
    assert lines[0] in indented(ROOT / "README.md")
    assert [line.split()[1] for line in lines] == [
        "demo",
        "run",
        "record",
        "view",
        "replay",
        "run",
        "compare",
    ]
    shutil.copytree(ROOT / "configs", tmp_path / "configs")
    files_shown("start.md", tmp_path / "configs")
    series = iter((measured_series, SAMPLES / "series"))
    for line in lines[1:]:
        if line.startswith("rig run "):
            measured(line, tmp_path, next(series))
        else:
            ran(line, tmp_path)
    assert (tmp_path / "runs" / "tutorial.rrd").stat().st_size > 0


@pytest.mark.slow
def test_the_commands_about_results_laws_and_plans(tmp_path: Path) -> None:
    shutil.copytree(ROOT / "configs", tmp_path / "configs")
    shutil.copytree(SAMPLES / "first", tmp_path / "runs" / "first")
    sections = ("What to quote", "Fit again, compare with the paper", "Which law it is")
    lines = [line for section in sections for line in indented(DOCS / "results.md", section)]
    lines += indented(DOCS / "many-runs.md", "Plan runs")
    assert [line.split()[1] for line in lines] == ["export", "fit", "fit", "fit", "fit", "plan", "plan"]
    for line in lines:
        # for a run so short that they do not converge, these laws take minutes
        if "masing" not in line:
            ran(re.sub(r"\ball\b", "viscous", line), tmp_path)


@pytest.mark.slow
def test_the_readme_from_top_to_bottom(tmp_path: Path) -> None:
    """And then the page that says more of the same commands."""
    (tmp_path / "configs").symlink_to(ROOT / "configs")
    lines = [line for line in indented(ROOT / "README.md") if line.startswith("rig ")]
    lines += indented(DOCS / "measure.md", "Look at a run again")
    assert len(lines) >= 8
    # half a minute of swings on a small sensor instead of twenty minutes, and no contact, as `start.md` has
    # one; figures have tests of their own
    for line in lines:
        ran(line, tmp_path, *(set_words(QUICK) if line.startswith("rig demo") else []))
    assert (tmp_path / "first.rrd").stat().st_size > 0
    assert (tmp_path / "runs" / "first" / "report.html").exists()


def test_the_rooms_are_listed_from_top_to_bottom() -> None:
    """Those of `rig` in the order in which they may import each other, and those of `processing`."""
    text = text_of(ROOT / "CONTRIBUTING.md")
    listed = re.findall(r"^\| `(\w+)/` \|", text, re.MULTILINE)
    pyproject = tomllib.loads(text_of(ROOT / "pyproject.toml"))
    (layers,) = (
        contract["layers"]
        for contract in pyproject["tool"]["importlinter"]["contracts"]
        if contract.get("containers") == ["rig"]
    )
    folders = {path.parent.name for path in (ROOT / "rig").glob("*/__init__.py")}
    of_rig = listed[: len(folders)]
    assert set(of_rig) == folders
    floor = {room.strip(): number for number, layer in enumerate(layers) for room in layer.split("|")}
    assert sorted(of_rig, key=floor.__getitem__) == of_rig
    others = {path.parent.name for path in (ROOT / "processing").glob("*/__init__.py")}
    assert set(listed[len(folders) :]) == others
    assert len(listed) == len(folders) + len(others)
