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
from tests.rig.command_line import SMALL, rig, set_words
from tests.rig.view.replay_record import RATE_HZ, make_record

ROOT = Path(__file__).resolve().parents[2]
DOCUMENTS = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    ROOT / "SECURITY.md",
    *sorted((ROOT / ".github").rglob("*.*")),
    *sorted((ROOT / "docs").glob("*.md")),
    *sorted((ROOT / "docs" / "reference").glob("*.md")),
]
SHORT = set_words(SMALL | {"session.max_duration_s": "24"})


def indented(document: Path, section: str = "") -> list[str]:
    """Command lines of a page, or of a section: indented by four spaces, comments cut off."""
    text = document.read_text(encoding="utf-8")
    if section:
        _, found, text = text.partition(f"\n## {section}\n")
        assert found, f"{document.name}: has no section {section}"
        text = text.partition("\n## ")[0]
    lines = re.findall(r"^ {4}(?:\$ )?((?:rig|make) .*)$", text, re.MULTILINE)
    return [line.split("  #")[0].strip() for line in lines]


def test_make_targets_that_are_named_exist() -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    targets = set(re.findall(r"^([\w-]+):", makefile, re.MULTILINE))
    named = {
        line.split()[1] for document in DOCUMENTS for line in indented(document) if line.startswith("make ")
    }
    assert {"demo", "test"} <= named
    assert named <= targets


def test_commands_that_are_named_exist() -> None:
    listing = rig("--help")
    known = set(re.findall(r"^  (\w+) ", listing.stdout, re.MULTILINE))
    for document in DOCUMENTS:
        named = set(re.findall(r"`rig (\w+)", document.read_text(encoding="utf-8")))
        assert named <= known, f"{document.name}: {named - known}"


def test_options_that_are_shown_exist() -> None:
    """Of every command line in the documents, also of those that need an instrument."""
    shown, program = 0, typer.main.get_command(app)
    for document in DOCUMENTS:
        text = document.read_text(encoding="utf-8")
        for line in re.findall(r"^(?: {4,7})?(?:\$ )?(?:sudo )?(rig [a-z].*)$", text, re.MULTILINE):
            words = shlex.split(line, comments=True)[1:]
            command: Any = program
            while inner := getattr(command, "commands", {}):
                assert words[0] in inner, f"{document.name}: {line}"
                command = inner[words.pop(0)]
            known = {"--help", *(name for parameter in command.params for name in parameter.opts)}
            known |= {name for parameter in command.params for name in parameter.secondary_opts}
            given = {word for word in words if re.fullmatch(r"--?[a-z][\w-]*", word)}
            assert given <= known, f"{document.name}: {line}: {given - known}"
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


def test_pictures_and_pages_that_are_linked_exist() -> None:
    for document in DOCUMENTS:
        for target in re.findall(r"\]\(([^)#]+)", document.read_text(encoding="utf-8")):
            if "://" not in target:
                assert (document.parent / target).exists(), f"{document.name}: {target}"


def test_files_that_are_named_exist() -> None:
    rooms = ("rig/", "acquisition/", "calibration/", "processing/", "tests/", "docs/", "configs/")
    for document in [*DOCUMENTS, *sorted((ROOT / "docs" / "decisions").glob("*.md"))]:
        for name in re.findall(r"`([\w./-]+)`", document.read_text(encoding="utf-8")):
            assert not name.startswith(rooms) or (ROOT / name).exists(), f"{document.name}: {name}"


def test_configurations_that_are_shown_are_valid() -> None:
    found = 0
    for document in DOCUMENTS:
        text = document.read_text(encoding="utf-8")
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
    text = (ROOT / "docs" / "calibrate.md").read_text(encoding="utf-8")
    for name, block in re.findall(r"^```toml\n# (\S+\.toml)\n(.*?)^```", text, re.MULTILINE | re.DOTALL):
        (tmp_path / name).write_text(block, encoding="utf-8")
    levers = []
    for line in ("rig calibrate lever geometry.toml", "rig calibrate lever tilts.toml"):
        assert f"    {line}\n" in text
        done = rig(*line.split()[1:], cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        levers.append(done.stdout.splitlines()[-1])
    done = rig("calibrate", "check", "tilts.toml", "--lever", levers[0], cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "calibrate again" not in done.stdout
    assert len(read_input(tmp_path / "transfer.toml", TransferFile).level) == 5


@pytest.mark.slow
def test_a_rig_is_built_as_it_is_written(tmp_path: Path, measured_series: Path) -> None:
    """Its rehearsal: the configuration with the simulated camera; a measured series stands for the runs."""
    text = (ROOT / "docs" / "build.md").read_text(encoding="utf-8")
    ((name, block),) = re.findall(r"^```toml\n# (\S+\.toml)\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    assert 'driver = "usb3vision"' in block
    validate_configuration(tomllib.loads(block), name)
    (tmp_path / name).write_text(block.replace("usb3vision", "simulated"), encoding="utf-8")
    calibrations = (ROOT / "docs" / "calibrate.md").read_text(encoding="utf-8")
    for file, shown in re.findall(r"^```toml\n# (\S+\.toml)\n(.*?)^```", calibrations, re.M | re.S):
        (tmp_path / file).write_text(shown, encoding="utf-8")
    made = []
    for line in indented(ROOT / "docs" / "build.md"):
        words = shlex.split(line)[1:]
        if words[0] == "run":
            load_configuration(
                tmp_path / words[1], words[words.index("--set") + 1 :] if "--set" in words else []
            )
            shutil.copytree(measured_series, tmp_path / words[words.index("-o") + 1])
        elif words[:2] != ["calibrate", "sensor"]:
            short = ["--seconds", "1"] if "align" in words else []
            done = rig(*words, *short, cwd=tmp_path)
            assert done.returncode == 0, f"{line}: {done.stderr[-500:]}"
            made += [done.stdout.splitlines()[-1]] if words[0] == "calibrate" else []
    (section,) = re.findall(r"^```toml\n(\[calibration\]\n.*?)^```", text, re.MULTILINE | re.DOTALL)
    assert set(made) <= set(tomllib.loads(section)["calibration"].values())


def test_the_notebook_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With a short session in the place of the one of `start.md`; the outputs it keeps are from that."""
    path = ROOT / "docs" / "notebooks" / "own-law.ipynb"
    shutil.copytree(ROOT / "tests" / "rig" / "data" / "samples" / "series", tmp_path / "runs" / "tutorial")
    (tmp_path / "docs" / "notebooks").mkdir(parents=True)
    monkeypatch.chdir(tmp_path / "docs" / "notebooks")
    ran = runpy.run_path(str(path.parent / "fill.py"))["run_cells"](path)
    kept = json.loads(path.read_text(encoding="utf-8"))
    for cell, shown in zip(ran["cells"], kept["cells"], strict=True):
        outputs = cell.get("outputs", []), shown.get("outputs", [])
        assert [output["output_type"] for output in outputs[0]] == [o["output_type"] for o in outputs[1]]
    printed = "".join(str(cell.get("outputs", "")) for cell in ran["cells"])
    assert float(re.findall(r"paper: chi2/dof ([\d.]+)", printed)[0]) < 3


def test_messages_that_are_explained_exist() -> None:
    """What the page of troubles quotes in the first column is said by the program, word for word."""
    text = (ROOT / "docs" / "troubleshooting.md").read_text(encoding="utf-8")
    quoted = re.findall(r'"([^"|]+)"', " ".join(re.findall(r"^\|([^|]+)\|", text, re.MULTILINE)))
    assert len(quoted) >= 15
    sources = [ROOT / "Makefile"]
    for package in ("rig", "acquisition", "calibration", "processing"):
        sources += sorted((ROOT / package).rglob("*.py"))
    said = "\n".join(path.read_text(encoding="utf-8") for path in sources)
    assert [words for words in quoted if words not in said] == []


def test_sections_that_are_named_exist() -> None:
    """In README and docs; an example of `extending.md` adds a section of its own."""
    found = set()
    others = set((ROOT / "docs").rglob("*.md")) - {ROOT / "docs" / "extending.md"}
    for document in [ROOT / "README.md", *sorted(others)]:
        for name in re.findall(r"`\[([\w.]+)\]`", document.read_text(encoding="utf-8")):
            assert is_section(name), f"{document.name}: [{name}] is no section of a configuration"
            found.add(name)
    assert len(found) >= 5


def test_a_section_that_does_not_exist_is_found() -> None:
    assert is_section("start")
    assert is_section("simulation.release")
    assert is_section("materials.mine")
    assert not is_section("starts")
    assert not is_section("start.release")
    assert not is_section("start.way")


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
    text = (ROOT / "docs" / "reference" / "record.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"(?:^ {4}.*\n|^\n)*^ {4}from pathlib.*\n(?:^ {4}.*\n|^\n)*", text, re.MULTILINE)
    monkeypatch.chdir(tmp_path)
    make_record(tmp_path / "run-1.mcap", 20.0, windows=True)
    names: dict[str, Any] = {}
    exec(textwrap.dedent(block), names)
    assert len(names["spots"]) == 20 * RATE_HZ - 1
    assert len(names["swings"]) >= 5
    assert names["window"].image.shape == (84, 84)


@pytest.mark.slow
def test_the_commands_of_the_start(tmp_path: Path, measured_series: Path) -> None:
    """Series that are measured already stand for those that `rig run` would measure for minutes.

    The demonstration is README's, whose test measures it.
    """
    lines = [line for line in indented(ROOT / "docs" / "start.md") if line.startswith("rig ")]
    assert lines[0] in indented(ROOT / "README.md")
    named = "demo run record view replay run compare"
    assert [line.split()[1] for line in lines] == named.split()
    shutil.copytree(ROOT / "configs", tmp_path / "configs")
    text = (ROOT / "docs" / "start.md").read_text(encoding="utf-8")
    for name, block in re.findall(r"^```toml\n# (\S+\.toml)\n(.*?)^```", text, re.MULTILINE | re.DOTALL):
        assert not (tmp_path / "configs" / name).exists()
        (tmp_path / "configs" / name).write_text(block, encoding="utf-8")
    series = iter((measured_series, ROOT / "tests" / "rig" / "data" / "samples" / "series"))
    for line in lines[1:]:
        words = shlex.split(line)[1:]
        if words[0] == "run":
            load_configuration(tmp_path / words[1], words[words.index("--set") + 1 :])
            shutil.copytree(next(series), tmp_path / words[words.index("-o") + 1])
        else:
            done = rig(*words, cwd=tmp_path)
            assert done.returncode == 0, f"{line}: {done.stderr[-500:]}"
    assert (tmp_path / "runs" / "tutorial.rrd").stat().st_size > 0


@pytest.mark.slow
def test_the_commands_about_results_laws_and_plans(tmp_path: Path) -> None:
    shutil.copytree(ROOT / "configs", tmp_path / "configs")
    shutil.copytree(ROOT / "tests" / "rig" / "data" / "samples" / "first", tmp_path / "runs" / "first")
    sections = ("What to quote", "Fit again, compare with the paper", "Which law it is")
    lines = [line for section in sections for line in indented(ROOT / "docs" / "results.md", section)]
    lines += indented(ROOT / "docs" / "many-runs.md", "Plan runs")
    assert [line.split()[1] for line in lines] == ["export", "fit", "fit", "fit", "fit", "plan", "plan"]
    for line in lines:
        if "masing" in line:
            # for a run so short that they do not converge, these laws take minutes
            continue
        words = ["viscous" if word == "all" else word for word in shlex.split(line)[1:]]
        done = rig(*words, cwd=tmp_path)
        assert done.returncode == 0, f"{line}: {done.stderr[-500:]}"


@pytest.mark.slow
def test_the_readme_from_top_to_bottom(tmp_path: Path) -> None:
    """And then the page that says more of the same commands."""
    (tmp_path / "configs").symlink_to(ROOT / "configs")
    commands = [
        *(line for line in indented(ROOT / "README.md") if line.startswith("rig ")),
        *indented(ROOT / "docs" / "measure.md", "Look at a run again"),
    ]
    assert len(commands) >= 8
    for line in commands:
        words = shlex.split(line)[1:]
        # a minute of swings on a small sensor instead of twenty, and no contact, as `start.md` has one;
        # figures have tests of their own
        extra = [*SHORT, "--set", 'instrument.kind="tomlinson"'] if words[0] == "demo" else []
        done = rig(*words, *extra, cwd=tmp_path)
        assert done.returncode == 0, f"{line}: {done.stderr[-500:]}"
    assert (tmp_path / "first.rrd").stat().st_size > 0
    assert (tmp_path / "runs" / "first" / "report.html").exists()


def test_the_rooms_are_listed_from_top_to_bottom() -> None:
    """Those of `rig` in the order in which they may import each other, and those of `processing`."""
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    listed = re.findall(r"^\| `(\w+)/` \|", text, re.MULTILINE)
    pyproject = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
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
