"""Typed statements (`hydro_env.ir`) that work lane by lane as LLVM's vector instructions.

A sweep of a generated kernel is a function `name(cells, h)` of loops

    for l in range(LANES):
        a = cells[3 * LANES + l]
        cells[5 * LANES + l] = a if a > 0.0 else other(a)

As many lanes go to a vector as a register of the processor holds. Left to Numba the compiler would have to find out types,
variables and that the loop can be vectorised at all, and spend most of its time on that. What a statement computes is fixed by
its text: its products and sums are fused, a * b + c in one rounding, and nothing else is fused or reordered. What the compiler
fused by itself would depend on the effects compiled in and on the width of the block.

`found += test` in a loop counts the lanes that pass a test (before the loop `found = 0`, and `return found` at the end). An `if`
in a loop ends by storing to a cell: its statements run on all lanes of a vector if any lane passes, so what they store has to be
right for each. Functions that are called are written in their place; of their `if` both ways are computed. TypeError, naming
the function, for anything else.
"""

from collections.abc import Iterable

from llvmlite import ir

from hydro_env.ir.nodes import Assign, Expr, For, Function, If, Return, Statement, Store, var
from hydro_env.ir.reader import Arr, Reader, module_sources

#: Type of what a sweep returns: on how many lanes its test was passed.
FOUND = ir.IntType(32)

_COMPARISONS = {"lt": "<", "gt": ">", "le": "<=", "ge": ">=", "eq": "==", "ne": "!="}
_OPERATIONS = {
    "add": "fadd", "sub": "fsub", "mul": "fmul", "div": "fdiv", "and": "and_", "or": "or_", "not": "not_",
    "neg": "fneg", "where": "select",
}  # fmt: skip
_INSTRUCTIONS = {"abs": "llvm.fabs", "sqrt": "llvm.sqrt", "floor": "llvm.floor", "fma": "llvm.fma"}

Names = dict[str, ir.Value]


class _Emitter:
    """Emits the statements of one sweep; values are vectors of `width` lanes."""

    def __init__(
        self, builder: ir.IRBuilder, functions: dict[str, Function], cells: ir.Value, name: str, register: int
    ) -> None:
        self.builder, self.functions, self.name, self.register = builder, functions, name, register
        self.cells, self.kind = cells, cells.type.pointee
        self.bytes = 4 if isinstance(self.kind, ir.FloatType) else 8  # of a real number
        self.found = builder.alloca(FOUND)  # on how many lanes the test was passed
        builder.store(FOUND(0), self.found)

    # --- values -----------------------------------------------------------------------------------------------------
    def _fail(self, what: str) -> TypeError:
        return TypeError(f"{self.name}: {what} cannot run on many lanes at once")

    @property
    def _vector(self) -> ir.VectorType:
        return ir.VectorType(self.kind, self.width)

    @property
    def _suffix(self) -> str:
        return f"v{self.width}f{8 * self.bytes}"

    def _splat(self, scalar: ir.Value) -> ir.Value:
        """A scalar on all lanes."""
        vector = ir.Constant(self._vector, ir.Undefined)
        first = self.builder.insert_element(vector, scalar, ir.Constant(ir.IntType(32), 0))
        lanes = ir.Constant(ir.VectorType(ir.IntType(32), self.width), [0] * self.width)
        return self.builder.shuffle_vector(first, vector, lanes)

    def _address(self, index: Expr) -> ir.Value:
        """Address of the cells of all lanes at hand: all but the lane is known."""
        if index.op != "add" or index.args[0].known is None:
            raise self._fail("a cell whose lane is not `l`")
        place = self.builder.add(self.lane, ir.Constant(ir.IntType(64), index.args[0].known))
        return self.builder.bitcast(self.builder.gep(self.cells, [place]), ir.PointerType(self._vector))

    def value(self, x: Expr, names: Names) -> ir.Value:
        """The value of an expression."""
        emit = self.builder
        match x.op:
            case "const" if x.kind == "bool":
                return ir.Constant(ir.VectorType(ir.IntType(1), self.width), [int(x.value)] * self.width)
            case "const":
                return ir.Constant(self._vector, [float(x.value)] * self.width)
            case "var":
                found = names[x.value]
                return found if isinstance(found.type, ir.VectorType) else self._splat(found)
            case "load" if x.args[0].known is not None:
                pointer = emit.gep(self.cells, [ir.Constant(ir.IntType(64), x.args[0].known)])
                return self._splat(emit.load(pointer, align=self.bytes))
            case "load":
                return emit.load(self._address(x.args[0]), align=self.bytes)
            case "call":
                return self._call(self.functions[x.value], [self.value(each, names) for each in x.args])
        operands = [self.value(each, names) for each in x.args]
        if x.op in _OPERATIONS:
            return getattr(emit, _OPERATIONS[x.op])(*operands)
        if x.op in _COMPARISONS:
            return emit.fcmp_ordered(_COMPARISONS[x.op], *operands)
        if x.op in _INSTRUCTIONS:
            signature = ir.FunctionType(self._vector, [self._vector] * len(operands))
            return emit.call(self._declared(f"{_INSTRUCTIONS[x.op]}.{self._suffix}", signature), operands)
        raise self._fail(f"{x.op!r}")

    def _declared(self, name: str, signature: ir.FunctionType) -> ir.Function:
        module = self.builder.module
        return module.globals.get(name) or ir.Function(module, signature, name)

    # --- statements -------------------------------------------------------------------------------------------------
    def _call(self, function: Function, operands: list[ir.Value]) -> ir.Value:
        names = dict(zip((name for name, _, _ in function.parameters), operands, strict=True))
        outer, self.name = self.name, function.name
        result = self._block(function.body, names)
        if result is None:
            raise TypeError(f"{self.name} returns nothing")
        self.name = outer
        return result

    def _block(self, statements: list[Statement], names: Names) -> ir.Value | None:
        """Runs statements; the value of the `return` they end in, None if they do not."""
        for number, each in enumerate(statements):
            match each:
                case Assign(_, value) if value.kind == "int":
                    self._count(self.value(value.args[1].args[0], names))
                case Assign(name, value):
                    names[name] = self.value(value, names)
                case Store(_, index, value):
                    self._store(index, value, names)
                case Return(Expr() as value):
                    return self.value(value, names)
                case If(test, body, []) if isinstance(body[-1], Store):
                    self._where_any(self.value(test, names), body, dict(names))
                case If(test, body, orelse):
                    # Both ways are computed on every lane; what follows belongs to each of them.
                    rest = statements[number + 1 :]
                    chosen = self.value(test, names)
                    left = self._block([*body, *rest], dict(names))
                    right = self._block([*orelse, *rest], dict(names))
                    if left is None or right is None:
                        raise self._fail("an `if` without a `return`")
                    return self.builder.select(chosen, left, right)
                case _:
                    raise self._fail(type(each).__name__)
        return None

    def _store(self, index: Expr, value: Expr, names: Names) -> None:
        """Stores a value to the cells of all lanes; `value if test else what is there` to those that pass the test."""
        if not (value.op == "where" and value.args[2].op == "load" and _same(value.args[2].args[0], index)):
            self.builder.store(self.value(value, names), self._address(index), align=self.bytes)
            return
        test, new = (self.value(each, names) for each in value.args[:2])
        pointer = self._address(index)
        whole = ir.IntType(32)
        signature = ir.FunctionType(ir.VoidType(), [new.type, pointer.type, whole, test.type])
        function = self._declared(f"llvm.masked.store.{self._suffix}.p0{self._suffix}", signature)
        self.builder.call(function, [new, pointer, ir.Constant(whole, self.bytes), test])

    def _where_any(self, test: ir.Value, body: list[Statement], names: Names) -> None:
        """Statements that are left out where no lane of the vector passes a test; else they are run on all of them."""
        emit = self.builder
        bits = emit.bitcast(test, ir.IntType(self.width))
        with emit.if_then(emit.icmp_unsigned("!=", bits, ir.Constant(bits.type, 0)), likely=False):
            self._block(body, names)

    def _count(self, test: ir.Value) -> None:
        """Counts the lanes on which a test is passed."""
        emit = self.builder
        passed = emit.ctpop(emit.zext(emit.bitcast(test, ir.IntType(self.width)), FOUND))
        emit.store(emit.add(emit.load(self.found), passed), self.found)

    def _lanes(self, lanes: int, body: list[Statement], names: Names) -> None:
        """A loop over lanes, a vector at a time."""
        emit, index = self.builder, ir.IntType(64)
        self.width = next(w for w in (16, 8, 4, 2, 1) if w * self.bytes <= self.register and lanes % w == 0)
        before, loop = emit.block, emit.append_basic_block("lanes")
        emit.branch(loop)
        emit.position_at_end(loop)
        self.lane = emit.phi(index)  # the first lane of the vector at hand
        self._block(body, dict(names))
        onward = emit.add(self.lane, ir.Constant(index, self.width))
        self.lane.add_incoming(ir.Constant(index, 0), before)
        self.lane.add_incoming(onward, emit.block)
        after = emit.append_basic_block("done")
        emit.cbranch(emit.icmp_signed("<", onward, ir.Constant(index, lanes)), loop, after)
        emit.position_at_end(after)

    def sweep(self, statements: Iterable[Statement], names: Names) -> None:
        """The statements of the sweep itself: loops over lanes, and the count that it returns."""
        for each in statements:
            match each:
                case For(_, _, stop, _, body) if stop.known is not None:
                    self._lanes(stop.known, body, names)
                case Assign(_, value) if value.known == 0:
                    pass
                case Return(Expr(op="var")):
                    pass
                case _:
                    raise self._fail(type(each).__name__)
        self.builder.ret(self.builder.load(self.found))


def _same(a: Expr, b: Expr) -> bool:
    """Whether two expressions are the same."""
    return (a.op, a.value) == (b.op, b.value) and all(map(_same, a.args, b.args))


def llvm_text(text: str, single: bool, register: int) -> str:
    """A module of LLVM with the sweeps of a Python text, each as `int32 name(real *cells, real h)`.

    A sweep is a function `name(cells, h)`; other functions are those it calls, assignments name whole numbers. `single`: cells
    of float32, else of float64. `register`: bytes of a vector register.
    """
    kind = ir.FloatType() if single else ir.DoubleType()
    module, reader = ir.Module("sweeps"), Reader(fuses=True)
    for name, source in module_sources(text).items():
        if [a.arg for a in source.node.args.args] == ["cells", "h"]:
            reader.call(source, [Arr.of("double", "cells", (0,)), var("h", "double")])
            functions = {each.name: each for each in reader.functions.values()}
            sweep = ir.Function(module, ir.FunctionType(FOUND, [kind.as_pointer(), kind]), name)
            cells, h = sweep.args
            builder = ir.IRBuilder(sweep.append_basic_block("entry"))
            _Emitter(builder, functions, cells, name, register).sweep(functions[name].body, {"h": h})
    return str(module)
