"""How often the diagnosis is right: blind trials on practice logs of the independent simulator, and the table of them.

    python -m hydro_env.experiments.blind_trials --out DIR [--groups medium two ...] [--seed N] [--minutes M] [--slice K/N]
        [--jobs N] [--empty N] [--only SEED FIRST-LAST ...]
    python -m hydro_env.experiments.blind_trials --out DIR --write docs         # publishes what is in DIR, no new trial
    python -m hydro_env.experiments.blind_trials --out DIR --logs LOGS --make   # practice logs for later trials only

A trial hides effects in a rig whose base parameters are up to 15 % off the given model's, each channel alone, with noise and
quantisation. The rig is `plant.reference` with the "different" forms: SciPy's stiff solver, no line of physics in common
with what is fitted, and every effect in another shape than the catalogue's where one exists. Groups of trials:

    nothing     nothing hidden and the model right
    parameters  nothing hidden, only parameters wrong
    medium      every effect at medium severity on one channel (alternately 1 and 2)
    small, large  the same at half and twice the size
    two         two effects at once
    unlisted    every effect hidden at medium severity and taken out of the candidates
    speed_only, current_too   every effect, only command and speed (and current) in the log, no load applied
    quiet, noisy  every effect with a tenth of the noise and ten times the noise
    no_twins    every effect that the catalogue declares not to be told from others, these taken out of the candidates too

Trials that DIR holds already are not run again, so a run may be interrupted and continued. Slices write files of their own
(trials_K_of_N.json) and may run side by side. Each row says by a hash of the sources which method it ran on, and how much the
*true* values in the catalogue's form leave on the sealed log (`form`): less than that no naming of effects can reach.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import math
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..diagnosis import diagnose
from ..files import write_json, write_text
from ..plant import CATALOGUE, simulate
from ..practice.generate import Practice, make_practice
from ..units import RPM

__all__ = [
    "BARS",
    "GROUPS",
    "Case",
    "cases",
    "commands",
    "method",
    "practice_logs",
    "run_case",
    "run_trials",
    "summary",
    "table",
]

SCHEMA = "hydro_env/trials/3"
#: Largest error of a base parameter.
BASE_ERROR = 0.15
EVERYTHING = ("setpoint", "current", "pressure", "load")
PAIRS = (
    ("dead_zone:1", "load_bias:1"), ("magnetic_hysteresis:1", "line_loss:1"), ("sensor_lag:1", "null_offset:2"),
    ("supply_droop", "dead_zone:2"), ("flow_saturation:1", "motor_coulomb_friction:1"), ("dead_zone:both",),
    ("coil_heating:2", "directional_gain:2"), ("pressure_dependent_flow:1", "eccentric_load:2"),
    ("spring_preload:2", "quadratic_drag:2"), ("command_delay:1", "flow_gain_nonlinearity:1"),
)  # fmt: skip
#: group: (settings of the log, whether the effect is taken out of the candidates)
GROUPS: dict[str, dict[str, Any]] = {
    "nothing": {"base_error": 0.0},
    "parameters": {},
    "medium": {},
    "two": {},
    "unlisted": {"unlisted": True},
    "small": {"severity": "small"},
    "large": {"severity": "large"},
    "speed_only": {"record": ("setpoint",)},
    "current_too": {"record": ("setpoint", "current")},
    "quiet": {"noise": 0.1},
    "noisy": {"noise": 10.0},
    "no_twins": {"unlisted": True, "twins": False},
}
#: What the seeds of the groups begin with. Frozen: a seed means the same trial whatever is added later.
_GROUP_SEEDS = {
    "nothing": 0, "parameters": 1000, "medium": 2000, "two": 3000, "unlisted": 4000, "small": 5000, "large": 6000,
    "speed_only": 7000, "current_too": 8000, "quiet": 9000, "noisy": 10000, "no_twins": 11000,
}  # fmt: skip
#: The effects that are hidden one by one, in the order of their seeds. Frozen: a new effect goes to the end.
_ORDER = (
    "command_delay", "driver_saturation", "coil_heating", "magnetic_hysteresis", "spool_stiction", "spring_preload",
    "flow_force", "null_offset", "dead_zone", "flow_saturation", "directional_gain", "flow_gain_nonlinearity",
    "pressure_dependent_flow", "supply_droop", "entrained_air", "line_loss", "crossport_relief", "speed_dependent_leakage",
    "motor_coulomb_friction", "quadratic_drag", "displacement_ripple", "load_bias", "eccentric_load", "shaft_backlash",
    "viscosity_drift", "sensor_lag", "sensor_gain", "sensor_offset",
)  # fmt: skip
#: The same for those whose declared twins are taken out, too.
_ORDER_WITHOUT_TWINS = (
    "command_delay", "magnetic_hysteresis", "spool_stiction", "spring_preload", "dead_zone", "line_loss", "quadratic_drag",
    "sensor_lag",
)  # fmt: skip
#: Groups in which something is hidden that may be named.
_WITH_CHANNEL = frozenset(GROUPS) - {"nothing", "parameters", "unlisted", "no_twins"}
#: Trials of each group that hides nothing, unless told otherwise.
EMPTY = 10
#: What is asked for: (what, counted by, over the groups, at least or at most this share).
BARS: tuple[tuple[str, str, tuple[str, ...], float], ...] = (
    ("correct effect, or listed as indistinguishable from the named one", "set", ("medium",), 0.95),
    ("correct effect", "right", ("medium",), 0.0),
    (
        "the same, or `calibration` that lists the effect as hidden by calibration",
        "declared_set",
        ("medium",),
        0.0,
    ),
    ("correct channel", "channel", ("medium",), 0.95),
    ("false alarm: an effect named though there is none (at most)", "alarm", ("nothing", "parameters"), 0.02),
    ("`unknown` where the effect is not among the candidates", "right", ("unlisted",), 0.90),
    ("`unknown`, or an effect declared indistinguishable from it", "open", ("unlisted",), 0.0),
    ("`unknown` where no indistinguishable effect is a candidate either", "right", ("no_twins",), 0.0),
    ("both of two effects", "both", ("two",), 0.85),
    ("held-out speed error within 1.3 times the noise", "sealed", ("medium",), 0.90),
    ("the same with the named effects alone, without form corrections", "sealed_named", ("medium",), 0.0),
    ("held-out speed error within 1.3 times what the true values leave", "sealed_form", ("medium",), 0.0),
    ("placebo better than the named effects (at most)", "placebo", ("medium", "two"), 0.0),
)


@dataclass(frozen=True)
class Case:
    """One trial: what is hidden and how it is logged; whether it is taken out of the candidates, and its declared twins too."""

    group: str
    hidden: tuple[str, ...]
    seed: int
    severity: str = "medium"
    base_error: float = BASE_ERROR
    noise: float = 1.0
    record: tuple[str, ...] = EVERYTHING
    unlisted: bool = False
    twins: bool = True


def cases(groups: Sequence[str], seed: int, empty: int = EMPTY) -> list[Case]:
    """The trials of these groups; each has a seed of its own, and another `seed` gives other rigs, sizes and manoeuvres.

    `empty` is how many there are of each group that hides nothing.
    """
    found = []
    for group in groups:
        first = seed + _GROUP_SEEDS[group]
        sets: list[tuple[str, ...]]
        if group in ("nothing", "parameters"):
            sets = [()] * empty
        elif group == "two":
            sets = list(PAIRS)
        else:
            names = _ORDER_WITHOUT_TWINS if group == "no_twins" else _ORDER
            sets = [
                (n if CATALOGUE[n].scope == "rig" else f"{n}:{1 + number % 2}",)
                for number, n in enumerate(names)
            ]
        found += [Case(group, hidden, first + number, **GROUPS[group]) for number, hidden in enumerate(sets)]
    return found


def method() -> str:
    """Hash of the sources that find and judge nothing else: rows with the same one ran on the same method."""
    package = Path(__file__).parent.parent
    sources = [p for room in ("diagnosis", "plant") for p in sorted((package / room).rglob("*.py"))]
    sources = [p for p in sources if p.parent.name != "report"]
    return hashlib.sha256(b"".join(p.read_bytes() for p in sources)).hexdigest()[:10]


def practice_logs(case: Case, folder: Path, *, duration: float = 12.0, rate: float = 1000.0) -> None:
    """Makes the logs of a trial in `folder`, unless they are there, and form.json beside them: what the true values in the
    catalogue's form leave of each speed on the sealed log, RMS in rpm, noise and all."""
    if (folder / "form.json").exists():
        return
    practice = make_practice(
        case.hidden, severity=case.severity, base_error=case.base_error, noise=case.noise, record=case.record,
        seed=case.seed, duration=duration, rate=rate,
    )  # fmt: skip
    practice.write(folder)
    write_json(folder / "form.json", _form(practice, 1.0 / rate))


def _form(practice: Practice, period: float) -> dict[str, float]:
    log: Mapping[str, np.ndarray] = practice.logs["sealed"]
    command = np.column_stack([log[f"command_{c}_V"] for c in (1, 2)])
    load = np.column_stack([log.get(f"load_{c}_Nm", np.zeros(len(command))) for c in (1, 2)])
    speed = simulate(practice.true, command, load, period, record=("measured_speed",))["measured_speed"][:, 0]
    errors = {c: log[f"speed_{c}_rpm"] - speed[:, c - 1] / RPM for c in (1, 2)}
    return {f"speed_{c}_rpm": float(np.sqrt(np.mean(e**2))) for c, e in errors.items()}


@contextmanager
def _kept(case: Case, logs: Path | None) -> Iterator[Path]:
    """The folder of a trial's logs: one of `logs` that stays, or one for this once."""
    if logs is not None:
        yield logs / f"{case.group}_{case.seed}"
        return
    with tempfile.TemporaryDirectory() as folder:
        yield Path(folder)


def run_case(
    case: Case, *, duration: float = 12.0, rate: float = 1000.0, jobs: int = 1, logs: Path | None = None
) -> dict[str, Any]:
    """Hides, diagnoses and judges; one row of trials.json. `logs` keeps the practice logs, or has them already."""
    with _kept(case, logs) as folder:
        practice_logs(case, folder, duration=duration, rate=rate)
        truth, form = (json.loads((folder / name).read_text()) for name in ("truth.json", "form.json"))
        files = [folder / f"{name}.csv" for name in ("fit_1", "fit_2", "sealed")]
        without = [h["name"] for h in truth["effects"]] if case.unlisted else []
        if not case.twins:
            without += [twin for name in without for twin in CATALOGUE[name].indistinguishable_from]
        begin, cpu = time.perf_counter(), time.process_time()
        data = diagnose(files[:2], files[2:], model=folder / "model.yaml", without=without, jobs=jobs).as_dict()
        seconds, cpu_s = time.perf_counter() - begin, time.process_time() - cpu
    sizes = {
        f"{h['name']}.{n}": p["value"]
        for h in truth["effects"]
        for n, p in h["parameters"].items()
        if p["value"] is not None
    }
    hidden = {(h["name"], c) for h in truth["effects"] for c in _sides(h["channel"])}
    row = {**asdict(case), "sizes": sizes, **judge(data, hidden, truth["verdict"], case.unlisted, form)}
    visible = [data["detectable"].get(name, {}).get(c) for name, c in hidden]
    tried = [t for t in data["trials"] if t["refitted"] and t["gain"] > 0.5 * t["needed"]]
    return {
        **row, "visible": all(v is not False for v in visible), "seconds": round(seconds, 1), "cpu_s": round(cpu_s, 1),
        "jobs": jobs, "gap": data["gap"]["sealed"], "effects": data["effects"], "method": method(),
        "corrections": [[k["correction"], k["channel"]] for k in data.get("shape_corrections", [])],
        "tried": [[t["effect"], t["channel"], t["gain"], t["needed"], t["fate"]] for t in tried],
    }  # fmt: skip


def judge(
    data: dict[str, Any], truth: set[tuple[str, str]], expected: str, unlisted: bool = False,
    form: Mapping[str, float] | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Compares a diagnosis (the content of diagnosis.json) with the set of hidden (effect, channel).

    `form` is what the true values in the catalogue's form leave of each speed (`practice_logs`).
    """
    expected = "unknown" if unlisted else expected
    named = {(e["name"], c) for e in data["effects"] for c in _sides(e["channel"])}
    tied = {
        (n, c)
        for e in data["effects"]
        for n in (e["name"], *e["indistinguishable_from"])
        for c in _sides(e["channel"])
    }
    word = data["verdict"]
    names = word == "effects" and truth <= tied and len(named) <= len(truth)
    # Declared not to be told from calibration: true, but no name was given, so it is counted apart.
    hidden = {(n, c) for n, channels in data.get("hidden_by_calibration", {}).items() for c in channels}
    declared = word == "calibration" and bool(truth) and truth <= hidden
    twins = {(t, c) for n, c in named for t in CATALOGUE[n].indistinguishable_from}
    speeds = {k: v for k, v in data["gap"]["sealed"].items() if k.startswith("speed")}
    least = {k: max((form or {}).get(k, 0.0), v["noise"]) for k, v in speeds.items()}
    score = {
        m: sum(math.log(max(v[m] / v["noise"], 1.0)) for v in data["gap"]["sealed"].values())
        for m in ("after", "placebo")
    }
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
        "sealed": all(v["after"] <= 1.3 * v["noise"] for v in speeds.values()),
        "sealed_named": all(v.get("named", v["after"]) <= 1.3 * v["noise"] for v in speeds.values()),
        "sealed_form": all(v["after"] <= 1.3 * least[k] for k, v in speeds.items()),
        "placebo": score["placebo"] < score["after"] - 0.05,
        "worst": max((v["after"] / v["noise"] for v in speeds.values()), default=math.nan),
        "form": max((least[k] / v["noise"] for k, v in speeds.items()), default=math.nan),
    }


def _sides(channel: str) -> tuple[str, ...]:
    return ("1", "2") if channel == "both" else (channel,)


def rows_of(folder: Path) -> list[dict[str, Any]]:
    """All rows that the slices of a run have left in a folder, in the order of groups and seeds; a trial that two of them ran
    counts once."""
    rows = [r for path in sorted(folder.glob("trials*.json")) for r in json.loads(path.read_text())["rows"]]
    once = {(r["group"], r["seed"]): r for r in reversed(rows)}
    return sorted(once.values(), key=lambda r: (list(GROUPS).index(r["group"]), r["seed"]))


def run_trials(
    out: Path, wanted: Sequence[Case], *, minutes: float = math.inf, jobs: int = 1, say: Callable[[str], None] = print,
    duration: float = 12.0, rate: float = 1000.0, name: str = "trials.json", logs: Path | None = None,
) -> list[dict[str, Any]]:  # fmt: skip
    """Runs the trials that the folder `out` lacks, for `minutes` at most; its file `name` holds what is done so far.

    Returns all rows of the folder. `logs` is where practice logs are kept or made beforehand.
    """
    out.mkdir(parents=True, exist_ok=True)
    path = out / name
    own: list[dict[str, Any]] = json.loads(path.read_text())["rows"] if path.exists() else []
    end = time.monotonic() + 60.0 * minutes
    for case in wanted:
        if any((r["group"], tuple(r["hidden"]), r["seed"]) == _key(case) for r in rows_of(out)):
            continue
        if time.monotonic() > end:
            break
        own.append(run_case(case, duration=duration, rate=rate, jobs=jobs, logs=logs))
        write_json(path, {"schema": SCHEMA, "rows": own})
        say(line(own[-1]))
    return rows_of(out)


def _key(case: Case) -> tuple[str, tuple[str, ...], int]:
    return case.group, case.hidden, case.seed


def line(row: dict[str, Any]) -> str:
    """One trial in a line."""
    mark = "right" if row["right"] else "set" if row["set"] else "WRONG"
    hidden = ", ".join(row["hidden"]) or "nothing"
    return (
        f"{row['group']:<12}{hidden:<44}{mark:<7}{row['verdict']:<12}{', '.join(row['named']) or '-':<60}"
        f"{row['worst']:6.2f} x noise (true values {row['form']:.2f}) {row['cpu_s']:4.0f} s CPU"
    )


def summary(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """What was reached beside each bar: counts over the trials of its groups that were run."""
    found = []
    for what, key, groups, bar in BARS:
        own = [r for r in rows if r["group"] in groups]
        found.append(
            {
                "what": what,
                "groups": list(groups),
                "bar": bar,
                "count": sum(bool(r.get(key)) for r in own),
                "trials": len(own),
            }
        )
    return found


def table(rows: Sequence[dict[str, Any]]) -> str:
    """The table in Markdown: bars, counts by group, and every trial that went wrong."""
    lines = ["| criterion | trials | target | reached |", "|---|---|---|---|"]
    for s in summary(rows):
        if s["trials"]:
            bar = "" if s["bar"] == 0.0 and "most" not in s["what"] else f"{100 * s['bar']:.0f} %"
            lines.append(
                f"| {s['what']} | {', '.join(s['groups'])} | {bar} | "
                f"{s['count']} of {s['trials']} ({100 * s['count'] / s['trials']:.0f} %) |"
            )
    lines += [
        "",
        "| group | trials | correct | correct or indistinguishable | or `calibration` that lists it | correct channel "
        "| held-out error within 1.3 | median CPU, s |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for group in GROUPS:
        own = [r for r in rows if r["group"] == group]
        if own:
            times = sorted(r["cpu_s"] for r in own)
            lines.append(
                f"| {group} | {len(own)} | {sum(r['right'] for r in own)} | "
                f"{sum(r['right'] or r['set'] for r in own)} | "
                f"{sum(r['right'] or r['declared_set'] for r in own) if group in _WITH_CHANNEL else '-'} | "
                f"{sum(r['channel'] for r in own) if group in _WITH_CHANNEL else '-'} | "
                f"{sum(r['sealed'] for r in own)} | {times[len(times) // 2]:.0f} |"
            )
    methods = [r.get("method", "?") for r in rows]
    if len(set(methods)) > 1:
        lines += [
            "",
            "Ran on different states of the method: "
            + ", ".join(f"{m} ({methods.count(m)})" for m in set(methods)),
        ]
    wrong = [r for r in rows if not r["right"]]
    lines += [
        "",
        "Trials that were not simply correct:",
        "",
        "| group | hidden | verdict | named | held-out speed error, times the noise (true values) | seed |",
        "|---|---|---|---|---|---|",
    ]
    for r in wrong:
        names = ", ".join(
            f"{e['name']}:{e['channel']}"
            + (f" (or {', '.join(e['indistinguishable_from'])})" if e["indistinguishable_from"] else "")
            for e in r["effects"]
        )
        hidden = (", ".join(r["hidden"]) or "nothing") + (
            "" if r.get("visible", True) else " (reported as not detectable here)"
        )
        lines.append(
            f"| {r['group']} | {hidden} | {r['verdict']} | {names or '-'} | {r['worst']:.2f} ({r['form']:.2f}) | {r['seed']} |"
        )
    slow = sorted((r["cpu_s"] for r in rows), reverse=True)
    lines += [
        "",
        f"Processor time of a diagnosis: {sum(t <= 60.0 for t in slow)} of {len(slow)} within 60 s, at most {slow[0]:.0f} s.",
    ]
    for jobs in sorted({r.get("jobs", 1) for r in rows} - {1}):
        timed = [r for r in rows if r.get("jobs") == jobs]
        every = [(g, [r["seconds"] for r in timed if r["group"] == g]) for g in GROUPS]
        lines += [
            "",
            f"Elapsed time with {jobs} threads: {_within([r['seconds'] for r in timed])}; of these",
            "",
        ]
        lines += [f"* {group}: {_within(own)}" for group, own in every if own]
    rough = [r for r in rows if (r["right"] or r["set"]) and r["verdict"] == "effects" and not r["sealed"]]
    lines += [
        "",
        "Correctly named, but the held-out speed error stays above 1.3 times the noise (in brackets what the true values in "
        "the catalogue's functional form leave): "
        + (
            "; ".join(
                f"{', '.join(r['hidden'])} ({r['group']}) {r['worst']:.2f} ({r['form']:.2f})" for r in rough
            )
            or "none"
        )
        + ".",
    ]
    made = " and ".join(f"`{command}`" for command in commands(rows))
    return "\n".join([f"Made by {made}; {len(rows)} trials.", "", *lines, ""])


def _within(seconds: Sequence[float]) -> str:
    """How many of these times are within a minute, in words."""
    ordered = sorted(seconds)
    middle, longest = ordered[len(ordered) // 2], ordered[-1]
    return f"{sum(t <= 60.0 for t in ordered)} of {len(ordered)} within 60 s, median {middle:.0f} s, at most {longest:.0f} s"


def commands(rows: Sequence[dict[str, Any]]) -> list[str]:
    """The commands that make these rows and no others: for every block of seeds one for the groups that were run whole, and
    one for the others."""
    found = []
    done = {(r["group"], r["seed"]) for r in rows}
    blocks = {(g, s): s - _GROUP_SEEDS[g] for g, s in done}
    for block in sorted({b - b % 1000 for b in blocks.values()}):
        own = {key for key, b in blocks.items() if b - b % 1000 == block}
        # Groups that hide nothing may have any number of trials.
        nothing = [sum(group == g for g, _ in own) for group in ("nothing", "parameters")]
        empty = max(nothing)
        whole, part = [], []
        for group in GROUPS:
            every = {(group, c.seed) for c in cases([group], block, empty)}
            if every and every <= own:
                whole.append(group)
            elif every & own:
                part.append(group)
        start = f"python -m hydro_env.experiments.blind_trials --seed {block} --out DIR"
        start += f" --empty {empty}" if empty else ""
        if whole:
            found.append(f"{start} --groups {' '.join(whole)}")
        if part:
            seeds = " ".join(_ranges([s for g, s in sorted(own) if g in part]))
            found.append(f"{start} --groups {' '.join(part)} --only {seeds}")
    return found


def _ranges(numbers: Sequence[int]) -> list[str]:
    """Whole numbers in order, neighbours as `first-last`."""
    found: list[list[int]] = []
    for n in sorted(numbers):
        if found and n == found[-1][-1] + 1:
            found[-1][1:] = [n]
        else:
            found.append([n])
    return ["-".join(map(str, pair)) for pair in found]


def _numbers(text: str) -> range:
    """`7` or `3-7`, the numbers it means."""
    first, _, last = text.partition("-")
    return range(int(first), int(last or first) + 1)


#: What a published row keeps: what the table shows and counts.
_PUBLISHED = (
    "group", "hidden", "seed", "verdict", "named", "right", "set", "declared_set", "open", "channel", "alarm", "both", "sealed",
    "sealed_named", "sealed_form", "placebo", "worst", "form", "visible", "seconds", "cpu_s", "jobs", "method", "effects",
)  # fmt: skip


def publish(rows: Sequence[dict[str, Any]], folder: Path) -> None:
    """Writes FOLDER/trials.json, a line for each trial; `python docs/generate.py` then makes the page of it."""
    own = [{key: row[key] for key in _PUBLISHED if key in row} for row in rows]
    for row in own:
        row["effects"] = [
            {k: e[k] for k in ("name", "channel", "indistinguishable_from")} for e in row["effects"]
        ]
    lines = ",\n".join(f"  {json.dumps(row)}" for row in own)
    counts = ",\n".join(f"  {json.dumps(each)}" for each in summary(rows))
    text = f'{{\n "schema": "{SCHEMA}",\n "summary": [\n{counts}\n ],\n "rows": [\n{lines}\n ]\n}}\n'
    write_text(folder / "trials.json", text)


def _main() -> None:
    parser = argparse.ArgumentParser(description="How often the diagnosis is right.")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument(
        "--groups", nargs="*", default=["nothing", "parameters", "medium", "two", "unlisted"], choices=GROUPS
    )
    parser.add_argument("--seed", type=int, default=20000)
    parser.add_argument("--minutes", type=float, default=math.inf)
    parser.add_argument(
        "--jobs", type=int, default=1, help="threads of a diagnosis, for its time on the wall"
    )
    parser.add_argument("--slice", default="1/1", help="K/N: every N-th trial from the K-th")
    parser.add_argument("--empty", type=int, default=EMPTY, help="trials of each group that hides nothing")
    parser.add_argument(
        "--only", type=_numbers, nargs="*", help="seeds of the trials to be run, or FIRST-LAST"
    )
    parser.add_argument("--logs", type=Path, help="folder in which practice logs are kept")
    parser.add_argument("--make", action="store_true", help="only makes the logs, in --logs")
    parser.add_argument("--write", type=Path, help="folder that trials.json is published to; runs nothing")
    given = parser.parse_args()
    if given.write is not None:
        publish(rows_of(given.out), given.write)
        return
    part, of = map(int, given.slice.split("/"))
    wanted = cases(given.groups, given.seed, given.empty)[part - 1 :: of]
    if given.only is not None:
        wanted = [c for c in wanted if any(c.seed in seeds for seeds in given.only)]
    if given.make:
        for case in wanted:
            practice_logs(case, given.logs / f"{case.group}_{case.seed}")
        return
    name = "trials.json" if of == 1 else f"trials_{part}_of_{of}.json"
    rows = run_trials(
        given.out, wanted, minutes=given.minutes, jobs=given.jobs, name=name, logs=given.logs,
        say=lambda text: print(text, flush=True),
    )  # fmt: skip
    for s in summary(rows):
        if s["trials"]:
            print(f"{s['what']:<60}{s['count']:4} of {s['trials']}")


if __name__ == "__main__":
    _main()
