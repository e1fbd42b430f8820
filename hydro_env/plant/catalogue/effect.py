"""What an effect is, and the catalogue that holds all of them.

An effect is a term of the one right-hand side (`rhs.py`) that vanishes at its neutral value. It is described once: name,
port, parameters (unit, neutral value, bounds, typical size, source) and its law. The same description extends the
plant, randomises the mismatch, hides effects in practice logs and supplies the candidates of the diagnosis.

A *law* is a scalar function. Its name is the quantity of `rates` that it changes and its first argument is that
quantity; every further argument is looked up by name among the effect's own parameters and states, the signals and
parameters of `rates`, and `other_flow`, the valve flow of the rig's other channel. It returns the changed quantity,
*exactly* unchanged when the parameters are neutral. It may use +, -, *, /, comparisons, conditional expressions, `abs`,
the functions of `vector_math`, and functions of its own file that do the same.

A *state* is memory of an effect: a rate (law of the same kind) and a `scale`, by which the error of its steps is judged. Several
states may share their laws, each with arguments of its own (`given`).

Several effects may have laws and states in common (`Effect.shares`), as a leak and a check valve have the mean pressure of
the lines that they drain and fill.

A law that reads a function's own arguments only is what makes user effects possible: see `register`.
"""

import inspect
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from types import FunctionType
from typing import Any

from ...errors import check_known
from ..parameters import PARAMETERS, Parameter

#: Ports in the order in which the signal passes them.
PORTS = ("driver", "coil", "force", "opening", "flow", "supply", "line", "motor", "load", "fluid", "sensor")

#: Quantities of `rates` (and of sensors) that a law may change, and base parameters that an effect may add to.
QUANTITIES = (
    "voltage", "resistance", "force", "opening", "drive", "flow", "bulk_modulus", "displacement", "leakage_coefficient",
    "leakage", "viscous_friction", "motor_pressure", "torque", "measured_speed", "mean_line_pressure",
)  # fmt: skip


#: Functions of `vector_math` that cost as much as tens of products.
TRANSCENDENTAL = frozenset({"exp", "tanh", "cos", "sin"})


@lru_cache(maxsize=1024)
def arguments(law: Callable[..., Any]) -> tuple[str, ...]:
    """Names of what a law asks for, in order."""
    return tuple(inspect.signature(law).parameters)


def helpers_of(law: Callable[..., Any]) -> dict[str, FunctionType]:
    """The functions that a law calls, by what it calls them: those of `vector_math`, and plain ones of its file."""
    known = law.__globals__
    return {name: known[name] for name in law.__code__.co_names if isinstance(known.get(name), FunctionType)}


def called_by(law: Callable[..., Any]) -> dict[FunctionType, None]:
    """All functions that a law calls, directly or through others."""
    found: dict[FunctionType, None] = {}
    waiting = list(helpers_of(law).values())
    while waiting:
        helper = waiting.pop()
        if helper not in found:
            found[helper] = None
            waiting += helpers_of(helper).values()
    return found


@dataclass(frozen=True)
class State:
    """Memory of an effect: `rate` is d(state)/dt. The integrator finds its slopes by differences; `decay`, -d(rate)/d(state) in
    1/s, is for a rate whose slope has no bound.

    `scale` is a change of the state that moves the shaft by some 10 rad/s, or by less where it is long remembered: the integrator
    lets a step err by about a thousandth of it. A state whose scale is too large is simulated less exactly than the rest, one
    whose scale is too small costs steps.

    `given` says what arguments of the two are here, where several states share them: the name of what is looked up instead,
    or a number.
    """

    name: str
    rate: Callable[..., float]
    decay: Callable[..., float] | None = None
    scale: float = 1.0
    given: Mapping[str, str | float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Effect:
    """One effect of the catalogue; see the module's text for what laws and states are.

    What it is: `title` says it in a sentence ("spool overlap (dead zone)"; the name in words unless given), `summary` in a
    line of a table, `signature` how it shows in a log.
    `scope` is "channel" (each valve and motor has its own) or "rig" (both share the same values).
    `family` names a group of effects that compete with each other and with simpler ones; the diagnosis tries a member only
    if the model as given lists it among its effects.

    What it does, beside laws and states: `adds_to` names base parameters of the channel that one of the effect's parameters
    is simply added to, `limits` those that one of them is an upper limit of. `delays_command` names a parameter (s) by which
    the command is late; the delay line itself lives in the kernel, which hands `rates` the delayed command.
    `shares` is what several effects have in common: an effect in no catalogue, or for a correction of form the one that it
    corrects, which acts once and just before the first of them where any is compiled in. Its states and
    parameters are also theirs: a state of theirs with the name of one of its states adds to that state's rate, and its parameters
    have the values of the first of them with such parameters that is not neutral.

    What it is confused with: `indistinguishable_from` lists effects that no data of the usual channels separate from this
    one, `separated_by` experiments that do, by the name of the other effect; a pair needs its experiment on one side only.
    `corrects` is for a correction of form: the effects that it corrects, each with the parameters of the correction that
    repeat something of that effect: the name of one of its parameters (with a minus: its opposite), or a number.
    """

    name: str
    port: str
    parameters: tuple[Parameter, ...]
    summary: str
    signature: str
    source: str
    laws: Mapping[str, Callable[..., float]] = field(default_factory=dict)
    states: tuple[State, ...] = ()
    adds_to: Mapping[str, str] = field(default_factory=dict)
    limits: Mapping[str, str] = field(default_factory=dict)
    scope: str = "channel"
    indistinguishable_from: tuple[str, ...] = ()
    family: str = ""
    title: str = ""
    delays_command: str = ""
    shares: "Effect | None" = None
    separated_by: Mapping[str, str] = field(default_factory=dict)
    corrects: Mapping[str, Mapping[str, str | float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.title:
            object.__setattr__(self, "title", self.name.replace("_", " "))

    def parameter(self, name: str) -> Parameter:
        """The parameter of that name; KeyError if there is none."""
        return {parameter.name: parameter for parameter in self.parameters}[name]

    def is_neutral(self, values: Mapping[str, float]) -> bool:
        """Whether the effect vanishes at these parameter values (missing ones count as neutral).

        An effect vanishes when the parameters that carry its size are neutral; the others only shape it.
        """
        return all(values.get(p.name, p.nominal) == p.nominal for p in self.parameters if p.carries_size)

    def reads(self, signal: str) -> bool:
        """Whether a law or a state asks for this signal."""
        asked = {a for law in self.laws.values() for a in arguments(law)}
        asked |= {str(state.given.get(a, a)) for state in self.states for a in arguments(state.rate)}
        return signal in asked

    @property
    def names(self) -> tuple[str, ...]:
        """Its parameters and states."""
        return (*(p.name for p in self.parameters), *(s.name for s in self.states))

    @property
    def couples_channels(self) -> bool:
        """Whether the effect lets the two channels of a rig act on each other."""
        return self.reads("other_flow")

    @property
    def is_cheap(self) -> bool:
        """Whether the effect costs next to nothing where it is compiled in but neutral."""
        called = {helper.__name__ for law in self.laws.values() for helper in called_by(law)}
        costly = self.delays_command or len(self.states) > 1 or called & TRANSCENDENTAL
        return self.scope == "channel" and not costly


#: All effects by name, in the order in which they act.
CATALOGUE: dict[str, Effect] = {}


def register(effect: Effect) -> Effect:
    """Adds an effect to the catalogue; it is at once simulated, hideable and diagnosable.

    ValueError if the name is taken, the port or a changed quantity is unknown, a named parameter is missing, or no parameter
    carries the effect's size.
    """
    for wrong in _wrong(effect):
        raise ValueError(f"effect {effect.name!r}{wrong}")
    CATALOGUE[effect.name] = effect
    return effect


def _wrong(effect: Effect) -> Iterator[str]:
    """Why an effect cannot be registered."""
    if effect.name in CATALOGUE:
        yield " is in the catalogue already"
    if effect.port not in PORTS:
        yield f": port {effect.port!r} is none of {', '.join(PORTS)}"
    for quantity in effect.laws:
        if quantity not in QUANTITIES:
            yield f": a law changes {quantity!r}, none of {', '.join(QUANTITIES)}"
    own = {p.name for p in effect.parameters}
    named = [*effect.adds_to.values(), *effect.limits.values(), effect.delays_command]
    for name in filter(None, [*named, *(p.not_below for p in effect.parameters)]):
        if name not in own:
            yield f" has no parameter {name!r}, none of {', '.join(sorted(own))}"
    if not any(p.carries_size for p in effect.parameters):
        yield ": one of its parameters must have a typical value besides its neutral one"


def unregister(name: str) -> None:
    """Takes an effect out of the catalogue (tests of user effects; KeyError if it is not there)."""
    del CATALOGUE[name]


def separating_experiment(first: str, second: str) -> str:
    """The experiment under which two effects, by name, differ; "" where the catalogue knows none."""
    return CATALOGUE[first].separated_by.get(second, "") or CATALOGUE[second].separated_by.get(first, "")


def parameter_of(name: str) -> Parameter:
    """The description of "Kq" or "dead_zone.overlap_positive". InputError for an unknown name."""
    effect, dot, own = name.partition(".")
    if not dot:
        check_known("unknown parameter", [name], PARAMETERS)
        return PARAMETERS[name]
    check_known("unknown effect", [effect], CATALOGUE)
    known = {p.name: p for p in CATALOGUE[effect].parameters}
    check_known(f"effect {effect!r} has no parameter", [own], known)
    return known[own]
