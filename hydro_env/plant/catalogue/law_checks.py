"""Checks of the laws of users' effects: names that nothing defines, and laws that act at the neutral value.

Without them an unknown name surfaces in the compiler, far from the user's file, and a law that is not neutral bends the plant
wherever the effect is compiled in without acting.
"""

import ast
from collections.abc import Callable, Iterator
from functools import cache
from math import isfinite, isinf
from typing import Any

import numpy as np

from ...errors import InputError, check_known
from ..kernel import laws
from ..parameters import PARAMETERS, Parameter
from ..rhs import rates
from .effect import Effect, arguments

#: Points at which a law is tried at its neutral value, half of them small signals and half of them large ones.
SAMPLES = 200


def check_laws(effect: Effect) -> None:
    """InputError, in one line with the effect and the line of its file, for a law that asks for what there is not, does what
    the kernel cannot, or changes its quantity at the neutral value."""
    for part, law, known in _laws(effect):
        where = f"effect {effect.name!r}: {part}"
        check_known(f"line {law.__code__.co_firstlineno}: {where} asks for", arguments(law), known)
        laws.check_law(law, f"{where}: ")
    for quantity, law in effect.laws.items():
        _check_neutral(effect, quantity, law)


def _laws(effect: Effect) -> Iterator[tuple[str, Callable[..., Any], set[str]]]:
    """Every law with what it is and what it may ask for."""
    own = {*effect.names, *(effect.shares.names if effect.shares else ())}
    for quantity, law in effect.laws.items():
        yield f"the law of {quantity}", law, own | _known_at(quantity) | {quantity, "other_flow"}
    everything = own | _known_at("") | {"other_flow", "own_flow"}
    for state in effect.states:
        yield f"the rate of state {state.name!r}", state.rate, everything | state.given.keys()
        if state.decay is not None:
            yield f"the decay of state {state.name!r}", state.decay, everything | state.given.keys()


@cache
def _known_at(quantity: str) -> frozenset[str]:
    """Names of `rates` that have a value where the laws of a quantity stand; "": at the end."""
    known = set(arguments(rates))
    for node in laws.parse(rates).body:
        if isinstance(node, ast.Assign):
            name = ast.unparse(node.targets[0])
            known.add(name)
            if name == quantity:
                break
    return frozenset(known)


def _check_neutral(effect: Effect, quantity: str, law: Callable[..., Any]) -> None:
    """InputError if the law changes its quantity although the parameters that carry the effect's size are neutral."""
    rng = np.random.default_rng(0)
    own = {p.name: p for p in effect.parameters}
    states = (*effect.states, *(effect.shares.states if effect.shares else ()))
    rest = {state.name: 0.0 for state in states}  # where a state of an effect that does not act stays
    first, *others = arguments(law)
    for sample in range(SAMPLES):
        scale = 10.0 ** rng.uniform(-6.0, 0.0 if sample % 2 else 6.0)
        given = {name: rest.get(name, _value(own.get(name), name, scale, rng)) for name in others}
        value = float(scale * rng.uniform(-1.0, 1.0))
        try:
            changed = law(value, *given.values())
        except ArithmeticError:  # signals that do not occur together
            continue
        if changed != value:
            neutral = ", ".join(f"{p.name}={p.neutral:g}" for p in effect.parameters if p.carries_size)
            raise InputError(
                f"line {law.__code__.co_firstlineno}: effect {effect.name!r}: the law of {quantity} is not neutral: at"
                f" {neutral} it makes {changed:g} of {value:g}; there it must return {first!r} unchanged"
            )


def _value(parameter: Parameter | None, name: str, scale: float, rng: np.random.Generator) -> float:
    """A value of one argument: neutral for the size of the effect, anything plausible for what only shapes it."""
    if parameter is None:
        return PARAMETERS[name].nominal if name in PARAMETERS else float(scale * rng.uniform(-1.0, 1.0))
    if parameter.carries_size or isinf(parameter.nominal):
        return parameter.neutral
    ends = [end for end in (parameter.low, parameter.nominal, parameter.high) if isfinite(end)]
    return float(rng.uniform(min(ends), max(ends)))
