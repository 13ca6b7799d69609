"""How kernels within others are compiled, and what numba would find out again and again meanwhile.

numba makes optimized machine code of every kernel within another one, which nobody calls, and then optimizes
the same code again in the caller's. Here it is only linked into that. For every operator numba asks dozens of
candidates whether they take these types, and collects the reasons of those that do not; the answer is the
same in every kernel. Decision 24 has what both pay.
"""

import operator
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.targetconfig import ConfigStack
from numba.core.types import Function


class PartCompiler(Compiler):  # type: ignore[misc]
    """numba's compiler for what Python does not call: it makes no machine code."""

    def define_pipelines(self) -> Any:
        """The options are changed here, where those that numba's own functions inherit are fixed already."""
        self.state.flags.no_cpython_wrapper = self.state.flags.no_compile = True
        self.state.library = _PartLibrary(self.state.targetctx.codegen(), self.state.func_id.func_qualname)
        return super().define_pipelines()


class _PartLibrary(JITCodeLibrary):  # type: ignore[misc]
    """Code that is linked into that of other kernels, which optimize it together with their own."""

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True


class Part:
    """What numba knows a kernel within another one by, in place of its machine code."""


class _Answers:
    """What numba's operators and functions make of which types, found once for each set of options.

    A function that is given more candidates later is another one to numba.
    """

    def __init__(self, context: Any) -> None:
        self._context = context
        self._ask = context.resolve_function_type
        self._known: dict[Any, tuple[Any, Any]] = {}
        self._flags: Any = None
        self._options = 0
        self._different: list[Any] = []

    def resolve_function_type(self, function: Any, args: Any, words: Any) -> Any:
        """What a call gives, as numba's method of that name."""
        kind = function
        if not isinstance(kind, Function):
            kind = self._context._lookup_global(function)
        if words or type(kind) is not Function:
            return self._ask(function, args, words)
        key = kind, args, self._options_now()
        known = self._known.get(key)
        if known is None:
            signature = self._ask(function, args, words)
            if signature is not None:
                self._known[key] = signature, kind.get_impl_key(signature)
            return signature
        signature, implementation = known
        # an implementation for other options may have been found for the same types since
        vars(kind)["_impl_keys"][signature.args] = implementation
        return signature

    def resolve_setitem(self, target: Any, index: Any, value: Any) -> Any:
        """What an assignment to an element gives, as numba's method of that name."""
        kind = self._context.resolve_value_type(operator.setitem)
        return self.resolve_function_type(kind, (target, index, value), {})

    def _options_now(self) -> int:
        """The number of the options that hold now, among those seen so far."""
        flags = ConfigStack.top_or_none()
        if flags is not self._flags or not self._different:
            if flags not in self._different:
                self._different.append(flags)
            self._flags, self._options = flags, self._different.index(flags)
        return self._options


_ANSWERS: dict[Any, _Answers] = {}


@contextmanager
def answers_kept(context: Any) -> Iterator[None]:
    """Ask numba's functions once in this process for the types of their results, within the context."""
    answers = _ANSWERS.get(context)
    if answers is None:
        answers = _ANSWERS[context] = _Answers(context)
    context.resolve_function_type = answers.resolve_function_type
    context.resolve_setitem = answers.resolve_setitem
    try:
        yield
    finally:
        del context.resolve_function_type, context.resolve_setitem
