"""Telling the processor which pixels will be needed soon; a frame that has just arrived is in no cache."""

from collections.abc import Callable
from typing import Any, cast

from llvmlite import ir  # type: ignore[import-untyped]
from numba import njit, types
from numba.extending import intrinsic

from processing.spot.spot import Image

LINE_BYTES = 64
_READ, _KEEP, _DATA = 0, 3, 1


@intrinsic
def _prefetch(typing_context: Any, image: Any, place: Any) -> Any:
    """Code for `prefetch`."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        array = context.make_array(signature.args[0])(context, builder, arguments[0])
        address = builder.bitcast(builder.gep(array.data, [arguments[1]]), ir.IntType(8).as_pointer())
        number = ir.IntType(32)
        kind = ir.FunctionType(ir.VoidType(), [address.type, number, number, number])
        function = builder.module.declare_intrinsic("llvm.prefetch", [address.type], kind)
        builder.call(function, [address, number(_READ), number(_KEEP), number(_DATA)])
        return context.get_dummy_value()

    return types.void(image, types.intp), generate


prefetch = cast(Callable[[Image, int], None], _prefetch)
"""Begin to load the cache line of an image's element, counted in C order; beyond its end it does nothing.

Compiled code only. A hint: it changes no value, reads nothing that the program sees, and cannot fail.
"""


@njit(cache=True, nogil=True, error_model="numpy")
def prefetch_window(image: Image, x0: int, y0: int, nx: int, ny: int) -> None:
    """Begin to load nx x ny pixels from (x0, y0) on: the rows of a window lie too far apart to be guessed."""
    width = image.shape[1]
    in_a_line = LINE_BYTES // image.itemsize
    for y in range(y0, y0 + ny):
        first = y * width + x0
        for place in range(first, first + nx, in_a_line):
            prefetch(image, place)
        prefetch(image, first + nx - 1)
