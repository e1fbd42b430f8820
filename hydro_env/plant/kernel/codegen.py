"""Writes the module of a kernel: the sweeps over the lanes of a block, which `driver` calls.

A sweep is one loop over all lanes. `begin` makes the first stage of a step and the factors of its matrix, `finish` the other
two, and `ask` says in how many parts a lane wants its next substep. Lanes are independent of each other, so each goes at its
own pace: a step has another length on every lane, and `pace` begins the next substep where one is done. It computes once what
the parameters and the length of a step settle. `refine` finds stiff channels; `look` gives the outputs, and `guard` puts
lanes that have diverged to rest.

What makes it fast: nothing is computed in every stage that `pace` can compute once; two of the three stages share their rates;
the arrow structure of the matrix W solves in some thirty operations.
"""

from __future__ import annotations

import ast
import textwrap
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import NamedTuple

from ..catalogue import Effect
from ..stiffness import FINE_PARTS, LINE, MOST_FINER, SPOOL
from .driver import NUMBERS
from .integrator import METHOD, integral_coefficients
from .layout import (
    DIVISORS,
    FACTORS,
    INTEGRAL,
    RECIPROCALS,
    STATES,
    Layout,
    in_text,
    layout_of,
    parameters_of,
    states_of,
    uses,
    with_shared,
)  # fmt: skip
from .statements import Substep, call, chain, drive_around, functions, fused_lines, needed, substep_of
from .template import EXCHANGE, MODULE, TOGETHER

__all__ = ["Module", "module_text"]

#: Beyond these magnitudes (SI) a state counts as diverged; a state of an effect beyond the last.
STATE_CAPS = (1e3, 1e-2, 1e3, 1e-2, 1e12, 1e7, 1e12)
#: A lane that meets an end stop takes that substep in so many parts, and so does one in hard contact; one in soft contact takes
#: fewer. At a sharp bend of an effect it takes as many as the effect asks for.
HARD_PARTS, SOFT_PARTS = 5, 3
#: A contact is hard where its natural frequency, or the rate of its damping, times the substep, is more than this.
HARD_FREQUENCY, HARD_DAMPING = 0.3, 0.5

#: The solution of (ig - W) u = r for the states of `rates`, with the factors of `statements.FACTORISATION`.
_SOLUTION = [
    "u__spool_speed = ((w_current * r__current - w_spool * r__spool - w_bristle * r__bristle) + r__spool_speed)"
    " * e_spool_speed",
    "u__current = (r__current - w_back * u__spool_speed) * e_current",
    "u__spool = (r__spool + u__spool_speed) * gh",
    "u__bristle = r__bristle * e_bristle + w_slope * u__spool_speed",
    "q__pressure = r__pressure + w_flow * u__spool",
    "u__speed = (r__speed + w_lift * q__pressure) * e_speed",
    "u__pressure = (q__pressure - w_pump * u__speed) * e_pressure",
]


class Module(NamedTuple):
    """The text of a module, the rows that are kept between calls by the names of the plant, how many rows a block has, and
    the driver's `NUMBERS`, addresses aside."""

    text: str
    rows: dict[str, int]
    num_rows: int
    numbers: dict[str, int]


@dataclass(frozen=True)
class _Bend:
    """A test whether a lane should take its substep in `parts` parts; a cheap one may say before where that can be. `least` is
    how many of them a stiff lane wants."""

    test: str
    parts: int
    near: str = ""
    least: str = ""


@dataclass(frozen=True)
class _Sweeps:
    """The statements of every sweep, for a layout that has rows for what is settled."""

    at: Layout
    substep: Substep
    bends: list[_Bend]

    @property
    def _flows(self) -> list[str]:
        """The valve flows of the substep before, where a law asks for them."""
        asked = any(uses(name, self.substep.rates_text) for name in ("other_flow", "own_flow"))
        return (
            [f"own_flow = {self.at.cell('flow')}", f"other_flow = {self.at.cell('other_flow')}"]
            if asked
            else []
        )

    @property
    def exchanges_flows(self) -> bool:
        return bool(self._flows)

    @property
    def coupling(self) -> dict[str, float]:
        """Parameters whose values, unless neutral, let the channels of a rig act on each other."""
        return {
            in_text(e, p.name): p.nominal
            for e in self.at.effects
            if e.couples_channels
            for p in e.parameters
            if p.carries_size
        }

    @property
    def _inputs(self) -> list[str]:
        # `rates` takes the command as the delay line hands it over.
        inputs = [f"command = {self.at.cell('applied')}"]
        return [*inputs, *self.at.load(["load", "time"], self.substep.rates_text), *self._flows]

    def _store(self, names: Iterable[str]) -> list[str]:
        return [f"{self.at.cell(name)} = {name}" for name in names]

    def pace(self) -> list[str]:
        """Lanes whose substep is done begin the next one; where it is taken in other parts, the length of a step is new."""
        at, own = self.at, needed(set(self.at.settled), self.substep.settling)
        lines = at.load(["left", "parts", "wanted"], "left parts wanted")
        lines += ["parts = parts if left > 0.0 else wanted", "left = left if left > 0.0 else wanted"]
        lines += [*self._store(["left"]), f"if parts != {at.cell('parts')}:"]
        settled = at.load([*at.parameters, *RECIPROCALS], "\n".join(own))
        settled += ["step = h / parts", "ih = 1.0 / step", f"gh = {METHOD.gamma!r} * step", "ig = 1.0 / gh"]
        settled += own + self._store(["parts", "step", "ih", "ig", *at.settled])
        return lines + ["    " + line for line in settled]

    def refine(self) -> list[str]:
        """Reciprocals; what is left of the dry friction, and in how many parts stiff channels take every substep."""
        at = self.at
        sizes = [
            in_text(e, p.name)
            for e in at.effects
            if e.reads("current_rate")
            for p in e.parameters
            if p.carries_size
        ]
        coil = " | ".join(f"(abs({name}) > 0.0)" for name in sizes) or "L < 0.0"
        asked = (*SPOOL, *LINE, "L", *sizes)
        lines = [*at.load(asked, " ".join(asked)), "dry = (Fc > 0.0) | (Fs > 0.0)"]
        lines += ["left = friction_left(Fc, Fs)", "Fs = friction_left(Fs, Fc)", "Fc = left"]
        lines += ["soft = bristles_left(Fc, Fs) if dry else 0.0", "s0 = soft * s0", "s1 = soft * s1"]
        lines += [
            "force = greatest_force(alpha, R, k, x_max, u_rated)",
            "bristles = bristle_parts(h, force, m, Fc, Fs, s0, s1)",
            "stops = stop_parts(h, force, m, x_max, k_stop, v_stop)",
            f"coil = coil_parts(h, R, L) if {coil} else 0.0",
            f"ring = ring_parts(h, {', '.join(LINE)})",
            "fine = fine_parts(bristles, stops, coil, ring)",
        ]
        lines += self._store(("Fc", "Fs", "s0", "s1", "fine"))
        if self.coupling:
            lines += at.load(self.coupling, " ".join(self.coupling))
            coupled = " | ".join(_acts(e, str) for e in at.effects if e.couples_channels)
            lines += [f"{at.cell('together')} = 1.0 if {coupled} else 0.0"]
        lines += at.load(DIVISORS, " ".join(DIVISORS)) + [f"per_{name} = 1.0 / {name}" for name in DIVISORS]
        return lines + self._store(RECIPROCALS) + [f"{at.cell('parts')} = 0.0"]

    def ask(self) -> list[str]:
        """In how many parts each lane takes the next substep."""
        return self.at.load(self.at.states, "\n".join(asked := self._asked())) + asked

    def _asked(self) -> list[str]:
        """Of several bends the one with most parts decides; a stiff channel takes each part in its own number of parts."""
        at, known = self.at, [*self.at.parameters, *RECIPROCALS]
        near = " | ".join(dict.fromkeys(f"({bend.near or bend.test})" for bend in self.bends))
        first = needed({"past"}, self.substep.whole_rates)
        around = drive_around(at.effects)
        if around or uses("line_travel", near):
            first.append("line_travel = h * beta * per_V * (D * abs(speed) + Kq * abs(spool))")
        first += around
        then = needed({"outward", "grip"}, self.substep.whole_rates)
        for bend in sorted(self.bends, key=lambda bend: bend.parts):
            then.append(f"wanted = {float(bend.parts)} if {bend.test} else wanted")
        for bend in self.bends:
            if bend.least:
                then.append(f"finer = corner_parts({float(bend.parts)}, {bend.least} / {at.cell('fine')})")
                then.append(f"wanted = finer if {bend.test} and finer > wanted else wanted")
        then = [*at.load(known, "\n".join(then)), "wanted = 1.0", *then]
        then += [f"{at.cell('wanted')} = wanted * {at.cell('fine')}"]
        lines = [*at.load(known, "\n".join([*first, near])), *first]
        lines += [f"{at.cell('wanted')} = {at.cell('fine')}", f"if {near}:"]
        return lines + ["    " + line for line in then]

    @property
    def _solution(self) -> list[str]:
        """The solution of (ig - W) u = r."""
        return [*_SOLUTION, *(f"u__{name} = r__{name} * f__{name}" for name in self.at.own_states)]

    def _solve(self, lines: Iterable[str], summed: bool) -> list[str]:
        """`lines` for rates and factors, and the solution for r: the rate plus, if `summed`, a sum over earlier stages."""
        sums = [f"r__{n} = {f'sum__{n} + ' if summed else ''}{n}_rate" for n in self.at.staged]
        return [*lines, *sums, *self._solution]

    def first_stage(self) -> list[str]:
        """Rates, matrix, its factors, and the solution u0, all in one sweep."""
        at, step = self.at, self.substep
        lines = at.load(at.states, step.rates_text + " ".join(at.states)) + self._inputs
        lines += [*at.load(["step", "ig"], "step ig"), f"gh = {METHOD.gamma!r} * step"]
        made = step.rates + step.own_rates + step.slopes + step.factors
        lines += at.load(at.constants, "\n".join(made))
        for name, adding in states_of(at.effects).items():
            decays = [call(e, s.name + "_decay", s.decay, s.given) for e, s in adding if s.decay is not None]
            slope = f"({' + '.join(['ig', *decays])})" if decays else "ig"
            made.append(f"f__{name} = 1.0 / {slope}")
        lines += self._solve(made, summed=False)
        lines += [f"{at.cell('f__' + name)} = {name}" for name in FACTORS if name not in step.factor_rows]
        lines += [f"{at.cell('f__' + name)} = f__{name}" for name in at.own_states]
        lines += [f"{at.cell('next_flow')} = flow"] if self.exchanges_flows else []
        return lines + [f"{at.cell('u0__' + name)} = u__{name}" for name in at.staged]

    def later_stages(self) -> list[str]:
        """The second and third stage, which share their rates; the states move."""
        at, step = self.at, self.substep
        lines = [
            *at.load(["step", "ih", "ig"], "step ih ig"),
            f"gh = {METHOD.gamma!r} * step",
            *_coefficients(),
        ]
        for name in at.staged:
            lines += [f"begin__{name} = {at.cell(name)}", f"u0__{name} = {at.cell(f'u0__{name}')}"]
            lines += [f"{name} = begin__{name} + a10 * u0__{name}", f"sum__{name} = c10 * u0__{name}"]
        for name, rate in INTEGRAL.items():
            moved = f"p1 * begin__{rate} + q10 * u0__{rate}"
            lines += [f"begin__{name} = {at.cell(name)}", f"{name} = begin__{name} + step * ({moved})"]
        lines += self._inputs + at.load(at.constants, step.rates_text)
        lines += [f"{name} = {at.cell(step.factor_rows.get(name, f'f__{name}'))}" for name in FACTORS]
        lines += [f"f__{name} = {at.cell('f__' + name)}" for name in at.own_states]
        lines = self._solve([*lines, *step.rates, *step.own_rates], summed=True)
        lines += [f"u1__{name} = u__{name}" for name in at.staged]
        lines += [f"r__{name} = d0 * u0__{name} + d1 * u1__{name}" for name in at.staged]
        return [*lines, *self._solution, *self._end_of_step()]

    def _end_of_step(self) -> list[str]:
        at, lines = self.at, []
        for name in at.staged:
            lines += [f"{name} = begin__{name} + m0 * u0__{name} + m1 * u1__{name} + u__{name}"]
        for name, rate in INTEGRAL.items():
            moved = f"p3 * begin__{rate} + q30 * u0__{rate} + q31 * u1__{rate} + q32 * u__{rate}"
            lines += [f"{name} = begin__{name} + step * ({moved})"]
        # A lane that has done all its substeps waits for the others.
        lines += at.load(["todo", "left", "time"], "todo left time")
        lines += ["going = todo > 0.0", "left = left - 1.0", "todo = todo - 1.0 if left <= 0.0 else todo"]
        lines += [f"{name} = {name} if going else {at.cell(name)}" for name in at.states]
        lines += ["time = time + step if going else time", "more |= todo > 0.0"]
        if self.exchanges_flows:
            lines += [f"{at.cell('flow')} = {at.cell('next_flow')} if going else {at.cell('flow')}"]
        lines += self._store(["todo", "left", "time", *at.states])
        return lines + self._asked()

    def look(self) -> list[str]:
        """Flow, and what only sensors see, from the states as they are."""
        at, outputs = self.at, ["flow", "measured_speed", "mean_line_pressure"]
        measured = ["measured_speed = speed", *chain("measured_speed", at.effects)]
        measured += ["mean_line_pressure = 0.0", *chain("mean_line_pressure", at.effects)]
        lines = needed(set(outputs), [*self.substep.whole_rates, *measured])
        loaded = at.load([*at.parameters, *RECIPROCALS], "\n".join(lines))
        return at.load(at.states, " ".join(at.states)) + self._inputs + loaded + lines + self._store(outputs)

    def guard(self) -> list[str]:
        """Lanes whose states are beyond the caps are put to rest and marked."""
        at = self.at
        lines = [f"ok = abs({at.cell(STATES[0])}) < {STATE_CAPS[0]!r}"]
        caps = zip(STATES, STATE_CAPS, strict=True)
        lines += [f"ok = ok & (abs({at.cell(name)}) < {cap!r})" for name, cap in caps]
        lines += [f"ok = ok & (abs({at.cell(name)}) < {STATE_CAPS[-1]!r})" for name in at.own_states]
        lines += [f"{at.cell('diverged')} = {at.cell('diverged')} if ok else 1.0"]
        return lines + [f"{at.cell(name)} = {at.cell(name)} if ok else 0.0" for name in at.states]


def _bends(effects: Iterable[Effect]) -> list[_Bend]:
    """Tests for lanes that meet an end stop within a substep or are pressed on it, and for sharp bends of effects."""
    near, contact = "past + h * abs(spool_speed) > 0.0", "(past > 0.0) & (grip > 0.0)"
    bends = [
        _Bend("(past <= 0.0) & (past + h * outward > 0.0)", HARD_PARTS, near),
        _Bend(contact, SOFT_PARTS, near),
        _Bend(f"{contact} & (h * h * k_stop * grip > {HARD_FREQUENCY**2!r} * m)", HARD_PARTS, near),
        _Bend(f"{contact} & (h * k_stop * past > {HARD_DAMPING!r} * v_stop * m)", HARD_PARTS, near),
    ]
    if drive_around(effects):
        # The root of the drive is steepest where none is left: a line as high as the supply.
        bends.append(_Bend("drive__above * drive__below < 0.0", HARD_PARTS))
    for effect in effects:
        if effect.corner is not None:
            given = {"substep": "h"}
            test = call(effect, "corner", effect.corner, given)
            least = call(effect, "least_parts", effect.least_parts, given) if effect.least_parts else ""
            bends.append(_Bend(test, effect.corner_parts, least=least))
    return bends


def _coefficients() -> list[str]:
    """The tableau, for a step of `step` s, ih = 1 / step.

    As it has the rates of the second stage, u of the third is that of the second plus the solution for a sum of earlier u. The
    step needs it times m[2], which is in `d0` and `d1` at once."""
    a, c, m, (p, q) = METHOD.a, METHOD.c, METHOD.m, integral_coefficients(METHOD)
    found = {"a10": a[1, 0], "m0": m[0], "m1": m[1] + m[2], "p1": p[1], "q10": q[1, 0]}
    found |= {"p3": p[3], "q30": q[3, 0], "q31": q[3, 1] + q[3, 2], "q32": q[3, 2] / m[2]}
    lines = [f"{name} = {float(value)!r}" for name, value in found.items()]
    rates = {"c10": c[1, 0], "d0": m[2] * (c[2, 0] - c[1, 0]), "d1": m[2] * c[2, 1]}
    return lines + [f"{name} = {float(value)!r} * ih" for name, value in rates.items()]


def _indent(lines: Iterable[str], depth: int = 1) -> str:
    return textwrap.indent("\n".join(lines), "    " * depth)


def _sweep(lines: Iterable[str]) -> str:
    """A loop over all lanes of a block that runs these statements."""
    return _indent(["for l in range(LANES):", *("    " + line for line in fused_lines(lines))])


def _acts(effect: Effect, called: Callable[[str], str]) -> str:
    """The test whether an effect is not neutral; `called` says what its parameters are called."""
    sizes = [(called(in_text(effect, p.name)), p.nominal) for p in effect.parameters if p.carries_size]
    return " | ".join(f"({name} != {ast.unparse(ast.Constant(nominal))})" for name, nominal in sizes)


def _additions(layout: Layout) -> str:
    """Adds parameters of effects to base parameters, or limits these by them; parameters that several effects share."""
    cell, lines = layout.cell, []
    for shared in layout.effects:
        for p in shared.parameters:
            value = ""
            for e in reversed([e for e in layout.effects if e.shares is shared and p.name in e.names]):
                own = cell(in_text(e, p.name))
                value = f"({own} if {_acts(e, cell)} else {value})" if value else own
            lines += [f"{cell(in_text(shared, p.name))} = {value}"] if value else []
    for e in layout.effects:
        for base, own in ((cell(b), cell(in_text(e, o))) for b, o in e.adds_to.items()):
            lines.append(f"{base} = {base} + {own}")
        for base, own in ((cell(b), cell(in_text(e, o))) for b, o in e.limits.items()):
            lines.append(f"{base} = {base} if {base} < {own} else {own}")
    return _sweep(lines) if lines else ""


def _delay_line(layout: Layout) -> dict[str, str]:
    """How the command reaches the lanes: as it is, or late by the sum of what effects delay it."""
    delays = [layout.cell(in_text(e, e.delays_command)) for e in layout.effects if e.delays_command]
    if not delays:
        return {"apply": "cells[APPLIED * LANES + l] = cells[COMMAND * LANES + l]", "late": ""}
    return {"apply": "pass", "late": _sweep([f"{layout.cell('late')} = {' + '.join(delays)}"])}


def module_text(effects: tuple[Effect, ...], half: int) -> Module:
    """The module of a kernel for these effects, for blocks of `half` rigs."""
    given, effects = effects, with_shared(effects)
    layout = layout_of(effects, half)
    substep = substep_of(effects)
    layout = layout.with_settled(substep.settled)
    bends = _bends(effects)
    sweeps, at = _Sweeps(layout, substep, bends), layout.rows
    exchange = EXCHANGE.format(flow=at["flow"], other=at["other_flow"]) if sweeps.exchanges_flows else ""
    together = TOGETHER.format(wanted=at["wanted"], together=at["together"]) if sweeps.coupling else ""
    text = MODULE.format(
        functions="\n\n".join(functions(effects)), half=half, command=at["command"], applied=at["applied"],
        rated=at["u_rated"], todo=at["todo"], left=at["left"], refine=_sweep(sweeps.refine()),
        together=_indent(together.splitlines()),
        pace=_sweep(sweeps.pace()), ask=_sweep(sweeps.ask()), first=_sweep(sweeps.first_stage()),
        later=_sweep(sweeps.later_stages()),
        watch=_sweep(sweeps.look()), guard=_sweep(sweeps.guard()), exchange=_indent(exchange.splitlines()),
        additions=_additions(layout), **_delay_line(layout),
    )  # fmt: skip
    own, settable = set(layout.parameters), set(parameters_of(given))
    rows = {
        name.replace("__", ".", 1) if name in own else name: n
        for name, n in at.items()
        if n < layout.kept and (name in settable or name not in own)
    }
    numbers = {"half": half, "moving": layout.moving, "kept": layout.kept}
    at_bends = (bend.parts * (int(MOST_FINER) if bend.least else 1) for bend in bends)
    numbers["most_parts"] = max([1, *at_bends]) * max(FINE_PARTS)
    numbers |= {} if any(e.delays_command for e in effects) else {"late": -1}
    return Module(text, rows, len(at), {name: numbers.get(name, at.get(name, 0)) for name in NUMBERS})
