"""The report: a page that needs no network, for a manager (first sentence, first picture) and an engineer (the rest)."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.resources import files
from typing import TYPE_CHECKING, Any

import numpy as np

from ..plant import CATALOGUE
from .prove import shown_unit
from .result import parameter_text

if TYPE_CHECKING:
    from .command import Diagnosis
    from .select import Trial

__all__ = ["report_page", "sentence", "terminal_text"]

_NAMES = {
    "speed": "speed",
    "current": "coil current",
    "pressure": "pressure difference",
    "spool": "spool position",
    "flow": "flow",
}
_UNITS = {"mm_per_s": "mm/s", "lpm": "l/min"}
#: Points of a trace in a picture.
POINTS = 900


def _plain(name: str) -> str:
    return name.replace("_", " ")


def _where(channel: str) -> str:
    return {"rig": "the whole rig", "both": "both channels"}.get(channel, f"channel {channel}")


def sentence(found: Diagnosis) -> str:
    """The verdict in one sentence."""
    word, data = found.data["verdict"], found.data
    key, entry = headline(data)
    signal, channel, unit = _split(key)
    gap = f"On the sealed logs the {signal} error of channel {channel} is {entry['after']:.3g} {unit} RMS"
    noise = f"noise {entry['noise']:.3g}"
    if word == "none":
        return f"Nothing is missing: the model as given explains the logs. {gap} ({noise})."
    if word == "calibration":
        return (
            "Only known parameters were off: adjusted inside their plausible ranges, the model explains the logs. "
            f"{gap}, {entry['before']:.3g} before ({noise})."
        )
    names = "; ".join(f"{_plain(n.name)} on {_where(n.channel)}" for n in found.named)
    if word == "effects":
        return (
            f"The model lacks {names}. {gap}: {entry['before']:.3g} as given, "
            f"{entry['calibrated']:.3g} after calibration alone ({noise})."
        )
    known = f" {names} explains a part." if names else ""
    places = ", ".join(
        dict.fromkeys(
            f"{_plain(p.equation)} of channel {p.channel + 1} ({p.regime})" for p in found.places[:2]
        )
    )
    return (
        f"Something is missing that no effect of the catalogue explains; it shows in {places or 'all signals'}."
        f"{known} {gap} ({noise})."
    )


def headline(data: dict[str, Any]) -> tuple[str, dict[str, float]]:
    """The signal that tells most: the speed whose gap fell most, in noise units."""
    speeds = {k: v for k, v in data["gap"]["sealed"].items() if k.startswith("speed")}
    key = max(
        speeds, key=lambda k: (speeds[k]["before"] - speeds[k]["after"]) / max(speeds[k]["noise"], 1e-30)
    )
    return key, speeds[key]


def _split(key: str) -> tuple[str, str, str]:
    signal, channel, unit = key.split("_", 2)
    return _NAMES[signal], channel, _UNITS.get(unit, unit)


def terminal_text(found: Diagnosis) -> str:
    """About twenty lines."""
    data = found.data
    lines = [f"verdict: {data['verdict']}", sentence(found), ""]
    for n in found.named:
        tied = (
            f"; cannot be told from {', '.join(n.indistinguishable_from)}" if n.indistinguishable_from else ""
        )
        lines.append(f"  {n.name} ({_where(n.channel)}), probability {n.probability:.2f}{tied}")
        lines += [f"    {name} = {parameter_text(p)}" for name, p in n.parameters.items()]
    lines += [
        "RMS error on the sealed logs",
        f"  {'signal':<18}{'noise':>9}{'before':>10}{'calibrated':>12}{'after':>10}{'placebo':>10}",
    ]
    for key, e in data["gap"]["sealed"].items():
        lines.append(
            f"  {key:<18}{e['noise']:9.3g}{e['before']:10.3g}{e['calibrated']:12.3g}{e['after']:10.3g}{e['placebo']:10.3g}"
        )
    hidden = [
        f"{name}:{c}" for name, row in data["detectable"].items() for c, seen in row.items() if not seen
    ]
    if hidden:
        text = ", ".join(hidden[:8]) + (f" and {len(hidden) - 8} more" if len(hidden) > 8 else "")
        lines.append(f"could not be seen in these logs at medium size: {text}")
    if data["verdict"] == "unknown":
        for place in data["where"][:2]:
            form = place["shape"]
            lines.append(
                f"{_plain(place['equation'])} of channel {place['channel']}: a curve over {form['over']} holds "
                f"{100 * form['explains']:.0f} % of the error, {100 * form['with_direction']:.0f} % rising and falling apart"
            )
    if data["next_experiment"]:
        lines.append(f"next experiment: {data['next_experiment']['description']}")
    lines += [f"warning: {text}" for text in found.warnings[:4]]
    if len(found.warnings) > 4:
        lines.append(f"warning: {len(found.warnings) - 4} more in the report")
    return "\n".join(lines)


def report_page(found: Diagnosis) -> str:
    """The HTML page."""
    from ..pages import render

    return render(
        files("hydro_env.diagnosis").joinpath("report.html"),
        title="Diagnosis of a hydraulic rig", verdict=found.data["verdict"], sentence=sentence(found), data=found.data,
        traces=_traces(found), bars=_bars(found), ranking=_ranking(found), parameters=_parameters(found),
        detectable=_detectable(found),
        named=found.named, warnings=found.warnings, plain=_plain, where=_where, parameter_text=parameter_text,
        split=_split, catalogue=CATALOGUE, logs=[p.label for p in found.machine.parts],
        proofs=[p.label for p in found.sealed.machine.parts],
    )  # fmt: skip


def _traces(found: Diagnosis) -> list[Any]:
    """Before and after on the sealed logs, one picture for each channel: speed, its error with the noise band."""
    from ..pages import COLOURS, figure, svg

    pictures = []
    machine = found.sealed.machine
    for channel in machine.channels:
        segment = next(s for s in machine.segments[channel] if s.signal == "speed")
        unit, size = shown_unit(machine, "speed", channel)
        unit = _UNITS.get(unit, unit)
        log = machine.parts[segment.log].log
        time = log.time_s[segment.rows]
        keep = segment.used
        noise = found.data["gap"]["sealed"][
            next(k for k in found.data["gap"]["sealed"] if k.startswith(f"speed_{channel + 1}"))
        ]["noise"]
        drawing, axes = figure(2, height=2.1)
        shown = _thin(np.where(keep, segment.measured, np.nan) / size)
        axes[0].plot(_thin(time), shown, color=COLOURS[4], label="measured", linewidth=2.2)
        axes[1].axhspan(
            -2.0 * noise, 2.0 * noise, color=COLOURS[4], alpha=0.25, label="noise, 2 standard deviations"
        )
        for name, colour in (("before", COLOURS[1]), ("calibrated", COLOURS[5]), ("after", COLOURS[0])):
            trace = found.sealed.traces[name][channel][segment.place]
            if name != "calibrated":
                axes[0].plot(
                    _thin(time), _thin(np.where(keep, trace, np.nan) / size), color=colour, label=name
                )
            axes[1].plot(
                _thin(time),
                _thin(np.where(keep, segment.measured - trace, np.nan) / size),
                color=colour,
                label=name,
                linewidth=1.0,
            )
        axes[0].set_ylabel(f"speed, {unit}")
        axes[1].set_ylabel(f"error, {unit}")
        axes[1].set_xlabel("time, s")
        for axis in axes:
            axis.legend(loc="upper right", ncols=4)
        pictures.append(
            (
                f"Channel {channel + 1}, sealed log {log.name}",
                svg(drawing, f"speed of channel {channel + 1} and its error"),
            )
        )
    return pictures


def _thin(values: np.ndarray) -> np.ndarray:
    return values[:: max(1, values.size // POINTS)]


def _bars(found: Diagnosis) -> Any:
    """RMS errors on the sealed logs in noise units."""
    from ..pages import COLOURS, figure, svg

    gap = found.data["gap"]["sealed"]
    drawing, axes = figure(1, height=0.45 * len(gap) + 1.2)
    axis = axes[0]
    names = ("before", "calibrated", "placebo", "after")
    colours = dict(zip(names, (COLOURS[1], COLOURS[5], COLOURS[3], COLOURS[0]), strict=True))
    rows = np.arange(len(gap))[::-1]
    for n, name in enumerate(names):
        values = [max(e[name] / max(e["noise"], 1e-30), 1e-3) for e in gap.values()]
        axis.barh(rows + 0.3 - 0.2 * n, values, 0.18, color=colours[name], label=name)
    axis.axvline(1.0, color=COLOURS[4], linewidth=2.0)
    axis.set_xscale("log")
    axis.set_yticks(rows, [f"{_split(k)[0]} {_split(k)[1]}" for k in gap])
    axis.set_xlabel("RMS error over noise (1: nothing left to explain)")
    axis.legend(loc="lower right", ncols=4)
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
    return [
        {
            "effect": t.effect, "where": "rig" if t.channel is None else str(t.channel + 1), "gain": float(t.gain),
            "needed": float(t.needed),
            "refitted": t.problem is not None, "fate": t.fate,
        }
        for t in rows
    ]  # fmt: skip


def _parameters(found: Diagnosis) -> list[dict[str, Any]]:
    rows = []
    for name, p in found.data["calibrated"].items():
        rows.append({"name": name, **p, "change": p["value"] / p["nominal"] - 1.0 if p["nominal"] else 0.0})
    return rows


def _detectable(found: Diagnosis) -> tuple[Sequence[str], list[tuple[str, list[str]]]]:
    columns = [str(c + 1) for c in found.machine.channels] + (
        ["rig"] if any("rig" in v for v in found.data["detectable"].values()) else []
    )
    marks = {True: "yes", False: "no", None: ""}
    return columns, [
        (name, [marks[row.get(c)] for c in columns]) for name, row in found.data["detectable"].items()
    ]
