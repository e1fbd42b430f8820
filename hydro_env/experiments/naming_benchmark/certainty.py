"""What whole diagnoses say of their own certainty, against the truth: intervals of parameters, probabilities of names.

A true value outside its interval under a verdict `unknown` is counted apart: something is missing there, and a model that lacks
something has no true parameters.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ...reading import read_json
from ..coverage import by_channel, covered, given_names, percent, reliability_lines

#: Folder beside the answers of a method with the whole diagnosis of each rig.
WHOLE = "whole"


def certainty(answers: Path, truths: Mapping[str, Mapping[str, Any]]) -> dict[str, Any] | None:
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


def lines(found: Mapping[str, Any]) -> list[str]:
    """Two tables in Markdown: intervals, and probabilities where names have any."""
    text = ["| 95 % intervals | parameters | hold the true value |", "|---|---|---|"]
    for verdict, kinds in found["inside"].items():
        for kind, (inside, of) in kinds.items():
            if of:
                which = "verdict `unknown`" if verdict == "unknown" else "all other verdicts"
                text.append(f"| {which} | {kind} | {inside} of {of} ({percent(inside, of)}) |")
    return [*text, "", *reliability_lines(found["names"])]
