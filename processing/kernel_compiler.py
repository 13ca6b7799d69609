"""Compilation of the kernels by numba, and the cache of their machine code.

This module is imported when the first kernel is called. numba compiles a kernel again for each constant that
another kernel passes to it, its cache does not notice a change in a kernel that is called from another file,
and it refuses to compile if no cache can be written. Here a kernel is compiled for types only; a cache entry
belongs to the code of the kernel and of all kernels that it calls; and without a cache a kernel is compiled
in every process. The machine code of a kernel that another one calls is only made as a part of the caller's.
Decision 24 states the gain in time.
"""

import gc
import hashlib
import os
import pickle
import secrets
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
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
from numba.core.runtime import rtsys
from numba.core.sigutils import normalize_signature
from numba.types import Array, unliteral

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

WAIT_EVENT = "processing:another process compiles it"


@contextmanager
def locked(path: Path, on_wait: Callable[[], None]) -> Iterator[None]:
    """Hold the lock of a file within the context; `on_wait` is called once if another process has it.

    The file need not exist. Without such locks or write access the context is entered without a lock.
    """
    try:
        file = os.open(path, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o666)
    except OSError:
        yield
        return
    try:
        if fcntl is not None:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                on_wait()
                fcntl.flock(file, fcntl.LOCK_EX)
            except OSError:  # a file system without locks
                pass
        yield
    finally:
        os.close(file)  # closing releases the lock


class PartCompiler(Compiler):  # type: ignore[misc]
    """Compiler for kernels that only other kernels call: it produces no machine code."""

    def define_pipelines(self) -> Any:
        """Change the options here, after those that numba's own functions inherit have been fixed."""
        self.state.flags.no_cpython_wrapper = self.state.flags.no_compile = True
        self.state.library = _PartLibrary(self.state.targetctx.codegen(), self.state.func_id.func_qualname)
        return super().define_pipelines()


class _PartLibrary(JITCodeLibrary):  # type: ignore[misc]
    """Code that is linked into that of other kernels and optimized together with theirs."""

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True


class KernelPart:
    """Identity by which numba finds a kernel called by another one; it has no machine code."""


class Kernel(CPUDispatcher):  # type: ignore[misc]
    """A compiled function (see `kernel`)."""

    _cache_is_open = False
    _is_part = False
    """Whether the kernel is being compiled as a part of another one."""

    def compile(self, sig: Any) -> Any:
        """Load the machine code from the cache, or compile and store it; for a call from Python."""
        with global_compiler_lock, ExitStack() as until_stored:
            if self._is_part:
                return super().compile(sig)
            if not self._cache_is_open:
                self._cache, self._cache_is_open = function_cache(self.py_func, self.targetoptions), True
            # an overload that is a part of another kernel cannot be called from Python; any other was
            # compiled by a thread that had the lock before
            overload = self.overloads.get(tuple(normalize_signature(sig)[0]))
            if overload is not None and isinstance(overload.entry_point, KernelPart):
                del self.overloads[overload.signature.args]
                overload = None
            if overload is None and isinstance(self._cache, _Cache):
                report_wait = partial(event.start_event, WAIT_EVENT, {"dispatcher": self})
                until_stored.enter_context(locked(self._cache.lock, report_wait))
            with _without_garbage_collection():
                entry = super().compile(sig)
            if type(self) is Kernel and any(map(_makes_arrays, self.nopython_signatures)):
                self.__class__ = _KernelThatMakesArrays
            return entry

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """Compile for types, not for the values of constants; for a call within another kernel.

        No machine code is made or stored, because it becomes a part of the caller's.
        """
        types = tuple(unliteral(kind) for kind in args)
        keyword_types = {name: unliteral(kind) for name, kind in kws.items()}
        cache, self._cache, self._is_part = self._cache, NullCache(), True
        self._compiler.pipeline_class, pipeline_class = PartCompiler, self._compiler.pipeline_class
        try:
            return super().get_call_template(types, keyword_types)
        finally:
            self._compiler.pipeline_class = pipeline_class
            self._cache, self._is_part = cache, False

    def add_overload(self, cres: Any) -> None:
        """Offer compiled code to Python, or to other kernels if it is a part of them."""
        if self._is_part:
            cres = cres._replace(entry_point=KernelPart())
            self.targetctx.insert_user_function(cres.entry_point, cres.fndesc, [cres.library])
            self.overloads[cres.signature.args] = cres
            return
        # as when code is loaded from the cache: kernels within it may need constants
        for environment in cres._find_referenced_environments():
            cres.codegen.set_env(environment.env_name, environment)
        super().add_overload(cres)


class _KernelThatMakesArrays(Kernel):
    """Kernel that returns arrays. numba builds them by code of Python, in which Ctrl-C may arrive.

    numba then raises SystemError ("returned a result with an exception set") with the interrupt as its cause,
    which code that waits for Ctrl-C would not catch. Catching it costs 0.2 us a call, which kernels without
    arrays need not pay.
    """

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        try:
            return super().__call__(*args, **kwargs)
        except SystemError as error:
            if error.__cause__ is not None:
                raise error.__cause__ from None
            raise


def _makes_arrays(signature: Any) -> bool:
    kinds = getattr(signature.return_type, "types", (signature.return_type,))
    return any(isinstance(kind, Array) for kind in kinds)


class _CacheFile(IndexDataCacheFile):  # type: ignore[misc]
    """Cache files of one function, with machine code in files whose names are never used again.

    numba writes its index first and counts the other files from 1. The index would name old code as the new
    while that is written, or if its writing fails, and code for other types if two processes write at once.
    """

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
def _without_garbage_collection() -> Iterator[None]:
    """Context without garbage collection, which takes a fifth of a compilation and finds nothing."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


class _Cache(FunctionCache):  # type: ignore[misc]
    """Cache of a function, valid for its code and that of all functions that it calls."""

    def __init__(self, function: FunctionType, code: str) -> None:
        super().__init__(function)
        self._cache_file = _CacheFile(
            cache_path=self._cache_path, filename_base=self._impl.filename_base, source_stamp=code
        )

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        # machine code needs numba's runtime, but not the declarations by which numba types and lowers code:
        # their import, which numba makes here as well, takes longer than loading twenty kernels
        rtsys.initialize(target_context)
        try:
            with self._guard_against_spurious_io_errors():
                return self._load_overload(sig, target_context)
        except (OSError, EOFError, pickle.UnpicklingError, AttributeError, ImportError):
            # the file was cut off by a crash, is not readable for this user, or needs a class that is gone
            with suppress(OSError):
                self.flush()
            return None

    @property
    def lock(self) -> Path:
        """File whose lock a process holds while it loads or compiles the function."""
        return Path(self._cache_path) / f"{self._impl.filename_base}.lock"

    def save_overload(self, sig: Any, data: Any) -> None:
        with suppress(OSError):  # a full disk, say: the next process compiles it again
            super().save_overload(sig, data)


def function_cache(function: Any, options: dict[str, Any]) -> Any:
    """Cache for compiled code of the function; one that stores nothing if no folder can be written."""
    code = hashlib.sha256(repr(sorted(options.items())).encode())
    code.update(Path(__file__).read_bytes())  # a change of the compilation changes the machine code
    for content in code_bytes(function, set()):
        code.update(content)
    try:
        return _Cache(function, code.hexdigest())
    except RuntimeError:
        return NullCache()


def code_bytes(function: FunctionType, visited: set[object]) -> Iterator[bytes]:
    """Bytes that determine a function's machine code: place, bytecode, values, the functions it calls."""
    if function in visited:
        return
    visited.add(function)
    # machine code names the modules of the functions that it calls, and imports them when it is loaded
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
                yield from _value_bytes(value, visited)
                if isinstance(value, ModuleType):  # the function may call kernels of the module
                    for attribute in code.co_names:
                        member = vars(value).get(attribute)
                        if isinstance(member, Kernel):
                            yield from _value_bytes(member, visited)


def _value_bytes(value: Any, visited: set[object]) -> Iterator[bytes]:
    function = getattr(value, "py_func", getattr(value, "_defn", value))  # of a kernel, of an intrinsic
    if isinstance(function, FunctionType):
        yield repr(sorted(getattr(value, "targetoptions", {}).items())).encode()
        yield from code_bytes(function, visited)
    elif isinstance(value, np.ndarray):
        yield repr((value.dtype.str, value.shape)).encode() + value.tobytes()
    elif isinstance(value, ModuleType):
        yield value.__name__.encode()
    elif isinstance(value, type):
        yield repr((value.__qualname__, getattr(value, "_fields", ()))).encode()
    else:
        yield repr(value).encode()
