"""The numerical kernels: functions on numbers and arrays that numba compiles when the first is called.

Until then a kernel is declared, and numba, whose import takes longer than many a command, is not imported.
`processing.kernel_compiler` has how they are compiled and where the machine code is kept.
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
    """What numba makes of a function, once one of all that are declared is wanted."""

    def __init__(self, function: Callable[..., Any], make: Callable[[], Any]) -> None:
        update_wrapper(self, function)
        self._make = make
        self._made: Any = None
        _DECLARED.append(self)

    def made(self) -> Any:
        """The compiled function, by which modules that hold a declared one have it from now on.

        A kernel finds the kernels that it calls in its module, where numba knows nothing but its own.
        """
        with _LOCK:
            if self._made is None:
                # numba raises and catches a thousand errors as it compiles, and would colour the text of each
                os.environ.setdefault("NUMBA_DISABLE_ERROR_MESSAGE_HIGHLIGHTING", "1")
                for one in _DECLARED:
                    one._made = one._make()
                packages = {one.__module__.partition(".")[0] for one in _DECLARED}
                _DECLARED.clear()
                for name, module in list(sys.modules.items()):
                    if name.partition(".")[0] in packages:
                        for key, value in list(vars(module).items()):
                            if isinstance(value, _Declared):
                                setattr(module, key, value._made)
            return self._made

    def __call__(self, *args: Any, **words: Any) -> Any:
        return self.made()(*args, **words)

    def __getattr__(self, name: str) -> Any:
        # asked for before it is there only by copies and pickles
        if name.startswith("__") or name in ("_make", "_made"):
            raise AttributeError(name)
        return getattr(self.made(), name)


@overload
def kernel(function: Function, /) -> Function: ...
@overload
def kernel(*, fastmath: bool = ...) -> Callable[[Function], Function]: ...
def kernel(function: Function | None = None, /, *, fastmath: bool = False) -> Any:
    """Compile a function on numbers and arrays with numba, when it is first called, for the types then given.

    It runs without Python's lock, and a division by zero gives an infinity or NaN as in numpy. `fastmath`
    lets the compiler reorder sums, which it needs to turn them into vector instructions. Where numba is
    turned off (NUMBA_DISABLE_JIT), the function stays what it is.
    """
    if function is None:
        return partial(kernel, fastmath=fastmath)
    if os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0"):
        return function
    options = {"nopython": True, "nogil": True, "error_model": "numpy", "fastmath": fastmath}
    options["no_cfunc_wrapper"] = True  # nothing calls them as functions of C

    def made() -> Any:
        from processing.kernel_compiler import Kernel

        return Kernel(function, targetoptions=options)

    return made() if "processing.kernel_compiler" in sys.modules else _Declared(function, made)


def intrinsic(generator: Callable[..., Any]) -> Any:
    """An instruction that numba puts into a kernel, by the function that generates it (`numba.extending`)."""

    def made() -> Any:
        from numba.extending import intrinsic

        return intrinsic(generator)

    return made() if "processing.kernel_compiler" in sys.modules else _Declared(generator, made)


@contextmanager
def at_compilation(call: Callable[[bool], None]) -> Iterator[None]:
    """Call once, within the context, when a kernel is compiled and not merely loaded from its cache.

    One that another process compiles just then counts, too. `call` is given whether the machine code will be
    kept for the next process.
    """
    from numba.core import event

    from processing.kernel_compiler import WAITS

    class FirstCompilation(event.Listener):  # type: ignore[misc]
        called = False

        def on_start(self, event: Any) -> None:
            if not self.called:
                self.called = True
                call(event.data["dispatcher"].stats.cache_path is not None)

        def on_end(self, event: Any) -> None:
            pass

    listener = FirstCompilation()
    with event.install_listener("numba:compile", listener), event.install_listener(WAITS, listener):
        yield
