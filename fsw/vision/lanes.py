"""Pixels of many strips at once, side by side in vectors: where they begin, summed, and turned to one line a strip."""

from collections.abc import Callable
from typing import Any, cast

import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic
from numpy.typing import NDArray

from fsw.vision.vectors import (
    INDEX,
    add_digits,
    address_of,
    everywhere,
    load,
    load_whole,
    outermost,
    store,
    to_float,
    transposed,
)

Index = np.uintp  # without a sign, it needs no look at an array's other end
Lines = NDArray[np.float32]
Places = NDArray[np.int32]
ColumnReader = Callable[[NDArray[Any], Index, Index, Lines, Index, Index], None]
RowReader = Callable[[NDArray[Any], Index, Places, Lines, Index], None]
WindowFinder = Callable[
    [tuple[float, float, float, float], float, float, int, int, Places, Places, NDArray[np.float64], Index],
    tuple[int, int],
]

LANES = 8  # strips read and weighed at once
ROWS = 8  # of the image, read at once
TAPS = 16  # pixels of a strip weighed at once
_BYTES = ir.IntType(8).as_pointer()


def make_column_reader(each: int) -> ColumnReader:
    """The function read(image, row, column, lines, strip, place): strips side by side along image rows.

    Of each of LANES strips, `each` columns wide, the first at `column`, it writes the sums of ROWS rows from `row` on
    to lines[strip + lane, place:]. Nothing is checked: `each` x LANES pixels from `column` on must lie in the image's
    memory in every row.
    """

    @intrinsic
    def read(_: Any, image: Any, row: Any, column: Any, lines: Any, strip: Any, place: Any) -> Any:
        n = types.uintp
        signature = types.void(image, n, n, lines, n, n)
        bits = image.dtype.bitwidth

        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            image, row, column, lines, strip, place = args
            address, stride = address_of(context, builder, signature.args[0], image, [row, column])
            rows = []
            for _ in range(ROWS):
                digits = load(builder, address, ir.IntType(bits * each), LANES, bits // 8)
                rows.append(to_float(builder, add_digits(builder, digits, bits)))
                address = builder.add(address, stride)
            out, stride = address_of(context, builder, signature.args[3], lines, [strip, place])
            for values in transposed(builder, rows):
                store(builder, out, values)
                out = builder.add(out, stride)
            return context.get_dummy_value()

        return signature, generate

    return cast(ColumnReader, read)


def make_row_reader(each: int) -> RowReader:
    """The function read(image, row, columns, lines, strip): strips one below the other, the first at `row`.

    Of each of LANES strips, `each` rows high, it writes the sums of TAPS columns from columns[strip + lane] on to
    lines[strip + lane]. Nothing is checked: all must lie in the image.
    """

    @intrinsic
    def read(_: Any, image: Any, row: Any, columns: Any, lines: Any, strip: Any) -> Any:
        n = types.uintp
        signature = types.void(image, n, columns, lines, n)
        bits = image.dtype.bitwidth

        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            image, row, columns, lines, strip = args
            first, pitch = address_of(context, builder, signature.args[0], image, [row, row.type(0)])
            column, step = address_of(context, builder, signature.args[2], columns, [strip])
            out, stride = address_of(context, builder, signature.args[3], lines, [strip, strip.type(0)])
            for _ in range(LANES):
                at = builder.mul(load_whole(builder, column, row.type), row.type(bits // 8))
                total = None
                for _ in range(each):
                    pixels = load(builder, builder.add(first, at), ir.IntType(bits), TAPS, bits // 8)
                    pixels = builder.zext(pixels, ir.VectorType(ir.IntType(2 * bits), TAPS))
                    total = builder.add(total, pixels) if total else pixels
                    first = builder.add(first, pitch)
                store(builder, out, to_float(builder, total))
                column, out = builder.add(column, step), builder.add(out, stride)
            return context.get_dummy_value()

        return signature, generate

    return cast(RowReader, read)


def make_window_finder(parts: int) -> WindowFinder:
    """The function find(curve, along, each, sign, first, starts, phases, rests, strip): where LANES windows begin.

    curve: where an edge stands across, see `place_at`; the strips lie at `along` + lane x each. Places are counted by
    `sign`, 1 or -1. A window begins `first` pixels from the edge's: starts[strip + lane]. In which of `parts` (a power
    of 2) of its pixel the edge lies, and how far from that one's middle, goes to phases and rests. Returns the least
    and the greatest start.
    """

    @intrinsic
    def find(
        _: Any,
        curve: Any,
        along: Any,
        each: Any,
        sign: Any,
        first: Any,
        starts: Any,
        phases: Any,
        rests: Any,
        strip: Any,
    ) -> Any:
        n, real, whole = types.uintp, types.float64, types.int32
        signature = types.UniTuple(whole, 2)(curve, real, real, whole, whole, starts, phases, rests, n)

        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            curve, along, each, sign, first, *out, strip = args
            reals, wholes = ir.VectorType(ir.DoubleType(), LANES), ir.VectorType(INDEX, LANES)
            middle, place, slope, bend, along, each = (
                everywhere(builder, value, reals) for value in (*cgutils.unpack_tuple(builder, curve), along, each)
            )
            t = builder.fadd(along, builder.fmul(each, ir.Constant(reals, [float(i) for i in range(LANES)])))
            t = builder.fsub(t, middle)
            place = builder.fadd(place, builder.fmul(t, builder.fadd(slope, builder.fmul(t, bend))))
            sign = everywhere(builder, sign, wholes)
            place = builder.fmul(place, builder.sitofp(builder.mul(sign, wholes([parts] * LANES)), reals))
            floor = ir.FunctionType(reals, [reals]), f"llvm.floor.v{LANES}f64"
            base = builder.call(cgutils.get_or_insert_function(builder.module, *floor), [place])
            part = builder.fptosi(base, wholes)
            rest = builder.fsub(builder.fsub(place, base), reals([0.5] * LANES))
            pixel = builder.ashr(part, wholes([parts.bit_length() - 1] * LANES))
            start = builder.add(builder.mul(pixel, sign), everywhere(builder, first, wholes))
            phase = builder.and_(part, wholes([parts - 1] * LANES))
            rest = builder.fmul(rest, reals([1.0 / parts] * LANES))
            for values, array, kind in zip((start, phase, rest), out, signature.args[5:8], strict=True):
                store(builder, address_of(context, builder, kind, array, [strip])[0], values)
            ends = [outermost(builder, start, order) for order in "<>"]
            return context.make_tuple(builder, signature.return_type, ends)

        return signature, generate

    return cast(WindowFinder, find)


@intrinsic
def _prefetch(_: Any, image: Any, row: Any, offset: Any) -> Any:
    """Ask for the line of the cache that holds the byte at an offset in an image's row, and do not wait for it."""
    signature = types.void(image, types.intp, types.intp)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        image, row, offset = args
        array = context.make_array(signature.args[0])(context, builder, image)
        stride = cgutils.unpack_tuple(builder, array.strides)[0]
        place = builder.add(builder.mul(row, stride), offset)
        kind = ir.FunctionType(ir.VoidType(), [_BYTES, INDEX, INDEX, INDEX])
        function = cgutils.get_or_insert_function(builder.module, kind, "llvm.prefetch.p0")
        address = builder.inttoptr(builder.add(builder.ptrtoint(array.data, place.type), place), _BYTES)
        builder.call(function, [address, INDEX(0), INDEX(3), INDEX(1)])  # to read, into the nearest cache, data
        return context.get_dummy_value()

    return signature, generate


prefetch = cast(Callable[[NDArray[Any], int, int], None], _prefetch)
