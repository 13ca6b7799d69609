"""Commands on records: `rig record info`, `check` and `recover`."""

from pathlib import Path
from typing import Annotated

import typer

from acquisition.record import recovery_path, resolve_records
from processing.errors import RigError
from rig.commands.arguments import Record, group, in_json, input_option, new_file, one_record, output_option

_HIDDEN_SECTIONS = {"record"}
"""Sections of a record's metadata that are not printed."""


@in_json
def info(record: Record) -> None:
    """Print what a record contains, and how it was made.

    \b
    Example:
      rig record info runs/first
    """
    for path in resolve_records(record):
        _print_info(path)


def _print_info(path: Path) -> None:
    """Print the decay in a record, the result next to it, and the contents."""
    from acquisition.record.digest import RecordedCamera, utc_text
    from acquisition.record.reader import RecordReader
    from processing.units import seconds
    from rig.terminal import answer, print_line

    with RecordReader(path) as reader:
        numbers_file, metadata = reader.numbers, reader.metadata
        losses, counts, files = reader.losses(), reader.counts, reader.files
        half_cycles, unit = reader.half_cycles(), reader.deflection_unit
        attachments = {name: len(next(numbers_file.copies(name), b"")) for name in numbers_file.attachments}
        damages = reader.damages
    amplitudes = [h.amplitude / unit.shown_size for h in half_cycles if not h.flags]
    amplitude = f"{amplitudes[0]:.2f} to {amplitudes[-1]:.2f} {unit.shown}" if amplitudes else "none"
    count = f"{len(half_cycles)}, {len(half_cycles) - len(amplitudes)} of them flagged"
    result = _result_summary(path)
    sizes = []
    for file in files:
        truncation = f"cut short after {_size(file.readable_bytes)} (see rig record recover)"
        sizes.append(f"{file.path}: {_size(file.size)}, {'whole' if file.is_complete else truncation}")
    print_line(sizes[0])
    for name, text in (("amplitude", amplitude), ("half-cycles", count), ("result", result)):
        print_line(f"{name:<12} {text}")
    for line in sizes[1:]:
        print_line(line)
    print_line(f"schema {int(metadata['record']['schema_version'])}, written by {numbers_file.library}")
    start_ns, end_ns = numbers_file.start_ns, numbers_file.end_ns
    if start_ns:
        clock = " of simulated time" if RecordedCamera.from_metadata(metadata).simulated else ""
        duration_s = seconds(end_ns - start_ns)
        print_line(f"{utc_text(start_ns)} to {utc_text(end_ns)}, {duration_s:.1f} s{clock}")
    for topic, messages in counts.items():
        print_line(f"  {topic:<20} {messages}")
    if losses is not None:
        print_line(f"frames lost: {losses}")
    for section, texts in metadata.items():
        stated = {key: text for key, text in texts.items() if text}
        if section not in _HIDDEN_SECTIONS and stated:
            print_line(f"{section}")
            for key, text in stated.items():
                print_line(f"  {key:<20} {text}")
    for name, size in attachments.items():
        print_line(f"attachment {name} ({_size(size)})")
    for damage in damages:
        print_line(f"problem: {damage}")
    answer(
        records=[
            {
                "path": path,
                "amplitudes": amplitudes[:1] + amplitudes[-1:],
                "amplitude_unit": unit.shown,
                "half_cycles": len(half_cycles),
                "result": result,
                "size_bytes": sum(file.size for file in files),
                "whole": all(file.is_complete for file in files),
                "start_ns": start_ns,
                "end_ns": end_ns,
                "messages": dict(counts),
                "frames_lost": losses,
                "metadata": metadata,
                "attachments": attachments,
                "damage": damages,
            }
        ]
    )


def _result_summary(path: Path) -> str:
    """One line on the result next to a record, or why there is none."""
    from rig.analysis import main_result, read_results, results_path

    source = results_path(path.parent)
    if not source.exists():
        return f"none yet; rig fit {path} makes one"
    try:
        run = next((run for run in read_results(source).runs if Path(run.record).name == path.name), None)
    except RigError as error:
        return str(error)
    if run is None:
        return f"none in {source.name}; rig fit {path} makes one"
    problem = f"not fitted: {run.problem}" if run.problem else "nothing was fitted"
    return f"{main_result(run).text or problem} ({source.name})"


@in_json
def check(
    record: Record,
    results: Annotated[
        Path | None,
        input_option("results.json that names the record's hash; default: the one beside the record."),
    ] = None,
) -> None:
    """Verify a record: checksums, gaps, times, hash.

    \b
    Example:
      rig record check runs/first
    """
    raise typer.Exit(max([_print_check(path, results) for path in resolve_records(record)]))


def _print_check(path: Path, results: Path | None) -> int:
    """Print one line for each finding; returns the exit status, 1 if there is an error."""
    from acquisition.record.check import check_record
    from rig.analysis import results_path
    from rig.terminal import answer, print_line

    if results is None and (latest := results_path(path.parent)).exists():
        results = latest
    findings = check_record(path, results)
    if results is not None:
        from rig.report import check_report

        findings += check_report(results)
    for finding in findings:
        print_line(f"{finding.severity}: {finding.text}")
    answer(records=[{"path": path, "findings": list(findings)}])
    errors = sum(finding.severity == "error" for finding in findings)
    summary = "is sound" if not errors else "1 error" if errors == 1 else f"{errors} errors"
    print_line(f"{path}: {summary}")
    return 1 if errors else 0


@in_json
def recover(
    record: Record,
    output: Annotated[
        Path | None, output_option("File to write; default: NAME-recovered.mcap.", new_file(".mcap"))
    ] = None,
) -> None:
    """Save what is readable of a record that was cut short.

    \b
    Example:
      rig record recover runs/first/run-1.mcap
    """
    from acquisition.record.check import recover as recover_into
    from acquisition.record.digest import utc_text
    from acquisition.record.reader import RecordReader
    from rig.terminal import answer, print_line

    path = one_record(record)
    with RecordReader(path) as reader:
        if reader.is_sound:
            print_line(f"{path}: is sound, every byte is as written; there is nothing to recover")
            answer(path=path, sound=True)
            return
    target = output or recovery_path(path)
    recovery = recover_into(path, target)
    with RecordReader(target) as copy:
        messages, end_ns = copy.counts, max(file.end_ns for file in copy.files)
    answer(path=target, sound=False, messages=messages, recovery=recovery)
    counts = ", ".join(f"{count} {topic.lstrip('/')}" for topic, count in messages.items())
    print_line(f"{target}: {counts or 'no messages'}, up to {utc_text(end_ns)}")
    print_line(f"lost: {recovery['lost'] or 'nothing'}")


def _size(count: int) -> str:
    size = float(count)
    for unit in ("B", "kB", "MB"):
        if size < 1000:
            return f"{size:.0f} {unit}" if unit == "B" else f"{size:.1f} {unit}"
        size /= 1000
    return f"{size:.1f} GB"


commands = group("record", "Describe, verify and recover records.", info, check, recover)
