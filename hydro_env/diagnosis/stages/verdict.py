"""The result of a diagnosis as data: verdict, effects with probabilities and intervals, gaps, and the JSON of the contract."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...plant import CATALOGUE, PlantModel, parameter_of
from ..estimation.global_search import mostly_explained, nearly_all, unexplained
from ..estimation.least_squares import Floors, Problem, gain, levels, rms
from ..estimation.uncertainty import APART, Certainty, certainty, chance, spread_of
from ..models.base import Machine
from .form_correction import Corrected, changes, is_correction
from .localisation import Place
from .next_experiment import next_experiment
from .screening import Look, alike, detectable, hidden_by_calibration
from .selection import Choice, Selection, at_edge
from .validation import NAMED, Proof, shown_unit

__all__ = [
    "SCHEMA",
    "Named",
    "calibrated_values",
    "diagnosis_dict",
    "doubts",
    "estimated_model",
    "make_sure",
    "named_effects",
    "verdict",
]

SCHEMA = "hydro_env/diagnosis/1"
#: A deviance by which rivals fall behind counts as this fraction: models are never exact.
TEMPER = 0.1
#: Share of the power above the noise that they must explain on the sealed logs, or else the verdict is `unknown`.
CONFIRMED = 0.25
#: A signal of the sealed logs is spoilt by what was named if it is off by so many times what calibration alone leaves, and so
#: many times the noise.
SPOILT = 1.2, 3.0
#: A signal above so many times its noise is off for sure.
SEEN = 1.1
#: What names and the corrections of their form may leave of a signal of the fit logs: so many times the noise, or this share of
#: what calibration alone leaves.
LEFT = 3.0, 0.05
#: The same in `levels`: one event or two in a log, such as a spool that meets its end stop late, speak against no name.
LEFT_LEVEL = 0.1
#: Values of the two channels that differ by less (relative) are one effect of both.
SAME_VALUE = 0.15


@dataclass(frozen=True)
class Named:
    """An effect that was found, as it goes to the report."""

    name: str
    channel: str
    probability: float
    indistinguishable_from: list[str]
    parameters: dict[str, dict[str, Any]]


def verdict(
    machine: Machine,
    given: dict[int, Problem],
    calibrated: dict[int, Problem],
    selection: Selection,
    floors: Floors,
) -> str:
    """none | calibration | effects | unknown, see the contract."""
    left = any(unexplained(machine, selection.problems[c], c, floors) for c in machine.channels)
    if selection.choices:
        return (
            "effects"
            if not left
            else "unknown"
            if not _mostly(machine, calibrated, selection, floors)
            else "effects"
        )
    if left:
        return "unknown"
    return (
        "calibration"
        if any(_better(machine, given[c], calibrated[c], c, floors) for c in machine.channels)
        else "none"
    )


def _better(machine: Machine, given: Problem, calibrated: Problem, channel: int, floors: Floors) -> bool:
    """Whether calibration explains more than its number of parameters would by chance."""
    old, new = (
        rms(machine, given.simulated[channel], channel),
        rms(machine, calibrated.simulated[channel], channel),
    )
    visible = any(old[k] > 1.03 * max(new[k], floors[channel, k[1]]) for k in old)
    return visible and gain(machine, given, calibrated, floors) > 6.0 * len(calibrated.unknowns)


def _mostly(machine: Machine, calibrated: dict[int, Problem], selection: Selection, floors: Floors) -> bool:
    """Whether what was found explains most of the gap in every channel that has one left, by level or by power."""
    for c in machine.channels:
        own = [k.effect for k in selection.choices if k.channel == c]
        if not machine.quick and any(at_edge(selection.problems[c], n) for n in own):
            continue  # taken for what it explains in a corrected form: see `doubts`
        if not mostly_explained(machine, calibrated[c], selection.problems[c], c, floors):
            return False
    return True


def doubts(
    machine: Machine, selection: Selection, final: dict[int, Problem], fit: Proof, sealed: Proof, floors: Floors,
) -> list[str]:  # fmt: skip
    """Why what was named is not vouched for although it explains most of the fit logs, a sentence each; none if it is.

    `final` are the named effects with the corrections of their form, `fit` and `sealed` the proofs with both. The sealed logs
    judge here and choose nothing. Where estimates that the fit logs cannot part (`certainty`) give courses that part
    by more than what is left of a signal, that rest speaks against no name.
    """
    found = []
    for c in dict.fromkeys(k.channel for k in selection.choices if k.channel is not None):
        shares = []
        level = levels(machine, fit.traces["after"][c], c, floors)
        moved, apart = (spread_of(m, final[c], c, floors) for m in (machine, sealed.machine))
        for key, entry in sealed.gap.items():
            if key.split("_")[1] != str(c + 1):
                continue
            signal = key.split("_")[0]
            fitted, plain = fit.gap[key], f"the {signal} of channel {c + 1}"
            # A correction of form proves nothing of the name.
            after = entry.get(NAMED, entry["after"])
            silent = apart.get(signal, 0.0) > max(APART, after / entry["noise"])
            spoilt = after > SPOILT[0] * entry["calibrated"] and after > SPOILT[1] * entry["noise"]
            if not silent and (spoilt or (not machine.quick and _worse(fitted) and _worse(entry))):
                found.append(f"{plain} is explained worse with the named effects than by calibration alone")
            known = moved.get(signal, 0.0) < fitted["after"] / fitted["noise"]
            far = known and _far_from_explained(fitted)
            if not machine.quick and far and level[signal] > LEFT_LEVEL:
                times = fitted["after"] / fitted["noise"]
                found.append(
                    f"{plain} of the fit logs is left {times:.2g} times its noise, whatever the form of what is named"
                )
            if entry["calibrated"] > 1.3 * entry["noise"] and not silent:
                excess = entry["calibrated"] ** 2 - entry["noise"] ** 2
                shares.append((entry["calibrated"] ** 2 - after**2) / excess)
        if shares and max(shares) < CONFIRMED:
            found.append(f"the effects of channel {c + 1} explain next to nothing of the sealed logs")
    for k in selection.choices:
        if machine.quick or k.channel is None:
            continue
        if not all(at_edge(p[k.channel], k.effect) for p in (selection.problems, final)):
            continue
        was, left = (fit.traces[name][k.channel] for name in ("calibrated", "after"))
        if not nearly_all(machine, was, left, k.channel, floors):
            found.append(f"the size of {k.effect.replace('_', ' ')} stays at the edge of its plausible range")
    return list(dict.fromkeys(found))


def _worse(entry: dict[str, float]) -> bool:
    """Whether what was named, in its own form or a corrected one, adds to the power above the noise of a signal."""
    noise = entry["noise"] ** 2
    after = min(entry["after"], entry.get(NAMED, entry["after"])) ** 2
    return after > SEEN**2 * noise and after - noise > SPOILT[0] * (entry["calibrated"] ** 2 - noise)


def _far_from_explained(entry: dict[str, float]) -> bool:
    """Whether a signal is left far from its noise, by what calibration alone left too.

    Whatever names fit the logs, what is left with the form of each put right is no matter of form any more.
    """
    return entry["after"] > max(LEFT[0] * entry["noise"], LEFT[1] * entry["calibrated"])


def named_effects(
    machine: Machine, selection: Selection, looks: Sequence[Look], floors: Floors, seed: int = 0,
    final: dict[int, Problem] | None = None,
) -> list[Named]:  # fmt: skip
    """The effects with probability, rivals, values and 95 % intervals; equal ones on both channels become "both".

    Values are those of `final` (default: of the selection), where forms may be corrected; nothing else depends on that.
    """
    final = selection.problems if final is None else final
    same = alike(looks)
    found = []
    for choice in selection.choices:
        # Alike by direction is not enough: a rival must also have done nearly as well when it was refitted.
        rivals = sorted(choice.rivals, key=lambda n: choice.rivals[n])
        rivals += [
            n
            for n in same.get((choice.effect, choice.channel), [])
            if n not in rivals and _tied(selection, choice, n)
        ]
        # Between names that are declared alike the law's exact form decides, which no machine keeps: they weigh the same.
        declared = CATALOGUE[choice.effect].indistinguishable_from
        behind = {n: 0.0 if n in declared else choice.rivals.get(n, 0.0) for n in rivals}
        weight = 1.0 + sum(math.exp(-0.5 * TEMPER * deficit) for deficit in behind.values())
        channel = choice.channel
        c = machine.channels[0] if channel is None else channel
        likely = 1.0 / (1.0 + math.exp(-0.5 * TEMPER * (choice.gain - choice.needed)))
        if choice.without is not None and choice.without.channel == selection.problems[c].channel:
            drawn = chance(machine, choice.without, selection.problems[c], choice.needed, floors, seed)
            likely = min(likely, drawn)
        key = "rig" if channel is None else str(channel + 1)
        found.append(
            Named(
                choice.effect,
                key,
                round(likely / weight, 3),
                rivals,
                _parameters(final[c], choice.effect, c),
            )
        )
    return _merged(found)


def _merged(found: list[Named]) -> list[Named]:
    """An effect that both channels have with the same values, within SAME_VALUE, becomes one entry of channel "both"."""
    out: list[Named] = []
    for n in found:
        twin = next((o for o in out if o.name == n.name and {o.channel, n.channel} == {"1", "2"}), None)
        if twin is None or not all(_alike(twin.parameters[p], n.parameters[p]) for p in n.parameters):
            out.append(n)
            continue
        parameters = {
            name: {
                "value": 0.5 * (a["value"] + b["value"]),
                "low": min(a["low"], b["low"]),
                "high": max(a["high"], b["high"]),
                "unit": a["unit"],
                "without_one_manoeuvre": max(a["without_one_manoeuvre"], b["without_one_manoeuvre"]),
            }
            for name, a in twin.parameters.items()
            for b in (n.parameters[name],)
        }
        rivals = list(dict.fromkeys(twin.indistinguishable_from + n.indistinguishable_from))
        out[out.index(twin)] = Named(n.name, "both", min(twin.probability, n.probability), rivals, parameters)
    return out


def _alike(a: dict[str, Any], b: dict[str, Any]) -> bool:
    if a["low"] <= b["high"] and b["low"] <= a["high"]:
        return True
    return bool(abs(a["value"] - b["value"]) <= SAME_VALUE * max(abs(a["value"]), abs(b["value"])))


def _tied(selection: Selection, choice: Choice, name: str) -> bool:
    tried = [
        t
        for t in selection.trials
        if t.effect == name and t.channel == choice.channel and t.problem is not None
    ]
    return any(t.gain > 0.9 * choice.gain for t in tried)


def _parameters(problem: Problem, effect: str, channel: int) -> dict[str, dict[str, Any]]:
    out = {}
    for j, u in enumerate(problem.unknowns):
        if u.name.startswith(f"{effect}.") and u.channel in (None, channel):
            out[u.name.split(".", 1)[1]] = _interval(problem, j)
    return out


def _interval(problem: Problem, j: int) -> dict[str, Any]:
    """Value and 95 % interval; `without_one_manoeuvre` is how far the value moves at most when one manoeuvre is left out."""
    u, q = problem.unknowns[j], float(problem.q[j])
    value = float(u.value(q))
    sure: Certainty | None = problem.certainty
    if sure is None:
        spread = 1.96 * float(problem.spread[j]) if problem.spread is not None else 0.0
        ends, moved = [u.value(q - spread), u.value(q + spread)], 0.0
    else:
        ends = [u.value(float(sure.low[j])), u.value(float(sure.high[j]))]
        moved = max(abs(u.value(q + d) - value) for d in (-float(sure.without[j]), float(sure.without[j])))
    low, high = (min(max(v, u.low), u.high) for v in (min(ends), max(ends)))
    return {
        "value": value, "low": float(low), "high": float(high), "unit": u.unit, "without_one_manoeuvre": float(moved),
    }  # fmt: skip


def make_sure(machine: Machine, problems: Sequence[Problem], floors: Floors, seed: int) -> None:
    """Sets `certainty` of every problem that has estimates and their derivatives."""
    for problem in {id(p): p for p in problems}.values():
        if problem.unknowns and problem.columns:
            problem.certainty = certainty(machine, problem, floors, seed)


def calibrated_values(machine: Machine, problems: dict[int, Problem]) -> dict[str, dict[str, Any]]:
    """Base parameters: nominal (as given), estimated value and its interval, by "J_1"."""
    out = {}
    for c, problem in problems.items():
        for j, u in enumerate(problem.unknowns):
            if u.channel in (None, c) and (("." not in u.name) or u.name in machine.base(c)):
                out[f"{u.name}_{c + 1}"] = {"nominal": machine.given(u.name, c), **_interval(problem, j)}
    return out


def at_bounds(problems: dict[int, Problem]) -> list[str]:
    """Estimates at the end of their plausible range, by "J of channel 1"."""
    found = []
    for c, problem in problems.items():
        for u, q in zip(problem.unknowns, problem.q, strict=True):
            if (
                u.channel in (None, c)
                and u.at_bound(float(q))
                and u.high > u.low
                and not ("." in u.name and (q == 0.0 or is_correction(u.name.split(".")[0])))
            ):
                found.append(f"{u.name} of channel {c + 1} ({u.value(float(q)):.3g} {u.unit})")
    return found


def estimated_model(machine: Machine, problems: dict[int, Problem], name: str) -> PlantModel:
    """The model with the estimated values put in."""
    pairs: dict[str, tuple[float, float]] = {}
    for c, problem in problems.items():
        for parameter, value in problem.values(c).items():
            if parameter in machine.own and parameter != "Kq":
                continue
            parameter_of(parameter)
            pair = list(pairs.get(parameter, machine.model.pair(parameter)))
            pair[c] = float(value)
            if "." in parameter and CATALOGUE[parameter.split(".", 1)[0]].scope == "rig":
                pair = [float(value)] * 2
            pairs[parameter] = (pair[0], pair[1])
    return machine.written(machine.model.with_values(pairs, name))


def diagnosis_dict(
    machine: Machine, word: str, named: list[Named], places: list[Place], calibrated: dict[int, Problem], fit: Proof,
    sealed: Proof, looks: Sequence[Look], selection: Selection, corrections: Sequence[Corrected], seconds: float,
    hashes: dict[str, str], warnings: list[str],
) -> dict[str, Any]:  # fmt: skip
    """The content of diagnosis.json; `trials`, `warnings`, `hidden_by_calibration`, `shape_corrections` go beyond the contract.

    Where there are shape corrections, "after" is the model with them, "named" in `gap` the one with the effects alone.
    """
    visible = detectable(looks, machine)
    return {
        "schema": SCHEMA,
        "verdict": word,
        "effects": [vars(n) for n in named],
        "where": [p.as_dict() for p in places],
        "calibrated": calibrated_values(machine, calibrated),
        "gap": {"sealed": sealed.gap, "fit": fit.gap},
        "shape_corrections": [_correction(machine, sealed.machine, calibrated, k) for k in corrections],
        "next_experiment": next_experiment(named, machine, selection),
        "detectable": visible,
        "hidden_by_calibration": hidden_by_calibration(looks),
        "seconds": round(seconds, 1),
        "log_sha256": hashes,
        "trials": [
            {
                "effect": t.effect, "channel": "rig" if t.channel is None else str(t.channel + 1), "round": t.round,
                "gain": round(float(t.gain), 1), "needed": round(float(t.needed), 1), "refitted": t.problem is not None,
                "fate": t.fate,
            }
            for t in selection.trials
        ],
        "warnings": warnings,
    }  # fmt: skip


def _correction(
    machine: Machine, sealed: Machine, final: dict[int, Problem], kept: Corrected
) -> dict[str, Any]:
    """A shape correction: what it corrects, its numbers, and how large it is, as RMS change of the signals on the sealed logs."""
    channels = machine.channels if kept.channel is None else (kept.channel,)
    size: dict[str, float] = {}
    for c in channels:
        for signal, value in changes(sealed, final[c], kept.correction, c).items():
            unit, scale = shown_unit(sealed, signal, c)
            size[f"{signal}_{c + 1}_{unit}"] = value / scale
    return {
        "effect": kept.effect, "correction": kept.correction, "what": CATALOGUE[kept.correction].summary,
        "channel": "rig" if kept.channel is None else str(kept.channel + 1), "note": "shape correction, not physics",
        "parameters": _parameters(final[channels[0]], kept.correction, channels[0]),
        "changes": size, "fall": round(float(kept.fall), 1), "held_out": round(float(kept.held_out), 1),
    }  # fmt: skip


def parameter_text(entry: dict[str, Any]) -> str:
    """`1.14e-04 m (1.11e-04 to 1.17e-04)`."""
    values = [entry["value"], entry["low"], entry["high"]]
    shown = [f"{v:.3g}" if np.isfinite(v) else "none" for v in values]
    unit = "" if entry["unit"] == "1" else f" {entry['unit']}"
    return f"{shown[0]}{unit} ({shown[1]} to {shown[2]})"
