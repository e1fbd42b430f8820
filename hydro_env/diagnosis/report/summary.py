"""The report in about twenty lines of text, for a terminal."""

from __future__ import annotations

from collections.abc import Sequence

from ..result import Diagnosis
from ..stages.naming import NamedEffect
from ..stages.screening import detectable
from ..stages.validation import AT_NOISE
from . import statements as say
from . import wording as words

#: Lines at most: those of a small terminal.
LINES = 20


def summary(state: Diagnosis) -> str:
    """What the page says, shorter."""
    guess = " (best guess, not proven)" if state.best_guess else ""
    places, tried, known, warnings = _places(state), _tried(state), _known(state), state.warnings
    lines = [*filter(None, (f"verdict: {state.verdict}{guess}", say.sentence(state), say.weak_proof(state)))]
    lines += [*(_effect(state, n) for n in state.effects), *places]
    lines += [f"  form correction, not physics: {text}" for text in say.correction_texts(state)]
    lines += [*_errors(state), *tried, known, _hidden(state)]
    if state.next_experiment:
        lines.append(f"  next experiment: {state.next_experiment.description}")
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


def _first(texts: Sequence[str], count: int = 6) -> str:
    """The first ones, and how many more there are."""
    more = f" and {len(texts) - count} more" if len(texts) > count else ""
    return f"{', '.join(texts[:count])}{more}"


def _effect(state: Diagnosis, n: NamedEffect) -> str:
    every = say.effect_values(state, n)
    values = "; ".join(f"{name} {value}" + (f" = {share}" if share else "") for name, value, share in every)
    return f"  {n.name}, {words.where(n.channel)}, probability {n.probability:.2f}: {values}"


def _places(state: Diagnosis) -> list[str]:
    lines = []
    for p in say.shown_locations(state)[:2]:
        where = f"{words.EQUATIONS[p.equation]} of channel {p.channel + 1}: {100.0 * p.share:.0f} % of the residual"
        regime = f"most at {p.regime}" if p.regime != "everywhere" else p.regime
        lines.append(f"  where: {where}, {regime}; worst {say.windows_text(state, p)}")
    return lines


def _errors(state: Diagnosis) -> list[str]:
    """The table of errors on the held-out logs."""
    columns = say.error_columns(state)
    heads = "".join(f"{heading:>{width}}" for _, heading, width in columns)
    lines, quiet = [f"  {'held-out logs, RMS error':<29}{heads}"], []
    for s in say.errors_of(state.proofs.held_out):
        name, e = f"{s.name} {s.channel + 1}", s.errors
        if max(e["before"], e["calibrated"], e["after"]) < AT_NOISE * e["noise"]:
            quiet.append(name)
            continue
        row = "".join(f"{e.get(model, e['after']):{width}.3g}" for model, _, width in columns)
        lines.append(f"    {f'{name}, {s.unit}':<27}{row}")
    return [*lines, *([f"    at the noise with every model: {', '.join(quiet)}"] if quiet else [])]


def _tried(state: Diagnosis) -> list[str]:
    """The best candidates that were refitted and rejected."""
    tried = [r for r in say.ranking(state) if r.refitted and not r.accepted]
    texts = [f"{words.plain(r.effect)} on {r.where} ({r.gain:.0f}: {r.outcome})" for r in tried[:3]]
    if texts:
        return [f"  rejected, by gain: {', '.join(texts)}"]
    return [] if state.effects else ["  no effect was worth a closer look"]


def _known(state: Diagnosis) -> str:
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


def _hidden(state: Diagnosis) -> str:
    named = {(n.name, str(c + 1)) for n in state.effects for c in n.channels}
    texts = []
    for name, row in detectable(state.screening).items():
        if places := [c for c, shows in row.items() if not shows and (name, c) not in named]:
            texts.append(f"{words.plain(name)} ({', '.join(places)})")
    if texts:
        return f"  not detectable in these logs at medium size: {_first(texts)}"
    every = "the catalogue" if state.rig.has_hidden_states else "this reduced model"
    return f"  every effect of {every} is detectable at medium size"
