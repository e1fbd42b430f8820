"""The report: a page that needs no network, for a manager (first sentence, first picture) and an engineer (the rest), and its
pictures, inline SVG with their captions."""

import textwrap
from datetime import date
from importlib.resources import files
from typing import TYPE_CHECKING, Any

import numpy as np

from ... import __version__
from ...pages import COLOURS, figure, render, svg
from ...plant import CATALOGUE
from ..models.base import Segment
from ..stages.localisation import Location
from ..stages.screening import detectable, hidden_by_calibration
from . import statements as say
from . import wording as words

if TYPE_CHECKING:
    from ..result import Diagnosis

#: Points of a trace in a picture: one for each pixel of its width.
POINTS = 900
#: Signals that the calibrated model leaves off by this many times the noise have a picture.
FAR_OFF = 2.0
#: Beside errors of this many times the noise its band, of four standard deviations, takes less than half of a picture: what is
#: left then has axes of its own.
BAND_INVISIBLE = 5.0
#: Room for numbers and a label on the left of a picture, inches.
LEFT = 0.95
_COLOURS = {"before": COLOURS[1], "calibrated": COLOURS[5], "after": COLOURS[0]}
_ABOVE = {"loc": "lower center", "bbox_to_anchor": (0.5, 1.0), "frameon": False}


def report_page(state: "Diagnosis") -> str:
    """The HTML page."""
    return render(
        files(__package__).joinpath("page.html"),
        title=f"Diagnosis of {say.log_names(state)}, model {state.rig.model.name}, {date.today()}", version=__version__,
        state=state, say=say, words=words, catalogue=CATALOGUE, head=say.headline(state), columns=say.error_columns(state),
        parameters=[(p, say.comment(state.rig, p)) for p in state.known], traces=traces(state),
        maps=[(p, _map(p)) for p in say.shown_locations(state)[:2]],
        seen=detectable(state.screening), hidden=hidden_by_calibration(state.screening),
    )  # fmt: skip


# --- pictures ---------------------------------------------------------------------------------------------------------------
def traces(state: "Diagnosis") -> list[dict[str, Any]]:
    """Before and after on the held-out logs: speed and its error with the noise band, the headline's channel first; then every
    other signal that calibration leaves far off."""
    proof, first = state.proofs.held_out, say.headline(state).channel
    by_channel = [{s.signal: s for s in proof.rig.segments[c][::-1]} for c in proof.rig.channels]
    by_channel.sort(key=lambda own: own["speed"].channel != first)
    off = {key for key, e in proof.errors.items() if e["calibrated"] > FAR_OFF * e["noise"]}
    speeds = [own.pop("speed") for own in by_channel]
    far = (s for own in by_channel for s in own.values() if (s.channel, s.signal) in off)
    return [_trace(state, s) for s in (*speeds, *far)]


def _trace(state: "Diagnosis", segment: Segment) -> dict[str, Any]:
    """The picture of a signal, and what its caption needs."""
    proof, channel, keep = state.proofs.held_out, segment.channel, segment.used
    unit, size = say.unit_of(proof.rig, segment.signal, channel)
    name, log = words.SIGNALS[segment.signal], proof.rig.parts[segment.log].log
    entry, every = proof.errors[channel, segment.signal], slice(None, None, max(1, keep.size // POINTS))
    time = log.time_s[segment.rows][every]
    apart = max(entry["before"], entry["calibrated"]) > BAND_INVISIBLE * entry["noise"]
    drawing, axes = figure(3 if apart else 2, height=2.1, left=LEFT)
    measured = np.where(keep, segment.measured, np.nan) / size
    axes[0].plot(time, measured[every], color=COLOURS[4], label="measured", linewidth=2.2)
    errors: dict[str, np.ndarray] = {}
    for model, colour in _COLOURS.items():
        trace = proof.traces[model][channel][segment.place] / size
        errors[model] = measured - trace
        if model != "calibrated":
            shown = np.where(keep, trace, np.nan)[every]
            axes[0].plot(time, shown, color=colour, label=model)
        for axis in axes[1:] if model == "after" else axes[1:2]:
            axis.plot(time, errors[model][every], color=colour, label=model, linewidth=1.0)
    for axis, shown in zip(axes[1:], (np.array([*errors.values()]), errors["after"]), strict=False):
        band = 2.0 * entry["noise"]
        axis.axhspan(-band, band, color=COLOURS[4], alpha=0.25, label="noise, 2 standard deviations")
        # Limits that a few far larger events do not set.
        if (finite := np.abs(shown[np.isfinite(shown)])).size:
            reach = max(1.15 * float(np.quantile(finite, 0.998)), 3.0 * entry["noise"])
            axis.set_ylim(-reach, reach)
        axis.set_ylabel(f"error, {unit}")
    axes[0].set_ylabel(f"{name}, {unit}")
    axes[-1].set_xlabel("time, s")
    for axis in axes:
        axis.legend(ncols=4, **_ABOVE)
    picture = svg(drawing, f"{name} of channel {channel + 1} and its error")
    return {"picture": picture, "channel": channel + 1, "signal": name, "log": log.name, "apart": apart}


def _map(location: Location) -> Any:
    """Of a location that holds much of the residual: the error over the quantity that its equation depends on."""
    form = location.shape
    drawing, (axis,) = figure(1, height=2.0, left=LEFT)
    x, y, spread = np.array(form.points).reshape(-1, 3).T
    axis.axhline(0.0, color=COLOURS[4], linewidth=0.8)
    axis.errorbar(x, y, 2.0 * spread, color=COLOURS[1], marker="o", markersize=3.5, capsize=2)
    axis.set_xlabel(form.over)
    axis.set_ylabel("\n".join(textwrap.wrap(f"residual: {form.error}", 22)))
    return svg(drawing, f"where channel {location.channel + 1} errs")
