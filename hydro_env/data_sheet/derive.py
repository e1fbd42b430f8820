"""From the quantities of a data sheet to the parameters of a model, by formulas that can be undone.

What no formula gives (how far hysteresis, step response and frequencies follow from friction, damping and the coil together) is
left to `Fitted`, numbers by which `describe.py` makes the simulated data sheet that of the paper.

Logs and data sheets fix only ratios of spool mass, spring, force and friction (`plant.parameters.SCALINGS`). Here the spring is
the base plant's as far as the mass can then be simulated, and the travel so short that the spool takes little of the coil's
power.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from hydro_env.plant import PARAMETERS
from hydro_env.plant.catalogue.supply import steady_droop
from hydro_env.units import BAR, LPM, MILLIMETRE, MILLISECOND, REVOLUTION, RPM

DENSITY = 870.0  # kg/m3, mineral oil
#: The effects of every model that is derived here; `crossport_relief` where the sheet has it.
EFFECTS = (
    "magnetic_hysteresis", "dead_zone", "pressure_dependent_flow", "supply_droop", "entrained_air", "line_loss",
    "motor_coulomb_friction",
)  # fmt: skip


@dataclass(frozen=True)
class Fitted:
    """What is found by simulation: factors on the natural frequency, hysteresis and rated flow, damping ratio and coil lag where
    they are not assumed."""

    frequency: float = 1.0
    hysteresis: float = 1.0
    flow: float = 1.0
    damping: float | None = None
    coil_lag: float | None = None


def total_drop(q: Mapping[str, float]) -> float:
    """Pressure drop over the whole valve at the rated flow, Pa."""
    return q["edges"] * q["at_pressure_drop_bar"] * BAR


def full_flow(q: Mapping[str, float]) -> float:
    """Flow of the open valve at the supply pressure, m3/s: it grows with the root of the drop."""
    return q["rated_flow_lpm"] * LPM * math.sqrt(q["pressure_bar"] * BAR / total_drop(q))


def parameters(
    q: Mapping[str, float], other_flow: float, fitted: Fitted, scale_of: Mapping[str, float] | None = None
) -> dict[str, float]:
    """The values of one channel by name, SI. `other_flow` is the full flow of the other channel, m3/s; `scale_of` are values
    whose spring and rated travel are kept."""
    both = full_flow(q) + other_flow
    return {**_valve(q, fitted, scale_of), **_motor(q), **_lines(q), **_supply(q, both)}


def _valve(q: Mapping[str, float], fitted: Fitted, scale_of: Mapping[str, float] | None) -> dict[str, float]:
    base = {name: p.nominal for name, p in PARAMETERS.items()}
    guessed = 0.45 / (q["step_response_ms"] * MILLISECOND) if "step_response_ms" in q else math.nan
    natural = q.get("frequency_minus_90_deg_Hz", q.get("frequency_minus_3_dB_Hz", guessed))
    omega = fitted.frequency * 2.0 * math.pi * natural
    damping = q["damping"] if fitted.damping is None else fitted.damping
    power = q["volts"] * q["ampere"]
    if scale_of is None:
        least, most = PARAMETERS["m"].possible
        k = omega**2 * min(max(base["k"] / omega**2, least), most)
        travel = math.sqrt(0.4 * damping * power / (k * omega))
        travel = min(max(travel, 1e-4), base["alpha"] * base["u_rated"] / base["R"] / base["k"])
    else:
        k, travel = scale_of["k"], scale_of["alpha"] * q["ampere"] / scale_of["k"]
    force, resistance = k * travel, q["volts"] / q["ampere"]
    m, alpha = k / omega**2, force / q["ampere"]
    loop = fitted.hysteresis * q["hysteresis_percent"] / 100.0 * force
    dry = 0.5 * loop * q["friction_share"]
    bristle = max(dry / (travel * 1.2e-3), PARAMETERS["s0"].possible[0])
    lag = (q.get("coil_lag", 0.0) if fitted.coil_lag is None else fitted.coil_lag) / omega
    inductance = q["coil_inductance_mH"] / 1000.0 if "coil_inductance_mH" in q else lag * resistance
    overlap = q["dead_band_percent"] / 100.0 * travel
    drop = math.sqrt(q["pressure_bar"] * BAR / total_drop(q))
    size = travel / (base["alpha"] * base["u_rated"] / base["R"] / base["k"])
    return {
        "m": m, "R": resistance, "alpha": alpha, "k": k, "u_rated": q["volts"],
        "L": max(inductance, PARAMETERS["L"].possible[0]),
        "C": max(2.0 * damping * m * omega - alpha**2 / resistance, 0.0),
        "Kq": fitted.flow * q["rated_flow_lpm"] * LPM / (travel - overlap) * drop,
        "Fc": dry, "Fs": dry * (1.0 if q["friction_share"] == 1.0 else 1.5), "vs": base["vs"] * size,
        "s0": bristle, "s1": max(math.sqrt(bristle * m), PARAMETERS["s1"].possible[0]), "s2": 0.0,
        "x_max": base["x_max"] * size, "k_stop": base["k_stop"] * k / base["k"],
        "dead_zone.overlap_positive": overlap, "dead_zone.overlap_negative": overlap,
        "magnetic_hysteresis.amplitude": 0.5 * loop * (1.0 - q["friction_share"]),
        "magnetic_hysteresis.width": 0.04 * q["ampere"],
    }  # fmt: skip


def _motor(q: Mapping[str, float]) -> dict[str, float]:
    displacement = q["displacement_cm3"] * 1e-6 / REVOLUTION
    pressure, speed = q["at_pressure_bar"] * BAR, q["at_speed_rpm"] * RPM
    lost = (1.0 - q["mechanical_efficiency_percent"] / 100.0) * displacement * pressure
    dry = q["dry_share"] * lost
    if "starting_torque_percent" in q:
        lacking = 1.0 - q["starting_torque_percent"] / 100.0
        static = lacking * displacement * q["starting_torque_at_bar"] * BAR
        dry = min(dry, static)
    else:
        static = q["static_over_dry"] * dry
    leaked = displacement * speed * (100.0 / q["volumetric_efficiency_percent"] - 1.0)
    return {
        "D": displacement, "J": q["inertia_kgm2"], "B": (lost - dry) / speed, "Km": leaked / pressure,
        "motor_coulomb_friction.coulomb": dry, "motor_coulomb_friction.static": static,
        "motor_coulomb_friction.stribeck_speed": 3.0,
    }  # fmt: skip


def _lines(q: Mapping[str, float]) -> dict[str, float]:
    bore, length, flow = q["bore_mm"] * MILLIMETRE, q["length_m"], full_flow(q)
    area = math.pi / 4.0 * bore**2
    # 20 K of warming halve the viscosity of such an oil.
    viscosity = 1e-6 * q["oil_viscosity_grade"] * 2.0 ** ((40.0 - q["oil_temperature_C"]) / 20.0)
    reynolds = flow / area * bore / viscosity
    friction = 64.0 / reynolds if reynolds < 2300.0 else 0.316 / reynolds**0.25
    loss = 2.0 * (friction * length / bore + q["fittings"]) * DENSITY / (2.0 * area**2)
    oil, wall = q["oil_bulk_modulus_bar"] * BAR, q["wall_bulk_modulus_bar"] * BAR
    found = {
        "V": 0.5 * (area * length + 0.5e-6 * q["displacement_cm3"]),
        "beta": 1.0 / (1.0 / oil + 1.0 / wall),
        "line_loss.coefficient": loss,
        "entrained_air.fraction": q["oil_air_percent"] / 100.0,
    }
    if "crossport_relief_bar" in q:
        relief = q["crossport_relief_bar"] * BAR
        found["crossport_relief.relief_pressure"] = relief
        found["crossport_relief.conductance"] = flow / (q["override_percent"] / 100.0 * relief)
    return found


def _supply(q: Mapping[str, float], flow_of_both: float) -> dict[str, float]:
    return {
        "pressure_dependent_flow.supply_pressure": q["pressure_bar"] * BAR,
        "supply_droop.relative_drop": q["droop_percent"] / 100.0 / steady_droop(flow_of_both, 0.0, 1.0),  # type: ignore[no-untyped-call]
        "supply_droop.time_constant": q["droop_ms"] * MILLISECOND,
    }
