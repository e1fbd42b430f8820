"""Sets of rigs with hidden effects: `rigs/NAME` is what a method gets, `truth` what nobody may look at before scoring.

    set.json                 names of the rigs, and the digest of the truth
    rigs/NAME/fit_1.csv      valve bench, open loop
    rigs/NAME/fit_2.csv      operation, closed loop
    rigs/NAME/validation.csv other manoeuvres, all signals
    rigs/NAME/commands.csv   a longer run that begins with the validation log: time, commands and loads alone
    rigs/NAME/model.yaml     the model as an engineer has it
    rigs/NAME/rig.json       candidates, and from when on `commands.csv` is scored
    truth/NAME.json          what is hidden and how large it is
    truth/NAME.csv           measured speeds of the scored part
    truth/set.json           the seed

Of rigs that may be asked (`dialogue`) there is no valve bench, and rig.json has the budget of questions.

Rigs are practice rigs (`hydro_env.practice`). What is hidden, on which channel, its severity, the errors of the base
parameters, the noise and the recorded signals are drawn for each rig from the seed of the set. Every rig leaves some
effects out of its candidates, so that a list of candidates says nothing about what is hidden.
"""

from collections.abc import Mapping, Sequence
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from ...arrays import Floats
from ...errors import InputError
from ...files import write_json, write_text
from ...measured.formats import read_table
from ...plant import BUILT_IN, CATALOGUE
from ...plant.sensors import NOISE
from ...practice.generate import make_practice
from ...practice.recorder import log_text
from ...reading import read_json

SET_SCHEMA = "hydro_env/naming_set/1"
RIG_SCHEMA = "hydro_env/naming_rig/1"
TRUTH_SCHEMA = "hydro_env/naming_truth/1"
#: Kinds of rigs with their shares of a set.
KINDS = {"one": 0.5, "unlisted": 0.15, "two": 0.1, "parameters": 0.15, "nothing": 0.1}
#: Length of the logs to fit and of validation, of the run that begins with the validation log, s.
DURATION, LONG_DURATION = 12.0, 24.0
#: Ranges that a rig's settings are drawn from: base error, factor on the noise (by factors).
BASE_ERROR, NOISE_FACTOR = (0.02, 0.15), (0.5, 3.0)
#: What is recorded beside time, command and speed, each with its probability.
RECORDS = ((("setpoint", "current", "pressure", "load"), 0.7), (("setpoint", "pressure", "load"), 0.3))
#: Effects that each rig leaves out of its candidates, beside those that logs cannot part from them.
LEFT_OUT = 3
#: What a rig answers at most: questions, seconds of commands, and sensors, one for each question that records it.
BUDGET = {"questions": 3, "seconds": 3 * DURATION, "sensors": 3}


def _kinds(rigs: int, rng: np.random.Generator) -> list[str]:
    """Kinds of the rigs of a set, as near to their shares as whole numbers go, in random order."""
    edges = np.round(np.cumsum([0.0, *KINDS.values()]) * rigs).astype(int)
    kinds = [kind for kind, n in zip(KINDS, np.diff(edges), strict=True) for _ in range(n)]
    return [kinds[k] for k in rng.permutation(len(kinds))]


def _effects() -> list[str]:
    return [name for name in BUILT_IN if not CATALOGUE[name].family]


def _with_twins(name: str) -> set[str]:
    return {name, *CATALOGUE[name].indistinguishable_from} & {*_effects()}


def draw_rig(kind: str, rng: np.random.Generator) -> dict[str, Any]:
    """What is drawn for a rig of a kind: hidden effects, effects that are no candidates, and settings of the practice logs."""
    names = _effects()
    one, other = (names[k] for k in rng.choice(len(names), 2, replace=False))
    while other in _with_twins(one):
        other = names[int(rng.integers(len(names)))]
    hidden = {"one": [one], "unlisted": [one], "two": [one, other]}.get(kind, [])
    # The first is left out where it is to be unlisted; otherwise none that is hidden, nor one like it, may be.
    kept = set().union(*map(_with_twins, hidden)) if kind != "unlisted" else set()
    out = _with_twins(one) if kind == "unlisted" else set()
    free = [n for n in rng.permutation(names) if n not in kept and not _with_twins(str(n)) & kept]
    for name in free[: LEFT_OUT - (kind == "unlisted")]:
        out |= _with_twins(str(name))
    low, high = NOISE_FACTOR
    return {
        "effects": [
            n if CATALOGUE[n].scope == "rig" else f"{n}:{c}"
            for n, c in zip(hidden, rng.integers(1, 3, 2), strict=False)
        ],
        "left_out": sorted(out),
        "severity": "large" if rng.random() < 1.0 / 3.0 else "medium",
        "base_error": 0.0 if kind == "nothing" else float(rng.uniform(*BASE_ERROR)),
        "noise": float(low * (high / low) ** rng.random()),
        "record": list(RECORDS[int(rng.random() > RECORDS[0][1])][0]),
        "seed": int(rng.integers(2**31)),
    }


def make_set(out: Path, rigs: int, seed: int, ask: bool = False) -> None:
    """Makes a set of rigs in the folder `out`, which may be asked if `ask`; rigs that it holds already are kept, so a stopped run
    goes on.

    InputError if the folder holds a set of another size, seed or kind.
    """
    names = [f"rig_{n + 1:03d}" for n in range(rigs)]
    about = {"schema": SET_SCHEMA, "rigs": names, "ask": ask}
    drawn = {"seed": seed, **about}
    path = out / "truth" / "set.json"
    if path.exists() and read_json(path, "a set's seed") != drawn:
        raise InputError(f"{out}: holds another set than --rigs {rigs} --seed {seed}; name another --out")
    path.parent.mkdir(parents=True, exist_ok=True)
    write_json(path, drawn)
    shared, *own = np.random.SeedSequence(seed).spawn(1 + rigs)
    kinds = _kinds(rigs, np.random.default_rng(shared))
    bar = tqdm(zip(names, kinds, own, strict=True), total=rigs, unit="rig", disable=None)
    for name, kind, stream in bar:
        bar.set_description(name)
        if not (out / "truth" / f"{name}.json").exists():
            _make_rig(out, name, kind, draw_rig(kind, np.random.default_rng(stream)), ask)
    write_json(out / "set.json", {**about, "truth_sha256": _digest(out / "truth")})


def _digest(truth: Path) -> str:
    """SHA-256 of the files of the truth, in the order of their names."""
    return sha256(
        b"".join(path.name.encode() + path.read_bytes() for path in sorted(truth.iterdir()))
    ).hexdigest()


def _make_rig(out: Path, name: str, kind: str, drawn: Mapping[str, Any], ask: bool) -> None:
    """Writes a rig and its truth, the truth last."""
    settings = {key: drawn[key] for key in ("severity", "base_error", "noise", "record", "seed")}
    runs = ("fit_2",) if ask else ("fit_1", "fit_2")
    short = make_practice(drawn["effects"], runs=runs, duration=DURATION, **settings)
    values = {f"{h.name}.{n}": v for h in short.hidden for n, v in h.parameters.items()}
    long = make_practice(
        drawn["effects"], runs=("sealed",), duration=LONG_DURATION, **{**settings, "values": values}
    )
    folder = out / "rigs" / name
    folder.mkdir(parents=True, exist_ok=True)
    held_out = long.logs["sealed"]
    early = held_out["time_s"] < DURATION
    given = {n: c for n, c in held_out.items() if n.split("_")[0] in ("time", "command", "load")}
    scored = {n: c[~early] for n, c in held_out.items() if n.split("_")[0] in ("time", "speed")}
    logs = {**short.logs, "validation": {n: c[early] for n, c in held_out.items()}, "commands": given}
    for log, columns in logs.items():
        write_text(folder / f"{log}.csv", log_text(columns))
    short.given.to_yaml(folder / "model.yaml")
    candidates = [n for n in _effects() if n not in drawn["left_out"]]
    about = {"schema": RIG_SCHEMA, "rig": name, "candidates": candidates, "scored_from_s": DURATION}
    write_json(folder / "rig.json", about | ({"budget": BUDGET} if ask else {}))
    write_text(out / "truth" / f"{name}.csv", log_text(scored))
    truth = {
        "schema": TRUTH_SCHEMA,
        "rig": name,
        "kind": kind,
        "verdict": "unknown" if kind == "unlisted" else short.truth["verdict"],
        "noise_rpm": NOISE["speed_rpm"] * drawn["noise"],
        **{key: short.truth[key] for key in ("effects", "base_parameters", "form_constants")},
        **{key: drawn[key] for key in (*settings, "left_out")},
        "hidden": drawn["effects"],
        "values": values,
    }
    write_json(out / "truth" / f"{name}.json", truth)


def read_set(folder: Path) -> dict[str, Any]:
    """The content of set.json. InputError where it is none."""
    return _read(folder / "set.json", "a set of `hydro-env naming-benchmark make`", SET_SCHEMA, "rigs")


def read_truth(folder: Path, rig: str) -> dict[str, Any]:
    """The truth of a rig of the set in `folder`. InputError for another one than that whose digest is published."""
    path, published = folder / "truth" / f"{rig}.json", read_set(folder).get("truth_sha256")
    if published is not None and path.exists() and _digest(path.parent) != published:
        raise InputError(f"{path.parent}: is not the truth whose digest {folder / 'set.json'} has")
    return _read(path, "the truth of a rig of the naming benchmark", TRUTH_SCHEMA, "effects")


def _read(path: Path, what: str, schema: str, key: str) -> dict[str, Any]:
    data: dict[str, Any] = read_json(path, what)
    if not isinstance(data, dict) or data.get("schema") != schema or key not in data:
        raise InputError(f"{path}: expected {what}, schema {schema!r}")
    return data


def columns_of(path: Path, names: Sequence[str]) -> Floats:
    """The named columns (T, names) of a CSV file. InputError for a missing column or a cell that is no finite number."""
    found = read_table(path, lambda header: names)
    values = np.column_stack([found.columns[name] for name in names])
    if len(bad := np.flatnonzero(np.isnan(values).any(axis=1))):
        raise InputError(f"{path}: row {found.row(bad[0])}: not a finite number")
    return values


def read_commands(rig: Path) -> tuple[Floats, Floats, Floats, float]:
    """commands.csv of a rig's folder: time (T,), s, commands (T, 2), V, loads (T, 2), N m, and the period, s."""
    names = ("time_s", "command_1_V", "command_2_V", "load_1_Nm", "load_2_Nm")
    long = columns_of(rig / "commands.csv", names)
    return long[:, 0], long[:, 1:3], long[:, 3:5], float(long[1, 0] - long[0, 0])
