"""One strip of pixels at once: summed to LANES numbers side by side, and multiplied with two templates.

numba knows no vectors of its own, and LLVM makes none of sums of floating-point numbers, whose order it must keep. So
these few lines give LLVM vectors: any processor's, for it splits them as it needs. Sums of pixels are exact, and the
products are added in one order, by halves: the same bits on every run.
"""

from collections.abc import Callable
from typing import Any, cast

import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic
from numpy.typing import NDArray

Strip = Callable[
    [NDArray[Any], np.uintp, np.uintp, np.uintp, NDArray[np.float32], np.uintp, np.uintp, NDArray[np.float32]],
    tuple[float, float],
]

LANES = 16
SURE = 8  # lanes that are never beyond the last pixel
_INDEX, _FLOAT, _SUM = ir.IntType(32), ir.FloatType(), ir.VectorType(ir.IntType(32), LANES)


def make_strip(across_rows: bool, each: int) -> Strip:
    """The function strip(image, row, column, taps, weight, table, phase, pixel) -> (product 0, product 1).

    across_rows: taps are rows from `row` on, and `each` columns from `column` on are summed; else taps are columns, and
    `each` rows are summed. Writes the sums to pixel (LANES,); behind `taps` they are any finite numbers, and the
    products are right if the weights (tables, phases, 2 or more, LANES) are 0 there. Nothing is checked: `taps`
    x `each` pixels must lie in the image, and where taps are columns LANES x `each` pixels in its memory.
    """

    @intrinsic
    def strip(
        _: Any, image: Any, row: Any, column: Any, taps: Any, weight: Any, table: Any, phase: Any, pixel: Any
    ) -> Any:
        n = types.uintp
        signature = types.UniTuple(types.float32, 2)(image, n, n, n, weight, n, n, pixel)
        bits = image.dtype.bitwidth

        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            image, row, column, taps, weight, table, phase, pixel = args
            index = row.type
            first, stride = _address(context, builder, signature.args[0], image, [row, column])
            sum_up = _sum_columns if across_rows else _sum_rows
            values = builder.sitofp(sum_up(builder, first, stride, taps, bits, each), ir.VectorType(_FLOAT, LANES))
            whole = values.type.as_pointer()
            place, _stride = _address(context, builder, signature.args[7], pixel, [index(0)])
            builder.store(values, builder.inttoptr(place, whole), align=4)
            products = []
            for template in range(2):
                at = [table, phase, index(template), index(0)]
                place, _stride = _address(context, builder, signature.args[4], weight, at)
                factors = builder.load(builder.inttoptr(place, whole), align=4)
                products.append(_add_up(builder, builder.fmul(factors, values)))
            return context.make_tuple(builder, signature.return_type, products)

        return signature, generate

    return cast(Strip, strip)


def _address(context: Any, builder: Any, kind: Any, value: Any, place: list[Any]) -> tuple[Any, Any]:
    """Address of an array's element, and the bytes from row to row, as numbers."""
    array = context.make_array(kind)(context, builder, value)
    shape, strides = (cgutils.unpack_tuple(builder, packed) for packed in (array.shape, array.strides))
    pointer = cgutils.get_item_pointer2(
        context, builder, array.data, shape, strides, kind.layout, place, wraparound=False
    )
    return builder.ptrtoint(pointer, place[0].type), strides[0]


def _sum_rows(builder: Any, address: Any, stride: Any, _taps: Any, bits: int, each: int) -> Any:
    """Sum of `each` rows of LANES pixels."""
    total = ir.Constant(_SUM, [0] * LANES)
    pixels = ir.VectorType(ir.IntType(bits), LANES).as_pointer()
    for _ in range(each):
        row = builder.load(builder.inttoptr(address, pixels), align=bits // 8)
        total = builder.add(total, builder.zext(row, _SUM))
        address = builder.add(address, stride)
    return total


def _sum_columns(builder: Any, address: Any, stride: Any, taps: Any, bits: int, each: int) -> Any:
    """Sums of `each` pixels side by side, of LANES rows: `each` pixels are one number, whose digits are added."""
    run = ir.IntType(bits * each)
    runs: Any = ir.Constant(ir.VectorType(run, LANES), ir.Undefined)
    for k in range(LANES):
        number = builder.load(builder.inttoptr(address, run.as_pointer()), align=bits // 8)
        runs = builder.insert_element(runs, number, _INDEX(k))
        step = stride
        if k + 1 >= SURE:  # beyond the last row there may be no image
            step = builder.select(builder.icmp_unsigned("<", taps.type(k + 1), taps), stride, stride.type(0))
        address = builder.add(address, step)
    total = ir.Constant(runs.type, [0] * LANES)
    for k in range(each):
        digit = builder.lshr(runs, ir.Constant(runs.type, [bits * k] * LANES))
        total = builder.add(total, builder.and_(digit, ir.Constant(runs.type, [(1 << bits) - 1] * LANES)))
    if run.width == _SUM.element.width:
        return total
    return builder.trunc(total, _SUM) if run.width > _SUM.element.width else builder.zext(total, _SUM)


def _add_up(builder: Any, values: Any) -> Any:
    """Sum of all lanes, by halves."""
    count = LANES
    while count > 1:
        count //= 2
        halves = [ir.Constant(ir.VectorType(_INDEX, count), list(range(i, i + count))) for i in (0, count)]
        values = builder.fadd(*(builder.shuffle_vector(values, values, half) for half in halves))
    return builder.extract_element(values, _INDEX(0))
