"""The flow controller's units and settings for a rig, from its model.

The law is written for motors of the paper's displacement, inertia and rated flow, and every rig is one of these in the right
units (`exact_units`). What is left are ratios: how stiff motor and lines are, how fast the spool is, what the supply can
accelerate. The paper's motor leaks so much that its speed follows the flow slowly and without swinging; its settings were tuned
(`leaks`). Any other motor swings against the oil in its lines. Feedback of the pressure damps that, as leakage would, where
the valve is fast enough (Merritt 1967, ch. 8, dynamic pressure feedback), and the rest is taken as slowly as the valve allows.
"""

from __future__ import annotations

from dataclasses import replace
from math import cos, inf, pi, sqrt

import numpy as np

from hydro_env.controllers.estimation.estimator import EstimatorSettings
from hydro_env.controllers.estimation.nominal import NOMINAL, RATED_FLOW, STICTION, Motor
from hydro_env.controllers.estimation.spool import SpoolSettings
from hydro_env.controllers.estimation.valve_estimator import ValveSettings
from hydro_env.controllers.mpc.crossing import CrossingSettings
from hydro_env.controllers.mpc.feedback import FeedbackSettings
from hydro_env.controllers.mpc.flow_controller import FlowSettings
from hydro_env.controllers.mpc.probing import ProbingSettings
from hydro_env.controllers.mpc.reference import ReferenceSettings
from hydro_env.plant.parameters import SUPPLY_PRESSURE
from hydro_env.plant import PlantModel, Scales, scales_of

__all__ = ["exact_units", "fitted", "leaks"]
import os
P = dict(r=0.35, track=0.33, couple=0.5, rate=0.8, rise=0.4, most=0.6, brake=1.0, lead=0.7, fall=2.0, lag=5e-3)
P.update({k: float(v) for k, v in (e.split('=') for e in os.environ.get('FIT','').split(',') if e)})

def leaks(model: PlantModel) -> bool:
    """Whether the motor leaks like the paper's, beside what it turns and what its lines take up."""
    v = {name: max(model.pair(name)) for name in ("D", "J", "Km", "V", "beta")}
    return v["D"] ** 2 < 10.0 * v["J"] * v["Km"] and v["V"] < 5e-3 * v["beta"] * v["Km"]


def exact_units(model: PlantModel) -> Scales:
    """The rig in multiples of the paper's in which displacement, inertia and rated flow are the paper's."""
    rough = scales_of(model)
    size, inertia = (max(model.pair(name)) / NOMINAL[name] for name in ("D", "J"))
    flow = max(model.value("Kq", c) * _travel(model, c) for c in (0, 1)) / RATED_FLOW
    return replace(rough, flow=flow, displacement=size, inertia=inertia, pressure=inertia * flow / size**2)


def _travel(model: PlantModel, channel: int) -> float:
    """Spool travel at the rated command, m."""
    force = model.value("alpha", channel) * model.value("u_rated", channel) / model.value("R", channel)
    return min(force / model.value("k", channel), model.value("x_max", channel))


def fitted(model: PlantModel, period: float) -> FlowSettings:
    """Settings for a rig whose motor is not the paper's."""
    units, rough = exact_units(model), scales_of(model)
    spool = _spool(model)
    leakage = max(model.pair("Km")) / NOMINAL["Km"] * units.pressure / units.flow
    swell = max(v / b for v, b in zip(model.pair("V"), model.pair("beta"), strict=True)) * units.pressure / (units.displacement * 1.0)
    # the oil in the lines, in the law's units: flow per pressure rate
    swell = max(v / b for v, b in zip(model.pair("V"), model.pair("beta"), strict=True)) * units.pressure / units.flow
    swings = NOMINAL["D"] / sqrt(NOMINAL["J"] * swell)  # 1/s, motor against oil
    shaped = spool.damping < 0.3
    late = 0.5 * period + spool.coil + 2.0 * spool.damping / spool.rate + (0.01 if shaped else 0.0)
    late += max(model.pair("command_delay.delay")) + max(model.pair("sensor_lag.time_constant"))
    answer = P['r'] / late * max(cos(min(swings * late, pi)), 0.0)  # 1/s, of the pressure, by feedback
    damping = answer * swell / NOMINAL["Km"]
    follows = answer + leakage * NOMINAL["Km"] / swell
    largest = _largest(follows, swings, late)
    track, couple = min(P['track'] * largest, 30.0), min(P['couple'] * largest, 60.0)
    rate = min(P['rate'] * max(follows, swings), 42.0, 0.8 / late)
    supply = _supply(model, rough) / units.pressure
    motor = Motor(
        leakage=leakage, compliance=1e12 * swell, damping=damping, mode=0.0 if damping else swings * 0.23,
        noise=rough.pressure / units.pressure, supply=supply,
        friction=max(model.pair("B")) / NOMINAL["B"] * units.speed / units.torque,
    )
    if os.environ.get('SHOW'): print(dict(late=late, swings=swings, answer=answer, follows=follows, track=track, couple=couple, rate=rate, supply=supply/1e5, noise=motor.noise, shaped=shaped, spool=spool))
    return FlowSettings(
        motor=motor,
        estimator=EstimatorSettings(
            spool=spool,
            valves=ValveSettings(
                drift=0.0247, gain_drift=0.0085, still=0.016, moving=0.346, first=0.0056, idle=1.0, unused=0.0
            ),
        ),
        reference=ReferenceSettings(
            rate=rate, rise=min(P['rise'] * follows, 28.0), fall=P['fall'], doubt=2.9, foresight=0.0,
            most=P['most'] * supply * NOMINAL["D"] / NOMINAL["J"], brake=P['brake'] * supply * NOMINAL["D"] / NOMINAL["J"],
        ),
        probing=ProbingSettings(led=False, detect=0.0047, patience=0.0),
        crossing=CrossingSettings(known=0.0135),
        feedback=FeedbackSettings(track=track, couple=couple, delay=late, lead=P['lead'] * late / 0.01, late=0.78),
        planner=None,
        shaped=shaped,
    )


def _largest(damped: float, swings: float, late: float) -> float:
    """Acceleration per error of the speed at which the loop is at its limit, 1/s: that of a motor that swings at the rate
    `swings`, whose pressure settles at the rate `damped`, all 1/s, behind a delay (s)."""
    s = 1j * np.geomspace(0.1, 20.0, 2000) / late
    loop = damped * np.exp(-s * late) / (s * s + damped * s + swings**2)
    beyond = np.flatnonzero(np.unwrap(np.angle(loop)) < -pi)
    return float(1.0 / abs(loop[beyond[0]]))


def _supply(model: PlantModel, rough: Scales) -> float:
    found = max(model.pair("pressure_dependent_flow.supply_pressure"))
    return found if found < inf else rough.pressure * SUPPLY_PRESSURE.nominal


def _spool(model: PlantModel) -> SpoolSettings:
    """The slower of both spools."""
    rate, damping, coil, friction, stop = 1e9, 0.0, 0.0, 0.0, 0.0
    for c in (0, 1):
        def value(name: str, c: int = c) -> float:
            return model.value(name, c)
        own = sqrt(value("k") / value("m"))
        ratio = (value("C") + value("s2") + value("alpha") ** 2 / value("R")) / (2.0 * sqrt(value("k") * value("m")))
        if own / max(ratio, 1.0) < rate / max(damping, 1.0):
            rate, damping = own, ratio
        coil = max(coil, value("L") / value("R"))
        friction = max(friction, value("Fs") / (value("k") * _travel(model, c)))
        stop = max(stop, value("x_max") / _travel(model, c))
    # one that creeps is taken for one with the same lag that does not swing
    rate, damping = rate / max(damping, 1.0), min(damping, 1.0)
    return SpoolSettings(
        rate=rate, damping=damping, friction=0.54 * friction / STICTION, substep=2.0 * pi / rate / 24.0, coil=coil,
        stop=stop, pressure_lag=P['lag'],
    )
