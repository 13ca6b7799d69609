"""Prefetch instructions: load pixels into the processor's cache before they are needed.

A frame that has just arrived from the camera is in no cache; waiting for memory would take most of the time.
"""

from collections.abc import Callable
from typing import Any, cast

from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.extending import intrinsic

from processing.kernel import kernel
from processing.spot.spot import Image

LINE_BYTES = 64
_READ, _KEEP, _DATA = 0, 3, 1


@intrinsic  # type: ignore[untyped-decorator]
def _prefetch(typing_context: Any, image: Any, place: Any) -> Any:
    """Generate the LLVM prefetch instruction for `prefetch`."""

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
"""Start loading the cache line of an image element; the index counts elements in C order.

It can be called from compiled code only. It is a hint to the processor and has no effect on the result, also
for an index beyond the end of the image.
"""


@kernel
def prefetch_window(image: Image, x0: int, y0: int, nx: int, ny: int) -> None:
    """Start loading nx x ny pixels from (x0, y0) on.

    The processor's own prefetching does not recognise the rows of a window, which are far apart in memory.
    """
    width = image.shape[1]
    in_a_line = LINE_BYTES // image.itemsize
    for y in range(y0, y0 + ny):
        first = y * width + x0
        for place in range(first, first + nx, in_a_line):
            prefetch(image, place)
        prefetch(image, first + nx - 1)
