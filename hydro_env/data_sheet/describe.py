"""A model of a rig from its data sheets, with the given data sheet beside the simulated one and all that was assumed."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from hydro_env.data_sheet.derive import EFFECTS, Fitted, full_flow, parameters
from hydro_env.data_sheet.quantities import DYNAMIC, Quantity, quantities, values_of
from hydro_env.data_sheet.sheet import TABLES, DataSheet
from hydro_env.data_sheet.simulated import dynamics_of, motor_figures, rig_figures, steady_figures
from hydro_env.errors import InputError
from hydro_env.files import write_json, write_text
from hydro_env.plant import PlantModel, parameter_of, scales_of
from hydro_env.reading import shipped_yaml

SCHEMA = "hydro_env/describe/1"
#: Relative deviation of the simulated from the given figure that is marked, and what is never marked, in the figure's unit.
_MARKED, _NEVER = 0.05, 0.2
#: What is fitted to one, two and three figures of the spool's dynamics that a sheet may have, with its bounds; and how often.
_FREE = (("frequency", 0.1, 10.0), ("damping", 0.25, 3.0), ("coil_lag", 0.02, 3.0))
_ROUNDS = 2
#: By which the range of a parameter is wider than its assumptions make it: data sheets leave as much open themselves.
_TOLERANCE = 0.1


@dataclass(frozen=True)
class Figure:
    """One line of a data sheet: `given` is None where the sheet has none, `assumed` where a class value stands for it."""

    channel: int
    key: str
    given: float | None
    assumed: bool
    simulated: float

    @property
    def deviation_percent(self) -> float | None:
        """Of the simulated from the given figure."""
        return None if not self.given else 100.0 * (self.simulated / self.given - 1.0)

    @property
    def marked(self) -> bool:
        """Whether the model does not do what the sheet says."""
        given = self.simulated if self.given is None else self.given
        return not abs(self.simulated - given) <= max(_MARKED * abs(given), _NEVER)


@dataclass(frozen=True)
class Assumption:
    """A quantity that no sheet gives, in the unit of its key, and the parameters that rest on it."""

    channel: int
    key: str
    value: float
    low: float
    high: float
    why: str
    parameters: tuple[str, ...]


@dataclass(frozen=True)
class Described:
    """A model, where its values are from, its simulated data sheet, and what was assumed."""

    model: PlantModel
    sources: dict[str, str]
    figures: list[Figure]
    assumptions: list[Assumption]


@dataclass
class _Channel:
    """A channel while it is described: what is known of it, and what was found by simulation."""

    number: int
    known: dict[str, Quantity]
    other_flow: float
    fitted: Fitted = field(default_factory=Fitted)

    def __post_init__(self) -> None:
        self.q = values_of(self.known)

    @property
    def parameters(self) -> dict[str, float]:
        """The values of the channel by name, SI."""
        return parameters(self.q, self.other_flow, self.fitted)

    def moved(self, key: str, value: float) -> dict[str, float]:
        """The parameters if a quantity were another, on the same spring and travel."""
        return parameters({**self.q, key: value}, self.other_flow, self.fitted, self.parameters)


def describe(sheet: DataSheet) -> Described:
    """The model of a data sheet. InputError for values that no such component has."""
    known = [quantities(sheet, channel) for channel in (0, 1)]
    flows = [full_flow(values_of(each)) for each in known]
    channels = [_Channel(c, known[c], flows[1 - c]) for c in ((0,) if known[0] == known[1] else (0, 1))]
    figures, simulated = [], {}
    for c in channels:
        c.fitted, simulated[c.number] = _fit(sheet, c)
    model = _model(sheet, [c.parameters for c in channels])
    for c in channels:
        found = {**simulated[c.number], **motor_figures(model, c.number, c.q), **rig_figures(model, c.number)}
        for key, value in found.items():
            given = c.known.get(key)
            printed = None if given is None else given.value
            figures.append(Figure(c.number + 1, key, printed, given is not None and given.assumed, value))
    ranges: dict[str, tuple[float, float]] = {}
    assumptions = [row for c in channels for row in _assumptions(model, c, ranges)]
    return Described(replace(model, ranges=ranges), _sources(sheet, channels), figures, assumptions)


def _model(sheet: DataSheet, channels: list[dict[str, float]]) -> PlantModel:
    one, two = channels[0], channels[-1]
    names = dict.fromkeys((*one, *two))
    pairs = {n: (one.get(n, parameter_of(n).nominal), two.get(n, parameter_of(n).nominal)) for n in names}
    try:
        return PlantModel(sheet.name, pairs, EFFECTS)
    except InputError as problem:
        raise InputError(f"no model has these values: {str(problem).partition(': ')[2]}") from None


# --- what no formula gives --------------------------------------------------------------------------------------------
def _fit(sheet: DataSheet, c: _Channel) -> tuple[Fitted, dict[str, float]]:
    """The numbers by which the model of a channel does what its sheet says, as far as a few numbers can, and its figures."""

    def model_of(fitted: Fitted) -> PlantModel:
        return _model(sheet, [parameters(c.q, c.other_flow, fitted)])

    def nearer(found: dict[str, float], key: str) -> float:
        return min(max(c.q[key] / max(found[key], 1e-9), 0.3), 3.0)

    fitted = Fitted()
    for _ in range(_ROUNDS):
        fitted = _fit_dynamics(c, model_of, fitted)
        for _ in range(3):  # both are nearly in proportion
            found = steady_figures(model_of(fitted), c.number, c.q)
            hysteresis = fitted.hysteresis * nearer(found, "hysteresis_percent")
            flow = fitted.flow * nearer(found, "rated_flow_lpm")
            fitted = replace(fitted, hysteresis=hysteresis, flow=flow)
    model = model_of(fitted)
    return fitted, {**steady_figures(model, c.number, c.q), **dynamics_of(model, c.number, c.q)}


def _fit_dynamics(c: _Channel, model_of: Callable[[Fitted], PlantModel], start: Fitted) -> Fitted:
    """The spool's dynamics by least squares on the plant."""
    given = [key for key in DYNAMIC if key in c.q]
    names = [row for row in _FREE if row[0] != "coil_lag" or "coil_lag" in c.q][: len(given)]
    at = [getattr(start, name) or c.q.get(name, 1.0) for name, _, _ in names]

    def fitted(x: np.ndarray) -> Fitted:
        return replace(start, **{row[0]: math.exp(value) for row, value in zip(names, x, strict=True)})

    def off(x: np.ndarray) -> np.ndarray:
        found = dynamics_of(model_of(fitted(x)), c.number, c.q)
        return np.array([min(max(math.log(found[key] / c.q[key]), -3.0), 3.0) for key in given])

    low, high = (np.log([row[n] for row in names]) for n in (1, 2))
    first = np.clip(np.log(at), low + 1e-6, high - 1e-6)
    answer = least_squares(off, first, bounds=(low, high), diff_step=0.01, xtol=1e-4, ftol=1e-5, max_nfev=20)
    return fitted(answer.x)


# --- what was assumed, and where each value is from -------------------------------------------------------------------
def _assumptions(
    model: PlantModel, c: _Channel, ranges: dict[str, tuple[float, float]]
) -> Iterator[Assumption]:
    """What was assumed of a channel; what it leaves open of each parameter, one at a time, is added to the `ranges`."""
    nominal, scales = c.parameters, scales_of(model, c.number)
    for key, quantity in c.known.items():
        if quantity.low is None or quantity.high is None or getattr(c.fitted, key, None) is not None:
            continue
        span = quantity.low, quantity.high
        ends = [c.moved(key, end) for end in span]
        moved = {name for end in ends for name in _moved(nominal, end)}
        names = tuple(name for name in nominal if name in moved)
        if names or quantity.low == quantity.high:
            yield Assumption(c.number + 1, key, quantity.value, *span, quantity.why, names)
        for name in names:
            possible = scales.parameter(parameter_of(name)).possible
            every = [*model.pair(name), *ranges.get(name, ()), *(end[name] for end in ends)]
            low, high = min(every) * (1.0 - _TOLERANCE), max(every) * (1.0 + _TOLERANCE)
            ranges[name] = (max(low, min(possible[0], min(every))), min(high, possible[1]))


def _moved(nominal: dict[str, float], other: dict[str, float]) -> list[str]:
    """The parameters that are not what they were."""
    return [name for name, value in nominal.items() if not math.isclose(other[name], value, rel_tol=1e-9)]


def _sources(sheet: DataSheet, channels: list[_Channel]) -> dict[str, str]:
    """Where each value is from: how, and from which keys of the sheet and which assumptions."""
    words = shipped_yaml(__package__, "sources.yaml")
    texts: dict[str, dict[str, None]] = {}
    for c in channels:
        nominal = c.parameters
        used: dict[str, list[str]] = {name: [] for name in nominal}
        for key, quantity in c.known.items():
            text = f"{key} {quantity.value:.4g}" + " (assumed)" * quantity.assumed
            for name in _moved(nominal, c.moved(key, 1.01 * quantity.value or 0.01)):
                used[name].append(text)
        for name, keys in used.items():
            how = words.get(name) or words[name.partition(".")[0]]
            texts.setdefault(name, {})[f"{how}; {', '.join(keys)}" if keys else how] = None
    tables = [f"{name}: {t.source}" for name, t in zip(TABLES, sheet.tables(0), strict=True) if t.source]
    printed = f" [{'; '.join(tables)}]" if tables else ""
    return {name: " / ".join(each) + printed for name, each in texts.items()}


# --- what is written --------------------------------------------------------------------------------------------------
def write(found: Described, folder: Path) -> str:
    """Writes model.yaml, describe.json and describe.txt into a folder; the text of the last."""
    found.model.to_yaml(folder / "model.yaml", found.sources)
    rows = [{**vars(f), "deviation_percent": f.deviation_percent, "marked": f.marked} for f in found.figures]
    data = {"schema": SCHEMA, "figures": rows, "assumptions": [vars(row) for row in found.assumptions]}
    write_json(folder / "describe.json", data)
    text = _text(found)
    write_text(folder / "describe.txt", text + "\n")
    return text


def _text(found: Described) -> str:
    lines = [f"{found.model.name:36}{'given':>12}{'simulated':>12}    (...) assumed"]
    channels = {figure.channel for figure in found.figures}
    for f in found.figures:
        given = "-" if f.given is None else f"({f.given:.4g})" if f.assumed else f"{f.given:.4g}"
        mark = "  <- not what the sheet says" if f.marked else ""
        of = f" {f.channel}" if len(channels) > 1 else ""
        lines.append(f"  {f.key + of:34}{given:>12}{f.simulated:>12.4g}{mark}")
    if any(f.marked for f in found.figures):
        lines.append("No such model does all that the sheet says: check the marked figures and conditions.")
    lines.append("\nassumed, as the sheet does not say; what is measured instead goes into the sheet")
    rows: dict[tuple[Any, ...], list[int]] = {}
    for row in found.assumptions:
        rows.setdefault((row.key, row.value, row.low, row.high, row.why), []).append(row.channel)
    for (key, value, low, high, why), at in rows.items():
        name = f"{key} {at[0]}" if len(at) < len(channels) else key
        span = "" if low == high else f"{low:.4g} to {high:.4g}"
        lines.append(f"  {name:34}{value:>12.4g}  {span:20}{why}")
    return "\n".join(lines)
