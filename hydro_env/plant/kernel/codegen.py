"""Turns the one right-hand side and a set of effects into a vectorised, compiled step.

Method: ROS34PW2 of Rang and Angermann (BIT 45, 2005): four stages, order 3, L-stable, stiffly accurate, and a
W-method, that is, of full order with *any* matrix W in place of the Jacobian. W here holds the stiff loops of a channel
(coil, spool, bristle; pressure, speed), as far as they damp, and every effect's own decay; its arrow structure solves in
some thirty operations. The angle, an integral of the speed, needs no stages of its own.

Layout: a block is `half` rigs side by side; lanes 0..half-1 are their first channels, lanes half..2*half-1 their second
ones. All rows of a block (states, parameters, stages) lie in one flat array with constant offsets, the loop over
substeps is outside and the loops over lanes inside; vector_ir.py writes these as vector instructions. Nothing is fused or
reordered on the way: the text names each `fma` itself, so every lane gets the same bits whatever its neighbours, its
place, the width of the block and the neutral effects that are compiled in.

Speed: what the parameters and the length of the step settle is computed once, not in every stage; sums over earlier
stages come before the rates they are added to, so that little waits for the friction's long chain of operations; W
leaves out the falling slope of the Stribeck curve, which would cost work and, when steep, stability.

Source text: `rates` (rhs.py), the laws of the effects and the functions of vector_math are pasted into one generated
module, which is kept in the user's cache under a hash of its own text: compiled once for a set of effects, and never
stale.
"""

from __future__ import annotations

import ast
import hashlib
import importlib.util
import inspect
import os
import re
import sys
import tempfile
import textwrap
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from .. import vector_math
from ..catalogue import CATALOGUE, Effect
from ..catalogue.effect import arguments
from ..parameters import PARAMETERS
from ..rhs import rates
from . import vector_ir

__all__ = ["STATES", "Kernel", "compile_kernel", "rosenbrock_coefficients"]

#: Functions of vector_math that laws may call.
_HELPERS = ("clip", "sign", "exp", "bell", "tanh", "cos", "sin")
#: States of a channel, in the order of `rates`.
STATES = ("current", "spool", "spool_speed", "bristle", "pressure", "speed", "angle")
#: Beyond these magnitudes (SI) a state counts as diverged.
STATE_CAPS = (1e2, 1e-2, 1e3, 1e-2, 1e10, 1e5, 1e12)
#: A lane at an end stop takes a substep in so many parts; at a sharp bend of an effect, as many as the effect asks for.
STOP_PARTS = 5
#: Longest delay that the delay line of the command holds, s.
LONGEST_DELAY = 0.05

#: A state that nothing acts on but another one, of which it is the integral.
INTEGRAL = {"angle": "speed"}

_OUTPUTS = ("time", "flow", "measured_speed", "diverged", "command", "load")


def rosenbrock_coefficients() -> dict[str, Any]:
    """ROS34PW2 (Rang, Angermann 2005), in the variables that need no product with the matrix.

    Keys: `gamma`; `alpha` (4, 4), `Gamma` (4, 4), `b` (4,) as published; `a`, `c`, `m` transformed
    (Hairer, Wanner, Solving Ordinary Differential Equations II, IV.7).
    """
    gamma = 4.3586652150845900e-01
    alpha = np.array([
        [0.0, 0.0, 0.0, 0.0],
        [8.7173304301691801e-01, 0.0, 0.0, 0.0],
        [8.4457060015369423e-01, -1.1299064236484185e-01, 0.0, 0.0],
        [0.0, 0.0, 1.0, 0.0],
    ])  # fmt: skip
    full = np.array([
        [gamma, 0.0, 0.0, 0.0],
        [-8.7173304301691801e-01, gamma, 0.0, 0.0],
        [-9.0338057013044082e-01, 5.4180672388095326e-02, gamma, 0.0],
        [2.4212380706095346e-01, -1.2232505839045147e00, 5.4526025533510214e-01, gamma],
    ])  # fmt: skip
    b = np.array(
        [2.4212380706095346e-01, -1.2232505839045147e00, 1.5452602553351020e00, 4.3586652150845900e-01]
    )
    inverse = np.linalg.inv(full)
    return {
        "gamma": gamma, "alpha": alpha, "Gamma": full, "b": b,
        "a": alpha @ inverse, "c": np.eye(4) / gamma - inverse, "m": b @ inverse,
    }  # fmt: skip


def _integral_coefficients(method: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """What the method makes of a state whose rate is another state v, in closed form.

    Such a state needs no stages of its own: at stage i (row 4: at the end of the step) it is
    y + h (p[i] v + sum over j of q[i, j] u_j), with u_j the stages of v. Returns p (5,) and q (5, 4).
    """
    a, c, gamma = np.vstack([method["a"], method["m"]]), method["c"], method["gamma"]
    own, stages = np.zeros(4), np.zeros((4, 4))  # its stages w_i = h (own[i] v + sum of stages[i, j] u_j)
    for i in range(4):
        own[i] = gamma * (1.0 + c[i, :i] @ own[:i])
        stages[i] = gamma * (a[i] + np.eye(4)[i] + c[i, :i] @ stages[:i])
    return a @ own, a @ stages


@dataclass(frozen=True)
class Kernel:
    """A compiled step for a set of effects.

    `advance(memory, cells, ring, head, commands, loads, substeps, h, record, every, out)` runs every block through all rows of
    `commands`; see the generated text. `rows` maps names of states, parameters and outputs to rows of the memory.
    """

    effects: tuple[str, ...]
    half: int
    rows: dict[str, int]
    num_rows: int
    dtype: np.dtype[Any]
    num_cells: int
    has_delay: bool
    advance: Callable[..., None]
    source: str


# --- from laws to statements ------------------------------------------------------------------------------------------
class _Names:
    """What an argument of a law is called in the generated text."""

    def __init__(self, effect: Effect, given: Mapping[str, str | float] | None = None) -> None:
        self.own = {p.name: f"{effect.name}__{p.name}" for p in effect.parameters}
        self.own |= {s.name: f"{effect.name}__{s.name}" for s in effect.states}
        self.own |= {a: self.own.get(str(source), str(source)) for a, source in (given or {}).items()}

    def __call__(self, argument: str, changed: dict[str, str]) -> str:
        name = self.own.get(argument, argument)
        return changed.get(name, name)


def _law_name(effect: Effect, part: str) -> str:
    return f"{effect.name}__{part}__law"


def _chain(quantity: str, effects: Iterable[Effect], changed: dict[str, str] | None = None) -> list[str]:
    """Statements that pass `quantity` through the laws of the effects; `changed` renames arguments."""
    changed = changed or {}
    target = changed.get(quantity, quantity)
    lines = []
    for effect in effects:
        law = effect.laws.get(quantity)
        if law is not None:
            names = _Names(effect)
            asked = [target] + [names(a, changed) for a in arguments(law)[1:]]
            lines.append(f"{target} = {_law_name(effect, quantity)}({', '.join(asked)})")
    return lines


def _depends(quantity: str, effects: Iterable[Effect], argument: str) -> bool:
    return any(argument in arguments(e.laws[quantity])[1:] for e in effects if quantity in e.laws)


def _rates_body(effects: tuple[Effect, ...]) -> list[str]:
    """The lines of `rates` with the laws of the effects in their places."""
    source = textwrap.dedent(inspect.getsource(rates))
    docstring = ast.parse(source).body[0].body[0]  # type: ignore[attr-defined]
    lines = source.splitlines()[docstring.end_lineno :]
    body = []
    for line in textwrap.dedent("\n".join(lines)).splitlines():
        marker = re.fullmatch(r"# effects on (\w+)", line.strip())
        if marker:
            body += _chain(marker[1], effects)
        elif line.strip() and not line.startswith(("#", "return")):
            body.append(line)
    return body


def _slopes(effects: tuple[Effect, ...]) -> list[str]:
    """Statements for the entries of W that close a loop; by differences where an effect changes them."""
    lines = [
        # LuGre, without the slope of the Stribeck curve
        "bristle_decay = s0 * abs(spool_speed) / breakaway",
        "decay_slope = sign(spool_speed) * s0 / breakaway",
        "bristle_slope = clip(1.0 - decay_slope * bristle, 0.0, 2.0)",
        "friction_bristle = s0 - s1 * bristle_decay",
        "friction_slope = s1 * bristle_slope + s2 + C + (k_stop * past / v_stop if contact > 0.0 else 0.0)",
        "stiffness = k + (k_stop * grip if contact > 0.0 else 0.0)",
    ]
    if _depends("force", effects, "spool"):
        lines += ["spool__d = spool + 1e-7", "force__d = alpha * current"]
        lines += _chain("force", effects, {"force": "force__d", "spool": "spool__d"})
        lines += ["stiffness = stiffness + positive((force - force__d) * 1e7)"]
    lines += ["pressure__d = pressure + 1e3", "leakage_slope = leakage_coefficient"]
    if _depends("leakage", effects, "pressure"):
        lines += [
            "laminar__d = leakage_coefficient * pressure__d",
            "laminar = leakage_coefficient * pressure",
        ]
        lines += ["leakage__d = laminar__d"]
        lines += _chain("leakage", effects, {"leakage": "leakage__d", "pressure": "pressure__d"})
        # Only what the effects add, so that a neutral one changes no bit.
        lines += [
            "leakage_slope = leakage_slope + positive(((leakage__d - laminar__d) - (leakage - laminar)) * 1e-3)"
        ]
    if _depends("drive", effects, "pressure"):
        lines += ["drive__d = 1.0"]
        lines += _chain("drive", effects, {"drive": "drive__d", "pressure": "pressure__d"})
        lines += ["flow__d = Kq * opening * sqrt(drive__d if drive__d > 0.0 else 0.0)"]
        lines += ["leakage_slope = leakage_slope + positive((flow - flow__d) * 1e-3)"]
    lines += ["shaft_slope = viscous_friction"]
    if _depends("torque", effects, "speed") or _depends("motor_pressure", effects, "speed"):
        changed = {"torque": "torque__d", "motor_pressure": "motor_pressure__d", "speed": "speed__d"}
        lines += ["speed__d = speed + 1e-3", "torque__d = -load", "motor_pressure__d = pressure"]
        lines += _chain("motor_pressure", effects, changed) + _chain("torque", effects, changed)
        lines += [
            "shaft_slope = shaft_slope + positive("
            "(displacement * (motor_pressure - motor_pressure__d) + torque - torque__d) * 1e3)"
        ]
    return lines


#: The factors of W = ig - slopes, by elimination: current, spool and bristle into the spool speed, pressure into the speed.
_FACTORS = [
    "inertia = per_m",
    "e_current = 1.0 / (ig + resistance * per_L)",
    "e_bristle = 1.0 / (ig + bristle_decay)",
    "w_spool = stiffness * inertia * gh",
    "w_bristle = friction_bristle * inertia * e_bristle",
    "w_current = alpha * inertia * e_current",
    "w_back = alpha * per_L",
    "w_slope = bristle_slope",
    "e_spool_speed = 1.0 / (ig + positive(friction_slope * inertia + w_spool * gh + w_bristle * w_slope + w_current * w_back))",
    "softness = bulk_modulus * per_V",
    "w_flow = softness * Kq",
    "w_pump = softness * displacement",
    "e_pressure = 1.0 / (ig + softness * leakage_slope)",
    "w_lift = displacement * per_J * e_pressure",
    "e_speed = 1.0 / (ig + shaft_slope * per_J + w_lift * w_pump)",
]


# --- fused multiply-add ---------------------------------------------------------------------------------------------
class _Fuse(ast.NodeTransformer):
    """Writes a * b + c, c + a * b, a * b - c and c - a * b as one fused operation.

    The compiler may not fuse on its own: what it fuses would depend on the effects compiled in and on the width of the
    block. Fused here, statement by statement, a statement gives the same bits wherever it stands.
    """

    def visit_BinOp(self, node: ast.BinOp) -> ast.AST:
        node = self.generic_visit(node)  # type: ignore[assignment]
        if not isinstance(node.op, ast.Add | ast.Sub):
            return node
        minus = isinstance(node.op, ast.Sub)
        left, right = node.left, node.right
        if isinstance(right, ast.BinOp) and isinstance(right.op, ast.Mult):
            factor = ast.UnaryOp(ast.USub(), right.left) if minus else right.left
            return _call("fma", factor, right.right, left)
        if isinstance(left, ast.BinOp) and isinstance(left.op, ast.Mult):
            term = ast.UnaryOp(ast.USub(), right) if minus else right
            return _call("fma", left.left, left.right, term)
        return node

    def visit_Subscript(self, node: ast.Subscript) -> ast.AST:
        return node  # an index is whole numbers


def _call(name: str, *arguments: ast.expr) -> ast.Call:
    return ast.Call(ast.Name(name, ast.Load()), list(arguments), [])


@lru_cache(maxsize=1024)  # kernels of different effects share most of their text
def _fused(text: str) -> str:
    return ast.unparse(_Fuse().visit(ast.parse(textwrap.dedent(text))))


# --- the generated module ---------------------------------------------------------------------------------------------
class _Rows:
    """Row numbers of a block, handed out in order."""

    def __init__(self) -> None:
        self.number: dict[str, int] = {}

    def add(self, *names: str) -> None:
        for name in names:
            self.number[name] = len(self.number)


#: Base parameters that are divided by: their reciprocals are rows of their own, since a division costs ten products.
_DIVISORS = ("L", "m", "V", "J", "vs", "v_stop")


def _by_reciprocals(lines: Iterable[str]) -> list[str]:
    return [re.sub(rf"/ ({'|'.join(_DIVISORS)})\b", r"* per_\1", line) for line in lines]


def _needed(wanted: set[str], lines: Iterable[str]) -> list[str]:
    """The assignments among `lines` that the wanted names depend on."""
    kept: list[str] = []
    for line in reversed(list(lines)):
        target, expression = line.split(" = ", 1)
        if target in wanted:
            kept.append(line)
            wanted = wanted | set(re.findall(r"[A-Za-z_]\w*", expression))
    return kept[::-1]


class _Hoist(ast.NodeTransformer):
    """Takes what depends on the parameters and the length of the step alone out of the statements of a sweep.

    `constant` names what is known beforehand. `take(lines)` gives the lines back with a name `k__n` in place of each
    constant part; `lines` then holds the assignments that make these names, in order.
    """

    def __init__(self, constant: Iterable[str]) -> None:
        self.constant = set(constant)
        self.lines: list[str] = []
        self.names: dict[str, str] = {}

    def _is_constant(self, node: ast.AST) -> bool:
        called = {n.func for n in ast.walk(node) if isinstance(n, ast.Call)}
        names = {n for n in ast.walk(node) if isinstance(n, ast.Name)} - called
        return bool(names) and all(n.id in self.constant for n in names)

    def _name(self, node: ast.AST) -> str:
        text = ast.unparse(node)
        # A variable may be assigned several times, so the same text need not mean the same.
        name = f"k__{len(self.names)}"
        self.lines.append(f"{name} = {text}")
        self.names[name] = text
        return name

    def visit(self, node: ast.AST) -> Any:
        if isinstance(node, ast.BinOp | ast.Call | ast.IfExp) and self._is_constant(node):
            return ast.Name(self._name(node), ast.Load())
        return super().visit(node)

    def take(self, lines: Iterable[str]) -> list[str]:
        taken = []
        for line in lines:
            target, expression = line.split(" = ", 1)
            node = ast.parse(expression, mode="eval").body
            if self._is_constant(node) or isinstance(node, ast.Constant):
                self.constant.add(target)
                self.lines.append(line)
                if not isinstance(node, ast.Name | ast.Constant):
                    line = f"{target} = {self._name(ast.Name(target, ast.Load()))}"
            else:
                self.constant.discard(target)
                line = f"{target} = {ast.unparse(self.visit(node))}"
            taken.append(line)
        return taken


def _indent(lines: Iterable[str], depth: int) -> str:
    return textwrap.indent("\n".join(lines), "    " * depth)


def _sweep(lines: Iterable[str], depth: int) -> str:
    """A loop over all lanes of a block that runs these statements."""
    body = _fused("\n".join(lines)).splitlines()
    return _indent(["for l in range(LANES):", *("    " + line for line in body)], depth)


def _uses(name: str, text: str) -> bool:
    return re.search(rf"\b{name}\b", text) is not None


@lru_cache(maxsize=256)
def _paste(function: Callable[..., Any], name: str) -> str:
    """Source of a plain function under another name. ValueError if it cannot run on many lanes at once."""
    try:
        source = textwrap.dedent(inspect.getsource(function))
    except OSError:
        raise ValueError(
            f"the source of law {function.__name__!r} cannot be read; define it in a file"
        ) from None
    if not source.startswith("def "):
        raise ValueError(
            f"law {function.__name__!r} must be a plain function (def), not a lambda or decorated"
        )
    text = re.sub(r"^def \w+\(", f"def {name}(", source)
    vector_ir.check(ast.parse(source).body[0], _HELPERS)  # type: ignore[arg-type]
    return _fused(text)


def _module_text(effects: tuple[Effect, ...], half: int, single: bool) -> tuple[str, dict[str, int], int]:
    parameters = list(PARAMETERS) + [f"{e.name}__{p.name}" for e in effects for p in e.parameters]
    extra = [(e, s) for e in effects for s in e.states]
    states = list(STATES) + [f"{e.name}__{s.name}" for e, s in extra]

    rows = _Rows()
    rows.add(*states, *_OUTPUTS)
    saved = len(states) + 2  # states, time and flow: all that a step changes
    staged = [name for name in states if name not in INTEGRAL]  # states with stages of their own
    moving = len(rows.number)
    rows.add(*parameters)
    kept = len(rows.number)
    factors = ("e_current", "e_bristle", "e_spool_speed", "w_spool", "w_bristle", "w_current", "w_back", "w_slope",
               "e_speed", "e_pressure", "w_flow", "w_pump", "w_lift")  # fmt: skip
    rows.add(*(f"f__{name}" for name in factors), *(f"f__{name}" for name in states[len(STATES) :]))
    rows.add(
        *(f"u{stage}__{name}" for stage in range(3) for name in staged), "applied", "next_flow", "other_flow"
    )
    rows.add(*(f"per_{name}" for name in _DIVISORS))
    rows.add("asked", *(f"{copy}{r}" for copy in ("before", "after") for r in range(saved)))
    at = rows.number

    def row(name: str) -> str:
        return f"cells[{at[name] * 2 * half} + l]"

    reciprocals = [f"per_{name}" for name in _DIVISORS]

    def load(names: Iterable[str], text: str) -> list[str]:
        return [f"{name} = {row(name)}" for name in names if _uses(name, text)]

    body = _by_reciprocals(_rates_body(effects))
    # `rates` takes the command as the delay line hands it over.
    effect_rates = []
    for effect, state in extra:
        names = _Names(effect, state.given)
        call = ", ".join(names(a, {}) for a in arguments(state.rate))
        effect_rates.append(
            f"{effect.name}__{state.name}_rate = {_law_name(effect, state.name + '_rate')}({call})"
        )
    own_flow = ["own_flow = " + row("flow"), "other_flow = " + row("other_flow")]
    body_text = "\n".join(body + effect_rates)
    flows = own_flow if _uses("other_flow", body_text) or _uses("own_flow", body_text) else []
    inputs = ["command = " + row("applied"), *load(["load", "time"], body_text), *flows]
    slopes = _by_reciprocals(_slopes(effects))

    # What the parameters and the length of the step settle is computed once, by `settle`.
    hoist = _Hoist({*parameters, *reciprocals, "ig", "gh"})
    watch_body, body = body, hoist.take(body)
    slopes = hoist.take(slopes)
    made = hoist.take(_FACTORS)
    settled = {line.split(" = ")[0]: line.split(" = ")[1] for line in made if re.search(r" = k__\d+$", line)}
    kept_rows = [n for n in hoist.names if _uses(n, "\n".join([*body, *slopes, *made]))]
    rows.add(*kept_rows)
    at_factor = {name: settled.get(name, f"f__{name}") for name in factors}
    constants = [*parameters, *reciprocals, *kept_rows]

    # Which lanes take the substep in parts: those about to meet an end stop, or a sharp bend of an effect.
    bends = ["abs(spool) + h * abs(spool_speed) > x_max"]
    number_of_parts = [STOP_PARTS]
    for effect in effects:
        if effect.corner is not None:
            names = _Names(effect)
            call = ", ".join("h" if a == "substep" else names(a, {}) for a in arguments(effect.corner))
            bends.append(f"{_law_name(effect, 'corner')}({call})")
            number_of_parts.append(effect.corner_parts)
    near = [f"near |= ({') | ('.join(bends)})"]
    ask = [*load([*states, *parameters], "\n".join(bends)), "parts = 0.0"]
    for bend, parts in sorted(zip(bends, number_of_parts, strict=True), key=lambda pair: pair[1]):
        ask.append(f"parts = {float(parts)} if {bend} else parts")
    ask.append(f"{row('asked')} = parts")

    # First stage: rates, matrix, its factors, and the solution u0, all in one sweep.
    body_text = "\n".join(body + effect_rates)
    first = load(states, body_text + " ".join(states)) + inputs
    first += (
        load(constants, "\n".join([body_text, *slopes, *made, *near])) + body + effect_rates + slopes + made
    )
    first += [f"{row('f__' + name)} = {name}" for name in factors if name not in settled]
    for effect, state in extra:
        name = f"{effect.name}__{state.name}"
        if state.decay is None:
            first.append(f"f__{name} = 1.0 / ig")
        else:
            names = _Names(effect, state.given)
            call = ", ".join(names(a, {}) for a in arguments(state.decay))
            first.append(f"f__{name} = 1.0 / (ig + {_law_name(effect, state.name + '_decay')}({call}))")
        first.append(f"{row('f__' + name)} = f__{name}")
    prepare = _needed(set(kept_rows), hoist.lines)
    divided = [f"per_{name} = 1.0 / {name}" for name in _DIVISORS]
    prepare = load(parameters, "\n".join([*divided, *prepare])) + divided + prepare
    prepare += [f"{row(name)} = {name}" for name in reciprocals]
    prepare += [f"{row(name)} = {name}" for name in kept_rows]

    def solve(sums: Callable[[str], str]) -> list[str]:
        """(ig - W) u = r, where r is the rate plus a combination of earlier stages."""
        lines = [f"r__{name} = {sums(name)}{name}_rate" for name in staged]
        lines += [
            "u__spool_speed = ((w_current * r__current - w_spool * r__spool - w_bristle * r__bristle) + r__spool_speed)"
            " * e_spool_speed",
            "u__current = (r__current - w_back * u__spool_speed) * e_current",
            "u__spool = (r__spool + u__spool_speed) * gh",
            "u__bristle = (r__bristle + w_slope * u__spool_speed) * e_bristle",
            "q__pressure = r__pressure + w_flow * u__spool",
            "u__speed = (r__speed + w_lift * q__pressure) * e_speed",
            "u__pressure = (q__pressure - w_pump * u__speed) * e_pressure",
        ]
        return lines + [f"u__{name} = r__{name} * f__{name}" for name in states[len(STATES) :]]

    first += [f"{row('next_flow')} = flow"] if flows else []
    first += near + solve(lambda name: "") + [f"{row('u0__' + name)} = u__{name}" for name in staged]

    def stage(number: int) -> list[str]:
        lines = []
        for name in staged:
            for j in range(number):
                lines.append(f"u{j}__{name} = {row(f'u{j}__{name}')}")
            terms = "".join(f" + a{number}{j} * u{j}__{name}" for j in range(number))
            lines += [f"{name} = {row(name)}{terms}"]
            lines += [f"sum__{name} = " + " + ".join(f"c{number}{j} * u{j}__{name}" for j in range(number))]
        for name, rate in INTEGRAL.items():
            if number == 3 or _uses(name, body_text):
                terms = "".join(f" + q{number}{j} * u{j}__{rate}" for j in range(number))
                lines += [f"begin__{rate} = {row(rate)}", f"begin__{name} = {row(name)}"]
                lines += [f"{name} = begin__{name} + p{number} * begin__{rate}{terms}"]
        lines += inputs + load(constants, body_text) + body + effect_rates
        lines += [f"{name} = {row(at_factor[name])}" for name in factors]
        lines += [f"f__{name} = {row('f__' + name)}" for name in states[len(STATES) :]]
        lines += solve(lambda name: f"sum__{name} + ")
        if number < 3:
            return lines + [f"{row(f'u{number}__{name}')} = u__{name}" for name in staged]
        # Stiffly accurate: the step ends where the last stage stands, plus its u.
        lines += [f"{name} = {name} + u__{name}" for name in staged]
        for name, rate in INTEGRAL.items():
            terms = "".join(f" + q4{j} * u{j}__{rate}" for j in range(3))
            lines += [f"{name} = begin__{name} + p4 * begin__{rate}{terms} + q43 * u__{rate}"]
        # Stored only after everything is loaded: the compiler gives up on vectors otherwise.
        lines += [f"{row('time')} = {row('time')} + h"]
        lines += [f"{row('flow')} = {row('next_flow')}"] if flows else []
        return lines + [f"{row(name)} = {name}" for name in states]

    method = rosenbrock_coefficients()
    p, q = _integral_coefficients(method)
    coefficients = []
    for i in range(1, 4):
        for j in range(i):
            coefficients.append(f"a{i}{j} = {float(method['a'][i, j])!r}")
            coefficients.append(f"c{i}{j} = {float(method['c'][i, j])!r} * ih")
    for i in range(1, 5):
        coefficients += [f"p{i} = {float(p[i])!r} * h"]
        coefficients += [f"q{i}{j} = {float(q[i, j])!r} * h" for j in range(min(i, 4))]

    watch = [*watch_body, "measured_speed = speed", *_chain("measured_speed", effects)]
    watch = _needed({"flow", "measured_speed"}, watch)
    watch = (
        load(states, " ".join(states)) + inputs + load([*parameters, *reciprocals], "\n".join(watch)) + watch
    )
    watch += [f"{row('flow')} = flow", f"{row('measured_speed')} = measured_speed"]

    guard = [f"ok = abs({row(STATES[0])}) < {STATE_CAPS[0]!r}"]
    guard += [f"ok = ok & (abs({row(name)}) < {cap!r})" for name, cap in zip(STATES, STATE_CAPS, strict=True)]
    guard += [f"ok = ok & (abs({row(name)}) < 1e12)" for name in states[len(STATES) :]]
    guard += [f"{row('diverged')} = {row('diverged')} if ok else 1.0"]
    guard += [f"{row(name)} = {row(name)} if ok else 0.0" for name in states]

    additions = [
        (at[base], at[f"{e.name}__{own}"]) for e in effects for base, own in e.adds_to.items()
    ]  # fmt: skip
    base_rows = {
        "additions": "\n".join(
            f"        for l in range(LANES):\n"
            f"            cells[{b} * LANES + l] = cells[{b} * LANES + l] + cells[{p} * LANES + l]"
            for b, p in additions
        ),
    }

    helpers = [getattr(vector_math, name) for name in _HELPERS]
    pasted = [_paste(f, f.__name__) for f in helpers]
    for effect in effects:
        pasted += [_paste(law, _law_name(effect, quantity)) for quantity, law in effect.laws.items()]
        if effect.corner is not None:
            pasted.append(_paste(effect.corner, _law_name(effect, "corner")))
        for state in effect.states:
            pasted.append(_paste(state.rate, _law_name(effect, state.name + "_rate")))
            if state.decay is not None:
                pasted.append(_paste(state.decay, _law_name(effect, state.name + "_decay")))

    exchange = _EXCHANGE.format(flow=at["flow"], other=at["other_flow"]) if flows else ""
    delays = [
        f"cells[{at[f'{e.name}__{e.delays_command}']} * LANES + l]" for e in effects if e.delays_command
    ]
    if not delays:
        apply = "cells[APPLIED * LANES + l] = cells[COMMAND * LANES + l]"
        ring = ""
    else:
        apply = "pass"
        late = delays[0] if len(delays) == 1 else f"({' + '.join(delays)})"
        ring = _DELAY.format(late=late)
    lanes_text = inspect.getsource(vector_ir)
    text = _MODULE.format(
        lanes=hashlib.sha256(lanes_text.encode()).hexdigest()[:16],
        functions="\n\n".join(pasted), half=half, moving=moving, kept=kept, total=len(at),
        command=at["command"], load=at["load"], applied=at["applied"], time=at["time"], rated=at["u_rated"],
        asked=at["asked"],
        saved=saved, before=at["before0"], after=at["after0"],
        part_numbers=(1, *sorted(set(number_of_parts))),
        ask=_sweep(ask, 1),
        gamma=repr(method["gamma"]), coefficients=_indent(_fused("\n".join(coefficients)).splitlines(), 1),
        prepare=_sweep(prepare, 1), first=_sweep(first, 1), second=_sweep(stage(1), 1),
        third=_sweep(stage(2), 1), fourth=_sweep(stage(3), 1), real="np.float32" if single else "np.float64",
        watch=_sweep(watch, 1), guard=_sweep(guard, 1), exchange=_indent(exchange.splitlines(), 1),
        apply=apply, ring=ring, **base_rows,
    )  # fmt: skip
    visible = {name.replace("__", ".", 1) if name in parameters and "__" in name else name: n
               for name, n in at.items() if n < kept}  # fmt: skip
    return text, visible, kept


_DELAY = """\
                slot = (head + t * substeps + n) % slots
                for l in range(LANES):
                    ring[b, slot, l] = cells[COMMAND * LANES + l]
                    late = {late} / whole_step
                    late = late if late < slots - 2.0 else slots - 2.0
                    whole = int(late)
                    share = late - whole
                    cells[APPLIED * LANES + l] = (
                        (1.0 - share) * ring[b, (slot - whole) % slots, l] + share * ring[b, (slot - whole - 1) % slots, l]
                    )
"""

_EXCHANGE = """\
for l in range(HALF):
    cells[{other} * LANES + l] = cells[{flow} * LANES + HALF + l]
    cells[{other} * LANES + HALF + l] = cells[{flow} * LANES + l]"""

_MODULE = '''\
"""Generated by hydro_env.plant.kernel.codegen; the name of this file is the hash of its text.

Its vector instructions are written by hydro_env.plant.kernel.vector_ir, whose own text has the hash {lanes}.
"""

from math import floor, sqrt

import numpy as np
from hydro_env.jit import compiled
from hydro_env.plant.kernel.vector_ir import vectors

real = {real}


def block(function):
    return compiled(function, nogil=True)  # threads may step plants of their own side by side

HALF = {half}
LANES = 2 * HALF
MOVING = {moving}
KEPT = {kept}
TOTAL = {total}
COMMAND, LOAD, APPLIED, TIME, RATED = {command}, {load}, {applied}, {time}, {rated}
ASKED, SAVED, BEFORE, AFTER = {asked}, {saved}, {before}, {after}
PART_NUMBERS = {part_numbers}
KINDS = len(PART_NUMBERS)


def positive(value):
    return value if value > 0.0 else 0.0


{functions}


@vectors
def look(cells):
    """Outputs (flow, measured speed) of a block from its states."""
    for l in range(LANES):
        cells[APPLIED * LANES + l] = cells[COMMAND * LANES + l]
{exchange}
{watch}


@vectors
def guard(cells):
    """Puts lanes that left the bounds of sense to rest and marks them."""
{guard}


@vectors
def settle(cells, h):
    """Once for all substeps of a length: reciprocals, and what depends on the parameters and that length alone."""
    gh = {gamma} * h
    ig = 1.0 / gh
{prepare}


@vectors
def ask(cells, h):
    """In how many parts each lane should take a step of h seconds; 0 for the whole one."""
{ask}


@vectors
def begin(cells, h) -> bool:
    """The first stage of a step of h seconds; whether there are lanes that should take it in parts."""
    near = False
    gh = {gamma} * h
    ig = 1.0 / gh
{exchange}
{first}
    return near


@vectors
def finish(cells, h):
    """The other three stages; the states move."""
    gh = {gamma} * h
    ih = 1.0 / h
{coefficients}
{second}
{third}
{fourth}


@block
def advance(memory, cells, ring, head, commands, loads, substeps, h, record, every, out):
    """Runs every block through all rows of `commands`, `substeps` steps of `h` seconds to a row.

    memory (blocks * KEPT * LANES,); cells (TOTAL * LANES,), aligned: room to work in; ring (blocks, slots, LANES) and head:
    the delay line; commands, loads (T, rigs or 1, 2): one row for all rigs where the middle is 1; record: rows of the
    memory that go to out (len(record), T // every, rigs, 2) at the instant of each row, before its command acts.
    """
    whole_step = real(h)
    rigs = out.shape[2]
    slots = ring.shape[1]
    for b in range(memory.size // (KEPT * LANES)):
        start = b * KEPT * LANES
        for i in range(KEPT * LANES):
            cells[i] = memory[start + i]
{additions}
        settled = whole_step
        settle(cells, settled)
        for t in range(commands.shape[0]):
            if record.size > 0 and t % every == 0:
                look(cells)
                for r in range(record.size):
                    for l in range(HALF):
                        rig = b * HALF + l
                        if rig < rigs:
                            out[r, t // every, rig, 0] = cells[record[r] * LANES + l]
                            out[r, t // every, rig, 1] = cells[record[r] * LANES + HALF + l]
            for l in range(HALF):
                rig = b * HALF + l
                rig = rig if rig < rigs else 0
                c = rig if commands.shape[1] > 1 else 0
                d = rig if loads.shape[1] > 1 else 0
                tl = t if loads.shape[0] > 1 else 0
                cells[COMMAND * LANES + l] = commands[t, c, 0]
                cells[COMMAND * LANES + HALF + l] = commands[t, c, 1]
                cells[LOAD * LANES + l] = loads[tl, d, 0]
                cells[LOAD * LANES + HALF + l] = loads[tl, d, 1]
            for l in range(LANES):
                limit = cells[RATED * LANES + l]
                u = cells[COMMAND * LANES + l]
                u = u if u < limit else limit
                cells[COMMAND * LANES + l] = u if u > -limit else -limit
                {apply}
            for n in range(substeps):
{ring}
                # Lanes at an end stop or a sharp bend of an effect take the step in parts. A step is made for all lanes
                # whole, and if there are such lanes once more for each number of parts they ask for; AFTER collects
                # for each lane the result that is meant for it.
                split = False
                for kind in range(KINDS):
                    parts = PART_NUMBERS[kind]
                    if kind > 0:
                        asked = False
                        for l in range(LANES):
                            asked = asked or cells[ASKED * LANES + l] == parts
                        if not asked:
                            continue
                        for i in range(SAVED * LANES):
                            cells[i] = cells[BEFORE * LANES + i]
                    h = whole_step / real(parts)
                    if h != settled:
                        settle(cells, h)
                        settled = h
                    for _ in range(parts):
                        near = begin(cells, h)
                        if near and kind == 0:
                            split = True
                            ask(cells, h)
                            for i in range(SAVED * LANES):
                                cells[BEFORE * LANES + i] = cells[i]
                        finish(cells, h)
                    if not split:
                        break
                    for r in range(SAVED):
                        for l in range(LANES):
                            if kind == 0 or cells[ASKED * LANES + l] == parts:
                                cells[(AFTER + r) * LANES + l] = cells[r * LANES + l]
                if split:
                    for i in range(SAVED * LANES):
                        cells[i] = cells[AFTER * LANES + i]
            guard(cells)
        look(cells)
        for i in range(MOVING * LANES):
            memory[start + i] = cells[i]
'''


def _cache_folder() -> Path:
    """Where generated kernels are kept: $HYDRO_ENV_CACHE, else the user's cache, else a temporary folder."""
    named = os.environ.get("HYDRO_ENV_CACHE")
    base = (
        Path(named)
        if named
        else Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "hydro_env"
    )
    try:
        base.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=base):
            pass
    except OSError:
        base = Path(tempfile.gettempdir()) / f"hydro_env_{os.getuid() if hasattr(os, 'getuid') else 'cache'}"
        base.mkdir(parents=True, exist_ok=True)
    return base


def _import_text(text: str) -> ModuleType:
    name = "kernel_" + hashlib.sha256(text.encode()).hexdigest()[:16]
    path = _cache_folder() / f"{name}.py"
    if not path.exists() or path.read_text() != text:
        handle, temporary = tempfile.mkstemp(dir=path.parent, suffix=".tmp")
        with os.fdopen(handle, "w") as file:
            file.write(text)
        os.replace(temporary, path)
    specification = importlib.util.spec_from_file_location(name, path)
    assert specification is not None and specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    sys.modules[name] = module  # the compiler's cache looks its functions up there
    specification.loader.exec_module(module)
    return module


@lru_cache(maxsize=64)
def _compiled(effects: tuple[Effect, ...], half: int, single: bool) -> Kernel:
    text, rows, kept = _module_text(effects, half, single)
    module = _import_text(text)
    names = tuple(e.name for e in effects)
    dtype = np.dtype(np.float32 if single else np.float64)
    delay = any(e.delays_command for e in effects)
    return Kernel(names, half, rows, kept, dtype, module.TOTAL * module.LANES, delay, module.advance, text)


def compile_kernel(effects: Iterable[str] = (), half: int = 8, dtype: Any = np.float64) -> Kernel:
    """The kernel for these effects, compiled on its first call. KeyError for an effect the catalogue lacks.

    `dtype` is float64, or float32 for twice the lanes to a vector.

    The effects act in the order of the catalogue, whatever order they are named in.
    """
    wanted = set(effects)
    for name in wanted:
        CATALOGUE[name]
    single = np.dtype(dtype) == np.float32
    return _compiled(tuple(e for e in CATALOGUE.values() if e.name in wanted), half, single)
