"""The agent's part of closing the loop: `python -m agents.close_loop --rigs DIR --out DIR`.

`hydro-env close-loop --out DIR` has hidden effects in rigs, diagnosed them and left three models of each: wrong, repaired
and true. Here a PPO agent is trained from nothing on each of them, with the same training file, number of steps and seed,
and drives the hidden rigs, which the independent reference simulator plays, on scenarios it has not been trained on. Its
network sees the last measurements as they are (interface `frames`): what it knows of the valves it has from its model.

DIR receives what the command wrote (close_loop.json, traces.json, close_loop.md) with the agent beside the other
controllers, `runs/` with all trainings, and `drives/` with the scores. The same command again goes on where it was stopped.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from agents.command import run_command
from hydro_env.controllers.learned.policy import NumpyPolicy
from hydro_env.errors import InputError
from hydro_env.experiments import close_loop
from hydro_env.experiments.close_loop import SOURCES, collect, summary
from hydro_env.experiments.close_loop_drives import drive
from hydro_env.files import write_json
from hydro_env.plant import load_model
from hydro_env.practice.generate import constants_of
from hydro_env.reading import MAX_BYTES_OF_RESULTS, read_json
from hydro_env.training.config import Config, read_config
from hydro_env.training.train import train

CONFIG = Path(__file__).parent.parent / "configs" / "close_loop.yml"
NAME = "ppo"


@dataclass(frozen=True)
class Work:
    """A training and the hidden rig its policy drives; all rigs of a seed share the training on the wrong model."""

    rig: str
    case: str
    seed: int
    forms: str
    source: str

    @property
    def training(self) -> str:
        return f"wrong_{self.seed}" if self.source == "wrong" else f"{self.rig}_{self.source}"


def work_of(data: Mapping[str, Any]) -> Iterator[Work]:
    """What is to be done for the result of `hydro-env close-loop`: one seed of all cases after the other."""
    for row in sorted(data["rigs"], key=lambda row: int(row["seed"])):
        for source in SOURCES:
            yield Work(row["rig"], row["case"], row["seed"], row["forms"], source)


def run(rigs: Path, out: Path, config: Config, *, command: str = "", progress: bool = True) -> dict[str, Any]:
    """Trains and scores what is not done yet; returns the result, which is written to `out` after every rig.

    `rigs` is the folder that `hydro-env close-loop` wrote. InputError if it is not, or if `out` holds trainings of another
    training file or other models.
    """
    data = read(rigs)
    texts = {(w.rig, w.source): _text(rigs, w) for w in work_of(data)}
    (out / "drives").mkdir(parents=True, exist_ok=True)
    others = [s for s in data["scores"] if s["controller"] != NAME or s["tuned_on"] == "none"]
    training = {
        "config": config.path.name,
        "text": config.text,
        "steps": config.num_steps,
        "command": command,
    }
    rows: list[dict[str, Any]] = []
    for work in work_of(data):
        kept = out / "drives" / f"{work.rig}_{work.source}.json"
        model = rigs / "rigs" / work.rig / f"{work.source}.yaml"
        origin = {"config": config.text, "model": texts[work.rig, work.source]}
        if not kept.is_file():
            if progress:
                print(f"{work.rig}: agent of the {work.source} model", flush=True)
            policy = _trained(work, model, out / "runs" / work.training, config, command, progress)
            truth = load_model(rigs / "rigs" / work.rig / "true.yaml")
            hidden = read_json(rigs / "rigs" / work.rig / "truth.json", "the truth of a practice rig")
            drawn: dict[str, Any] = {"forms": work.forms, "constants": constants_of(hidden)}
            drives = {
                name: close_loop.scored(drive(NumpyPolicy(policy), truth, name, work.seed, **drawn))
                for name in close_loop.SCENARIOS
            }
            write_json(kept, {**origin, "drives": drives}, indent=None)
        done = read_json(kept, "the drives of an agent", max_bytes=MAX_BYTES_OF_RESULTS)
        if {key: done[key] for key in origin} != origin:
            raise InputError(f"{kept}: is of another training file or model; name another --out")
        about = {
            "controller": NAME,
            "tuned_on": work.source,
            "rig": work.rig,
            "case": work.case,
            "seed": work.seed,
        }
        rows += [{**about, "scenario": name, **result} for name, result in done["drives"].items()]
        if work.source == SOURCES[-1]:
            scores = others + rows
            data = {**data, "agent": training, "scores": scores, "summary": collect(scores)}
            close_loop.write(out, data)
    return data


def read(folder: Path) -> dict[str, Any]:
    """What `write` wrote. InputError if there is no such result."""
    what = f"a result of `hydro-env close-loop --out {folder}`"
    files = folder / "close_loop.json", folder / "traces.json"
    data, traces = (read_json(file, what, max_bytes=MAX_BYTES_OF_RESULTS) for file in files)
    if not isinstance(data, dict) or data.get("schema") != close_loop.SCHEMA:
        raise InputError(f"{folder / 'close_loop.json'}: its schema should be {close_loop.SCHEMA!r}")
    kept = {_of(s): s for s in traces}
    return {**data, "scores": [kept.get(_of(s), s) for s in data["scores"]]}


def _of(row: Mapping[str, Any]) -> tuple[str, ...]:
    return tuple(row[key] for key in ("controller", "tuned_on", "rig", "scenario"))


def _text(rigs: Path, work: Work) -> str:
    """The file of a model. InputError if it is not there, before anything is trained."""
    path = rigs / "rigs" / work.rig / f"{work.source}.yaml"
    try:
        return path.read_text(encoding="utf-8")
    except OSError as problem:
        raise InputError(
            f"{path}: {problem.strerror}; `hydro-env close-loop --out {rigs}` writes it"
        ) from None


def _trained(work: Work, model: Path, folder: Path, config: Config, command: str, bar: bool) -> Path:
    """The policy trained on a model; what has been trained already is not trained again."""
    own = replace(
        config,
        env_kwargs={**config.env_kwargs, "plant": str(model), "mismatch": None},
        training=config.training.model_copy(update={"seed": work.seed}),
    )
    train(own, folder, resume=(folder / "config.yml").is_file(), command=command, bar=bar)
    return folder / "policy.npz"


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m agents.close_loop",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--rigs", type=Path, required=True, help="folder that `hydro-env close-loop` wrote")
    parser.add_argument("--out", type=Path, required=True, help="folder to write to; may be the same")
    parser.add_argument("--config", type=Path, default=CONFIG, help="training file; its plant is replaced")
    parser.add_argument("--quiet", action="store_true", help="no progress bars")
    given = parser.parse_args()

    def work() -> None:
        command = f"python -m agents.close_loop --config {given.config.name}"
        data = run(
            given.rigs, given.out, read_config(given.config), command=command, progress=not given.quiet,
        )  # fmt: skip
        print(summary(data))

    run_command(work)


if __name__ == "__main__":
    main()
