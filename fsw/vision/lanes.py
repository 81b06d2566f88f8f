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
            at = _Addresses(context, builder, signature)
            if across_rows:
                total = _sum_columns(builder, lambda k: at(0, image, [builder.add(row, k), column]), taps, bits, each)
            else:
                total = _sum_rows(builder, lambda k: at(0, image, [builder.add(row, k), column]), index, bits, each)
            values = builder.sitofp(total, ir.VectorType(_FLOAT, LANES))
            whole = values.type.as_pointer()
            builder.store(values, builder.bitcast(at(7, pixel, [index(0)]), whole), align=4)
            products = []
            for template in range(2):
                place = at(4, weight, [table, phase, index(template), index(0)])
                factors = builder.load(builder.bitcast(place, whole), align=4)
                products.append(_add_up(builder, builder.fmul(factors, values)))
            return context.make_tuple(builder, signature.return_type, products)

        return signature, generate

    return cast(Strip, strip)


class _Addresses:
    """Address of an array's element, of the arguments of one signature."""

    def __init__(self, context: Any, builder: Any, signature: Any) -> None:
        self.context, self.builder, self.signature = context, builder, signature

    def __call__(self, argument: int, value: Any, place: list[Any]) -> Any:
        kind, builder = self.signature.args[argument], self.builder
        array = self.context.make_array(kind)(self.context, builder, value)
        shape, strides = (cgutils.unpack_tuple(builder, packed) for packed in (array.shape, array.strides))
        return cgutils.get_item_pointer2(
            self.context, builder, array.data, shape, strides, kind.layout, place, wraparound=False
        )


def _sum_rows(builder: Any, at: Callable[[Any], Any], index: Any, bits: int, each: int) -> Any:
    """Sum of `each` rows of LANES pixels."""
    total = ir.Constant(_SUM, [0] * LANES)
    pixels = ir.VectorType(ir.IntType(bits), LANES)
    for k in range(each):
        row = builder.load(builder.bitcast(at(index(k)), pixels.as_pointer()), align=bits // 8)
        total = builder.add(total, builder.zext(row, _SUM))
    return total


def _sum_columns(builder: Any, at: Callable[[Any], Any], taps: Any, bits: int, each: int) -> Any:
    """Sums of `each` pixels side by side, of LANES rows: `each` pixels are one number, whose digits are added."""
    run, one = ir.IntType(bits * each), taps.type(1)
    runs: Any = ir.Constant(ir.VectorType(run, LANES), ir.Undefined)
    last = builder.sub(taps, one)
    for k in range(LANES):
        row = taps.type(k)
        if k >= SURE:  # beyond the last row there may be no image
            row = builder.select(builder.icmp_unsigned("<", row, last), row, last)
        number = builder.load(builder.bitcast(at(row), run.as_pointer()), align=bits // 8)
        runs = builder.insert_element(runs, number, _INDEX(k))
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
