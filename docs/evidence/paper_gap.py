"""The paper's own gap: its tables alone give a speed difference of 13 rpm where it reports 175. What could be missing?

    python -m docs.evidence.paper_gap --out DIR

There are no logs, so nothing can be fitted or proved; there are four published facts. Every effect of the catalogue is put on
valve V1, small to as large as is plausible, all in one batch, and asked:

    reach      does any plausible size give the reported 175 rpm in the set-point steps (Fig. 7)?
    again      are the speeds equal again within a second, as the conclusion says?
    threshold  at that size, is there no flow below 300 mA and some by 430 mA, as Fig. 2 and its text say?

What passes the first is what the number of Fig. 7 cannot tell apart; the third fact is of another kind, a measured curve.
"""

from __future__ import annotations

import argparse
from dataclasses import asdict, dataclass
from math import exp, isinf, log
from pathlib import Path
from typing import Any

import numpy as np

from agents.command import run_command
from hydro_env.experiments.reproduce import (
    EQUAL_WITHIN_RPM,
    PUBLISHED_STEPS_RPM,
    SETPOINT_STEPS,
    Traces,
    equal_again_after,
    run_paper,
)  # fmt: skip
from hydro_env.files import write_json
from hydro_env.plant import CATALOGUE, Effect, Parameter, load_model, simulate

#: Shares of the plausible range that are tried, and the width of "equal again", rpm.
SHARES = (0.02, 0.05, 0.1, 0.2, 0.35, 0.5, 0.7, 1.0)
WITHIN_RPM = EQUAL_WITHIN_RPM
AGAIN_S = 1.0
#: Fig. 2 and its text: no flow below the first current, the flow starts at about 400 mA.
NO_FLOW_A, FLOW_A = 0.30, 0.43


@dataclass(frozen=True)
class Answer:
    """What one effect on V1 can do: `largest_rpm` over its plausible sizes; the rest at the size that gives 175 rpm, or None."""

    effect: str
    direction: int
    largest_rpm: float
    parameters: dict[str, float] | None
    peak_rpm: float | None
    equal_again_s: float | None
    threshold_A: float | None
    explains_figure_7: bool
    explains_figure_2: bool


def _sized(p: Parameter, share: float, direction: int) -> float | None:
    """The parameter at a share of its range; None where there is no range in that direction."""
    if not p.carries_size:
        return p.nominal
    up = (p.typical > p.nominal) == (direction > 0)
    end = p.high if up else p.low
    if p.role == "limit":
        return exp(log(p.high) + share * log(p.low / p.high)) if direction > 0 else None
    if end == p.nominal:
        return None
    if p.log and p.nominal > 0.0 and end > 0.0:
        return p.nominal * (end / p.nominal) ** share
    return p.nominal + share * (end - p.nominal)


def _values(effect: Effect, share: float, direction: int) -> dict[str, float] | None:
    found = {p.name: _sized(p, share, direction) for p in effect.parameters}
    return None if any(v is None for v in found.values()) else found  # type: ignore[return-value]


def _columns(rows: list[tuple[Effect, dict[str, float]]], effects: list[Effect]) -> dict[str, np.ndarray]:
    """Values for `run_paper`, (rows, 2): each row's effect on V1, everything else neutral."""
    columns = {
        f"{e.name}.{p.name}": np.full((len(rows), 2), p.nominal) for e in effects for p in e.parameters
    }
    for n, (effect, values) in enumerate(rows):
        for name, value in values.items():
            columns[f"{effect.name}.{name}"][n, 0] = value
    return columns


def paper_gap() -> list[Answer]:
    """All effects of single valves and motors, those that explain most first."""
    effects = [e for e in CATALOGUE.values() if e.scope == "channel" and not getattr(e, "family", "")]
    tries = [
        (effect, direction, share, values)
        for effect in effects
        for direction in (1, -1)
        for share in SHARES
        if (values := _values(effect, share, direction)) is not None
    ]
    model = load_model("paper")
    traces = run_paper(
        model, SETPOINT_STEPS, values=_columns([(e, v) for e, _, _, v in tries], effects), num_rigs=len(tries)
    )
    tables = float(run_paper(model, SETPOINT_STEPS).peak[0])
    found: dict[tuple[str, int], tuple[Effect, float, dict[str, float] | None]] = {}
    for effect in effects:
        for direction in (1, -1):
            own = [n for n, t in enumerate(tries) if t[0] is effect and t[1] == direction]
            if own:
                shares = np.array([0.0, *(tries[n][2] for n in own)])
                peaks = np.array([tables, *traces.peak[own]])
                found[effect.name, direction] = (
                    effect,
                    float(peaks.max()),
                    _crossing(effect, direction, shares, peaks),
                )
    reached = [(key, effect, values) for key, (effect, _, values) in found.items() if values is not None]
    again = _again(model, [(e, v) for _, e, v in reached], effects)
    thresholds = _thresholds([(e, v) for _, e, v in reached], effects)
    answers = []
    for (name, direction), (_, largest, values) in found.items():
        place = next((n for n, (key, _, _) in enumerate(reached) if key == (name, direction)), None)
        if place is None:
            answers.append(Answer(name, direction, largest, None, None, None, None, False, False))
            continue
        peak, settled = again[place]
        near = abs(peak - PUBLISHED_STEPS_RPM) < 0.15 * PUBLISHED_STEPS_RPM
        answers.append(
            Answer(
                name, direction, largest, values, peak, settled, thresholds[place], near,
                NO_FLOW_A <= thresholds[place] <= FLOW_A,
            )
        )  # fmt: skip
    return sorted(answers, key=lambda a: (-a.explains_figure_7, -a.explains_figure_2, a.equal_again_s or 9.0))


def _crossing(
    effect: Effect, direction: int, shares: np.ndarray, peaks: np.ndarray
) -> dict[str, float] | None:
    """The smallest size with the published difference, read off between the tried ones."""
    above = np.flatnonzero(peaks >= PUBLISHED_STEPS_RPM)
    if not above.size or above[0] == 0:
        return None
    n = int(above[0])
    part = (PUBLISHED_STEPS_RPM - peaks[n - 1]) / (peaks[n] - peaks[n - 1])
    return _values(effect, float(shares[n - 1] + part * (shares[n] - shares[n - 1])), direction)


def _again(
    model: Any, rows: list[tuple[Effect, dict[str, float]]], effects: list[Effect]
) -> list[tuple[float, float]]:
    """Peak (rpm) and longest time until equal again (s) of each row."""
    if not rows:
        return []
    traces: Traces = run_paper(model, SETPOINT_STEPS, values=_columns(rows, effects), num_rigs=len(rows))
    times = equal_again_after(traces, SETPOINT_STEPS, WITHIN_RPM).max(axis=0)
    return [(float(p), float(t)) for p, t in zip(traces.peak, times, strict=True)]


def _thresholds(rows: list[tuple[Effect, dict[str, float]]], effects: list[Effect]) -> list[float]:
    """Current (A) at which V1's flow first exceeds 1 % of its rated flow on a slow ramp, inf where it never does."""
    if not rows:
        return []
    model, period = load_model("paper"), 1e-3
    command = np.linspace(0.0, model.value("u_rated", 0), 12001)[:, None] * np.ones(2)
    out = simulate(
        model, command, None, period, values=_columns(rows, effects), num_rigs=len(rows), record=("current", "flow")
    )  # fmt: skip
    rated = simulate(model, command, None, period, record=("flow",))["flow"][-1, 0, 0]
    found = []
    for n in range(len(rows)):
        open_ = np.flatnonzero(np.abs(out["flow"][:, n, 0]) > 0.01 * abs(rated))
        found.append(float(out["current"][open_[0], n, 0]) if open_.size else float("inf"))
    return found


def table(answers: list[Answer]) -> str:
    """The answer in words and lines."""
    seven = [a for a in answers if a.explains_figure_7]
    both = [a for a in seven if a.explains_figure_2]
    lines = [
        f"{len({a.effect for a in seven})} of {len({a.effect for a in answers})} effects on V1, at a plausible size, give the "
        f"published {PUBLISHED_STEPS_RPM:g} rpm:",
        *(
            f"  {a.effect:<24}" + ", ".join(f"{k} {v:.3g}" for k, v in (a.parameters or {}).items())
            + f"; equal again after {a.equal_again_s:.2f} s; flow from {1e3 * (a.threshold_A or 0.0):.0f} mA"
            for a in seven
        ),
        "Figure 7's number alone cannot tell these apart; equal again within the second that the paper names: "
        + (", ".join(dict.fromkeys(a.effect for a in seven if (a.equal_again_s or 9.0) <= AGAIN_S)) or "none of them")
        + ".",
        "Fig. 2 says that no flow comes below 300 mA. At the size that Fig. 7 asks for it would: "
        + (", ".join(a.effect for a in both) if both else "none of them")
        + ".",
        ""
        if both
        else "So no single effect of V1 alone meets both figures. The flow of Fig. 2 starts late enough only with several times "
        "that overlap, which V2 must then have too: Fig. 7 sees the difference of the two valves, Fig. 2 each one's own.",
        "A log of command, current, pressure and speed of one slow triangle on each valve would decide.",
    ]  # fmt: skip
    return "\n".join(line for line in lines if line)


def run(out: Path) -> list[Answer]:
    """Writes paper_gap.json to `out`."""
    answers = paper_gap()
    out.mkdir(parents=True, exist_ok=True)
    rows = [
        {k: (None if isinstance(v, float) and isinf(v) else v) for k, v in asdict(a).items()} for a in answers
    ]
    write_json(out / "paper_gap.json", {"published_rpm": PUBLISHED_STEPS_RPM, "answers": rows})
    return answers


def main() -> None:
    parser = argparse.ArgumentParser(prog="paper_gap", description="What could the paper's tables lack?")
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args()
    print(table(run(given.out)))


if __name__ == "__main__":
    run_command(main)
