"""The next experiment: commands, and loads where the rig has been loaded, that show what the logs leave open.

Open are the names that are listed as indistinguishable from a named effect; where nothing is confirmed, the candidates that
explain most of each channel, and what the held-out logs ask of parameters that the fit logs leave open. Each model has been
refitted to the logs; `experiment_design` finds the experiment. What the catalogue knows of a pair is said beside it, such as a
signal to record. The reduced model of a cylinder axis gets words only: commands from a table would drive it to the end of its
stroke.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...plant.catalogue import separating_experiment
from ..estimation.estimate import Estimate
from ..experiment_design import SECONDS, Design, Operation, Question, Trial, best_design, commands_csv
from ..models.dynamic_rig import DynamicRig
from ..result import Diagnosis
from .validation import AT_NOISE

#: The file that the commands are written to, beside diagnosis.json.
FILE = "next_experiment.csv"
#: The model without any effect: the other one where a single candidate explains something.
CALIBRATION = "calibration"
#: Models that differ by less (RMS, in units of what is not known) are not parted by commands alone.
PARTED = 1.0


@dataclass(frozen=True)
class NextExperiment:
    """What to record next: in words, the names that it separates, and the commands and loads, if there are any."""

    description: str
    separates: Sequence[str]
    design: Design | None = None

    def as_dict(self) -> dict[str, Any]:
        """The entry of diagnosis.json; `distances` between pairs are RMS in units of noise and open parameters, `prediction`
        is how far estimates are apart on the held-out logs, RMS in times the noise."""
        found: dict[str, Any] = {"description": self.description, "separates": list(self.separates)}
        if self.design is not None:
            found["distances"] = {" | ".join(pair): round(d, 2) for pair, d in self.design.apart.items()}
            if self.design.prediction is not None:
                now, then = self.design.prediction
                found["prediction"] = {"now": round(now, 2), "expected": round(then, 2)}
            found["commands"] = FILE
        return found

    def csv(self) -> str | None:
        """The text of `FILE`; None without commands."""
        return None if self.design is None else commands_csv(self.design.command_V, self.design.load)


def run(state: Diagnosis) -> NextExperiment | None:
    """Proposes what to record next, and the commands for it."""
    return proposed(state, questions(state), operations(state)) or _in_words(state)


def proposed(
    state: Diagnosis, asked: Sequence[Question], wanted: Mapping[int, Operation]
) -> NextExperiment | None:
    """The experiment that shows best what is asked and wanted; None where there is none."""
    if not (asked or wanted) or not isinstance(state.rig, DynamicRig):
        return None
    rng = np.random.default_rng([state.logs.fit.settings.seed, 21])
    design = best_design(Trial(state.logs.fit, asked, wanted), rng, max_load(state))
    names = sorted({name for question in asked for name in question.models})
    return None if design is None else NextExperiment(_described(design), names, design)


def max_load(state: Diagnosis) -> float:
    """The largest load of an experiment, N m: as the settings say, else the largest of the logs, which the rig can do."""
    if state.logs.fit.settings.load_limit is not None:
        return state.logs.fit.settings.load_limit
    logs = [part.log.load for part in (*state.rig.parts, *state.logs.held_out.parts)]
    return max(
        (float(np.nanmax(np.abs(load), initial=0.0)) for load in logs if load is not None), default=0.0
    )


# --- what is open -----------------------------------------------------------------------------------------------------
def questions(state: Diagnosis) -> list[Question]:
    """What the logs leave open: competing names by channel, each with its estimate."""
    every = {c: _tied(state, c) or _best(state, c) for c in (*state.rig.channels, None)}
    return [Question(channel, models) for channel, models in every.items() if len(models) > 1]


def operations(state: Diagnosis) -> dict[int, Operation]:
    """What the estimates of channels are to predict of the held-out logs: where nothing is proven, and where names leave more of
    them than the noise."""
    if not state.rig.has_hidden_states or state.verdict in ("none", "calibration"):
        return {}
    channels: Sequence[int] = state.rig.channels
    if state.verdict == "effects" and not state.best_guess:
        channels = [c for c in channels if state.proofs.left([c]) > AT_NOISE]
    held_out = state.logs.fit.on(state.logs.held_out)
    final = {c: state.models.final[c] for c in channels if state.models.final[c].intervals}
    return {c: Operation.of(held_out, p, c) for c, p in final.items()}


def _tied(state: Diagnosis, channel: int | None) -> dict[str, Estimate]:
    """A confirmed effect of a channel and those that it is tied with; of several, the first that is tied with others."""
    if state.verdict != "effects" or state.best_guess:
        return {}
    for effect in state.effects:
        if channel in (effect.channels or (None,)) and effect.indistinguishable_from:
            present = state.selection.estimates[state.rig.channels[0] if channel is None else channel]
            tried = _tried(state, channel)
            return {effect.name: present} | {n: tried[n] for n in effect.indistinguishable_from if n in tried}
    return {}


def _best(state: Diagnosis, channel: int | None) -> dict[str, Estimate]:
    """Where nothing is confirmed: the candidates of a channel that explain most of it, as many as it may have effects."""
    if state.verdict != "unknown" and not state.best_guess:
        return {}
    tried, most = _tried(state, channel, worthwhile=True), state.logs.fit.settings.max_effects
    found = dict(sorted(tried.items(), key=lambda item: item[1].cost)[:most])
    if len(found) == 1 and channel is not None and state.models.calibrated[channel].columns:
        found[CALIBRATION] = state.models.calibrated[channel]
    return found


def _tried(state: Diagnosis, channel: int | None, worthwhile: bool = False) -> dict[str, Estimate]:
    """The latest estimate with each candidate of a channel, or with those that paid for themselves."""
    tried = (t for t in state.selection.candidates if t.gain > t.needed or not worthwhile)
    found = ((t.effect, t.estimate) for t in tried if t.channel == channel)
    return {name: p for name, p in found if p is not None and p.columns}


# --- in words ---------------------------------------------------------------------------------------------------------
def _described(design: Design) -> str:
    """What the experiment will show, and what the catalogue says of the pair that it parts least."""
    what = "commands and loads" if design.load.any() else "commands"
    text, known = f"play the {SECONDS:g} s of {what} in {FILE} and log as before", ""
    if design.apart:
        (one, other), least = min(design.apart.items(), key=lambda item: item[1])
        pair = f"{one.replace('_', ' ')} and {other.replace('_', ' ')}"
        times = f"{least:.2g} times what is not known"
        if least >= PARTED:
            text += f": there {pair} differ by {times}"
        else:
            text = f"{what} alone hardly separate {pair} ({FILE}: {times})"
            known = "" if CALIBRATION in (one, other) else separating_experiment(one, other)
    if design.prediction is not None:
        now, then = design.prediction
        text += (
            f"; predictions of the held-out logs, now uncertain by {now:.2g} times the noise, should then be uncertain by "
            f"{then:.2g} times"
        )
    return "; or ".join(filter(None, (text, known)))


def _in_words(state: Diagnosis) -> NextExperiment | None:
    """What the catalogue knows of names that stayed tied, or which signals are missing."""
    tied = [[effect.name, *effect.indistinguishable_from] for effect in state.effects]
    tied = [names for names in tied if len(names) > 1]
    for name, *others in tied:
        for other in others:
            if text := separating_experiment(name, other):
                return NextExperiment(text, sorted({name, other}))
    signals = ("current", "pressure", "load")
    missing = [s for s in signals if not any(p.log.has(s) for p in state.rig.parts)]
    slow = "slow triangles of three amplitudes, then steps under load"
    text = f"record {', '.join(missing)} as well" if missing else slow
    return NextExperiment(text, tied[0]) if tied else None
