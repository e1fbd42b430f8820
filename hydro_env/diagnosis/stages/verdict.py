"""The verdict: `none`, `calibration`, `effects` or `unknown`, and whether the held-out logs confirm it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from ...plant import CATALOGUE
from ..estimation import (
    CANNOT_BE_PREDICTED,
    Estimate,
    Fit,
    mostly_explained,
    predictions_apart,
    unexplained,
)
from ..settings import rule
from ..state import PROVEN, Estimates, State
from .candidates import Selection, carries_size, neutral_of
from .localisation import locate
from .naming import effect_values
from .validation import NAMED, Proof, proved

__all__ = ["confirm", "decide", "doubts"]

DOUBT_WORSE = rule("doubt_worse", "reject names that make a signal worse of the held-out logs")
DOUBT_LEFT = rule(
    "doubt_left", "reject names that leave much of a signal of the fit logs, whatever their form"
)
DOUBT_NEUTRAL = rule("doubt_neutral", "reject names whose interval holds the neutral value")

#: A signal of the held-out logs is made worse if its error is so many times what calibration alone leaves, and so many times
#: the noise.
WORSE, WORSE_NOISE = 1.2, 3.0
#: A signal above so many times its noise is off for sure.
ABOVE_NOISE = 1.1
#: What names and the corrections of their form may leave of a signal of the fit logs: so many times the noise, or this share of
#: what calibration alone leaves; or, in `Fit.levels`: one event or two in a log, such as a spool that meets its end stop late,
#: speak against no name.
LEFT_NOISE, LEFT_SHARE, LEFT_LEVEL = 3.0, 0.05, 0.1
#: Calibration is visible if the error was above what it leaves by this factor, and sure if it gains so much for each parameter.
CALIBRATION_VISIBLE, CALIBRATION_GAIN = 1.03, 6.0


# --- from the fit logs ----------------------------------------------------------------------------------------------------
def decide(state: State) -> State:
    """The verdict by the fit logs."""
    verdict = _verdict(state.fit, state.given, state.calibrated, state.selection)
    return replace(state, verdict=verdict, final=state.given if verdict == "none" else state.final)


def _verdict(fit: Fit, given: Estimates, calibrated: Estimates, selection: Selection) -> str:
    left = any(unexplained(fit, selection.estimates[c], c) for c in fit.rig.channels)
    found = {c: selection.in_best_form(c) for c in fit.rig.channels}
    if selection.accepted:
        mostly = all(mostly_explained(fit, calibrated[c], found[c], c) for c in fit.rig.channels)
        return "effects" if mostly or not left else "unknown"
    if any(unexplained(fit, found[c], c) for c in fit.rig.channels):
        return "unknown"
    better = any(_better(fit, given[c], calibrated[c], c) for c in fit.rig.channels)
    return "calibration" if better else "none"


def _better(fit: Fit, given: Estimate, calibrated: Estimate, channel: int) -> bool:
    """Whether calibration explains more than its number of parameters would by chance."""
    old, new = (fit.rms(p.simulated[channel], channel) for p in (given, calibrated))
    visible = any(old[k] > CALIBRATION_VISIBLE * max(new[k], fit.noise[channel, k[1]]) for k in old)
    moved = sum(u.channel in (None, channel) for u in calibrated.unknowns)
    return visible and fit.gain(given, calibrated, (channel,)) > CALIBRATION_GAIN * moved


# --- from the held-out logs -----------------------------------------------------------------------------------------------
def confirm(state: State) -> State:
    """The verdict by the held-out logs: names that are doubted are not confirmed, and not corrected either.

    Held-out logs that seem to be of another rig or state judge nothing.
    """
    state = replace(state, elsewhere=list(_elsewhere(state)))
    if state.verdict != "effects" or state.elsewhere:
        return state
    found = doubts(
        state.fit, state.fit.on(state.held_out), state.selection, state.final, state.judged_fit, state.judged
    )
    if not found:
        return state
    bare = replace(
        state, doubts=found, verdict="unknown", final=state.selection.estimates, placebo=state.selection.placebo,
        corrections=[], locations=state.locations or locate(state.rig, state.calibrated),
    )  # fmt: skip
    return proved(bare)


def _elsewhere(state: State) -> Iterator[str]:
    """What of the held-out logs is not as in the fit logs, which the same model explains to the noise.

    The coil comes first: nothing but the command acts on its current, so that one that is off means another coil or temperature.
    Other signals say so only where nothing is named: an effect may fit the logs that it was chosen by.
    """
    if not state.rig.has_hidden_states or state.undetermined:
        return
    every, held_out = state.verdict in ("none", "calibration"), state.fit.on(state.held_out)
    for (c, signal), there in sorted(state.judged.errors.items(), key=lambda item: item[0][1] != "current"):
        here = state.judged_fit.errors[c, signal]
        times, before = (e["after"] / max(e["noise"], 1e-30) for e in (there, here))
        if not (every or signal == "current") or times < PROVEN or before > ABOVE_NOISE:
            continue
        if predictions_apart(held_out, state.final[c], c).get(signal, 0.0) < times:
            worse = (
                ", worse than by the model as given" if there["after"] > ABOVE_NOISE * there["before"] else ""
            )
            name = "coil current" if signal == "current" else signal.replace("_", " ")
            yield f"the {name} of channel {c + 1} is left {times:.2g} times its noise there{worse}"


def doubts(
    fit: Fit, held_out: Fit, selection: Selection, final: Estimates, on_fit: Proof, on_held_out: Proof
) -> list[str]:
    """Why what was named is not confirmed although it explains most of the fit logs, a sentence each; none if it is.

    `final` are the named effects with the corrections of their form, the proofs are with both. The held-out logs judge here and
    choose nothing. Where estimates that the fit logs cannot distinguish (`predictions_apart`) give courses that differ by more
    than what is left of a signal, that residual speaks against no name.
    """
    found: list[str] = []
    for c in dict.fromkeys(k.channel for k in selection.accepted if k.channel is not None):
        found += _doubts_of_channel(fit, held_out, final, c, on_fit, on_held_out)
    if fit.settings.uses(DOUBT_NEUTRAL):
        for one in selection.accepted:
            c = fit.rig.channels[0] if one.channel is None else one.channel
            if _may_be_absent(final[c], one.effect, c):
                place = "the rig" if one.channel is None else f"channel {c + 1}"
                found.append(
                    f"{CATALOGUE[one.effect].title} of {place}: its interval holds the neutral value"
                )
    return list(dict.fromkeys(found))


def _may_be_absent(estimate: Estimate, effect: str, channel: int) -> bool:
    """Whether the intervals of all that gives an effect its size hold the neutral values."""
    sizes = {u.parameter: neutral_of(u) for u in estimate.unknowns if u.effect == effect and carries_size(u)}
    found = {name: v for name, v in effect_values(estimate, effect, channel).items() if name in sizes}
    return bool(found) and all(v.low <= sizes[name] <= v.high for name, v in found.items())


def _doubts_of_channel(
    fit: Fit, held_out: Fit, final: Estimates, c: int, on_fit: Proof, on_held_out: Proof
) -> Iterator[str]:
    uses, dynamic = fit.settings.uses, fit.rig.has_hidden_states
    level = fit.levels(on_fit.traces["after"][c], c)
    fit_apart, held_out_apart = (predictions_apart(each, final[c], c) for each in (fit, held_out))
    for (channel, signal), entry in on_held_out.errors.items():
        if channel != c:
            continue
        fitted, plain = on_fit.errors[channel, signal], f"the {signal} of channel {c + 1}"
        # A correction of form proves nothing of the name.
        after, noise, calibrated = entry.get(NAMED, entry["after"]), entry["noise"], entry["calibrated"]
        silent = held_out_apart.get(signal, 0.0) > max(CANNOT_BE_PREDICTED, after / noise)
        clearly = after > WORSE * calibrated and after > WORSE_NOISE * noise
        worse = clearly or (dynamic and _worse(fitted) and _worse(entry))
        if not silent and worse and uses(DOUBT_WORSE):
            yield f"{plain} is explained worse with the named effects than by calibration alone"
        times = fitted["after"] / fitted["noise"]
        far = fit_apart.get(signal, 0.0) < times and _far_from_explained(fitted)
        if dynamic and far and level[signal] > LEFT_LEVEL and uses(DOUBT_LEFT):
            yield f"{plain} of the fit logs is left {times:.2g} times its noise, whatever the form of what is named"


def _worse(entry: dict[str, float]) -> bool:
    """Whether what was named, in its own form or a corrected one, adds to the power above the noise of a signal."""
    noise = entry["noise"] ** 2
    after = min(entry["after"], entry.get(NAMED, entry["after"])) ** 2
    return after > ABOVE_NOISE**2 * noise and after - noise > WORSE * (entry["calibrated"] ** 2 - noise)


def _far_from_explained(entry: dict[str, float]) -> bool:
    """Whether a signal is left far from its noise, by what calibration alone left too.

    Whatever names fit the logs, what is left with the form of each put right is no matter of form any more.
    """
    return entry["after"] > max(LEFT_NOISE * entry["noise"], LEFT_SHARE * entry["calibrated"])
