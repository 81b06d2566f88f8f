"""Products of strips with templates, and their sums over the strips of a segment, several at once."""

from collections.abc import Callable
from typing import Any, cast

import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic
from numpy.typing import NDArray

from fsw.vision.lanes import LANES, TAPS, Index, Lines, Places
from fsw.vision.vectors import (
    FLOAT,
    INDEX,
    add_up_each,
    address_of,
    everywhere,
    halved,
    load,
    load_whole,
    place_of,
    shuffle,
    store,
)

FloatArray = NDArray[np.float64]
StripWeigher = Callable[[Lines, Places, Lines, Index, Places, FloatArray, Lines, Index], None]
StripAdder = Callable[[Lines, Index, Index], tuple[float, float, float, float, float]]
OtherWeigher = Callable[[Lines, Index, Index, Lines, Lines, Index, Index], tuple[float, float, float, float, float]]

FIRST = 2  # templates that every strip is weighed with,
OTHERS = 4  # and those behind them
# Of each strip: the step b, and c, b times the shift in pixels; 1 if it is taken, 0 if not, and then nothing else.
TAKEN, PRODUCTS = 2, 3
SUMS = 5  # count, and sums of b, b2, b c, c2
_REALS, _WHOLES = ir.VectorType(FLOAT, LANES), ir.VectorType(INDEX, LANES)


@intrinsic
def _weigh_strips(
    _: Any, lines: Any, starts: Any, weight: Any, table: Any, phases: Any, rests: Any, products: Any, strip: Any
) -> Any:
    """Products (PRODUCTS, strips) of LANES strips from `strip` on with their phases' first two templates.

    Of each strip lines[i, starts[i]:][:TAPS], less its first number; it is taken if starts[i] >= 0. phases (strips,),
    and rests (strips,), px that the edge lies beyond where the phase has it. weight (tables, phases, templates, TAPS).
    Nothing is checked.
    """
    n = types.uintp
    signature = types.void(lines, starts, weight, n, phases, rests, products, n)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        lines, starts, weight, table, phases, rests, products, strip = args
        none, size = strip.type(0), strip.type(4)
        line, pitch = address_of(context, builder, signature.args[0], lines, [strip, none])
        begin, step = address_of(context, builder, signature.args[1], starts, [strip])
        phase, each = address_of(context, builder, signature.args[4], phases, [strip])
        first, strides = place_of(context, builder, signature.args[2], weight, [table, none, none, none])
        both: tuple[list[Any], list[Any]] = [], []
        for _ in range(LANES):
            start = load_whole(builder, begin, none.type)
            start = builder.select(builder.icmp_signed(">", start, none), start, none)
            values = load(builder, builder.add(line, builder.mul(start, size)), FLOAT, TAPS, 4)
            values = builder.fsub(values, shuffle(builder, values, values, [0] * TAPS))
            factors = builder.add(first, builder.mul(load_whole(builder, phase, none.type), strides[1]))
            for sums in both:
                product = builder.fmul(load(builder, factors, FLOAT, TAPS, 4), values)
                sums.append(builder.fadd(*halved(builder, product)))
                factors = builder.add(factors, strides[2])
            line, begin, phase = (builder.add(a, b) for a, b in ((line, pitch), (begin, step), (phase, each)))
        begin, _step = address_of(context, builder, signature.args[1], starts, [strip])
        shown = builder.icmp_signed(">=", load(builder, begin, INDEX, LANES, 4), _WHOLES([0] * LANES))
        rest, _step = address_of(context, builder, signature.args[5], rests, [strip])
        rest = builder.fptrunc(load(builder, rest, ir.DoubleType(), LANES, 8), _REALS)
        step, shift = (add_up_each(builder, sums) for sums in both)
        shift = builder.fsub(shift, builder.fmul(step, rest))
        nothing = _REALS([0.0] * LANES)
        for i, values in enumerate((step, shift, _REALS([1.0] * LANES))):
            out, _stride = address_of(context, builder, signature.args[6], products, [strip.type(i), strip])
            store(builder, out, builder.select(shown, values, nothing))
        return context.get_dummy_value()

    return signature, generate


weigh_strips = cast(StripWeigher, _weigh_strips)


@intrinsic
def _add_strips(_: Any, products: Any, begun: Any, ended: Any) -> Any:
    """Sums over products[:, begun:ended] of the strips: how many are taken, b, b2, b c, c2.

    products (PRODUCTS, strips), LANES strips more than are ever added. Nothing is checked.
    """
    n = types.uintp
    signature = types.UniTuple(types.float32, SUMS)(products, n, n)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        products, begun, ended = args
        nothing = _REALS([0.0] * LANES)
        sums = [cgutils.alloca_once_value(builder, nothing) for _ in range(SUMS)]
        with cgutils.for_range_slice(builder, begun, ended, begun.type(LANES), begun.type) as (strip, _count):
            left = everywhere(builder, builder.trunc(builder.sub(ended, strip), INDEX), _WHOLES)
            own = builder.icmp_signed("<", _WHOLES(list(range(LANES))), left)
            values = []
            for i in range(PRODUCTS):
                at, _stride = address_of(context, builder, signature.args[0], products, [strip.type(i), strip])
                values.append(builder.select(own, load(builder, at, FLOAT, LANES, 4), nothing))
            b, c, taken = values
            for total, each in zip(
                sums, (taken, b, *(builder.fmul(*p) for p in ((b, b), (b, c), (c, c)))), strict=True
            ):
                builder.store(builder.fadd(builder.load(total), each), total)
        vectors = [builder.load(total) for total in sums]
        added = add_up_each(builder, vectors + vectors[:1] * (LANES - SUMS))
        found = [builder.extract_element(added, INDEX(i)) for i in range(SUMS)]
        return context.make_tuple(builder, signature.return_type, found)

    return signature, generate


add_strips = cast(StripAdder, _add_strips)


@intrinsic
def _weigh_others(_: Any, lines: Any, strip: Any, place: Any, weight: Any, own: Any, table: Any, phase: Any) -> Any:
    """Products of lines[strip, place:place + TAPS], less its first number, with the templates behind the first two.

    And of its squares with own. weight (tables, phases, templates, TAPS), own (tables, phases, TAPS). Nothing is
    checked.
    """
    n = types.uintp
    signature = types.UniTuple(types.float32, OTHERS + 1)(lines, n, n, weight, own, n, n)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        lines, strip, place, weight, own, table, phase = args
        values = _load_taps(context, builder, signature.args[0], lines, [strip, place])
        values = builder.fsub(values, shuffle(builder, values, values, [0] * TAPS))
        products = []
        for other in range(FIRST, FIRST + OTHERS):
            at = [table, phase, phase.type(other), phase.type(0)]
            factors = _load_taps(context, builder, signature.args[3], weight, at)
            products.append(builder.fmul(factors, values))
        factors = _load_taps(context, builder, signature.args[4], own, [table, phase, phase.type(0)])
        products.append(builder.fmul(factors, builder.fmul(values, values)))
        halves = [builder.fadd(*halved(builder, product)) for product in products]
        sums = add_up_each(builder, halves + halves[:1] * (LANES - len(halves)))
        found = [builder.extract_element(sums, INDEX(i)) for i in range(len(halves))]
        return context.make_tuple(builder, signature.return_type, found)

    return signature, generate


def _load_taps(context: Any, builder: Any, kind: Any, value: Any, place: list[Any]) -> Any:
    """TAPS numbers of an array."""
    address, _stride = address_of(context, builder, kind, value, place)
    return load(builder, address, FLOAT, TAPS, 4)


weigh_others = cast(OtherWeigher, _weigh_others)
