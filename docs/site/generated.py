"""What pages of the site say of commands, keys and schemas, made from the program itself, as Markdown."""

import json
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, get_origin

import click
import typer.main

import rig
from acquisition.record import topics
from acquisition.record.schemas import MessageType, comment_of
from rig.cli import app
from rig.settings import Configuration
from rig.settings.validation_messages import section_fields, section_of

ROOT = Path(__file__).resolve().parents[2]


def commands() -> str:
    """Every command with its help, arguments and options."""
    return "\n".join(_command("rig", typer.main.get_command(app)))


def _command(name: str, command: click.Command) -> Iterator[str]:
    context = click.Context(command, info_name=name)
    inner: dict[str, click.Command] = getattr(command, "commands", {})
    yield f"## {name}\n\n{_text(command.help or '')}\n"
    if not inner or name == "rig":
        usage = " ".join(command.collect_usage_pieces(context))
        yield f"    {name} {usage}\n"
        rows = [row for parameter in command.params if (row := parameter.get_help_record(context))]
        if rows:
            yield _table(("option", ""), [(f"`{option}`", _text(text)) for option, text in rows])
    for title, below in inner.items():
        yield from _command(f"{name} {title}", below)


def configuration() -> str:
    """Every section with its keys: type, default, limits, meaning."""
    return "\n".join(_section("", Configuration))


def _section(path: str, model: type) -> Iterator[str]:
    plain, below = [], []
    for key, field in section_fields(model).items():
        inner = section_of(field)
        here = f"{path}.{key}" if path else key
        if inner is None:
            limits = " ".join(_limit(rule) for rule in field.metadata)
            default = "required" if field.is_required() else f"`{_default(field)}`"
            plain.append(
                (f"`{key}`", f"`{_kind(field.annotation)}` {limits}", default, _text(field.description or ""))
            )
        else:
            below.append((f"{here}.NAME" if get_origin(field.annotation) is dict else here, inner))
    if path:
        about = (model.__doc__ or "").partition("\n\n")[0]
        yield f"## [{path}]\n\n{_text(about)}\n"
    if plain:
        yield _table(("key", "kind", "default", ""), plain)
    for here, inner in below:
        yield from _section(here, inner)


def _kind(annotation: Any) -> str:
    text = getattr(annotation, "__name__", "") if not get_origin(annotation) else str(annotation)
    text = re.sub(r"[\w.]+\.(\w+)", r"\1", text or str(annotation))
    text = re.sub(r"Optional\[(.*)\]$", r"\1", text).replace(" | None", "")
    return re.sub(r"Literal\[(.*)\]$", r"\1", text)


def _default(field: Any) -> str:
    value = field.get_default(call_default_factory=True)
    if value is None:
        return "none"
    return json.dumps(value, default=str) if not isinstance(value, float) else f"{value:g}"


def _limit(rule: Any) -> str:
    """A limit as it is said: at least, below."""
    signs = {"gt": ">", "ge": "≥", "lt": "<", "le": "≤"}
    return ", ".join(f"{sign} {getattr(rule, name):g}" for name, sign in signs.items() if hasattr(rule, name))


def results() -> str:
    """Every table of results.json with its keys, from the schema."""
    schema = json.loads((ROOT / "docs" / "results.schema.json").read_text(encoding="utf-8"))
    return "\n".join(_defined(name, entry) for name, entry in sorted(schema["$defs"].items()))


def _defined(name: str, entry: dict[str, Any]) -> str:
    title = f"## {name}\n\n{_text(entry.get('description', ''))}\n"
    rows = [
        (f"`{key}`", _schema_kind(value), _text(value.get("description", "")))
        for key, value in entry.get("properties", {}).items()
    ]
    return title + (("\n" + _table(("key", "kind", ""), rows)) if rows else "")


def _schema_kind(value: dict[str, Any]) -> str:
    if "$ref" in value:
        target = value["$ref"].rpartition("/")[2]
        return f"[{target}](#{target.lower()})"
    if "enum" in value or "const" in value:
        return "one of " + ", ".join(f"`{each}`" for each in value.get("enum", [value.get("const")]))
    choices = value.get("anyOf") or value.get("oneOf")
    if choices:
        return " or ".join(dict.fromkeys(_schema_kind(each) for each in choices))
    kind = value.get("type", "any")
    kind = " or ".join(kind) if isinstance(kind, list) else kind
    if isinstance(value.get("items"), dict):
        return f"{kind} of {_schema_kind(value['items'])}"
    if isinstance(value.get("additionalProperties"), dict):
        return f"table of {_schema_kind(value['additionalProperties'])}"
    return kind


def record_topics() -> str:
    """Every message of a record with its fields."""
    types = [value for value in vars(topics).values() if isinstance(value, MessageType)]
    return "\n".join(_message(each) for each in types)


def _message(message: MessageType) -> str:
    rows = [(f"`{name}`", kind, _text(comment_of(name))) for name, kind in message.fields]
    title = f"## {message.name}, `{message.topic}`"
    flags = "".join(_flags(meaning) for meaning in message.meanings)
    return f"{title}\n\n{_text(message.description)}\n\n{_table(('field', 'kind', ''), rows)}{flags}"


def _flags(meaning: Any) -> str:
    values = ", ".join(f"{member.value} {member.name}" for member in meaning)
    return f"\n{meaning.__name__}: {values}.\n"


def python() -> str:
    """Functions and classes of `import rig`, for autodoc."""
    lines = []
    for name in rig.__all__:
        value = getattr(rig, name)
        kind = "function" if not isinstance(value, type) else "class"
        kind = "exception" if isinstance(value, type) and issubclass(value, Exception) else kind
        lines += [f".. auto{kind}:: rig.{name}"]
        lines += ["   :members:"] if name in ("Record", "Session", "Deflections") else []
        lines.append("")
    return "```{eval-rst}\n" + "\n".join(lines) + "\n```\n"


def notebook() -> str:
    """The cells of the notebook with what they print and draw."""
    path = ROOT / "docs" / "notebooks" / "own-law.ipynb"
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    # the page has the title and the introduction
    return "\n\n".join(part for cell in cells[1:] for part in _cell(cell))


def _cell(cell: dict[str, Any]) -> Iterator[str]:
    source = "".join(cell["source"])
    yield source if cell["cell_type"] == "markdown" else f"```python\n{source}\n```"
    for output in cell.get("outputs", []):
        if "text" in output:
            yield "```text\n" + "".join(output["text"]) + "```"
        else:
            yield f'<img alt="figure" src="data:image/png;base64,{output["data"]["image/png"]}">'


def _table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    lines += ["| " + " | ".join(cell.replace("|", r"\|") for cell in row) + " |" for row in rows]
    return "\n".join(lines) + "\n"


def _text(text: str) -> str:
    """In one line, with what Markdown would take for its own left alone."""
    text = " ".join(text.replace("\b", "").split()).replace("``", "`")
    parts = text.split("`")
    parts[::2] = [re.sub(r"([\[\]<>*_|])", r"\\\1", part) for part in parts[::2]]
    return "`".join(parts)


PAGES: dict[str, Callable[[], str]] = {
    "commands": commands,
    "configuration": configuration,
    "results": results,
    "topics": record_topics,
    "python": python,
    "notebook": notebook,
}
