"""Vectors of numbers in LLVM, for the few kernels that numba's own code is too slow for.

numba knows no vectors, and LLVM makes none of sums of floating-point numbers, whose order it must keep. These lines
give LLVM vectors: any processor's, for it splits them as it needs. Sums of whole numbers are exact, and the others are
added in one order, by halves: the same bits on every run.
"""

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba.core import cgutils

INDEX, FLOAT = ir.IntType(32), ir.FloatType()
# Which lanes of two vectors are added to which: partial sums of two times as many strips are left, half as many each.
_FOLDS = (
    ((0, 1, 2, 3, 8, 9, 10, 11), (4, 5, 6, 7, 12, 13, 14, 15)),
    ((0, 1, 8, 9, 4, 5, 12, 13), (2, 3, 10, 11, 6, 7, 14, 15)),
    ((0, 2, 8, 10, 4, 6, 12, 14), (1, 3, 9, 11, 5, 7, 13, 15)),
)


def place_of(context: Any, builder: Any, kind: Any, value: Any, place: list[Any]) -> tuple[Any, list[Any]]:
    """Address of an array's element, and the bytes from one to the next along each axis, as numbers."""
    array = context.make_array(kind)(context, builder, value)
    shape, strides = (cgutils.unpack_tuple(builder, packed) for packed in (array.shape, array.strides))
    pointer = cgutils.get_item_pointer2(
        context, builder, array.data, shape, strides, kind.layout, place, wraparound=False
    )
    return builder.ptrtoint(pointer, place[0].type), strides


def address_of(context: Any, builder: Any, kind: Any, value: Any, place: list[Any]) -> tuple[Any, Any]:
    """Address of an array's element, and the bytes from row to row, as numbers."""
    address, strides = place_of(context, builder, kind, value, place)
    return address, strides[0]


def load(builder: Any, address: Any, kind: Any, count: int, align: int) -> Any:
    """So many numbers of a kind side by side."""
    return builder.load(builder.inttoptr(address, ir.VectorType(kind, count).as_pointer()), align=align)


def store(builder: Any, address: Any, values: Any) -> None:
    """Write numbers side by side."""
    builder.store(values, builder.inttoptr(address, values.type.as_pointer()), align=4)


def load_whole(builder: Any, address: Any, kind: Any) -> Any:
    """A whole number of 32 bits, made as long as others."""
    return builder.sext(builder.load(builder.inttoptr(address, INDEX.as_pointer())), kind)


def everywhere(builder: Any, value: Any, kind: Any) -> Any:
    """The same number in all lanes."""
    first = builder.insert_element(ir.Constant(kind, ir.Undefined), value, INDEX(0))
    return shuffle(builder, first, first, [0] * kind.count)


def add_digits(builder: Any, runs: Any, bits: int) -> Any:
    """Pixels side by side are one number, of so many bits each: their sum, neighbours first."""
    while bits < runs.type.element.width:
        mask = sum(((1 << bits) - 1) << at for at in range(0, runs.type.element.width, 2 * bits))
        digits = ir.Constant(runs.type, [mask] * runs.type.count)
        upper = builder.lshr(runs, ir.Constant(runs.type, [bits] * runs.type.count))
        runs = builder.add(builder.and_(runs, digits), builder.and_(upper, digits))
        bits *= 2
    return runs


def to_float(builder: Any, sums: Any) -> Any:
    """Whole numbers, none of them larger than 2^24, as floating-point numbers."""
    whole = ir.VectorType(INDEX, sums.type.count)
    if sums.type.element.width > INDEX.width:
        sums = builder.trunc(sums, whole)
    elif sums.type.element.width < INDEX.width:
        sums = builder.zext(sums, whole)
    return builder.sitofp(sums, ir.VectorType(FLOAT, sums.type.count))


def shuffle(builder: Any, a: Any, b: Any, lanes: Any) -> Any:
    """Lanes of a, and behind them those of b."""
    chosen = list(lanes)
    return builder.shuffle_vector(a, b, ir.Constant(ir.VectorType(INDEX, len(chosen)), chosen))


def transposed(builder: Any, rows: list[Any]) -> list[Any]:
    """Columns of as many rows as they are long: blocks off the diagonal change places, from single numbers upwards."""
    size, block = len(rows), 1
    while block < size:
        upper = [j if j & block == 0 else size + j - block for j in range(size)]
        lower = [j + block if j & block == 0 else size + j for j in range(size)]
        for i in (i for i in range(size) if i & block == 0):
            a, b = rows[i], rows[i + block]
            rows[i], rows[i + block] = shuffle(builder, a, b, upper), shuffle(builder, a, b, lower)
        block *= 2
    return rows


def halved(builder: Any, values: Any) -> tuple[Any, Any]:
    """The lower and the upper half of the lanes."""
    count = values.type.count // 2
    return tuple(shuffle(builder, values, values, range(i, i + count)) for i in (0, count))


def fold(builder: Any, values: Any, join: Callable[[Any, Any], Any]) -> Any:
    """All lanes joined to one number, by halves."""
    while values.type.count > 1:
        values = join(*halved(builder, values))
    return builder.extract_element(values, INDEX(0))


def outermost(builder: Any, values: Any, order: str) -> Any:
    """The whole number that is less ("<") or greater (">") than those in all other lanes."""
    return fold(builder, values, lambda a, b: builder.select(builder.icmp_signed(order, a, b), a, b))


def add_up_each(builder: Any, vectors: list[Any]) -> Any:
    """Sums of all lanes of each of 8 vectors, by halves, side by side."""
    half = len(vectors) // 2
    pairs = list(zip(vectors[:half], vectors[half:], strict=True))
    for ahead, behind in _FOLDS:
        vectors = [builder.fadd(shuffle(builder, *pair, ahead), shuffle(builder, *pair, behind)) for pair in pairs]
        pairs = list(zip(vectors[::2], vectors[1::2], strict=False))
    return vectors[0]
