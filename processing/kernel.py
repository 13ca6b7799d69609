"""Numerical kernels: functions on numbers and arrays that numba compiles when the first of them is called.

Until then a kernel is only declared, and numba, whose import takes longer than many a command, not imported.
`processing.kernel_compiler` compiles kernels and stores their machine code.
"""

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial, update_wrapper
from threading import RLock
from typing import Any, TypeVar, overload

Function = TypeVar("Function", bound=Callable[..., Any])
_LOCK = RLock()
_DECLARED: list["_Declared"] = []


class _Declared:
    """Stand-in for a kernel that is not compiled; its first use replaces all stand-ins by kernels."""

    def __init__(self, function: Callable[..., Any], make: Callable[[], Any]) -> None:
        update_wrapper(self, function)
        self._compile = make
        self._compiled: Any = None
        _DECLARED.append(self)

    def compiled(self) -> Any:
        """Kernel of this function; every module then holds kernels in place of stand-ins.

        All are replaced, because numba finds in its module the kernels that one calls, and takes no other.
        """
        with _LOCK:
            if self._compiled is None:
                # numba raises and catches a thousand errors as it compiles, and would colour the text of each
                os.environ.setdefault("NUMBA_DISABLE_ERROR_MESSAGE_HIGHLIGHTING", "1")
                for one in _DECLARED:
                    one._compiled = one._compile()
                packages = {one.__module__.partition(".")[0] for one in _DECLARED}
                _DECLARED.clear()
                for name, module in list(sys.modules.items()):
                    if name.partition(".")[0] in packages:
                        for key, value in list(vars(module).items()):
                            if isinstance(value, _Declared):
                                setattr(module, key, value._compiled)
            return self._compiled

    def __call__(self, *args: Any, **words: Any) -> Any:
        return self.compiled()(*args, **words)

    def __getattr__(self, name: str) -> Any:
        # only copying and pickling ask for these before they exist
        if name.startswith("__") or name in ("_compile", "_compiled"):
            raise AttributeError(name)
        return getattr(self.compiled(), name)


@overload
def kernel(function: Function, /) -> Function: ...
@overload
def kernel(*, fastmath: bool = ...) -> Callable[[Function], Function]: ...
def kernel(function: Function | None = None, /, *, fastmath: bool = False) -> Any:
    """Compile a function on numbers and arrays with numba, at its first call with new types of arguments.

    It runs without Python's lock, and a division by zero gives an infinity or NaN as in numpy. `fastmath`
    lets the compiler reorder sums, which it needs to turn them into vector instructions. If numba is turned
    off (NUMBA_DISABLE_JIT), the function itself is returned.
    """
    if function is None:
        return partial(kernel, fastmath=fastmath)
    if os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0"):
        return function
    options = {"nopython": True, "nogil": True, "error_model": "numpy", "fastmath": fastmath}
    options["no_cfunc_wrapper"] = True  # nothing calls them as functions of C

    def compiled() -> Any:
        from processing.kernel_compiler import Kernel

        return Kernel(function, targetoptions=options)

    return compiled() if "processing.kernel_compiler" in sys.modules else _Declared(function, compiled)


def intrinsic(generator: Callable[..., Any]) -> Any:
    """Instruction that numba inserts into a kernel, from the function that generates it."""

    def compiled() -> Any:
        from numba.extending import intrinsic

        return intrinsic(generator)

    return compiled() if "processing.kernel_compiler" in sys.modules else _Declared(generator, compiled)


@contextmanager
def at_compilation(call: Callable[[bool], None]) -> Iterator[None]:
    """Call `call` once within the context, if a kernel is compiled and not only loaded from its cache.

    A kernel that another process is compiling counts, too. The argument of `call` is whether the machine code
    will be stored for the next process.
    """
    from numba.core import event

    from processing.kernel_compiler import WAIT_EVENT

    class FirstCompilation(event.Listener):  # type: ignore[misc]
        called = False

        def on_start(self, event: Any) -> None:
            if not self.called:
                self.called = True
                call(event.data["dispatcher"].stats.cache_path is not None)

        def on_end(self, event: Any) -> None:
            pass

    listener = FirstCompilation()
    with event.install_listener("numba:compile", listener), event.install_listener(WAIT_EVENT, listener):
        yield
