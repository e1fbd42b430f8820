"""What the report says, sentences and rows made of a diagnosis, and the same in about twenty lines of text for a terminal."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from ...plant import CATALOGUE
from ..logs import place_of
from ..models.base import RigModel
from ..stages.candidates import Candidate
from ..stages.localisation import Location
from ..stages.naming import NamedEffect
from ..stages.screening import detectable
from ..stages.validation import AT_NOISE, NAMED, Proof, shown_unit
from ..stages.values import KnownParameter
from ..stages.values import effect_values as values_of_effect
from . import wording as words

if TYPE_CHECKING:
    from ..result import Diagnosis

#: A name that is more likely wrong than right is not put forward as a fact.
LIKELY = 0.5
#: A placebo that leaves less than this many times what the names leave makes the proof weak, where calibration left this many
#: times the noise. Words only: no verdict depends on them.
PLACEBO_NEAR, WORTH_PROVING = 1.15, 1.2
_COLUMNS = (("noise", 9), ("before", 9), ("calibrated", 11), ("after", 9), ("placebo", 9))
#: Lines at most: those of a small terminal.
LINES = 20


@dataclass(frozen=True)
class SignalErrors:
    """RMS errors of a signal by model, beside "noise", in `unit`."""

    signal: str
    channel: int
    unit: str
    errors: dict[str, float]

    @property
    def name(self) -> str:
        return words.SIGNALS[self.signal]

    @property
    def above_noise(self) -> float:
        """What the final model leaves, in times the noise."""
        return self.errors["after"] / max(self.errors["noise"], 1e-30)


def unit_of(rig: RigModel, signal: str, channel: int) -> tuple[str, float]:
    """The unit that a signal is shown in, and its size in SI."""
    key, size = shown_unit(rig, signal, channel)
    return words.KEY_UNITS.get(key, key), size


def errors_of(proof: Proof) -> list[SignalErrors]:
    """All signals of a proof."""
    every = proof.errors.items()
    return [SignalErrors(signal, c, unit_of(proof.rig, signal, c)[0], entry) for (c, signal), entry in every]


def _speeds(state: "Diagnosis") -> list[SignalErrors]:
    return [e for e in errors_of(state.proofs.held_out) if e.signal == "speed"]


def _worst(state: "Diagnosis") -> SignalErrors:
    return max(_speeds(state), key=lambda e: e.above_noise)


def headline(state: "Diagnosis") -> SignalErrors:
    """The signal that says most: the speed whose residual fell most, in noise units, of the channels where something is named."""
    speeds, named = _speeds(state), {c for effect in state.effects for c in effect.channels}
    own = [e for e in speeds if e.channel in named] or speeds
    return max(own, key=lambda e: (e.errors["before"] - e.errors["after"]) / max(e.errors["noise"], 1e-30))


# --- the verdict ----------------------------------------------------------------------------------------------------------
def sentence(state: "Diagnosis") -> str:
    """The verdict in a sentence, and the proof in another."""
    head, doubtful = headline(state), _doubtful(state)
    e, unit = head.errors, head.unit
    error = f"On the held-out logs the error of the {head.name} of channel {head.channel + 1} is {e['after']:.3g} {unit} RMS"
    noise = f"the noise is {e['noise']:.3g}"
    other = "".join(
        f" Channel {s.channel + 1}: {s.errors['after']:.3g} {unit}, {s.errors['before']:.3g} as given; "
        f"noise {s.errors['noise']:.3g}."
        for s in _speeds(state)
        if s != head and max(s.errors["after"], s.errors["before"]) > AT_NOISE * s.errors["noise"]
    )
    if state.verdict == "none":
        enough = "Nothing is missing: the model as given explains the logs."
        return f"{doubtful or enough} {error}; {noise}.{other}"
    if state.verdict == "calibration":
        ranges = "known parameters adjusted inside their plausible ranges"
        enough = f"Calibration is enough: with {ranges}, the model explains the logs."
        return f"{doubtful or enough} {error}, {e['before']:.3g} before; {noise}.{other}"
    before = f"{e['before']:.3g} as given, {e['calibrated']:.3g} after calibration alone; {noise}"
    lacks = _guess if state.best_guess else _lacks if state.verdict == "effects" else _unknown
    return f"{doubtful} {lacks(state)} {error}: {before}.{other}".strip()


def _doubtful(state: "Diagnosis") -> str:
    """What speaks against the logs themselves, before anything is concluded from them, or nothing."""
    texts = []
    if state.undetermined:
        texts.append(f"These logs do not determine the known parameters: {words.listed(state.undetermined)}.")
    if state.elsewhere:
        where = words.listed(state.elsewhere[:2])
        texts.append(f"The held-out logs seem to be of another rig or state: {where}.")
    left = _worst(state).above_noise > AT_NOISE
    if state.verdict in ("none", "calibration") and (texts or left):
        by = "The model as given" if state.verdict == "none" else "Calibration"
        texts.append(f"{by} explains the fit logs{'' if left else ', as other values would'}.")
    return " ".join(texts)


def _guess(state: "Diagnosis") -> str:
    """The best guess, and what is proven: the share of a speed's error that it explains, and what it leaves."""
    worst = _worst(state)
    e = worst.errors
    power = e["calibrated"] ** 2 - e["noise"] ** 2
    share = max((e["calibrated"] ** 2 - e["after"] ** 2) / power, 0.0) if power > 0.0 else 0.0
    named = words.listed([_said(n) for n in state.effects])
    return (
        f"Something is missing; what it is, is not proven. The best guess is {named}: on the held-out logs it explains "
        f"{100.0 * share:.0f} % of the power that calibration leaves of the {worst.name} of channel {worst.channel + 1}, and "
        f"leaves {worst.above_noise:.2g} times the noise. So the effect has another form than the catalogue's, or another one "
        "is missing as well."
    )


def _lacks(state: "Diagnosis") -> str:
    sure = [n for n in state.effects if n.probability >= LIKELY or len(state.effects) == 1]
    perhaps = [n for n in state.effects if n not in sure]
    text = f"The model lacks {words.listed([_said(n) for n in sure or perhaps])}."
    if sure and perhaps:
        text += f" Perhaps also {words.listed([_said(n) for n in perhaps])}."
    return text


def _unknown(state: "Diagnosis") -> str:
    shown = shown_locations(state)[:2]
    places = [f"{words.EQUATIONS[p.equation]} of channel {p.channel + 1}, {p.regime}" for p in shown]
    where = words.listed(list(dict.fromkeys(places))) or "all signals"
    text = f"Something is missing that no effect of the catalogue explains; it shows in {where}."
    if state.effects:
        names = words.listed([f"{words.title(n.name)} on {words.where(n.channel)}" for n in state.effects])
        text += f" A part is explained by {names}."
    return text


def _said(n: NamedEffect) -> str:
    """An effect with its channel and what it is indistinguishable from."""
    tied = words.listed([words.title(name) for name in n.indistinguishable_from[:3]])
    text = f"{words.title(n.name)} on {words.where(n.channel)}"
    return text + (f" (or {tied}: these logs cannot distinguish them)" if tied else "")


def log_names(state: "Diagnosis") -> str:
    """The logs that were fitted, two by name."""
    names = list(dict.fromkeys(part.log.name for part in state.rig.parts))
    return words.listed(names if len(names) < 3 else [*names[:2], f"{len(names) - 2} more"])


def short_names(rig: RigModel) -> list[str]:
    """Parts of logs without the folders, which need not be there when the page is read: the demo's get another name."""
    return [Path(part.label).name for part in rig.parts]


# --- what is left ---------------------------------------------------------------------------------------------------------
def remaining(state: "Diagnosis", n: NamedEffect) -> str:
    """What the named effects together leave of the speeds of an effect's channels on the held-out logs."""
    speeds = [s for s in _speeds(state) if s.channel in (n.channels or state.rig.channels)]
    return words.listed([
        f"{s.errors['after']:.3g} of {s.errors['calibrated']:.3g} {s.unit} on channel {s.channel + 1} "
        f"(noise {s.errors['noise']:.3g})"
        for s in speeds
    ])  # fmt: skip


def weak_proof(state: "Diagnosis") -> str:
    """A remark where the best wrong effect does nearly as well on the held-out logs as what was named, or nothing."""
    entry = headline(state).errors
    near = entry["placebo"] <= PLACEBO_NEAR * entry.get(NAMED, entry["after"])
    if not state.effects or not near or entry["calibrated"] < WORTH_PROVING * entry["noise"]:
        return ""
    names = {words.title(name) for p in state.selection.placebo.values() for name in p.effects()}
    return (
        f"A placebo ({words.listed(sorted(names)) or 'another effect'}) does nearly as well on the held-out logs: they are "
        "weak evidence for the names."
    )


# --- where it is ----------------------------------------------------------------------------------------------------------
def shown_locations(state: "Diagnosis") -> list[Location]:
    """Locations on channels where the calibrated model leaves anything of the fit logs, the largest share first."""
    left = {c for (c, _), e in state.proofs.fit.errors.items() if e["calibrated"] > AT_NOISE * e["noise"]}
    return sorted((p for p in state.locations if p.channel in left), key=lambda p: -p.share)


def windows_text(state: "Diagnosis", location: Location) -> str:
    """The windows of a location, by log."""
    texts, parts = [], state.rig.parts
    for number in dict.fromkeys(log for log, _, _ in location.windows):
        text = ", ".join(f"{a:.2f} to {b:.2f}" for log, a, b in location.windows if log == number) + " s"
        texts.append(text + (f" of {parts[number].log.name}" if len(parts) > 1 else ""))
    return "; ".join(texts)


def places(state: "Diagnosis") -> list[str]:
    """Where effects may be: the channels, and the rig if there are such candidates."""
    of_rig = any("rig" in row for row in detectable(state.screening).values())
    return [*(str(c + 1) for c in state.rig.channels), *(["rig"] if of_rig else [])]


# --- numbers --------------------------------------------------------------------------------------------------------------
def effect_values(state: "Diagnosis", n: NamedEffect) -> list[tuple[str, str, str]]:
    """(parameter, estimate with interval, what that is of full command) of a named effect."""
    c = n.channels[0] if len(n.channels) == 1 else state.rig.channels[0]
    effect, values = CATALOGUE[n.name], n.parameters.items()
    shares = {own: words.of_command(n.name, own, p.value, state.model, c) for own, p in values}
    return [(effect.parameter(own).title, words.interval(p), shares[own]) for own, p in values]


def comment(rig: RigModel, p: KnownParameter) -> str:
    """What to think of a known parameter that moved further than such values usually do, or that was not known; or nothing."""
    if p.symbol in rig.own:
        return "not given: estimated from these logs alone"
    if not p.unusual:
        return ""
    if p.nominal:
        down, up = (100.0 * (end / p.nominal - 1.0) for end in p.usual)
        text = f"moved by {p.moved_by()}, more than the {down:+.0f} to {up:+.0f} % to which such a value is usually known: "
    else:
        text = f"given as 0, and more than {words.number(p.usual[1])} {p.estimate.unit} is unusual then: "
    return text + (
        "check it on the rig or in its data sheet; otherwise it may stand in for an effect that is missing"
    )


def error_columns(state: "Diagnosis") -> list[tuple[str, str, int]]:
    """(model, heading, width) of the table of errors; where a form was corrected, the names alone have a column."""
    plain = [(model, model, width) for model, width in _COLUMNS]
    return [*plain[:3], (NAMED, "effects only", 14), *plain[3:]] if state.models.corrections else plain


def correction_texts(state: "Diagnosis") -> Iterator[str]:
    """What each form correction is, in a line."""
    for k in state.models.corrections:
        values = list(values_of_effect(state.models.final, k.correction, k.channel).items())
        shown = "; ".join(f"{words.plain(own)} {words.interval(p)}" for own, p in values[:2])
        more = f" and {len(values) - 2} more numbers" if len(values) > 2 else ""
        where = words.where(place_of(k.channel))
        what = f"{CATALOGUE[k.correction].summary}, {where} (for {words.title(k.effect)})"
        yield f"{what}: {shown}{more}"


def ranking(state: "Diagnosis") -> list[Candidate]:
    """Candidates by gain in their last try: accepted ones first, then by gain."""
    last: dict[tuple[str, int | None], Candidate] = {}
    for t in state.selection.candidates:
        known = last.get((t.effect, t.channel))
        better = known is None or (not known.accepted and t.refitted and t.gain > known.gain)
        if better or t.accepted:
            last[t.effect, t.channel] = t
    for n in state.effects:
        for key in ((other, c) for other in n.indistinguishable_from for c in n.channels or (None,)):
            if key in last and not last[key].accepted:
                outcome = f"as good: indistinguishable from {words.plain(n.name)}"
                last[key] = replace(last[key], outcome=outcome)
    return sorted(last.values(), key=lambda t: (not t.accepted, not t.refitted, -t.gain))


# --- in about twenty lines --------------------------------------------------------------------------------------------------
def summary(state: "Diagnosis") -> str:
    """What the page says, shorter."""
    guess = " (best guess, not proven)" if state.best_guess else ""
    found, tried, known, warnings = _places(state), _tried(state), _known(state), state.warnings
    lines = [*filter(None, (f"verdict: {state.verdict}{guess}", sentence(state), weak_proof(state)))]
    lines += [*(_effect(state, n) for n in state.effects), *found]
    lines += [f"  form correction, not physics: {text}" for text in correction_texts(state)]
    lines += [*_errors(state), *tried, known, _hidden(state)]
    if state.next_experiment:
        lines.append(f"  next experiment: {state.next_experiment.description}")
    # What a full screen can spare first: the second place, then what was rejected, then known parameters.
    spare = [known, *tried, *found[1:]]
    while len(lines) > LINES - min(2, len(warnings)) and spare:
        lines.remove(spare.pop())
    most = min(3, max(1, LINES - len(lines)))
    shown = warnings if len(warnings) <= most else warnings[: max(1, most - 1)]
    lines += [f"  warning: {text}" for text in shown]
    if len(warnings) > len(shown):
        lines.append(f"  warning: {len(warnings) - len(shown)} more in the report")
    return "\n".join(lines)


def _first(texts: Sequence[str], count: int = 6) -> str:
    """The first ones, and how many more there are."""
    more = f" and {len(texts) - count} more" if len(texts) > count else ""
    return f"{', '.join(texts[:count])}{more}"


def _effect(state: "Diagnosis", n: NamedEffect) -> str:
    every = effect_values(state, n)
    values = "; ".join(f"{name} {value}" + (f" = {share}" if share else "") for name, value, share in every)
    return f"  {n.name}, {words.where(n.channel)}, probability {n.probability:.2f}: {values}"


def _places(state: "Diagnosis") -> list[str]:
    lines = []
    for p in shown_locations(state)[:2]:
        where = f"{words.EQUATIONS[p.equation]} of channel {p.channel + 1}: {100.0 * p.share:.0f} % of the residual"
        regime = f"most at {p.regime}" if p.regime != "everywhere" else p.regime
        lines.append(f"  where: {where}, {regime}; worst {windows_text(state, p)}")
    return lines


def _errors(state: "Diagnosis") -> list[str]:
    """The table of errors on the held-out logs."""
    columns = error_columns(state)
    heads = "".join(f"{heading:>{width}}" for _, heading, width in columns)
    lines, quiet = [f"  {'held-out logs, RMS error':<29}{heads}"], []
    for s in errors_of(state.proofs.held_out):
        name, e = f"{s.name} {s.channel + 1}", s.errors
        if max(e["before"], e["calibrated"], e["after"]) < AT_NOISE * e["noise"]:
            quiet.append(name)
            continue
        row = "".join(f"{e.get(model, e['after']):{width}.3g}" for model, _, width in columns)
        lines.append(f"    {f'{name}, {s.unit}':<27}{row}")
    return [*lines, *([f"    at the noise with every model: {', '.join(quiet)}"] if quiet else [])]


def _tried(state: "Diagnosis") -> list[str]:
    """The best candidates that were refitted and rejected."""
    tried = [r for r in ranking(state) if r.refitted and not r.accepted]
    texts = [f"{words.plain(r.effect)} on {r.where} ({r.gain:.0f}: {r.outcome})" for r in tried[:3]]
    if texts:
        return [f"  rejected, by gain: {', '.join(texts)}"]
    return [] if state.effects else ["  no effect was worth a closer look"]


def _known(state: "Diagnosis") -> str:
    """The known parameters that moved most."""
    own = state.rig.own  # of a reduced model: its nominal values stand for nothing
    known = [p for p in state.known if p.moved and abs(p.change) >= 0.005]
    rows = sorted(known, key=lambda p: -abs(p.change))
    if not rows:
        return "  known parameters: no interval excludes the given value"
    values = (f"= {words.interval(p.estimate)}" if p.symbol in own else p.moved_by() for p in rows)
    texts = [f"{p.name} {value}" for p, value in zip(rows, values, strict=True)]
    far = ", ".join(p.name for p in rows if p.unusual and p.symbol not in own)
    check = f"; check {far}: further than usual" if far else ""
    return f"  known parameters that moved: {_first(texts)}{check}"


def _hidden(state: "Diagnosis") -> str:
    named = {(n.name, str(c + 1)) for n in state.effects for c in n.channels}
    texts = []
    for name, row in detectable(state.screening).items():
        if places := [c for c, shows in row.items() if not shows and (name, c) not in named]:
            texts.append(f"{words.plain(name)} ({', '.join(places)})")
    if texts:
        return f"  not detectable in these logs at medium size: {_first(texts)}"
    every = "the catalogue" if state.rig.has_hidden_states else "this reduced model"
    return f"  every effect of {every} is detectable at medium size"
