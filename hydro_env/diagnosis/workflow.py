"""The command `hydro-env diagnose`: from logs to verdict, numbers, page and improved model.

    hydro-env diagnose FIT_LOG... --sealed LOG... [--model PRESET_OR_YAML] [--mapping YAML] [--jobs N] [--seed N] --out DIR

`LOG@FROM:TO` names a part of a log in seconds, `LOG@0:13,23:34` two windows of it; so one long run can serve for both
fit and proof. Axes whose mapping says `actuator: cylinder`, or any with `--steady`, are diagnosed with the reduced
steady-valve model (`steady_valve`), everything else with the dynamic plant (`motor`).
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError
from ..files import write_json, write_text
from ..measured.finding import SPELLING
from ..plant import PlantModel, load_model
from .estimation.least_squares import Floors, Problem, floors_from, lower, rescored, solve
from .estimation.multistart import along_all, far_from_noise, take_over
from .estimation.uncertainty import undetermined
from .input.parts import Part, overlap, read_parts
from .models.base import Machine
from .models.dynamic_rig import MotorRig
from .models.steady_valve import SteadyValve
from .report.wording import plain
from .stages.calibration import as_given, calibrate
from .stages.consistency import implausible, stop_if_sure
from .stages.form_correction import Corrected, corrected_all, placebo_too
from .stages.localisation import Place, locate
from .stages.screening import Look, absorb, first_look, hidden_by_calibration
from .stages.selection import Selection, penalty_per_number, select
from .stages.validation import MODELS, NAMED, Proof, prove
from .stages.verdict import (
    Named,
    at_bounds,
    diagnosis_dict,
    doubts,
    estimated_model,
    make_sure,
    named_effects,
    verdict,
)

__all__ = ["Diagnosis", "diagnose", "run"]


#: Steps of q for the differences in the iterations of the refit of what was found, by the noise that is seen then, and of the
#: last one, by the proof's substeps.
SHARPEN, LAST = (0.15, 0.04, 0.4, 0.15, 0.04, 0.4), (0.15, 0.04, 0.01, 0.04, 0.01)
#: Fit logs that are shorter in all than this, s, say little.
SHORT = 4.0


@dataclass
class Diagnosis:
    """Everything that was found; `data` is the content of diagnosis.json."""

    data: dict[str, Any]
    model: PlantModel
    machine: Machine
    named: list[Named]
    places: list[Place]
    selection: Selection
    looks: list[Look]
    fit: Proof
    sealed: Proof
    warnings: list[str]


def diagnose(
    fit_logs: Sequence[str | Path], sealed: Sequence[str | Path], *, model: str | Path | PlantModel = "paper",
    mapping: str | Path | None = None, jobs: int = 1, seed: int = 0, steady: bool = False, without: Sequence[str] = (),
    accept: Sequence[str] = (), say: Callable[[str], None] = lambda text: None, count: Callable[[int], None] | None = None,
) -> Diagnosis:  # fmt: skip
    """The whole workflow. `say` is told each stage in words, `count` the number of simulations done.

    `without` names effects that are not to be candidates; `accept` codes of findings (`sign`, `swapped`, `unit`, ...) that
    would otherwise stop a diagnosis. InputError for anything that cannot be used. `seed` is that of
    the bootstrap; the same seed gives the same result, with any number of threads (`jobs`) that simulate.
    """
    begin = time.perf_counter()
    if not fit_logs:
        raise InputError("no fit log; name at least one log to fit")
    if not sealed:
        raise InputError("no sealed log; name at least one with --sealed (or a part of a run, LOG@FROM:TO)")
    given_model = load_model(model)
    say("reading logs")
    parts, proofs = read_parts(fit_logs, mapping, accept), read_parts(sealed, mapping, accept)
    overlap(parts, proofs)
    parts, proofs = _with_common_signals(*_without_idle(parts, proofs))
    _check_channels(parts, proofs)
    machine = _machine(given_model, parts, steady, jobs, count, frozenset(without))
    seconds = max(len(p.log) * p.log.period for p in parts)

    try:
        return _workflow(machine, given_model, parts, proofs, seconds, say, begin, seed, accept)
    finally:
        machine.close()


def _workflow(
    machine: Machine, given_model: PlantModel, parts: list[Part], proofs: list[Part], seconds: float,
    say: Callable[[str], None], begin: float, seed: int, accept: Sequence[str],
) -> Diagnosis:  # fmt: skip
    """The stages."""
    say("model as given")
    given = as_given(machine, {(c, s.signal): 1e-9 for c in machine.channels for s in machine.segments[c]})
    odd = implausible(machine, given)
    stop_if_sure(odd, ", ".join(p.label for p in parts), accept)
    floors = floors_from(machine, given)
    say("calibrating known parameters")
    calibrated = calibrate(machine, floors)
    floors = lower(floors, floors_from(machine, calibrated))
    rescored(machine, list(calibrated.values()), floors)
    say("looking at every effect")
    looks = first_look(machine, calibrated, floors, machine.candidates(), seconds)
    if not machine.quick:
        absorb(machine, calibrated, floors, looks)
    selection = select(machine, calibrated, looks, floors, seconds, say)
    floors = lower(floors, floors_from(machine, selection.problems))
    taken = [
        p for c, p in selection.problems.items() if any(k.channel in (None, c) for k in selection.choices)
    ]
    _sharpened(machine, taken, floors)
    word = verdict(machine, given, calibrated, selection, floors)
    say("locating the gap")
    places = locate(machine, calibrated) if word not in ("none", "calibration") else []
    final = given if word == "none" else selection.problems
    wrong = selection.placebo
    corrections: list[Corrected] = []
    if word == "effects":
        say("correcting the form of what is named")
        machine.exact = True
        per_number = penalty_per_number(machine)
        final, corrections = corrected_all(
            machine, selection.problems, selection.named(), floors, per_number, selection.formed
        )
        wrong = placebo_too(machine, wrong, corrections, floors)
        machine.exact = False
    # The last steps of what is near the noise are by the proof's substeps: where a shaft nearly comes to rest a parameter's
    # last decimals count.
    fine = machine if machine.quick else machine.with_parts(parts, False)
    if word == "effects":
        every = (*final.values(), *wrong.values())
        _sharpened(fine, [p for p in every if not far_from_noise(fine, p, floors)], floors, LAST)
    say("proof on sealed logs")
    models = {"before": given, "calibrated": calibrated, "after": final, "placebo": {**calibrated, **wrong}}
    if corrections:
        models[NAMED] = selection.problems
    fit_proof = prove(fine, models)
    sealed_machine = machine.with_parts(proofs, True)
    sealed_proof = prove(sealed_machine, models)

    say("how sure")
    make_sure(machine, [*final.values(), *selection.problems.values(), *calibrated.values()], floors, seed)
    refuted = doubts(machine, selection, final, fit_proof, sealed_proof, floors) if word == "effects" else []
    if refuted:
        # What is not vouched for is not corrected either.
        final, corrections = selection.problems, []
        models = {
            **{n: models[n] for n in MODELS},
            "after": final,
            "placebo": {**calibrated, **selection.placebo},
        }
        fit_proof, sealed_proof = prove(fine, models), prove(sealed_machine, models)
        word = "unknown"
        places = places or locate(machine, calibrated)
    named = named_effects(machine, selection, looks, floors, seed, final)
    warnings = [*(f.text for f in odd), *_warnings(machine, parts, proofs, final, sealed_proof)]
    hidden = hidden_by_calibration(looks)
    if hidden and word in ("none", "calibration"):
        warnings.append(
            f"calibration would take all of these, so that they cannot be excluded: {', '.join(plain(n) for n in hidden)}"
        )
    for c in machine.channels if named and not machine.quick else ():
        for signal, times in undetermined(sealed_machine, final[c], c, floors).items():
            warnings.append(
                f"the {signal} of channel {c + 1} on the sealed logs cannot be foretold: estimates that the fit logs cannot part "
                f"give courses {times:.2g} times the noise apart"
            )
    if refuted:
        warnings.insert(0, f"none of what is named is vouched for: {'; '.join(refuted)}")
    hashes = {Path(str(p.label).split("@")[0]).name: p.log.sha256 for p in (*parts, *proofs)}
    data = diagnosis_dict(
        machine, word, named, places, final if word != "none" else calibrated, fit_proof, sealed_proof, looks, selection,
        corrections, time.perf_counter() - begin, hashes, warnings,
    )  # fmt: skip
    improved = (
        given_model if word == "none" else estimated_model(machine, final, f"{given_model.name} diagnosed")
    )
    return Diagnosis(
        data, improved, machine, named, places, selection, looks, fit_proof, sealed_proof, warnings
    )


def _sharpened(
    machine: Machine, problems: Sequence[Problem], floors: Floors, sizes: Sequence[float] = SHARPEN
) -> None:
    """Refits what was found, in place: by the noise that is seen now, since what was missing made it look larger, and by the
    substeps of `machine`."""
    if machine.quick:
        return
    machine.exact = True
    every = [p for p in {id(p): p for p in problems}.values() if p.unknowns]
    finer = [along_all(p) for p in every]
    solve(machine, finer, floors, len(sizes), sizes=sizes)
    for problem, other in zip(every, finer, strict=True):
        problem.cost = math.inf  # was counted by another noise, or with other substeps
        take_over(problem, other)
    machine.exact = False


def _machine(
    model: PlantModel, parts: list[Part], steady: bool, jobs: int, count: Callable[[int], None] | None,
    without: frozenset[str],
) -> Machine:  # fmt: skip
    kinds = {part.log.kinds[c] for part in parts for c in part.log.channels}
    if len(kinds) > 1:
        raise InputError("the mapping mixes motors and cylinders; diagnose one kind at a time")
    if steady or kinds == {"cylinder"}:
        return SteadyValve(model, parts, progress=count, without=without)
    return MotorRig(model, parts, jobs=jobs, progress=count, without=without)


def _without_idle(parts: list[Part], proofs: list[Part]) -> tuple[list[Part], list[Part]]:
    """The logs without a channel that was never driven and never moved, while the other one was."""
    idle = []
    for c in parts[0].log.channels:
        others = [o for o in parts[0].log.channels if o != c]
        peak = max(
            (float(np.nanmax(np.abs(p.log.speed[:, others]), initial=0.0)) for p in parts), default=0.0
        )
        still = all(
            c in p.log.channels
            and not p.log.command_V[:, c].any()
            and np.sqrt(np.nanmean(p.log.speed[:, c] ** 2)) < 0.02 * peak
            for p in parts
        )
        if still and others:
            idle.append(c)
    if len(idle) != 1:
        return parts, proofs
    text = f"channel {idle[0] + 1} was neither driven nor did it move: only the other one is diagnosed"
    found = [[_without_channel(p, idle[0]) for p in each] for each in (parts, proofs)]
    found[0][0] = replace(found[0][0], note="; ".join(t for t in (found[0][0].note, text) if t))
    return found[0], found[1]


def _with_common_signals(parts: list[Part], proofs: list[Part]) -> tuple[list[Part], list[Part]]:
    """The logs without the signals that only some of the fit logs have."""
    for signal in ("current", "pressure", "spool", "flow"):
        for c in parts[0].log.channels:
            having = [part.log.has(signal, c) for part in parts]
            if any(having) and not all(having):
                without = parts[having.index(False)].label
                text = (
                    f"{signal} of channel {c + 1} is not in every fit log (not in {without}): left out of all"
                )
                parts, proofs = ([_without_signal(p, signal, c) for p in each] for each in (parts, proofs))
                parts[0] = replace(parts[0], note="; ".join(t for t in (parts[0].note, text) if t))
    return parts, proofs


def _without_signal(part: Part, signal: str, channel: int) -> Part:
    if not part.log.has(signal, channel):
        return part
    values = part.log.get(signal)
    assert values is not None
    values = values.copy()
    values[:, channel] = np.nan
    return replace(part, log=replace(part.log, **{signal: None if np.isnan(values).all() else values}))  # type: ignore[arg-type]


def _without_channel(part: Part, channel: int) -> Part:
    command, speed = part.log.command_V.copy(), part.log.speed.copy()
    command[:, channel] = speed[:, channel] = np.nan
    return replace(part, log=replace(part.log, command_V=command, speed=speed))


def _check_channels(parts: list[Part], proofs: list[Part]) -> None:
    for part in (*parts, *proofs):
        if part.log.channels != parts[0].log.channels:
            raise InputError(
                f"{part.label}: has channels {_listed(part)}, {parts[0].label} has {_listed(parts[0])}; "
                "all logs need the same"
            )
    for c in parts[0].log.channels:
        if not any(abs(part.log.command_V[:, c]).max() > 0.0 for part in parts):
            raise InputError(
                f"{parts[0].label}: the command of channel {c + 1} is zero throughout{_yet_moves(parts, c)}; "
                "record the signal that drives the valve"
            )


def _yet_moves(parts: list[Part], c: int) -> str:
    peaks = [float(np.nanmax(np.abs(p.log.speed[p.inside, c]), initial=0.0)) for p in parts]
    moves = max(peaks) > 0.0 and max(peaks) >= 0.01
    return " though the axis moves: something else drove it" if moves else ""


def _listed(part: Part) -> str:
    return " and ".join(str(c + 1) for c in part.log.channels)


def _cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _warnings(
    machine: Machine, parts: list[Part], proofs: list[Part], final: dict[int, Problem], proof: Proof
) -> list[str]:
    found = [*machine.notes, *(p.note for p in (*parts, *proofs) if p.note)]
    for part in {p.log.sha256: p for p in (*parts, *proofs)}.values():
        # How a file is written matters least, so it is said last.
        ordered = sorted(part.log.findings, key=lambda f: f.code in SPELLING)
        found += [f"{part.log.name}: {f.text}" for f in ordered]
    lasts = sum(len(p.log) * p.log.period for p in parts)
    if lasts < SHORT:
        found.insert(0, f"the fit logs last {lasts:.2g} s in all: too short to part effects from each other")
    for key, entry in proof.gap.items():
        if entry["after"] > 1.1 * entry["before"] and entry["after"] > 1.3 * entry["noise"]:
            worse = f"{entry['after']:.3g}, {entry['before']:.3g} before"
            found.insert(
                0,
                f"{key}: the sealed logs are explained worse than by the model as given ({worse}); the fit logs say too "
                "little about what the sealed ones show",
            )
    found += [f"{text} ends at the edge of its plausible range" for text in at_bounds(final)]
    for key, entry in proof.gap.items():
        if entry["after"] > 1.02 * entry["calibrated"] and entry["after"] > 1.2 * entry["noise"]:
            found.append(
                f"{key}: on the sealed logs the calibrated model alone was better than with the named effects"
            )
    return found


def run(
    fit_logs: Sequence[str | Path], sealed: Sequence[str | Path], out: str | Path, *, model: str | Path = "paper",
    mapping: str | Path | None = None, jobs: int | None = None, seed: int = 0, steady: bool = False,
    accept: Sequence[str] = (), quiet: bool = False,
) -> Diagnosis:  # fmt: skip
    """The command: diagnoses, prints about twenty lines, writes diagnosis.json, report.html and model.yaml to `out`.

    `jobs` threads (None: one for every core that this process may use), as in `diagnose`.
    """
    from tqdm import tqdm

    from .report.page import report_page, terminal_text

    with tqdm(unit=" simulations", disable=quiet or None, leave=False) as bar:
        found = diagnose(
            fit_logs, sealed, model=model, mapping=mapping, jobs=jobs or _cores(), seed=seed, steady=steady,
            accept=accept, say=lambda text: bar.set_description(text), count=bar.update,
        )  # fmt: skip
        bar.set_description("writing the report")
        page = report_page(found)
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    write_json(folder / "diagnosis.json", found.data)
    found.model.to_yaml(folder / "model.yaml")
    write_text(folder / "report.html", page)
    if not quiet:
        print(terminal_text(found))
    return found
