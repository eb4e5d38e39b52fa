"""Arithmetic on the lanes of the integrator, written down in LLVM's own vector terms.

numba's loops over lanes stay scalar wherever arrays might overlap, and its sums live in memory.  `elementwise`
turns a formula into vector instructions for a row of columns; the other functions are sums over power series
with their totals in registers.  Every column goes through the same instructions, so that the bits of a row do
not depend on its lane.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

__all__ = [
    "apart",
    "bare",
    "curves_at",
    "derivatives_at",
    "elementwise",
    "larger",
    "mix",
    "products",
    "root_of",
    "row",
    "size_of",
    "smaller",
    "values_at",
    "where",
]


def _tools() -> tuple[Any, Any, Any]:
    """LLVM's instructions, numba's types, and the decorator that joins them."""
    from llvmlite import ir  # type: ignore[import-untyped]
    from numba.core import types
    from numba.extending import intrinsic

    return ir, types, intrinsic


ir, types, intrinsic = _tools()
_INDEX = ir.IntType(64)
#: numbers in one vector of the code; the compiler splits them as the processor needs
_WIDTH = 4
_Body = Callable[[Any, list[Any]], list[Any]]
_VECTOR = ir.VectorType(ir.DoubleType(), _WIDTH)


def _data(context: Any, builder: Any, kind: Any, row: Any) -> Any:
    """Address of the first number of an array, or of what `row` gave."""
    return row if isinstance(kind, types.CPointer) else context.make_array(kind)(context, builder, row).data


@intrinsic
def _row(typing: Any, array: Any, index: Any, first: Any) -> Any:
    """Address of array[index, first]: a slice would count its owners, which costs more than the arithmetic."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kind = signature.args[0]
        given = context.make_array(kind)(context, builder, arguments[0])
        index, first = (context.cast(builder, arguments[i], signature.args[i], types.int64) for i in (1, 2))
        width = builder.extract_value(given.shape, 1)
        return builder.gep(given.data, [builder.add(builder.mul(index, width), first)])

    return types.CPointer(types.float64)(array, index, first), generate


def _place(builder: Any, data: Any, index: Any) -> Any:
    return builder.bitcast(builder.gep(data, [index]), _VECTOR.as_pointer())


@intrinsic
def _bare(typing: Any, array: Any) -> Any:
    """The same array without an owner, whom numba would count at every call; the owner must outlive it."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        found = context.make_array(signature.args[0])(context, builder, arguments[0])
        found.meminfo = ir.Constant(found.meminfo.type, None)
        found.parent = ir.Constant(found.parent.type, None)
        return found._getvalue()

    return array(array), generate


def _load(builder: Any, data: Any, index: Any) -> Any:
    return builder.load(_place(builder, data, index), align=8, typ=_VECTOR)


def _spread(builder: Any, number: Any) -> Any:
    one = builder.insert_element(ir.Constant(_VECTOR, ir.Undefined), number, ir.Constant(ir.IntType(32), 0))
    mask = ir.Constant(ir.VectorType(ir.IntType(32), _WIDTH), [0] * _WIDTH)
    return builder.shuffle_vector(one, one, mask)


def _multiply_add(builder: Any, a: Any, b: Any, c: Any) -> Any:
    return builder.fadd(builder.fmul(a, b, flags=("contract",)), c, flags=("contract",))


def _number(value: int) -> Any:
    return ir.Constant(_INDEX, value)


def _loop(builder: Any, low: Any, high: Any, totals: list[Any], body: _Body) -> list[Any]:
    """totals = body(j, totals) for j from low to high - 1, the totals in registers."""
    before = builder.block
    head, inside, after = (builder.append_basic_block(name) for name in ("head", "inside", "after"))
    builder.branch(head)
    builder.position_at_end(head)
    j = builder.phi(_INDEX)
    held = [builder.phi(_VECTOR) for _ in totals]
    builder.cbranch(builder.icmp_signed("<", j, high), inside, after)
    builder.position_at_end(inside)
    results = body(j, held)
    following = builder.add(j, _number(1))
    end = builder.block
    builder.branch(head)
    j.add_incoming(low, before)
    j.add_incoming(following, end)
    for phi, first, result in zip(held, totals, results, strict=True):
        phi.add_incoming(first, before)
        phi.add_incoming(result, end)
    builder.position_at_end(after)
    return held


class Vector:
    """One vector of columns inside a formula of `elementwise`, or the outcome of a comparison of two."""

    def __init__(self, builder: Any, value: Any) -> None:
        self.builder, self.value = builder, value

    def _other(self, other: Any) -> Any:
        if isinstance(other, Vector):
            return other.value
        return ir.Constant(_VECTOR, [float(other)] * _WIDTH)

    def _make(self, name: str, left: Any, right: Any) -> Vector:
        return Vector(self.builder, getattr(self.builder, name)(left, right))

    def __add__(self, other: Any) -> Vector:
        return self._make("fadd", self.value, self._other(other))

    def __sub__(self, other: Any) -> Vector:
        return self._make("fsub", self.value, self._other(other))

    def __mul__(self, other: Any) -> Vector:
        return self._make("fmul", self.value, self._other(other))

    def __truediv__(self, other: Any) -> Vector:
        return self._make("fdiv", self.value, self._other(other))

    def __radd__(self, other: Any) -> Vector:
        return self._make("fadd", self._other(other), self.value)

    def __rsub__(self, other: Any) -> Vector:
        return self._make("fsub", self._other(other), self.value)

    def __rmul__(self, other: Any) -> Vector:
        return self._make("fmul", self._other(other), self.value)

    def __rtruediv__(self, other: Any) -> Vector:
        return self._make("fdiv", self._other(other), self.value)

    def __neg__(self) -> Vector:
        return 0.0 - self

    def __lt__(self, other: Any) -> Vector:
        return Vector(self.builder, self.builder.fcmp_ordered("<", self.value, self._other(other)))

    def __le__(self, other: Any) -> Vector:
        return Vector(self.builder, self.builder.fcmp_ordered("<=", self.value, self._other(other)))

    def __gt__(self, other: Any) -> Vector:
        return Vector(self.builder, self.builder.fcmp_ordered(">", self.value, self._other(other)))

    def __ge__(self, other: Any) -> Vector:
        return Vector(self.builder, self.builder.fcmp_ordered(">=", self.value, self._other(other)))

    def __and__(self, other: Vector) -> Vector:
        return self._make("and_", self.value, other.value)

    def __or__(self, other: Vector) -> Vector:
        return self._make("or_", self.value, other.value)


def where(choice: Vector, yes: Any, no: Any) -> Vector:
    """`yes` where a comparison holds, `no` elsewhere; at least one of the two is a vector or a number."""
    return Vector(choice.builder, choice.builder.select(choice.value, choice._other(yes), choice._other(no)))


def larger(a: Vector, b: Any) -> Vector:
    """The larger of two; the second where they cannot be compared."""
    return where(a > b, a, b)


def smaller(a: Vector, b: Any) -> Vector:
    """The smaller of two; the second where they cannot be compared."""
    return where(a < b, a, b)


def _call(name: str, a: Vector) -> Vector:
    module, full = a.builder.module, f"{name}.v{_WIDTH}f64"
    function = module.globals.get(full) or ir.Function(module, ir.FunctionType(_VECTOR, [_VECTOR]), full)
    return Vector(a.builder, a.builder.call(function, [a.value]))


def root_of(a: Vector) -> Vector:
    """Square root."""
    return _call("llvm.sqrt", a)


def size_of(a: Vector) -> Vector:
    """Absolute value."""
    return _call("llvm.fabs", a)


def elementwise(columns: int, outputs: int, formula: Callable[..., Any]) -> Any:
    """A function f(out_1 ... out_k, in_1 ... in_n) for compiled code that applies `formula` to `columns` columns.

    What goes in are arrays of one dimension, rows of arrays of two, as `row` gives them, or single numbers; what
    comes out may be one of the rows that went in.
    """

    @intrinsic
    def apply(typing: Any, *arguments: Any) -> Any:
        packed = types.StarArgTuple.from_types(arguments)

        def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
            kinds = list(signature.args[0])
            parts = [builder.extract_value(given[0], i) for i in range(len(kinds))]
            rows = [
                _data(context, builder, kind, part) if isinstance(kind, types.Array | types.CPointer) else None
                for kind, part in zip(kinds, parts, strict=True)
            ]
            numbers = [
                None if row is not None else _spread(builder, context.cast(builder, part, kind, types.float64))
                for row, part, kind in zip(rows, parts, kinds, strict=True)
            ]
            for place in range(0, columns, _WIDTH):
                inputs = [
                    Vector(builder, _load(builder, row, _number(place)) if row is not None else number)
                    for row, number in zip(rows[outputs:], numbers[outputs:], strict=True)
                ]
                results = formula(*inputs)
                for row, result in zip(rows, results if isinstance(results, tuple) else (results,), strict=False):
                    builder.store(result.value, _place(builder, row, _number(place)), align=8)
            return context.get_dummy_value()

        return types.void(packed), generate

    return apply


def _zeros(count: int) -> list[Any]:
    return [ir.Constant(_VECTOR, [0.0] * _WIDTH)] * count


def _products_of(columns: int) -> Any:
    """The function out[m] = sum of a[j, m] b[k-j, m], low <= j < high, over `columns` columns."""
    count = columns // _WIDTH

    @intrinsic
    def products(typing: Any, a: Any, b: Any, k: Any, low: Any, high: Any, out: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            kinds = signature.args
            data_a, data_b, data_out = (_data(context, builder, kinds[i], arguments[i]) for i in (0, 1, 5))
            k, low, high = (context.cast(builder, arguments[i], kinds[i], types.int64) for i in (2, 3, 4))

            def body(j: Any, totals: list[Any]) -> list[Any]:
                row_a = builder.mul(j, _number(columns))
                row_b = builder.mul(builder.sub(k, j), _number(columns))
                results = []
                for i, total in enumerate(totals):
                    place = _number(i * _WIDTH)
                    left = _load(builder, data_a, builder.add(row_a, place))
                    right = _load(builder, data_b, builder.add(row_b, place))
                    results.append(_multiply_add(builder, left, right, total))
                return results

            for i, total in enumerate(_loop(builder, low, high, _zeros(count), body)):
                builder.store(total, _place(builder, data_out, _number(i * _WIDTH)), align=8)
            return context.get_dummy_value()

        return types.void(a, b, k, low, high, out), generate

    return products


def _values_of(points: int) -> Any:
    """The function out[i] = sum of series[k] x[i]^k, k = 0 ... order, over `points` points."""
    count = points // _WIDTH

    @intrinsic
    def values_at(typing: Any, series: Any, order: Any, x: Any, out: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            kinds = signature.args
            data, data_x, data_out = (_data(context, builder, kinds[i], arguments[i]) for i in (0, 2, 3))
            order = context.cast(builder, arguments[1], kinds[1], types.int64)
            at = [_load(builder, data_x, _number(i * _WIDTH)) for i in range(count)]

            def body(j: Any, totals: list[Any]) -> list[Any]:
                term = _spread(builder, builder.load(builder.gep(data, [builder.sub(order, j)])))
                return [_multiply_add(builder, total, z, term) for total, z in zip(totals, at, strict=True)]

            high = builder.add(order, _number(1))
            for i, total in enumerate(_loop(builder, _number(0), high, _zeros(count), body)):
                builder.store(total, _place(builder, data_out, _number(i * _WIDTH)), align=8)
            return context.get_dummy_value()

        return types.void(series, order, x, out), generate

    return values_at


def _mix_of(columns: int) -> Any:
    """The function out[m] = sum of weights[i] rows[i, m], 0 <= i < columns, over `columns` columns."""
    count = columns // _WIDTH

    @intrinsic
    def mix(typing: Any, weights: Any, rows: Any, out: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            data, data_rows, data_out = (_data(context, builder, signature.args[i], arguments[i]) for i in range(3))

            def body(j: Any, totals: list[Any]) -> list[Any]:
                weight = _spread(builder, builder.load(builder.gep(data, [j])))
                row = builder.mul(j, _number(columns))
                parts = [_load(builder, data_rows, builder.add(row, _number(i * _WIDTH))) for i in range(count)]
                return [_multiply_add(builder, weight, part, total) for part, total in zip(parts, totals, strict=True)]

            for i, total in enumerate(_loop(builder, _number(0), _number(columns), _zeros(count), body)):
                builder.store(total, _place(builder, data_out, _number(i * _WIDTH)), align=8)
            return context.get_dummy_value()

        return types.void(weights, rows, out), generate

    return mix


def _derivatives_of(columns: int) -> Any:
    """The function at[m] = sum of x[k, m] t[m]^k and its derivative by t, over `columns` columns from `first`."""
    count = columns // _WIDTH

    @intrinsic
    def derivatives_at(typing: Any, x: Any, order: Any, width: Any, first: Any, t: Any, at: Any, rate: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            kinds = signature.args
            data, data_t, data_at, data_rate = (_data(context, builder, kinds[i], arguments[i]) for i in (0, 4, 5, 6))
            order, width, first = (context.cast(builder, arguments[i], kinds[i], types.int64) for i in (1, 2, 3))
            shares = [_load(builder, data_t, _number(i * _WIDTH)) for i in range(count)]

            def body(j: Any, totals: list[Any]) -> list[Any]:
                row = builder.add(builder.mul(builder.sub(order, j), width), first)
                values, rates = [], []
                for i, z in enumerate(shares):
                    term = _load(builder, data, builder.add(row, _number(i * _WIDTH)))
                    rates.append(_multiply_add(builder, totals[count + i], z, totals[i]))
                    values.append(_multiply_add(builder, totals[i], z, term))
                return values + rates

            high = builder.add(order, _number(1))
            totals = _loop(builder, _number(0), high, _zeros(2 * count), body)
            for i in range(count):
                place = builder.add(first, _number(i * _WIDTH))
                builder.store(totals[i], _place(builder, data_at, place), align=8)
                builder.store(totals[count + i], _place(builder, data_rate, place), align=8)
            return context.get_dummy_value()

        return types.void(x, order, width, first, t, at, rate), generate

    return derivatives_at


def _curves_of(columns: int) -> Any:
    """at[m] = sum of x[k, m] t[m]^k, its derivative by t and half its second derivative, from column `first`."""
    count = columns // _WIDTH

    @intrinsic
    def curves_at(
        typing: Any, x: Any, order: Any, width: Any, first: Any, t: Any, at: Any, rate: Any, bend: Any
    ) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            kinds = signature.args
            data, *rows = (_data(context, builder, kinds[i], arguments[i]) for i in (0, 4, 5, 6, 7))
            order, width, first = (context.cast(builder, arguments[i], kinds[i], types.int64) for i in (1, 2, 3))
            places = [builder.add(first, _number(i * _WIDTH)) for i in range(count)]
            shares = [_load(builder, rows[0], place) for place in places]

            def body(j: Any, totals: list[Any]) -> list[Any]:
                row = builder.mul(builder.sub(order, j), width)
                values, rates, bends = [], [], []
                for i, z in enumerate(shares):
                    term = _load(builder, data, builder.add(row, places[i]))
                    bends.append(_multiply_add(builder, totals[2 * count + i], z, totals[count + i]))
                    rates.append(_multiply_add(builder, totals[count + i], z, totals[i]))
                    values.append(_multiply_add(builder, totals[i], z, term))
                return values + rates + bends

            high = builder.add(order, _number(1))
            totals = _loop(builder, _number(0), high, _zeros(3 * count), body)
            for kind in range(3):
                for i in range(count):
                    builder.store(totals[kind * count + i], _place(builder, rows[1 + kind], places[i]), align=8)
            return context.get_dummy_value()

        return types.void(x, order, width, first, t, at, rate, bend), generate

    return curves_at


@intrinsic
def _apart(typing: Any) -> Any:
    """Keep the function that calls this out of its callers: a copy at every place of use costs seconds to compile."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        builder.function.attributes.add("noinline")
        return context.get_dummy_value()

    return types.void(), generate


apart: Any = _apart
products: Any = _products_of(32)
values_at: Any = _values_of(12)
mix: Any = _mix_of(12)
derivatives_at: Any = _derivatives_of(16)
curves_at: Any = _curves_of(16)
row: Any = _row
bare: Any = _bare
