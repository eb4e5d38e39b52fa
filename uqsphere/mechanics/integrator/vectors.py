"""Arithmetic on the lanes of the integrator, written down in LLVM's own vector terms.

numba's loops over lanes stay scalar wherever arrays might overlap, and its sums live in memory.
`elementwise` turns a formula into vector instructions for a row of columns; the other functions are
sums over power series with their totals in registers.  Every column goes through the same
instructions, so that the bits of a row do not depend on its lane.

Numba and LLVM give their values no types that Python could check: none are written down here.
"""

from __future__ import annotations

import math
from typing import Any

from uqsphere.mechanics.integrator.tracked import LANES, PAIR, WAVE


def _tools():
    """LLVM's instructions, numba's types, and the decorator that joins them."""
    from llvmlite import ir  # type: ignore[import-untyped]
    from numba.core import types
    from numba.extending import intrinsic

    return ir, types, intrinsic


ir, types, intrinsic = _tools()
_INDEX = ir.IntType(64)
#: numbers in one vector of the code at most; the compiler splits them as the processor needs
_WIDEST = 4


def _vectors(columns):
    """Numbers in one vector, and vectors in so many columns."""
    width = math.gcd(columns, _WIDEST)
    return width, columns // width


def _data(context, builder, kind, row):
    """Address of the first number of an array, or of what `row` gave."""
    return (
        row
        if isinstance(kind, types.CPointer)
        else context.make_array(kind)(context, builder, row).data
    )


@intrinsic
def _row(typing, array, index, first):
    """Address of array[index, first]: a slice would count its owners, which costs more than the
    arithmetic.
    """

    def generate(context, builder, signature, arguments):
        kind = signature.args[0]
        given = context.make_array(kind)(context, builder, arguments[0])
        index, first = (
            context.cast(builder, arguments[i], signature.args[i], types.int64) for i in (1, 2)
        )
        width = builder.extract_value(given.shape, 1)
        return builder.gep(given.data, [builder.add(builder.mul(index, width), first)])

    return types.CPointer(types.float64)(array, index, first), generate


@intrinsic
def _part(typing, array, first):
    """Address of array[first] of an array of one dimension."""

    def generate(context, builder, signature, arguments):
        given = context.make_array(signature.args[0])(context, builder, arguments[0])
        return builder.gep(
            given.data, [context.cast(builder, arguments[1], signature.args[1], types.int64)]
        )

    return types.CPointer(types.float64)(array, first), generate


def _place(builder, data, index, width):
    return builder.bitcast(
        builder.gep(data, [index]), ir.VectorType(ir.DoubleType(), width).as_pointer()
    )


def _load(builder, data, index, width):
    return builder.load(
        _place(builder, data, index, width), align=8, typ=ir.VectorType(ir.DoubleType(), width)
    )


def _store(builder, value, data, index):
    builder.store(value, _place(builder, data, index, value.type.count), align=8)


def _spread(builder, number, width):
    nothing = ir.Constant(ir.VectorType(ir.DoubleType(), width), ir.Undefined)
    one = builder.insert_element(nothing, number, ir.Constant(ir.IntType(32), 0))
    mask = ir.Constant(ir.VectorType(ir.IntType(32), width), [0] * width)
    return builder.shuffle_vector(one, one, mask)


def _multiply_add(builder, a, b, c):
    return builder.fadd(builder.fmul(a, b, flags=("contract",)), c, flags=("contract",))


def _number(value):
    return ir.Constant(_INDEX, value)


def _loop(builder, low, high, totals, body):
    """totals = body(j, totals) for j from low to high - 1, the totals in registers."""
    before = builder.block
    head, inside, after = (builder.append_basic_block(name) for name in ("head", "inside", "after"))
    builder.branch(head)
    builder.position_at_end(head)
    j = builder.phi(_INDEX)
    held = [builder.phi(total.type) for total in totals]
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


def _operation(instruction, turned=False):
    """A method of `Vector` that does one instruction of LLVM, with the other number first if
    `turned`.
    """

    def apply(self, other):
        left, right = (
            (self._other(other), self.value) if turned else (self.value, self._other(other))
        )
        return Vector(self.builder, getattr(self.builder, instruction)(left, right))

    return apply


def _comparison(sign):
    """A method of `Vector` that compares; false where either is not a number."""

    def apply(self, other):
        return Vector(self.builder, self.builder.fcmp_ordered(sign, self.value, self._other(other)))

    return apply


class Vector:
    """One vector of columns inside a formula of `elementwise`, or the outcome of a comparison of
    two.
    """

    def __init__(self, builder, value):
        self.builder, self.value = builder, value

    def _other(self, other):
        if isinstance(other, Vector):
            return other.value
        width = self.value.type.count
        return ir.Constant(ir.VectorType(ir.DoubleType(), width), [float(other)] * width)

    def __neg__(self):
        return 0.0 - self

    __add__, __radd__ = _operation("fadd"), _operation("fadd", turned=True)
    __sub__, __rsub__ = _operation("fsub"), _operation("fsub", turned=True)
    __mul__, __rmul__ = _operation("fmul"), _operation("fmul", turned=True)
    __truediv__, __rtruediv__ = _operation("fdiv"), _operation("fdiv", turned=True)
    __lt__, __le__, __gt__, __ge__ = (
        _comparison("<"),
        _comparison("<="),
        _comparison(">"),
        _comparison(">="),
    )
    __and__, __or__ = _operation("and_"), _operation("or_")


def where(choice, yes, no):
    """`yes` where a comparison holds, `no` elsewhere; at least one of the two is a vector or a
    number.
    """
    return Vector(
        choice.builder, choice.builder.select(choice.value, choice._other(yes), choice._other(no))
    )


def larger(a, b):
    """The larger of two; the second where they cannot be compared."""
    return where(a > b, a, b)


def smaller(a, b):
    """The smaller of two; the second where they cannot be compared."""
    return where(a < b, a, b)


def _call(name, a):
    module, kind = a.builder.module, a.value.type
    full = f"{name}.v{kind.count}f64"
    function = module.globals.get(full) or ir.Function(module, ir.FunctionType(kind, [kind]), full)
    return Vector(a.builder, a.builder.call(function, [a.value]))


def root_of(a):
    """Square root."""
    return _call("llvm.sqrt", a)


def size_of(a):
    """Absolute value."""
    return _call("llvm.fabs", a)


def elementwise(columns, outputs, formula):
    """A function f(out_1 ... out_k, in_1 ... in_n) for compiled code that applies `formula` to
    `columns` columns.

    What goes in are arrays of one dimension, rows of arrays of two, as `row` gives them, or single
    numbers; what comes out may be one of the rows that went in.
    """

    width, count = _vectors(columns)

    @intrinsic
    def apply(typing, *arguments):
        packed = types.StarArgTuple.from_types(arguments)

        def generate(context, builder, signature, given):
            kinds = list(signature.args[0])
            parts = [builder.extract_value(given[0], i) for i in range(len(kinds))]
            rows = [
                _data(context, builder, kind, part)
                if isinstance(kind, types.Array | types.CPointer)
                else None
                for kind, part in zip(kinds, parts, strict=True)
            ]
            numbers = [
                None
                if row is not None
                else _spread(builder, context.cast(builder, part, kind, types.float64), width)
                for row, part, kind in zip(rows, parts, kinds, strict=True)
            ]
            for i in range(count):
                place = _number(i * width)
                inputs = [
                    Vector(
                        builder, _load(builder, row, place, width) if row is not None else number
                    )
                    for row, number in zip(rows[outputs:], numbers[outputs:], strict=True)
                ]
                results = formula(*inputs)
                for row, result in zip(
                    rows, results if isinstance(results, tuple) else (results,), strict=False
                ):
                    _store(builder, result.value, row, place)
            return context.get_dummy_value()

        return types.void(packed), generate

    return apply


def _zeros(count, width):
    return [ir.Constant(ir.VectorType(ir.DoubleType(), width), [0.0] * width)] * count


def _sum(builder, data, low, high, columns, term):
    """Store in data[m] the sum of term(j, i, total) over low <= j < high; i counts the vectors of
    `columns` columns.
    """
    width, count = _vectors(columns)

    def body(j, totals):
        return [term(j, _number(i * width), total) for i, total in enumerate(totals)]

    for i, total in enumerate(_loop(builder, low, high, _zeros(count, width), body)):
        _store(builder, total, data, _number(i * width))


@intrinsic
def _products(typing, a, b, k, low, high, out):
    """out[m] = sum of a[j, m] b[k-j, m], low <= j < high, over PAIR columns."""
    width, _ = _vectors(PAIR)

    def generate(context, builder, signature, arguments):
        kinds = signature.args
        data_a, data_b, data_out = (
            _data(context, builder, kinds[i], arguments[i]) for i in (0, 1, 5)
        )
        k, low, high = (
            context.cast(builder, arguments[i], kinds[i], types.int64) for i in (2, 3, 4)
        )

        def term(j, place, total):
            left = builder.add(builder.mul(j, _number(PAIR)), place)
            right = builder.add(builder.mul(builder.sub(k, j), _number(PAIR)), place)
            return _multiply_add(
                builder,
                _load(builder, data_a, left, width),
                _load(builder, data_b, right, width),
                total,
            )

        _sum(builder, data_out, low, high, PAIR, term)
        return context.get_dummy_value()

    return types.void(a, b, k, low, high, out), generate


@intrinsic
def _values_at(typing, series, order, x, out):
    """out[i] = sum of series[k] x[i]^k, k = 0 ... order, over WAVE points."""
    width, count = _vectors(WAVE)

    def generate(context, builder, signature, arguments):
        kinds = signature.args
        data, data_x, data_out = (
            _data(context, builder, kinds[i], arguments[i]) for i in (0, 2, 3)
        )
        order = context.cast(builder, arguments[1], kinds[1], types.int64)
        at = [_load(builder, data_x, _number(i * width), width) for i in range(count)]

        def body(j, totals):
            term = _spread(builder, builder.load(builder.gep(data, [builder.sub(order, j)])), width)
            return [
                _multiply_add(builder, total, z, term) for total, z in zip(totals, at, strict=True)
            ]

        high = builder.add(order, _number(1))
        for i, total in enumerate(_loop(builder, _number(0), high, _zeros(count, width), body)):
            _store(builder, total, data_out, _number(i * width))
        return context.get_dummy_value()

    return types.void(series, order, x, out), generate


@intrinsic
def _mix(typing, weights, rows, out):
    """out[m] = sum of weights[i] rows[i, m], 0 <= i < WAVE, over WAVE columns."""
    width, _ = _vectors(WAVE)

    def generate(context, builder, signature, arguments):
        data, data_rows, data_out = (
            _data(context, builder, signature.args[i], arguments[i]) for i in range(3)
        )

        def term(j, place, total):
            weight = _spread(builder, builder.load(builder.gep(data, [j])), width)
            other = _load(
                builder, data_rows, builder.add(builder.mul(j, _number(WAVE)), place), width
            )
            return _multiply_add(builder, weight, other, total)

        _sum(builder, data_out, _number(0), _number(WAVE), WAVE, term)
        return context.get_dummy_value()

    return types.void(weights, rows, out), generate


def _series_of(columns, derivatives):
    """The function that evaluates power series at t[m], over `columns` columns from `first`.

    at[m] = sum of x[k, m] t[m]^k, its derivative by t, half of the second one: as many rows as
    asked for.
    """
    width, count = _vectors(columns)

    @intrinsic
    def series_at(typing, *arguments):  # x, order, width, first, t, at, rate, ...
        packed = types.StarArgTuple.from_types(arguments)

        def generate(context, builder, signature, given):
            kinds = list(signature.args[0])
            parts = [builder.extract_value(given[0], i) for i in range(len(kinds))]
            data, t, *rows = (
                _data(context, builder, kinds[i], parts[i]) for i in (0, *range(4, len(kinds)))
            )
            order, wide, first = (
                context.cast(builder, parts[i], kinds[i], types.int64) for i in (1, 2, 3)
            )
            shares = [_load(builder, t, _number(i * width), width) for i in range(count)]

            def body(j, totals):
                row = builder.add(builder.mul(builder.sub(order, j), wide), first)
                results = []
                for d in range(derivatives + 1):
                    for i, z in enumerate(shares):
                        lower = (
                            _load(builder, data, builder.add(row, _number(i * width)), width)
                            if d == 0
                            else totals[(d - 1) * count + i]
                        )
                        results.append(_multiply_add(builder, totals[d * count + i], z, lower))
                return results

            high = builder.add(order, _number(1))
            totals = _loop(
                builder, _number(0), high, _zeros((derivatives + 1) * count, width), body
            )
            for k, total in enumerate(totals):
                place = builder.add(first, _number(k % count * width))
                _store(builder, total, rows[k // count], place)
            return context.get_dummy_value()

        return types.void(packed), generate

    return series_at


@intrinsic
def _apart(typing):
    """Keep the function that calls this out of its callers: a copy at every place of use costs
    seconds to compile.
    """

    def generate(context, builder, signature, arguments):
        builder.function.attributes.add("noinline")
        return context.get_dummy_value()

    return types.void(), generate


apart: Any = _apart
products: Any = _products
values_at: Any = _values_at
mix: Any = _mix
derivatives_at: Any = _series_of(LANES, 1)
curves_at: Any = _series_of(LANES, 2)
row: Any = _row
part: Any = _part
