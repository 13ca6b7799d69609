"""Compilation of the numerical kernels, with a cache that knows all sources and may be missing.

numba compiles a kernel again for each constant that another kernel hands to it, its cache does not notice a
change in a kernel that is called from another file, and it refuses to compile where no cache can be written.
Here a kernel is compiled for types only; a cache entry belongs to the code of the kernel and of all that it
calls; processes that need the same kernel at once compile it once; and without a cache a kernel is compiled
in every process. A kernel within another one becomes machine code only as a part of that one. Decision 24 has
what this pays.
"""

import gc
import hashlib
import pickle
import secrets
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any, TypeVar, overload

import numpy as np
from numba.core import config, event
from numba.core.caching import FunctionCache, IndexDataCacheFile, NullCache
from numba.core.compiler_lock import global_compiler_lock
from numba.core.registry import CPUDispatcher
from numba.core.sigutils import normalize_signature
from numba.types import Array, unliteral

from processing.kernel_parts import KernelPart, PartCompiler, answers_kept, byte_locked

_WAITS = "processing:another process compiles it"
_BYTES = 2**31

Function = TypeVar("Function", bound=Callable[..., Any])


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
    if config.DISABLE_JIT:
        return function
    options = {"nopython": True, "nogil": True, "error_model": "numpy", "fastmath": fastmath}
    options["no_cfunc_wrapper"] = True  # nothing calls them as functions of C
    return Kernel(function, targetoptions=options)


@contextmanager
def at_compilation(call: Callable[[bool], None]) -> Iterator[None]:
    """Call once, within the context, when a kernel is compiled and not merely loaded from its cache.

    One that another process compiles just then counts, too. `call` is given whether the machine code will be
    kept for the next process.
    """
    listener = _FirstCompilation(call)
    with event.install_listener("numba:compile", listener), event.install_listener(_WAITS, listener):
        yield


class _FirstCompilation(event.Listener):  # type: ignore[misc]
    def __init__(self, call: Callable[[bool], None]) -> None:
        self._call: Callable[[bool], None] | None = call

    def on_start(self, event: Any) -> None:
        call, self._call = self._call, None
        if call is not None:
            call(event.data["dispatcher"].stats.cache_path is not None)

    def on_end(self, event: Any) -> None:
        pass


class Kernel(CPUDispatcher):  # type: ignore[misc]
    """A compiled function (see `kernel`)."""

    _cache_is_open = False
    _within_another = False

    def compile(self, sig: Any) -> Any:
        """Called for a call from Python: loads the machine code from the cache, or compiles and keeps it."""
        with global_compiler_lock, ExitStack() as until_kept:
            if self._within_another:
                return super().compile(sig)
            if not self._cache_is_open:
                self._cache, self._cache_is_open = cache_of(self.py_func, self.targetoptions), True
            # one that is a part of another kernel cannot be called from Python; any other comes from a thread
            # that had the lock before
            known = self.overloads.get(tuple(normalize_signature(sig)[0]))
            if known is not None and isinstance(known.entry_point, KernelPart):
                del self.overloads[known.signature.args]
                known = None
            if known is None and isinstance(self._cache, _Cache):
                until_kept.enter_context(self._cache.alone(sig, self.targetctx, self._say_that_it_waits))
            entry = self._compiled(sig)
            if type(self) is Kernel and any(map(_makes_arrays, self.nopython_signatures)):
                self.__class__ = _KernelThatMakesArrays
            return entry

    def _say_that_it_waits(self) -> None:
        event.start_event(_WAITS, {"dispatcher": self})

    def _compiled(self, sig: Any) -> Any:
        with _garbage_left(), answers_kept(self.typingctx):
            return super().compile(sig)

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """Called for a call within another kernel: compiles for types, not for the values of constants.

        It is neither made machine code nor kept by itself, since it becomes a part of the caller's.
        """
        types = tuple(unliteral(kind) for kind in args)
        named = {name: unliteral(kind) for name, kind in kws.items()}
        cache, self._cache, self._within_another = self._cache, NullCache(), True
        self._compiler.pipeline_class, whole = PartCompiler, self._compiler.pipeline_class
        try:
            return super().get_call_template(types, named)
        finally:
            self._compiler.pipeline_class = whole
            self._cache, self._within_another = cache, False

    def add_overload(self, cres: Any) -> None:
        """Offer compiled code to Python, or to other kernels if it is a part of them."""
        if self._within_another:
            cres = cres._replace(entry_point=KernelPart())
            self.targetctx.insert_user_function(cres.entry_point, cres.fndesc, [cres.library])
            self.overloads[cres.signature.args] = cres
            return
        # as where it is loaded: kernels within it may need constants
        for environment in cres._find_referenced_environments():
            cres.codegen.set_env(environment.env_name, environment)
        super().add_overload(cres)


class _KernelThatMakesArrays(Kernel):
    """One whose arrays numba hands to Python with Python's own code, where an interrupt may come up.

    numba then raises SystemError ("returned a result with an exception set"), of which the interrupt is the
    cause; nobody who waits for Ctrl-C would catch that. It costs 0.2 us a call, which others need not pay.
    """

    def __call__(self, *args: Any, **words: Any) -> Any:
        try:
            return super().__call__(*args, **words)
        except SystemError as error:
            if error.__cause__ is not None:
                raise error.__cause__ from None
            raise


def _makes_arrays(signature: Any) -> bool:
    kinds = getattr(signature.return_type, "types", (signature.return_type,))
    return any(isinstance(kind, Array) for kind in kinds)


class _CacheFile(IndexDataCacheFile):  # type: ignore[misc]
    """numba's files for one function, the machine code in files whose names are never used again.

    numba writes its index first and counts the other files from 1. Old code would pass for new while that
    is written or if it cannot be; code for other types, if two processes write at once; and a process that
    finds the index without the code takes the cache for spoilt.
    """

    def _load_index(self) -> dict[Any, str]:
        """The names of the files; none where a class that the index names is gone, as after an update."""
        try:
            found: dict[Any, str] = super()._load_index()
        except (AttributeError, ImportError):
            return {}
        return found

    def save(self, key: Any, data: Any) -> None:
        with byte_locked(Path(self._cache_path) / "keeping.lock", 0, lambda: None):
            overloads = self._load_index()
            name = overloads[key] = self._data_name(len(overloads))
            self._save_data(name, data)
            self._save_index(overloads)

    def _data_name(self, number: int) -> str:
        return f"{Path(super()._data_name(number)).stem}.{secrets.token_hex(8)}.nbc"

    def _save_index(self, overloads: dict[Any, str]) -> None:
        super()._save_index(overloads)
        pattern = self._data_name_pattern.replace("{number:d}", "*")
        for path in Path(self._cache_path).glob(pattern):
            if path.name not in overloads.values():
                with suppress(OSError):
                    path.unlink()


@contextmanager
def _garbage_left() -> Iterator[None]:
    """What numba makes of a kernel is needed to the end; to look through it for garbage takes a fifth of the
    time.
    """
    if not gc.isenabled():
        yield
        return
    gc.disable()
    try:
        yield
    finally:
        gc.enable()


class _Cache(FunctionCache):  # type: ignore[misc]
    """numba's cache of a function, valid for the code of all that the function calls."""

    def __init__(self, function: FunctionType, code: str) -> None:
        super().__init__(function)
        self._cache_file = _CacheFile(
            cache_path=self._cache_path, filename_base=self._impl.filename_base, source_stamp=code
        )

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        try:
            return super().load_overload(sig, target_context)
        except (OSError, EOFError, pickle.UnpicklingError):
            # cut off by a crash, or not for this user to read: compiled again
            with suppress(OSError):
                self.flush()
            return None

    @contextmanager
    def alone(self, sig: Any, target_context: Any, waits: Callable[[], None]) -> Iterator[None]:
        """While what is not kept yet is compiled: no other process compiles it for the same types, too."""
        key = self._index_key(sig, target_context.codegen())
        if self._holds(key):
            yield
            return
        name = repr((self._impl.filename_base, self._cache_file._source_stamp, key)).encode()
        byte = int.from_bytes(hashlib.sha256(name).digest()[:4]) % _BYTES
        with byte_locked(Path(self._cache_path) / "compiling.lock", byte, waits):
            yield

    def _holds(self, key: Any) -> bool:
        try:
            return key in self._cache_file._load_index()
        except (OSError, EOFError, pickle.UnpicklingError):
            return False

    def save_overload(self, sig: Any, data: Any) -> None:
        with suppress(OSError):  # a full disk, say: the next process compiles it again
            super().save_overload(sig, data)


def cache_of(function: Any, options: dict[str, Any]) -> Any:
    """Where compiled code of the function is kept; nowhere if no folder for it can be written."""
    code = hashlib.sha256(repr(sorted(options.items())).encode())
    for name in ("kernel.py", "kernel_parts.py"):  # how it is compiled
        code.update(Path(__file__).with_name(name).read_bytes())
    for line in code_of(function, set()):
        code.update(line)
    try:
        return _Cache(function, code.hexdigest())
    except RuntimeError:
        return NullCache()


def code_of(function: FunctionType, seen: set[object]) -> Iterator[bytes]:
    """What the machine code of a function follows from: its place, bytecode, values, functions it calls."""
    if function in seen:
        return
    seen.add(function)
    # machine code names the modules of what it calls, which are imported when it is loaded
    yield f"{function.__module__}.{function.__qualname__}{function.__defaults__!r}".encode()
    codes = [function.__code__]
    while codes:
        code = codes.pop()
        yield code.co_code
        documentation = function.__doc__ if code is function.__code__ else None
        for constant in code.co_consts:
            if isinstance(constant, CodeType):
                codes.append(constant)
            elif constant is None or constant != documentation:
                yield repr(constant).encode()
        for name in code.co_names:
            if name in function.__globals__:
                value = function.__globals__[name]
                yield name.encode()
                yield from _code_of_value(value, seen)
                if isinstance(value, ModuleType):  # a kernel of it may be called
                    named = [vars(value).get(attribute) for attribute in code.co_names]
                    for member in named:
                        if isinstance(member, Kernel):
                            yield from _code_of_value(member, seen)


def _code_of_value(value: Any, seen: set[object]) -> Iterator[bytes]:
    inner = getattr(value, "py_func", getattr(value, "_defn", value))  # of a kernel, of an intrinsic
    if isinstance(inner, FunctionType):
        yield repr(sorted(getattr(value, "targetoptions", {}).items())).encode()
        yield from code_of(inner, seen)
    elif isinstance(value, np.ndarray):
        yield repr((value.dtype.str, value.shape)).encode() + value.tobytes()
    elif isinstance(value, ModuleType):
        yield value.__name__.encode()
    elif isinstance(value, type):
        yield repr((value.__qualname__, getattr(value, "_fields", ()))).encode()
    else:
        yield repr(value).encode()
