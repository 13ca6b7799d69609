"""How kernels within others are compiled, what numba need not find out again, the lock of their cache."""

import operator
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.targetconfig import ConfigStack
from numba.core.types import Function

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

_POLL_S = 0.05
LONGEST_S = 600.0
"""After which the other process is taken for one that hangs, and is not waited for."""


@contextmanager
def byte_locked(path: Path, byte: int, waits: Callable[[], None]) -> Iterator[None]:
    """Hold the lock of one byte within the context; `waits` is called once if another process has it.

    The byte need not exist. Where the disk or the system knows no such locks, or nothing can be written, the
    context is entered without.
    """
    try:
        file = os.open(path, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o666)
    except OSError:
        yield
        return
    try:
        _take(file, byte, waits)
        yield
    finally:
        os.close(file)  # which gives the lock back


def _take(file: int, byte: int, waits: Callable[[], None]) -> None:
    until_s, said = time.monotonic() + LONGEST_S, False
    while not _taken(file, byte) and time.monotonic() < until_s:
        if not said:
            waits()
            said = True
        time.sleep(_POLL_S)


def _taken(file: int, byte: int) -> bool:
    """Whether another process does not have it; where there are no locks, none has."""
    if fcntl is None:
        return True
    try:
        fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, byte)
    except (BlockingIOError, PermissionError):
        return False
    except OSError:
        return True
    return True


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


class KernelPart:
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
