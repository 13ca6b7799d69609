"""The formulas of GenICam descriptions: parsed into functions, never executed as Python code.

The operators are those of the GenICam standard. Their precedence is that of EMVA's reference implementation,
with which manufacturers test their cameras; it differs from that of C::

    weakest   ?:  ||  &&  =  <>  <  >  <=  >=     (one level, from the left)
              +  -
              *  /  %
              **  &  |  ^  <<  >>                  (one level, from the left)
    strongest + - ~ in front of a value

Only the selected branch of ``?:`` is evaluated, so that a formula can avoid a division by zero.
"""

import math
import re
from collections.abc import Callable, Mapping
from typing import Final

from acquisition.cameras.usb3vision.genapi.operators import (
    BINARY,
    CONSTANTS,
    FUNCTIONS,
    Number,
    to_int64,
    truncated,
)
from processing.errors import DeviceError

_Evaluate = Callable[[Mapping[str, Number]], Number]

_TOKEN: Final = re.compile(
    r"\s*(?:(?P<hex>0[xX][0-9a-fA-F]+)|(?P<number>\d+(?:\.\d*)?(?:[eE][+-]?\d+)?|\.\d+(?:[eE][+-]?\d+)?)"
    r"|(?P<name>[A-Za-z_][\w.]*)|(?P<operator>\*\*|&&|\|\||<<|>>|<>|<=|>=|[-+*/%&|^~=<>?:(),]))"
)
_WEAKEST: Final = frozenset({"?", "||", "&&", "=", "<>", "<", ">", "<=", ">="})
_SUMS: Final = frozenset({"+", "-"})
_PRODUCTS: Final = frozenset({"*", "/", "%"})
_STRONGEST: Final = frozenset({"**", "&", "|", "^", "<<", ">>"})
_DEEPEST: Final = 60  # levels of brackets; real descriptions have fewer than 10


class FormulaError(DeviceError):
    """A formula in the camera's description is malformed or has no value."""


class Formula:
    """One formula, parsed once; called with the values of its variables, it returns a number.

    Parameters
    ----------
    text
        The formula as in the description.
    whole
        Calculate with 64-bit integers (IntSwissKnife, IntConverter: ``7 / 2`` is 3) instead of floats.
    variables
        Names of the variables that it may use.
    owner
        The feature to which it belongs, for messages.

    Raises
    ------
    FormulaError
        The formula is malformed; or, when called, it divides by zero or exceeds the range of numbers.
    """

    def __init__(self, text: str, *, whole: bool, variables: frozenset[str], owner: str) -> None:
        self.text = " ".join(text.split())
        self._whole = whole
        self._variables = variables
        self._owner = owner
        self._tokens = self._tokenise()
        self._at = 0
        self._depth = 0
        self._evaluate = self._weakest()
        if self._at < len(self._tokens):
            raise self._error(f"{self._tokens[self._at]!r} is out of place")

    def __call__(self, values: Mapping[str, Number]) -> Number:
        try:
            result = self._evaluate(values)
        except ZeroDivisionError:
            given = ", ".join(f"{name} = {value}" for name, value in values.items() if name in self.text)
            raise self._error(f"divides by zero{' with ' if given else ''}{given}") from None
        except OverflowError:
            raise self._error("exceeds the range of numbers") from None
        return truncated(result) if self._whole else float(result)

    def _error(self, problem: str) -> FormulaError:
        return FormulaError(
            f"{self._owner}: the formula {self.text[:120]!r} in the camera's description {problem}"
        )

    def _tokenise(self) -> list[str]:
        tokens, at = [], 0
        while at < len(self.text):
            found = _TOKEN.match(self.text, at)
            if found is None:
                raise self._error(f"has an unknown character {self.text[at]!r}")
            tokens.append(found.group().strip())
            at = found.end()
        return tokens

    def _peek(self) -> str:
        return self._tokens[self._at] if self._at < len(self._tokens) else ""

    def _take(self, expected: str = "") -> str:
        token = self._peek()
        if not token or (expected and token != expected):
            raise self._error(f"lacks {expected!r}" if expected else "ends too early")
        self._at += 1
        return token

    def _weakest(self) -> _Evaluate:
        left = self._chain(_SUMS)
        while self._peek() in _WEAKEST:
            operator = self._take()
            if operator == "?":
                yes = self._weakest()
                self._take(":")
                left = _choice(left, yes, self._chain(_SUMS))
            elif operator in ("&&", "||"):
                left = _logical(operator, left, self._chain(_SUMS))
            else:
                left = _operation(BINARY[operator], left, self._chain(_SUMS), self._whole)
        return left

    def _chain(self, operators: frozenset[str]) -> _Evaluate:
        if operators is _SUMS:
            tighter: Callable[[], _Evaluate] = lambda: self._chain(_PRODUCTS)  # noqa: E731
        elif operators is _PRODUCTS:
            tighter = lambda: self._chain(_STRONGEST)  # noqa: E731
        else:
            tighter = self._prefixed
        left = tighter()
        while self._peek() in operators:
            operation = BINARY[self._take()]
            left = _operation(operation, left, tighter(), self._whole)
        return left

    def _prefixed(self) -> _Evaluate:
        prefixes = []
        while self._peek() in ("+", "-", "~"):
            prefixes.append(self._take())
        value = self._value()
        for prefix in reversed(prefixes):
            if prefix == "-":
                value = _applied(lambda x: -x, value)
            elif prefix == "~":
                value = _applied(lambda x: ~truncated(x), value)
        return value

    def _value(self) -> _Evaluate:
        token = self._take()
        if token == "(":
            self._depth += 1
            if self._depth > _DEEPEST:
                raise self._error(f"has more than {_DEEPEST} levels of brackets")
            inner = self._weakest()
            self._take(")")
            self._depth -= 1
            return inner
        if token in self._variables:
            return _variable(token, self._whole)
        if token.upper() in FUNCTIONS and self._peek() == "(":
            return self._function(token.upper())
        if token in CONSTANTS:
            return _constant(CONSTANTS[token])
        if token[0].isdigit() or token[0] == ".":
            if token[:2] in ("0x", "0X"):
                return _constant(to_int64(int(token, 16)) if self._whole else int(token, 16))
            is_whole = self._whole and token.isdigit()
            return _constant(to_int64(int(token)) if is_whole else float(token))
        raise self._error(f"uses {token!r}, which is not a variable, function or constant")

    def _function(self, name: str) -> _Evaluate:
        self._take("(")
        arguments = [self._weakest()]
        while self._peek() == ",":
            self._take()
            arguments.append(self._weakest())
        self._take(")")
        if len(arguments) > (2 if name == "ROUND" else 1):
            raise self._error(f"gives {name} {len(arguments)} arguments")
        return _called(FUNCTIONS[name], arguments)


def _constant(value: Number) -> _Evaluate:
    return lambda values: value


def _variable(name: str, whole: bool) -> _Evaluate:
    return (lambda values: truncated(values[name])) if whole else (lambda values: float(values[name]))


def _operation(
    operation: Callable[[Number, Number], Number], left: _Evaluate, right: _Evaluate, whole: bool
) -> _Evaluate:
    def evaluate(values: Mapping[str, Number]) -> Number:
        result = operation(left(values), right(values))
        return to_int64(result) if whole and isinstance(result, int) else result

    return evaluate


def _logical(operator: str, left: _Evaluate, right: _Evaluate) -> _Evaluate:
    if operator == "&&":
        return lambda values: int(left(values) != 0 and right(values) != 0)
    return lambda values: int(left(values) != 0 or right(values) != 0)


def _choice(condition: _Evaluate, yes: _Evaluate, no: _Evaluate) -> _Evaluate:
    return lambda values: yes(values) if condition(values) != 0 else no(values)


def _applied(function: Callable[[Number], Number], argument: _Evaluate) -> _Evaluate:
    return lambda values: function(argument(values))


def _called(function: Callable[..., Number], arguments: list[_Evaluate]) -> _Evaluate:
    def evaluate(values: Mapping[str, Number]) -> Number:
        given = [argument(values) for argument in arguments]
        try:
            return function(*given)
        except ValueError:
            return math.nan  # outside the function's domain, for example the square root of -1

    return evaluate
