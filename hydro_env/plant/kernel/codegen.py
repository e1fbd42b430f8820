"""Writes the module of a kernel: the sweeps over the lanes of a block, which `driver` calls.

A sweep is one loop over all lanes, or several where lanes look at each other in between. `attempt_step` is a step of the
integrator (`integrator`): it factors the matrix, makes the stages, evaluates the rates where the step ends, and judges the error;
each lane then moves or stays, and goes on with a step of its own length. `precompute` computes once what the parameters settle,
`observe` gives the outputs, and `reset_diverged` puts lanes that were not followed to rest.

What makes it fast: two of the three stages share their rates; the rates at the end of a step begin the next one; the arrow
structure of the matrix W solves in some thirty operations.
"""

import ast
import re
import textwrap
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

from ..catalogue import Effect
from .driver import NUMBERS, SWEEPS
from .integrator import CONTROL, ERRORS, METHOD, TOLERATED, integral_coefficients
from .layout import (
    DIVISORS,
    INTEGRAL,
    STATES,
    Layout,
    in_text,
    parameters_of,
    scale_of,
    states_of,
    with_shared,
)  # fmt: skip
from .statements import Step, chain, functions, in_order, needed, reads, step_of, target

#: A sweep: statements that loops over the lanes run, and text between them that moves values from lane to lane.
Parts = list[list[str] | str]

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


#: Each channel sees a value of the other one.
_EXCHANGE = """\
for l in range(HALF):
    cells[{other} * LANES + l] = cells[{own} * LANES + HALF + l]
    cells[{other} * LANES + HALF + l] = cells[{own} * LANES + l]"""

#: Where they act on each other, both channels of a rig take the same steps.
_COUPLED = """\
for l in range(HALF):
    one = cells[{row} * LANES + l]
    two = cells[{row} * LANES + HALF + l]
    alone = cells[{coupled} * LANES + l] + cells[{coupled} * LANES + HALF + l] <= 0.0
    cells[{row} * LANES + l] = one if alone or one {worse} two else two
    cells[{row} * LANES + HALF + l] = two if alone or two {worse} one else one"""

#: All rigs of a block take the steps of its first one.
_GROUPED = """\
for l in range(HALF):
    cells[{row} * LANES + l] = cells[{row} * LANES]
    cells[{row} * LANES + HALF + l] = cells[{row} * LANES + HALF]"""


@dataclass(frozen=True)
class _Sweeps:
    """The statements of every sweep, each a method of its name. `grouped`: all rigs of a block take the steps of its first.

    `@name` is the cell of a name. A name that a loop uses before it is assigned is loaded: what an earlier loop of the sweep has
    assigned, else the cell of that name.
    """

    at: Layout
    step: Step
    grouped: bool

    # --- channels that act on each other ------------------------------------------------------------------------------
    @cached_property
    def exchanges(self) -> bool:
        """Whether a law or a state asks for valve flows."""
        read = reads([*self.step.rates, *self.step.own_rates, *self.step.slopes])
        return not read.isdisjoint(("other_flow", "own_flow"))

    def _exchange(self, own: str, other: str) -> str:
        return _EXCHANGE.format(own=self.at.row(own), other=self.at.row(other))

    @property
    def _flows_exchanged(self) -> list[str]:
        return [self._exchange("flow", "other_flow")] if self.exchanges else []

    def _alike(self, row: str, worse: str) -> list[str]:
        """Text by which lanes that belong together have the same in a row, the worse."""
        return self._coupled(row, worse) + ([_GROUPED.format(row=self.at.row(row))] if self.grouped else [])

    def _coupled(self, row: str, worse: str) -> list[str]:
        """Text by which channels that act on each other have the same in a row, the worse."""
        at = self.at
        if not any(e.couples_channels for e in at.effects):
            return []
        return [_COUPLED.format(row=at.row(row), coupled=at.row("coupled"), worse=worse)]

    # --- parts of sweeps ------------------------------------------------------------------------------------------------
    @property
    def _inputs(self) -> list[str]:
        """`rates` takes the command as the delay line hands it over."""
        return ["command = @applied", *self._flows]

    @property
    def _flows(self) -> list[str]:
        """Laws see the flows as they were where the step begins."""
        return ["own_flow = @flow", "other_flow = @other_flow"] if self.exchanges else []

    def _rates(self) -> Parts:
        """The rates of all states; those of the effects' states see both flows of the same instant."""
        if not (self.exchanges and self.step.own_rates):
            return [self.step.rates + self.step.own_rates]
        first = [*self.step.rates, "@shown_flow = flow"]
        flows = ["own_flow = flow", "other_flow = @seen_flow"]
        return [first, self._exchange("shown_flow", "seen_flow"), flows + self.step.own_rates]

    @property
    def _evaluated(self) -> list[str]:
        """Names of what is evaluated where a step begins: rates and their slopes, and flows where they are exchanged."""
        names = [*(f"{name}_rate" for name in self.at.staged), *self.step.carried]
        names += [*self.step.couplings, *(f"{name}__acts" for name in self.step.acting)]
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
    def precompute(self) -> Parts:
        """Once for all steps, for a tolerance of h rad/s: what effects add to base parameters, reciprocals, the dry friction that
        is left, what the parameters settle, and what an error of each state counts."""
        lines = [
            f"least = {TOLERATED.share!r} * Kq * x_max / D",
            f"least = least if least > {TOLERATED.min_share!r} * h else {TOLERATED.min_share!r} * h",
            "tolerance = h if h < least else least",
            "dry = (Fc > 0.0) | (Fs > 0.0)",
            "left = friction_left(Fc, Fs)",
            "Fs = friction_left(Fs, Fc)",
            "Fc = left",
            "soft = bristles_left(Fc, Fs) if dry else 0.0",
            "s0 = soft * s0",
            "s1 = soft * s1",
        ]
        lines += _stored(("Fc", "Fs", "s0", "s1"))
        for name in DIVISORS:
            lines += [f"per_{name} = 1.0 / {name}", f"@per_{name} = per_{name}"]
        lines += needed(set(self.step.settled), self.step.settling) + _stored(self.step.settled)
        if couple := " | ".join(_acts(e) for e in self.at.effects if e.couples_channels):
            lines += [f"@coupled = 1.0 if {couple} else 0.0"]
        for name, weight in ERRORS.items():
            # That of the spool grows with its speed.
            lines += [
                f"@spool_error = {weight}" if name == "spool" else f"@weight__{name} = 1.0 / ({weight})"
            ]
        lines += [
            f"@longest = {CONTROL.sticking!r} * sqrt(m / (k + s0)) if dry else 1e30",
            f"@late = {TOLERATED.late!r} * tolerance",
            f"@own_error = {TOLERATED.own_error!r} * h",
            f"@own_late = {TOLERATED.own_late!r} * h",
            "@begun = 0.0",
        ]
        for name, adding in states_of(self.at.effects).items():
            acts = " | ".join(filter(None, (_acts(effect) for effect, _ in adding)))
            lines += [f"@counts__{name} = 1.0 if {acts} else 0.0"]
        return [*_additions(self.at.effects), CUT, lines, *self._coupled("longest", "<")]

    def start_row(self) -> Parts:
        """Commands within what the valves take, held for h seconds; no lane is lost yet. Rates stand where command and load are
        those of the row before."""
        lines = [
            "command = command if command < u_rated else u_rated",
            "command = command if command > -u_rated else -u_rated",
            "@fresh = 0.0 if (@begun > 0.0) & (command == @applied) & (load == @loaded) else 1.0",
            "@begun = 1.0",
            "@command = command",
            "@applied = command",
            "@loaded = load",
            f"@step = step if step > 0.0 else {CONTROL.first!r}",
            "@todo = h",
            "@lost = 0.0",
        ]
        return [lines, *self._alike("step", "<")]

    def evaluate(self) -> Parts:
        """Rates of the states and their slopes, where the command has changed."""
        kept = [f"@{name} = {name} if @fresh > 0.0 else @{name}" for name in self._evaluated]
        parts: Parts = [self._inputs, *self._rates(), self.step.slopes, [*kept, "@fresh = 0.0"]]
        return parts + self._flows_exchanged

    def attempt_step(self) -> Parts:
        """A step of every lane, each of its own length; where its error is small enough, the states move."""
        middle = [*self._inputs, f"time = time + {float(METHOD.alpha[1].sum())!r} * taken"]
        parts = [*self._flows_exchanged, *self._first_stage(), CUT, middle, *self._rates(), CUT]
        parts += [*self._other_stages(), *self._rates(), self.step.slopes, CUT, self._error()]
        return [*parts, CUT, *self._alike("error", ">"), self._judged()]

    def _first_stage(self) -> Parts:
        """The length of the step, the matrix, and the solution for the rates where it begins; up to the second stage's place."""
        factors = [
            # A last step that would be short is shared with the one before.
            "taken = 0.5 * todo if (2.0 * step > todo) & (step < todo) & (todo > 0.0) else step",
            "taken = todo if (step > 0.999 * todo) & (todo > 0.0) else taken",
            "loose = spool_error + late * abs(@spool_speed)",
            "both = 1.0 / (taken * loose)",
            "ih = both * loose",
            "weight_of_spool = both * taken",
            f"gh = {METHOD.gamma!r} * taken",
            f"ig = {1.0 / METHOD.gamma!r} * ih",
            *self.step.factors,
        ]
        lines = [f"r__{name} = @{name}_rate" for name in self.at.staged] + self._solve + _coefficients()
        for name in self.at.staged:
            lines += [f"u0__{name} = u__{name}", f"{name} = @{name} + a10 * u0__{name}"]
        for name, rate in INTEGRAL.items():
            lines += [f"{name} = @{name} + taken * (p1 * @{rate} + q10 * u0__{rate})"]
        return [factors, CUT, lines]

    def _other_stages(self) -> Parts:
        """The second and third stage, which share their rates; up to where the step ends."""
        staged = self.at.staged
        second = _coefficients() + [f"r__{name} = c10 * u0__{name} + {name}_rate" for name in staged]
        second += self._solve + [f"u1__{name} = u__{name}" for name in staged]
        third = _coefficients() + [f"r__{name} = d0 * u0__{name} + d1 * u1__{name}" for name in staged]
        third += self._solve
        for name in staged:
            third += [f"moved__{name} = m0 * u0__{name} + m1 * u1__{name} + u__{name}"]
            third += [f"{name} = @{name} + moved__{name}"]
        for name, rate in INTEGRAL.items():
            moved = f"p3 * @{rate} + q30 * u0__{rate} + q31 * u1__{rate} + q32 * u__{rate}"
            third += [f"{name} = @{name} + taken * ({moved})"]
        return [second, CUT, [*third, "time = @time + taken", *self._flows]]

    def _error(self) -> list[str]:
        """The squared error of the step, in units of what it may be."""
        lines = [f"r__{n} = moved__{n} * ih - 0.5 * (@{n}_rate + {n}_rate)" for n in self.at.staged]
        lines += [*self._solve, "error = 0.0"]
        for name in (name for name in STATES if name not in INTEGRAL):
            weight = "weight_of_spool" if name == "spool" else f"@weight__{name}"
            square = "part * part" + " * per_stiff" * (name == "pressure")
            lines += [f"part = u__{name} * {weight}", f"error = error + {square}"]
        for name, adding in states_of(self.at.effects).items():
            size = f"@own_error * ({scale_of(adding)!r} + 0.01 * abs(@{name}))"
            lines += [f"loose = {size} + @own_late * abs(@{name}_rate)"]
            lines += [f"part = @counts__{name} * u__{name} / loose", "error = error + part * part"]
        return [*lines, f"@error = error * {1.0 / METHOD.gamma**2!r}"]

    def _judged(self) -> list[str]:
        """Where the error is small enough the lane moves; the next step follows from it."""
        moving = [*self.at.states, "time", *self._evaluated]
        return [
            "@before__todo = todo",
            "@before__speed = @speed",
            "@before__speed_rate = @speed_rate",
            "error = @error",
            "error = error if error < 1e12 else 1e12",
            "fine = error <= 1.0",
            f"change = {CONTROL.ladder[0][1]!r}",
            *(
                f"change = {change!r} if error >= {limit!r} else change"
                for limit, change in CONTROL.ladder[1:]
            ),
            "change = 1.0 if (@failed > 0.0) & (change > 1.0) else change",
            "wanted = taken * change",
            # A step that only the end of the row made short does not shorten those after it.
            "wanted = step if fine & (taken < step) & (wanted < step) & (change > 1.0) else wanted",
            "wanted = wanted if wanted < @longest else @longest",
            "going = todo > 0.0",
            "moves = going & fine",
            "@failed = (0.0 if fine else 1.0) if going else @failed",
            f"lost = going & (not fine) & (taken < {CONTROL.smallest!r})",
            "@lost = 1.0 if lost else @lost",
            "@step = wanted if going else step",
            "todo = todo - taken if moves else todo",
            "todo = 0.0 if lost else todo",
            "@todo = todo",
            "@attempts = @attempts + (1.0 if going else 0.0)",
            *(f"@{name} = {name} if moves else @{name}" for name in moving),
        ]

    def pass_point(self) -> Parts:
        """The speed at the next point of a grid with parts of h seconds, where the last attempt passed it: by the cubic through
        the speeds and their rates at both ends of the attempt (E. Hairer, S. P. Norsett, G. Wanner, Solving Ordinary Differential
        Equations I, section II.6)."""
        lines = [
            "due = points_left * h - row_left",
            "length = before__todo - todo",
            "passed = due >= todo",
            "share = (before__todo - due) / length",
            "rest = 1.0 - share",
            "rise = speed - before__speed",
            "bend = length * before__speed_rate - rise",
            "back = length * speed_rate - rise",
            "@point_speed = before__speed + share * (rise + rest * (rest * bend - share * back))",
            "@point_passed = points_left + 1.0 if passed else 0.0",
            "@points_left = points_left - 1.0 if passed else points_left",
        ]
        return [lines]

    def observe(self) -> Parts:
        """Flow, and what only sensors see, from the states as they are."""
        outputs = ["flow", "measured_speed", "mean_line_pressure", "motor_pressure"]
        measured = ["measured_speed = speed", *chain("measured_speed", self.at.effects)]
        measured += ["mean_line_pressure = 0.0", *chain("mean_line_pressure", self.at.effects)]
        return [self._inputs + needed(set(outputs), [*self.step.rates, *measured]) + _stored(outputs)]

    def reset_diverged(self) -> Parts:
        """Lanes that were lost, or did not come to the end of the row, or whose states are beyond the caps, are put to rest and
        marked."""
        own = states_of(self.at.effects)
        caps = dict(zip(STATES, STATE_CAPS, strict=True)) | dict.fromkeys(own, STATE_CAPS[-1])
        sound = ["ok = (@lost <= 0.0) & (@todo <= 0.0)"]
        sound += [f"ok = ok & (abs(@{name}) < {cap!r})" for name, cap in caps.items()]
        # Which state: the fastest in units of its error where the lane stands, or one beyond its cap.
        lines = ["stays = @sound > 0.0", "number = 1.0", "most = 0.0"]
        for n, (name, cap) in enumerate(caps.items(), 1):
            if name not in INTEGRAL:
                weight = "/ @spool_error" if name == "spool" else f"* @weight__{name}"
                weight = f"/ ({scale_of(own[name])!r} * @own_error)" if name in own else weight
                lines += [f"fast = abs(@{name}_rate) {weight}"]
                lines += [f"number = {float(n)!r} if fast > most else number"]
                lines += ["most = fast if fast > most else most"]
            lines += [f"far = (abs(@{name}) < {cap!r})", f"number = number if far else {float(n)!r}"]
            lines += ["most = most if far else 1e300"]
        lines += [
            "now = (@diverged <= 0.0) & (not stays)",
            "@lost_at = @time if now else @lost_at",
            "@diverged = number if now else @diverged",
        ]
        lines += [f"@{name} = @{name} if stays else 0.0" for name in (*self.at.states, "step", "begun")]
        parts: Parts = [[*sound, "@sound = 1.0 if ok else 0.0"], CUT]
        return [*parts, ["if @sound <= 0.0:", *(f"    {line}" for line in lines)]]


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


def _stored(names: Iterable[str]) -> list[str]:
    return [f"@{name} = {name}" for name in names]


def _acts(effect: Effect, mark: str = "") -> str:
    """The test whether an effect is not neutral; `mark` stands before its parameters, "@" for their cells."""
    sizes = [(mark + in_text(effect, p.name), p.nominal) for p in effect.parameters if p.carries_size]
    return " | ".join(f"({name} != {ast.unparse(ast.Constant(nominal))})" for name, nominal in sizes)


def _additions(effects: tuple[Effect, ...]) -> Parts:
    """Adds parameters of effects to base parameters, or limits these by them; parameters that several effects share."""
    lines = []
    for shared in effects:
        for p in shared.parameters:
            value = ""
            for e in reversed([e for e in effects if e.shares is shared and p.name in e.names]):
                own = f"@{in_text(e, p.name)}"
                value = f"({own} if {_acts(e, '@')} else {value})" if value else own
            lines += [f"@{in_text(shared, p.name)} = {value}"] if value else []
    for e in effects:
        lines += [f"@{base} = @{base} + @{in_text(e, own)}" for base, own in e.adds_to.items()]
        for base, own in ((base, f"@{in_text(e, own)}") for base, own in e.limits.items()):
            lines.append(f"@{base} = @{base} if @{base} < {own} else {own}")
    delays = [f"@{in_text(e, e.delays_command)}" for e in effects if e.delays_command]
    lines += [f"@delay = {' + '.join(delays)}"] if delays else []
    return [lines] if lines else []


# --- text -------------------------------------------------------------------------------------------------------------
#: Sweeps that count the lanes on which a row is above 0: where rates are to be evaluated, with time to go, that passed a point.
_COUNTED = {"start_row": "fresh", "attempt_step": "todo", "pass_point": "point_passed"}


def _joined(parts: Iterable[list[str] | str]) -> Parts:
    """Parts with loops that follow each other made one."""
    found: Parts = []
    for part in parts:
        if isinstance(part, list) and found and isinstance(found[-1], list):
            found[-1] = found[-1] + part
        else:
            found.append(part)
    return found


def _sweep(layout: Layout, name: str, parts: Parts) -> str:
    """A sweep as a function: loops over all lanes of a block. Steps are attempted on lanes with time to go alone."""

    def placed(line: str) -> str:
        return re.sub(r"@(\w+)", lambda cell: layout.cell(cell[1]), line)

    texts: Parts = [part if isinstance(part, str) else list(map(placed, part)) for part in _joined(parts)]
    made: dict[str, int] = {}  # the last loop that makes a name
    for n, part in enumerate(texts):
        if isinstance(part, str):
            continue
        used = _first_used(part)
        for each in (each for each in used if each in made):
            line = f"{layout.cell('kept__' + each)} = {each}"
            if line not in texts[made[each]]:
                texts[made[each]] = [*texts[made[each]], line]
        sources = {each: f"kept__{each}" if each in made else each for each in used}
        loads = [f"{each} = {layout.cell(row)}" for each, row in sources.items() if row in layout.rows]
        texts[n] = [*loads, *part]
        made |= dict.fromkeys(_made(part), n)
    counted = _COUNTED.get(name)
    lines = ["lanes = 0"] if counted else []
    for text in texts:
        if isinstance(text, str):
            lines += text.splitlines()
        else:
            if name == "attempt_step":
                text = [f"if {layout.cell('todo')} > 0.0:", *("    " + line for line in text)]
            lines += ["for l in range(LANES):", *("    " + line for line in text)]
    if counted:
        lines += ["for l in range(LANES):"] if isinstance(texts[-1], str) else []
        lines += [f"    lanes += {layout.cell(counted)} > 0.0", "return lanes"]
    return f"def {name}(cells, h):\n" + textwrap.indent("\n".join(lines), "    ")


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


def module_text(effects: tuple[Effect, ...], half: int, grouped: bool = False) -> Module:
    """The module of a kernel for these effects, for blocks of `half` rigs, see `_Sweeps` for `grouped`."""
    given, effects = effects, with_shared(effects)
    layout = Layout(effects, half)
    sweeps = _Sweeps(layout, step_of(effects), grouped)
    head = f"from math import floor, sqrt\n\nHALF = {half}\nLANES = 2 * HALF"
    texts = [_sweep(layout, name, getattr(sweeps, name)()) for name in SWEEPS]
    at, own, settable = layout.rows, set(layout.parameters), set(parameters_of(given))
    rows = {
        name.replace("__", ".", 1) if name in own else name: n
        for name, n in at.items()
        if n < layout.kept and (name in settable or name not in own)
    }
    numbers = {"half": half, "moving": layout.moving, "kept": layout.kept, "delay": at.get("delay", -1)}
    numbers["coupled"] = at.get("coupled", -1)
    text = "\n\n\n".join([head, *functions(effects), *texts]) + "\n"
    return Module(text, rows, len(at), {name: numbers.get(name, at.get(name, 0)) for name in NUMBERS})
