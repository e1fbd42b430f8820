"""The verdict: `none`, `calibration`, `effects` or `unknown`, and whether the held-out logs confirm it."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from ...plant import CATALOGUE
from ..estimation.estimate import Estimate, Estimates
from ..estimation.fit import Fit
from ..estimation.uncertainty import CANNOT_BE_PREDICTED, predictions_apart
from ..logs import Logs
from . import uncertainty, validation
from .calibration import Calibrated
from .candidates import Accepted, Selection, neutral_of
from .form_correction import Models
from .validation import AT_NOISE, NAMED, Proofs
from .values import effect_values

#: A signal of the held-out logs is made worse if its error is this many times what calibration alone leaves, and this many times
#: the noise. With these and the next three values only wrong names were doubted in blind trials (docs/evidence/notes.md).
WORSE, WORSE_NOISE = 1.2, 3.0
#: What names and the corrections of their form may leave of a signal of the fit logs: this many times the noise, or this share of
#: what calibration alone leaves; or, in `Fit.levels`: one event or two in a log, such as a spool that meets its end stop late,
#: speak against no name.
LEFT_NOISE, LEFT_SHARE, LEFT_LEVEL = 3.0, 0.05, 0.1
#: Calibration is visible if the error was above what it leaves by this factor, as much as a noise is known to, and sure if it
#: gains so much for each parameter, the 98.6 % point of chi-squared.
CALIBRATION_VISIBLE, CALIBRATION_GAIN = 1.03, 6.0


# --- from the fit logs ----------------------------------------------------------------------------------------------------
def decide(calibrated: Calibrated, selection: Selection) -> str:
    """The verdict by the fit logs."""
    fit, channels = selection.logs.fit, selection.logs.rig.channels
    given, first = calibrated.given, selection.calibrated | calibrated.plain
    found = selection.in_best_form()
    if selection.accepted:
        left = any(fit.unexplained(selection.estimates[c], c) for c in channels)
        mostly = all(fit.mostly_explained(first[c], found[c], c) for c in channels)
        return "effects" if mostly or not left else "unknown"
    if any(fit.unexplained(found[c], c) for c in channels):
        return "unknown"
    return "calibration" if any(_better(fit, given[c], first[c], c) for c in channels) else "none"


def _better(fit: Fit, given: Estimate, calibrated: Estimate, channel: int) -> bool:
    """Whether calibration explains more than its number of parameters would by chance."""
    old, new = (fit.rms(p.simulated[channel], channel) for p in (given, calibrated))
    visible = any(old[k] > CALIBRATION_VISIBLE * max(new[k], fit.noise[channel, k[1]]) for k in old)
    moved = sum(u.channel in (None, channel) for u in calibrated.unknowns)
    return visible and fit.gain(given, calibrated, (channel,)) > CALIBRATION_GAIN * moved


# --- from the held-out logs -----------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Confirmed:
    """The verdict that the held-out logs leave, why it is `unknown` though names explain the fit logs (`doubts`), and why these
    logs seem to be of another rig or state (`elsewhere`), with the models that are reported and their proofs. `absent` are named
    effects without which the logs may do."""

    verdict: str
    models: Models
    proofs: Proofs
    doubts: list[str]
    elsewhere: list[str]
    absent: list[Accepted]


def confirm(selection: Selection, verdict: str, models: Models, proofs: Proofs) -> Confirmed:
    """The verdict by the held-out logs: names that are doubted are not confirmed, and not corrected either.

    Held-out logs that seem to be of another rig or state judge nothing.
    """
    logs = selection.logs
    elsewhere = list(_elsewhere(logs, proofs))
    judged = verdict == "effects" and not elsewhere
    found = doubts(logs, selection.accepted, models.final, proofs) if judged else []
    if not found:
        return Confirmed(verdict, models, proofs, [], elsewhere, [])
    bare = models.as_named()
    bare = bare.with_shown(uncertainty.run(logs, bare.shown))
    absent = list(_absent(logs, selection.accepted, models.final))
    return Confirmed("unknown", bare, validation.run(logs, bare), found, [], absent)


def _elsewhere(logs: Logs, proofs: Proofs) -> Iterator[str]:
    """Coil currents of the held-out logs that are off, of coils that the same model explains to the noise in the fit logs.

    Nothing but the command acts on a current, so that this means another coil or temperature.
    """
    for (c, signal), there in proofs.judged.errors.items():
        here = proofs.judged_fit.errors[c, signal]
        off = there["after"] > logs.fit.settings.unexplained * there["noise"]
        if signal == "current" and off and here["after"] < AT_NOISE * here["noise"]:
            left = there["after"] / there["noise"]
            yield f"the coil current of channel {c + 1} is left {left:.2g} times its noise there"


def doubts(logs: Logs, accepted: Sequence[Accepted], final: Estimates, proofs: Proofs) -> list[str]:
    """Why what was named is not confirmed although it explains most of the fit logs, a sentence each; none if it is.

    `final` are the named effects with the corrections of their form, the proofs are with both. The held-out logs judge here and
    choose nothing. Where estimates that the fit logs cannot distinguish (`predictions_apart`) give trajectories which differ
    by more than what is left of a signal, that residual speaks against no name.
    """
    found: list[str] = []
    for c in dict.fromkeys(k.channel for k in accepted if k.channel is not None):
        found += _doubts_of_channel(logs, final, c, proofs)
    for one in _absent(logs, accepted, final):
        place = "the rig" if one.channel is None else f"channel {one.channel + 1}"
        found.append(f"{CATALOGUE[one.effect].title} of {place}: its interval holds the neutral value")
    return list(dict.fromkeys(found))


def _absent(logs: Logs, accepted: Sequence[Accepted], final: Estimates) -> Iterator[Accepted]:
    """The effects of which the intervals of all that gives them their size hold the neutral values."""
    for one in accepted:
        c = logs.rig.channels[0] if one.channel is None else one.channel
        values = effect_values(final, one.effect, one.channel)
        sizes = [u for u in final[c].unknowns if u.effect == one.effect and u.parameter in values]
        sizes = [u for u in sizes if CATALOGUE[one.effect].parameter(u.parameter).carries_size]
        ends = [(values[u.parameter].low, neutral_of(u), values[u.parameter].high) for u in sizes]
        if ends and all(low <= neutral <= high for low, neutral, high in ends):
            yield one


def _doubts_of_channel(logs: Logs, final: Estimates, c: int, proofs: Proofs) -> Iterator[str]:
    fit, on_fit = logs.fit, proofs.judged_fit
    dynamic = logs.rig.has_hidden_states
    level = fit.levels(on_fit.traces["after"][c], c)
    both = fit, fit.on(logs.held_out)
    fit_apart, held_out_apart = (predictions_apart(each, final[c], c) for each in both)
    for (channel, signal), entry in proofs.judged.errors.items():
        if channel != c:
            continue
        fitted, plain = on_fit.errors[channel, signal], f"the {signal} of channel {c + 1}"
        # A correction of form proves nothing of the name.
        after, noise, calibrated = entry.get(NAMED, entry["after"]), entry["noise"], entry["calibrated"]
        silent = held_out_apart.get(signal, 0.0) > max(CANNOT_BE_PREDICTED, after / noise)
        clearly = after > WORSE * calibrated and after > WORSE_NOISE * noise
        worse = clearly or (dynamic and _worse(fitted) and _worse(entry))
        if not silent and worse:
            yield f"{plain} is explained worse with the named effects than by calibration alone"
        times = fitted["after"] / fitted["noise"]
        # Whatever names fit the logs, what is left with the form of each put right is no matter of form any more.
        far = fitted["after"] > max(LEFT_NOISE * fitted["noise"], LEFT_SHARE * fitted["calibrated"])
        far = far and fit_apart.get(signal, 0.0) < times
        if dynamic and far and level[signal] > LEFT_LEVEL:
            yield f"{plain} of the fit logs is left {times:.2g} times its noise, whatever the form of what is named"


def _worse(entry: dict[str, float]) -> bool:
    """Whether what was named, in its own form or a corrected one, adds to the power above the noise of a signal."""
    noise = entry["noise"] ** 2
    after = min(entry["after"], entry.get(NAMED, entry["after"])) ** 2
    return after > AT_NOISE**2 * noise and after - noise > WORSE * (entry["calibrated"] ** 2 - noise)
