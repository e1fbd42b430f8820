"""From `rates` and the laws of the effects to statements of the generated text, one assignment to a line.

What depends on the parameters alone is taken out of them (`Step.settling`), divisions by parameters become products. A line is
looked at as a syntax tree (`target`, `reads`).
"""

import ast
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from types import MappingProxyType
from typing import Any

from .. import vector_math
from ..catalogue.effect import QUANTITIES, Effect, State, arguments
from ..friction import bristles_left, friction_left
from ..rhs import rates
from . import laws
from .layout import DIVISORS, RECIPROCALS, in_text, parameters_of, scale_of, states_of

#: Functions of vector_math that statements and laws may call.
HELPERS = ("clip", "positive", "sign", "exp", "bell", "tanh", "cos", "sin")


# --- lines ------------------------------------------------------------------------------------------------------------
def _names(node: ast.AST) -> Iterator[str]:
    """The names in an expression, those of the functions it calls aside."""
    if isinstance(node, ast.Name):
        yield node.id
    for child in node.args if isinstance(node, ast.Call) else ast.iter_child_nodes(node):
        yield from _names(child)


@lru_cache(maxsize=1 << 14)  # kernels of different effects share most of their statements
def _parts(line: str) -> tuple[str, tuple[str, ...]]:
    (node,) = ast.parse(line).body
    assert isinstance(node, ast.Assign)
    (to,) = node.targets
    return to.id if isinstance(to, ast.Name) else "", tuple(dict.fromkeys(_names(node.value)))


def target(line: str) -> str:
    """The name that a statement assigns, "" for a cell."""
    return _parts(line)[0]


def in_order(line: str) -> tuple[str, ...]:
    """The names that a statement uses."""
    return _parts(line)[1]


def reads(lines: Iterable[str]) -> set[str]:
    """The names that statements use."""
    return {name for line in lines for name in _parts(line)[1]}


# --- laws -------------------------------------------------------------------------------------------------------------
def _law_name(effect: Effect, part: str) -> str:
    return f"{effect.name}__{part}__law"


def _call(
    effect: Effect, part: str, law: Callable[..., Any], given: Mapping[str, str | float], changed: Mapping[str, str]
) -> str:  # fmt: skip
    """A call of a law of an effect; `given` says what an argument stands for, and `changed` renames what is handed over."""
    own = {own: in_text(effect, own) for own in effect.names}
    if effect.shares is not None:
        own |= {shared: in_text(effect.shares, shared) for shared in effect.shares.names}
    own |= {argument: own.get(str(source), str(source)) for argument, source in given.items()}
    asked = [own.get(argument, argument) for argument in arguments(law)]
    return f"{_law_name(effect, part)}({', '.join(changed.get(name, name) for name in asked)})"


def chain(
    quantity: str, effects: Iterable[Effect], changed: Mapping[str, str] = MappingProxyType({})
) -> list[str]:
    """Statements that pass `quantity` through the laws of the effects; `changed` renames arguments."""
    to = changed.get(quantity, quantity)
    return [
        f"{to} = {_call(effect, quantity, law, {arguments(law)[0]: to}, changed)}"
        for effect in effects
        if (law := effect.laws.get(quantity)) is not None
    ]


def functions(effects: Iterable[Effect]) -> list[str]:
    """The text of the functions that statements call: those of `vector_math` and the laws."""
    named = {name: getattr(vector_math, name) for name in HELPERS}
    named |= {f.__name__: f for f in (friction_left, bristles_left)}
    for effect in effects:
        named |= {_law_name(effect, quantity): law for quantity, law in effect.laws.items()}
        for state in effect.states:
            named[_law_name(effect, state.name + "_rate")] = state.rate
            if state.decay is not None:
                named[_law_name(effect, state.name + "_decay")] = state.decay
    return laws.texts(named)


# --- rates and their slopes -------------------------------------------------------------------------------------------
def _rates_body(effects: tuple[Effect, ...]) -> list[str]:
    """The statements of `rates`; a quantity passes through the laws of the effects as soon as it is there."""
    body = []
    for node in laws.parse(rates).body:
        if isinstance(node, ast.Assign):
            line = ast.unparse(node)
            body += [line, *(chain(target(line), effects) if target(line) in QUANTITIES else ())]
    return body


def _again(effects: Iterable[Effect], quantity: str, first: str, *moved: str) -> list[str]:
    """Statements that make `quantity`__d from `first` by the laws of the effects, as if each NAME of `moved` were NAME__d."""
    changed = {name: f"{name}__d" for name in (quantity, *moved)}
    return [f"{quantity}__d = {first}", *chain(quantity, effects, changed)]


def _depends(quantity: str, effects: Iterable[Effect], argument: str) -> bool:
    return any(argument in arguments(e.laws[quantity])[1:] for e in effects if quantity in e.laws)


def _slopes(effects: tuple[Effect, ...]) -> list[str]:
    """Statements for the entries of W that close a loop; by differences where an effect changes them."""
    lines = [
        # LuGre, the first three times the breakaway force. How that falls counts as with bristles that are bent as far as they
        # go, and not beyond a bound: with a steep fall in its matrix the method is not stable.
        "sliding = s0 * abs(spool_speed)",
        "falling = 2.0 * (breakaway - Fc) * (spool_speed * per_vs) * (spool_speed * per_vs)",
        "bending = breakaway - s0 * bristle * sign(spool_speed) - falling",
        "bristle_slope = clip(bending, -0.3 * breakaway, 2.0 * breakaway)",
        "friction_bristle = s0 * breakaway - s1 * sliding",
        "friction_slope = s2 + C + (k_stop * past / v_stop if contact > 0.0 else 0.0)",
        "stiffness = k + (k_stop * grip if contact > 0.0 else 0.0)",
    ]
    if _depends("force", effects, "spool"):
        lines += ["spool__d = spool + 1e-7", *_again(effects, "force", "alpha * current", "spool")]
        lines += ["stiffness = stiffness + positive((force - force__d) * 1e7)"]
    return lines + _flow_slope(effects) + _leakage_slope(effects) + _filling(effects) + _shaft_slope(effects)


def _flow_slope(effects: tuple[Effect, ...]) -> list[str]:
    """How fast flow grows as the valve opens."""
    lines = ["flow_slope = Kq * sqrt(drive if drive > 0.0 else 0.0)"]
    if any("opening" in effect.laws for effect in effects):
        lines += ["spool__d = spool + 1e-7", *_again(effects, "opening", "spool__d", "spool")]
        # Only what the effects add, so that a neutral one changes no bit.
        lines += ["flow_slope = flow_slope * (1.0 + ((opening__d - spool__d) - (opening - spool)) * 1e7)"]
    return lines


def _leakage_slope(effects: tuple[Effect, ...]) -> list[str]:
    """How fast flow is lost as the pressure rises."""
    lines = ["pressure__d = pressure + 1e3", "leakage_slope = leakage_coefficient"]
    if _depends("leakage", effects, "pressure"):
        lines += [
            "laminar__d = leakage_coefficient * pressure__d",
            "laminar = leakage_coefficient * pressure",
            *_again(effects, "leakage", "laminar__d", "pressure"),
            # Only what the effects add, so that a neutral one changes no bit.
            "leakage_slope = leakage_slope + positive(((leakage__d - laminar__d) - (leakage - laminar)) * 1e-3)",
        ]
    if _depends("drive", effects, "pressure") or _depends("flow", effects, "pressure"):
        passed = "Kq * opening * sqrt(drive__d if drive__d > 0.0 else 0.0)"
        lines += [
            *_again(effects, "drive", "1.0", "pressure"),
            *_again(effects, "flow", passed, "drive", "pressure"),
            "leakage_slope = leakage_slope + positive((flow - flow__d) * 1e-3)",
        ]
    return lines


def _filling(effects: tuple[Effect, ...]) -> list[str]:
    """How fast the rate of the pressure grows with it, as a fluid gets stiffer."""
    if not _depends("bulk_modulus", effects, "pressure"):
        return ["filling = 0.0"]
    return [
        *_again(effects, "bulk_modulus", "beta", "pressure"),
        "filling = pressure_rate * ((bulk_modulus__d - bulk_modulus) / bulk_modulus) * 1e-3",
    ]


def _shaft_slope(effects: tuple[Effect, ...]) -> list[str]:
    """How fast torque is lost as the speed rises."""
    lines = ["shaft_slope = viscous_friction"]
    if _depends("torque", effects, "speed") or _depends("motor_pressure", effects, "speed"):
        lines += [
            "speed__d = speed + 1e-3",
            *_again(effects, "motor_pressure", "pressure", "speed"),
            *_again(effects, "torque", "-load", "motor_pressure", "speed"),
            "shaft_slope = shaft_slope + positive("
            "(displacement * (motor_pressure - motor_pressure__d) + torque - torque__d) * 1e3)",
        ]
    return lines


#: The factors of 1 / gh - W, by elimination: current, spool and bristle into the spool speed, pressure into the speed. Divisions
#: take ten times as long as products, so all pivots share one.
FACTORISATION = [
    "inertia = per_m",
    "w_spool = stiffness * inertia * gh",
    "softness = bulk_modulus * per_V",
    "w_flow = softness * flow_slope",
    "w_pump = softness * displacement",
    "w_back = alpha * per_L",
    "lift = displacement * per_J",
    "pivot_current = 1.0 + gh * (resistance * per_L)",
    "pivot_bristle = breakaway + gh * sliding",
    "pivot_pressure = 1.0 + gh * (softness * leakage_slope - filling)",
    "free = 1.0 + gh * (friction_slope * inertia + w_spool * gh)",
    "coiled = free * pivot_current + gh * gh * (pull * inertia * w_back)",
    "slides = gh * (s1 + gh * s0) * inertia * bristle_slope",
    "pivot_spool_speed = coiled * pivot_bristle + slides * pivot_current",
    "pivot_speed = pivot_pressure * (1.0 + gh * (shaft_slope * per_J)) + gh * gh * lift * w_pump",
    "valve = pivot_current * pivot_bristle",
    "motor = pivot_pressure * pivot_speed",
    "whole_valve = valve * pivot_spool_speed",
    "stiff = bulk_modulus * per_beta",
    "shared = gh / (whole_valve * motor * stiff)",
    "per_valve = shared * (motor * stiff)",
    "per_motor = shared * (whole_valve * stiff)",
    "per_stiff = shared * (whole_valve * motor) * ig",
    "e_spool_speed = per_valve * valve * valve",
    "per_both = per_valve * pivot_spool_speed",
    "e_current = per_both * pivot_bristle",
    "per_bristles = per_both * pivot_current",
    "e_bristle = breakaway * per_bristles",
    "e_pressure = per_motor * pivot_speed",
    "e_speed = per_motor * pivot_pressure * pivot_pressure",
    "w_bristle = friction_bristle * inertia * per_bristles",
    "w_current = pull * inertia * e_current",
    "w_slope = bristle_slope * per_bristles",
    "w_lift = lift * e_pressure",
]


# --- what is computed once --------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Step:
    """Statements of a step, from which what the parameters settle has been taken out.

    `rates`: those of the seven states, `own_rates` those of the effects' states; `slopes` of the matrix, at the same place;
    `factors` of the matrix for a length of the step, from the names in `carried`; `couplings`: names of the slopes by which other
    states drive those of effects, each with the state and what it meets in the solution; `acting`: states of effects that are
    eliminated, and what drives them; `settling`: what makes the names in `settled`.
    """

    rates: list[str]
    own_rates: list[str]
    slopes: list[str]
    factors: list[str]
    carried: list[str]
    couplings: dict[str, tuple[str, str]]
    acting: dict[str, str]
    settling: list[str]
    settled: list[str]


#: What drives states of effects beside themselves: a step for its slope, and the change that the solution gives it.
_DRIVES = {
    "pressure": (1e3, "u__pressure"),
    "speed": (1e-3, "u__speed"),
    "spool_speed": (1e-6, "u__spool_speed"),
    "current_rate": (1e-3, "(ig * u__current - r__current)"),
}


#: States of effects that act on what drives them are eliminated into it: the driver; the quantity that they act on, and its value
#: without effects; the slope of the matrix that changes.
_MEETS = {
    "pressure": ("leakage", "leakage_coefficient * pressure", "leakage_slope"),
    "current_rate": ("force", "alpha * current", "pull"),
}


def _sum_of_rates(
    adding: Iterable[tuple[Effect, State]], changed: Mapping[str, str] = MappingProxyType({})
) -> str:
    """The rate of a state, of all that adds to it; `changed` renames arguments."""
    return " + ".join(_call(e, s.name + "_rate", s.rate, s.given, changed) for e, s in adding)


def _decay(adding: tuple[Effect, State], name: str, further: float) -> str:
    """How fast a state falls back by what one effect adds to its rate."""
    effect, state = adding
    if state.decay is not None:
        return _call(effect, state.name + "_decay", state.decay, state.given, {})
    rate, changed = _sum_of_rates([adding]), _sum_of_rates([adding], {name: f"{name}__d"})
    return f"positive(({rate} - {changed}) * {1.0 / further!r})"


def _own_slopes(effects: tuple[Effect, ...]) -> tuple[list[str], dict[str, tuple[str, str]], dict[str, str]]:
    """Statements for what W has of the states of effects, by differences: how they decay, what drives them, what they act on; the
    `couplings` and what is `acting`, as in `Step`."""
    lines: list[str] = []
    couplings: dict[str, tuple[str, str]] = {}
    acting: dict[str, str] = {}
    drives = dict(_DRIVES)
    for name, adding in states_of(effects).items():
        rate, further = _sum_of_rates(adding), 0.01 * scale_of(adding)
        lines += [f"{name}__d = {name} + {further!r}"]
        falling = [_decay(each, name, further) for each in adding]
        lines += [f"{name}_decay = {' + '.join(falling)}"]
        asked = reads([f"{name}_rate = {rate}"])
        for driver, (small, solved) in drives.items():
            if driver in asked:
                changed = _sum_of_rates(adding, {driver: f"{driver}__d"})
                lines += [f"{driver}__d = {driver} + {small!r}"]
                lines += [f"{name}__by_{driver} = ({changed} - {name}_rate) * {1.0 / small!r}"]
                couplings[f"{name}__by_{driver}"] = name, solved
        for driver, (quantity, first, _) in _MEETS.items():
            if driver in asked and name in reads(chain(quantity, effects)):
                lines += _again(effects, quantity, first, name)
                lines += [f"{name}__acts = ({quantity}__d - {quantity}) * {1.0 / further!r}"]
                acting[name] = driver
        drives[name] = further, f"u__{name}"
    return lines, couplings, acting


@lru_cache(maxsize=256)
def step_of(effects: tuple[Effect, ...]) -> Step:
    """The statements of a step with these effects."""
    states = states_of(effects)
    own = [f"{name}_rate = {_sum_of_rates(adding)}" for name, adding in states.items()]
    decays, couplings, acting = _own_slopes(effects)
    hoist = _Hoist({*parameters_of(effects), *RECIPROCALS})
    rates = hoist.take(_rates_body(effects))
    slopes = hoist.take(_slopes(effects)) + decays
    factors = [f"e_{name} = 1.0 / (ig + {name}_decay)" for name in states]
    eliminated = ["pull = alpha"]
    for name, driver in acting.items():
        slope = _MEETS[driver][2]
        back = f"{name}__by_{driver}" + " * ig" * (driver == "current_rate")
        eliminated += [f"{slope} = {slope} + {name}__acts * (e_{name} * {back})"]
    factors += hoist.take([*eliminated, *FACTORISATION])
    carried = dict.fromkeys(target(line) for line in rates + slopes if target(line) in reads(factors))
    used = reads([*rates, *slopes, *factors])
    return Step(
        rates=rates, own_rates=own, slopes=slopes, factors=factors, carried=list(carried), couplings=couplings, acting=acting,
        settling=hoist.lines, settled=[name for name in hoist.names if name in used],
    )  # fmt: skip


class _Reciprocals(ast.NodeTransformer):
    """Writes divisions by `DIVISORS` as products."""

    def visit_BinOp(self, node: ast.BinOp) -> ast.BinOp:
        self.generic_visit(node)
        match node:
            case ast.BinOp(left, ast.Div(), ast.Name(name)) if name in DIVISORS:
                return ast.BinOp(left, ast.Mult(), ast.Name(f"per_{name}", ast.Load()))
        return node


def needed(wanted: set[str], lines: Iterable[str]) -> list[str]:
    """The assignments among `lines` that the wanted names depend on."""
    kept: list[str] = []
    for line in reversed(list(lines)):
        if target(line) in wanted:
            kept.append(line)
            wanted = wanted | reads([line])
    return kept[::-1]


class _Hoist(ast.NodeTransformer):
    """Takes what depends on the parameters alone out of the statements of a sweep.

    `constant` names what is known beforehand. `take(lines)` gives the lines back with a name `k__n` in place of each
    constant part, and divisions by `DIVISORS` as products; `lines` then holds the assignments that make these names, in order.
    """

    def __init__(self, constant: Iterable[str]) -> None:
        self.constant = set(constant)
        self.lines: list[str] = []
        self.names: list[str] = []

    def _is_constant(self, node: ast.AST) -> bool:
        names = list(_names(node))
        return bool(names) and self.constant.issuperset(names)

    def _name(self, node: ast.AST) -> str:
        # A variable may be assigned several times, so the same text need not mean the same.
        self.names.append(f"k__{len(self.names)}")
        self.lines.append(f"{self.names[-1]} = {ast.unparse(node)}")
        return self.names[-1]

    def visit(self, node: ast.AST) -> Any:
        if isinstance(node, ast.BinOp | ast.Call | ast.IfExp) and self._is_constant(node):
            return ast.Name(self._name(node), ast.Load())
        return super().visit(node)

    def take(self, lines: Iterable[str]) -> list[str]:
        taken = []
        for line in lines:
            name, node = target(line), _Reciprocals().visit(ast.parse(line)).body[0].value
            if self._is_constant(node) or isinstance(node, ast.Constant):
                self.constant.add(name)
                self.lines.append(f"{name} = {ast.unparse(node)}")
                if not isinstance(node, ast.Name | ast.Constant):
                    line = f"{name} = {self._name(ast.Name(name, ast.Load()))}"
            else:
                self.constant.discard(name)
                line = f"{name} = {ast.unparse(self.visit(node))}"
            taken.append(line)
        return taken
