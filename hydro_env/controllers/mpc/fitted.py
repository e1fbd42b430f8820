"""Units and settings of the flow controller for a rig, from its model.

The law is written for a motor of the paper's displacement, inertia and rated flow, and every motor is that one in the right
units (`units_of`). What is left are ratios: how much leaks, how stiff the oil is, how fast the spool follows, what the supply can
accelerate. The paper's motor leaks so much that its speed follows a flow slowly and does not swing (`leaks`); it has settings of
its own. Others swing against the oil in their lines, which feedback of the pressure damps as leakage would, where the valve is
fast enough for it (Merritt 1967, ch. 8).
"""

from dataclasses import replace
from math import cos, inf, pi, sqrt

import numpy as np

from hydro_env.controllers.estimation.estimator import EstimatorSettings
from hydro_env.controllers.estimation.nominal import NOMINAL, RATED_FLOW, STICTION, Motor
from hydro_env.controllers.estimation.spool import SpoolSettings
from hydro_env.controllers.estimation.valve_estimator import ValveSettings
from hydro_env.controllers.mpc.edge_search import CrossingSettings, ProbingSettings
from hydro_env.controllers.mpc.feedback import FeedbackSettings
from hydro_env.controllers.mpc.flow_controller import FlowSettings
from hydro_env.controllers.mpc.reference import ReferenceSettings
from hydro_env.plant import PlantModel, Scales, scales_of
from hydro_env.plant.parameters import SUPPLY_PRESSURE
from hydro_env.plant.scales import rated

#: Shares of what is possible that are used: of the damping by the pressure's feedback, of the rate at which what lasts of an
#: error is taken out, and of the largest feedback on both errors. Set on drawn rigs, as the next ones are.
DAMP, SETTLE, TRACK, COUPLE = 0.4, 0.2, 0.2, 0.5
#: Likewise of the delay that the speed difference is predicted over, of the motor's own rate for the reference and for the rise
#: of flow, and of the supply's pressure.
LEAD, RATE, RISE, PUSH = 0.7, 0.3, 0.2, 0.85
#: Rated speeds a second that no reference exceeds; set on drawn rigs.
GENTLE = 5.0
#: Damping ratio of a spool below which commands are averaged.
RINGS = 0.3

VALVES = ValveSettings(
    before=0.03, drift=0.0247, gain_drift=0.0085, still=0.016, moving=0.346, first=0.0056, idle=1.0, unused=0.0,
)  # fmt: skip
PROBING = ProbingSettings(led=False, detect=0.0047, patience=0.0)
#: Estimation and probing of valves whose spools the model knows too roughly to lead them. Found by an evolution strategy on
#: pairs of `train` of the preset `rig`; `before` and `search` by trial on drawn rigs.
CROSSING = CrossingSettings(known=0.0135, search=3.0)


def leaks(model: PlantModel) -> bool:
    """Whether the motor leaks like the paper's, beside what it turns and what its lines take up."""
    v = {name: max(model.pair(name)) for name in ("D", "J", "Km", "V", "beta")}
    return v["D"] ** 2 < 10.0 * v["J"] * v["Km"] and v["V"] < 5e-3 * v["beta"] * v["Km"]


def units_of(model: PlantModel) -> Scales:
    """The rig in multiples of the paper's, such that displacement, inertia and rated flow are the paper's in these units."""
    size, inertia = (max(model.pair(name)) / NOMINAL[name] for name in ("D", "J"))
    flow = max(rated(model, c)["flow"] for c in (0, 1)) / RATED_FLOW
    pressure = inertia * flow / size**2
    return replace(scales_of(model), flow=flow, displacement=size, inertia=inertia, pressure=pressure)


def settings_of(model: PlantModel, period: float) -> FlowSettings:
    """Settings for a motor that does not leak like the paper's; `period` of control in s."""
    motor, spool = _motor(model), _spool(model)
    shaped = spool.damping < RINGS
    late = 0.5 * period + spool.coil + 2.0 * spool.damping / spool.rate + (0.01 if shaped else 0.0)
    late += max(model.pair("command_delay.delay")) + max(model.pair("sensor_lag.time_constant"))
    oil = 1e-12 * motor.compliance
    swings = NOMINAL["D"] / sqrt(NOMINAL["J"] * oil)  # rates in 1/s: of the motor against the oil,
    answer = DAMP / late * max(cos(min(swings * late, pi)), 0.0)  # of the pressure by its feedback,
    settles = answer + motor.leakage * NOMINAL["Km"] / oil  # and with the leakage
    motor = motor._replace(damping=answer * oil / NOMINAL["Km"], mode=0.0 if answer else 0.23 * swings)
    most = _max_feedback(settles, swings, late)
    push = PUSH * motor.supply * NOMINAL["D"] / NOMINAL["J"]
    return FlowSettings(
        motor=motor,
        estimator=EstimatorSettings(spool=spool, valves=VALVES),
        reference=ReferenceSettings(
            rate=min(RATE * max(settles, swings), 42.0, 0.8 / late),
            rise=min(RISE * settles, 28.0), fall=2.0, doubt=2.9, foresight=0.0,
            most=min(push, GENTLE * RATED_FLOW / NOMINAL["D"]),
        ),
        probing=PROBING,
        crossing=CROSSING,
        feedback=FeedbackSettings(
            settle=SETTLE * min(settles, 1.0 / late),
            track=min(TRACK * most, 30.0), couple=min(COUPLE * most, 60.0), delay=late,
            lead=LEAD * late / 0.01, late=0.78,
        ),
        planner=None,
        shaped=shaped,
    )  # fmt: skip


def _motor(model: PlantModel) -> Motor:
    """The motor in the law's units."""
    units, rough = units_of(model), scales_of(model)
    v = {name: max(model.pair(name)) for name in ("Km", "B", "V")}
    supply = max(model.pair("pressure_dependent_flow.supply_pressure"))
    if supply == inf:
        supply = rough.pressure * SUPPLY_PRESSURE.nominal
    return Motor(
        leakage=v["Km"] / NOMINAL["Km"] * units.pressure / units.flow,
        compliance=1e12 * v["V"] / min(model.pair("beta")) * units.pressure / units.flow,
        friction=v["B"] / NOMINAL["B"] * units.speed / units.torque,
        supply=supply / units.pressure,
        noise=rough.pressure / units.pressure,
    )


def _spool(model: PlantModel) -> SpoolSettings:
    """The slower one of both spools."""

    def of(c: int) -> SpoolSettings:
        k, m, R, alpha = (model.value(name, c) for name in ("k", "m", "R", "alpha"))
        damping = (model.value("C", c) + model.value("s2", c) + alpha**2 / R) / (2.0 * sqrt(k * m))
        # one that creeps is taken for one with the same lag that does not
        rate, travel = sqrt(k / m) / max(damping, 1.0), rated(model, c)["travel"]
        return SpoolSettings(
            rate=rate,
            damping=min(damping, 1.0),
            friction=0.54 * model.value("Fs", c) / (k * travel) / STICTION,
            substep=2.0 * pi / rate / 24.0,
            coil=model.value("L", c) / R,
            pressure_lag=5e-3,  # the rate of the pressure is a mean over the last period
            stop=model.value("x_max", c) / travel,
        )

    return min((of(0), of(1)), key=lambda spool: spool.rate)


def _max_feedback(settles: float, swings: float, late: float) -> float:
    """Acceleration per error of the speed, 1/s, with which the loop would just swing on: that of a motor behind a delay (s) which
    swings at the rate `swings` and whose pressure settles at the rate `settles`, both 1/s."""
    s = 1j * np.geomspace(0.1, 20.0, 2000) / late
    loop = settles * np.exp(-s * late) / (s * s + settles * s + swings**2)
    return float(1.0 / np.abs(loop[np.argmax(np.unwrap(np.angle(loop)) < -pi)]))
