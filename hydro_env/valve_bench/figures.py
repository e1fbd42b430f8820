"""The figures of a steady flow curve, in the manner of ISO 10770-1 (steady-state tests, output flow over signal).

All of them are read at equal flow: `rising(q)` and `falling(q)` are the signals at which the two branches pass the
flow q, and their middle is the valve without its hysteresis. 100 % of a signal is the rated signal, 100 % of a flow
the largest flow of that direction.

    dead zone      signal, from zero to where flow begins, each way: a parabola through the middle line between 3 and
                   50 % of the flow, extrapolated to no flow (subject: dead band, spool lap). `opens_at` is the signal
                   of the rising branch at 1 % of the flow, `closes_at` that of the returning one. A negative dead zone
                   is a valve that is open at zero signal.
    null           middle between the two edges of the dead zone (null bias); with no overlap, where the flow is zero
    hysteresis     largest difference of signal between the branches at equal flow, as the mean over a window of 4 % of
                   the flow; flows below 2 % and above 98 % of the largest are left out, where the curve is flat
    gain           slope of the straight line through the middle line between 10 and 80 % of the flow (normal flow gain)
    linearity      largest distance of the middle line from that straight line, in signal, between 5 and 95 % of the flow
    symmetry       difference of the two gains over the larger
    maximum flow   at the largest signal that was driven
    threshold      change of signal that the flow takes no notice of when the signal turns (seen at the turns of the
                   sweep, beyond half of the rated signal, at a change of 0.5 % of the flow)
    saturation     signal from which on the flow stays above 99 % of its largest value
"""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from hydro_env.units import LPM
from hydro_env.valve_bench.curve import FLOW, Curve, Floats, Loop, Monotone, loop_of, resolution
from hydro_env.valve_bench.leakage import flank_signals, flanks_of, peak_of

#: Shares of the largest flow between which each figure is read.
EDGE, LINE, LINEAR, WIDTH = (0.03, 0.5), (0.1, 0.8), (0.05, 0.95), (0.02, 0.98)
#: The directions of the flow.
WORDS = {1: "positive", -1: "negative"}
#: Share of the flow that counts as having begun.
BEGUN = 0.01
#: Hysteresis is the mean over a window of this share of the flow.
WINDOW = 0.04


@dataclass(frozen=True)
class Side:
    """One direction of the flow. Signals are counted away from zero, so both directions read alike.

    dead_zone, opens_at, closes_at in the unit of the signal; gain in m3/s per unit of signal; maximum_flow in m3/s;
    linearity_percent of the rated signal; `saturates_at` is None if the flow grows to the end.
    """

    dead_zone: float
    dead_zone_uncertainty: float
    opens_at: float | None
    closes_at: float | None
    gain: float
    linearity_percent: float
    maximum_flow: float
    largest_signal: float
    saturates_at: float | None


@dataclass(frozen=True)
class Figures:
    """All figures of the valve of a `curve`. What that does not tell is None, and `findings` says why."""

    curve: Curve
    kind: str
    noise: float
    findings: tuple[str, ...]
    positive: Side | None = None
    negative: Side | None = None
    hysteresis_percent: float | None = None
    hysteresis_uncertainty_percent: float | None = None
    widest_at: float | None = None
    mean_loop_percent: float | None = None
    null: float | None = None
    flow_at_zero: float | None = None
    gain_asymmetry_percent: float | None = None
    maximum_flow_asymmetry_percent: float | None = None
    threshold_percent: float | None = None
    leakage: dict[str, float] | None = None

    def as_json(self) -> dict[str, Any]:
        """The figures with units in the names: signals in percent of the rated one, flows in l/min."""
        found = {
            "name": self.curve.name,
            "kind": self.kind,
            "rated_signal": {"value": self.curve.rated, "unit": self.curve.signal_unit},
            "positive": self._side(self.positive),
            "negative": self._side(self.negative),
            "hysteresis": {
                "percent": self.hysteresis_percent,
                "uncertainty_percent": self.hysteresis_uncertainty_percent,
                "widest_at_percent": self._percent(self.widest_at),
                "widest_at": self.widest_at,
                "mean_percent": self.mean_loop_percent,
            },
            "null": {"percent": self._percent(self.null), "signal": self.null},
            "flow_at_zero_lpm": None if self.flow_at_zero is None else self.flow_at_zero / LPM,
            "gain_asymmetry_percent": self.gain_asymmetry_percent,
            "maximum_flow_asymmetry_percent": self.maximum_flow_asymmetry_percent,
            "threshold_percent": self.threshold_percent,
            "noise_lpm": self.noise / LPM,
            "findings": list(self.findings),
        }
        if self.leakage is not None:
            flows = {f"{name}_lpm": self.leakage[name] / LPM for name in ("maximum", "least")}
            found["leakage"] = {**flows, "null_percent": self._percent(self.leakage["null"])}
        return found

    def _percent(self, signal: float | None) -> float | None:
        return None if signal is None else float(self.curve.percent(signal))

    def _side(self, side: Side | None) -> dict[str, Any] | None:
        if side is None:
            return None
        data, travel = asdict(side), self.curve.travel_per_signal
        gain, most = data.pop("gain"), data.pop("maximum_flow")
        return {
            **data,
            "dead_zone_percent": self._percent(side.dead_zone),
            "dead_zone_travel_m": None if travel is None else side.dead_zone * travel,
            "gain_lpm_per_unit": gain / LPM,
            "gain_m2_per_s": None if travel is None else gain / travel,
            "maximum_flow_lpm": most / LPM,
        }


def identify(curve: Curve) -> Figures:
    """The figures of one sweep. InputError if the curve has too little in it."""
    loop = loop_of(curve)
    notes = list(loop.findings)
    steps = resolution(curve.signal), resolution(curve.flow)
    full = float(np.abs(curve.flow).max())
    if steps[0] > 2e-3 * curve.rated or steps[1] > 5e-3 * full:
        shares = f"{curve.percent(steps[0]):.2g} % of the rated signal and {100.0 * steps[1] / full:.2g} % of the largest flow"
        notes.append(f"recorded in steps of {shares}, which limits every figure")
    found = _flow(curve, loop, steps, notes) if loop.kind == FLOW else _leakage(curve, loop, notes)
    findings = (*curve.findings, *(f"{curve.name}: {each}" for each in notes))
    return Figures(curve, loop.kind, loop.noise, findings, **found)


def _flow(curve: Curve, loop: Loop, steps: tuple[float, float], notes: list[str]) -> dict[str, Any]:
    """Figures of a flow curve, by their names."""
    sides = sides_of(curve, loop, steps, notes)
    positive, negative = sides[1], sides[-1]
    found: dict[str, Any] = {"positive": positive, "negative": negative, **_hysteresis(curve, loop, sides)}
    if positive and negative:
        found["null"] = 0.5 * (positive.dead_zone - negative.dead_zone)
        for name in ("gain", "maximum_flow"):
            a, b = getattr(positive, name), getattr(negative, name)
            found[f"{name}_asymmetry_percent"] = 100.0 * float(abs(a - b) / max(a, b))
    if loop.low <= 0.0 <= loop.high:
        found["flow_at_zero"] = float(np.mean([branch.flow_at(0.0) for branch in loop.branches]))
    return found | {"threshold_percent": _threshold(curve, loop, sides, steps, notes)}


def sides_of(
    curve: Curve, loop: Loop, steps: tuple[float, float] = (0.0, 0.0), notes: list[str] | None = None
) -> dict[int, Side | None]:
    """The directions 1 and -1 of a curve, None where nothing flows and of a curve of leakage. `steps`: those in which signal and
    flow were recorded; `notes`: what was noticed is added. InputError if neither direction flows, or if the curve cannot be
    read."""
    if loop.kind != FLOW:
        return dict.fromkeys(WORDS)
    notes = [] if notes is None else notes
    top = {sign: max(branch.largest(sign) for branch in loop.branches) for sign in WORDS}
    sides: dict[int, Side | None] = dict.fromkeys(WORDS)
    for sign, word in WORDS.items():
        if top[sign] < max(0.05 * max(top.values()), 6.0 * loop.bin_noise):
            notes.append(f"no {word} flow in the curve, its figures are left out")
        else:
            sides[sign] = _side(curve, loop, sign, top[sign], steps, notes)
    if not any(sides.values()):
        raise curve.refused(f"the flow does not rise out of its noise of {loop.noise / LPM:.3g} l/min")
    return sides


def widths(rising: Monotone, falling: Monotone, levels: Floats) -> Floats:
    """Signal of the rising branch less that of the falling one at these flows (m3/s)."""
    return rising.signal_at(levels) - falling.signal_at(levels)


def _middle(loop: Loop, levels: Floats) -> Floats:
    return np.mean([branch.signal_at(levels) for branch in loop.branches], axis=0)


def _side(
    curve: Curve, loop: Loop, sign: int, top: float, steps: tuple[float, float], notes: list[str]
) -> Side:
    word = WORDS[sign]
    levels = np.linspace(0.01, 0.99, 197)
    # A branch that does not begin at no flow (an open valve swept on one side) cannot be read below its own start.
    covered = min(branch.largest(sign) for branch in loop.branches) / top
    inside = levels < 0.995 * covered
    middle = sign * _middle(loop, sign * top * levels)
    use = (levels >= LINE[0]) & (levels <= min(LINE[1], covered))
    if np.count_nonzero(use) < 10:
        raise curve.refused(f"the branches share too little {word} flow; sweep both over the same range")
    if not np.ptp(middle[use]) > 1e-6 * curve.rated:
        raise curve.refused(f"the {word} flow jumps at one signal; record samples between, more slowly")
    slope, start = np.polyfit(levels[use] * top, middle[use], 1)
    if not slope > 0.0:
        raise curve.refused(f"the {word} flow does not grow with the signal; is a column wrong?")
    straight = start + slope * levels * top
    between = (levels >= LINEAR[0]) & (levels <= LINEAR[1]) & inside
    off = float(np.max(np.abs(middle - straight)[between]))
    edges, spreads = zip(*(_edge(branch, sign, top) for branch in loop.branches), strict=True)
    outward, back = (loop.rising, loop.falling)[::sign]
    begun = sign * top * BEGUN
    opens, closes = (None if b is None else sign * float(b.signal_at(begun)) for b in (outward, back))
    end = sign * (loop.high if sign > 0 else loop.low)
    # On the way out only: on the way back hysteresis alone keeps the flow up.
    last = outward or loop.branches[0]
    full = sign * float(last.signal_at(sign * 0.99 * last.largest(sign)))
    slack = 3.0 * loop.bin_noise / top
    # A straight curve reaches 99 % of its flow one hundredth of its length before the end.
    flat = end - full > 0.03 * end + (0.01 + slack) * (end - float(np.mean(edges)))
    if flat:
        notes.append(f"the {word} flow is saturated from {curve.percent(full):.0f} % of the rated signal on")
    if end < 0.97 * curve.rated:
        told = f"the {word} side was driven to {curve.percent(end):.0f} % of the rated signal only"
        notes.append(f"{told}; its maximum flow is that of this signal")
    return Side(
        dead_zone=float(np.mean(edges)),
        dead_zone_uncertainty=float(np.max(spreads)) + 0.5 * (steps[0] + steps[1] * slope),
        opens_at=opens,
        closes_at=closes,
        gain=1.0 / slope,
        linearity_percent=100.0 * off / curve.rated,
        maximum_flow=top,
        largest_signal=end,
        saturates_at=full if flat else None,
    )


def _edge(branch: Monotone, sign: int, top: float) -> tuple[float, float]:
    """Where a branch's flow begins, counted away from zero, and its standard error from the scatter of the bins."""
    reach = np.linspace(*EDGE, 120)
    ends = np.sort(sign * branch.signal_at(sign * top * reach[[0, -1]]))
    away, flow = sign * branch.signal, sign * branch.flow
    use = (away >= ends[0]) & (away <= ends[1])
    if np.count_nonzero(use) < 4:  # few points: what lies between them is a straight line
        away, flow = sign * branch.signal_at(sign * top * reach), top * reach
        use, weight = np.ones(len(reach), dtype=bool), np.ones(len(reach))
    else:
        weight = np.sqrt(branch.count[use])
    x, q = away[use] - ends[0], flow[use] / top
    span = float(ends[1] - ends[0])
    if not np.ptp(x) > 1e-3 * span or span <= 0.0:  # a jump
        return float(ends[0]), span
    slope, start = np.polyfit(x, q, 1, w=weight)
    noise = branch.noise / top / np.sqrt(np.sum(weight**2)) / max(slope, 1e-12)
    root = ends[0] - start / slope
    if np.unique(np.round(x / span, 3)).size >= 6:
        # A parabola where the control edge is curved; its lower root, unless that lies nowhere near.
        a, b, c = np.polyfit(x, q, 2, w=weight)
        under = b * b - 4.0 * a * c
        divisor = b + np.sqrt(max(under, 0.0))
        if under >= 0.0 and divisor > 0.0 and -span <= (bent := -2.0 * c / divisor) <= span:
            return float(ends[0] + bent), float(4.0 * noise)
    return float(root), float(2.0 * noise)


def _hysteresis(curve: Curve, loop: Loop, sides: dict[int, Side | None]) -> dict[str, float]:
    """The loop where it is widest, with its uncertainty, and its mean width between 10 and 90 % of the flow."""
    if loop.rising is None or loop.falling is None:
        return {}
    widest, means = [], []
    levels = np.linspace(*WIDTH, 193)
    window = max(1, round(WINDOW / (levels[1] - levels[0])))
    kernel = np.ones(window) / window
    for sign, side in sides.items():
        if side is None:
            continue
        both = min(branch.largest(sign) for branch in loop.branches)
        flows = sign * both * levels
        # The first flow out of the noise: below it the dead zone's flat part is read, not the valve.
        use = levels > max(WIDTH[0], 10.0 * loop.bin_noise / side.maximum_flow)
        if np.count_nonzero(use) < window + 2:
            continue
        width = widths(loop.rising, loop.falling, flows[use])
        smooth = np.convolve(width, kernel, "valid")
        n = int(np.argmax(np.abs(smooth)))
        middle = _middle(loop, flows[use])
        inner = (levels[use] > 0.1) & (levels[use] < 0.9)
        if inner.any():
            means.append(float(np.mean(width[inner])))
        gain = float(np.ptp(flows[use]) / max(np.ptp(middle), 1e-300))
        near = max(1.0, float(np.median(loop.rising.count)) * max(1.0, WINDOW * len(loop.rising.count)))
        # The largest of some 50 windows stands further out than one of them: 2.8 instead of 2 standard errors.
        spread = 2.8 * np.sqrt(2.0) * loop.noise / np.sqrt(near) / gain
        widest.append((float(abs(smooth[n])), float(middle[n + window // 2]), spread))
    if not widest:
        return {}
    best, where, spread = max(widest, key=lambda each: each[0])
    around = np.abs(curve.signal - where) < 0.1 * curve.rated
    steepest = max(side.gain for side in sides.values() if side)
    spread += 0.5 * (resolution(curve.signal[around]) + resolution(curve.flow[around]) / steepest)
    found = {"widest_at": where, "hysteresis_percent": curve.percent(best)}
    found["hysteresis_uncertainty_percent"] = curve.percent(spread)
    return found | ({"mean_loop_percent": curve.percent(float(np.mean(means)))} if means else {})


def _threshold(
    curve: Curve, loop: Loop, sides: dict[int, Side | None], steps: tuple[float, float], notes: list[str]
) -> float | None:
    """Change of signal after a turn that the flow takes no notice of, percent of the rated signal."""
    if loop.rising is None or loop.falling is None:
        return None
    found = []
    for sign, leaving in ((1, loop.falling), (-1, loop.rising)):
        side = sides[sign]
        if side is None or side.saturates_at is not None or side.largest_signal < 0.5 * curve.rated:
            continue
        bin_noise = loop.noise / np.sqrt(np.median(leaving.count))
        step = 0.005 * side.maximum_flow
        if max(3.0 * bin_noise, steps[1]) > step or len(leaving.signal) < 100:
            continue
        full = leaving.largest(sign)
        left = sign * float(leaving.signal[-1 if sign > 0 else 0])
        gone = left - sign * float(leaving.signal_at(sign * (full - step)))
        found.append(max(0.0, gone - step / side.gain))
    if not found:
        notes.append("the threshold cannot be read off this sweep (saturated, noisy or coarse turns)")
        return None
    return 100.0 * float(np.mean(found)) / curve.rated


def _leakage(curve: Curve, loop: Loop, notes: list[str]) -> dict[str, Any]:
    """Figures of an internal leakage curve, by their names: its peak, its null, and the loop of its flanks."""
    notes.append("the flow peaks near the null: read as internal leakage, not as flow over signal")
    flanks = flanks_of(loop)
    null = float(np.mean([peak_of(*flank) for flank in flanks.values()]))
    found: dict[str, Any] = {"null": null}
    if len(flanks) == 2:
        rising, falling = flank_signals(*flanks[1]), flank_signals(*flanks[-1])
        wide = (rising - falling).ravel()
        n = int(np.argmax(np.abs(wide)))
        found["hysteresis_percent"] = curve.percent(float(abs(wide[n])))
        found["mean_loop_percent"] = curve.percent(float(np.mean(wide)))
        found["widest_at"] = float((rising + falling).ravel()[n] / 2.0)
    most, least = (float(np.mean([of(flow) for _, flow in flanks.values()])) for of in (np.max, np.min))
    return found | {"leakage": {"maximum": most, "least": least, "null": null}}
