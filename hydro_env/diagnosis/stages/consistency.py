"""Do the logs fit the model at all? Signs, units and exchanged sensors that only a model can show.

The model as given is simulated anyway. A signal that is its mirror image, a tenth or a hundred of it, or the other channel's
is no missing effect but a mistake in the recording (or a model of another machine); what a diagnosis named then would be
wrong. Where pressure and speed are logged the shaft says more: it ties them together whatever the valve does. The gate of
`hydro_env.measured` has looked before at what needs no model.
"""

import math
from collections.abc import Collection, Iterator
from dataclasses import replace

import numpy as np

from ...errors import InputError
from ...measured import Finding
from ...units import BAR, UNITS
from ..estimation.estimate import Estimates
from ..estimation.fit import noise_of
from ..logs import Logs
from ..models.base import LEVEL_FREE, RigModel
from .calibration import as_given
from .instruments import eccentric, runs_apart
from .shaft import given_shaft, shaft_of

#: Units in which a signal is really recorded.
_UNITS = {
    "speed": ("rpm", "rad/s", "deg/s"), "pressure": ("bar", "kPa", "Pa", "MPa", "psi"), "current": ("A", "mA"),
    "spool": ("mm", "um", "m"), "flow": ("l/min", "l/s", "m3/s", "GPM"),
}  # fmt: skip
#: A signal may be this factor larger or smaller than that of the model as given: plausible base parameters make two of it (`Kq`
#: lies between 0.5 and 1.25 times its value), an effect may make the rest.
_EFFECTS = 3.0
#: A ratio this near to that of two units is no accident; within the wider factor it is worth a warning. That is the square root
#: of `_EFFECTS`: what is nearer to 1 than that may be the rig.
_SURE, _NEAR = 1.3, 1.7
#: A shaft that fits to this is no accident (see `_misfit`): about the logarithm of `_NEAR`.
_FITS = 0.6
#: A command may be above the rated one by an offset and by noise, a percent or two each.
_BEYOND = 1.05
#: A supply pressure that is further off than this factor is worth a warning: gauges and settings agree to a tenth.
_SUPPLY = 1.2
#: One reading leaves this many times less variance of a signal than another: no chance from 15 independent samples on (F-test at
#: 1 %).
_LESS = 4.0
#: Fewest rows that are compared.
_ROWS = 100
#: Correlation and ratio of sizes of a signal and the model's, by signal and channel.
Likes = dict[tuple[str, int], tuple[float, float]]
_HINT = "give the right unit in a mapping, or a model of this machine"


def run(logs: Logs, accept: Collection[str] = ()) -> tuple[Logs, Estimates, list[Finding]]:
    """The model as given beside the logs, with the noise that it shows, and findings about these. InputError if the logs are
    surely not of this machine."""
    rig = logs.rig
    unknown = {(c, s.signal): 1e-9 for c in rig.channels for s in rig.segments[c]}
    given = as_given(replace(logs.fit, noise=unknown))
    fit = replace(logs.fit, noise=noise_of(rig, given))
    findings = implausible(rig, given)
    _stop_if_sure(findings, rig, accept)
    if rig.has_hidden_states:
        _stop_if_sure(list(_beyond_rated(logs.held_out)), logs.held_out, accept)
    return replace(logs, fit=fit), given, findings


def _stop_if_sure(findings: list[Finding], rig: RigModel, accept: Collection[str]) -> None:
    """InputError for the first finding about the logs of `rig` that is sure and not accepted."""
    for finding in findings:
        if finding.sure and finding.code not in accept:
            logs = ", ".join(p.label for p in rig.parts)
            raise InputError(f"{logs}: {finding.text}; if it is right, --accept {finding.code}")


def implausible(rig: RigModel, given: Estimates) -> list[Finding]:
    """Findings about the logs of `rig` beside the model as given."""
    if not rig.has_hidden_states:  # the steady-valve model takes its scale from the log
        return []
    found: list[Finding] = []
    likes: Likes = {}
    for channel in rig.channels:
        for signal in _compared(rig, channel):
            like = likes[signal, channel] = _alike(_pair(rig, given, channel, channel, signal))
            if like[0] < -0.5:
                message = f"the {signal} of channel {channel + 1} is the mirror image of the model's (correlation {like[0]:.2f})"
                hint = f"give `sign: -1` for the {signal} in a mapping"
                found.append(Finding("sign", message, hint, signal, channel + 1, sure=like[0] < -0.8))
    found += [*_units(rig, likes), *_load(rig), *_supply(rig)]
    found += [*_command(rig, given)] or [*_beyond_rated(rig)]
    if rig.channels == (0, 1):
        found += _exchanged(rig, given)
    return [*found, *eccentric(rig), *runs_apart(rig, given)]


def _compared(rig: RigModel, channel: int) -> list[str]:
    """The signals of a channel that are compared in size and sign."""
    return [s for s in rig.segments[channel].by_signal if s not in LEVEL_FREE]


def _pair(rig: RigModel, given: Estimates, own: int, other: int, signal: str) -> np.ndarray:
    """Measured samples of channel `own` and the model's of channel `other` (2, n), over all logs."""
    both = [np.zeros((2, 0))]
    by_log = {s.log: s for s in rig.segments[other].by_signal.get(signal, ())}
    for mine in rig.segments[own].by_signal.get(signal, ()):
        if mine.log in by_log:
            values = given[other].simulated[other][by_log[mine.log].place]
            both.append(np.array([mine.measured, values])[:, mine.used & np.isfinite(values)])
    return np.concatenate(both, axis=1)


def _alike(both: np.ndarray) -> tuple[float, float]:
    """Correlation and ratio of sizes of two signals (2, n); NaN, which no comparison holds for, where nothing is to compare."""
    one, two = both
    if one.size < _ROWS or not (np.std(one) > 0.0 and np.std(two) > 0.0):
        return math.nan, math.nan
    return float(np.corrcoef(one, two)[0, 1]), float(np.std(one) / np.std(two))


def _turned(
    rig: RigModel, turning: int, pressing: int | None = None, loaded: int | None = None, load_scale: float = 1.0,
    pressure_scale: float = 1.0,
) -> np.ndarray:  # fmt: skip
    """The measured speed of a channel over all logs, and what pressure and load, scaled, give to its shaft (2, n), see
    `shaft_of`; no samples where they are not logged."""
    both, values = [np.zeros((2, 0))], given_shaft(rig, turning if pressing is None else pressing)
    for shaft in filter(None, (shaft_of(part, turning, pressing, loaded) for part in rig.parts)):
        shaft = replace(shaft, pressure=pressure_scale * shaft.pressure, load=load_scale * shaft.load)
        both.append(np.array([shaft.speed, shaft.driven(values)])[:, shaft.used])
    return np.concatenate(both, axis=1)


def _unlike(both: np.ndarray) -> float:
    """One less the correlation."""
    return 1.0 - _alike(both)[0]


def _misfit(both: np.ndarray) -> float:
    """How far correlation and ratio of sizes are from one."""
    correlation, ratio = _alike(both)
    return abs(math.log(ratio)) + 2.0 * (1.0 - correlation)


# --- sizes and signs ------------------------------------------------------------------------------------------------------
def _supply(rig: RigModel) -> Iterator[Finding]:
    """A supply pressure of the model that the two lines do not have: they stand about half of it, and drain but never fill."""
    for channel in rig.channels:
        given = rig.given("pressure_dependent_flow.supply_pressure", channel)
        own = rig.segments[channel].by_signal.get("mean_line_pressure", ())
        sums = [2.0 * s.measured[s.used] for s in own]
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
        logged, without, mirrored = (_turned(rig, channel, load_scale=scale) for scale in (1.0, 0.0, -1.0))
        if logged[0].size < _ROWS or not np.std(logged[0]) > 0.0:
            continue
        off, free = (np.sqrt(np.mean((one - two) ** 2)) / np.std(one) for one, two in (logged, without))
        if off > max(_LESS * free, 1.0):
            loads = [p.log.load[:, channel] for p in rig.parts if p.log.load is not None]
            message = (
                f"the shaft of channel {channel + 1} turns as if the load that is logged (up to "
                f"{max(float(np.nanmax(np.abs(load))) for load in loads):.4g} N m) did not act: "
                f"with it the speed from pressure and load is off by {off:.2g} times its swing, without it by {free:.2g}; "
                "is the load sensor stuck or at its limit, its zero off, or its unit another?"
            )
            yield Finding("load", message, "correct or leave out the load", "load", channel + 1, sure=True)
        this_way, that_way = _unlike(logged), _unlike(mirrored)
        hint = "a load is positive where it brakes positive speed; give `sign: -1` for the load in a mapping"
        if this_way > _LESS * max(that_way, 1e-3) and that_way < 0.1:
            message = (
                f"the shaft of channel {channel + 1} turns as if its load had the other sign (correlation "
                f"{1.0 - that_way:.3f} that way, {1.0 - this_way:.3f} as logged)"
            )
            yield Finding("sign", message, hint, "load", channel + 1, sure=True)


def _units(rig: RigModel, likes: Likes) -> Iterator[Finding]:
    """Signals whose size is off by the factor between two units."""
    for channel in rig.channels:
        # Pressures with many holes give no shaft; then the model of each signal is all there is.
        logged = _turned(rig, channel).size > 0
        tied = logged and np.isfinite([likes[s, channel] for s in ("speed", "pressure")]).all()
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


def _tied_units(rig: RigModel, channel: int, likes: Likes) -> Iterator[Finding]:
    """Speed or pressure in another unit: what the shaft makes of the two, each taken in every unit that it may be in.

    Without a load the shaft cannot say which of the two is off; the valve's model then does, roughly. Where no unit fits it is
    a warning only: a missing drag can be several times the friction that the model has.
    """
    tries = []
    for signal, other in (("speed", "pressure"), ("pressure", "speed")):
        for unit, factor in _factors(rig, signal, channel).items():
            sizes = likes[signal, channel][1] / factor, likes[other, channel][1]
            if all(1.0 / _EFFECTS < size < _EFFECTS for size in sizes):
                both = _turned(rig, channel, pressure_scale=1.0 / factor if signal == "pressure" else 1.0)
                tries.append((_misfit(both / [[factor if signal == "speed" else 1.0], [1.0]]), signal, unit))
    plain = _turned(rig, channel)
    misfit, signal, unit = min(tries, default=(math.inf, "", ""))
    if misfit < _FITS and _misfit(plain) > misfit + 1.0:
        yield _unit(rig, signal, channel, likes[signal, channel][1], unit, True)
        return
    like = _alike(plain)
    if like[0] > 0.9 and not 1.0 / _EFFECTS < like[1] < _EFFECTS:
        message = (
            f"the speed of channel {channel + 1} is {like[1]:.3g} times what its pressure and load give to the shaft: "
            "a large loss that the model lacks, or is one of them in another unit?"
        )
        yield Finding("unit", message, _HINT, "speed", channel + 1)


def _factors(rig: RigModel, signal: str, channel: int) -> dict[str, float]:
    """How many times too large a signal is read that is recorded in each of the other units."""
    read = rig.parts[0].log.read_as.get(f"{signal}_{channel + 1}", ("", _UNITS[signal][0]))[1]
    return {unit: UNITS[read].scale / UNITS[unit].scale for unit in _UNITS[signal] if unit != read}


def _unit(rig: RigModel, signal: str, channel: int, ratio: float, meant: str, sure: bool) -> Finding:
    column, unit = rig.parts[0].log.read_as.get(f"{signal}_{channel + 1}", ("", ""))
    what = f"{column!r} (read as {unit})" if column else f"the {signal} of channel {channel + 1}"
    message = f"{what} is {ratio:.3g} times the model's {signal} of channel {channel + 1}: is it in {meant}?"
    fix = {f"channel_{channel + 1}": {signal: {"unit": meant}}}
    return Finding("unit", message, _HINT, signal, channel + 1, sure=sure, fix=fix)


# --- commands -------------------------------------------------------------------------------------------------------------
def _command(rig: RigModel, given: Estimates) -> Iterator[Finding]:
    """Commands in percent or as a fraction of full command, called volts: then every current is off by the same factor."""
    ratios = []
    for channel in rig.channels:
        measured, simulated = both = _pair(rig, given, channel, channel, "current")
        if not _alike(both)[0] >= 0.95:
            return
        # The model's current is limited where the command is.
        low = np.abs(simulated) < 0.9 * np.max(np.abs(simulated))
        ratios.append(np.linalg.lstsq(simulated[low, None], measured[low])[0].item())
    rated, peak = rig.model.value("u_rated", rig.channels[-1]), max(_peak(rig, c) for c in rig.channels)
    for meant, full, near in (("percent", 100.0, 1.05), ("a fraction of full command", 1.0, 1.5)):
        factor = rated / full
        hit = all(math.exp(abs(math.log(max(r, 1e-9) / factor))) < near for r in ratios)
        if hit and abs(math.log(factor)) > math.log(1.2) and peak < 1.05 * full:
            message = f"the currents are {ratios[0]:.3g} times what the commands give: are these in {meant}?"
            hint = "give `unit: percent` or `unit: fraction` and `full_scale` for the commands in a mapping"
            yield Finding("unit", message, hint, "command", sure=True)


def _peak(rig: RigModel, channel: int) -> float:
    """The largest command of a channel, V."""
    return max(float(np.nanmax(np.abs(p.log.command_V[:, channel]), initial=0.0)) for p in rig.parts)


def _beyond_rated(rig: RigModel) -> Iterator[Finding]:
    """Commands that the model's valve cannot be given: they are in another unit, or the model is of another valve."""
    for channel in rig.channels:
        rated, peak = rig.model.value("u_rated", channel), _peak(rig, channel)
        if peak > _BEYOND * rated:
            column = rig.parts[0].log.read_as.get(f"command_{channel + 1}", ("", ""))[0]
            what = f"{column!r}" if column else f"the command of channel {channel + 1}"
            percent = ": is it in percent?" if peak <= 100.0 * _BEYOND else ""
            message = f"{what} reaches {peak:.4g} V, the model's valve is full open at {rated:.4g} V (`u_rated`){percent}"
            hint = "give `unit: percent` and `full_scale` for the commands in a mapping, or the right `u_rated` in the model"
            yield Finding("unit", message, hint, "command", channel + 1, sure=True)


# --- exchanged sensors ----------------------------------------------------------------------------------------------------
def _exchanged(rig: RigModel, given: Estimates) -> Iterator[Finding]:
    """Signals that belong to the other channel."""
    signals = [s for s in _compared(rig, 0) if s in _compared(rig, 1)]
    if {"speed", "pressure"} <= {*signals} and (wrong := _shafts_exchanged(rig)):
        message = f"the pressure of each channel drives the shaft of the other one: are the columns of {wrong} swapped?"
        yield Finding("swapped", message, f"exchange the columns of {wrong} in a mapping", sure=True)
        return
    for signal in signals:
        like = {(c, o): _alike(_pair(rig, given, c, o, signal))[0] for c in (0, 1) for o in (0, 1)}
        if not np.isfinite([*like.values()]).all():
            return
        apart = min(like[0, 1], like[1, 0]) - max(like[0, 0], like[1, 1])
        # The coil hardly depends on what is missing elsewhere, so that much smaller differences count there.
        less = all(1.0 - like[c, c] > _LESS * max(1.0 - like[c, 1 - c], 1e-4) for c in (0, 1))
        coil = less and signal == "current"
        message = f"the {signal} of each channel is like the model's of the other channel: are they swapped?"
        hint = f"exchange the {signal} columns in a mapping"
        if apart > 0.2 or coil:
            yield Finding("swapped", message, hint, signal, sure=apart > 0.4 or coil)


def _shafts_exchanged(rig: RigModel) -> str:
    """What is swapped if the pressure of each channel fits the other one's shaft and not its own, or nothing.

    The load stays with the motor whose column it is in: it distinguishes exchanged speeds from exchanged pressures.
    """
    own = [_unlike(_turned(rig, c)) for c in (0, 1)]
    found = []
    for name, loads in (("speed", (0, 1)), ("pressure", (1, 0))):
        crossed = [_unlike(_turned(rig, 1 - c, c, loads[c])) for c in (0, 1)]
        if all(own[c] > _LESS * max(crossed[c], 1e-3) and crossed[c] < 0.1 for c in (0, 1)):
            found.append((max(crossed), name))
    if len(found) == 2 and min(found)[0] > 0.8 * max(found)[0]:
        return "speed or of pressure"
    return min(found)[1] if found else ""
