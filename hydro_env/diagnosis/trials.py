"""How often the diagnosis is right: practice logs of the independent simulator, one hidden effect at a time.

    python -m hydro_env.diagnosis.trials --out DIR [--effects dead_zone load_bias ...] [--severity medium] [--base-error 10]

Every effect is hidden on one channel (alternately 1 and 2) of a rig whose base parameters differ from the given model's by up
to `base-error` percent; beside them come rigs with nothing hidden and rigs with wrong parameters only. The effects act in
the reference simulator's "different" forms, which are not the ones that are fitted. Writes trials.json after every case.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..files import write_json
from ..plant import CATALOGUE
from .command import diagnose
from .hide import make_practice

__all__ = ["run_case", "run_trials", "table"]


def run_case(
    effects: Sequence[str],
    *,
    severity: str = "medium",
    base_error: float = 0.1,
    seed: int = 0,
    duration: float = 12.0,
) -> dict[str, Any]:
    """Hides, diagnoses and compares. `right`: verdict and the set of (effect, channel) are the truth's; `rivals`: they are
    once every named effect may stand for the ones it is said to be indistinguishable from."""
    practice = make_practice(effects, severity=severity, base_error=base_error, seed=seed, duration=duration)
    begin = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        practice.write(Path(folder))
        logs = [Path(folder) / f"{name}.csv" for name in ("fit_1", "fit_2", "sealed")]
        data = diagnose(logs[:2], logs[2:], model=Path(folder) / "model.yaml").data
    truth = {(h.name, c) for h in practice.hidden for c in _sides(h.channel)}
    named = {(e["name"], c) for e in data["effects"] for c in _sides(e["channel"])}
    tied = {
        (n, c)
        for e in data["effects"]
        for n in (e["name"], *e["indistinguishable_from"])
        for c in _sides(e["channel"])
    }
    speeds = {k: v for k, v in data["gap"]["sealed"].items() if k.startswith("speed")}
    worst = max(speeds, key=lambda k: speeds[k]["before"])
    return {
        "hidden": sorted(f"{n}:{c}" for n, c in truth),
        "verdict": data["verdict"],
        "expected": practice.truth["verdict"],
        "named": sorted(f"{n}:{c}" for n, c in named),
        "right": data["verdict"] == practice.truth["verdict"] and named == truth,
        "rivals": truth <= tied and len(named) <= len(truth),
        "found": truth <= named,
        "sealed": {worst: speeds[worst]},
        "cpu_s": round(time.process_time() - begin, 1),
        "severity": severity, "base_error": base_error, "seed": seed,
    }  # fmt: skip


def _sides(channel: str) -> tuple[str, ...]:
    return ("1", "2") if channel == "both" else (channel,)


def run_trials(
    out: Path, effects: Sequence[str], *, severity: str = "medium", base_error: float = 0.1, seed: int = 100
) -> list[dict[str, Any]]:
    """All cases one after the other; trials.json holds what is done so far."""
    from tqdm import tqdm

    out.mkdir(parents=True, exist_ok=True)
    cases: list[tuple[list[str], float]] = [([], 0.0), ([], base_error)]
    for number, name in enumerate(effects):
        cases.append(([name if CATALOGUE[name].scope == "rig" else f"{name}:{1 + number % 2}"], base_error))
    rows: list[dict[str, Any]] = []
    for number, (hidden, wrong) in enumerate(tqdm(cases, unit="case")):
        rows.append(run_case(hidden, severity=severity, base_error=wrong, seed=seed + number))
        write_json(out / "trials.json", {"schema": "hydro_env/trials/1", "rows": rows})
    return rows


def table(rows: Sequence[dict[str, Any]]) -> str:
    """One line for each case and a line of totals."""
    lines = []
    for row in rows:
        mark = (
            "right"
            if row["right"]
            else "tied"
            if row["rivals"] and row["hidden"]
            else "and more"
            if row["found"] and row["hidden"]
            else "wrong"
        )
        key, gap = next(iter(row["sealed"].items()))
        hidden = ", ".join(row["hidden"]) or f"nothing ({row['expected']})"
        lines.append(
            f"{hidden:<34}{mark:<10}{row['verdict']:<13}{', '.join(row['named']) or '-':<60}"
            f"{key}: {gap['before']:.3g} -> {gap['after']:.3g} (noise {gap['noise']:.2g})"
        )
    lines.append(f"{sum(r['right'] for r in rows)} of {len(rows)} right")
    return "\n".join(lines)


def _main() -> None:
    parser = argparse.ArgumentParser(description="How often the diagnosis is right.")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--effects", nargs="*", default=[e.name for e in CATALOGUE.values() if not e.family])
    parser.add_argument("--severity", default="medium")
    parser.add_argument("--base-error", type=float, default=10.0, help="percent")
    parser.add_argument("--seed", type=int, default=100)
    given = parser.parse_args()
    print(
        table(
            run_trials(
                given.out,
                given.effects,
                severity=given.severity,
                base_error=given.base_error / 100.0,
                seed=given.seed,
            )
        )
    )


if __name__ == "__main__":
    _main()
