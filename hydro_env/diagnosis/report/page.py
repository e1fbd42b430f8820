"""The report: a page that needs no network, for a manager (first sentence, first picture) and an engineer (the rest)."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.resources import files
from typing import TYPE_CHECKING, Any

import numpy as np

from ...plant import CATALOGUE
from ..stages.validation import NAMED, Proof, shown_unit
from . import wording as words

if TYPE_CHECKING:
    from ..models.base import Segment
    from ..stages.localisation import Place
    from ..stages.selection import Trial
    from ..stages.verdict import Named
    from ..workflow import Diagnosis

__all__ = ["report_page", "sentence", "terminal_text"]

#: Lines of a summary in the terminal, at most.
LINES = 20
#: Points of a trace in a picture.
POINTS = 900
#: A signal is at the noise if its error is less than this factor above it.
AT_NOISE = 1.1
#: Slower than this a model could follow, s; what is faster is noise, or sensors.
SLOW_S = 0.25
_TABLE = (("noise", 9), ("before", 9), ("calibrated", 11), ("after", 9), ("placebo", 9))
#: A name less likely than this is not put forward as a fact.
LIKELY = 0.5


def sentence(found: Diagnosis) -> str:
    """The verdict in a sentence, and the proof in another."""
    word, data = found.data["verdict"], found.data
    key, entry = headline(data)
    signal, channel, unit = words.signal(key)
    gap = f"On the held-out logs the error of the {signal} of channel {channel} is {entry['after']:.3g} {unit} RMS"
    noise = f"the noise is {entry['noise']:.3g}"
    other = "".join(
        f" Channel {words.signal(k)[1]}: {e['after']:.3g} {unit}, {e['before']:.3g} as given; noise {e['noise']:.3g}."
        for k, e in data["gap"]["sealed"].items()
        if k.startswith("speed") and k != key and max(e["after"], e["before"]) > AT_NOISE * e["noise"]
    )
    if word == "none":
        return f"Nothing is missing: the model as given explains the logs. {gap}; {noise}.{other}"
    if word == "calibration":
        return (
            "Calibration is enough: with known parameters adjusted inside their plausible ranges, the model explains the logs. "
            f"{gap}, {entry['before']:.3g} before; {noise}.{other}"
        )
    before = f"{entry['before']:.3g} as given, {entry['calibrated']:.3g} after calibration alone; {noise}"
    if word == "effects":
        sure = [n for n in found.named if n.probability >= LIKELY or len(found.named) == 1]
        perhaps = [n for n in found.named if n not in sure]
        text = f"The model lacks {words.listed([_said(n) for n in sure or perhaps])}."
        if sure and perhaps:
            text += f" Perhaps also {words.listed([_said(n) for n in perhaps])}."
        return f"{text} {gap}: {before}.{other}"
    places = words.listed(
        list(
            dict.fromkeys(
                f"{words.equation(p.equation)} of channel {p.channel + 1}, {p.regime}"
                for p in _shown_places(found)[:2]
            )
        )
    )
    text = f"Something is missing that no effect of the catalogue explains; it shows in {places or 'all signals'}."
    if found.named:
        names = words.listed([words.title(n.name) + f" on {words.where(n.channel)}" for n in found.named])
        text += f" A part is explained by {names}."
    return f"{text} {gap}: {before}.{other}"


def _said(n: Named) -> str:
    """An effect with its channel and what it cannot be told from."""
    tied = words.listed([words.title(name) for name in n.indistinguishable_from[:3]])
    return f"{words.title(n.name)} on {words.where(n.channel)}" + (
        f" (or {tied}: these logs cannot distinguish them)" if tied else ""
    )


def headline(data: dict[str, Any]) -> tuple[str, dict[str, float]]:
    """The signal that tells most: the speed whose gap fell most, in noise units."""
    speeds = {k: v for k, v in data["gap"]["sealed"].items() if k.startswith("speed")}
    key = max(
        speeds, key=lambda k: (speeds[k]["before"] - speeds[k]["after"]) / max(speeds[k]["noise"], 1e-30)
    )
    return key, speeds[key]


def left_over(found: Diagnosis) -> str:
    """What the final model leaves on the sealed logs of the speed that is worst: slow (physics) or fast (noise); or nothing."""
    speeds = {k: e for k, e in found.data["gap"]["sealed"].items() if k.startswith("speed")}
    key, entry = max(speeds.items(), key=lambda item: item[1]["after"] / max(item[1]["noise"], 1e-30))
    if entry["after"] < AT_NOISE * entry["noise"]:
        return ""
    _, channel, unit = words.signal(key)
    proof, c = found.sealed, int(channel) - 1
    size = shown_unit(proof.machine, "speed", c)[1]
    power = slow = 0.0
    for s in proof.machine.segments[c]:
        if s.signal != "speed":
            continue
        error = np.where(s.used, s.measured - proof.traces["after"][c][s.place], np.nan) / size
        width = max(1, round(SLOW_S / s.period))
        pieces = error[: error.size // width * width].reshape(-1, width)
        whole = np.isfinite(pieces).all(axis=1)
        power += float(np.sum(pieces[whole] ** 2))
        slow += float(np.sum(width * pieces[whole].mean(axis=1) ** 2))
    if power <= 0.0:
        return ""
    share = slow / power
    text = (
        f"Of the {entry['after']:.3g} {unit} that are left on channel {channel}, "
        f"{np.sqrt(share) * entry['after']:.2g} {unit} are slower than "
        f"{1.0 / SLOW_S:g} Hz, where a model could follow"
    )
    if share < 0.25:
        fast = float(np.sqrt(max(entry["after"] ** 2 * (1.0 - share) - entry["noise"] ** 2, 0.0)))
        more = f", with short events of {fast:.2g} {unit} in it" if fast > entry["noise"] else ""
        return f"{text}; the rest is as fast as noise is{more}."
    return f"{text}: something is still missing there, or the effect has another functional form than the catalogue's."


def weak_proof(found: Diagnosis) -> str:
    """A remark where the best wrong effect does nearly as well on the sealed logs as what was named, or nothing."""
    _, entry = headline(found.data)
    if (
        not found.named
        or entry["placebo"] > 1.15 * entry["after"]
        or entry["calibrated"] < 1.2 * entry["noise"]
    ):
        return ""
    names = {
        words.title(name.split(".", 1)[0])
        for p in found.selection.placebo.values()
        for name in p.request().values
        if "." in name
    }
    return (
        f"a placebo ({words.listed(sorted(names)) or 'another effect'}) does nearly as well on the held-out logs: they are "
        "weak evidence for the names"
    )


def _has_gap(proof: Proof, channel: int) -> bool:
    """Whether the calibrated model leaves anything of the fit logs on a channel."""
    return any(
        e["calibrated"] > AT_NOISE * e["noise"]
        for key, e in proof.gap.items()
        if key.split("_")[1] == str(channel + 1)
    )


def _shown_places(found: Diagnosis) -> list[Place]:
    """Places on channels that have a gap, the largest share first."""
    places = [p for p in found.places if _has_gap(found.fit, p.channel)]
    return sorted(places, key=lambda p: -p.share)


def _place_text(found: Diagnosis, place: Place) -> str:
    regime = f"most at {place.regime}" if place.regime != "everywhere" else "everywhere"
    return (
        f"{words.equation(place.equation)} of channel {place.channel + 1}: {100.0 * place.share:.0f} % of the residual, "
        f"{regime}; worst {_spans(found, place)}"
    )


def _spans(found: Diagnosis, place: Place) -> str:
    """The windows of a place, by log."""
    texts = []
    for number in dict.fromkeys(place.logs):
        mine = [w for w, log in zip(place.windows, place.logs, strict=True) if log == number]
        text = ", ".join(f"{a:.2f} to {b:.2f}" for a, b in mine) + " s"
        texts.append(
            text + (f" of {found.machine.parts[number].log.name}" if len(found.machine.parts) > 1 else "")
        )
    return "; ".join(texts)


def _values(found: Diagnosis, n: Named) -> list[tuple[str, str, str]]:
    """(parameter, estimate with interval, what that is of full command) of a named effect."""
    channel = int(n.channel) - 1 if n.channel in ("1", "2") else found.machine.channels[0]
    return [
        (
            words.parameter(n.name, own),
            words.interval(p),
            words.of_command(n.name, own, p["value"], found.machine.model, channel),
        )
        for own, p in n.parameters.items()
    ]


def _columns(found: Diagnosis) -> list[tuple[str, str, int]]:
    """(model, heading, width) of the table of errors; where a form was corrected, the names alone have a column."""
    plain = [(model, model, width) for model, width in _TABLE]
    return [*plain[:3], (NAMED, "names only", 12), *plain[3:]] if found.data["shape_corrections"] else plain


def correction_texts(found: Diagnosis) -> list[str]:
    """What each shape correction is and how large, in a line."""
    texts = []
    for k in found.data["shape_corrections"]:
        key = max(
            (n for n in k["changes"] if n.startswith("speed")), key=lambda n: k["changes"][n], default=""
        )
        name, _, unit = words.signal(key) if key else ("", "", "")
        values = "; ".join(
            f"{words.plain(own)} {words.interval(p)}" for own, p in list(k["parameters"].items())[:2]
        )
        more = f" and {len(k['parameters']) - 2} more numbers" if len(k["parameters"]) > 2 else ""
        size = (
            f"; it moves the {name} by {k['changes'][key]:.2g} {unit} RMS on the held-out logs" if key else ""
        )
        texts.append(
            f"{k['what']}, {words.where(k['channel'])} (for {words.title(k['effect'])}): {values}{more}{size}"
        )
    return texts


def terminal_text(found: Diagnosis) -> str:
    """About twenty lines: what the page says, shorter."""
    data = found.data
    lines = [f"verdict: {data['verdict']}", sentence(found)]
    rest = [text for text in (left_over(found), weak_proof(found)) if text]
    lines += [text[0].upper() + text[1:] for text in rest]
    for n in found.named:
        values = "; ".join(
            f"{name} {value}" + (f" = {share}" if share else "") for name, value, share in _values(found, n)
        )
        lines.append(f"  {n.name}, {words.where(n.channel)}, probability {n.probability:.2f}: {values}")
    places = [f"  where: {_place_text(found, p)}" for p in _shown_places(found)[:2]]
    lines += places
    if data["verdict"] == "unknown":
        for place in [p for p in data["where"] if _has_gap(found.fit, int(p["channel"]) - 1)][:1]:
            form = place["shape"]
            lines.append(
                f"  its shape: a curve over {form['over']} holds {100 * form['explains']:.0f} % of the error, "
                f"{100 * form['with_direction']:.0f} % rising and falling apart"
            )
    lines += [f"  shape correction, not physics: {text}" for text in correction_texts(found)]
    columns = _columns(found)
    heads = "".join(f"{heading:>{width}}" for _, heading, width in columns)
    lines.append(f"  {'held-out logs, RMS error':<29}{heads}")
    quiet = []
    for key, e in data["gap"]["sealed"].items():
        name, channel, unit = words.signal(key)
        if max(e["before"], e["calibrated"], e["after"]) < AT_NOISE * e["noise"]:
            quiet.append(f"{name} {channel}")
            continue
        row = "".join(f"{e.get(model, e['after']):{width}.3g}" for model, _, width in columns)
        lines.append(f"    {f'{name} {channel}, {unit}':<27}{row}")
    if quiet:
        lines.append(f"    at the noise with every model: {', '.join(quiet)}")
    lines += _tried_line(found) + _calibrated_line(found) + _hidden_line(found)
    if data["next_experiment"]:
        lines.append(f"  next experiment: {data['next_experiment']['description']}")
    # What a full screen can spare first: the second place, then what was rejected, then known parameters.
    spare = [*_calibrated_line(found), *_tried_line(found), *places[1:]]
    while len(lines) > LINES - min(2, len(found.warnings)) and spare:
        lines.remove(spare.pop())
    most = min(3, max(1, LINES - len(lines)))
    shown = found.warnings if len(found.warnings) <= most else found.warnings[: max(1, most - 1)]
    lines += [f"  warning: {text}" for text in shown]
    if len(found.warnings) > len(shown):
        lines.append(f"  warning: {len(found.warnings) - len(shown)} more in the report")
    return "\n".join(lines)


def _tried_line(found: Diagnosis) -> list[str]:
    """The best candidates that were refitted and rejected."""
    if found.data["verdict"] in ("none", "calibration") and not found.named:
        tried = [r for r in _ranking(found) if r["refitted"] and r["fate"] != "taken"][:2]
        if not tried:
            return ["  no effect was worth a closer look"]
        text = ", ".join(f"{words.plain(r['effect'])} on {r['where']} ({r['gain']:.0f})" for r in tried)
        return [
            f"  also tried: {text}; each would have to gain {min(r['needed'] for r in tried):.0f} or more"
        ]
    tried = [r for r in _ranking(found) if r["refitted"] and r["fate"] != "taken"][:3]
    names = {n.name for n in found.named}
    taken = [r for r in _ranking(found) if r["fate"] == "taken" and r["effect"] in names]
    if not tried:
        return []
    text = ", ".join(
        f"{words.plain(r['effect'])} on {r['where']} ({r['gain']:.0f}: {r['fate']})" for r in tried
    )
    gains = ", ".join(f"{r['gain']:.0f}" for r in taken)
    won = f"; taken with {gains}" if taken else ""
    return [f"  rejected, by gain: {text}{won}"]


def _calibrated_line(found: Diagnosis) -> list[str]:
    """The known parameters that moved most, in half-widths of their intervals."""
    rows = [p for p in _parameters(found) if p["high"] > p["low"]]
    rows = [p for p in rows if not p["low"] <= p["nominal"] <= p["high"] and abs(p["change"]) >= 0.005]
    rows.sort(key=lambda p: -abs(p["change"]))
    if not rows:
        return ["  known parameters: no interval excludes the given value"]
    own = found.machine.own  # of a reduced model: its nominal values stand for nothing
    text = ", ".join(
        f"{p['name']} = {words.interval(p)}"
        if p["name"].rsplit("_", 1)[0] in own
        else f"{p['name']} {100.0 * p['change']:+.0f} %"
        for p in rows[:6]
    )
    more = f" and {len(rows) - 6} more" if len(rows) > 6 else ""
    return [f"  known parameters that moved: {text}{more}"]


def _hidden_line(found: Diagnosis) -> list[str]:
    hidden: dict[str, list[str]] = {}
    for name, row in found.data["detectable"].items():
        for c, seen in row.items():
            if not seen:
                hidden.setdefault(name, []).append(c)
    if not hidden:
        all_of = "this reduced model" if found.machine.quick else "the catalogue"
        return [f"  every effect of {all_of} is detectable at medium size"]
    text = ", ".join(f"{words.plain(n)} ({', '.join(c)})" for n, c in list(hidden.items())[:6])
    more = f" and {len(hidden) - 6} more" if len(hidden) > 6 else ""
    return [f"  not detectable in these logs at medium size: {text}{more}"]


def report_page(found: Diagnosis) -> str:
    """The HTML page."""
    from ...pages import render

    key, entry = headline(found.data)
    return render(
        files(__package__).joinpath("page.html"),
        title="Diagnosis of a hydraulic rig", verdict=found.data["verdict"], sentence=sentence(found), data=found.data,
        left=[text for text in (left_over(found), weak_proof(found)) if text],
        corrections=correction_texts(found), columns=_columns(found),
        head=(*words.signal(key), entry), traces=_traces(found), bars=_bars(found), ranking=_ranking(found),
        parameters=_parameters(found), detectable=_detectable(found), maps=_maps(found),
        named=[(n, _values(found, n)) for n in found.named], warnings=found.warnings, words=words,
        places=[(p, _spans(found, p)) for p in _shown_places(found)],
        catalogue=CATALOGUE, logs=[p.label for p in found.machine.parts],
        proofs=[p.label for p in found.sealed.machine.parts],
    )  # fmt: skip


def _traces(found: Diagnosis) -> list[Any]:
    """Before and after on the sealed logs: speed and its error with the noise band, the headline's channel first; then every
    other signal that was far off before."""
    first = int(words.signal(headline(found.data)[0])[1]) - 1
    machine = found.sealed.machine
    channels = sorted(machine.channels, key=lambda c: c != first)
    pictures = [_trace(found, next(s for s in machine.segments[c] if s.signal == "speed")) for c in channels]
    for c in channels:
        for s in {s.signal: s for s in machine.segments[c][::-1] if s.signal != "speed"}.values():
            entry = _entry(found, s)
            if max(entry["before"], entry["calibrated"]) > 2.0 * entry["noise"]:
                pictures.append(_trace(found, s))
    return pictures


def _entry(found: Diagnosis, segment: Segment) -> dict[str, float]:
    gap = found.data["gap"]["sealed"]
    return dict(gap[next(k for k in gap if k.startswith(f"{segment.signal}_{segment.channel + 1}"))])


def _trace(found: Diagnosis, segment: Segment) -> Any:
    from ...pages import COLOURS, figure, svg

    machine, channel = found.sealed.machine, segment.channel
    key, size = shown_unit(machine, segment.signal, channel)
    name, _, unit = words.signal(f"{segment.signal}_{channel + 1}_{key}")
    log = machine.parts[segment.log].log
    time, keep = log.time_s[segment.rows], segment.used
    entry = _entry(found, segment)
    noise = entry["noise"]
    # Beside errors far above the noise its band cannot be seen: what is left then has axes of its own.
    apart = max(entry["before"], entry["calibrated"]) > 5.0 * noise
    drawing, axes = figure(3 if apart else 2, height=2.1)
    measured = _thin(np.where(keep, segment.measured, np.nan) / size)
    axes[0].plot(_thin(time), measured, color=COLOURS[4], label="measured", linewidth=2.2)
    errors: dict[str, np.ndarray] = {}
    for model, colour in (("before", COLOURS[1]), ("calibrated", COLOURS[5]), ("after", COLOURS[0])):
        trace = found.sealed.traces[model][channel][segment.place]
        errors[model] = np.where(keep, segment.measured - trace, np.nan) / size
        if model != "calibrated":
            axes[0].plot(_thin(time), _thin(np.where(keep, trace, np.nan) / size), color=colour, label=model)
        for axis in axes[1:] if model == "after" else axes[1:2]:
            axis.plot(_thin(time), _thin(errors[model]), color=colour, label=model, linewidth=1.0)
    for axis, shown in zip(axes[1:], (list(errors.values()), [errors["after"]]), strict=False):
        axis.axhspan(
            -2.0 * noise, 2.0 * noise, color=COLOURS[4], alpha=0.25, label="noise, 2 standard deviations"
        )
        axis.set_ylabel(f"error, {unit}")
        finite = np.concatenate([e[np.isfinite(e)] for e in shown])
        if finite.size:  # a few events may be far larger than what the rest shows
            reach = max(1.15 * float(np.quantile(np.abs(finite), 0.998)), 3.0 * noise)
            axis.set_ylim(-reach, reach)
    axes[0].set_ylabel(f"{name}, {unit}")
    axes[-1].set_xlabel("time, s")
    for axis in axes:
        axis.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=4, frameon=False)
    caption = (
        f"Channel {channel + 1}, {name} on the held-out log {log.name}: measured and simulated; below, the residual (measured "
        "minus simulated)" + (", last that of the final model alone" if apart else "")
    )
    return caption, svg(drawing, f"{name} of channel {channel + 1} and its error")


def _maps(found: Diagnosis) -> list[Any]:
    """For the two places that hold most of the gap: the error over the quantity that its equation depends on, and the
    error over time with the worst windows."""
    return [_map(found, p) for p in _shown_places(found)[:2]]


def _map(found: Diagnosis, place: Place) -> Any:
    from ...pages import COLOURS, figure, svg

    number = max(set(place.logs), key=place.logs.count) if place.logs else 0
    drawing, axes = figure(2, height=2.0, share_x=False)
    form = place.shape
    points = np.array(form["points"]).reshape(-1, 3)
    axes[0].axhline(0.0, color=COLOURS[4], linewidth=0.8)
    axes[0].errorbar(
        points[:, 0],
        points[:, 1],
        2.0 * points[:, 2],
        color=COLOURS[1],
        marker="o",
        markersize=3.5,
        capsize=2,
    )
    axes[0].set_xlabel(form["over"])
    axes[0].set_ylabel(_folded(f"missing: {form['error']}"))
    machine, channel = found.machine, place.channel
    segment = next(s for s in machine.segments[channel] if s.signal == "speed" and s.log == number)
    key, size = shown_unit(machine, "speed", channel)
    unit = words.signal(f"speed_{channel + 1}_{key}")[2]
    time = machine.parts[number].log.time_s[segment.rows]
    for model, colour in (("calibrated", COLOURS[5]), ("after", COLOURS[0])):
        # The fit's proof is on the same segments, so places agree.
        trace = found.fit.traces[model][channel][segment.place]
        error = np.where(segment.used, segment.measured - trace, np.nan) / size
        axes[1].plot(_thin(time), _thin(error), color=colour, label=model, linewidth=1.0)
    for n, (start, end) in enumerate(
        w for w, log in zip(place.windows, place.logs, strict=True) if log == number
    ):
        axes[1].axvspan(start, end, color=COLOURS[1], alpha=0.18, label="largest gap" if n == 0 else None)
    axes[1].set_xlabel("time, s")
    axes[1].set_ylabel(f"speed error, {unit}")
    axes[1].legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, frameon=False)
    caption = (
        f"{words.equation(place.equation)} of channel {channel + 1}. Above: what the calibrated model misses, over the quantity "
        f"that it depends on (with 95 % intervals); the curve holds {100 * form['explains']:.0f} % of the error, "
        f"{100 * form['with_direction']:.0f} % where rising and falling are taken apart. Below: the windows of "
        f"{machine.parts[number].log.name} with most of it"
    )
    return caption[0].upper() + caption[1:], svg(drawing, f"where channel {channel + 1} errs")


def _folded(text: str) -> str:
    """A long axis label on lines of about twenty letters."""
    import textwrap

    return "\n".join(textwrap.wrap(text, 22))


def _thin(values: np.ndarray) -> np.ndarray:
    return values[:: max(1, values.size // POINTS)]


def _bars(found: Diagnosis) -> Any:
    """RMS errors on the sealed logs in noise units."""
    from ...pages import COLOURS, figure, svg

    gap = found.data["gap"]["sealed"]
    drawing, axes = figure(1, height=0.45 * len(gap) + 1.2)
    axis = axes[0]
    formed = bool(found.data["shape_corrections"])
    names = ("before", "calibrated", "placebo", *((NAMED,) if formed else ()), "after")
    said = {NAMED: "names only", "after": "after, with shape correction" if formed else "after"}
    colours = {
        "before": COLOURS[1], "calibrated": COLOURS[5], "placebo": COLOURS[3], NAMED: COLOURS[2], "after": COLOURS[0],
    }  # fmt: skip
    step = 0.8 / len(names)
    rows = np.arange(len(gap))[::-1]
    for n, name in enumerate(names):
        values = [max(e[name] / max(e["noise"], 1e-30), 1e-3) for e in gap.values()]
        axis.barh(rows + 0.3 - step * n, values, 0.9 * step, color=colours[name], label=said.get(name, name))
    axis.axvline(1.0, color=COLOURS[4], linewidth=2.0)
    axis.set_xscale("log")
    largest = max(e[name] / max(e["noise"], 1e-30) for e in gap.values() for name in names)
    axis.set_xlim(0.5, max(2.0, 1.3 * largest))
    axis.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axis.xaxis.set_minor_formatter(lambda value, _: "")
    axis.set_yticks(rows, [" ".join(words.signal(k)[:2]) for k in gap])
    axis.set_xlabel("RMS error over noise (1: nothing left to explain)")
    axis.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=len(names), frameon=False)
    return svg(drawing, "errors of the models in noise units")


def _ranking(found: Diagnosis) -> list[dict[str, Any]]:
    """Candidates by gain in their last try: taken ones first, then by gain."""
    trials: dict[tuple[str, int | None], Trial] = {}
    for t in found.selection.trials:
        key = (t.effect, t.channel)
        if (
            key not in trials
            or t.fate == "taken"
            or (trials[key].fate != "taken" and t.problem is not None and t.gain > trials[key].gain)
        ):
            trials[key] = t
    rows = sorted(trials.values(), key=lambda t: (t.fate != "taken", t.problem is None, -t.gain))
    tied = {(rival, n.channel): n.name for n in found.named for rival in n.indistinguishable_from}
    ranked = []
    for t in rows:
        place = "rig" if t.channel is None else str(t.channel + 1)
        twin = tied.get((t.effect, place)) or tied.get((t.effect, "both"))
        fate = f"as good: cannot be told from {words.plain(twin)}" if twin and t.fate != "taken" else t.fate
        ranked.append(
            {
                "effect": t.effect, "where": place, "gain": float(t.gain), "needed": float(t.needed),
                "refitted": t.problem is not None, "fate": fate,
            }
        )  # fmt: skip
    return ranked


def _parameters(found: Diagnosis) -> list[dict[str, Any]]:
    rows = []
    for name, p in found.data["calibrated"].items():
        said = words.known(name, p["value"], found.machine.model)
        rows.append(
            {
                "name": name,
                "said": said,
                **p,
                "change": p["value"] / p["nominal"] - 1.0 if p["nominal"] else 0.0,
            }
        )
    return rows


def _detectable(found: Diagnosis) -> tuple[Sequence[str], list[tuple[str, list[str]]]]:
    columns = [str(c + 1) for c in found.machine.channels] + (
        ["rig"] if any("rig" in v for v in found.data["detectable"].values()) else []
    )
    marks = {True: "yes", False: "no", None: ""}
    hidden = found.data["hidden_by_calibration"]
    return columns, [
        (name, ["calibration hides it" if c in hidden.get(name, ()) else marks[row.get(c)] for c in columns])
        for name, row in found.data["detectable"].items()
    ]
