"""Reading, writing and finding results.json, and its JSON schema."""

import json
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from acquisition import atomic_write
from processing.errors import ConfigurationError, RecordError, require_schema
from processing.fault_text import fault_text
from rig.analysis.encoding import JsonObject, codec, file_schema
from rig.analysis.results import SCHEMA, RunResults, SessionResults
from rig.terminal import plain_values, translated_file_errors

RESULTS_NAME = "results.json"
_REMEDY = "rig fit makes it again from the record"


def encoded(values: object) -> JsonObject:
    """The JSON tree of results, or of a part of them."""
    # an analysed run or table has fields that the file does not hold
    bases: tuple[Any, ...] = (RunResults, SessionResults)
    kind: Any = next((base for base in bases if isinstance(values, base)), type(values))
    tree: JsonObject = codec(kind)[1].to_python(values, mode="json")
    return tree


def write_results(path: str | Path, results: SessionResults) -> None:
    """Write results.json, never over an existing file.

    Raises ConfigurationError for an existing file, and for values that are no results; RecordError for a
    file that cannot be written.
    """
    if not isinstance(results, SessionResults):
        raise ConfigurationError(f"results: SessionResults are needed, not a {type(results).__name__}")
    with translated_file_errors(Path(path)):
        atomic_write.write_new(Path(path), (_text(encoded(results)) + "\n").encode())


def _text(value: object, indent: str = "") -> str:
    """JSON with a line for each key; a list of plain values is on one line."""
    inner = indent + "  "
    if isinstance(value, dict) and value:
        rows = [f"{inner}{json.dumps(key)}: {_text(item, inner)}" for key, item in value.items()]
        return "{\n" + ",\n".join(rows) + f"\n{indent}}}"
    if isinstance(value, list) and not {dict, list}.isdisjoint(map(type, value)):
        return "[\n" + ",\n".join(inner + _text(item, inner) for item in value) + f"\n{indent}]"
    return json.dumps(value, allow_nan=False)


def results_path(source: Path) -> Path:
    """A results file itself, or the latest one of a folder: results-2.json comes after results.json."""
    if not source.is_dir():
        return source
    files = {path.stem.removeprefix("results-"): path for path in source.glob("results-*.json")}
    numbered = {int(suffix): path for suffix, path in files.items() if suffix.isdecimal()}
    return numbered[max(numbered)] if numbered else source / RESULTS_NAME


def read_results(source: str | Path) -> SessionResults:
    """results.json of a session's folder, or a results file: of records, or of the decays of a table.

    Raises RecordError in one line for a missing file, and for a key that cannot be read.
    """
    source = Path(source)
    path = results_path(source)
    try:
        tree = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        missing = (
            f"holds no {RESULTS_NAME}" if source.is_dir() else "no such folder or results file (results.json)"
        )
        raise RecordError(f"{source}: {missing}; rig run makes one, and rig fit from records") from None
    except OSError as error:
        raise RecordError(f"{path}: cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError:
        raise RecordError(f"{path}: is not a results file; name {RESULTS_NAME} or its folder") from None
    except (ValueError, RecursionError) as error:
        raise RecordError(f"{path}: cannot be read: it is not JSON ({error}); {_REMEDY}") from None
    return decoded(tree, path)


def decoded(tree: Any, path: Path) -> SessionResults:
    """Results from the tree by `encoded`; RecordError names the file and the key at fault."""
    runs = tree.get("runs") if isinstance(tree, dict) else None
    if not isinstance(runs, list) or not runs:
        raise RecordError(f"{path}: names no runs; it was not made by rig run or rig fit")
    require_schema(str(path), tree.get("schema"), SCHEMA, RecordError)
    try:
        results: SessionResults = codec(SessionResults)[0].validate_python(tree)
    except ValidationError as error:
        fault = error.errors()[0]
        # names of validators, which have parentheses, are no keys of the file
        keys = tuple(key for key in fault["loc"] if isinstance(key, int) or "(" not in key)
        raise RecordError(f"{path}: {fault_text({**fault, 'loc': keys})}; {_REMEDY}") from None
    return results


def recorded_results(record: Path, sha256: str) -> tuple[str, RunResults | None]:
    """Newest results of a record in its folder: the file's name and the run; ("", None) if there are none."""
    files = sorted(record.parent.glob("results*.json"), key=lambda path: path.stat().st_mtime, reverse=True)
    for path in files:
        try:
            runs = read_results(path).runs
        except RecordError:
            continue
        if run := next((run for run in runs if run.sha256 == sha256), None):
            return path.name, run
    return "", None


def free_path(folder: Path) -> Path:
    """Path of new results in a folder: results.json, or the first free one of results-2.json, ...."""
    path, number = folder / RESULTS_NAME, 2
    while path.exists():
        path, number = folder / f"{Path(RESULTS_NAME).stem}-{number}.json", number + 1
    return path


def relative_record(record: Path, folder: Path) -> str:
    """The path of a record as the file names it: relative to `folder` if it lies inside, else absolute."""
    try:
        return record.resolve().relative_to(folder.resolve()).as_posix()
    except ValueError:
        return record.resolve().as_posix()


def results_schema() -> str:
    """The JSON schema of results.json (JSON Schema 2020-12), the text of docs/results.schema.json."""
    tree = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": RESULTS_NAME,
        "description": f"Version {SCHEMA}: of records, or of a table of positions of any instrument.",
        **file_schema(SessionResults),
    }
    return _text(plain_values(tree)) + "\n"
