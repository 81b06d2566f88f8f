"""Products of strips with templates, several at once."""

from collections.abc import Callable
from typing import Any, cast

from numba.core import types
from numba.extending import intrinsic

from fsw.vision.lanes import LANES, TAPS, Index, Lines, Places
from fsw.vision.vectors import (
    FLOAT,
    INDEX,
    add_up_each,
    address_of,
    halved,
    load,
    load_whole,
    place_of,
    shuffle,
    store,
)

StripWeigher = Callable[[Lines, Places, Lines, Index, Places, Lines, Index], None]
OtherWeigher = Callable[[Lines, Index, Index, Lines, Lines, Index, Index], tuple[float, float, float, float, float]]

FIRST = 2  # templates that every strip is weighed with,
OTHERS = 4  # and those behind them


@intrinsic
def _weigh_strips(
    _: Any, lines: Any, starts: Any, weight: Any, table: Any, phases: Any, products: Any, strip: Any
) -> Any:
    """Products of LANES strips from `strip` on with their phases' first two templates: products[0 and 1, strip:].

    Of each strip lines[i, starts[i]:][:TAPS], less its first number; starts[i] < 0 is as good as 0. phases (strips,).
    weight (tables, phases, templates, TAPS). Nothing is checked.
    """
    n = types.uintp
    signature = types.void(lines, starts, weight, n, phases, products, n)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        lines, starts, weight, table, phases, products, strip = args
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
        for i, sums in enumerate(both):
            out, _stride = address_of(context, builder, signature.args[5], products, [strip.type(i), strip])
            store(builder, out, add_up_each(builder, sums))
        return context.get_dummy_value()

    return signature, generate


weigh_strips = cast(StripWeigher, _weigh_strips)


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
