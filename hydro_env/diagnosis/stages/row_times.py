"""When the rows of an unevenly spaced log were taken, and since when their commands act.

A command is held from its row on; but a row may be missing, or the recorder may run beside the controller, so that a command acts
since some time after the row before. And it may be the time stamps that are uneven, not the rows. What is right is judged by
regression: the model as given is simulated with each reading of the times, and the steps of its residual are compared with the
steps of the differences between these simulations. From row to row nothing else that is wrong in a model looks like them. Rows
of which the measurement is not known to its noise because of the times do not count.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.ndimage import maximum_filter1d

from ...measured import Finding
from ...measured.samples import standing_out
from ..estimation.estimate import Estimates, distinct
from ..estimation.noise import noise_floor
from ..input.parts import Part, timed
from ..models.base import Request, RigModel, Segment, Segments

#: A reading of the times is preferred to the one as logged if this share of its difference is in the residual: half, where all or
#: nothing of it is true, and of commands a whole row earlier half of that, where half a row is.
EVEN, AHEAD = 0.5, 0.25
#: Stamps that are off an even grid by less than this share of a step (RMS) are rounded only.
ROUNDED = 0.02
#: Rows that two readings put further apart than this share of the noise, which makes 1.1 of it, do not count, nor do those that
#: are so near to them, s: half a swing of 10 Hz.
APART, NEAR_S = 0.5, 0.05


def settled(rig: RigModel, parts: Sequence[Part]) -> list[Part]:
    """The parts of `rig`, those of uneven logs with their likeliest times, without measurements that depend too much on them."""
    if not rig.has_hidden_states or all(part.uneven is None for part in parts):
        return list(parts)

    def shown(lead: str, even: bool = False) -> list[np.ndarray]:
        return _simulated(rig, [_read(part, lead, even) for part in parts])[1]

    segments, logged = _simulated(rig, parts)
    offs = [part.log.late / part.log.period for part in parts if part.log.late is not None]
    even = any(np.sqrt(np.mean(off**2)) > ROUNDED for off in offs)
    readings = [shown("held", even=True)] if even else []
    ahead = shown("row")
    *by_stamps, by_commands = _shares(segments, logged, [*readings, ahead])
    lead, note, late, early = "half missing", "", None, logged
    if even and by_stamps[0] > EVEN:
        early, late = readings[0], shown("missing", even=True)
        note = "its time stamps are uneven, not its rows: these are taken as even"
    elif by_commands > AHEAD:
        lead, late = "half row", ahead
        note = "its commands act since before the rows that show them: taken as half a row earlier"
    apart = [b - a for a, b in zip(early, shown("missing") if late is None else late, strict=True)]
    found = []
    for number, part in enumerate(parts):
        if part.uneven is not None:
            own = [(s, change) for s, change in zip(segments, apart, strict=True) if s.log == number]
            part = _counted(_read(part, lead, early is not logged), own, note)
        found.append(part)
    return found


def without_outliers(rig: RigModel, calibrated: Estimates) -> tuple[RigModel, list[Finding]]:
    """The model without the rows in which a speed stands out of what the calibrated model leaves, and what to say of them.

    A shaft has inertia: what is missing from a model does not come and go within a row or two, far beyond the noise.
    """
    if not rig.has_hidden_states:
        return rig, []
    every = distinct(calibrated)
    shown = dict(zip(every, rig.predict([p.request() for p in every]), strict=True))
    segments, findings = {}, []
    for c in rig.channels:
        segments[c] = Segments(rig.segments[c])
        for n, s in enumerate(rig.segments[c]):
            known = np.flatnonzero(s.used)
            error = (s.filled - shown[calibrated[c]][c][s.place])[known]
            found = standing_out(error)[0] if s.signal == "speed" else []
            rows = [known[start:end] for start, end, height, nearby in found if height > nearby]
            if rows:
                inside = s.inside.copy()
                inside[np.concatenate(rows)] = False
                segments[c][n] = replace(s, inside=inside)
                message = (
                    f"{rig.parts[s.log].log.name}: {np.concatenate(rows).size} rows of the speed of channel {c + 1} stand out "
                    f"of the calibrated model, the first at {s.rows[rows[0][0]] * s.period / s.step:.6g} s"
                )
                hint = "no shaft moves so for a row or two; they do not count"
                findings.append(Finding("spikes", message, hint, "speed", c + 1))
    return (rig.view(segments=segments) if findings else rig), findings


def _shares(segments: list[Segment], logged: list[np.ndarray], others: list[list[np.ndarray]]) -> np.ndarray:
    """The shares of the differences of `others` from `logged` that the residual of `logged` holds, by least squares of the steps
    from row to row."""
    matrix, side = np.zeros((len(others), len(others))), np.zeros(len(others))
    for s, now, *readings in zip(segments, logged, *others, strict=True):
        both = s.used[1:] & s.used[:-1]
        residual = np.diff(s.filled - now)[both]
        columns = np.column_stack([np.diff(reading - now)[both] for reading in readings])
        size = max(1.5 * float(np.median(np.abs(residual))), 1e-12) if residual.size else np.inf
        matrix += columns.T @ columns / size**2
        side += columns.T @ residual / size**2
    return np.linalg.lstsq(matrix, side)[0]


def _counted(part: Part, apart: Sequence[tuple[Segment, np.ndarray]], note: str) -> Part:
    """The part without the measurements (NaN) that two readings of the times put `apart` by more than their noise."""
    log, lost = part.log, 0.0
    for s, difference in apart:
        if s.signal not in vars(log):  # made of other signals
            continue
        # What swings passes zero on its way: the largest difference nearby tells.
        near = maximum_filter1d(np.abs(difference), 2 * max(1, round(NEAR_S / s.period)) + 1)
        far = near > APART * noise_floor(s.measured, s.used, s.period)
        values = getattr(log, s.signal).copy()
        values[far, s.channel] = np.nan
        log = replace(log, **{s.signal: values})
        lost = max(lost, float(np.mean(far)))
    notes = [note] if note else []
    if lost > 0.005:
        notes.append(f"up to {lost:.0%} of the rows do not count, as it is unknown since when commands act")
    said = f"{part.log.name}: {'; '.join(notes)}" if notes else ""
    return replace(part, log=log, note="; ".join(filter(None, (part.note, said))))


def _read(part: Part, lead: str, even: bool) -> Part:
    """The part with commands that begin as late as they may ("held"), a "row" or "half row" earlier, or, where rows are
    "missing", with the first of these or half as early ("half missing")."""
    if part.uneven is None:
        return part
    log = part.uneven
    steps = np.diff(np.round((log.time_s - part.log.time_s[0]) / log.period), prepend=-1.0)
    # The command before missing rows is held for one step at least.
    missing = np.maximum(1.0 - 1.0 / np.maximum(steps, 1.0), 0.0)
    missing[0] = 0.0
    leads = {"held": 0.0, "row": 1.0, "half row": 0.5, "missing": missing, "half missing": 0.5 * missing}
    return timed(part, leads[lead], even)


def _simulated(rig: RigModel, parts: Sequence[Part]) -> tuple[list[Segment], list[np.ndarray]]:
    """All segments, of every row, and what the model as given shows there."""
    other = rig.with_parts(list(parts), True)
    shown = other.predict([Request(c, {}) for c in rig.channels])
    segments = [s for c in rig.channels for s in other.segments[c]]
    return segments, [shown[rig.channels.index(s.channel)][s.channel][s.place] for s in segments]
