"""What a reader should know besides: doubts, findings of the logs, weak logs, estimates at their bounds."""

import math
from collections.abc import Iterator, Sequence

from ...measured.finding import SPELLING
from ...plant import CATALOGUE, parameter_of
from ..estimation.estimate import Estimates
from ..estimation.uncertainty import unpredictable
from ..input.parts import Part
from ..models.base import RigModel
from ..result import Diagnosis
from .form_correction import is_correction
from .screening import hidden_by_calibration
from .validation import shown_unit, signal_key
from .values import absent_effects

#: The held-out logs are explained worse by the final model than by another one if its error is this many times that one's, and so
#: many times the noise: differences that a reader would see.
WORSE, WORSE_NOISE = 1.1, 1.3
#: An estimate is at a bound, or as given, within this share of its range: less than any interval.
AT_BOUND = 1e-3


def run(state: Diagnosis) -> list[str]:
    """Collects the warnings, the weightiest first."""
    about = (
        ("these logs do not determine the known parameters", state.undetermined),
        ("the held-out logs seem to be of another rig or state", state.elsewhere),
        ("none of the named effects is confirmed", state.doubts),
    )
    found = [f"{text}: {'; '.join(why)}" for text, why in about if why]
    found += [f.text for f in state.findings]
    found += [
        f"the model as given has a {CATALOGUE[effect].title} on channel {c + 1} that these logs do not show"
        for effect, c in absent_effects(state.rig, state.models.shown)
    ]
    found += [*_about_errors(state), *about_logs(state.rig, (*state.rig.parts, *state.logs.held_out.parts))]
    found += about_bounds(state.models.final)
    if state.verdict == "unknown":
        found.append(
            "something is missing from the model, so true values may lie outside the intervals of parameters"
        )
    hidden = [name.replace("_", " ") for name in hidden_by_calibration(state.screening)]
    if hidden and state.verdict in ("none", "calibration"):
        found.append(f"calibration hides these effects, so they cannot be excluded: {', '.join(hidden)}")
    return [*found, *_about_predictions(state)]


def _about_errors(state: Diagnosis) -> Iterator[str]:
    for (c, signal), e in state.proofs.judged.errors.items():
        for model, said in (("before", "the model as given"), ("calibrated", "the calibrated model alone")):
            if e["after"] > max(WORSE * e[model], WORSE_NOISE * e["noise"]):
                yield (
                    f"{signal_key(state.rig, signal, c)}: the held-out logs are explained worse than by {said} "
                    f"({e['after']:.3g}, {e[model]:.3g} by that); the fit logs say too little about what the held-out ones show"
                )


def about_bounds(estimates: Estimates) -> Iterator[str]:
    """Estimates that end at the edge of what is plausible."""
    for c, estimate in estimates.items():
        for u, q in zip(estimate.unknowns, estimate.q, strict=True):
            (first, last), near = u.bounds, AT_BOUND * (u.bounds[1] - u.bounds[0])
            # What stayed as given may be given at the end of its range; a correction is no physics.
            if abs(q) <= near or first + near < q < last - near or (u.effect and is_correction(u.effect)):
                continue
            # A given effect may be absent; the upper end of a limit's range stands for none.
            if "." in u.parameter:
                p, low = parameter_of(u.parameter), u.value(float(q)) < 0.5 * (u.low + u.high)
                if p.neutral == (u.low if low else math.inf if p.role == "limit" else u.high):
                    continue
            if u.channel in (None, c) and u.high > u.low:
                value = f"{u.value(float(q)):.3g} {u.unit}"
                yield f"{u.name} of channel {c + 1} ({value}) ends at the edge of its plausible range"


def about_logs(rig: RigModel, parts: Sequence[Part]) -> Iterator[str]:
    """What the model and the reading of these logs say."""
    yield from rig.notes
    yield from (p.note for p in parts if p.note)
    for part in {p.log.sha256: p for p in parts}.values():
        # How a file is written matters least, so it is said last.
        for finding in sorted(part.log.findings, key=lambda f: f.code in SPELLING):
            yield f"{part.log.name}: {finding.text}"


def _about_predictions(state: Diagnosis) -> Iterator[str]:
    for c in sorted(state.rig.followed):
        e, unit = state.proofs.judged.errors[c, "speed"], shown_unit(state.rig, "speed", c)[0]
        yield (
            f"the coupling of channel {c + 1} rattles, so that free simulations run apart from the rig (the errors shown are of "
            "these); names are judged by simulations that follow the measured speed, and these leave "
            f"{e['after']:.3g} {unit} of it, {e['calibrated']:.3g} with calibration alone; noise {e['noise']:.3g}"
        )
    held_out = state.logs.fit.on(state.logs.held_out)
    for c in state.rig.channels if state.effects and state.rig.has_hidden_states else ():
        for signal, times in unpredictable(held_out, state.models.final[c], c).items():
            yield (
                f"the {signal} of channel {c + 1} on the held-out logs cannot be predicted: estimates that the fit logs cannot "
                f"distinguish give results {times:.2g} times the noise apart"
            )
