"""Selection of effects: forward steps with joint refits, a penalty for the size of the library, backward steps.

For each channel: a screening of all candidates beside the present estimate, short refits of the promising ones (base
parameters move along frozen derivatives), full joint refits of the best, and the winner is accepted if the deviance falls
by more than the penalty (`candidates.penalty`). The deviance counts independent samples (`Fit.gain`). A set of local effects is
compared with one that has an effect of the whole rig.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from ...plant import CATALOGUE, PlantModel
from ..estimation.estimate import Estimate, Estimates, distinct, joined
from ..estimation.fit import Fit
from ..estimation.gauss_newton import DIFFERENCE_STEPS, SETTLE_ITERATIONS, solve
from ..estimation.local_minima import best_of_each, best_on_early_window, extensions
from .calibration import Calibrated
from .candidates import ABSENT, OUTDONE, TOO_LITTLE, VANISHED, Accepted, Selection, is_neutral, penalty
from .form_correction import given_on, is_correction
from .screening import Screening, screen
from .search import CHEAP_ITERATIONS, Search, short_refit

#: Short refits and full refits in the first round, and half as many in later ones, where the screening is beside a better model.
#: This is successive halving (Karnin, Koren and Somekh 2013) by quarters: of some forty candidates 12 and of these 3 go on.
FIRST_REFITS, LATER_REFITS = (12, 3), (6, 2)
#: Candidates whose short refit reached less than this share of the best one's are not refitted in full: a half, as above.
WITHIN_REACH = 0.5
#: No estimates.
NONE: Mapping[int, Estimate] = {}
#: Iterations of a full refit, one with each step of differences.
FULL_ITERATIONS = len(DIFFERENCE_STEPS)


def run(
    calibrated: Calibrated, screening: Sequence[Screening], former: PlantModel | None = None
) -> Selection:
    """Selects effects and estimates the noise again.

    Those of the `former` model, which a diagnosis of some of the logs has found, compete.
    """
    logs, copies = calibrated.logs, {p: replace(p) for p in calibrated.estimates.values()}
    own = {c: copies[p] for c, p in calibrated.estimates.items()}
    search = select(Search(logs.fit, own, screening, logs.seconds, dict(own)))
    if former is not None and logs.rig.has_hidden_states:
        recall(search, former)
    placebo = _placebos(search)
    fit = logs.fit.with_noise_seen_by(search.present)
    groups = search.calibrated, search.present, placebo
    tried = [t.estimate for t in search.forms.values() if t is not None]
    fit.rescore(list(dict.fromkeys([*tried, *(p for group in groups for p in group.values())])))
    found = search.calibrated, search.present, search.accepted, search.candidates
    return Selection(replace(logs, fit=fit), *found, placebo, search.forms)


def without_weakest(selection: Selection, absent: Sequence[Accepted]) -> Selection:
    """The same without that one of the `absent` effects that gains least; the rest is settled again."""
    least = min(absent, key=lambda k: k.gain - k.needed)
    on = (None, least.channel)
    of = [p for p in distinct(selection.estimates) if least.channel is None or p.channel in on]
    less = {p: p.without(least.effect, least.channel) for p in of}
    solve(selection.logs.fit, [*less.values()], SETTLE_ITERATIONS)
    estimates = {c: less.get(p, p) for c, p in selection.estimates.items()}
    accepted = [k for k in selection.accepted if k is not least]
    own = (least.effect, least.channel)
    candidates = [
        replace(k, outcome=ABSENT) if k.accepted and (k.effect, k.channel) == own else k
        for k in selection.candidates
    ]
    return replace(selection, estimates=estimates, accepted=accepted, candidates=candidates)


def _placebos(search: Search) -> Estimates:
    """The best wrong candidate of the first round on each channel, refitted as far as what was accepted."""
    wrong = [k for k in search.candidates if k.round == 1 and k.refitted and not k.accepted]
    found: Estimates = {}
    for k in sorted(wrong, key=lambda k: k.gain):
        if k.estimate is not None:
            found |= dict.fromkeys(search.fit.channels_of(k.estimate), k.estimate)
    solve(search.fit, distinct(found), SETTLE_ITERATIONS)
    return found


def select(search: Search) -> Search:
    """Selects effects for every channel and for the rig, starting from the calibrated estimates and their screening.

    What acts on both channels is searched for in two ways: first on each channel, or first on the rig, whichever promises more.
    Several local effects imitate one of the rig, and the other way round, so the other way is gone as well where another set
    may do better, and the sets are compared.
    """
    whole = len(search.fit.rig.channels) == 2 and any(k.channel is None for k in search.screening)
    leads = whole and rig_effect_leads(search)
    _search(search, leads)
    if not (whole and _may_be_outdone(search, leads)):
        return search
    other = Search(search.fit, search.calibrated, search.screening, search.seconds, dict(search.calibrated))
    _search(other, not leads)
    return better_set(search, other)


def _search(search: Search, rig_first: bool) -> None:
    """Searches for a set of effects: first for one of the rig and then beside it on the channels, or the other way round."""
    channels = search.fit.rig.channels
    first = [c for c in channels if _worth_another(search, c)]
    of_channels = [k for k in search.screening if k.channel is not None]
    if not rig_first:
        _forward(search, first, of_channels)
    if len(channels) == 2:
        select_rig_effects(search)
    if any(k.channel is None for k in search.accepted):
        # Before, it had hidden what else there is on each channel.
        _forward(search, [c for c in channels if _worth_another(search, c)])
    if search.fit.rig.has_hidden_states:
        prefer_form(search)


def _may_be_outdone(search: Search, rig_first: bool) -> bool:
    """Whether the other way may lead to a set of effects that does better: a smaller one, or one that explains what this one
    leaves."""
    if not search.accepted:
        return rig_first
    several = not rig_first and len(search.accepted) > 1
    return several or any(_worth_another(search, c) for c in search.fit.rig.channels)


def better_set(search: Search, other: Search) -> Search:
    """The search whose set of effects explains more, with what the effects of each must pay for.

    Both go as far as they can first. The one that is left knows how far the other one is behind (`Accepted.rival`).
    """
    fit = search.fit
    if not other.accepted:
        return search
    search.settle(list(dict.fromkeys(p for s in (search, other) for p in s.present.values())))
    pairs = sorted(((joined(s.present), s) for s in (search, other)), key=lambda pair: pair[0].cost)
    (more, best), (less, rest) = pairs
    # In the samples that are independent beside the one that explains more.
    ahead = fit.gain(less, more, fit.rig.channels) + sum(k.needed for k in rest.accepted)
    ahead -= sum(k.needed for k in best.accepted)
    if ahead < 0.0:
        best, rest = rest, best
    names = {(k.effect, k.channel) for k in rest.accepted}
    own = ((k, (k.effect, k.channel) in names) for k in best.accepted)
    best.accepted = [k if shared else replace(k, rival=abs(ahead)) for k, shared in own]
    best.candidates += [replace(k, outcome=OUTDONE) if k.accepted else k for k in rest.candidates]
    return best


def _worth_another(search: Search, c: int) -> bool:
    """Whether a channel has a residual left that is worth looking into and is no matter of the form of what was accepted."""
    fit, present = search.fit, search.present[c]
    if not fit.could_pay(present, c):
        return False
    named = [e for e in present.effects() if not is_correction(e)]
    if not fit.rig.has_hidden_states or not (named or given_on(fit, present)):
        return True
    # Beside given effects alone a curve may take up a missing one; which of them it is, is decided at the end (`prefer_form`).
    return (not named and fit.unexplained(present, c)) or fit.could_pay(search.in_other_form(present), c)


# --- forward steps --------------------------------------------------------------------------------------------------------
def _forward(search: Search, channels: list[int], screening: Sequence[Screening] = ()) -> None:
    """Rounds, as long as an effect is accepted on a channel and leaves something; the first one with a `screening`, if any."""
    for number in range(1 if screening else 2, search.fit.settings.max_effects + 1):
        if not channels:
            break
        if number > 1:
            here = {c: search.present[c] for c in channels}
            screening = screen(search.fit, here, search.names, search.seconds, search.screening)
        # Channels that are estimated together take turns: what one of them gets changes the model of both.
        together = any(p.channel is None for p in search.present.values())
        turns = [[c] for c in channels] if together else [channels]
        accepted = [c for turn in turns for c in _round(search, turn, screening, number)]
        channels = [c for c in accepted if _worth_another(search, c)]


def _round(
    search: Search, channels: Sequence[int], screening: Sequence[Screening], number: int, known: Mapping[int, Estimate] = NONE
) -> list[int]:  # fmt: skip
    """One forward step on every channel, where `known` estimates compete as well; returns the channels on which an effect was
    accepted."""
    fit, cheap = search.fit, search.fit.rig.simulation_is_cheap
    short, full = FIRST_REFITS if number == 1 or cheap else LATER_REFITS
    every = {c: _promising(search, c, screening, number, short) for c in channels}
    for c, p in known.items():
        every[c].append(p)
    every = {c: own for c, own in every.items() if own}
    short_refit(fit, [p for own in every.values() for p in own])
    refits = {c: _within_reach(search.present[c], own, full) for c, own in every.items()}
    solve(fit, [p for own in refits.values() for p in own], CHEAP_ITERATIONS if cheap else FULL_ITERATIONS)
    refits = {c: _ranked(fit, own) for c, own in refits.items()}
    # All have been refitted alike here.
    gains = {c: _gains(search, c, own) for c, own in refits.items()}
    # Before it is judged: in a local minimum the right one gains little, too.
    search.settle([own[0] for own in refits.values()])
    if fit.rig.has_hidden_states:
        again = _compete_on_beginning(search, refits)
        refits, gains = refits | again, gains | {c: _gains(search, c, own) for c, own in again.items()}
    for c, twins in _twins(search, refits, gains).items():
        first, gain = refits[c][0], gains[c][refits[c][0].label]
        best, *_ = refits[c] = _ranked(fit, [*refits[c], *twins])
        # Directly, in samples that are independent beside the better one: a little that is left makes these many more or less.
        gains[c] |= {p.label: gain - max(0.0, fit.gain(p, best)) for p in (first, *twins)}
    for c, own in every.items():
        for p in own:
            if p.label not in gains[c]:
                search.record(p.label, c, number, fit.gain(search.present[c], p), OUTDONE, p)
    return [c for c, own in refits.items() if _accept_best(search, c, own, gains[c], number)]


def _ranked(fit: Fit, refits: Sequence[Estimate]) -> list[Estimate]:
    """The best estimate of each effect, best first."""
    return best_of_each(refits, key=lambda p: p.cost + penalty(fit, p.label))


def _gains(search: Search, c: int, refits: Sequence[Estimate]) -> dict[str, float]:
    """By effect the gain over what a channel has."""
    return {p.label: search.fit.gain(search.present[c], p) for p in refits}


def _within_reach(present: Estimate, tries: Sequence[Estimate], most: int) -> list[Estimate]:
    """The candidates within reach of the best one, but two at least, which are refitted in full."""
    own = sorted(tries, key=lambda p: p.cost)
    falls = [present.cost - p.cost for p in own[:most]]
    return own[: max(sum(fall > WITHIN_REACH * falls[0] for fall in falls), min(2, len(own)))]


def _promising(
    search: Search, c: int, screening: Sequence[Screening], number: int, most: int
) -> list[Estimate]:
    """The most promising candidates of a channel, or all where simulating costs next to nothing, as they begin."""
    here = {k.effect for k in search.on(c)}
    own = [k for k in screening if k.channel == c and k.effect not in here]
    good = own if search.fit.rig.simulation_is_cheap else [k for k in own[:most] if k.gain > 0.0]
    for k in (k for k in own if k not in good):
        search.record(k.effect, c, number, k.gain, TOO_LITTLE)
    return [search.present[c].extended(k.effect, k.start, c) for k in good]


def _compete_on_beginning(search: Search, refits: dict[int, list[Estimate]]) -> dict[int, list[Estimate]]:
    """Where the best candidate leaves more than another form of it would explain, every effect that the logs would show competes
    again on their beginning, and the best are refitted beside those that the screening proposed, the two best as far as they go.
    Returns all refitted ones of these channels, best first.
    """
    fit, presents, names = search.fit, {}, []
    for c, (best, *_) in refits.items():
        if fit.unexplained(best, c) and fit.unexplained(search.in_other_form(best), c):
            here = {n for n, on in search.present[c].placed_effects() if on in (None, c)}
            shows = {s.effect for s in search.screening if s.channel == c and s.shows}
            names.append([n for n in search.names if n in shows - here])
            presents[c] = search.present[c]
    found = zip(presents, best_on_early_window(fit, [*presents.items()], names), strict=True)
    # The best so far has been settled; then the best of the others is, too.
    others = {c: [*refits[c][1:], *own] for c, own in found}
    solve(fit, [p for own in others.values() for p in own], FULL_ITERATIONS)
    others = {c: _ranked(fit, own) for c, own in others.items()}
    search.settle([p for own in others.values() for p in own[:1]])
    return {c: _ranked(fit, [*own, refits[c][0]]) for c, own in others.items()}


def _twins(
    search: Search, refits: dict[int, list[Estimate]], gains: dict[int, dict[str, float]]
) -> dict[int, list[Estimate]]:
    """By channel the declared twins of the best candidate that do not compete with it, fitted from where it ended: usual logs
    cannot tell them apart, so one that is behind may have ended in a local minimum."""
    fit, found = search.fit, {}
    for c, (best, *_) in refits.items():
        less, behind = best.without(best.label, c), search.competing(best.label, gains[c])
        pays = fit.gain(search.present[c], best) > penalty(fit, best.label)
        declared = [n for n in CATALOGUE[best.label].indistinguishable_from if n in search.names]
        names = [n for n in declared if pays and n not in behind]
        found[c] = [*extensions(fit.rig, less, c, names)]
    fit.evaluate([p for own in found.values() for p in own])
    found = {c: best_of_each(own) for c, own in found.items()}
    solve(fit, [p for own in found.values() for p in own], SETTLE_ITERATIONS)
    return {c: own for c, own in found.items() if own}


def _adopt_base(search: Search, c: int, vanished: Estimate) -> bool:
    """Takes over the known parameters of a candidate that vanished, if they explain the logs better; whether it does."""
    fit, present = search.fit, search.present[c]
    less = vanished.without(vanished.label, c)
    solve(fit, [less], CHEAP_ITERATIONS)
    better = less.cost < present.cost and fit.gain(present, less) > 0.0
    if better:
        search.put(less)
        if all(map(is_correction, present.effects())):  # the calibration itself had ended in a local minimum
            search.calibrated = {**search.calibrated, **dict.fromkeys(fit.channels_of(less), less)}
    return better


def _accept_best(
    search: Search, c: int, refits: Sequence[Estimate], alike: dict[str, float], number: int
) -> bool:
    """Judges the refitted candidates of a channel, the best one first, and accepts that, if it passes; whether it does. `alike`
    are the gains by effect when all had been refitted alike."""
    before = search.present[c]
    best, *_ = [search.judged(c, before, p, number, outdone=p is not refits[0]) for p in refits]
    if best.accepted:
        competing = search.competing(best.effect, alike)
        search.accepted.append(Accepted(best.effect, c, best.gain, best.needed, competing, before))
        search.put(refits[0])
    return best.accepted or (best.outcome == VANISHED and _adopt_base(search, c, refits[0]))


# --- effects of the whole rig -----------------------------------------------------------------------------------------------
def rig_effect_leads(search: Search) -> bool:
    """Whether an effect of the rig promises more at first look than the best effects of both channels together.

    It then comes first: beside it, channels are searched for what they have, without it for what imitates it.
    """
    best = {k.channel: max(k.gain, 0.0) for k in sorted(search.screening, key=lambda k: k.gain)}
    of_rig = best.pop(None, 0.0)
    return of_rig > sum(best.values())


def select_rig_effects(search: Search) -> None:
    """Accepts the effect of the rig that explains most beside what the channels have, each refitted as far as it goes."""
    fit, before = search.fit, joined(search.present)
    tries: list[Estimate] = []
    for one in (k for k in search.screening if k.channel is None):
        if one.gain > penalty(fit, one.effect):
            tries.append(before.extended(one.effect, one.start))
        else:
            search.record(one.effect, None, 1, one.gain, TOO_LITTLE)
    if not tries:
        return
    short_refit(fit, tries)
    solve(fit, tries, SETTLE_ITERATIONS)
    first, *others = _ranked(fit, tries)
    best = search.judged(None, before, first, 1)
    if best.accepted:
        search.accepted.append(Accepted(best.effect, None, best.gain, best.needed, without=before))
        left = drop_vanished(search, first)
        solve(fit, [left] if left is not first else [], SETTLE_ITERATIONS)
        search.put(left)
    for p in others:
        search.judged(None, before, p, 1, outdone=True)


def drop_vanished(search: Search, estimate: Estimate) -> Estimate:
    """The estimate with those effects alone that did not vanish when one of the rig joined them: what an effect of the rig
    explains is no channel's."""
    left = estimate
    for k in [*search.accepted]:
        if k.channel is not None and is_neutral(estimate, k.effect, k.channel):
            search.drop(k, 0.0, "vanishes beside an effect of the whole rig", estimate)
            left = left.without(k.effect, k.channel)
    return left


# --- what was found in fewer logs -------------------------------------------------------------------------------------------
def recall(search: Search, former: PlantModel) -> None:
    """Takes over the effects of a `former` model on the channels where these explain more than those of the search, by what the
    effects of both must pay for: more logs have more local minima, so less of them may have shown what this search missed.

    Each of these effects competes again for its place beside the others.
    """
    fit = search.fit
    tries = {c: _formerly(search, former, c) for c, p in search.present.items() if p.channel is not None}
    tries = {c: p for c, p in tries.items() if p is not search.calibrated[c]}
    search.settle([*tries.values()])
    for c, found in tries.items():
        present, names = search.present[c], [k.effect for k in search.on(c)]
        less, more = sorted((present, found), key=lambda p: p.cost)
        ahead = fit.gain(less, more) if more is found else -fit.gain(less, more)
        own = [e for e in found.effects() if not is_correction(e)]
        ahead += sum(k.needed for k in search.on(c)) - sum(penalty(fit, e) for e in own)
        if ahead <= 0.0:
            continue
        search.put(found)
        if sorted(own) == sorted(names):
            continue
        for k in search.on(c):
            search.drop(k, k.gain, OUTDONE, present)
        for name in own:
            _compete_again(search, c, name)
        prefer_form(search)


def _compete_again(search: Search, c: int, name: str) -> None:
    """A forward step for the place of one of the effects that a channel has, beside its others."""
    whole = replace(search.present[c], label=name)
    less = whole.without(name, c)
    search.settle([less])
    search.put(less)
    beside = screen(search.fit, {c: less}, search.names, search.seconds, search.screening)
    _round(search, [c], [k for k in beside if k.effect != name], 2, {c: whole})


def _formerly(search: Search, former: PlantModel, c: int) -> Estimate:
    """The calibrated estimate of a channel with the effects that a `former` model has there, at the values of that; the
    calibrated one itself if it has none."""
    found, acting = search.calibrated[c], former.effects
    for k in search.screening:
        if k.channel == c and k.effect in acting and not CATALOGUE[k.effect].is_neutral(acting[k.effect][c]):
            found = found.with_effect(k.effect, k.start, c)
    return found if found is search.calibrated[c] else found.at_values_of(former, c)


# --- backward step ----------------------------------------------------------------------------------------------------------
def prefer_form(search: Search) -> None:
    """Drops the last effect of a channel if another form of those accepted before, or of given ones, explains more: no rig has
    exactly the laws of the catalogue, and what a law leaves is no further effect."""
    fit = search.fit
    for c in fit.rig.channels:
        for one in reversed(search.on(c)):
            present, less = search.present[c], one.without
            left = [placed for placed in present.placed_effects() if placed != (one.effect, c)]
            if less is None or less.placed_effects() != left or not (left or given_on(fit, less)):
                break  # it is alone, or others joined it since
            form = search.form_of(less)
            if form is None or form.score >= present.cost + one.needed:
                break
            alone = all(is_correction(effect) for effect, _ in left)
            if alone and fit.gain(form.estimate, search.in_other_form(present)) >= one.needed:
                break  # beside given effects it pays in another form, as these do
            search.drop(one, fit.gain(less, present), "another form of the others does better", present)
            search.put(less)
            solve(fit, [less], SETTLE_ITERATIONS)
