"""What a reader should know besides: doubts, findings of the logs, weak logs, estimates at their bounds."""

from __future__ import annotations

from collections.abc import Iterator

from ...measured.finding import SPELLING
from ...plant import CATALOGUE
from ..estimation import unpredictable
from ..state import State
from .screening import hidden_by_calibration
from .validation import shown_unit, signal_key
from .values import absent_effects, at_bounds

__all__ = ["run"]

#: Fit logs that are shorter in all than this, s, say little.
SHORT_LOGS = 4.0


def run(state: State) -> list[str]:
    """Collects the warnings, the weightiest first."""
    found = []
    if state.undetermined:
        found.append(f"these logs do not determine the known parameters: {'; '.join(state.undetermined)}")
    if state.elsewhere:
        found.append(f"the held-out logs seem to be of another rig or state: {'; '.join(state.elsewhere)}")
    found += [f"none of the named effects is confirmed: {'; '.join(state.doubts)}"] if state.doubts else []
    found += [f.text for f in state.findings]
    found += [
        f"the model as given has a {CATALOGUE[effect].title} on channel {c + 1} that these logs do not show"
        for effect, c in absent_effects(state.rig, state.shown)
    ]
    found += _about_logs_and_fit(state)
    if state.verdict == "unknown":
        found.append(
            "something is missing from the model, so true values may lie outside the intervals of parameters"
        )
    hidden = [name.replace("_", " ") for name in hidden_by_calibration(state.screening)]
    if hidden and state.verdict in ("none", "calibration"):
        found.append(f"calibration hides these effects, so they cannot be excluded: {', '.join(hidden)}")
    for c in sorted(state.rig.followed):
        entry, unit = (
            state.proofs.judged.errors[c, "speed"],
            shown_unit(state.rig, "speed", c)[0].replace("_", " "),
        )
        found.append(
            f"the coupling of channel {c + 1} rattles, so that free simulations run apart from the rig (the errors shown are of "
            "these); names are judged by simulations that follow the measured speed, and these leave "
            f"{entry['after']:.3g} {unit} of it, {entry['calibrated']:.3g} with calibration alone; noise {entry['noise']:.3g}"
        )
    for c in state.rig.channels if state.effects and state.rig.has_hidden_states else ():
        for signal, times in unpredictable(state.fit.on(state.held_out), state.final[c], c).items():
            found.append(
                f"the {signal} of channel {c + 1} on the held-out logs cannot be predicted: estimates that the fit logs cannot "
                f"distinguish give results {times:.2g} times the noise apart"
            )
    return found


def _about_logs_and_fit(state: State) -> list[str]:
    rig, parts = state.rig, (*state.rig.parts, *state.held_out.parts)
    first, found = [], [*rig.notes, *(p.note for p in parts if p.note)]
    for part in {p.log.sha256: p for p in parts}.values():
        # How a file is written matters least, so it is said last.
        ordered = sorted(part.log.findings, key=lambda f: f.code in SPELLING)
        found += [f"{part.log.name}: {f.text}" for f in ordered]
    lasts = sum(len(p.log) * p.log.period for p in rig.parts)
    if lasts < SHORT_LOGS:
        first.append(f"the fit logs last {lasts:.2g} s in all: too short to distinguish effects")
    for key, entry in _errors(state):
        if entry["after"] > 1.1 * entry["before"] and entry["after"] > 1.3 * entry["noise"]:
            worse = f"{entry['after']:.3g}, {entry['before']:.3g} before"
            first.append(
                f"{key}: the held-out logs are explained worse than by the model as given ({worse}); the fit logs "
                "say too little about what the held-out ones show"
            )
    found += [f"{text} ends at the edge of its plausible range" for text in at_bounds(state.final)]
    for key, entry in _errors(state):
        if entry["after"] > 1.02 * entry["calibrated"] and entry["after"] > 1.2 * entry["noise"]:
            found.append(
                f"{key}: on the held-out logs the calibrated model alone was better than with the named effects"
            )
    return [*first[::-1], *found]


def _errors(state: State) -> Iterator[tuple[str, dict[str, float]]]:
    for (c, signal), entry in state.proofs.judged.errors.items():
        yield signal_key(state.held_out, signal, c), entry
