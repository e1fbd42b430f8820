"""Laws of effects as text of a generated module: their source is read, checked, and pasted with the functions that they call."""

import ast
import inspect
import textwrap
from collections.abc import Callable, Collection, Mapping
from copy import deepcopy
from functools import lru_cache
from typing import Any

from ...errors import InputError
from .. import vector_math
from ..catalogue.effect import called_by, helpers_of

Function = Callable[..., Any]

#: Functions of laws that are instructions of the processor.
INSTRUCTIONS = ("abs", "floor", "sqrt")
#: What a law may consist of.
_ALLOWED = (
    ast.FunctionDef, ast.arguments, ast.arg, ast.Expr, ast.Pass, ast.Assign, ast.Return, ast.If, ast.Name, ast.Constant,
    ast.BinOp, ast.UnaryOp, ast.BoolOp, ast.Compare, ast.IfExp, ast.Call, ast.expr_context, ast.USub, ast.Not, ast.Pow,
    ast.Add, ast.Sub, ast.Mult, ast.Div, ast.BitAnd, ast.BitOr, ast.And, ast.Or, ast.Lt, ast.Gt, ast.LtE, ast.GtE, ast.Eq,
    ast.NotEq,
)  # fmt: skip


@lru_cache(maxsize=1024)
def parse(function: Function) -> ast.FunctionDef:
    """The syntax tree of a plain function, with the lines of its file. ValueError if its source cannot be read."""
    law = f"law {function.__name__!r}"
    try:
        source = textwrap.dedent(inspect.getsource(function))
    except OSError:
        raise ValueError(f"the source of {law} cannot be read; define it in a file") from None
    if not source.startswith("def "):
        raise ValueError(f"{law} must be a plain function (def), not a lambda or decorated")
    written = compile(source, "<law>", "exec", dont_inherit=True).co_consts[0]
    if (written.co_code, written.co_names) != (function.__code__.co_code, function.__code__.co_names):
        # The text would be kept on disk under the identity of the law that is loaded.
        raise ValueError(f"the file of {law} was changed since it was loaded; start Python again")
    node = ast.parse(source).body[0]
    assert isinstance(node, ast.FunctionDef)
    return ast.increment_lineno(node, function.__code__.co_firstlineno - 1)


# --- checks -----------------------------------------------------------------------------------------------------------
def check_law(law: Function, where: str = "") -> None:
    """InputError, with the line of its file and `where`, if a law, or a function that it calls, cannot run on many lanes."""
    functions: list[Function] = [law, *called_by(law)]
    for function in functions:
        if function in called_by(function):
            line = function.__code__.co_firstlineno
            raise InputError(f"line {line}: {where}{function.__name__}: calls itself")
        check(parse(function), {*vector_math.__all__, *helpers_of(function)}, where)


def check(function: ast.FunctionDef, known: Collection[str], where: str = "") -> None:
    """InputError, as `check_law`, if a function cannot run on many lanes at once; `known` are the functions it may call."""
    known = {*known, *INSTRUCTIONS}
    hint = (
        "a law may use + - * / and whole powers, comparisons, conditional expressions, if and return, functions of its own file,"
        f" and {', '.join(sorted(known))}"
    )
    body = [node for statement in function.body for node in ast.walk(statement)]
    for node in body:
        parts = [node.op] if isinstance(node, ast.BinOp) else [node]
        if not all(isinstance(part, _ALLOWED) for part in parts):
            text = ast.unparse(node).splitlines()[0]
            line = getattr(node, "lineno", function.lineno)
            raise InputError(f"line {line}: {where}{function.name}: {text!r}: {hint}")
        if isinstance(node, ast.Call) and ast.unparse(node.func) not in known:
            text = ast.unparse(node.func)
            raise InputError(f"line {node.lineno}: {where}{function.name}: {text!r} cannot be called: {hint}")
    assigned = {a.arg for a in function.args.args}
    assigned |= {n.id for n in body if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)}
    called = {ast.unparse(n.func) for n in body if isinstance(n, ast.Call)}
    for node in body:
        if isinstance(node, ast.Name) and node.id not in called | assigned:
            told = f"{function.name}: {node.id!r} is not an argument of the law"
            raise InputError(f"line {node.lineno}: {where}{told}")


# --- text -------------------------------------------------------------------------------------------------------------
def texts(functions: Mapping[str, Function]) -> list[str]:
    """The text of functions under these names, and of all that they call. ValueError if one cannot run on many lanes at once."""
    found: dict[str, str] = {}
    for name, function in functions.items():
        check_law(function)
        named = {each: _name(each) for each in called_by(function)} | {function: name}
        for each, own in named.items():
            text = _text(each, own)
            if found.setdefault(own, text) != text:
                raise ValueError(
                    f"two functions that laws call are named {own!r}; give one of them another name"
                )
    return list(found.values())


def _name(helper: Function) -> str:
    """What a function that laws call is called in the text."""
    if helper.__module__ == vector_math.__name__:
        return helper.__name__
    return f"{helper.__module__.rpartition('.')[2]}__{helper.__name__.strip('_')}"


@lru_cache(maxsize=1024)
def _text(function: Function, name: str) -> str:
    node = deepcopy(parse(function))
    node.name = name
    helpers = helpers_of(function)
    for each in ast.walk(node):
        if isinstance(each, ast.Call) and isinstance(each.func, ast.Name) and each.func.id in helpers:
            each.func.id = _name(helpers[each.func.id])
    return ast.unparse(node)
