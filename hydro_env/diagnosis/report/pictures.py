"""The pictures of the report, as inline SVG with their captions."""

from __future__ import annotations

import textwrap
from typing import Any

import numpy as np

from ...pages import COLOURS, figure, svg
from ..models.base import Segment
from ..stages.localisation import Location
from ..stages.validation import NAMED
from ..state import State
from . import wording as words
from .statements import errors_of, headline, shown_locations, unit_of

__all__ = ["bars", "maps", "traces"]

#: Points of a trace in a picture.
POINTS = 900
#: Signals that the calibrated model leaves off by so many times the noise have a picture.
FAR_OFF = 2.0
#: Beside errors of so many times the noise its band cannot be seen: what is left then has axes of its own.
BAND_INVISIBLE = 5.0
#: Room for numbers and a label on the left of a picture, and for a letter of a label, inches.
LEFT, LETTER = 0.95, 0.065
_MODEL_COLOURS = {
    "before": COLOURS[1], "calibrated": COLOURS[5], "placebo": COLOURS[3], NAMED: COLOURS[2], "after": COLOURS[0],
}  # fmt: skip
_ABOVE = {"loc": "lower center", "bbox_to_anchor": (0.5, 1.0), "frameon": False}


def traces(state: State) -> list[tuple[str, Any]]:
    """Before and after on the held-out logs: speed and its error with the noise band, the headline's channel first; then every
    other signal that calibration leaves far off."""
    proof, first = state.proofs.held_out, headline(state).channel
    segments = proof.rig.segments
    channels = sorted(proof.rig.channels, key=lambda c: c != first)
    pictures = [_trace(state, next(s for s in segments[c] if s.signal == "speed")) for c in channels]
    for c in channels:
        for s in {s.signal: s for s in segments[c][::-1] if s.signal != "speed"}.values():
            entry = proof.errors[c, s.signal]
            if entry["calibrated"] > FAR_OFF * entry["noise"]:
                pictures.append(_trace(state, s))
    return pictures


def _trace(state: State, segment: Segment) -> tuple[str, Any]:
    proof, channel, keep = state.proofs.held_out, segment.channel, segment.used
    unit, size = unit_of(proof.rig, segment.signal, channel)
    name, log = words.SIGNALS[segment.signal], proof.rig.parts[segment.log].log
    time, entry = _thin(log.time_s[segment.rows]), proof.errors[channel, segment.signal]
    apart = max(entry["before"], entry["calibrated"]) > BAND_INVISIBLE * entry["noise"]
    drawing, axes = figure(3 if apart else 2, height=2.1, left=LEFT)
    measured = np.where(keep, segment.measured, np.nan) / size
    axes[0].plot(time, _thin(measured), color=COLOURS[4], label="measured", linewidth=2.2)
    errors: dict[str, np.ndarray] = {}
    for model in ("before", "calibrated", "after"):
        trace, colour = proof.traces[model][channel][segment.place], _MODEL_COLOURS[model]
        errors[model] = np.where(keep, segment.measured - trace, np.nan) / size
        if model != "calibrated":
            axes[0].plot(time, _thin(np.where(keep, trace, np.nan) / size), color=colour, label=model)
        for axis in axes[1:] if model == "after" else axes[1:2]:
            axis.plot(time, _thin(errors[model]), color=colour, label=model, linewidth=1.0)
    for axis, shown in zip(axes[1:], (list(errors.values()), [errors["after"]]), strict=False):
        _noise_band(axis, entry["noise"], np.concatenate(shown))
        axis.set_ylabel(f"error, {unit}")
    axes[0].set_ylabel(f"{name}, {unit}")
    axes[-1].set_xlabel("time, s")
    for axis in axes:
        axis.legend(ncols=4, **_ABOVE)
    caption = (
        f"Channel {channel + 1}, {name} on the held-out log {log.name}: measured and simulated; below, the residual (measured "
        "minus simulated)" + (", last that of the final model alone" if apart else "")
    )
    return caption, svg(drawing, f"{name} of channel {channel + 1} and its error")


def _noise_band(axis: Any, noise: float, errors: np.ndarray) -> None:
    """The noise as a band, and limits that a few far larger events do not set."""
    label = "noise, 2 standard deviations"
    axis.axhspan(-2.0 * noise, 2.0 * noise, color=COLOURS[4], alpha=0.25, label=label)
    finite = errors[np.isfinite(errors)]
    if finite.size:
        reach = max(1.15 * float(np.quantile(np.abs(finite), 0.998)), 3.0 * noise)
        axis.set_ylim(-reach, reach)


def maps(state: State) -> list[tuple[str, Any]]:
    """For the two locations that hold most of the residual: the error over the quantity that its equation depends on, and the
    error over time with the worst windows."""
    return [_map(state, p) for p in shown_locations(state)[:2]]


def _map(state: State, location: Location) -> tuple[str, Any]:
    rig, channel, form = state.rig, location.channel, location.shape
    number = max(set(location.logs), key=location.logs.count) if location.logs else 0
    drawing, (above, below) = figure(2, height=2.0, share_x=False, left=LEFT)
    x, y, spread = np.array(form.points).reshape(-1, 3).T
    above.axhline(0.0, color=COLOURS[4], linewidth=0.8)
    above.errorbar(x, y, 2.0 * spread, color=COLOURS[1], marker="o", markersize=3.5, capsize=2)
    above.set_xlabel(form.over)
    above.set_ylabel("\n".join(textwrap.wrap(f"residual: {form.error}", 22)))
    segment = next(s for s in rig.segments[channel] if s.signal == "speed" and s.log == number)
    unit, size = unit_of(rig, "speed", channel)
    log = rig.parts[number].log
    for model in ("calibrated", "after"):
        # The fit's proof is on the same segments, so places agree.
        trace = state.proofs.fit.traces[model][channel][segment.place]
        error = np.where(segment.used, segment.measured - trace, np.nan) / size
        time, colour = _thin(log.time_s[segment.rows]), _MODEL_COLOURS[model]
        below.plot(time, _thin(error), color=colour, label=model, linewidth=1.0)
    windows = [w for w, own in zip(location.windows, location.logs, strict=True) if own == number]
    for n, (start, end) in enumerate(windows):
        below.axvspan(start, end, color=COLOURS[1], alpha=0.18, label="largest residual" if n == 0 else None)
    below.set_xlabel("time, s")
    below.set_ylabel(f"speed error, {unit}")
    below.legend(ncols=3, **_ABOVE)
    caption = (
        f"{words.equation(location.equation)} of channel {channel + 1}. Above: residual of the calibrated model over the "
        f"quantity that it depends on (with 95 % intervals); a curve explains {100 * form.explains:.0f} % of it, "
        f"{100 * form.with_direction:.0f} % with separate curves for rising and falling. Below: the windows of "
        f"{log.name} with most of it"
    )
    return caption[0].upper() + caption[1:], svg(drawing, f"where channel {channel + 1} errs")


def _thin(values: np.ndarray) -> np.ndarray:
    return values[:: max(1, values.size // POINTS)]


def bars(state: State) -> Any:
    """RMS errors on the held-out logs in noise units."""
    signals = errors_of(state.proofs.held_out)
    labels = [f"{s.name} {s.channel + 1}" for s in signals]
    left = 0.2 + LETTER * max(map(len, labels))
    drawing, (axis,) = figure(1, height=0.8 * len(signals) + 0.9, left=left)
    names = ("before", "calibrated", "placebo", *((NAMED,) if state.corrections else ()), "after")
    said = {NAMED: "effects only"}  # as in the table above the picture
    step = 0.8 / len(names)
    rows = np.arange(len(signals))[::-1]
    over_noise = {n: [s.errors[n] / max(s.errors["noise"], 1e-30) for s in signals] for n in names}
    for n, name in enumerate(names):
        values = [max(v, 1e-3) for v in over_noise[name]]
        style = {"color": _MODEL_COLOURS[name], "label": said.get(name, name)}
        drawn = axis.barh(rows + 0.3 - step * n, values, 0.9 * step, **style)
        texts = [f"{words.number(s.errors[name])} {s.unit}" for s in signals]
        axis.bar_label(drawn, texts, padding=4, fontsize=8)
    axis.grid(axis="y", visible=False)
    axis.margins(y=0.02)
    axis.axvline(1.0, color=COLOURS[4], linewidth=2.0)
    axis.set_xscale("log")
    # The bars end at 85 % of the width, so that their values have room.
    widest = max(2.0, *(v for values in over_noise.values() for v in values))
    axis.set_xlim(0.5, 0.5 * (widest / 0.5) ** (1.0 / 0.85))
    axis.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axis.xaxis.set_minor_formatter(lambda value, _: "")
    axis.set_yticks(rows, labels)
    axis.set_xlabel("RMS error over noise (1, grey line: nothing left to explain)")
    axis.legend(ncols=len(names), **_ABOVE)
    return svg(drawing, "errors of the models in noise units")
