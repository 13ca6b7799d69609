"""What a contributor's tools read agrees with what pyproject.toml and the Makefile state."""

import re
import subprocess
import tomllib
from importlib import metadata
from pathlib import Path
from typing import Any

import yaml

ROOT = Path(__file__).resolve().parents[1]
PROJECT: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
SYSTEMS = {"ubuntu": "POSIX :: Linux", "macos": "MacOS", "windows": "Microsoft :: Windows"}


def text_of(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


def loaded(name: str) -> Any:
    return yaml.safe_load(text_of(name))


def classified(topic: str) -> set[str]:
    found = (line.partition(f"{topic} :: ")[2] for line in PROJECT["project"]["classifiers"])
    return {name for name in found if name}


def test_the_matrix_has_every_system_and_python_that_the_package_names() -> None:
    matrix = loaded(".github/workflows/checks.yml")["jobs"]["test"]["strategy"]["matrix"]
    pythons = {name for name in classified("Programming Language :: Python") if "." in name}
    assert set(matrix["python"]) == pythons
    assert f">={matrix['python'][0]}" == PROJECT["project"]["requires-python"]
    systems = {SYSTEMS[name.partition("-")[0]] for name in matrix["os"]}
    assert systems == classified("Operating System")


def test_the_workflow_runs_what_exists() -> None:
    text = text_of(".github/workflows/checks.yml")
    for target in re.findall(r"run: make ([\w-]+)", text):
        assert f"\n{target}: " in text_of("Makefile")
    named = re.findall(r"(?<![\w/])(?:tests|configs)/[\w./]+", text)
    assert len(named) >= 5
    assert all((ROOT / name).exists() for name in named)


def test_the_demonstration_is_measured_once_into_the_folder_that_the_pages_name(tmp_path: Path) -> None:
    (tmp_path / "Makefile").write_text(text_of("Makefile"), encoding="utf-8")
    for made in ("runs/first", None):
        plan = subprocess.run(
            ["make", "-n", "-o", ".venv/.installed", "demo"],
            cwd=tmp_path, capture_output=True, text=True, check=True,
        ).stdout  # fmt: skip
        words = plan.split()
        assert words[words.index("run") + 1] == "configs/demo.toml"
        assert (words[words.index("-o") + 1] if "-o" in words else None) == made
        (tmp_path / "runs" / "first" / "run-1.mcap").mkdir(parents=True, exist_ok=True)
    assert "    rig demo -o runs/first\n" in text_of("README.md")


def test_hooks_run_the_pinned_tools_of_make_lint() -> None:
    (repository,) = loaded(".pre-commit-config.yaml")["repos"]
    assert repository["repo"] == "local"
    run = {hook["entry"].split()[0].removeprefix(".venv/bin/") for hook in repository["hooks"]}
    lint = text_of("Makefile").partition("\nlint:")[2].partition("\n\n")[0]
    assert run == set(re.findall(r"\$\(BIN\)/([\w-]+)", lint))


def test_all_packages_carry_their_types() -> None:
    for package in PROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"]:
        assert (ROOT / package / "py.typed").is_file()


def test_the_version_is_stated_by_the_tag_alone() -> None:
    assert "version" not in PROJECT["project"]
    assert not re.search(r"^version:", text_of("CITATION.cff"), re.MULTILINE)
    assert re.fullmatch(r"\d+\.\d+\.\d+(\.dev\d+)?", metadata.version(PROJECT["project"]["name"]))


def test_forms_ask_for_each_thing_once_and_insist_on_one() -> None:
    forms = sorted((ROOT / ".github/ISSUE_TEMPLATE").glob("*.yml"))
    assert len(forms) == 3
    for form in forms:
        fields = [one for one in loaded(str(form.relative_to(ROOT)))["body"] if one["type"] != "markdown"]
        assert len({field["id"] for field in fields}) == len(fields) > 0
        assert any(field.get("validations", {}).get("required") for field in fields)


def test_a_release_is_published_without_a_secret_and_from_a_tag_alone() -> None:
    text = text_of(".github/workflows/release.yml")
    workflow = loaded(".github/workflows/release.yml")
    # yaml takes the key for a truth value
    assert workflow[True] == {"push": {"tags": ["v[0-9]+.[0-9]+.[0-9]+"]}}
    assert "secrets." not in text
    assert workflow["permissions"] == {"contents": "read"}
    publishing = workflow["jobs"]["pypi"]
    assert (publishing["permissions"], publishing["environment"]) == ({"id-token": "write"}, "pypi")
    assert "run" not in {key for step in publishing["steps"] for key in step}


def test_the_image_has_no_root_and_only_what_it_copies() -> None:
    lines = text_of("Containerfile").splitlines()
    users = [line.split()[1] for line in lines if line.startswith("USER ")]
    assert users == ["rig"]
    copies = [line.split()[1:-1] for line in lines if line.startswith("COPY ") and "--from" not in line]
    let_in = [line[1:] for line in text_of(".containerignore").splitlines() if line.startswith("!")]
    assert {word for words in copies for word in words} == set(let_in)
    extras = set(re.search(r"\.whl\)\[([\w,]+)\]", "\n".join(lines))[1].split(","))  # type: ignore[index]
    assert extras <= set(PROJECT["project"]["optional-dependencies"])
