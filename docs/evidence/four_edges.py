"""A second rig simulator: valves with four edges, and lines that each have a pressure of their own.

The plant, and the reference simulator that checks it, know the load pressure alone: lines are alike, and the supply is shared by
the two edges that are open. Simulators of fluid power (Hopsan, Simscape, AMESim) rather simulate what a machine has: every edge
of the spool is an orifice by itself, and the oil of either line is compressed by what flows into it. Both are the same where
edges and lines are alike (Merritt, Hydraulic Control Systems, 1967, ch. 5 and 6); where they are not, the plant has to make do
with its own laws. This module shares no equation and no constant with either.

    spool       x'' = (2 pi f)^2 (g u - x) - 2 z (2 pi f) x', between its ends; u behind delay, limit and play
    edge        q = c a dp / sqrt(|dp| + 2000 Pa), a how far it is open: PA and BT from x on, PB and AT from -x on
    line A      p_A' = K_A / V_A (q_PA - q_AT - D w - k (p_A - p_B) - relief - leak to tank), line B likewise
    shaft       J w' = D (p_A - p_B) - B w - friction - load
    supply      falls by a resistance times what both valves take

Explicit Runge-Kutta steps of fourth order. Signals are as of `plant.simulate`: row n is the state at the instant at which
command n begins to act.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydro_env.jit import compiled

Array = NDArray[np.float64]

#: What `simulate` returns, by columns: pressures of lines A and B, Pa, and the speed as the sensor shows it, rad/s.
SIGNALS = ("pressure_a", "pressure_b", "measured_speed")

#: Pressure drop below which an orifice is laminar, Pa.
LAMINAR = 2e3
#: Lag of the supply line, s, and the speed within which dry friction changes its sign, rad/s.
SUPPLY_LAG, TURNING = 2e-3, 0.05
#: Pressure of the tank and what a line holds at least (a cavity's), Pa.
TANK, CAVITY = 1e5, 0.0


class Axis(NamedTuple):
    """One valve with its motor, SI. Neutral values are those by which something is not there."""

    gain: float
    """Travel of the spool by command, m/V."""
    frequency: float
    """Of the spool, Hz."""
    damping: float
    orifice: float
    """Flow of an edge by its opening and the root of its pressure drop, m2/s/sqrt(Pa)."""
    volume_a: float
    volume_b: float
    modulus: float
    displacement: float
    leakage: float
    inertia: float
    friction: float
    travel: float = 1e-3
    zero: float = 0.0
    """Spool position without a command, m."""
    overlap_pa: float = 0.0
    overlap_pb: float = 0.0
    overlap_at: float = 0.0
    overlap_bt: float = 0.0
    negative_gain: float = 1.0
    """Of the edges PB and AT against the others."""
    voltage_limit: float = math.inf
    delay: float = 0.0
    play: float = 0.0
    """Whole width at the input, V."""
    leak_a: float = 0.0
    leak_b: float = 0.0
    relief_pressure: float = math.inf
    relief_slope: float = 0.0
    relief_lag: float = 0.0
    relief_hysteresis: float = 0.0
    air: float = 0.0
    """Share of the oil at atmospheric pressure."""
    hose: float = 0.0
    """Compliance of the walls of both lines by their volume, 1/Pa."""
    vessel_volume: float = 0.0
    """Beside line A behind an orifice."""
    vessel_orifice: float = 0.0
    coulomb: float = 0.0
    static: float = 0.0
    stribeck: float = 2.0
    far_inertia: float = 0.0
    """Behind a soft shaft; the load acts there."""
    stiffness: float = 0.0
    shaft_damping: float = 0.0
    sensor_lag: float = 0.0
    sensor_offset: float = 0.0


#: Numbers of the states of an axis.
X, V, PA, PB, W, TWIST, FAR, VESSEL, RELIEF, SENSOR = range(10)


def simulate(
    axes: tuple[Axis, Axis], command_V: Array, load_Nm: Array, period: float, *, supply: float, resistance: float = 0.0,
    step: float = 20e-6,
) -> dict[str, Array]:  # fmt: skip
    """Signals (T, 2) of a rig, by name (`SIGNALS`), for commands and loads (T, 2) that each hold for a `period`, s.

    `supply` is the pressure at no flow, Pa, `resistance` what it loses by flow, Pa s/m3; `step` is the longest one, s. Delays are
    taken to the nearest whole period.
    """
    steps = math.ceil(period / step - 1e-9)
    rows = len(command_V)
    commands = np.zeros((rows, 2))
    for c, axis in enumerate(axes):
        late = min(round(axis.delay / period), rows)
        commands[late:, c] = command_V[: rows - late, c]
    out = np.zeros((rows, 2, len(SIGNALS)))
    _run(axes, commands, np.ascontiguousarray(load_Nm), period / steps, steps, supply, resistance, out)
    return {name: out[:, :, n] for n, name in enumerate(SIGNALS)}


def _orifice(factor: float, opening: float, drop: float) -> float:
    if opening <= 0.0:
        return 0.0
    return factor * opening * drop / math.sqrt(abs(drop) + LAMINAR)


_orifice = compiled(_orifice, nogil=True)


def _modulus(axis: Any, pressure: float) -> float:
    """Bulk modulus of a line, with its air compressed at constant temperature and walls that give way, Pa."""
    absolute = max(pressure, 0.2e5)
    return 1.0 / (1.0 / axis.modulus + axis.air * 1e5 / absolute**2 + axis.hose)


_modulus = compiled(_modulus, nogil=True)


def _rates(
    axis: Any, s: Any, reference: float, load: float, supply: float, cracked: float, rate: Any
) -> float:
    """Puts the rates of the states `s` of an axis into `rate`; returns what the valve takes from the supply, m3/s.

    `reference` is where the spool is sent, m, `cracked` the pressure from which the relief valve is open as things are, Pa.
    """
    x, pa, pb, w = s[X], s[PA], s[PB], s[W]
    omega = 2.0 * math.pi * axis.frequency
    rate[X] = s[V]
    rate[V] = omega * omega * (reference - x) - 2.0 * axis.damping * omega * s[V]
    back = axis.orifice * axis.negative_gain
    from_supply_a = _orifice(axis.orifice, x - axis.overlap_pa, supply - pa)
    from_supply_b = _orifice(back, -x - axis.overlap_pb, supply - pb)
    to_tank_a = _orifice(back, -x - axis.overlap_at, pa - TANK)
    to_tank_b = _orifice(axis.orifice, x - axis.overlap_bt, pb - TANK)
    across = pa - pb
    through = axis.displacement * w + axis.leakage * across
    if axis.relief_slope > 0.0:
        wanted = axis.relief_slope * max(abs(across) - cracked, 0.0)
        flow = s[RELIEF] if axis.relief_lag > 0.0 else wanted
        rate[RELIEF] = (wanted - s[RELIEF]) / axis.relief_lag if axis.relief_lag > 0.0 else 0.0
        through += flow if across > 0.0 else -flow
    into_vessel = 0.0
    if axis.vessel_volume > 0.0:
        into_vessel = _orifice(axis.vessel_orifice, 1.0, pa - s[VESSEL])
        rate[VESSEL] = axis.modulus / axis.vessel_volume * into_vessel
    into_a = from_supply_a - to_tank_a - through - axis.leak_a * (pa - TANK) - into_vessel
    into_b = from_supply_b - to_tank_b + through - axis.leak_b * (pb - TANK)
    rate[PA] = _modulus(axis, pa) / axis.volume_a * into_a
    rate[PB] = _modulus(axis, pb) / axis.volume_b * into_b
    dry = axis.coulomb + (axis.static - axis.coulomb) * math.exp(-((w / axis.stribeck) ** 2))
    torque = axis.displacement * across - axis.friction * w - dry * math.tanh(w / TURNING)
    if axis.far_inertia > 0.0:
        shaft = axis.stiffness * s[TWIST] + axis.shaft_damping * (w - s[FAR])
        rate[W] = (torque - shaft) / axis.inertia
        rate[FAR] = (shaft - load) / axis.far_inertia
        rate[TWIST] = w - s[FAR]
    else:
        rate[W] = (torque - load) / axis.inertia
    if axis.sensor_lag > 0.0:
        rate[SENSOR] = (w - s[SENSOR]) / axis.sensor_lag
    return from_supply_a + from_supply_b


_rates = compiled(_rates, nogil=True)


def _run(
    axes: Any, commands: Any, loads: Any, h: float, steps: int, supply: float, resistance: float, out: Any
) -> None:  # fmt: skip
    """The rig from rest through all rows, `steps` steps of `h` each."""
    states, rates = np.zeros((2, 10)), np.zeros((4, 2, 10))
    trial = np.zeros((2, 10))
    lag = np.zeros(4)
    states[:, PA] = states[:, PB] = states[:, VESSEL] = 0.5 * (supply + TANK)
    pressure = supply
    held, reference, cracked, is_open = np.zeros(2), np.zeros(2), np.zeros(2), np.zeros(2)
    for row in range(commands.shape[0]):
        for c in range(2):
            axis = axes[c]
            shown = states[c, SENSOR] if axis.sensor_lag > 0.0 else states[c, W]
            out[row, c, 0], out[row, c, 1], out[row, c, 2] = (
                states[c, PA],
                states[c, PB],
                shown + axis.sensor_offset,
            )
            u = min(max(commands[row, c], -axis.voltage_limit), axis.voltage_limit)
            held[c] = min(max(held[c], u - 0.5 * axis.play), u + 0.5 * axis.play)
            reference[c] = axis.gain * held[c] + axis.zero
        for _ in range(steps):
            for c in range(2):
                axis = axes[c]
                across = abs(states[c, PA] - states[c, PB])
                if is_open[c] > 0.0 and across < axis.relief_pressure - axis.relief_hysteresis:
                    is_open[c] = 0.0
                if across > axis.relief_pressure:
                    is_open[c] = 1.0
                cracked[c] = axis.relief_pressure - is_open[c] * axis.relief_hysteresis
            for stage in range(4):
                share = 0.0 if stage == 0 else h if stage == 3 else 0.5 * h
                flow, before = 0.0, max(stage - 1, 0)
                at = pressure + share * lag[before]
                for c in range(2):
                    trial[c] = states[c] + share * rates[before, c]
                    flow += _rates(
                        axes[c], trial[c], reference[c], loads[row, c], at, cracked[c], rates[stage, c]
                    )
                lag[stage] = (supply - resistance * flow - at) / SUPPLY_LAG
            pressure += h / 6.0 * (lag[0] + 2.0 * lag[1] + 2.0 * lag[2] + lag[3])
            states += h / 6.0 * (rates[0] + 2.0 * rates[1] + 2.0 * rates[2] + rates[3])
            for c in range(2):
                ends = axes[c].travel
                if abs(states[c, X]) > ends:
                    states[c, X] = min(max(states[c, X], -ends), ends)
                    states[c, V] = 0.0
                states[c, PA], states[c, PB] = max(states[c, PA], CAVITY), max(states[c, PB], CAVITY)


_run = compiled(_run, nogil=True)
