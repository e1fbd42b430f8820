"""A diagnosis against the truth of a practice rig, and what is asked of all trials together."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from statistics import NormalDist
from typing import Any

from hydro_env.experiments import coverage
from hydro_env.experiments.coverage import by_channel
from hydro_env.plant import CATALOGUE, parameter_of

#: A held-out speed error counts as explained within this multiple of the noise.
HELD_OUT_WITHIN = 1.3
#: Width of an interval of 90 % of a normal distribution, as a share of that of 95 %.
WIDTH_90 = NormalDist().inv_cdf(0.95) / NormalDist().inv_cdf(0.975)


def judge(
    data: Mapping[str, Any], truth: set[tuple[str, str]], expected: str, unlisted: bool = False,
    form: Mapping[str, float] | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Compares a diagnosis (the content of diagnosis.json) with the set of hidden (effect, channel).

    `form` is what the true values in the catalogue's form leave of each speed (`running.practice_logs`).
    """
    expected = "unknown" if unlisted else expected
    named = by_channel(data["effects"])
    tied = by_channel(
        {**e, "name": n} for e in data["effects"] for n in (e["name"], *e["indistinguishable_from"])
    )
    word = data["verdict"]
    names = word == "effects" and truth <= tied and len(named) <= len(truth)
    # Declared not to be told from calibration: true, but no name was given, so it is counted apart.
    hidden = {(n, c) for n, channels in data.get("hidden_by_calibration", {}).items() for c in channels}
    declared = word == "calibration" and bool(truth) and truth <= hidden
    twins = {(t, c) for n, c in named for t in CATALOGUE[n].indistinguishable_from}
    return {
        "verdict": word,
        "expected": expected,
        "named": sorted(f"{n}:{c}" for n, c in named),
        "right": word == "unknown" if unlisted else word == expected and named == truth,
        "set": names,
        "declared_set": names or declared,
        "open": word == "unknown" or declared or (word == "effects" and len(named) == 1 and truth <= twins),
        "channel": bool(named) and {c for _, c in named} == {c for _, c in truth},
        "alarm": bool(named) and not truth,
        "both": word == "effects" and truth <= tied,
        **_gap(data["gap"]["sealed"], form or {}),
    }


def _gap(gap: Mapping[str, Mapping[str, float]], form: Mapping[str, float]) -> dict[str, Any]:
    """What the diagnosis leaves on the held-out log, against the noise, the true values and the placebo."""
    speeds = {k: v for k, v in gap.items() if k.startswith("speed")}
    least = {k: max(form.get(k, 0.0), v["noise"]) for k, v in speeds.items()}
    score = {
        m: sum(math.log(max(v[m] / v["noise"], 1.0)) for v in gap.values()) for m in ("after", "placebo")
    }
    return {
        "sealed": all(v["after"] <= HELD_OUT_WITHIN * v["noise"] for v in speeds.values()),
        "sealed_named": all(
            v.get("named", v["after"]) <= HELD_OUT_WITHIN * v["noise"] for v in speeds.values()
        ),
        "sealed_form": all(v["after"] <= HELD_OUT_WITHIN * least[k] for k, v in speeds.items()),
        "placebo": score["placebo"] < score["after"] - 0.05,
        "worst": max((v["after"] / v["noise"] for v in speeds.values()), default=math.nan),
        "form": max((least[k] / v["noise"] for k, v in speeds.items()), default=math.nan),
    }


# --- intervals --------------------------------------------------------------------------------------------------------
def covered(data: Mapping[str, Any], truth: Mapping[str, Any]) -> dict[str, Any]:
    """`coverage.covered` with `at_90`: how many true values of each kind are inside intervals of 90 %, which are the published
    ones of 95 % narrowed as those of a normal distribution."""
    counts = coverage.covered(_narrowed(data), truth)
    return {**coverage.covered(data, truth), "at_90": {kind: counts[kind][0] for kind in ("base", "effects")}}


def _narrowed(data: Mapping[str, Any]) -> dict[str, Any]:
    """A diagnosis with intervals of 90 %."""
    effects = [
        {**e, "parameters": {n: _narrow(f"{e['name']}.{n}", own) for n, own in e["parameters"].items()}}
        for e in data["effects"]
    ]
    calibrated = {n: _narrow(n.rsplit("_", 1)[0], own) for n, own in data["calibrated"].items()}
    return {"calibrated": calibrated, "effects": effects}


def _narrow(name: str, entry: Mapping[str, float]) -> dict[str, float]:
    """The interval of a parameter, `D` or `dead_zone.overlap`, narrowed in the scale in which it varies."""
    log = parameter_of(name).log
    value, ends = entry["value"], (entry["low"], entry["high"])
    if log and min(value, *ends) > 0.0:
        low, high = (value * (end / value) ** WIDTH_90 for end in ends)
    else:
        low, high = (value + WIDTH_90 * (end - value) for end in ends)
    return {**entry, "low": low, "high": high}


# --- what is asked for --------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Criterion:
    """`what` is asked for, as a share of the trials of `groups` whose row has a true `key`: at least `target`, or `at_most`
    so much; no target: reported only."""

    what: str
    key: str
    groups: tuple[str, ...]
    target: float | None = None
    at_most: bool = False


CRITERIA = (
    Criterion("correct effect, or listed as indistinguishable from the named one", "set", ("medium",), 0.95),
    Criterion("correct effect", "right", ("medium",)),
    Criterion("the same, or `calibration` that lists the effect as hidden by calibration", "declared_set", ("medium",)),
    Criterion("correct channel", "channel", ("medium",), 0.95),
    Criterion(
        "false alarm: an effect named though there is none (at most)", "alarm", ("nothing", "parameters"), 0.02, at_most=True
    ),
    Criterion("`unknown` where the effect is not among the candidates", "right", ("unlisted",), 0.90),
    Criterion("`unknown`, or an effect declared indistinguishable from it", "open", ("unlisted",)),
    Criterion("`unknown` where no indistinguishable effect is a candidate either", "right", ("no_twins",)),
    Criterion("both of two effects", "both", ("two",), 0.85),
    Criterion("held-out speed error within 1.3 times the noise", "sealed", ("medium",), 0.90),
    Criterion("the same with the named effects alone, without form corrections", "sealed_named", ("medium",)),
    Criterion("held-out speed error within 1.3 times what the true values leave", "sealed_form", ("medium",)),
    Criterion("placebo better than the named effects (at most)", "placebo", ("medium", "two"), 0.0, at_most=True),
)  # fmt: skip


def summary(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """What was reached beside each criterion: counts over the trials of its groups that were run."""
    found = []
    for criterion in CRITERIA:
        own = [r for r in rows if r["group"] in criterion.groups]
        about = asdict(criterion) | {"groups": list(criterion.groups)}
        found.append(about | {"count": sum(bool(r.get(criterion.key)) for r in own), "trials": len(own)})
    return found
