"""Answers against the truth: names, channels, false alarms, `unknown`, held-out error and time, with intervals.

A name counts as right if it is the hidden one or one that the catalogue declares indistinguishable from it. Intervals of
shares are Wilson's, those of medians come from a bootstrap over rigs; both at 95 %.

Of whole diagnoses it is counted, too, how certain they are: how often intervals hold the true value, and how often names are
right, by their probability. A true value outside its interval under a verdict `unknown` is counted apart: something is missing
there, and a model that lacks something has no true parameters.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...arrays import Floats
from ...errors import InputError
from ...plant import CATALOGUE, load_model, simulate
from ...reading import read_json
from ...units import RPM
from ..coverage import by_channel, covered, given_names, percent, reliability_lines, wilson
from .answers import WHOLE, read_answers
from .dialogue import answers_of
from .sets import columns_of, read_commands, read_set, read_truth

SCHEMA = "hydro_env/naming_scores/1"
#: A held-out error within this multiple of the noise counts as explained.
WITHIN = 1.3
RESAMPLES = 2000


def judge(answer: Mapping[str, Any], truth: Mapping[str, Any], error: float | None) -> dict[str, Any]:
    """One answer against the truth of its rig; `error` is the held-out error over the noise."""
    hidden, named = by_channel(truth["effects"]), by_channel(answer["effects"])
    names = {n for n, _ in named}
    accepted = {n: {n, *CATALOGUE[n].indistinguishable_from} for n, _ in hidden}
    matched = [n for n, alike in accepted.items() if names & alike]
    listed = truth["kind"] in ("one", "two")
    strange = [n for n in names if not any(n in alike for alike in accepted.values())]
    return {
        "rig": truth["rig"],
        "kind": truth["kind"],
        "hidden": sorted(f"{n}:{c}" for n, c in hidden),
        "verdict": answer["verdict"],
        "named": sorted(f"{n}:{c}" for n, c in named),
        "name": listed and len(matched) == len(accepted) and len(names) <= len(accepted),
        "first": listed and _most_probable(answer) in set().union(*accepted.values()),
        "channel": listed and bool(named) and {c for _, c in named} == {c for _, c in hidden},
        "false_name": bool(strange) or (truth["kind"] == "unlisted" and bool(names)),
        "alarm": not hidden and bool(named),
        "unknown": truth["kind"] == "unlisted" and answer["verdict"] == "unknown",
        "error": error,
        "seconds": answer.get("seconds"),
    }


def _most_probable(answer: Mapping[str, Any]) -> str | None:
    """The name with the largest probability, the first of those without any; None where nothing is named."""
    named = max(answer["effects"], key=lambda e: e.get("probability", 0.0), default=None)
    return None if named is None else str(named["name"])


def _held_out_error(folder: Path, answers: Path, answer: Mapping[str, Any], noise: float) -> float | None:
    """RMS of the speed's error on the scored part, over both channels and over the noise; None where nothing was predicted."""
    name = answer["rig"]
    speeds = ("speed_1_rpm", "speed_2_rpm")
    measured = columns_of(folder / "truth" / f"{name}.csv", ("time_s", *speeds))
    if answer.get("prediction"):
        path = answers / answer["prediction"]
        rows = len(columns_of(folder / "rigs" / name / "commands.csv", ("time_s",)))
        found = columns_of(path, ("time_s", *speeds))
        if len(found) != rows:
            raise InputError(f"{path}: {len(found)} rows, expected {rows}, one for each of commands.csv")
        found = found[-len(measured) :]
        if np.max(np.abs(found[:, 0] - measured[:, 0])) > 1e-4:
            raise InputError(f"{path}: time_s differs from that of commands.csv")
        predicted = found[:, 1:]
    elif answer.get("model"):
        _, command, load, period = read_commands(folder / "rigs" / name)
        model = load_model(answers / answer["model"])
        speed = simulate(model, command, load, period, record=["measured_speed"])["measured_speed"]
        predicted = speed[-len(measured) :, 0] / RPM
    else:
        return None
    return float(np.sqrt(np.mean((predicted - measured[:, 1:]) ** 2)) / noise)


def score(folder: Path, methods: Mapping[str, Path], first: int | None = None) -> dict[str, Any]:
    """Scores folders of answers, by method, to the set in `folder` or to its `first` rigs; the content of naming.json.

    InputError for whatever is missing or malformed.
    """
    whole = list(read_set(folder)["rigs"])
    rigs, seed = whole[:first], read_json(folder / "truth" / "set.json", "the seed of a set")["seed"]
    every = {method: read_answers(path, whole, first) for method, path in methods.items()}
    truths = {name: read_truth(folder, name) for name in rigs}
    rows = []
    for method, found in every.items():
        for name, truth in truths.items():
            error = _held_out_error(folder, methods[method], found[name], truth["noise_rpm"])
            questions = len(answers_of(methods[method] / name))
            rows.append({"method": method, **judge(found[name], truth, error), "questions": questions})
    return {
        "schema": SCHEMA, "seed": seed, "rigs": len(rigs), "summary": summary(rows),
        "certainty": {m: c for m, path in methods.items() if (c := _certainty(path, truths)) is not None},
        "rows": rows,
    }  # fmt: skip


# --- all rigs together --------------------------------------------------------------------------------------------------
#: What is counted of the rows, and over which kinds of rigs.
_SHARES = {
    "name": ("one", "two"), "first": ("one", "two"), "channel": ("one", "two"), "alarm": ("nothing", "parameters"),
    "unknown": ("unlisted",), "false_name": ("one", "two", "unlisted", "nothing", "parameters"),
}  # fmt: skip


def summary(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Counts and intervals by method."""
    found = []
    for method in dict.fromkeys(r["method"] for r in rows):
        own = [r for r in rows if r["method"] == method]
        entry: dict[str, Any] = {"method": method}
        for what, kinds in _SHARES.items():
            asked = [bool(r[what]) for r in own if r["kind"] in kinds]
            entry[what] = {"count": sum(asked), "of": len(asked), "ci95": wilson(sum(asked), len(asked))}
        errors = np.array([r["error"] for r in own if r["error"] is not None])
        entry["within"] = {"count": int((errors <= WITHIN).sum()), "of": len(errors)}
        entry["error"], entry["questions"] = _median(errors), float(np.mean([r["questions"] for r in own]))
        entry["seconds"] = _median(np.array([r["seconds"] for r in own if r["seconds"] is not None]))
        found.append(entry)
    return found


def _median(values: Floats) -> dict[str, Any] | None:
    if not len(values):
        return None
    rng = np.random.default_rng(0)
    drawn = np.median(values[rng.integers(0, len(values), (RESAMPLES, len(values)))], axis=1)
    return {"median": float(np.median(values)), "ci95": np.quantile(drawn, (0.025, 0.975)).tolist()}


def table(scores: Mapping[str, Any]) -> str:
    """The summary as a table in Markdown, whom the first method is ahead of on names, and what methods say of their certainty."""
    head = [
        "method", "names right", "most probable name right",
        "channel right", "false alarms", "`unknown` right", "rigs with a false name",
        "held-out error, times the noise", f"within {WITHIN:g}", "time, s",
    ]  # fmt: skip
    asked = [entry.get("questions", 0.0) for entry in scores["summary"]]
    head += ["questions, mean"] * any(asked)
    text = ["| " + " | ".join(head) + " |", "|" + " --- |" * len(head)]
    for entry, questions in zip(scores["summary"], asked, strict=True):
        within = f"{entry['within']['count']} of {entry['within']['of']}"
        cells = [f"`{entry['method']}`", *(_share(entry[what]) for what in _SHARES)]
        cells += [_middle(entry["error"]), within, _middle(entry["seconds"])]
        cells += [f"{questions:.2g}"] * any(asked)
        text.append("| " + " | ".join(cells) + " |")
    text += ["", *_ahead(scores["summary"])]
    for method, found in scores["certainty"].items():
        text += ["", f"What `{method}` says of its own certainty:", "", *_certainty_lines(found)]
    return "\n".join(text)


def _share(entry: Mapping[str, Any]) -> str:
    low, high = (round(100 * v) for v in entry["ci95"])
    return f"{entry['count']} of {entry['of']} ({low} to {high} %)"


def _middle(entry: Mapping[str, Any] | None) -> str:
    if entry is None:
        return "-"
    low, high = entry["ci95"]
    return f"{entry['median']:.3g} ({low:.3g} to {high:.3g})"


def _ahead(entries: Sequence[Mapping[str, Any]]) -> list[str]:
    """Where the first method is ahead of the others on names at no more false alarms, and where not."""
    if len(entries) < 2:
        return []
    first, *others = entries
    names: dict[bool, list[str]] = {True: [], False: []}
    for other in others:
        more = first["name"]["count"] > other["name"]["count"]
        names[more and first["alarm"]["count"] <= other["alarm"]["count"]].append(f"`{other['method']}`")
    says = {
        True: "names more, at no more false alarms, than",
        False: "does not name more, or has more false alarms, than",
    }
    return [f"`{first['method']}` {says[ahead]} {', '.join(own)}." for ahead, own in names.items() if own]


# --- what whole diagnoses say of their own certainty ---------------------------------------------------------------------
def _certainty(answers: Path, truths: Mapping[str, Mapping[str, Any]]) -> dict[str, Any] | None:
    """Names by "answers" and "guesses" as (probability, right), and true values inside their intervals as [inside, all].

    None for a method that leaves no whole diagnoses.
    """
    found: dict[str, Any] = {
        "names": {"answers": [], "guesses": []},
        "inside": {w: {"base": [0, 0], "effects": [0, 0]} for w in ("confirmed", "unknown")},
        "outside": {},
    }
    for name, truth in truths.items():
        path = answers / WHOLE / f"{name}.json"
        if not path.exists():
            return None
        data = read_json(path, "a whole diagnosis")
        unknown = data["verdict"] == "unknown"
        points = given_names(data["effects"], by_channel(truth["effects"]))
        found["names"]["answers" if data["verdict"] == "effects" else "guesses"] += points
        counts = covered(data, truth)
        for kind, total in found["inside"]["unknown" if unknown else "confirmed"].items():
            total[:] = [a + b for a, b in zip(total, counts[kind], strict=True)]
        if not unknown:
            for symbol in counts["outside"]:
                short = symbol if "." in symbol else symbol.rsplit("_", 1)[0]
                found["outside"][short] = found["outside"].get(short, 0) + 1
    return found


def _certainty_lines(found: Mapping[str, Any]) -> list[str]:
    """Two tables in Markdown: intervals, and probabilities where names have any."""
    text = ["| 95 % intervals | parameters | hold the true value |", "|---|---|---|"]
    for verdict, kinds in found["inside"].items():
        for kind, (inside, of) in kinds.items():
            if of:
                which = "verdict `unknown`" if verdict == "unknown" else "all other verdicts"
                text.append(f"| {which} | {kind} | {inside} of {of} ({percent(inside, of)}) |")
    return [*text, "", *reliability_lines(found["names"])]
