"""Which single changes of a module are tried, found in its syntax tree and made in its text.

Docstrings, annotations, decorators, messages and what only a type checker reads stay as they are: nothing
follows from them that a test of behaviour could see.
"""

import ast
from collections.abc import Iterator
from dataclasses import dataclass

OPERATORS: dict[type[ast.AST], tuple[str, tuple[str, ...]]] = {
    ast.Add: ("+", ("-",)),
    ast.Sub: ("-", ("+",)),
    ast.Mult: ("*", ("/",)),
    ast.Div: ("/", ("*",)),
    ast.FloorDiv: ("//", ("/",)),
    ast.Mod: ("%", ("*",)),
    ast.Pow: ("**", ("*",)),
    ast.BitAnd: ("&", ("|",)),
    ast.BitOr: ("|", ("&",)),
    ast.LShift: ("<<", (">>",)),
    ast.RShift: (">>", ("<<",)),
    ast.And: ("and", ("or",)),
    ast.Or: ("or", ("and",)),
    ast.Lt: ("<", ("<=", ">")),
    ast.LtE: ("<=", ("<", ">=")),
    ast.Gt: (">", (">=", "<")),
    ast.GtE: (">=", (">", "<=")),
    ast.Eq: ("==", ("!=",)),
    ast.NotEq: ("!=", ("==",)),
    ast.Is: ("is", ("is not",)),
    ast.IsNot: ("is not", ("is",)),
    ast.In: ("in", ("not in",)),
    ast.NotIn: ("not in", ("in",)),
}
TWINS = {
    twin: other
    for pair in (
        ("min", "max"),
        ("any", "all"),
        ("floor", "ceil"),
        ("sin", "cos"),
        ("minimum", "maximum"),
        ("argmin", "argmax"),
        ("nanmin", "nanmax"),
    )
    for twin, other in (pair, pair[::-1])
}
"""Functions that are taken for each other."""
OF_CHECKS = {"strict", "frozen", "slots", "kw_only", "description", "title", "stacklevel"}
"""Arguments that guard against faults of ours, or are words."""


@dataclass(frozen=True, slots=True)
class Mutation:
    """Bytes `start` to `end` of a module replaced; `within` is the outermost function or class, if any."""

    start: int
    end: int
    text: str
    within: str

    def applied(self, source: bytes) -> bytes:
        """The module with it."""
        return source[: self.start] + self.text.encode() + source[self.end :]


def mutations(source: bytes) -> list[Mutation]:
    """All that can be made, in the order of the text; of each kind at one place all ways."""
    found = _Finder(source)
    tree = ast.parse(source)
    for statement in tree.body:
        found.within = getattr(statement, "name", "")
        found.visit(statement)
    return sorted(found.mutations, key=lambda mutation: (mutation.start, mutation.end, mutation.text))


class _Finder(ast.NodeVisitor):
    def __init__(self, source: bytes) -> None:
        self.mutations: list[Mutation] = []
        self.within = ""
        self._source = source
        self._lines = [0]
        for line in source.splitlines(keepends=True):
            self._lines.append(self._lines[-1] + len(line))

    def generic_visit(self, node: ast.AST) -> None:
        for name, value in ast.iter_fields(node):
            if name in ("annotation", "returns", "decorator_list", "type_params", "bases"):
                continue
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST):
                    self.visit(child)

    def _start(self, node: ast.expr | ast.stmt) -> int:
        return self._lines[node.lineno - 1] + node.col_offset

    def _end(self, node: ast.expr | ast.stmt) -> int:
        assert node.end_lineno is not None
        assert node.end_col_offset is not None
        return self._lines[node.end_lineno - 1] + node.end_col_offset

    def _replace(self, node: ast.expr, text: str) -> None:
        self.mutations.append(Mutation(self._start(node), self._end(node), text, self.within))

    def _other_operator(self, operator: ast.AST, start: int, end: int) -> None:
        """The operator in the text between two operands."""
        if type(operator) not in OPERATORS:
            return
        token, others = OPERATORS[type(operator)]
        at = self._source.find(token.encode(), start, end)
        if at >= 0 and b"#" not in self._source[start:end]:
            self.mutations += [Mutation(at, at + len(token), other, self.within) for other in others]

    def _opposite(self, test: ast.expr) -> None:
        """A branch that is never taken, and one taken where it should not be."""
        text = self._source[self._start(test) : self._end(test)].decode()
        self._replace(test, "False")
        self._replace(test, f"(not ({text}))")

    def visit_BinOp(self, node: ast.BinOp) -> None:
        if not (_is_text(node.left) or _is_text(node.right) or _is_type(node)):
            self._other_operator(node.op, self._end(node.left), self._start(node.right))
        self.generic_visit(node)

    def visit_AugAssign(self, node: ast.AugAssign) -> None:
        if not _is_text(node.value):
            self._other_operator(node.op, self._end(node.target), self._start(node.value))
        self.generic_visit(node)

    def visit_BoolOp(self, node: ast.BoolOp) -> None:
        for left, right in zip(node.values, node.values[1:], strict=False):
            self._other_operator(node.op, self._end(left), self._start(right))
        self.generic_visit(node)

    def visit_Compare(self, node: ast.Compare) -> None:
        operands = [node.left, *node.comparators]
        for operator, left, right in zip(node.ops, operands, operands[1:], strict=False):
            self._other_operator(operator, self._end(left), self._start(right))
        self.generic_visit(node)

    def visit_UnaryOp(self, node: ast.UnaryOp) -> None:
        token = {ast.USub: "-", ast.Not: "not ", ast.Invert: "~"}.get(type(node.op), "")
        if token:
            start = self._start(node)
            self.mutations.append(Mutation(start, start + len(token), "", self.within))
        self.generic_visit(node)

    def visit_Constant(self, node: ast.Constant) -> None:
        match node.value:
            case bool():
                self._replace(node, str(not node.value))
            case int():
                self._replace(node, str(node.value + 1))
            case float() if node.value == node.value:
                self._replace(node, repr(2 * node.value if node.value else 1.0))

    def visit_If(self, node: ast.If) -> None:
        if isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
            return
        if not all(isinstance(statement, ast.Raise) for statement in node.body):
            self._opposite(node.test)
        else:
            self._replace(node.test, "False")
        self.generic_visit(node)

    def visit_IfExp(self, node: ast.IfExp) -> None:
        self._opposite(node.test)
        self.generic_visit(node)

    def visit_Call(self, node: ast.Call) -> None:
        name, end = _called(node.func), self._end(node.func)
        if name in TWINS:
            self.mutations.append(Mutation(end - len(name), end, TWINS[name], self.within))
        if name not in ("TypeVar", "cast", "NewType"):
            self.generic_visit(node)

    def visit_keyword(self, node: ast.keyword) -> None:
        if node.arg not in OF_CHECKS:
            self.generic_visit(node)

    def visit_JoinedStr(self, node: ast.JoinedStr) -> None:
        """Words, with their roundings."""

    def visit_Raise(self, node: ast.Raise) -> None:
        """A message: that it is raised is changed by its condition."""

    def visit_Assert(self, node: ast.Assert) -> None:
        """For the type checker."""


def _called(function: ast.expr) -> str:
    match function:
        case ast.Name():
            return function.id
        case ast.Attribute():
            return function.attr
    return ""


def _is_text(node: ast.expr) -> bool:
    return isinstance(node, ast.JoinedStr) or (isinstance(node, ast.Constant) and isinstance(node.value, str))


def _is_type(node: ast.BinOp) -> bool:
    """``X | None`` and the like."""
    names = list(_names(node))
    return isinstance(node.op, ast.BitOr) and all(name == "None" or name[:1].isupper() for name in names)


def _names(node: ast.expr) -> Iterator[str]:
    match node:
        case ast.BinOp():
            yield from _names(node.left)
            yield from _names(node.right)
        case ast.Subscript():
            yield from _names(node.value)
        case ast.Constant():
            yield str(node.value)
        case ast.Name() | ast.Attribute():
            yield (
                "X"
                if _called(node) in ("int", "float", "str", "bytes", "list", "tuple", "dict")
                else _called(node)
            )
        case _:
            yield ""
