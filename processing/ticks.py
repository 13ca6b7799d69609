"""Ticks of a clock, which are integer nanoseconds, and seconds: the one place where one becomes the other."""

from typing import Any, Final, overload

import numpy as np
from numpy.typing import NDArray

S_PER_NS: Final = 1e-9
NS_PER_S: Final = 1e9


@overload
def seconds(ticks_ns: float | np.integer[Any]) -> float: ...
@overload
def seconds(ticks_ns: NDArray[np.int64]) -> NDArray[np.float64]: ...
def seconds(ticks_ns: Any) -> Any:
    """A number or an array of ticks in s; differences of ticks first, which are exact as integers."""
    return ticks_ns * S_PER_NS


@overload
def nanoseconds(time_s: float) -> int: ...
@overload
def nanoseconds(time_s: NDArray[np.float64]) -> NDArray[np.int64]: ...
def nanoseconds(time_s: Any) -> Any:
    """The nearest ticks of a number or an array of times in s."""
    ticks_ns = time_s * NS_PER_S
    return np.rint(ticks_ns).astype(np.int64) if isinstance(time_s, np.ndarray) else round(ticks_ns)
