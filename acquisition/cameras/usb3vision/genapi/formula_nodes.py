"""Nodes whose value is calculated by a formula: SwissKnife (read only) and Converter (read and write)."""

from abc import abstractmethod

from acquisition.cameras.usb3vision.genapi.description import NodeDescription
from acquisition.cameras.usb3vision.genapi.formula import Formula
from acquisition.cameras.usb3vision.genapi.node import Access, Node, Nodes, parse_number
from acquisition.cameras.usb3vision.genapi.operators import Number


class _Calculated(Node):
    """Base class: variables, constants and named expressions of the formulas."""

    def __init__(self, description: NodeDescription, nodes: Nodes) -> None:
        super().__init__(description, nodes)
        self._whole = description.kind.startswith("Int")
        self._variables = {
            item.attributes.get("Name", ""): item.text for item in description.all("pVariable")
        }
        self._formulas: dict[str, Formula] = {}

    def variable_values(self) -> dict[str, Number]:
        """Present values of all variables and constants; all are read, also if the formula does not need
        them.
        """
        values = {
            name: self._variable(name, self.nodes.node(target)) for name, target in self._variables.items()
        }
        for item in self.description.all("Constant"):
            values[item.attributes.get("Name", "")] = self._constant(item.text)
        return values

    def number(self) -> Number:
        return self.nodes.look.number(self.name, self._number)

    get = number

    @abstractmethod
    def _number(self) -> Number:
        """Calculate the value."""

    def _with_variables(self, mode: Access) -> Access:
        for target in self._variables.values():
            mode = mode.where_readable(self.nodes.node(target).access())
        return mode

    def _constant(self, text: str) -> Number:
        try:
            return parse_number(text)
        except ValueError:
            raise self.broken(f"its constant {text!r} is not a number") from None

    def _variable(self, name: str, node: Node) -> Number:
        """Value of a variable. The suffix of its name selects the node's value, limits, step, or a choice."""
        stem, _, suffix = name.partition(".")
        if stem and suffix.startswith(("Entry.", "Enum.")):
            return node.entry_number(suffix.partition(".")[2])
        limits = {"Min": node.minimum, "Max": node.maximum, "Inc": node.increment} if stem else {}
        value = limits.get(suffix, node.number)()
        if value is None:
            raise self.broken(f"{node.name} has no {suffix}")
        return value

    def evaluate(self, tag: str, values: dict[str, Number]) -> Number:
        """Value of the formula with this tag, after the named expressions that it may use."""
        known = dict(values)
        for item in self.description.all("Expression"):
            name = item.attributes.get("Name", "")
            known[name] = self._formula(f"Expression {name}", item.text, known)(known)
        text = self.description.text(tag)
        if text is None:
            raise self.broken(f"it has no {tag}")
        return self._formula(tag, text, known)(known)

    def _formula(self, key: str, text: str, known: dict[str, Number]) -> Formula:
        if key not in self._formulas:
            owner = f"{self.nodes.name}: {self.name}"
            self._formulas[key] = Formula(text, whole=self._whole, variables=frozenset(known), owner=owner)
        return self._formulas[key]


class SwissKnife(_Calculated):
    """A value calculated from other nodes; it cannot be set."""

    def own_access(self) -> Access:
        return self._with_variables(Access.READ_ONLY)

    def _number(self) -> Number:
        self.must_be_readable()
        return self.evaluate("Formula", self.variable_values())


class Converter(_Calculated):
    """A value converted to and from that of another node: FormulaTo(FROM) is written, FormulaFrom(TO) is
    read.
    """

    def _target(self) -> Node:
        target = self.referred("pValue")
        if target is None:
            raise self.broken("a converter without pValue")
        return target

    def own_access(self) -> Access:
        return self._with_variables(self._target().access())

    def _number(self) -> Number:
        self.must_be_readable()
        return self._from(self._target().number(), self.variable_values())

    def _from(self, value: Number, variables: dict[str, Number]) -> Number:
        return self.evaluate("FormulaFrom", variables | {"TO": value})

    def set_number(self, value: Number) -> None:
        self.must_be_writable()
        self._target().set_number(self.evaluate("FormulaTo", self.variable_values() | {"FROM": value}))

    set = set_number
    """Set the value; the limits are those of the other node."""

    def _limits(self) -> tuple[Number, Number] | None:
        low, high = self._target().minimum(), self._target().maximum()
        if low is None or high is None or self.description.text("Slope") == "Varying":
            return None
        variables = self.variable_values()
        ends = self._from(low, variables), self._from(high, variables)
        return min(ends), max(ends)

    def minimum(self) -> Number | None:
        limits = self._limits()
        return None if limits is None else limits[0]

    def maximum(self) -> Number | None:
        limits = self._limits()
        return None if limits is None else limits[1]
