"""Records the JSON that every command writes on small inputs, to show that a change of layout changes no result.

    python -m tests.command_outputs record DIR           # at the commit before
    python -m tests.command_outputs compare DIR OTHER    # after recording OTHER at the commit after

The commands run in DIR, one after the other, some on the output of earlier ones. What is compared is every number and word of
their JSON and YAML files, bit for bit, except times and hashes of code (`IGNORED`). Takes some minutes.
"""

from __future__ import annotations

import json
import math
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

COMMANDS: dict[str, str] = {
    "reproduce": "reproduce --no-pictures --out reproduce",
    "valve_test": "valve-test paper paper:2 rig --seconds 3,9 --controllers pid_paper --seeds 1 --no-pictures --out valve_test",
    "tune": "tune --controller cross_coupled --episodes 192 --cases 4 --scenario setpoint_steps --out tune",
    "tune_linear": "tune --linear --out tune_linear",
    "benchmark": "benchmark all --suite quick --cases 2 --out benchmark",
    "benchmark_rig": "benchmark all --suite quick --cases 2 --plant rig --scenario load_step --out benchmark_rig",
    "hide_none": "hide --none --base-error 10 --duration 4 --seed 1 --out hide_none",
    "hide_dead_zone": "hide dead_zone:1 --base-error 10 --duration 4 --seed 2 --out hide_dead_zone",
    "hide_pair": "hide supply_droop load_bias:2 --base-error 10 --duration 4 --seed 3 --out hide_pair",
    "hide_stiction": "hide spool_stiction:2 --base-error 15 --duration 4 --seed 4 --out hide_stiction",
    "hide_speed": "hide sensor_lag:1 --record setpoint --base-error 10 --duration 4 --seed 5 --out hide_speed",
    "diagnose_none": "diagnose {hide_none} --jobs 2 --out diagnose_none",
    "diagnose_dead_zone": "diagnose {hide_dead_zone} --jobs 2 --out diagnose_dead_zone",
    "diagnose_pair": "diagnose {hide_pair} --jobs 2 --out diagnose_pair",
    "diagnose_stiction": "diagnose {hide_stiction} --jobs 2 --out diagnose_stiction",
    "diagnose_speed": "diagnose {hide_speed} --jobs 2 --out diagnose_speed",
    "diagnose_steady": "diagnose {hide_dead_zone} --steady --jobs 2 --out diagnose_steady",
}
#: Keys of times and of hashes of code.
IGNORED = frozenset({"seconds", "cpu_s", "method", "version", "us_per_step", "versions", "wall_s"})


def _filled(command: str) -> list[str]:
    """The words of a command; {FOLDER} stands for the logs that `hide` has written there."""
    words = []
    for word in command.split():
        if word.startswith("{"):
            folder = word.strip("{}")
            words += [f"{folder}/fit_1.csv", f"{folder}/fit_2.csv", "--sealed", f"{folder}/sealed.csv"]
            words += ["--model", f"{folder}/model.yaml"]
        else:
            words.append(word)
    return words


def record(folder: Path, names: list[str]) -> None:
    """Runs the commands, all or those named, in `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in names or COMMANDS:
        begin = time.perf_counter()
        words = [sys.executable, "-m", "hydro_env", *_filled(COMMANDS[name])]
        done = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False)
        print(f"{name:<20}{time.perf_counter() - begin:6.1f} s  exit {done.returncode}", flush=True)
        if done.returncode:
            print(done.stderr[-2000:])


def differences(one: Any, other: Any, place: str = "") -> Iterator[str]:
    """Where two values from JSON differ."""
    if isinstance(one, dict) and isinstance(other, dict):
        for key in sorted({*one, *other} - IGNORED, key=str):
            if key not in one or key not in other:
                yield f"{place}.{key}: only in {'the first' if key in one else 'the second'}"
            else:
                yield from differences(one[key], other[key], f"{place}.{key}")
    elif isinstance(one, list) and isinstance(other, list):
        if len(one) != len(other):
            yield f"{place}: {len(one)} and {len(other)} entries"
        for n, (a, b) in enumerate(zip(one, other, strict=False)):
            yield from differences(a, b, f"{place}[{n}]")
    elif one != other and not (
        isinstance(one, float) and isinstance(other, float) and math.isnan(one) and math.isnan(other)
    ):
        yield f"{place}: {one!r} and {other!r}"


def _read(path: Path) -> Any:
    text = path.read_text(encoding="utf-8")
    return yaml.safe_load(text) if path.suffix == ".yaml" else json.loads(text)


def compare(one: Path, other: Path) -> int:
    """Prints every difference of the JSON and YAML files in two folders; returns how many there are."""
    files = sorted(
        {p.relative_to(f) for f in (one, other) for kind in ("*.json", "*.yaml") for p in f.rglob(kind)}
    )
    found = 0
    for name in files:
        if not ((one / name).exists() and (other / name).exists()):
            print(f"{name}: only in {one if (one / name).exists() else other}")
            found += 1
            continue
        own = list(differences(_read(one / name), _read(other / name)))
        for text in own[:10]:
            print(f"{name}{text}")
        if len(own) > 10:
            print(f"{name}: and {len(own) - 10} more")
        found += len(own)
    print(f"{len(files)} files, {found} differences")
    return found


def main() -> None:
    match sys.argv[1:]:
        case ["record", folder, *names]:
            record(Path(folder), names)
        case ["compare", one, other]:
            sys.exit(compare(Path(one), Path(other)) > 0)
        case _:
            sys.exit(__doc__)


if __name__ == "__main__":
    main()
