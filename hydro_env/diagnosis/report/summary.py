"""The report in about twenty lines of text, for a terminal."""

from __future__ import annotations

from collections.abc import Sequence

from ..stages.next_experiment import NextExperiment
from ..stages.screening import detectable
from ..stages.values import known_parameters
from ..state import State
from . import wording as words
from .statements import (
    AT_NOISE,
    correction_texts,
    effect_values,
    error_columns,
    errors_of,
    ranking,
    remarks,
    sentence,
    shown_locations,
    windows_text,
)

__all__ = ["summary"]

#: Lines at most.
LINES = 20


def summary(state: State, next_experiment: NextExperiment | None, warnings: Sequence[str]) -> str:
    """What the page says, shorter."""
    places, tried, known = _places(state), _tried(state), _known(state)
    lines = [
        f"verdict: {state.verdict}{' (best guess, not proven)' if state.best_guess else ''}",
        sentence(state),
    ]
    lines += [*remarks(state), *_effects(state), *places, *_shape(state)]
    lines += [f"  shape correction, not physics: {text}" for text in correction_texts(state)]
    lines += [*_errors(state), *tried, known, _hidden(state)]
    if next_experiment:
        lines.append(f"  next experiment: {next_experiment.description}")
    # What a full screen can spare first: the second place, then what was rejected, then known parameters.
    spare = [known, *tried, *places[1:]]
    while len(lines) > LINES - min(2, len(warnings)) and spare:
        lines.remove(spare.pop())
    most = min(3, max(1, LINES - len(lines)))
    shown = warnings if len(warnings) <= most else warnings[: max(1, most - 1)]
    lines += [f"  warning: {text}" for text in shown]
    if len(warnings) > len(shown):
        lines.append(f"  warning: {len(warnings) - len(shown)} more in the report")
    return "\n".join(lines)


def _effects(state: State) -> list[str]:
    lines = []
    for n in state.effects:
        values = "; ".join(
            f"{name} {value}" + (f" = {share}" if share else "")
            for name, value, share in effect_values(state, n)
        )
        lines.append(f"  {n.name}, {words.where(n.channel)}, probability {n.probability:.2f}: {values}")
    return lines


def _places(state: State) -> list[str]:
    lines = []
    for p in shown_locations(state)[:2]:
        regime = f"most at {p.regime}" if p.regime != "everywhere" else "everywhere"
        where = f"{words.equation(p.equation)} of channel {p.channel + 1}: {100.0 * p.share:.0f} % of the residual"
        lines.append(f"  where: {where}, {regime}; worst {windows_text(state, p)}")
    return lines


def _shape(state: State) -> list[str]:
    """The shape of what no effect explains."""
    channels = {p.channel for p in shown_locations(state)}
    first = next((p for p in state.locations if p.channel in channels), None)
    if state.verdict != "unknown" or first is None:
        return []
    form = first.shape
    return [
        f"  its shape: a curve over {form.over} explains {100 * form.explains:.0f} % of the residual, "
        f"{100 * form.with_direction:.0f} % with rising and falling separate"
    ]


def _errors(state: State) -> list[str]:
    """The table of errors on the held-out logs."""
    columns = error_columns(state)
    heads = "".join(f"{heading:>{width}}" for _, heading, width in columns)
    lines = [f"  {'held-out logs, RMS error':<29}{heads}"]
    quiet = []
    for s in errors_of(state.proofs.held_out):
        name, e = f"{s.name} {s.channel + 1}", s.errors
        if max(e["before"], e["calibrated"], e["after"]) < AT_NOISE * e["noise"]:
            quiet.append(name)
            continue
        row = "".join(f"{e.get(model, e['after']):{width}.3g}" for model, _, width in columns)
        lines.append(f"    {f'{name}, {s.unit}':<27}{row}")
    if quiet:
        lines.append(f"    at the noise with every model: {', '.join(quiet)}")
    return lines


def _tried(state: State) -> list[str]:
    """The best candidates that were refitted and rejected."""
    rows = ranking(state)
    tried = [r for r in rows if r.refitted and not r.accepted]
    if state.verdict in ("none", "calibration") and not state.effects:
        if not tried:
            return ["  no effect was worth a closer look"]
        text = ", ".join(f"{words.plain(r.effect)} on {r.where} ({r.gain:.0f})" for r in tried[:2])
        least = min(r.needed for r in tried[:2])
        return [f"  also tried: {text}; each would have to gain {least:.0f} or more"]
    if not tried:
        return []
    text = ", ".join(f"{words.plain(r.effect)} on {r.where} ({r.gain:.0f}: {r.outcome})" for r in tried[:3])
    names = {n.name for n in state.effects}
    gains = ", ".join(f"{r.gain:.0f}" for r in rows if r.accepted and r.effect in names)
    return [f"  rejected, by gain: {text}{f'; accepted with {gains}' if gains else ''}"]


def _known(state: State) -> str:
    """The known parameters that moved most, in half-widths of their intervals."""
    rows = [
        p for p in known_parameters(state.rig, state.shown) if p.estimate.high > p.estimate.low and p.moved
    ]
    rows = sorted((p for p in rows if abs(p.change) >= 0.005), key=lambda p: -abs(p.change))
    if not rows:
        return "  known parameters: no interval excludes the given value"
    own = state.rig.own  # of a reduced model: its nominal values stand for nothing
    text = ", ".join(
        f"{p.name} = {words.interval(p.estimate)}" if p.symbol in own else f"{p.name} {p.moved_by()}"
        for p in rows[:6]
    )
    more = f" and {len(rows) - 6} more" if len(rows) > 6 else ""
    far = ", ".join(p.name for p in rows if p.unusual and p.symbol not in own)
    return f"  known parameters that moved: {text}{more}{f'; check {far}: further than usual' if far else ''}"


def _hidden(state: State) -> str:
    seen = detectable(state.screening)
    named = [(effect.name, str(channel + 1)) for effect in state.effects for channel in effect.channels]
    hidden = {
        name: [c for c, shows in row.items() if not shows and (name, c) not in named]
        for name, row in seen.items()
    }
    texts = [f"{words.plain(name)} ({', '.join(row)})" for name, row in hidden.items() if row]
    if not texts:
        all_of = "the catalogue" if state.rig.has_hidden_states else "this reduced model"
        return f"  every effect of {all_of} is detectable at medium size"
    more = f" and {len(texts) - 6} more" if len(texts) > 6 else ""
    return f"  not detectable in these logs at medium size: {', '.join(texts[:6])}{more}"
