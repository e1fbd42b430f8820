"""Do the logs fit the model at all? Signs, units and exchanged sensors that only a model can show.

The model as given is simulated anyway. A signal that is its mirror image, a tenth or a hundred of it, or the other channel's
is no missing effect but a mistake in the recording (or a model of another machine); what a diagnosis named then would be
wrong. Where pressure and speed are logged the shaft says more: it ties them together whatever the valve does. The gate of
`hydro_env.measured` has looked before at what needs no model.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from dataclasses import replace

import numpy as np

from ...errors import InputError
from ...measured import Finding
from ...units import BAR, UNITS
from ..input.parts import filled
from ..models.base import LEVEL_FREE, RigModel
from ..models.shaft import shaft_speed
from ..state import Estimates, State
from .calibration import fit_as_given
from .instruments import eccentric, runs_apart

__all__ = ["implausible", "run", "stop_if_sure"]

#: Units in which a signal is really recorded.
_UNITS = {
    "speed": ("rpm", "rad/s", "deg/s"), "pressure": ("bar", "kPa", "Pa", "MPa", "psi"), "current": ("A", "mA"),
    "spool": ("mm", "um", "m"), "flow": ("l/min", "l/s", "m3/s", "GPM"),
}  # fmt: skip
#: A ratio this near to one of a unit (factor) is no accident; within the wider factor it is worth a warning.
_SURE, _NEAR = 1.3, 1.7
#: A shaft that fits to this is no accident (see `_misfit`).
_FITS = 0.6
#: A missing effect changes a signal by less than this factor.
_EFFECTS = 3.0
#: A command may be above the rated one by an offset and by noise.
_BEYOND = 1.05
#: A supply pressure that is further off than this factor is worth a warning.
_SUPPLY = 1.2
_HINT = "give the right unit in a mapping, or a model of this machine"
#: A signal belongs to the channel whose model leaves this much less of it, ...
_LESS = 4.0


def run(state: State) -> State:
    """Simulates the model as given; InputError if the logs are surely not of this machine. The noise is first estimated here."""
    rig = state.rig
    fit, given = fit_as_given(rig, state.settings)
    findings = implausible(rig, given)
    stop_if_sure(findings, ", ".join(p.label for p in rig.parts), state.accept)
    if rig.has_hidden_states:
        beyond = _beyond_rated(state.held_out)
        stop_if_sure(list(beyond), ", ".join(p.label for p in state.held_out.parts), state.accept)
    return replace(state, given=given, findings=findings, fit=fit)


def implausible(rig: RigModel, given: Estimates) -> list[Finding]:
    """Findings about the logs of `rig` beside the model as given."""
    if not rig.has_hidden_states:  # the steady-valve model takes its scale from the log
        return []
    found: list[Finding] = []
    likes: dict[tuple[str, int], tuple[float, float]] = {}
    for channel in rig.channels:
        for signal in _compared(rig, channel):
            measured, simulated = _pair(rig, given, channel, channel, signal)
            if measured.size < 100 or not (np.std(measured) > 0.0 and np.std(simulated) > 0.0):
                continue
            like = float(np.corrcoef(measured, simulated)[0, 1])
            ratio = float(np.sqrt(np.mean(measured**2) / np.mean(simulated**2)))
            likes[signal, channel] = like, ratio
            if like < -0.5:
                message = f"the {signal} of channel {channel + 1} is the mirror image of the model's (correlation {like:.2f})"
                hint = f"give `sign: -1` for the {signal} in a mapping"
                found.append(Finding("sign", message, hint, signal, channel + 1, sure=like < -0.8))
    found += _units(rig, likes)
    found += _load(rig)
    found += _supply(rig)
    found += [*_command(rig, given)] or [*_beyond_rated(rig)]
    if rig.channels == (0, 1):
        found += _exchanged(rig, given)
    return [*found, *eccentric(rig), *runs_apart(rig, given)]


def _compared(rig: RigModel, channel: int) -> list[str]:
    """The signals of a channel that are compared in size and sign."""
    return [s for s in dict.fromkeys(s.signal for s in rig.segments[channel]) if s not in LEVEL_FREE]


def _supply(rig: RigModel) -> Iterator[Finding]:
    """A supply pressure of the model that the two lines do not have: they stand about half of it, and drain but never fill."""
    for channel in rig.channels:
        given = rig.given("pressure_dependent_flow.supply_pressure", channel)
        sums = [2.0 * s.measured[s.used] for s in rig.segments[channel] if s.signal == "mean_line_pressure"]
        if not sums or not np.isfinite(given):
            continue
        seen = float(np.quantile(np.concatenate(sums), 0.9))
        if not 1.0 / _SUPPLY < seen / given < _SUPPLY:
            message = (
                f"the pressures of both lines of channel {channel + 1} make {seen / BAR:.0f} bar together, the supply; "
                f"the model has {given / BAR:.0f} bar"
            )
            hint = "give `pressure_dependent_flow.supply_pressure` of this rig in the model"
            yield Finding("supply", message, hint, "pressure", channel + 1)


def _load(rig: RigModel) -> Iterator[Finding]:
    """Loads of the other sign, and loads that do not act: the shaft then fits with the mirrored load, or with none, and not
    with the one as logged."""
    for channel in rig.channels:
        own, mirrored = (_unlike(_shaft(rig, channel, channel, load_scale=sign)) for sign in (1.0, -1.0))
        logged, without = (_error(rig, channel, load_scale=scale) for scale in (1.0, 0.0))
        if logged > max(_LESS * without, 1.0):
            peak = max(
                float(np.nanmax(np.abs(p.log.load[:, channel]))) for p in rig.parts if p.log.load is not None
            )
            message = (
                f"the shaft of channel {channel + 1} turns as if the load that is logged (up to {peak:.4g} N m) did not act: "
                f"with it the speed from pressure and load is off by {logged:.2g} times its swing, without it by {without:.2g}; "
                "is the load sensor stuck or at its limit, its zero off, or its unit another?"
            )
            yield Finding("load", message, "correct or leave out the load", "load", channel + 1, sure=True)
        if own > _LESS * max(mirrored, 1e-3) and mirrored < 0.1:
            message = (
                f"the shaft of channel {channel + 1} turns as if its load had the other sign (correlation {1.0 - mirrored:.3f} "
                f"that way, {1.0 - own:.3f} as logged)"
            )
            hint = (
                "a load is positive where it brakes positive speed; give `sign: -1` for the load in a mapping"
            )
            yield Finding("sign", message, hint, "load", channel + 1, sure=True)


def _units(rig: RigModel, likes: dict[tuple[str, int], tuple[float, float]]) -> Iterator[Finding]:
    """Signals whose size is off by the factor between two units."""
    for channel in rig.channels:
        # Pressures with many holes give no shaft; then the model of each signal is all there is.
        both = {"speed", "pressure"} <= {signal for signal, c in likes if c == channel}
        tied = both and _shaft(rig, channel, channel) is not None
        if tied:
            yield from _tied_units(rig, channel, likes)
        for signal in _UNITS:
            if (signal, channel) not in likes or (tied and signal in ("speed", "pressure")):
                continue
            like, ratio = likes[signal, channel]
            factors = _factors(rig, signal, channel)
            meant = min(factors, key=lambda unit: abs(math.log(ratio / factors[unit])))
            off = math.exp(abs(math.log(ratio / factors[meant])))
            if off < _NEAR and abs(like) > 0.7:
                yield _unit(rig, signal, channel, ratio, meant, off < _SURE and abs(like) > 0.85)


def _tied_units(
    rig: RigModel, channel: int, likes: dict[tuple[str, int], tuple[float, float]]
) -> Iterator[Finding]:
    """Speed or pressure in another unit: what the shaft makes of the two, each taken in every unit that it may be in.

    Without a load the shaft cannot say which of the two is off; the valve's model then does, roughly. Where no unit fits it is
    a warning only: a missing drag can be several times the friction that the model has.
    """
    best: tuple[float, str, str] | None = None
    plain = _misfit(_shaft(rig, channel, channel))
    for signal, other in (("speed", "pressure"), ("pressure", "speed")):
        for unit, factor in _factors(rig, signal, channel).items():
            beside = likes[signal, channel][1] / factor
            if not (
                1.0 / _EFFECTS < beside < _EFFECTS and 1.0 / _EFFECTS < likes[other, channel][1] < _EFFECTS
            ):
                continue
            fast, pressing = (1.0 / factor, 1.0) if signal == "speed" else (1.0, 1.0 / factor)
            misfit = _misfit(_shaft(rig, channel, channel, speed_scale=fast, pressure_scale=pressing))
            if best is None or misfit < best[0]:
                best = misfit, signal, unit
    if best is not None and best[0] < _FITS and plain > best[0] + 1.0:
        yield _unit(rig, best[1], channel, likes[best[1], channel][1], best[2], True)
        return
    shaft = _shaft(rig, channel, channel)
    if shaft is not None and shaft[0] > 0.9 and not 1.0 / _EFFECTS < shaft[1] < _EFFECTS:
        message = (
            f"the speed of channel {channel + 1} is {shaft[1]:.3g} times what its pressure and load give to the shaft: "
            "a large loss that the model lacks, or is one of them in another unit?"
        )
        yield Finding("unit", message, _HINT, "speed", channel + 1)


def _factors(rig: RigModel, signal: str, channel: int) -> dict[str, float]:
    """How many times too large a signal is read that is recorded in each of the other units."""
    read = rig.parts[0].log.read_as.get(f"{signal}_{channel + 1}", ("", _UNITS[signal][0]))[1]
    size = UNITS[read].scale
    return {other: size / UNITS[other].scale for other in _UNITS[signal] if other != read}


def _unit(rig: RigModel, signal: str, channel: int, ratio: float, meant: str, sure: bool) -> Finding:
    column, unit = rig.parts[0].log.read_as.get(f"{signal}_{channel + 1}", ("", ""))
    what = f"{column!r} (read as {unit})" if column else f"the {signal} of channel {channel + 1}"
    message = f"{what} is {ratio:.3g} times the model's {signal} of channel {channel + 1}: is it in {meant}?"
    fix = {f"channel_{channel + 1}": {signal: {"unit": meant}}}
    return Finding("unit", message, _HINT, signal, channel + 1, sure=sure, fix=fix)


def _misfit(shaft: tuple[float, float] | None) -> float:
    """How far correlation and ratio of sizes are from one."""
    return math.inf if shaft is None else abs(math.log(shaft[1])) + 2.0 * (1.0 - shaft[0])


def _command(rig: RigModel, given: Estimates) -> Iterator[Finding]:
    """Commands in percent or as a fraction of full command, called volts: then every current is off by the same factor."""
    ratios, rated, peak = [], 1.0, 0.0
    for channel in rig.channels:
        rated = rig.model.value("u_rated", channel)
        measured, simulated = [np.zeros(0)], [np.zeros(0)]
        for s in (s for s in rig.segments[channel] if s.signal == "current"):
            command = np.abs(rig.parts[s.log].log.command_V[s.rows, channel])
            peak = max(peak, float(command.max(initial=0.0)))
            values = given[channel].simulated[channel][s.place]
            keep = (
                s.used & np.isfinite(values) & (command < 0.95 * rated)
            )  # beyond that the model's is limited
            measured.append(s.measured[keep])
            simulated.append(values[keep])
        one, two = np.concatenate(measured), np.concatenate(simulated)
        if one.size < 100 or not float(two @ two) > 0.0 or np.corrcoef(one, two)[0, 1] < 0.95:
            return
        ratios.append(float(one @ two) / float(two @ two))
    for meant, full, near in (("percent", 100.0, 1.05), ("a fraction of full command", 1.0, 1.5)):
        factor = rated / full
        hit = all(math.exp(abs(math.log(max(r, 1e-9) / factor))) < near for r in ratios)
        if ratios and hit and abs(math.log(factor)) > math.log(1.2) and peak < 1.05 * full:
            message = f"the currents are {ratios[0]:.3g} times what the commands give: are these in {meant}?"
            hint = "give `unit: percent` or `unit: fraction` and `full_scale` for the commands in a mapping"
            yield Finding("unit", message, hint, "command", sure=True)


def _beyond_rated(rig: RigModel) -> Iterator[Finding]:
    """Commands that the model's valve cannot be given: they are in another unit, or the model is of another valve."""
    for channel in rig.channels:
        rated = rig.model.value("u_rated", channel)
        peak = max(float(np.nanmax(np.abs(p.log.command_V[:, channel]), initial=0.0)) for p in rig.parts)
        if peak > _BEYOND * rated:
            column = rig.parts[0].log.read_as.get(f"command_{channel + 1}", ("", ""))[0]
            what = f"{column!r}" if column else f"the command of channel {channel + 1}"
            message = (
                f"{what} reaches {peak:.4g} V, the model's valve is full open at {rated:.4g} V (`u_rated`)"
            )
            if peak <= 1.05 * 100.0:
                message += ": is it in percent?"
            hint = "give `unit: percent` and `full_scale` for the commands in a mapping, or the right `u_rated` in the model"
            yield Finding("unit", message, hint, "command", channel + 1, sure=True)


def _exchanged(rig: RigModel, given: Estimates) -> Iterator[Finding]:
    """Signals that belong to the other channel."""
    signals = [s for s in _compared(rig, 0) if s in _compared(rig, 1)]
    if {"speed", "pressure"} <= {*signals}:
        wrong = _shafts_exchanged(rig)
        if wrong:
            message = f"the pressure of each channel drives the shaft of the other one: are the columns of {wrong} swapped?"
            yield Finding("swapped", message, f"exchange the columns of {wrong} in a mapping", sure=True)
            return
    for signal in signals:
        likes = {}
        for own in (0, 1):
            for other in (0, 1):
                measured, simulated = _pair(rig, given, own, other, signal)
                if measured.size < 100 or not (np.std(measured) > 0.0 and np.std(simulated) > 0.0):
                    return
                likes[own, other] = float(np.corrcoef(measured, simulated)[0, 1])
        apart = min(likes[0, 1], likes[1, 0]) - max(likes[0, 0], likes[1, 1])
        # The coil hardly depends on what is missing elsewhere, so that much smaller differences count there.
        coil = signal == "current" and all(
            1.0 - likes[c, c] > _LESS * max(1.0 - likes[c, 1 - c], 1e-4) for c in (0, 1)
        )
        if apart > 0.2 or coil:
            message = (
                f"the {signal} of each channel is like the model's of the other channel: are they swapped?"
            )
            hint = f"exchange the {signal} columns in a mapping"
            yield Finding("swapped", message, hint, signal, sure=apart > 0.4 or coil)


def _shafts_exchanged(rig: RigModel) -> str:
    """What is swapped if the pressure of each channel fits the other one's shaft and not its own, or nothing.

    The load stays with the motor whose column it is in: it distinguishes exchanged speeds from exchanged pressures.
    """
    own = [_unlike(_shaft(rig, c, c)) for c in (0, 1)]
    best, what = math.inf, ""
    for name, loads in (("speed", (0, 1)), ("pressure", (1, 0))):
        crossed = [_unlike(_shaft(rig, c, 1 - c, load_of=loads[c])) for c in (0, 1)]
        if (
            all(own[c] > _LESS * max(crossed[c], 1e-3) and crossed[c] < 0.1 for c in (0, 1))
            and max(crossed) <= best
        ):
            tie = math.isfinite(best) and max(crossed) > 0.8 * best
            best, what = max(crossed), "speed or of pressure" if tie else name
    return what


def _unlike(shaft: tuple[float, float] | None) -> float:
    """One less the correlation; 2 where there is none."""
    return 2.0 if shaft is None else 1.0 - shaft[0]


def _shaft(
    rig: RigModel, pressing: int, turning: int, *, load_of: int | None = None, load_scale: float = 1.0,
    speed_scale: float = 1.0, pressure_scale: float = 1.0,
) -> tuple[float, float] | None:  # fmt: skip
    """The speed of channel `turning` beside the one that the measured pressure of channel `pressing` gives to the shaft:
    correlation and ratio of their sizes; None where they are not logged. All may be scaled before; the load is that of
    channel `load_of`, of `turning` if None."""
    loaded = turning if load_of is None else load_of
    both = _replayed(rig, pressing, turning, loaded, load_scale, pressure_scale)
    if both is None:
        return None
    one, two = speed_scale * both[0], both[1]
    if one.size < 100 or not (np.std(one) > 0.0 and np.std(two) > 0.0):
        return None
    return float(np.corrcoef(one, two)[0, 1]), float(np.std(one) / np.std(two))


def _error(rig: RigModel, channel: int, load_scale: float) -> float:
    """How far the speed of a channel is from the one that its pressure and its load, scaled, give to the shaft: the RMS in
    times the standard deviation of the speed; 0 where it cannot be said."""
    both = _replayed(rig, channel, channel, channel, load_scale)
    if both is None or both[0].size < 100 or not np.std(both[0]) > 0.0:
        return 0.0
    return float(np.sqrt(np.mean((both[0] - both[1]) ** 2)) / np.std(both[0]))


def _replayed(
    rig: RigModel, pressing: int, turning: int, loaded: int, load_scale: float, pressure_scale: float = 1.0
) -> tuple[np.ndarray, np.ndarray] | None:
    """The measured speed of channel `turning` (n,), and what the pressure of `pressing` and the load of `loaded` give (n,)."""
    measured, replayed = [], []
    names = {"displacement": "D", "inertia": "J", "friction": "B"}
    shaft = {key: rig.model.value(name, pressing) for key, name in names.items()}
    for part in rig.parts:
        log = part.log
        if log.pressure is None or not (log.has("pressure", pressing) and log.has("speed", turning)):
            return None
        pressure, speed = pressure_scale * log.pressure[:, pressing], log.speed[:, turning]
        if np.isfinite(pressure).mean() < 0.9:
            return None
        load = np.zeros(len(log))
        if log.load is not None and log.has("load", loaded):
            load = load_scale * np.nan_to_num(log.load[:, loaded])
        used = part.inside & np.isfinite(speed)
        measured.append(speed[used])
        replayed.append(shaft_speed(filled(pressure), load, log.period, **shaft)[used])
    return np.concatenate(measured), np.concatenate(replayed)


def _pair(
    rig: RigModel, given: Estimates, own: int, other: int, signal: str
) -> tuple[np.ndarray, np.ndarray]:
    """Measured samples of channel `own` and the model's of channel `other`, over all logs."""
    measured, simulated = [], []
    by_log = {s.log: s for s in rig.segments[other] if s.signal == signal}
    for mine in rig.segments[own]:
        if mine.signal == signal and mine.log in by_log:
            values = given[other].simulated[other][by_log[mine.log].place]
            keep = mine.used & np.isfinite(values)
            measured.append(mine.measured[keep])
            simulated.append(values[keep])
    return np.concatenate(measured or [np.zeros(0)]), np.concatenate(simulated or [np.zeros(0)])


def stop_if_sure(findings: list[Finding], logs: str, accept: Collection[str]) -> None:
    """InputError for the first finding that is sure and not accepted."""
    for finding in findings:
        if finding.sure and finding.code not in accept:
            raise InputError(f"{logs}: {finding.text}; if it is right, --accept {finding.code}")
