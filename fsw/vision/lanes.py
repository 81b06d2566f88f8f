"""Pixels of many strips at once, side by side in vectors: summed, turned to one line a strip, and weighed.

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

Index = np.uintp  # without a sign, it needs no look at an array's other end
Lines = NDArray[np.float32]
Reader = Callable[[NDArray[Any], Index, Index, Index, Lines, Index, Index], None]
Weigher = Callable[[Lines, Index, Index, Lines, Index, Index, Index], tuple[float, float]]
SquareWeigher = Callable[[Lines, Index, Index, Lines, Index, Index], float]

LANES = 16  # strips read at once, and pixels weighed at once
ROWS = 8  # read at once
_BYTES = ir.IntType(8).as_pointer()
_INDEX, _FLOAT, _SUM = ir.IntType(32), ir.FloatType(), ir.VectorType(ir.IntType(32), LANES)


def make_column_reader(each: int) -> Reader:
    """The function read(image, row, column, last, lines, strip, place): strips side by side along image rows.

    Of each of LANES strips, `each` columns wide, the first at `column`, it writes the sums of ROWS rows from `row` on
    to lines[strip + lane, place:]. Behind row `last` it takes that row again. Nothing is checked: `each` x LANES pixels
    from `column` on must lie in the image's memory in every row.
    """

    @intrinsic
    def read(_: Any, image: Any, row: Any, column: Any, last: Any, lines: Any, strip: Any, place: Any) -> Any:
        n = types.uintp
        signature = types.void(image, n, n, n, lines, n, n)
        bits = image.dtype.bitwidth

        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            image, row, column, last, lines, strip, place = args
            address, stride = _address(context, builder, signature.args[0], image, [row, column])
            rows = []
            for k in range(ROWS):
                rows.append(_to_float(builder, _add_digits(builder, _load(builder, address, bits * each, bits), bits)))
                further = builder.icmp_unsigned("<", builder.add(row, row.type(k)), last)
                address = builder.add(address, builder.select(further, stride, stride.type(0)))
            out, stride = _address(context, builder, signature.args[4], lines, [strip, place])
            for lane in range(0, LANES, ROWS):
                part = [_shuffle(builder, values, values, range(lane, lane + ROWS)) for values in rows]
                for values in _transposed(builder, part):
                    builder.store(values, builder.inttoptr(out, values.type.as_pointer()), align=4)
                    out = builder.add(out, stride)
            return context.get_dummy_value()

        return signature, generate

    return cast(Reader, read)


def make_row_reader(each: int) -> Reader:
    """The function read(image, row, column, last, lines, strip, place): one strip of LANES columns.

    It writes the sums of `each` rows from `row` on to lines[strip, place:]. Nothing is checked, `last` is not used:
    LANES pixels from `column` on must lie in the image's memory in every row.
    """

    @intrinsic
    def read(_: Any, image: Any, row: Any, column: Any, last: Any, lines: Any, strip: Any, place: Any) -> Any:
        n = types.uintp
        signature = types.void(image, n, n, n, lines, n, n)
        bits = image.dtype.bitwidth

        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            image, row, column, _last, lines, strip, place = args
            address, stride = _address(context, builder, signature.args[0], image, [row, column])
            total = None
            for _ in range(each):
                pixels = builder.zext(_load(builder, address, bits, bits), ir.VectorType(ir.IntType(2 * bits), LANES))
                total = builder.add(total, pixels) if total else pixels
                address = builder.add(address, stride)
            out, _stride = _address(context, builder, signature.args[4], lines, [strip, place])
            values = _to_float(builder, total)
            builder.store(values, builder.inttoptr(out, values.type.as_pointer()), align=4)
            return context.get_dummy_value()

        return signature, generate

    return cast(Reader, read)


@intrinsic
def _prefetch(_: Any, image: Any, row: Any, offset: Any) -> Any:
    """Ask for the line of the cache that holds the byte at an offset in an image's row, and do not wait for it."""
    signature = types.void(image, types.intp, types.intp)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        image, row, offset = args
        array = context.make_array(signature.args[0])(context, builder, image)
        stride = cgutils.unpack_tuple(builder, array.strides)[0]
        place = builder.add(builder.mul(row, stride), offset)
        kind = ir.FunctionType(ir.VoidType(), [_BYTES, _INDEX, _INDEX, _INDEX])
        function = cgutils.get_or_insert_function(builder.module, kind, "llvm.prefetch.p0")
        address = builder.inttoptr(builder.add(builder.ptrtoint(array.data, place.type), place), _BYTES)
        builder.call(function, [address, _INDEX(0), _INDEX(3), _INDEX(1)])  # to read, into the nearest cache, data
        return context.get_dummy_value()

    return signature, generate


prefetch = cast(Callable[[NDArray[Any], int, int], None], _prefetch)


@intrinsic
def _weigh(_: Any, lines: Any, strip: Any, place: Any, weight: Any, table: Any, phase: Any, template: Any) -> Any:
    """Products of lines[strip, place:place + LANES], less its first number, with two templates from `template` on.

    weight (tables, phases, templates, LANES). Nothing is checked.
    """
    n = types.uintp
    signature = types.UniTuple(types.float32, 2)(lines, n, n, weight, n, n, n)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        lines, strip, place, weight, table, phase, template = args
        values = _line(context, builder, signature.args[0], lines, [strip, place])
        values = builder.fsub(values, _shuffle(builder, values, values, [0] * LANES))
        products = []
        for more in range(2):
            at = [table, phase, builder.add(template, template.type(more)), template.type(0)]
            factors = _line(context, builder, signature.args[3], weight, at)
            products.append(_add_up(builder, builder.fmul(factors, values)))
        return context.make_tuple(builder, signature.return_type, products)

    return signature, generate


weigh = cast(Weigher, _weigh)


@intrinsic
def _weigh_squares(_: Any, lines: Any, strip: Any, place: Any, weight: Any, table: Any, phase: Any) -> Any:
    """Product of the squares of lines[strip, place:place + LANES], less its first number, with weights.

    weight (tables, phases, LANES). Nothing is checked.
    """
    n = types.uintp
    signature = types.float32(lines, n, n, weight, n, n)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        lines, strip, place, weight, table, phase = args
        values = _line(context, builder, signature.args[0], lines, [strip, place])
        values = builder.fsub(values, _shuffle(builder, values, values, [0] * LANES))
        factors = _line(context, builder, signature.args[3], weight, [table, phase, phase.type(0)])
        return _add_up(builder, builder.fmul(factors, builder.fmul(values, values)))

    return signature, generate


weigh_squares = cast(SquareWeigher, _weigh_squares)


def _address(context: Any, builder: Any, kind: Any, value: Any, place: list[Any]) -> tuple[Any, Any]:
    """Address of an array's element, and the bytes from row to row, as numbers."""
    array = context.make_array(kind)(context, builder, value)
    shape, strides = (cgutils.unpack_tuple(builder, packed) for packed in (array.shape, array.strides))
    pointer = cgutils.get_item_pointer2(
        context, builder, array.data, shape, strides, kind.layout, place, wraparound=False
    )
    return builder.ptrtoint(pointer, place[0].type), strides[0]


def _load(builder: Any, address: Any, bits: int, aligned: int) -> Any:
    """LANES numbers of so many bits."""
    return builder.load(
        builder.inttoptr(address, ir.VectorType(ir.IntType(bits), LANES).as_pointer()), align=aligned // 8
    )


def _line(context: Any, builder: Any, kind: Any, value: Any, place: list[Any]) -> Any:
    """LANES numbers of an array."""
    address, _stride = _address(context, builder, kind, value, place)
    return builder.load(builder.inttoptr(address, ir.VectorType(_FLOAT, LANES).as_pointer()), align=4)


def _add_digits(builder: Any, runs: Any, bits: int) -> Any:
    """Pixels side by side are one number, of so many bits each: their sum, neighbours first."""
    while bits < runs.type.element.width:
        mask = sum(((1 << bits) - 1) << at for at in range(0, runs.type.element.width, 2 * bits))
        digits = ir.Constant(runs.type, [mask] * LANES)
        upper = builder.lshr(runs, ir.Constant(runs.type, [bits] * LANES))
        runs = builder.add(builder.and_(runs, digits), builder.and_(upper, digits))
        bits *= 2
    return runs


def _to_float(builder: Any, sums: Any) -> Any:
    """Whole numbers, none of them larger than 2^24, as floating-point numbers."""
    if sums.type.element.width > _SUM.element.width:
        sums = builder.trunc(sums, _SUM)
    elif sums.type.element.width < _SUM.element.width:
        sums = builder.zext(sums, _SUM)
    return builder.sitofp(sums, ir.VectorType(_FLOAT, LANES))


def _shuffle(builder: Any, a: Any, b: Any, lanes: Any) -> Any:
    """Lanes of a, and behind them those of b."""
    chosen = list(lanes)
    return builder.shuffle_vector(a, b, ir.Constant(ir.VectorType(_INDEX, len(chosen)), chosen))


def _transposed(builder: Any, rows: list[Any]) -> list[Any]:
    """Columns of as many rows as they are long: blocks off the diagonal change places, from single numbers upwards."""
    size, block = len(rows), 1
    while block < size:
        upper = [j if j & block == 0 else size + j - block for j in range(size)]
        lower = [j + block if j & block == 0 else size + j for j in range(size)]
        for i in (i for i in range(size) if i & block == 0):
            a, b = rows[i], rows[i + block]
            rows[i], rows[i + block] = _shuffle(builder, a, b, upper), _shuffle(builder, a, b, lower)
        block *= 2
    return rows


def _add_up(builder: Any, values: Any) -> Any:
    """Sum of all lanes, by halves."""
    count = LANES
    while count > 1:
        count //= 2
        low, high = (_shuffle(builder, values, values, range(i, i + count)) for i in (0, count))
        values = builder.fadd(low, high)
    return builder.extract_element(values, _INDEX(0))
