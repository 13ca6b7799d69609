"""How numba compiles the kernels, and where it keeps them; imported when the first kernel is called.

numba compiles a kernel again for each constant that another kernel hands to it, its cache does not notice a
change in a kernel that is called from another file, and it refuses to compile where no cache can be written.
Here a kernel is compiled for types only; a cache entry belongs to the code of the kernel and of all that it
calls; processes that need the same kernel at once compile it once; and without a cache a kernel is compiled
in every process. A kernel within another one becomes machine code only as a part of that one. Decision 24 has
what this pays.
"""

import gc
import hashlib
import os
import pickle
import secrets
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np
from numba.core import event
from numba.core.caching import FunctionCache, IndexDataCacheFile, NullCache
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.compiler_lock import global_compiler_lock
from numba.core.registry import CPUDispatcher
from numba.core.sigutils import normalize_signature
from numba.types import Array, unliteral

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

WAITS = "processing:another process compiles it"
_BYTES = 2**31
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
        event.start_event(WAITS, {"dispatcher": self})

    def _compiled(self, sig: Any) -> Any:
        with _garbage_left():
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
    code.update(Path(__file__).read_bytes())  # how it is compiled
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
