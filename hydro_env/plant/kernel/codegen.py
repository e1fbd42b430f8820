"""Writes the module of a kernel: the sweeps over the lanes of a block, which `driver` calls.

A sweep is one loop over all lanes, or several where lanes look at each other in between. `attempt_step` is a step of the
integrator (`integrator`): it factors the matrix, makes the stages, evaluates the rates where the step ends, and judges the error;
each lane then moves or stays, and goes on with a step of its own length. `precompute` computes once what the parameters settle,
`observe` gives the outputs, and `reset_diverged` puts lanes that were not followed to rest.

What makes it fast: two of the three stages share their rates; the rates at the end of a step begin the next one; the arrow
structure of the matrix W solves in some thirty operations.
"""

from __future__ import annotations

import ast
import textwrap
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

from ..catalogue import Effect
from .driver import NUMBERS, SWEEPS
from .fused import fused_lines
from .integrator import CONTROL, ERRORS, METHOD, TOLERATED, integral_coefficients
from .layout import (
    DIVISORS,
    INTEGRAL,
    RECIPROCALS,
    STATES,
    Layout,
    in_text,
    layout_of,
    parameters_of,
    scale_of,
    states_of,
    with_shared,
)  # fmt: skip
from .statements import Step, chain, functions, in_order, needed, reads, step_of, target
from .template import COUPLED, EXCHANGE, GROUPED, MODULE

__all__ = ["Module", "module_text"]

#: Beyond these magnitudes (SI) a state counts as diverged; a state of an effect beyond the last.
STATE_CAPS = (1e3, 1e-2, 1e3, 1e-2, 1e12, 1e7, 1e12)

#: Between two loops over the lanes where one would do: a processor has several lanes of a shorter loop under way at once.
CUT = ""

#: The solution of (ig - W) u = r for the states of `rates`, with the factors of `statements.FACTORISATION`.
_SOLUTION = [
    "u__spool_speed = ((w_current * r__current - w_spool * r__spool - w_bristle * r__bristle) + q__spool_speed)"
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
class _Sweeps:
    """The statements of every sweep. A sweep is a list of parts: loops over the lanes, or text that moves values between them.
    `grouped`: all rigs of a block take the steps of its first."""

    at: Layout
    step: Step
    grouped: bool

    # --- channels that act on each other ------------------------------------------------------------------------------
    @property
    def exchanges(self) -> bool:
        """Whether a law or a state asks for valve flows."""
        return not self._read.isdisjoint(("other_flow", "own_flow"))

    @cached_property
    def _read(self) -> set[str]:
        return reads([*self.step.rates, *self.step.own_rates, *self.step.slopes])

    def _exchange(self, own: str, other: str) -> str:
        return EXCHANGE.format(own=self.at.row(own), other=self.at.row(other))

    def _alike(self, row: str, worse: str) -> list[str]:
        """Text by which lanes that belong together have the same in a row, the worse."""
        grouped = [GROUPED.format(row=self.at.row(row))] if self.grouped else []
        return self._coupled(row, worse) + grouped

    def _coupled(self, row: str, worse: str) -> list[str]:
        """Text by which channels that act on each other have the same in a row, the worse."""
        at = self.at
        if not any(e.couples_channels for e in at.effects):
            return []
        return [COUPLED.format(row=at.row(row), coupled=at.row("coupled"), worse=worse)]

    # --- parts of sweeps ------------------------------------------------------------------------------------------------
    @property
    def _inputs(self) -> list[str]:
        # `rates` takes the command as the delay line hands it over. Laws see the flows as they were where the step begins.
        inputs = [f"command = {self.at.cell('applied')}", *self.at.load(["load", "time"])]
        return [*inputs, *self._constants]

    @property
    def _constants(self) -> list[str]:
        flows = {"own_flow": "flow", "other_flow": "other_flow"}
        seen = [f"{n} = {self.at.cell(row)}" for n, row in flows.items() if n in self._read]
        return seen + self.at.load([*self.at.parameters, *RECIPROCALS, *self.step.settled], self._read)

    def _rates(self) -> list[list[str] | str]:
        """The rates of all states; those of the effects' states see both flows of the same instant."""
        if not self.exchanges:
            return [self.step.rates + self.step.own_rates]
        if not self.step.own_rates:  # only laws ask for flows
            return [self.step.rates]
        flows = ["own_flow = flow", f"other_flow = {self.at.cell('seen_flow')}"]
        first = [*self.step.rates, f"{self.at.cell('shown_flow')} = flow"]
        return [first, self._exchange("shown_flow", "seen_flow"), flows + self.step.own_rates]

    @property
    def _couplings(self) -> list[str]:
        """Names of the slopes between states of effects and base states."""
        return [*self.step.couplings, *(f"{name}__acts" for name in self.step.acting)]

    @property
    def _evaluated(self) -> list[str]:
        """Names of what is evaluated where a step begins: rates and their slopes, and flows where they are exchanged."""
        names = [*(f"{name}_rate" for name in self.at.staged), *self.step.carried, *self._couplings]
        names += [f"{name}_decay" for name in self.at.own_states]
        return names + (["flow"] if self.exchanges else [])

    @property
    def _solve(self) -> list[str]:
        """The solution of (ig - W) u = r."""
        driven = {name: f"r__{name}" for name in self.at.own_states}
        for slope, (name, solved) in self.step.couplings.items():
            driven[name] = f"({slope} * {solved} + {driven[name]})"
        base = ["q__spool_speed = r__spool_speed", *_SOLUTION]
        for name, driver in self.step.acting.items():
            if driver == "pressure":
                found = f"softness * {name}__acts * (e_{name} * r__{name})"
                base.insert(-2, f"q__pressure = q__pressure - {found}")
            else:
                rest = f"r__{name} - {name}__by_{driver} * r__current"
                found = f"inertia * {name}__acts * (e_{name} * ({rest}))"
                base.insert(1, f"q__spool_speed = q__spool_speed + {found}")
        return [*base, *(f"u__{name} = {value} * e_{name}" for name, value in driven.items())]

    # --- sweeps ---------------------------------------------------------------------------------------------------------
    def precompute(self) -> list[list[str] | str]:
        at = self.at
        lines = [
            *at.load(at.parameters),
            f"least = {TOLERATED.share!r} * Kq * x_max / D",
            f"least = least if least > {TOLERATED.min_share!r} * h else {TOLERATED.min_share!r} * h",
            "tolerance = h if h < least else least",
        ]
        lines += ["dry = (Fc > 0.0) | (Fs > 0.0)"]
        lines += ["left = friction_left(Fc, Fs)", "Fs = friction_left(Fs, Fc)", "Fc = left"]
        lines += ["soft = bristles_left(Fc, Fs) if dry else 0.0", "s0 = soft * s0", "s1 = soft * s1"]
        lines += at.store(("Fc", "Fs", "s0", "s1"))
        lines += [f"per_{name} = 1.0 / {name}" for name in DIVISORS] + at.store(RECIPROCALS)
        lines += needed(set(self.step.settled), self.step.settling) + at.store(self.step.settled)
        if couple := " | ".join(_acts(e, str) for e in at.effects if e.couples_channels):
            lines += [f"{at.cell('coupled')} = 1.0 if {couple} else 0.0"]
        for name, weight in ERRORS.items():
            lines += [
                f"{at.cell('spool_error')} = {weight}"  # grows with its speed
                if name == "spool"
                else f"{at.cell('weight__' + name)} = 1.0 / ({weight})"
            ]
        lines += [f"{at.cell('longest')} = {CONTROL.sticking!r} * sqrt(m / (k + s0)) if dry else 1e30"]
        lines += [
            f"{at.cell('late')} = {TOLERATED.late!r} * tolerance",
            f"{at.cell('own_error')} = {TOLERATED.own_error!r} * h",
            f"{at.cell('own_late')} = {TOLERATED.own_late!r} * h",
            f"{at.cell('begun')} = 0.0",
        ]
        for name, adding in states_of(at.effects).items():
            acts = " | ".join(filter(None, (_acts(effect, str) for effect, _ in adding)))
            lines += [f"{at.cell('counts__' + name)} = 1.0 if {acts} else 0.0"]
        return [lines, *self._coupled("longest", "<")]

    def start_row(self) -> list[list[str] | str]:
        """Commands within what the valves take, held for h seconds; no lane is lost yet. Rates stand where command and load are
        those of the row before."""
        at, names = self.at, ["command", "u_rated", "step", "load"]
        lines = at.load(names)
        lines += ["command = command if command < u_rated else u_rated"]
        lines += ["command = command if command > -u_rated else -u_rated"]
        begun, applied, loaded = map(at.cell, ("begun", "applied", "loaded"))
        same = f"({begun} > 0.0) & (command == {applied}) & (load == {loaded})"
        lines += [f"{at.cell('fresh')} = 0.0 if {same} else 1.0", f"{at.cell('begun')} = 1.0"]
        lines += [f"{at.cell('command')} = command", f"{at.cell('applied')} = command"]
        lines += [f"{at.cell('loaded')} = load"]
        lines += [f"{at.cell('step')} = step if step > 0.0 else {CONTROL.first!r}"]
        lines += [f"{at.cell('todo')} = h", f"{at.cell('lost')} = 0.0"]
        return [lines, *self._alike("step", "<")]

    def evaluate(self) -> list[list[str] | str]:
        at, first = self.at, [*self.at.load(self.at.states), *self._inputs]
        names = self._evaluated
        kept = [f"{at.cell(n)} = {n} if {at.cell('fresh')} > 0.0 else {at.cell(n)}" for n in names]
        parts: list[list[str] | str] = [first, *self._rates()]
        parts += [self.step.slopes, [*kept, f"{at.cell('fresh')} = 0.0"]]
        return parts + ([self._exchange("flow", "other_flow")] if self.exchanges else [])

    def attempt_step(self) -> list[list[str] | str]:
        middle = [*self._inputs, f"time = time + {float(METHOD.alpha[1].sum())!r} * taken"]
        parts: list[list[str] | str] = [*self._first_stage(), CUT, middle, *self._rates(), CUT]
        parts += [*self._other_stages(), *self._rates(), self.step.slopes, CUT, self._error()]
        parts += [CUT, *self._alike("error", ">"), self._judged()]
        return ([self._exchange("flow", "other_flow")] if self.exchanges else []) + parts

    def _first_stage(self) -> list[list[str] | str]:
        """The length of the step, the matrix, and the solution for the rates where it begins; up to the second stage's place."""
        at, step = self.at, self.step
        lines = [f"todo = {at.cell('todo')}", f"step = {at.cell('step')}"]
        # A last step that would be short is shared with the one before.
        lines += ["taken = 0.5 * todo if (2.0 * step > todo) & (step < todo) & (todo > 0.0) else step"]
        lines += ["taken = todo if (step > 0.999 * todo) & (todo > 0.0) else taken"]
        lines += [f"loose = {at.cell('spool_error')} + {at.cell('late')} * abs({at.cell('spool_speed')})"]
        lines += ["both = 1.0 / (taken * loose)", "ih = both * loose", "weight_of_spool = both * taken"]
        lines += [f"gh = {METHOD.gamma!r} * taken", f"ig = {1.0 / METHOD.gamma!r} * ih"]
        lines += at.load([*at.parameters, *RECIPROCALS, *step.settled], reads(step.factors))
        names = [*step.carried, *self._couplings, *(f"{name}_decay" for name in at.own_states)]
        lines += [f"{name} = {at.cell(name)}" for name in names] + step.factors
        factors, lines = lines, [f"r__{name} = {at.cell(name + '_rate')}" for name in at.staged] + self._solve
        lines += _coefficients()
        for name in at.staged:
            lines += [f"u0__{name} = u__{name}", f"{name} = {at.cell(name)} + a10 * u0__{name}"]
        for name, rate in INTEGRAL.items():
            lines += [f"{name} = {at.cell(name)} + taken * (p1 * {at.cell(rate)} + q10 * u0__{rate})"]
        return [factors, CUT, lines]

    def _other_stages(self) -> list[list[str] | str]:
        """The second and third stage, which share their rates; up to where the step ends."""
        at = self.at
        lines = _coefficients() + [f"r__{name} = c10 * u0__{name} + {name}_rate" for name in at.staged]
        lines += self._solve + [f"u1__{name} = u__{name}" for name in at.staged]
        second, lines = lines, _coefficients()
        lines += [f"r__{name} = d0 * u0__{name} + d1 * u1__{name}" for name in at.staged] + self._solve
        for name in at.staged:
            lines += [f"moved__{name} = m0 * u0__{name} + m1 * u1__{name} + u__{name}"]
            lines += [f"{name} = {at.cell(name)} + moved__{name}"]
        for name, rate in INTEGRAL.items():
            moved = f"p3 * {at.cell(rate)} + q30 * u0__{rate} + q31 * u1__{rate} + q32 * u__{rate}"
            lines += [f"{name} = {at.cell(name)} + taken * ({moved})"]
        lines += [f"time = {at.cell('time')} + taken"]
        return [second, CUT, lines + self._constants]

    def _error(self) -> list[str]:
        """The squared error of the step, in units of what it may be."""
        at = self.at
        lines = [
            f"r__{name} = moved__{name} * ih - 0.5 * ({at.cell(name + '_rate')} + {name}_rate)"
            for name in at.staged
        ]
        lines += [*self._solve, "error = 0.0"]
        for name in STATES:
            weight = "weight_of_spool" if name == "spool" else at.cell(f"weight__{name}")
            if name not in INTEGRAL:
                square = "part * part" + " * per_stiff" * (name == "pressure")
                lines += [f"part = u__{name} * {weight}", f"error = error + {square}"]
        for name, adding in states_of(at.effects).items():
            size = f"{at.cell('own_error')} * ({scale_of(adding)!r} + 0.01 * abs({at.cell(name)}))"
            lines += [f"loose = {size} + {at.cell('own_late')} * abs({at.cell(name + '_rate')})"]
            lines += [
                f"part = {at.cell('counts__' + name)} * u__{name} / loose",
                "error = error + part * part",
            ]
        return [*lines, f"{at.cell('error')} = error * {1.0 / METHOD.gamma**2!r}"]

    def _judged(self) -> list[str]:
        at = self.at
        lines = [f"{at.cell('before__todo')} = todo"]
        lines += [f"{at.cell('before__' + name)} = {at.cell(name)}" for name in ("speed", "speed_rate")]
        lines += [f"error = {at.cell('error')}"]
        lines += ["error = error if error < 1e12 else 1e12", "fine = error <= 1.0"]
        lines += [f"change = {CONTROL.ladder[0][1]!r}"]
        lines += [
            f"change = {change!r} if error >= {limit!r} else change" for limit, change in CONTROL.ladder[1:]
        ]
        lines += [f"change = 1.0 if ({at.cell('failed')} > 0.0) & (change > 1.0) else change"]
        lines += ["wanted = taken * change"]
        # A step that only the end of the row made short does not shorten those after it.
        lines += ["wanted = step if fine & (taken < step) & (wanted < step) & (change > 1.0) else wanted"]
        lines += [f"wanted = wanted if wanted < {at.cell('longest')} else {at.cell('longest')}"]
        lines += ["going = todo > 0.0", "moves = going & fine"]
        lines += [f"{at.cell('failed')} = (0.0 if fine else 1.0) if going else {at.cell('failed')}"]
        lines += [f"lost = going & (not fine) & (taken < {CONTROL.smallest!r})"]
        lines += [f"{at.cell('lost')} = 1.0 if lost else {at.cell('lost')}"]
        lines += [f"{at.cell('step')} = wanted if going else step"]
        lines += ["todo = todo - taken if moves else todo", "todo = 0.0 if lost else todo"]
        lines += [
            f"{at.cell('todo')} = todo",
            f"{at.cell('attempts')} = {at.cell('attempts')} + (1.0 if going else 0.0)",
        ]
        names = [*at.states, "time", *self._evaluated]
        return lines + [f"{at.cell(name)} = {name} if moves else {at.cell(name)}" for name in names]

    def pass_point(self) -> list[list[str] | str]:
        """By the cubic through the speeds and their rates at both ends of the attempt (E. Hairer, S. P. Norsett, G. Wanner,
        Solving Ordinary Differential Equations I, section II.6)."""
        at = self.at
        lines = at.load(["todo", "row_left", "points_left", "speed", "speed_rate"])
        lines += [
            f"{name} = {at.cell('before__' + of)}"
            for name, of in (("began", "todo"), ("before", "speed"), ("rate", "speed_rate"))
        ]
        lines += ["due = points_left * h - row_left", "length = began - todo", "passed = due >= todo"]
        lines += ["share = (began - due) / length", "rest = 1.0 - share", "rise = speed - before"]
        lines += ["bend = length * rate - rise", "back = length * speed_rate - rise"]
        lines += [f"{at.cell('point_speed')} = before + share * (rise + rest * (rest * bend - share * back))"]
        lines += [f"{at.cell('point_passed')} = points_left + 1.0 if passed else 0.0"]
        lines += [f"{at.cell('points_left')} = points_left - 1.0 if passed else points_left"]
        return [lines]

    def observe(self) -> list[list[str] | str]:
        """Flow, and what only sensors see, from the states as they are."""
        at, outputs = self.at, ["flow", "measured_speed", "mean_line_pressure"]
        measured = ["measured_speed = speed", *chain("measured_speed", at.effects)]
        measured += ["mean_line_pressure = 0.0", *chain("mean_line_pressure", at.effects)]
        lines = needed(set(outputs), [*self.step.rates, *measured])
        loaded = at.load([*at.parameters, *RECIPROCALS, *self.step.settled], reads(lines))
        return [at.load(at.states) + self._inputs + loaded + lines + at.store(outputs)]

    def reset_diverged(self) -> list[list[str] | str]:
        """Lanes that were lost, or did not come to the end of the row, or whose states are beyond the caps."""
        at = self.at
        lines = [f"ok = ({at.cell('lost')} <= 0.0) & ({at.cell('todo')} <= 0.0)"]
        caps = zip(STATES, STATE_CAPS, strict=True)
        lines += [f"ok = ok & (abs({at.cell(name)}) < {cap!r})" for name, cap in caps]
        lines += [f"ok = ok & (abs({at.cell(name)}) < {STATE_CAPS[-1]!r})" for name in at.own_states]
        sound = [*lines, f"{at.cell('sound')} = 1.0 if ok else 0.0"]
        # Which state: the fastest in units of its error where the lane stands, or one beyond its cap.
        lines = [f"stays = {at.cell('sound')} > 0.0", "number = 1.0", "most = 0.0"]
        for n, name in enumerate(at.states, 1):
            cap = STATE_CAPS[min(n, len(STATE_CAPS)) - 1]
            if name not in INTEGRAL:
                weight = f"* {at.cell('weight__' + name)}"
                if name not in STATES:
                    scale = scale_of(states_of(at.effects)[name])
                    weight = f"/ ({scale!r} * {at.cell('own_error')})"
                elif name == "spool":
                    weight = f"/ {at.cell('spool_error')}"
                lines += [f"fast = abs({at.cell(name + '_rate')}) {weight}"]
                lines += [f"number = {float(n)!r} if fast > most else number"]
                lines += ["most = fast if fast > most else most"]
            lines += [f"far = (abs({at.cell(name)}) < {cap!r})", f"number = number if far else {float(n)!r}"]
            lines += ["most = most if far else 1e300"]
        lines += [f"first = {at.cell('diverged')} <= 0.0", "now = first & (not stays)"]
        lines += [f"{at.cell('lost_at')} = {at.cell('time')} if now else {at.cell('lost_at')}"]
        lines += [f"{at.cell('diverged')} = number if now else {at.cell('diverged')}"]
        lines += [
            f"{at.cell(name)} = {at.cell(name)} if stays else 0.0" for name in (*at.states, "step", "begun")
        ]
        return [sound, CUT, [f"if {at.cell('sound')} <= 0.0:", *(f"    {line}" for line in lines)]]


def _coefficients() -> list[str]:
    """The tableau, for a step of `taken` s, ih = 1 / taken.

    As it has the rates of the second stage, u of the third is that of the second plus the solution for a sum of earlier u. The
    step needs it times m[2], which is in `d0` and `d1` at once."""
    a, c, m, (p, q) = METHOD.a, METHOD.c, METHOD.m, integral_coefficients(METHOD)
    found = {"a10": a[1, 0], "m0": m[0], "m1": m[1] + m[2], "p1": p[1], "q10": q[1, 0]}
    found |= {"p3": p[3], "q30": q[3, 0], "q31": q[3, 1] + q[3, 2], "q32": q[3, 2] / m[2]}
    lines = [f"{name} = {float(value)!r}" for name, value in found.items()]
    rates = {"c10": c[1, 0], "d0": m[2] * (c[2, 0] - c[1, 0]), "d1": m[2] * c[2, 1]}
    return lines + [f"{name} = {float(value)!r} * ih" for name, value in rates.items()]


def _acts(effect: Effect, called: Callable[[str], str]) -> str:
    """The test whether an effect is not neutral; `called` says what its parameters are called."""
    sizes = [(called(in_text(effect, p.name)), p.nominal) for p in effect.parameters if p.carries_size]
    return " | ".join(f"({name} != {ast.unparse(ast.Constant(nominal))})" for name, nominal in sizes)


# --- text -------------------------------------------------------------------------------------------------------------
def _joined(parts: Iterable[list[str] | str]) -> list[list[str] | str]:
    """Parts with loops that follow each other made one."""
    found: list[list[str] | str] = []
    for part in parts:
        if isinstance(part, list) and found and isinstance(found[-1], list):
            found[-1] = found[-1] + part
        else:
            found.append(part)
    return found


def _sweep(layout: Layout, parts: Sequence[list[str] | str], going: bool = False, counted: str = "") -> str:
    """Loops over all lanes of a block that run these statements; a later loop finds what an earlier one left. `going`: only lanes
    with time to go; `counted`: a row whose lanes above 0 are counted at the end."""
    texts = _joined(parts)
    made: dict[str, int] = {}  # the last loop that makes a name
    for n, part in enumerate(texts):
        if isinstance(part, str):
            continue
        asked = [name for name in _first_used(part) if name in made]
        texts[n] = [*(f"{name} = {layout.cell('kept__' + name)}" for name in asked), *part]
        for name in asked:
            line = f"{layout.cell('kept__' + name)} = {name}"
            if line not in texts[made[name]]:
                texts[made[name]] = [*texts[made[name]], line]
        made |= dict.fromkeys(_made(part), n)
    lines: list[str] = []
    for text in texts:
        if isinstance(text, str):
            lines += text.splitlines()
        else:
            body = list(fused_lines(text))
            if going:
                body = [f"if {layout.cell('todo')} > 0.0:", *("    " + line for line in body)]
            lines += ["for l in range(LANES):", *("    " + line for line in body)]
    if counted:
        lines += ["for l in range(LANES):"] if isinstance(texts[-1], str) else []
        lines += [f"    lanes += {layout.cell(counted)} > 0.0"]
    return textwrap.indent("\n".join(lines), "    ")


def _made(lines: list[str]) -> set[str]:
    """Names that the statements of a loop assign, those under an `if` aside."""
    return {target(line) for line in lines if not line.startswith(("if ", " "))} - {""}


def _first_used(lines: list[str]) -> list[str]:
    """Names that the statements of a loop use before they assign them, in order."""
    made: set[str] = set()
    asked: dict[str, None] = {}
    for line in lines:
        line = f"test = {line[3:-1]}" if line.startswith("if ") else line.strip()
        asked |= dict.fromkeys(name for name in in_order(line) if name not in made)
        made.add(target(line))
    return list(asked)


def _additions(layout: Layout) -> list[list[str] | str]:
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
    delays = [cell(in_text(e, e.delays_command)) for e in layout.effects if e.delays_command]
    lines += [f"{cell('delay')} = {' + '.join(delays)}"] if delays else []
    return [lines] if lines else []


def module_text(effects: tuple[Effect, ...], half: int, grouped: bool = False) -> Module:
    """The module of a kernel for these effects, for blocks of `half` rigs, see `_Sweeps` for `grouped`."""
    given, effects = effects, with_shared(effects)
    layout = layout_of(effects, half)
    sweeps = _Sweeps(layout, step_of(effects), grouped)
    counts = {"start_row": "fresh", "attempt_step": "todo", "pass_point": "point_passed"}
    texts = {n: _sweep(layout, getattr(sweeps, n)(), n == "attempt_step", counts.get(n, "")) for n in SWEEPS}
    additions = _sweep(layout, _additions(layout))
    text = MODULE.format(functions="\n\n".join(functions(effects)), half=half, additions=additions, **texts)
    at, own, settable = layout.rows, set(layout.parameters), set(parameters_of(given))
    rows = {
        name.replace("__", ".", 1) if name in own else name: n
        for name, n in at.items()
        if n < layout.kept and (name in settable or name not in own)
    }
    numbers = {"half": half, "moving": layout.moving, "kept": layout.kept, "delay": at.get("delay", -1)}
    numbers["coupled"] = at.get("coupled", -1)
    return Module(text, rows, len(at), {name: numbers.get(name, at.get(name, 0)) for name in NUMBERS})
