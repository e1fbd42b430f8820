"""Coverage of intervals and reliability of probabilities: diagnoses of practice rigs against the truth.

A probability is believed as far as, of the names given with it, that share is right (reliability diagram). A name is right if it
is hidden on that channel; one that is declared indistinguishable from the hidden one is not, since such names share their
probability. Names of a verdict `effects` are answers; those that an `unknown` lists are guesses, and are counted apart.
"""

from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from typing import Any

from scipy.stats import binomtest

#: Edges of the bins of probability.
BINS = (0.0, 0.3, 0.5, 0.7, 0.9, 1.0)

#: A name that was given: its probability and whether it is right.
Point = tuple[float, bool]


def by_channel(effects: Iterable[Mapping[str, Any]]) -> set[tuple[str, str]]:
    """(effect, channel) of the effects of a truth, a diagnosis or an answer; "both" counts as channels 1 and 2."""
    return {
        (e["name"], c) for e in effects for c in (("1", "2") if e["channel"] == "both" else (e["channel"],))
    }


def covered(data: Mapping[str, Any], truth: Mapping[str, Any]) -> dict[str, Any]:
    """How many true values (of truth.json) lie inside the published intervals of a diagnosis (of diagnosis.json).

    `base` and `effects` are [inside, all]: base parameters that were calibrated, and parameters of effects that were named
    rightly, channel and all. `outside` names those that are not inside.
    """
    wrong = truth["base_parameters"]
    true = {(h["name"], h["channel"]): h["parameters"] for h in truth["effects"]}
    published = [
        ("base", n, wrong[n]["value"] if n in wrong else interval["nominal"], interval)
        for n, interval in data["calibrated"].items()
    ]
    published += [
        ("effects", f"{e['name']}.{n}", true[e["name"], e["channel"]][n]["value"], interval)
        for e in data["effects"]
        if (e["name"], e["channel"]) in true
        for n, interval in e["parameters"].items()
    ]
    found: dict[str, Any] = {"base": [0, 0], "effects": [0, 0], "outside": []}
    for kind, name, value, interval in published:
        inside = value is not None and interval["low"] <= value <= interval["high"]
        found[kind] = [found[kind][0] + inside, found[kind][1] + 1]
        found["outside"] += [] if inside else [name]
    return found


def wilson(count: int, of: int) -> tuple[float, float]:
    """Wilson's interval (1927) of a share, at 95 %."""
    if of == 0:
        return 0.0, 1.0
    interval = binomtest(count, of).proportion_ci(method="wilson")
    return float(interval.low), float(interval.high)


def percent(count: int, of: int) -> str:
    """A share and its interval, as text."""
    low, high = (round(100 * v) for v in wilson(count, of))
    return f"{round(100 * count / of)} %; {low} to {high} %"


# --- probabilities of names -------------------------------------------------------------------------------------------
def given_names(effects: Iterable[Mapping[str, Any]], hidden: set[tuple[str, str]]) -> list[Point]:
    """The names of a diagnosis that have a probability, against the set of hidden (effect, channel)."""
    given = [e for e in effects if e.get("probability") is not None]
    return [(float(e["probability"]), by_channel([e]) <= hidden) for e in given]


def reliability(points: Sequence[Point]) -> list[dict[str, Any]]:
    """For every bin that holds names: its edges, mean probability, and how many are right."""
    found = []
    for low, high in pairwise(BINS):
        own = [(p, right) for p, right in points if low <= p < high or p == high == BINS[-1]]
        if own:
            count, mean = sum(right for _, right in own), sum(p for p, _ in own) / len(own)
            found.append({"from": low, "to": high, "names": len(own), "right": count, "mean": mean})
    return found


def reliability_lines(named: Mapping[str, Sequence[Point]]) -> list[str]:
    """A table in Markdown, empty where no name has a probability."""
    lines = ["| names | probability | number | mean probability | right |", "|---|---|---|---|---|"]
    for what, points in named.items():
        for b in reliability(points):
            span, right = f"{b['from']:g} to {b['to']:g}", f"{b['right']} ({percent(b['right'], b['names'])})"
            lines.append(f"| {what} | {span} | {b['names']} | {b['mean']:.2f} | {right} |")
    return lines if len(lines) > 2 else []
