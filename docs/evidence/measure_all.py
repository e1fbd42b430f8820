"""Measures every published table and picture again, all at one commit, and publishes them.

    python -m docs.evidence.measure_all --out DIR [--only STEP ...] [--data DIR]   # a night on two cores
    python -m docs.evidence.measure_all --out DIR --publish                        # when all is measured

A stopped run goes on where it was. Each step runs its commands in DIR/STEP and keeps what they print in log.txt. A step that
DIR holds is run again where its commands, or code that it runs, have changed since, so what is published was measured with the
code of the commit that it bears. Nothing is measured or published while files are changed but not committed.
`--data` is the folder of the measured machines, which are others' data; without it their tables stay as they are.
"""

from __future__ import annotations

import argparse
import os
import re
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from agents.command import run_command
from docs import generate
from hydro_env.controllers import CONTROLLERS
from hydro_env.errors import InputError
from hydro_env.files import write_json, write_text
from hydro_env.reading import MAX_BYTES_OF_RESULTS, read_json

from .any_policy import TUNED, compared
from .blind_trials.running import rows_of
from .blind_trials.tables import markdown
from .blind_trials.tables import publish as publish_trials
from .paper_gap import AGAIN_S

ROOT = Path(__file__).parents[2]
#: What every step runs; besides, the steps that diagnose run all of docs/evidence, the others the scripts that they name.
CODE = "hydro_env", "agents", "configs"
DIAGNOSED = (
    "pictures", "four_edge_rigs", "naming", "measured_machines", "close_loop", "blind_trials", "any_rig", "dialogue",
)  # fmt: skip
#: What of it tells of results, and what only steps that diagnose run.
TOLD = "*.md", "docs/evidence/*.json", "docs/evidence/measure_all.py"
DIAGNOSIS = "hydro_env/diagnosis", "hydro_env/case", "hydro_env/experiments/naming_benchmark"
SCHEMA = "hydro_env/measured/1"
#: Seed of naming benchmark, blind trials and dialogues: one that nobody has looked at, another one for each release.
BLIND_SEED = 3_000_000


@dataclass(frozen=True)
class Step:
    """What is run in a folder, with words in braces as in `measure`, and what is published: arguments of docs/generate.py, and
    files to copy, each with its place. `tables` writes Markdown tables of what the commands left."""

    commands: Sequence[str]
    publish: Sequence[str] = ()
    copies: Mapping[str, str] = field(default_factory=dict)
    tables: Callable[[Path], None] | None = None


# --- tables that no command writes ------------------------------------------------------------------------------------
def _scores(folder: Path) -> dict[tuple[str, str, str], dict[str, Any]]:
    """Rows of a scores.json by controller, scenario and metric."""
    rows = read_json(folder / "scores.json", "scores", max_bytes=MAX_BYTES_OF_RESULTS)["rows"]
    return {(r["controller"], r["scenario"], r["metric"]): r for r in rows}


def _table(path: Path, head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    write_text(path, "\n".join(markdown(head, rows)) + "\n")


PEAK, TRACKING = "max_speed_difference_rpm", "tracking_mae_rpm"
SCENARIOS = ("setpoint_steps", "load_step", "staircase", "sine", "unequal_load")


def _rig(folder: Path) -> None:
    found, rows = _scores(folder), []
    for name in dict.fromkeys(c for c, _, _ in found):
        cells = []
        for scenario in SCENARIOS:
            peak, tracking = found[name, scenario, PEAK], found[name, scenario, TRACKING]["iqm"]
            low, high = peak["ci95"]
            cells.append(f"{peak['iqm']:.0f} [{low:.0f}, {high:.0f}], {tracking:.0f}, {peak['cvar95']:.0f}")
        rows.append([f"`{name}`", *cells])
    _table(folder / "rig.md", ["controller", *SCENARIOS], rows)


def _settings(folder: Path) -> None:
    found, every = _scores(folder), (*SCENARIOS, "disturbance")
    rows = []
    for name in dict.fromkeys(c for c, _, _ in found):
        both = [(found[name, s, PEAK], found[name, s, TRACKING]) for s in every]
        cells = [f"{a['iqm']:.1f} at {b['iqm']:.1f} ({a['cvar95']:.0f})" for a, b in both]
        rows.append([f"`{name.removeprefix('probing_flow')}`", *cells])
    _table(folder / "settings.md", ["`probing_flow`", *every], rows)


PERIODS = {"5 ms": "0.005", "10 ms": "0.01", "20 ms": "0.02"}


def _periods(folder: Path) -> None:
    found = {text: _scores(folder / value) for text, value in PERIODS.items()}
    names = [n for n in CONTROLLERS if all((n, SCENARIOS[0], PEAK) in own for own in found.values())]
    rows = []
    for name in names:
        both = [(own[name, SCENARIOS[0], PEAK], own[name, SCENARIOS[0], TRACKING]) for own in found.values()]
        rows.append([f"`{name}`", *(f"{a['iqm']:.1f} at {b['iqm']:.1f}" for a, b in both)])
    _table(folder / "periods.md", ["controller", *PERIODS], rows)


def _valves(folder: Path) -> None:
    data = read_json(folder / "valve_test.json", "a valve test")
    valves, sides = data["valves"], ("positive", "negative")
    each = {
        "dead zone each way, %": [
            ", ".join(f"{v[s]['dead_zone_percent']:.1f}" for s in sides) for v in valves
        ],
        "hysteresis, % (widest at, %)": [
            f"{v['hysteresis']['percent']:.1f} ({v['hysteresis']['widest_at_percent']:.0f})" for v in valves
        ],
        "gain, l/min per A": [f"{v['positive']['gain_lpm_per_unit']:.1f}" for v in valves],
        "linearity, %": [f"{v['positive']['linearity_percent']:.1f}" for v in valves],
        "maximum flow, l/min": [f"{v['positive']['maximum_flow_lpm']:.1f}" for v in valves],
    }
    _table(folder / "valves.md", ["", *(v["name"] for v in valves)], [[n, *c] for n, c in each.items()])
    driven = data["synchronisation"]
    pairs = list(dict.fromkeys(" + ".join(r["valves"]) for r in driven["pairs"]))
    of = {(r["controller"], " + ".join(r["valves"])): r for r in driven["pairs"]}
    *others, alike = sorted(pairs, key=lambda pair: pair == " + ".join(data["most_alike"]))
    rows = []
    for c in dict.fromkeys(r["controller"] for r in driven["pairs"]):
        cells = [f"{of[c, p][PEAK]:.1f} ({of[c, p][TRACKING]:.1f})" for p in pairs]
        gain = min(of[c, p][PEAK] for p in others) - of[c, alike][PEAK]
        rows.append([f"`{c}`", *cells, f"{gain:.1f}"])
    _table(folder / "valve_pairs.md", ["controller", *pairs, "gain by the most similar pair"], rows)


def _four_edges(folder: Path) -> None:
    seeds = [
        read_json(folder / n / "four_edge_rigs.json", "rigs of a run")["rows"] for n in ("seed_1", "seed_2")
    ]
    counts: dict[str, Callable[[Mapping[str, Any]], bool]] = {
        "rigs": lambda r: True, "right": lambda r: r["right"], "right, or listed with the named one": lambda r: r["set"],
        "named, but only as a best guess": lambda r: bool(r["named"]) and r["best_guess"],
        "a false name given as proven": lambda r: r["false_name"],
        "held-out speeds within 1.3 times the noise": lambda r: r["worst"] <= 1.3,
    }  # fmt: skip
    rows = [[text, *(str(sum(map(counted, own))) for own in seeds)] for text, counted in counts.items()]
    _table(folder / "four_edge_rigs.md", ["count", "seed 1", "seed 2"], rows)


def _blind_trials(folder: Path) -> None:
    (folder / "published").mkdir(exist_ok=True)
    publish_trials(rows_of(folder), folder / "published")


def _any_rig(folder: Path) -> None:
    rows = []
    for name in ("drawn", "paper"):
        own = list(read_json(folder / name / "names.json", "rigs that were examined").values())
        named, among = (f"{sum(r[key] for r in own)} of {len(own)}" for key in ("right", "set"))
        missed = ", ".join(f"`{r['hidden'][0]}`" for r in own if not r["set"])
        rows.append(["drawn" if name == "drawn" else f"`{name}`", named, among, missed])
    head = ["plant", "effect named", "or listed as indistinguishable from the named one", "missed"]
    _table(folder / "any_rig.md", head, rows)


def _paper_gap(folder: Path) -> None:
    answers = read_json(folder / "paper_gap.json", "answers")["answers"]
    reach = [a for a in answers if a["explains_figure_7"]]
    facts = {
        "175 rpm at a plausible size": reach,
        "then speeds equal again within a second": [a for a in reach if a["equal_again_s"] <= AGAIN_S],
        "then no flow below 300 mA": [a for a in reach if a["explains_figure_2"]],
    }
    rows = []
    for fact, own in facts.items():
        names = dict.fromkeys(f"`{a['effect']}`" for a in own)
        rows.append([fact, str(len(names)), ", ".join(names) or "none"])
    tried = len({a["effect"] for a in answers})
    _table(folder / "paper_gap.md", ["", f"effects, of {tried}", "which"], rows)


def _exports(folder: Path) -> None:
    lines = (folder / "log.txt").read_text(encoding="utf-8").splitlines()
    rows = {
        cells[0]: cells for line in lines if line.startswith("|") for cells in [line.strip("| ").split(" | ")]
    }
    head = ["controller", "code and constants, bytes", "state, bytes", "worst step, us"]
    _table(folder / "exports.md", head, list(rows.values()))


def _any_policy(folder: Path) -> None:
    driven, rows = read_json(folder / "any_policy.json", "rigs that were driven"), []
    for law in TUNED:
        both = [compared(driven, "gru_any", law, metric) for metric in ("difference", "tracking")]
        rows.append([f"`{law}`", *(cell for one in both for cell in one)])
    ends = ("peak smaller in", "ratio of peaks", "tracking error smaller in", "ratio of tracking errors")
    _table(folder / "any_policy.md", ["tuned law", *ends], rows)


def _close_loop(folder: Path) -> None:
    path, rows = folder / "agent" / "close_loop.json", []
    for r in read_json(path, "a closed loop", max_bytes=MAX_BYTES_OF_RESULTS)["rigs"]:
        hidden = ", ".join(f"`{e['name']}:{e['channel']}`" for e in r["hidden"])
        named = ", ".join(f"`{name}`" for name in r["named"])
        left = [
            ", ".join(f"{e[k]:.1f}" for k in ("before", "after", "noise")) for e in r["sealed_rpm"].values()
        ]
        rows.append([r["rig"], hidden, named, f"`{r['verdict']}`", *left])
    ends = [f"channel {c}: as given, repaired, noise" for c in (1, 2)]
    _table(folder / "close_loop_rigs.md", ["rig", "hidden", "named", "verdict", *ends], rows)


# --- the steps --------------------------------------------------------------------------------------------------------
FULL = "--split test_interp --split test_extrap --split faulted --split val"
STUDIED = "pid_tuned cross_coupled virtual_leader adaptive_flow probing_flow gru gru_any ppo"
ONE_MILLION = "ppo sac ppo_recipe ppo_single sac_recipe tqc recurrent_ppo clone_cross_coupled"
#: In the order in which they are run: the shortest first.
STEPS = {
    "speed": Step(["{hydro} speed --out ."], ["speed.json"]),
    "scores": Step([f"{{hydro}} benchmark --suite full {FULL} --jobs 2 --out ."], ["scores.json"]),
    "leaderboard": Step(["{hydro} benchmark --suite paper --jobs 2 --out ."], copies={"result_*.json": "docs/leaderboard"}),
    "valve_test": Step(
        ["{hydro} valve-test valve_1 valve_2 valve_3 --out ."], ["valves=valves.md", "valve_pairs=valve_pairs.md"],
        tables=_valves,
    ),
    "settings": Step(
        ["{hydro} benchmark probing_flow:rate=22,rise=10 probing_flow:rate=13,rise=5 --split val --out ."],
        ["settings=settings.md"], tables=_settings,
    ),
    "periods": Step(
        [
            f"{{hydro}} benchmark --split val --scenario setpoint_steps --cases 48 --control-period {s} --jobs 2 --out {s}"
            for s in PERIODS.values()
        ],
        ["periods=periods.md"], tables=_periods,
    ),
    "robustness": Step(
        [f"{{python}} -m agents.robustness {STUDIED} --first 200 --out ."], ["robustness=robustness.md"]
    ),
    "rig": Step(
        [
            "{hydro} tune --controller pid --plant rig --out pid",
            "{hydro} tune --controller cross_coupled --plant rig --out cross_coupled",
            "{hydro} benchmark pid/gains.json cross_coupled/gains.json adaptive_flow probing_flow gru_any gru_rig"
            " --as-shipped --plant rig --split test_interp --cases 100 --jobs 2 --out .",
        ],
        ["rig=rig.md"], tables=_rig,
    ),
    "ladder": Step(["{python} -m agents.baselines --lines --pairs 500 --out ."], ["ladder=ladder.md"]),
    "pictures": Step(
        ["{hydro} demo --out demo", "{python} -m agents.picture --out agents_start_and_reversal.png"],
        copies={"demo/demo.png": "docs/images", "agents_start_and_reversal.png": "docs/images"},
    ),
    "exports": Step(
        ["{python} -m tests.export.measure pid_tuned cross_coupled adaptive_flow probing_flow ppo gru"],
        ["exports=exports.md"], tables=_exports,
    ),
    "lab": Step(["{python} -m tests.lab.picture lab.png"], copies={"lab.png": "docs/images"}),
    "paper_gap": Step(
        ["{python} -m docs.evidence.paper_gap --out ."], ["paper_gap=paper_gap.md"], tables=_paper_gap
    ),
    "scaling": Step(["{python} -m docs.evidence.scaling --out ."], ["scaling=scaling.md"], {"scaling.png": "docs/images"}),
    "four_edge_rigs": Step(
        [f"{{python}} -m docs.evidence.four_edge_rigs --seed {n} --jobs 2 --out seed_{n}" for n in (1, 2)],
        ["four_edge_rigs=four_edge_rigs.md"], tables=_four_edges,
    ),
    "naming": Step(
        [
            f"{{hydro}} naming-benchmark make --rigs 36 --seed {BLIND_SEED} --out set",
            "{hydro} naming-benchmark run diagnose calibrate --set set --out answers",
            "{python} -m docs.evidence.naming_methods sindy polynomial certify network --set set --out answers",
            "{hydro} naming-benchmark score answers/diagnose answers/calibrate answers/sindy answers/polynomial answers/certify"
            " answers/network --set set --out .",
        ],
        copies={"naming.json": "docs/evidence"},
    ),
    "measured_machines": Step(
        ["{python} -m docs.evidence.measured_machines {data} --out ."], ["crane=crane.md", "servo_valve=servo_valve.md"],
        {"measured_machines.png": "docs/images"},
    ),
    "close_loop": Step(
        [
            "{hydro} close-loop --seed 1 --seeds 2 --cells cells --out rigs",
            "{python} -m agents.close_loop --rigs rigs --out agent",
            "{python} -m docs.evidence.close_loop_picture agent --out agent",
        ],
        ["close_loop=agent/close_loop.md", "close_loop_rigs=close_loop_rigs.md"],
        {"agent/close_loop.png": "docs/images/closing_the_loop.png"}, _close_loop,
    ),
    "baselines": Step(
        [
            f"{{python}} -m agents.baselines --agents {ONE_MILLION} --steps 1000000 --out .",
            "{python} -m agents.baselines --agents ppo_recipe ppo_single --steps 8000000 --out .",
        ],
        ["baselines=baselines.md", "line_to_beat=line_to_beat.md"],
        {"baselines.png": "docs/images", "baselines.json": "docs/images"},
    ),
    "blind_trials": Step(
        [
            f"{{python}} -m docs.evidence.blind_trials --seed {BLIND_SEED} --jobs 2 --out .",
        ],
        copies={"published/trials.json": "docs/evidence"}, tables=_blind_trials,
    ),
    "any_rig": Step(
        [
            f"{{python}} -m docs.evidence.any_rig --name --seed {BLIND_SEED + 200_000} --rigs 34 {words}"
            for words in ("--out drawn", "--plant paper --out paper")
        ],
        ["any_rig=any_rig.md"], tables=_any_rig,
    ),
    "any_policy": Step(
        ["{python} -m docs.evidence.any_policy --first 19 --rigs 19 --out ."], ["any_policy=any_policy.md"], tables=_any_policy
    ),
    "dialogue": Step(
        [
            f"{{python}} -m docs.evidence.dialogue --seed {BLIND_SEED + 100_000} --singles 36 --pairs 20 --empty 16"
            " --questions asked random --jobs 2 --out ."
        ],
        ["dialogue=dialogue.md"],
    ),
}  # fmt: skip


# --- running ----------------------------------------------------------------------------------------------------------
def git(*words: str) -> str:
    return subprocess.run(
        ["git", *words], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.strip()


def commit() -> str:
    """The commit that is measured; InputError where files are changed but not committed."""
    if changed := git("status", "--porcelain", "--untracked-files=no"):
        raise InputError(
            f"{changed.split(maxsplit=1)[-1].splitlines()[0]}: changed but not committed; commit it first"
        )
    return git("rev-parse", "HEAD")


def is_current(name: str, done: Mapping[str, Any] | None) -> bool:
    """Whether a step was measured with the commands and the code of this commit."""
    commands = list(STEPS[name].commands)
    if done is None or done.get("commands") != commands:
        return False
    named = re.findall(r"-m ((?:docs|tests)[.\w]+)", " ".join(commands))
    code = ["docs/evidence"] if name in DIAGNOSED else [f"{each.replace('.', '/')}.py" for each in named]
    aside = TOLD if name in DIAGNOSED else (*TOLD, *DIAGNOSIS)
    return not git(
        "diff", "--name-only", done["commit"], "--", *CODE, *code, *(f":(exclude){each}" for each in aside)
    )


def measure(out: Path, name: str, data: Path | None) -> None:
    """Runs the commands of a step in its folder. InputError for one that fails."""
    step, folder = STEPS[name], out / name
    folder.mkdir(parents=True, exist_ok=True)
    words = {
        "python": shlex.quote(sys.executable), "hydro": f"{shlex.quote(sys.executable)} -m hydro_env", "data": str(data),
    }  # fmt: skip
    for command in step.commands:
        with (folder / "log.txt").open("a", encoding="utf-8") as log:
            done = subprocess.run(
                shlex.split(command.format(**words)), cwd=folder, stdout=log, stderr=subprocess.STDOUT, check=False,
                env={**os.environ, "PYTHONPATH": str(ROOT)},
            )  # fmt: skip
        if done.returncode:
            raise InputError(
                f"{folder / 'log.txt'}: {command!r} ended with status {done.returncode}; the same call goes on"
            )
    if step.tables is not None:
        step.tables(folder)


def as_published(name: str) -> str:
    """The commands of a step as they stand above its table."""
    words = {"python": "python", "hydro": "hydro-env", "data": "DATA"}
    texts = (command.format(**words).replace(" --jobs 2", "") for command in STEPS[name].commands)
    return "; ".join(re.sub(r"--out \.$", "--out DIR", text) for text in texts)


def publish(out: Path, names: Sequence[str]) -> None:
    """Takes what the steps have left into the documents."""
    for name in names:
        for argument in STEPS[name].publish:
            table, _, file = argument.rpartition("=")
            made = str(out / name / file)
            generate.take(f"{table}={made}" if table else made, as_published(name))
        for pattern, place in STEPS[name].copies.items():
            for path in sorted((out / name).glob(pattern)):
                shutil.copy(path, ROOT / place)
        if STEPS[name].copies:
            generate.keep(name, as_published(name))
    generate.write()


def run(out: Path, names: Sequence[str], data: Path | None) -> None:
    """Measures what DIR lacks of the steps `names`, and keeps in DIR/measured.json at which commit and how long each took."""
    from tqdm import tqdm

    out.mkdir(parents=True, exist_ok=True)
    done = _done(out)
    for name in (bar := tqdm(names, unit="step")):
        bar.set_description(name)
        now = commit()
        if is_current(name, done.get(name)):
            continue
        if name in done:
            shutil.rmtree(out / name)
        begin = time.monotonic()
        measure(out, name, data)
        if commit() != now:
            raise InputError(
                f"{name}: the checkout moved to another commit meanwhile; the same call measures it again"
            )
        minutes = round((time.monotonic() - begin) / 60.0, 1)
        done[name] = {"commit": now, "minutes": minutes, "commands": list(STEPS[name].commands)}
        write_json(out / "measured.json", {"schema": SCHEMA, "steps": done})


def _done(out: Path) -> dict[str, dict[str, Any]]:
    path = out / "measured.json"
    return dict(read_json(path, "what was measured")["steps"]) if path.exists() else {}


def main() -> None:
    parser = argparse.ArgumentParser(prog="measure_all", description="Measures every published table again.")
    parser.add_argument("--out", type=Path, required=True, help="folder of the steps")
    parser.add_argument("--only", nargs="+", choices=STEPS, help="these steps alone")
    parser.add_argument("--data", type=Path, help="folder of the measured machines")
    parser.add_argument("--publish", action="store_true", help="takes what was measured into the documents")
    given = parser.parse_args()
    names = given.only or [name for name in STEPS if given.data or name != "measured_machines"]
    out, data = given.out.absolute(), given.data.absolute() if given.data else None
    if not given.publish:
        run(out, names, data)
        return
    done, now = _done(out), commit()
    if other := [name for name in names if not is_current(name, done.get(name))]:
        raise InputError(
            f"{out}: {', '.join(other)} not measured with the code of {now[:7]}; run it without --publish first"
        )
    publish(out, names)


if __name__ == "__main__":
    run_command(main)
