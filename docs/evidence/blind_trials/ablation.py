"""What a rule of the diagnosis is worth: the same trials with it and without it, pair by pair.

`--out DIR --without-rule NAME ...` keeps the trials without these rules in DIR/without_NAME+..., `--constant NAME=VALUE` those
with another value of a constant likewise; `--out DIR --ablation`
compares every such folder with the trials of DIR itself and writes DIR/ablation.json and DIR/ablation.md.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from scipy.stats import binomtest

from hydro_env.errors import InputError
from hydro_env.files import write_json, write_text

from .cases import WITH_NAME
from .running import rows_of
from .tables import markdown, share

SCHEMA = "hydro_env/ablation/1"
_PREFIX = "without_"

Row = Mapping[str, Any]
Pair = tuple[Row, Row]


def folder_without(out: Path, rules: Sequence[str]) -> Path:
    """Where the trials without these rules are kept."""
    return out / (_PREFIX + "+".join(sorted(rules))) if rules else out


def ablation(baseline: Sequence[Row], without: Mapping[str, Sequence[Row]]) -> dict[str, Any]:
    """Compares trials `without` rules, {names of rules: rows}, with the same trials of the `baseline`, on those that both ran.

    Counts are [with the rule, without it]. `p` is the chance of so uneven a number of names won and lost by luck (exact
    sign test, two-sided). Ratios are geometric means over the pairs, without over with.
    """
    return {"schema": SCHEMA, "rows": [_compared(name, baseline, rows) for name, rows in without.items()]}


def _compared(name: str, baseline: Sequence[Row], rows: Sequence[Row]) -> dict[str, Any]:
    before = {_key(r): r for r in baseline}
    pairs = [(before[_key(r)], r) for r in rows if _key(r) in before]
    named = [p for p in pairs if p[0]["group"] in WITH_NAME]
    empty = [p for p in pairs if p[0]["group"] in ("nothing", "parameters")]
    missing = [p for p in pairs if p[0]["expected"] == "unknown"]
    lost = sum(a["right"] and not b["right"] for a, b in named)
    won = sum(b["right"] and not a["right"] for a, b in named)
    return {
        "rules": name,
        "pairs": len(pairs),
        "with_effect": len(named),
        "right": _counts(named, "right"),
        "set": _counts(named, "set"),
        "lost": lost,
        "won": won,
        "p": float(binomtest(lost, lost + won).pvalue) if lost + won else 1.0,
        "nothing_hidden": len(empty),
        "alarm": _counts(empty, "alarm"),
        "missing": len(missing),
        "unknown": _counts(missing, "right"),
        "unknown_though_listed": [sum(p[n]["verdict"] == "unknown" for p in named) for n in (0, 1)],
        "sealed_error_ratio": _ratio(pairs, "worst"),
        "cpu_s": [round(sum(p[n]["cpu_s"] for p in pairs), 1) for n in (0, 1)],
        "cpu_ratio": _ratio(pairs, "cpu_s"),
        "covered": [_covered([p[n] for p in pairs]) for n in (0, 1)],
        "changed": [
            {"group": a["group"], "hidden": a["hidden"], "seed": a["seed"], "with": a["named"], "without": b["named"]}
            for a, b in pairs
            if (a["verdict"], a["named"]) != (b["verdict"], b["named"])
        ],
    }  # fmt: skip


def _key(row: Row) -> tuple[str, int]:
    return row["group"], row["seed"]


def _counts(pairs: Sequence[Pair], key: str) -> list[int]:
    return [sum(bool(p[n][key]) for p in pairs) for n in (0, 1)]


def _ratio(pairs: Sequence[Pair], key: str) -> float | None:
    logs = [math.log(b[key] / a[key]) for a, b in pairs if a[key] > 0.0 and b[key] > 0.0]
    return math.exp(sum(logs) / len(logs)) if logs else None


def _covered(rows: Sequence[Row]) -> list[int]:
    """True values inside the intervals, and all of them."""
    return [sum(r["covered"][kind][k] for r in rows for kind in ("base", "effects")) for k in (0, 1)]


def ablation_table(found: Mapping[str, Any]) -> str:
    """The comparison in Markdown: in each cell with the rule, then without it."""
    header = [
        "rule switched off", "trials", "correct effect", "lost, won (p)", "correct or indistinguishable", "false alarms",
        "`unknown` where the effect is no candidate", "`unknown` where it is one", "held-out error, ratio",
        "true values in the intervals", "CPU, s",
    ]  # fmt: skip
    cells = []
    for r in found["rows"]:
        ratio = "-" if r["sealed_error_ratio"] is None else f"{r['sealed_error_ratio']:.3f}"
        cells.append(
            [
                r["rules"], r["pairs"], _both(r["right"], r["with_effect"]), f"{r['lost']}, {r['won']} ({r['p']:.2g})",
                _both(r["set"], r["with_effect"]), _both(r["alarm"], r["nothing_hidden"]), _both(r["unknown"], r["missing"]),
                _both(r["unknown_though_listed"], r["with_effect"]), ratio,
                ", ".join(share(*counts) for counts in r["covered"]), f"{r['cpu_s'][0]:.0f}, {r['cpu_s'][1]:.0f}",
            ]
        )  # fmt: skip
    return "\n".join(markdown(header, cells)) + "\n"


def _both(counts: Sequence[int], of: int) -> str:
    return f"{counts[0]}, {counts[1]} of {of}" if of else "-"


def write_ablation(out: Path) -> dict[str, Any]:
    """Compares all that is in a folder of trials; InputError if it holds no trials without a rule."""
    folders = sorted(p for p in out.glob(f"{_PREFIX}*") if p.is_dir())
    without = {p.name.removeprefix(_PREFIX): rows_of(p) for p in folders}
    if not without:
        raise InputError(f"{out}: no folder {_PREFIX}NAME; run the trials with --without-rule NAME first")
    found = ablation(rows_of(out), without)
    write_json(out / "ablation.json", found)
    write_text(out / "ablation.md", ablation_table(found))
    return found
