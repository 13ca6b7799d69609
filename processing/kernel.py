"""Numerical kernels: functions on numbers and arrays that numba compiles when the first of them is called.

Until that call a kernel is only declared. numba is not imported before, because its import takes longer than
many commands. `processing.kernel_compiler` compiles kernels and stores their machine code.
"""

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial, update_wrapper
from threading import RLock
from typing import Any, TypeVar, overload

Function = TypeVar("Function", bound=Callable[..., Any])
_COMPILER = "processing.kernel_compiler"
_LOCK = RLock()
_DEFERRED_KERNELS: list["_DeferredKernel"] = []


class _DeferredKernel:
    """Stand-in for a kernel that is not compiled; the first use of one replaces all by kernels."""

    def __init__(self, function: Callable[..., Any], make_kernel: Callable[[], Any]) -> None:
        update_wrapper(self, function)
        self._make_kernel = make_kernel
        self._kernel: Any = None
        _DEFERRED_KERNELS.append(self)

    def kernel(self) -> Any:
        """Kernel of this function; every module then holds kernels in place of stand-ins.

        All are replaced: numba looks up the kernels that a kernel calls by their names in its module, and
        rejects a stand-in.
        """
        with _LOCK:
            if self._kernel is None:
                # numba raises and catches a thousand errors as it compiles; colouring their texts takes time
                os.environ.setdefault("NUMBA_DISABLE_ERROR_MESSAGE_HIGHLIGHTING", "1")
                for stand_in in _DEFERRED_KERNELS:
                    stand_in._kernel = stand_in._make_kernel()
                packages = {stand_in.__module__.partition(".")[0] for stand_in in _DEFERRED_KERNELS}
                _DEFERRED_KERNELS.clear()
                for name, module in list(sys.modules.items()):
                    if name.partition(".")[0] in packages:
                        for key, value in list(vars(module).items()):
                            if isinstance(value, _DeferredKernel):
                                setattr(module, key, value._kernel)
            return self._kernel

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        return self.kernel()(*args, **kwargs)

    def __getattr__(self, name: str) -> Any:
        # only copying and pickling ask for these before they exist
        if name.startswith("__") or name in ("_make_kernel", "_kernel"):
            raise AttributeError(name)
        return getattr(self.kernel(), name)


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
    options["no_cfunc_wrapper"] = True  # no C code calls the kernels

    def make() -> Any:
        from processing.kernel_compiler import Kernel

        return Kernel(function, targetoptions=options)

    return make() if _COMPILER in sys.modules else _DeferredKernel(function, make)


def intrinsic(generator: Callable[..., Any]) -> Any:
    """Instruction that numba inserts into a kernel, from the function that generates it."""

    def make() -> Any:
        from numba.extending import intrinsic as numba_intrinsic

        return numba_intrinsic(generator)

    return make() if _COMPILER in sys.modules else _DeferredKernel(generator, make)


@contextmanager
def notify_of_compilation(callback: Callable[[bool], None]) -> Iterator[None]:
    """Call `callback` once within the context, if a kernel is compiled and not only loaded from its cache.

    A kernel that another process is compiling counts, too. The argument of `callback` is whether the machine
    code will be stored for the next process.
    """
    from numba.core import event

    from processing.kernel_compiler import WAIT_EVENT

    class FirstCompilation(event.Listener):  # type: ignore[misc]
        has_notified = False

        def on_start(self, event: Any) -> None:
            if not self.has_notified:
                self.has_notified = True
                callback(event.data["dispatcher"].stats.cache_path is not None)

        def on_end(self, event: Any) -> None:
            pass

    listener = FirstCompilation()
    with event.install_listener("numba:compile", listener), event.install_listener(WAIT_EVENT, listener):
        yield
