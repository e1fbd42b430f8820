"""How near the kernel is to what the processor can do.

Once more in C++: how much speed does the Python tool chain cost?

The statements of the generated substep (see `hydro_env.plant.kernel.codegen`) are translated one by one to C++ and compiled by
the machine's own compiler with vector instructions for this processor. Both run the same block from the same state, so
both the time and the result can be compared: the states must agree to the last bits.

Arithmetic: the operations of a substep are counted in the same statements and set against what a loop of nothing but
multiplications and additions reaches on the same thread. That tells a slow processor from a slow kernel.
"""

from __future__ import annotations

import ast
import ctypes
import shutil
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from hydro_env.plant.kernel import STATES
from hydro_env.plant.model import SUBSTEP
from hydro_env.plant.plant import Plant

__all__ = ["measure_ratio", "to_cpp"]

FLAGS = (
    "-O3", "-march=native", "-mprefer-vector-width=512", "-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math",
    "-fopenmp-simd", "-shared", "-fPIC",
)  # fmt: skip
_OPERATORS = {
    ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Lt: "<", ast.Gt: ">", ast.LtE: "<=", ast.GtE: ">=",
    ast.Eq: "==", ast.And: "&&", ast.Or: "||", ast.BitAnd: "&&", ast.BitOr: "||",
}  # fmt: skip
_FUNCTIONS = {"abs": "std::fabs", "sqrt": "std::sqrt", "floor": "std::floor", "fma": "std::fma"}


def _expression(node: ast.expr) -> str:
    match node:
        case ast.Constant(value):
            return repr(float(value)) if isinstance(value, float) else repr(value)
        case ast.Name(name):
            return name
        case ast.BinOp(left, operator, right):
            return f"({_expression(left)} {_OPERATORS[type(operator)]} {_expression(right)})"
        case ast.UnaryOp(_, operand):
            return f"(-{_expression(operand)})"
        case ast.BoolOp(operator, values):
            return "(" + f" {_OPERATORS[type(operator)]} ".join(map(_expression, values)) + ")"
        case ast.Compare(left, [operator], [right]):
            return f"({_expression(left)} {_OPERATORS[type(operator)]} {_expression(right)})"
        case ast.IfExp(test, body, orelse):
            return f"({_expression(test)} ? {_expression(body)} : {_expression(orelse)})"
        case ast.Call(ast.Name("real"), [value]):
            return _expression(value)
        case ast.Call(ast.Name(name), arguments):
            # A name of their own: C++ has an exp and a sign already.
            return f"{_FUNCTIONS.get(name, 'lane_' + name)}({', '.join(map(_expression, arguments))})"
        case ast.Subscript(ast.Name(name), index):
            return f"{name}[{_expression(index)}]"
    raise NotImplementedError(ast.unparse(node))


def _statements(body: list[ast.stmt], known: set[str]) -> list[str]:
    lines = []
    for node in body:
        match node:
            case ast.Expr():  # a docstring
                continue
            case ast.Assign([ast.Name(name)], ast.Constant(bool() as value)):
                lines.append(f"int {name} = {int(value)};")
                known.add(name)
            case ast.Assign([ast.Name(name)], value):
                lines.append(f"{'' if name in known else 'double '}{name} = {_expression(value)};")
                known.add(name)
            case ast.Assign([target], value):
                lines.append(f"{_expression(target)} = {_expression(value)};")
            case ast.AugAssign(ast.Name(name), _, value):
                lines.append(f"{name} = {name} || {_expression(value)};")
            case ast.Return(ast.Name("more")):
                continue
            case ast.Return(ast.expr() as value):
                lines.append(f"return {_expression(value)};")
            case ast.If(test, inner, []):  # what a vector may leave out where no lane passes
                lines += [f"if ({_expression(test)}) {{", *_statements(inner, set(known)), "}"]
            case ast.For(ast.Name(name), ast.Call(_, [bound]), inner):
                marked = [n.target for n in inner if isinstance(n, ast.AugAssign)]
                reduced = "".join(f" reduction(||:{ast.unparse(target)})" for target in marked)
                lines.append(f"#pragma omp simd{reduced}")
                lines.append(f"for (int {name} = 0; {name} < {_expression(bound)}; {name}++) {{")
                lines += [*_statements(inner, set(known)), "}"]
            case _:
                raise NotImplementedError(ast.unparse(node))
    return lines


def to_cpp(source: str) -> str:
    """The whole substep of a generated kernel as C++: `run(cells, steps, h)`, `h` as in the step before. NotImplementedError
    for what it cannot say.
    """
    functions = {node.name: node for node in ast.parse(source).body if isinstance(node, ast.FunctionDef)}
    half, todo = (int(source.split(f"\n{name} = ")[1].split("\n")[0]) for name in ("HALF", "TODO"))
    wanted: list[str] = []

    def need(name: str) -> None:
        for call in ast.walk(functions[name]):
            if isinstance(call, ast.Call) and isinstance(call.func, ast.Name):
                called = call.func.id
                if called in functions and called not in _FUNCTIONS and called not in wanted:
                    need(called)
        wanted.append(name)

    entries = ("begin", "finish")
    for name in entries:
        need(name)
    text = ["#include <cmath>", f"static const int HALF = {half}, LANES = {2 * half};"]
    for name in wanted:
        node = functions[name]
        arguments = [a.arg for a in node.args.args]
        head = f"static void {name}(double *__restrict cells, double h)" if name in entries else (
            f"static inline double lane_{name}({', '.join('double ' + a for a in arguments)})"
        )  # fmt: skip
        text += [head + " {", *_statements(node.body, set(arguments)), "}"]
    text.append(
        'extern "C" void run(double *cells, long steps, double h) {'
        f" for (int l = 0; l < LANES; l++) cells[{todo} * LANES + l] = steps;"
        " for (long n = 0; n < steps; n++) { begin(cells, h); finish(cells, h); } }"
    )
    return "\n".join(text) + "\n"


#: Nothing but fused multiplications and additions, on more registers than one of them takes cycles.
_PEAK = """
typedef double lanes __attribute__((vector_size(64)));
extern "C" double peak(long turns, double a, double b) {
    lanes x[12], scale, shift;
    for (int l = 0; l < 8; l++) {
        scale[l] = a;
        shift[l] = b;
        for (int n = 0; n < 12; n++) x[n][l] = n + l;
    }
    for (long t = 0; t < turns; t++)
        for (int n = 0; n < 12; n++) for (int l = 0; l < 8; l++) x[n][l] = __builtin_fma(x[n][l], scale[l], shift[l]);
    double sum = 0.0;
    for (int n = 0; n < 12; n++)
        for (int l = 0; l < 8; l++) sum += x[n][l];
    return sum;
}
"""


def operations(source: str) -> int:
    """Additions, multiplications, divisions and roots of a generated substep, a channel; one fused operation counts two."""
    functions = {node.name: node for node in ast.parse(source).body if isinstance(node, ast.FunctionDef)}

    def count(node: ast.AST) -> int:
        total = 0
        for part in ast.walk(node):
            if isinstance(part, ast.BinOp) and isinstance(part.op, ast.Add | ast.Sub | ast.Mult | ast.Div):
                total += 1
            elif isinstance(part, ast.Call) and isinstance(part.func, ast.Name):
                name = part.func.id
                total += {"fma": 2, "sqrt": 1}.get(name, 0)
                total += count(functions[name]) if name in functions and name not in _FUNCTIONS else 0
        # What only says where something lies is no arithmetic.
        places = (part.slice for part in ast.walk(node) if isinstance(part, ast.Subscript))
        return total - sum(isinstance(each, ast.BinOp) for place in places for each in ast.walk(place))

    return count(functions["begin"]) + count(functions["finish"])


def _compiled(compiler: str, folder: Path, source: str) -> tuple[Any, Any]:
    """The C++ twin `run(cells, steps, h)` of a generated kernel and `peak(turns, a, b)`, compiled in `folder`."""
    code, library = folder / "step.cpp", folder / "step.so"
    code.write_text(to_cpp(source) + _PEAK)
    subprocess.run([compiler, *FLAGS, str(code), "-o", str(library)], check=True, capture_output=True)
    run, peak = ctypes.CDLL(str(library)).run, ctypes.CDLL(str(library)).peak
    run.argtypes = (ctypes.c_void_p, ctypes.c_long, ctypes.c_double)
    peak.argtypes, peak.restype = (ctypes.c_long, ctypes.c_double, ctypes.c_double), ctypes.c_double
    return run, peak


def measure_ratio(seconds: float = 1.0) -> dict[str, Any] | None:
    """Time of a channel substep of our kernel and of its C++ twin, ns, and their ratio; None without a C++ compiler.

    Also the thread's peak of float64 arithmetic in GFLOP/s, and the kernel's share of it.
    """
    compiler = next((found for name in ("c++", "g++", "clang++") if (found := shutil.which(name))), None)
    if compiler is None:
        return None
    plant = Plant("paper_dead_zone", 16)
    plant.run(np.full((30, 2), 40.0), None, 0.01)
    kernel, command, load = plant.kernel, np.full((1, 1, 2), 42.0), np.zeros((1, 1, 2))
    memory = start = plant.memory.copy()
    room = np.zeros(kernel.num_cells + 8)
    cells = room[-room.ctypes.data % 64 // 8 :][: kernel.num_cells]
    twin_room = room.copy()
    twin_cells = twin_room[-twin_room.ctypes.data % 64 // 8 :][: kernel.num_cells]
    nothing, out = np.zeros(0, np.int64), np.zeros((0, 1, 16, 2))

    def ours(steps: int) -> None:
        kernel.advance(
            memory.reshape(-1), cells, None, 0, command, load, steps, SUBSTEP, SUBSTEP, nothing, 1, out
        )

    with tempfile.TemporaryDirectory() as folder:
        run, peak = _compiled(compiler, Path(folder), kernel.source)

        def theirs(steps: int) -> None:
            run(twin_cells.ctypes.data, steps, SUBSTEP)

        best: dict[str, float] = {}
        end = time.perf_counter() + seconds
        while time.perf_counter() < end or not best:
            memory = start.copy()
            ours(1)  # leaves in the cells all that the parameters settle
            twin_cells[:] = cells
            for name, function in (("kernel", ours), ("cpp", theirs)):
                function(10)
                begin = time.perf_counter()
                function(400)
                passed = (time.perf_counter() - begin) / (400 * 32) * 1e9
                best[name] = min(best.get(name, np.inf), passed)
            begin = time.perf_counter()
            peak(100_000, 0.999, 0.5)
            passed = (time.perf_counter() - begin) / (100_000 * 12 * 8 * 2) * 1e9
            best["flop"] = min(best.get("flop", np.inf), passed)
    moved = slice(0, len(STATES) * 32)
    last = {"kernel": cells[moved], "cpp": twin_cells[moved]}
    scale = np.abs(last["cpp"]).reshape(len(STATES), -1).max(1).repeat(32) + 1e-300
    return {
        "kernel_ns": best["kernel"],
        "cpp_ns": best["cpp"],
        "ratio": best["cpp"] / best["kernel"],
        "operations": operations(kernel.source),
        "peak_gflops": 1.0 / best["flop"],
        "share_of_peak": operations(kernel.source) * best["flop"] / best["kernel"],
        "largest_relative_difference": float((np.abs(last["kernel"] - last["cpp"]) / scale).max()),
    }
