"""Vector instructions for plain Python statements that work lane by lane.

A sweep of a generated kernel is a function `name(cells, h)` of statements on scalars and of loops

    for l in range(LANES):
        a = cells[3 * LANES + l]
        cells[5 * LANES + l] = a if a > 0.0 else other(a)

It is translated here straight to LLVM's vector instructions, as many lanes to a vector as the widest registers hold. Left to
Numba the compiler would have to find out types, variables and that the loop can be vectorised at all, and spend most of its
time on that. What a statement computes is fixed by its text: nothing is fused or reordered.

Statements: assignments to variables and cells; `found += test` in a loop to count the lanes that pass a test (before the
loop `found = 0`, and `return found` at the end); in a loop also `if` before statements that end by storing to a cell: they
run on all lanes of a vector if any lane passes, so what they store has to be right for each; and in the functions called also
`if` and `return`. Expressions: + - * /, whole powers, comparisons, and/or/&/|/not, conditional expressions, abs, sqrt, floor,
fma, and other functions of the same module. TypeError, naming the function, for anything else.
"""

from __future__ import annotations

import ast
from collections.abc import Collection, Mapping
from typing import Any

from llvmlite import ir

__all__ = ["FOUND", "check", "llvm_text"]

#: Type of what a sweep returns: 1 if any lane passes its test, else 0.
FOUND = ir.IntType(32)

#: Bytes of the widest vector register that is made use of; narrower machines take several.
_WIDEST = 64
_COMPARISONS = {ast.Lt: "<", ast.Gt: ">", ast.LtE: "<=", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!="}
_ARITHMETIC = {ast.Add: "fadd", ast.Sub: "fsub", ast.Mult: "fmul", ast.Div: "fdiv"}
_LOGIC = {ast.BitAnd: "and_", ast.BitOr: "or_", ast.And: "and_", ast.Or: "or_"}
_INSTRUCTIONS = {"abs": "llvm.fabs", "sqrt": "llvm.sqrt", "floor": "llvm.floor", "fma": "llvm.fma"}

Functions = Mapping[str, ast.FunctionDef]


class _Emitter:
    """Emits the statements of one function; values are vectors of `width` lanes."""

    def __init__(
        self,
        builder: ir.IRBuilder,
        constants: Mapping[str, Any],
        functions: Functions,
        cells: ir.Value,
        kind: ir.Type,
        name: str,
    ) -> None:
        self.builder, self.constants, self.functions, self.name = builder, dict(constants), functions, name
        self.cells, self.kind = cells, kind
        self.lane: ir.Value | None = None  # index of the first lane of the vector at hand
        self.width = 1

    # --- values -----------------------------------------------------------------------------------------------------
    def _fail(self, node: ast.AST) -> TypeError:
        return TypeError(
            f"{self.name}: {ast.unparse(node)!r} cannot run on many lanes at once; use +, -, *, /, comparisons, "
            "conditional expressions, if, return, and the functions of hydro_env.plant.vector_math"
        )

    @property
    def _vector(self) -> ir.VectorType:
        return ir.VectorType(self.kind, self.width)

    def _constant(self, value: float) -> ir.Value:
        return ir.Constant(self._vector, [float(value)] * self.width)

    def _splat(self, scalar: ir.Value) -> ir.Value:
        """A scalar on all lanes."""
        vector = ir.Constant(self._vector, ir.Undefined)
        first = self.builder.insert_element(vector, scalar, ir.Constant(ir.IntType(32), 0))
        return self.builder.shuffle_vector(
            first, vector, ir.Constant(ir.VectorType(ir.IntType(32), self.width), [0] * self.width)
        )

    def _address(self, node: ast.Subscript) -> ir.Value:
        """Address of cells[... + l]: all but the lane is known now."""
        if not (isinstance(node.value, ast.Name) and node.value.id == "cells" and self.lane is not None):
            raise self._fail(node)
        offset = eval(compile(ast.Expression(node.slice), "<index>", "eval"), self.constants, {"l": 0})
        index = self.builder.add(self.lane, ir.Constant(ir.IntType(64), int(offset)))
        pointer = self.builder.gep(self.cells, [index])
        return self.builder.bitcast(pointer, ir.PointerType(self._vector))

    @property
    def _align(self) -> int:
        return 4 if isinstance(self.kind, ir.FloatType) else 8

    def value(self, node: ast.expr, names: dict[str, ir.Value]) -> ir.Value:
        """The value of an expression."""
        emit = self.builder
        match node:
            case ast.Constant(bool() as truth):
                return ir.Constant(ir.VectorType(ir.IntType(1), self.width), [int(truth)] * self.width)
            case ast.Constant(int() | float() as number):
                return self._constant(number)
            case ast.Name(name) if name in names:
                found = names[name]
                return found if isinstance(found.type, ir.VectorType) else self._splat(found)
            case ast.Subscript(_, index) if not any(
                n.id == "l" for n in ast.walk(index) if isinstance(n, ast.Name)
            ):
                offset = eval(compile(ast.Expression(index), "<index>", "eval"), self.constants)
                pointer = emit.gep(self.cells, [ir.Constant(ir.IntType(64), int(offset))])
                return self._splat(emit.load(pointer, align=self._align))
            case ast.Subscript():
                return emit.load(self._address(node), align=self._align)
            case ast.BinOp(left, ast.Pow(), ast.Constant(int() as power)) if 1 <= power <= 8:
                factor = result = self.value(left, names)
                for _ in range(power - 1):
                    result = emit.fmul(result, factor)
                return result
            case ast.BinOp(left, operator, right) if type(operator) in _ARITHMETIC | _LOGIC:
                operation = getattr(emit, (_ARITHMETIC | _LOGIC)[type(operator)])
                return operation(self.value(left, names), self.value(right, names))
            case ast.BoolOp(operator, parts):
                result = self.value(parts[0], names)
                for part in parts[1:]:
                    result = getattr(emit, _LOGIC[type(operator)])(result, self.value(part, names))
                return result
            case ast.UnaryOp(ast.USub(), ast.Constant(int() | float() as number)):
                return self._constant(-number)
            case ast.UnaryOp(ast.USub(), operand):
                return emit.fneg(self.value(operand, names))
            case ast.UnaryOp(ast.Not(), operand):
                return emit.not_(self.value(operand, names))
            case ast.Compare(left, operators, others) if all(type(o) in _COMPARISONS for o in operators):
                result, first = None, self.value(left, names)
                for comparison, other in zip(operators, others, strict=True):
                    second = self.value(other, names)
                    test = emit.fcmp_ordered(_COMPARISONS[type(comparison)], first, second)
                    result = test if result is None else emit.and_(result, test)
                    first = second
                return result
            case ast.IfExp(test, body, orelse):
                return emit.select(
                    self.value(test, names), self.value(body, names), self.value(orelse, names)
                )
            case ast.Call(ast.Name(called), arguments, []) if called in _INSTRUCTIONS:
                return self._instruction(_INSTRUCTIONS[called], [self.value(a, names) for a in arguments])
            case ast.Call(ast.Name(called), arguments, []) if called in self.functions:
                return self._call(self.functions[called], [self.value(a, names) for a in arguments])
        raise self._fail(node)

    def _instruction(self, name: str, operands: list[ir.Value]) -> ir.Value:
        kind = f"v{self.width}f{32 if isinstance(self.kind, ir.FloatType) else 64}"
        signature = ir.FunctionType(self._vector, [self._vector] * len(operands))
        module = self.builder.module
        function = module.globals.get(f"{name}.{kind}") or ir.Function(module, signature, f"{name}.{kind}")
        return self.builder.call(function, operands)

    def _store_where(self, test: ir.Value, value: ir.Value, pointer: ir.Value) -> None:
        """Stores the lanes that pass a test."""
        whole, kind = ir.IntType(32), f"v{self.width}f{32 if isinstance(self.kind, ir.FloatType) else 64}"
        name, signature = f"llvm.masked.store.{kind}.p0{kind}", [value.type, pointer.type, whole, test.type]
        module = self.builder.module
        function = module.globals.get(name) or ir.Function(
            module, ir.FunctionType(ir.VoidType(), signature), name
        )
        self.builder.call(function, [value, pointer, ir.Constant(whole, self._align), test])

    # --- statements -------------------------------------------------------------------------------------------------
    def _call(self, function: ast.FunctionDef, operands: list[ir.Value]) -> ir.Value:
        names = dict(zip((a.arg for a in function.args.args), operands, strict=True))
        outer, self.name = self.name, function.name
        result = self._block(function.body, names)
        if result is None:
            raise TypeError(f"{self.name} returns nothing")
        self.name = outer
        return result

    def _block(self, statements: list[ast.stmt], names: dict[str, ir.Value]) -> ir.Value | None:
        """Runs statements; the value of the `return` they end in, None if they do not."""
        for number, node in enumerate(statements):
            match node:
                case ast.Expr(ast.Constant()) | ast.Pass():
                    pass
                case ast.Assign([ast.Name(name)], value):
                    names[name] = self.value(value, names)
                case ast.Assign([ast.Subscript() as target], ast.IfExp(test, value, kept)) if ast.unparse(
                    kept
                ) == ast.unparse(target):
                    self._store_where(
                        self.value(test, names), self.value(value, names), self._address(target)
                    )
                case ast.Assign([ast.Subscript() as target], value):
                    self.builder.store(self.value(value, names), self._address(target), align=self._align)
                case ast.AugAssign(ast.Name(name), ast.Add(), value) if self.lane is not None:
                    names[name] = self.builder.add(names[name], self._count(self.value(value, names)))
                case ast.Return(ast.expr() as value):
                    return self.value(value, names)
                case ast.If(test, [*_, ast.Assign([ast.Subscript()])] as body, []) if self.lane is not None:
                    self._where_any(self.value(test, names), body, dict(names))
                case ast.If(test, body, orelse):
                    # Both ways are computed on every lane; what follows belongs to each of them.
                    rest = statements[number + 1 :]
                    chosen = self.value(test, names)
                    left, right = (
                        self._block([*body, *rest], dict(names)),
                        self._block([*orelse, *rest], dict(names)),
                    )
                    if left is None or right is None:
                        raise self._fail(node)
                    return self.builder.select(chosen, left, right)
                case ast.For(ast.Name("l"), ast.Call(ast.Name("range"), [bound]), body, []):
                    self._lanes(bound, body, names)
                case _:
                    raise self._fail(node)
        return None

    def _where_any(self, test: ir.Value, body: list[ast.stmt], names: dict[str, ir.Value]) -> None:
        """Statements that are left out where no lane of the vector passes a test; else they are run on all of them."""
        emit = self.builder
        bits = emit.bitcast(test, ir.IntType(self.width))
        with emit.if_then(emit.icmp_unsigned("!=", bits, ir.Constant(bits.type, 0)), likely=False):
            self._block(body, names)

    def _count(self, test: ir.Value) -> ir.Value:
        """On how many lanes a test is passed."""
        bits = self.builder.zext(self.builder.bitcast(test, ir.IntType(self.width)), FOUND)
        return self.builder.ctpop(bits)

    def _lanes(self, bound: ast.expr, body: list[ast.stmt], names: dict[str, ir.Value]) -> None:
        """A loop over lanes, a vector at a time."""
        lanes = eval(compile(ast.Expression(bound), "<lanes>", "eval"), self.constants)
        widest = _WIDEST // (4 if isinstance(self.kind, ir.FloatType) else 8)
        width = next(w for w in (32, 16, 8, 4, 2, 1) if w <= widest and lanes % w == 0)
        index = ir.IntType(64)
        before, loop = self.builder.block, self.builder.append_basic_block("lanes")
        after = self.builder.append_basic_block("done")
        self.builder.branch(loop)
        self.builder.position_at_end(loop)
        self.lane = self.builder.phi(index)
        self.width = width
        inner = dict(names)
        found = {node.target.id for node in body if isinstance(node, ast.AugAssign)}  # type: ignore[union-attr]
        marks = {name: self.builder.phi(FOUND) for name in found}
        inner.update(marks)
        self._block(body, inner)
        for name, mark in marks.items():
            mark.add_incoming(FOUND(0), before)
            mark.add_incoming(inner[name], self.builder.block)
        onward = self.builder.add(self.lane, ir.Constant(index, width))
        self.lane.add_incoming(ir.Constant(index, 0), before)
        self.lane.add_incoming(onward, self.builder.block)
        self.builder.cbranch(self.builder.icmp_signed("<", onward, ir.Constant(index, lanes)), loop, after)
        self.builder.position_at_end(after)
        names.update({name: inner[name] for name in found})
        self.lane, self.width = None, 1

    def scalars(self, statements: list[ast.stmt], names: dict[str, ir.Value]) -> ir.Value | None:
        """The statements of the function itself: scalars, one lane wide, and loops over lanes. What it returns."""
        for node in statements:
            if isinstance(node, ast.Return) and isinstance(node.value, ast.Name):
                return names[node.value.id]
            self._block([node], names)
            for name, value in names.items():
                if isinstance(value.type, ir.VectorType):
                    names[name] = self.builder.extract_element(value, ir.Constant(ir.IntType(32), 0))
        return None


#: What a function called from a loop over lanes may consist of.
_ALLOWED = (
    ast.FunctionDef, ast.arguments, ast.arg, ast.Expr, ast.Pass, ast.Assign, ast.Return, ast.If, ast.Name, ast.Constant,
    ast.BinOp, ast.UnaryOp, ast.BoolOp, ast.Compare, ast.IfExp, ast.Call, ast.expr_context, ast.USub, ast.Not, ast.Pow,
    *_ARITHMETIC, *_LOGIC, *_COMPARISONS,
)  # fmt: skip


class LawError(ValueError):
    """What a law may not do, and in which line of its source."""

    def __init__(self, message: str, node: ast.AST) -> None:
        super().__init__(message)
        self.line: int = getattr(node, "lineno", 1)


def check(function: ast.FunctionDef, known: Collection[str]) -> None:
    """LawError, in one line, if a function cannot run on many lanes at once; `known` are the functions it may call."""
    hint = "a law may use + - * / and whole powers, comparisons, conditional expressions, if and return, and "
    hint += ", ".join(sorted({*known, *_INSTRUCTIONS} - {"fma"}))
    body = [node for statement in function.body for node in ast.walk(statement)]
    for node in body:
        parts = [node.op] if isinstance(node, ast.BinOp) else [node]
        if not all(isinstance(part, _ALLOWED) for part in parts):
            raise LawError(f"{function.name}: {ast.unparse(node).splitlines()[0]!r}: {hint}", node)
        if isinstance(node, ast.Call) and ast.unparse(node.func) not in {*known, *_INSTRUCTIONS}:
            raise LawError(f"{function.name}: {ast.unparse(node.func)!r} cannot be called: {hint}", node)
    assigned = {a.arg for a in function.args.args}
    assigned |= {n.id for n in body if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)}
    called = {ast.unparse(n.func) for n in body if isinstance(n, ast.Call)}
    for node in body:
        if isinstance(node, ast.Name) and node.id not in called | assigned:
            raise LawError(f"{function.name}: {node.id!r} is not an argument of the law", node)


def llvm_text(text: str, single: bool) -> str:
    """A module of LLVM with the sweeps of a Python text, each as `int32 name(real *cells, real h)`.

    A sweep is a function `name(cells, h)`; other functions are those it calls, assignments name whole numbers. `single`: cells
    of float32, else of float64.
    """
    tree = ast.parse(text)
    functions = {node.name: node for node in tree.body if isinstance(node, ast.FunctionDef)}
    constants: dict[str, Any] = {}
    for node in tree.body:
        if isinstance(node, ast.Assign):
            exec(compile(ast.Module([node], []), "<constants>", "exec"), constants)
    kind = ir.FloatType() if single else ir.DoubleType()
    module = ir.Module("sweeps")
    for node in functions.values():
        if [a.arg for a in node.args.args] == ["cells", "h"]:
            sweep = ir.Function(module, ir.FunctionType(FOUND, [kind.as_pointer(), kind]), node.name)
            cells, h = sweep.args
            emitter = _Emitter(
                ir.IRBuilder(sweep.append_basic_block("entry")), constants, functions, cells, kind, node.name
            )
            found = emitter.scalars(node.body, {"h": h})
            emitter.builder.ret(FOUND(0) if found is None else found)
    return str(module)
