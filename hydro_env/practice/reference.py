"""An independent simulator of the rig: the plain equations, integrated by SciPy's stiff solvers.

It shares no line of physics with the compiled kernel. The kernel is checked against it (`forms="same"`), and practice
logs come from it (`forms="different"`), so that a diagnosis never meets its own equations in disguise. The two forms
agree on what every parameter means and on its limits; they differ in shape:

    effect                     same form (the catalogue's)       different form
    driver_saturation          hard clip                         soft knee (p-norm, p = 24)
    coil_heating               heated by i^2 of the cold coil    heated by i^2 R(t)
    magnetic_hysteresis        Bouc-Wen                          sum of four stop operators (Prandtl-Ishlinskii)
    spool_stiction             larger Fc, Fs of the one bristle  second, elasto-plastic bristle (Dupont 2002)
    spring_preload             tanh                              algebraic, narrower
    flow_force                 on the spool's travel             on the flow opening, with radial clearance
    dead_zone                  sharp corners                     corners rounded by the radial clearance
    flow_saturation            hard clip                         p-norm
    directional_gain           kink                              blended around zero
    flow_gain_nonlinearity     gain linear in the opening        power law
    pressure_dependent_flow    square root, blocked when dp > ps laminar transition, back flow when dp > ps
    supply_droop               one lag                           two lags (pump and accumulator line)
    entrained_air              isothermal                        polytropic (1.2)
    line_loss, quadratic_drag  q abs(q)                          q sqrt(q^2 + small^2), laminar at low flow
    crossport_relief           kink                              rounded cracking
    motor_coulomb_friction     tanh with Stribeck peak           LuGre bristle on the shaft
    displacement_ripple        one cosine                        with a second harmonic
    loss models of the motor   sign(w) as tanh(10 w), root       sign(w) as w/sqrt(w^2 + 0.01), laminar gap
                               smooth below 0.1 bar              in series with the turbulent one
    shaft_backlash             damper grows at first             damper grows throughout, more gently
    viscosity_drift            exponential                       faster beginning, same end
    sensor_lag                 first order                       two lags with the same sum
    the others                 one form only: delay, offsets, gains, constant and eccentric torque, leakage by speed

Signals are SI, arrays (T, 2): column 0 is channel 1. Row n is the state at the instant at which command n begins to act
(row 0: rest), the convention of `plant.simulate` and of rig logs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import odeint, solve_ivp

from ..errors import InputError
from ..jit import compiled
from ..plant.catalogue import BUILT_IN, CATALOGUE
from ..plant.catalogue.losses import FAMILY
from ..plant.model import PlantModel, load_model
from ..plant.parameters import PARAMETERS

__all__ = ["FORMS", "REFERENCE_SIGNALS", "ReferenceRig", "run_closed_loop", "simulate_reference"]

Array = NDArray[np.float64]

#: "same": the equations of the catalogue; "different": another shape with the same meaning of every parameter.
FORMS = ("same", "different")
#: What the simulator returns.
REFERENCE_SIGNALS = (
    "current", "spool", "spool_speed", "bristle", "pressure", "speed", "angle", "flow", "measured_speed",
)  # fmt: skip

_STATES = REFERENCE_SIGNALS[:7]
_STATE_SCALES = (0.1, 1e-4, 1e-2, 1e-6, 1e5, 1.0, 1.0)  # for absolute tolerances
_SUPPLY_FLOW = 2.0 * 476106e-6 * 20.0 * 73.0 / (100.0 * 17000.0)  # m3/s
_INSTANT = 1e-9  # s; what lies closer together happens at once
_STOPS = np.array([0.48, 1.14, 1.97, 3.62])  # thresholds of the stop operators, in half widths
_SHIFTS = ("heat", "loop", "second_bristle", "shaft_bristle", "twist", "lag", "droop")


def _fields() -> list[tuple[str, Any]]:
    own = [(name, np.float64) for name in PARAMETERS]
    effects = [
        (f"{e.name}__{p.name}", np.float64)
        for e in map(CATALOGUE.__getitem__, BUILT_IN)
        for p in e.parameters
    ]
    places = [(f"at_{name}", np.int64) for name in ("states", *_SHIFTS)]
    return [*own, *effects, *places, ("different", np.int64), ("lossy", np.int64)]


# --- laws, one by one; `p` is the record of a channel's parameters ---------------------------------------------------
@compiled
def _limited(value, limit, soft):
    if limit == np.inf:
        return value
    if soft:
        return value / (1.0 + (abs(value) / limit) ** 24.0) ** (1.0 / 24.0)
    return min(max(value, -limit), limit)


@compiled
def _opening(p, spool):
    """Opening of the metering edges, m, as a function of the spool's position."""
    x = spool + p.null_offset__offset
    high, low = p.dead_zone__overlap_positive, p.dead_zone__overlap_negative
    if high != 0.0 or low != 0.0:
        if p.different:
            clearance = 5e-6
            above, below = x - high, x + low
            x = 0.5 * (above + math.sqrt(above * above + clearance**2))
            x += 0.5 * (below - math.sqrt(below * below + clearance**2))
        elif x > high:
            x -= high
        elif x < -low:
            x += low
        else:
            x = 0.0
    x = _limited(x, p.flow_saturation__opening_limit, p.different)
    ratio = p.directional_gain__ratio
    if ratio != 1.0:
        if p.different:
            x *= 0.5 * (1.0 + ratio) + 0.5 * (1.0 - ratio) * math.tanh(x / 2e-6)
        elif x < 0.0:
            x *= ratio
    curvature = p.flow_gain_nonlinearity__curvature
    if curvature != 0.0:
        share = min(abs(x) * p.R * p.k / (p.alpha * p.u_rated), 1.0)
        if p.different:
            power = -math.log2(1.0 - 0.5 * curvature)
            x *= ((share * share + 4e-4) / 1.0004) ** (0.5 * power)
        else:
            x *= 1.0 - curvature + curvature * share
    return x


@compiled
def _valve_flow(p, spool, pressure, droop):
    """Flow through the valve, m3/s, (8) with the orifice law of (7) where an effect asks for it."""
    x = _opening(p, spool)
    against = pressure if x > 0.0 else (-pressure if x < 0.0 else 0.0)
    drive = 1.0 - against / p.pressure_dependent_flow__supply_pressure - droop
    if p.pressure_dependent_flow__supply_pressure == np.inf and p.supply_droop__relative_drop == 0.0:
        return p.Kq * x
    if p.different:
        transition = 1e-4
        return p.Kq * x * drive * ((1.0 + transition) / (drive * drive + transition)) ** 0.25
    return p.Kq * x * math.sqrt(max(drive, 0.0))


@compiled
def _magnetic_force(p, y, dy, current_rate):
    """Force of the solenoid, N; sets the rates of the hysteresis."""
    force = p.alpha * y[p.at_states]
    if p.at_loop >= 0:
        width = max(p.magnetic_hysteresis__width, 2.0 * p.magnetic_hysteresis__amplitude / p.alpha)
        if p.different:
            for j in range(4):
                s = y[p.at_loop + j]
                free = 1.0
                if s * current_rate > 0.0:
                    free = max(1.0 - abs(s) ** 12.0, 0.0)
                dy[p.at_loop + j] = free * current_rate / (0.5 * width * _STOPS[j])
                force -= 0.25 * p.magnetic_hysteresis__amplitude * s
        else:
            s = y[p.at_loop]
            dy[p.at_loop] = (current_rate - abs(current_rate) * s) / width
            force -= p.magnetic_hysteresis__amplitude * s
    return force


@compiled
def _spool_friction(p, y, dy):
    """LuGre friction of the spool, N, (9)-(11); sets the rates of its bristles."""
    v, z = y[p.at_states + 2], y[p.at_states + 3]
    coulomb, static = p.Fc, p.Fs
    if not p.different:
        coulomb += p.spool_stiction__coulomb
        static += p.spool_stiction__static
    peak = math.exp(-((v / p.vs) ** 2))
    z_rate = v - abs(v) * p.s0 / (coulomb + (static - coulomb) * peak) * z
    dy[p.at_states + 3] = z_rate
    friction = p.s0 * z + p.s1 * z_rate + p.s2 * v
    if p.at_second_bristle >= 0:
        z = y[p.at_second_bristle]
        coulomb, static = p.spool_stiction__coulomb, p.spool_stiction__static
        limit = (coulomb + (static - coulomb) * peak) / p.s0
        # Purely elastic up to 70 % of the limit, then ever more plastic.
        plastic = 0.0
        if z * v > 0.0 and abs(z) > 0.7 * limit:
            plastic = 1.0
            if abs(z) < limit:
                plastic = 0.5 + 0.5 * math.sin(math.pi * (abs(z) - 0.85 * limit) / (0.3 * limit))
        z_rate = v - plastic * abs(v) * z / limit
        dy[p.at_second_bristle] = z_rate
        friction += p.s0 * z + 0.5 * p.s1 * z_rate
    return friction


@compiled
def _spool_rates(p, y, dy, pressure):
    """Coil (6), spool (5) and all that acts on them."""
    at = p.at_states
    i, x, v = y[at], y[at + 1], y[at + 2]
    voltage = _limited(p.command, p.driver_saturation__voltage_limit, p.different)
    resistance = p.R
    if p.at_heat >= 0:
        heat = y[p.at_heat]
        resistance *= 1.0 + p.coil_heating__rise * heat
        power = (i * p.R / p.u_rated) ** 2
        if p.different:
            power *= resistance / p.R
        dy[p.at_heat] = (power - heat) / p.coil_heating__time_constant
    i_rate = (voltage - resistance * i - p.alpha * v) / p.L
    dy[at] = i_rate
    dy[at + 1] = v

    force = _magnetic_force(p, y, dy, i_rate)
    preload = p.spring_preload__preload
    if preload != 0.0:
        if p.different:
            force -= preload * x / math.sqrt(x * x + 15e-6**2)
        else:
            force -= preload * math.tanh(x / 20e-6)
    if p.flow_force__coefficient != 0.0:
        travel = x
        if p.different:
            open_ = _opening(p, x)
            travel = open_ * math.sqrt(1.0 + (2e-6 / max(abs(open_), 2e-6)) ** 2)
        against = pressure if travel > 0.0 else (-pressure if travel < 0.0 else 0.0)
        force -= p.flow_force__coefficient * travel * max(p.flow_force__supply_pressure - against, 0.0)

    stop = 0.0
    beyond = abs(x) - p.x_max
    if beyond > 0.0:
        side = 1.0 if x > 0.0 else -1.0
        stop = -side * max(
            p.k_stop * beyond * (1.0 + v * side / p.v_stop), 0.0
        )  # Hunt and Crossley: pushes, never pulls
    friction = _spool_friction(p, y, dy)
    dy[at + 2] = (force + stop - p.k * x - p.C * v - friction) / p.m


@compiled
def _shaft_torque(p, y, dy, speed, angle, load):
    """Torque on the motor's shaft besides that of the pressure and of viscous friction, N m."""
    torque = -load - p.load_bias__bias
    coulomb, static = p.motor_coulomb_friction__coulomb, p.motor_coulomb_friction__static
    if coulomb != 0.0 or static != 0.0:
        level = coulomb + (static - coulomb) * math.exp(
            -((speed / p.motor_coulomb_friction__stribeck_speed) ** 2)
        )
        if p.different:
            stiffness = max(coulomb, static) / 0.003
            damping = 2.0 * 0.5 * math.sqrt(stiffness * p.J) * math.exp(-((speed / 0.5) ** 2))
            z = y[p.at_shaft_bristle]
            z_rate = speed - abs(speed) * stiffness * z / level
            dy[p.at_shaft_bristle] = z_rate
            torque -= stiffness * z + damping * z_rate
        else:
            torque -= level * math.tanh(10.0 * speed)
    drag = p.quadratic_drag__coefficient
    if p.different:
        torque -= drag * speed * math.sqrt(speed * speed + 4.0)
    else:
        torque -= drag * speed * abs(speed)
    torque -= p.eccentric_load__amplitude * math.sin(angle + p.eccentric_load__phase)
    if p.at_twist >= 0:
        twist, outer = y[p.at_twist], y[p.at_twist + 1]
        wound = max(abs(twist) - 0.5 * p.shaft_backlash__gap, 0.0)
        passed = 0.0
        if wound > 0.0:
            side = 1.0 if twist > 0.0 else -1.0
            damping = p.shaft_backlash__damping
            if p.different:
                damping *= wound / (wound + 8e-3)
            else:
                damping *= min(50.0 * wound, 1.0)
            passed = side * max(p.shaft_backlash__stiffness * wound + damping * (speed - outer) * side, 0.0)
        dy[p.at_twist] = speed - outer
        dy[p.at_twist + 1] = (passed - load) / p.shaft_backlash__inertia
        torque += load - passed
    return torque


@compiled
def _loss_flow(p, difference, speed):
    """Flow that the loss models of the motor let past its chambers at a pressure difference, m3/s."""
    height = abs(difference)
    # Wilson: Cs D dp / mu.
    past = height * p.wilson_losses__slip / p.wilson_losses__viscosity * p.D

    # Schloesser: the same, and Cst D^(2/3) sqrt(2 dp / rho).
    past += height * p.schloesser_losses__slip / p.schloesser_losses__viscosity * p.D
    area, transition = p.schloesser_losses__turbulent_area, 1e4
    if area > 0.0:
        inertia = p.schloesser_losses__density / (2.0 * area * area)
        if p.different:
            gap = math.sqrt(inertia * transition)
            past += 2.0 * height / (gap + math.sqrt(gap * gap + 4.0 * inertia * height))
        else:
            past += math.sqrt(height * height / math.hypot(height, transition) / inertia)

    # Dorey: Wilson's with a coefficient that grows, and what is compressed in every turn and lost.
    coefficient = p.dorey_losses__slip * (1.0 + p.dorey_losses__slip_growth * height)
    past += height * coefficient / p.dorey_losses__viscosity * p.D
    past += p.dorey_losses__compression * p.D * height / p.beta * abs(speed)

    # Jeong: flow in a gap goes with the cube of its height.
    widening = (1.0 + p.jeong_losses__gap_growth * height) ** 3.0
    past += height * widening * p.jeong_losses__slip / p.jeong_losses__viscosity * p.D

    # Ivantysyn and Ivantysynova: terms of second degree.
    past += p.ivantysyn_losses__flow_pp * height**2.0 + p.ivantysyn_losses__flow_pw * abs(speed) * height
    return math.copysign(past, difference)


@compiled
def _loss_torque(p, difference, speed):
    """Torque that the loss models of the motor take, N m, against the motion."""
    ideal, rate = abs(p.D * difference), abs(speed)
    dry = p.wilson_losses__constant_torque + p.wilson_losses__friction * ideal
    wet = p.wilson_losses__drag * p.wilson_losses__viscosity * p.D

    dry += p.schloesser_losses__constant_torque + p.schloesser_losses__friction * ideal
    wet += p.schloesser_losses__drag * p.schloesser_losses__viscosity * p.D
    wet += p.schloesser_losses__hydrodynamic * p.schloesser_losses__density * rate

    rest = math.exp(-rate / p.dorey_losses__boundary_speed)
    dry += p.dorey_losses__friction * ideal * (1.0 + p.dorey_losses__boundary * rest)
    wet += p.dorey_losses__drag * p.dorey_losses__viscosity * p.D

    rest = math.exp(-rate / p.jeong_losses__stribeck_speed)
    contact = p.jeong_losses__constant_torque + p.jeong_losses__friction * ideal
    dry += contact + contact * p.jeong_losses__stribeck * rest
    wet += p.jeong_losses__drag * p.jeong_losses__viscosity * p.D
    wet += p.jeong_losses__hydrodynamic * p.jeong_losses__density * rate

    dry += p.ivantysyn_losses__torque_0 + p.ivantysyn_losses__torque_p * abs(difference)
    wet += p.ivantysyn_losses__torque_ww * rate + p.ivantysyn_losses__torque_pw * abs(difference)
    way = speed / math.hypot(speed, 0.1) if p.different else math.tanh(10.0 * speed)
    return dry * way + wet * speed


@compiled
def _motor_rates(p, y, dy, flow, load, time):
    """Line (1), (3) and shaft (2)."""
    at = p.at_states
    pressure, speed, angle = y[at + 4], y[at + 5], y[at + 6]
    change = p.viscosity_drift__change
    if change != 0.0:
        warm = 1.0 - math.exp(-time / p.viscosity_drift__time_constant)
        if p.different:
            warm += 0.2 * warm * (1.0 - warm)
        change *= warm
    softness = 1.0 / p.beta
    air = p.entrained_air__fraction
    if air != 0.0:
        ratio = 101325.0 / (101325.0 + abs(pressure))
        if p.different:
            softness += air / (1.2 * 101325.0) * ratio ** (2.2 / 1.2)
        else:
            softness += air / 101325.0 * ratio**2
    displacement = p.D
    ripple = p.displacement_ripple__amplitude
    if ripple != 0.0:
        turn = p.displacement_ripple__order * angle
        wave = math.cos(turn)
        if p.different:
            wave += 0.25 * math.cos(2.0 * turn)
        displacement *= 1.0 + ripple * wave
    leakage = p.Km * math.exp(-change) * pressure + p.speed_dependent_leakage__coefficient * speed
    setting = p.crossport_relief__relief_pressure
    if setting != np.inf:
        excess = abs(pressure) - setting
        if p.different:
            excess = 0.5 * (excess + math.sqrt(excess * excess + 0.3e5**2))
            excess *= math.tanh(abs(pressure) / 1e5)
        leakage += math.copysign(max(excess, 0.0) * p.crossport_relief__conductance, pressure)
    if p.lossy:
        leakage += _loss_flow(p, pressure, speed)
    motor_flow = displacement * speed
    dy[at + 4] = (flow - motor_flow - leakage) / (p.V * softness)

    lost = p.line_loss__coefficient * motor_flow
    lost *= math.sqrt(motor_flow * motor_flow + 1e-10) if p.different else abs(motor_flow)
    torque = displacement * (pressure - lost) - p.B * math.exp(change) * speed
    if p.lossy:
        torque -= _loss_torque(p, pressure - lost, speed)
    dy[at + 5] = (torque + _shaft_torque(p, y, dy, speed, angle, load)) / p.J
    dy[at + 6] = speed


@compiled
def _measured(p, y):
    """What the speed sensor shows, rad/s, without noise."""
    shown = y[p.at_states + 5]
    if p.at_lag >= 0:
        shown = y[p.at_lag + 1] if p.different else y[p.at_lag]
    return shown * p.sensor_gain__gain + p.sensor_offset__offset


@compiled
def _rates(time, y, channels):
    """Right-hand side of one or of both channels: `channels` is an array of parameter records."""
    dy = np.zeros(y.size)
    total = 0.0
    for p in channels:
        at = p.at_states
        droop = 0.0
        if p.at_droop >= 0:
            droop = y[p.at_droop + 1] if p.different else y[p.at_droop]
        pressure = y[at + 4]
        flow = _valve_flow(p, y[at + 1], pressure, droop)
        total += abs(flow)
        _spool_rates(p, y, dy, pressure)
        _motor_rates(p, y, dy, flow, p.load, time)
        if p.at_lag >= 0:
            whole = p.sensor_lag__time_constant
            if p.different:
                dy[p.at_lag] = (y[at + 5] - y[p.at_lag]) / (0.7 * whole)
                dy[p.at_lag + 1] = (y[p.at_lag] - y[p.at_lag + 1]) / (0.3 * whole)
            else:
                dy[p.at_lag] = (y[at + 5] - y[p.at_lag]) / whole
    p = channels[0]
    if p.at_droop >= 0:
        # One supply for both valves; `relative_drop` is the drop at the rated flow of two nominal valves.
        target = p.supply_droop__relative_drop * total / _SUPPLY_FLOW
        memory = p.supply_droop__time_constant
        if p.different:
            dy[p.at_droop] = (target - y[p.at_droop]) / (0.7 * memory)
            dy[p.at_droop + 1] = (y[p.at_droop] - y[p.at_droop + 1]) / (0.3 * memory)
        else:
            dy[p.at_droop] = (target - y[p.at_droop]) / memory
    return dy


@compiled
def _look(y, channels, flow, shown):
    """Flow and measured speed of every row of states: y (T, states) -> flow, shown (T, channels)."""
    for t in range(y.shape[0]):
        for c in range(channels.shape[0]):
            p = channels[c]
            droop = 0.0
            if p.at_droop >= 0:
                droop = y[t, p.at_droop + 1] if p.different else y[t, p.at_droop]
            flow[t, c] = _valve_flow(p, y[t, p.at_states + 1], y[t, p.at_states + 4], droop)
            shown[t, c] = _measured(p, y[t])


# --- layout of the states ---------------------------------------------------------------------------------------------
class _Group:
    """Channels that are integrated together: each alone, or both where they share the supply."""

    def __init__(self, model: PlantModel, members: tuple[int, ...], forms: str) -> None:
        self.members = members
        self.channels = np.zeros(
            len(members), dtype=[*_fields(), ("command", np.float64), ("load", np.float64)]
        )
        different = forms == "different"
        scales: list[float] = []

        def place(*of_states: float) -> int:
            scales.extend(of_states)
            return len(scales) - len(of_states)

        for p, c in zip(self.channels, members, strict=True):
            for name in PARAMETERS:
                p[name] = model.value(name, c)
            for effect in map(CATALOGUE.__getitem__, BUILT_IN):
                for parameter in effect.parameters:
                    p[f"{effect.name}__{parameter.name}"] = model.value(f"{effect.name}.{parameter.name}", c)
            p["different"] = different
            p["lossy"] = any(
                CATALOGUE[name].family == FAMILY and not CATALOGUE[name].is_neutral(pair[c])
                for name, pair in model.effects.items()
            )
            p["at_states"] = place(*_STATE_SCALES)
            for name in _SHIFTS:
                p[f"at_{name}"] = -1
            if p["coil_heating__rise"] != 0.0:
                p["at_heat"] = place(0.1)
            if p["magnetic_hysteresis__amplitude"] != 0.0:
                p["at_loop"] = place(*([1.0] * (4 if different else 1)))
            if different and max(p["spool_stiction__coulomb"], p["spool_stiction__static"]) > 0.0:
                p["at_second_bristle"] = place(1e-6)
            if (
                different
                and max(p["motor_coulomb_friction__coulomb"], p["motor_coulomb_friction__static"]) > 0.0
            ):
                p["at_shaft_bristle"] = place(1e-3)
            if p["shaft_backlash__inertia"] > 0.0:
                p["at_twist"] = place(1e-2, 1.0)
            if p["sensor_lag__time_constant"] > 0.0:
                p["at_lag"] = place(*([1.0] * (2 if different else 1)))
        if self.channels["supply_droop__relative_drop"].any():
            self.channels["at_droop"] = place(*([0.1] * (2 if different else 1)))
        self.scales = np.array(scales)
        self.state = np.zeros(len(scales))

    def integrate(self, times: Array, method: str, tolerance: float) -> Array:
        """States at `times` (the first is now), (len(times), states); the last becomes the present state."""
        limits = {"rtol": tolerance, "atol": tolerance * self.scales}
        rows = None
        if method == "LSODA":
            rows, info = odeint(
                _rates, self.state, times, args=(self.channels,), tfirst=True, full_output=True, mxstep=20000,
                printmessg=False, **limits,
            )  # fmt: skip
            if info["message"] != "Integration successful.":
                rows, method = None, "Radau"
        if rows is None:
            found = solve_ivp(
                _rates,
                (times[0], times[-1]),
                self.state,
                method=method,
                t_eval=times,
                args=(self.channels,),
                **limits,
            )
            if not found.success:
                raise RuntimeError(
                    f"reference simulator: {found.message} at t = {found.t[-1] if found.t.size else times[0]}"
                )
            rows = found.y.T
        if not np.isfinite(rows[-1]).all():
            raise RuntimeError(f"reference simulator: a state is not finite after t = {times[0]:g} s")
        self.state = np.array(rows[-1])
        return np.asarray(rows)


class ReferenceRig:
    """One rig of two channels, at rest at time zero.

    `forms` as in `FORMS`; `method` one of SciPy's "LSODA" (fast), "BDF", "Radau" (the strictest); `tolerance` is the
    relative one, absolute ones follow from the scale of each state. The integration starts afresh at every change of a
    command or load, so no solver steps over a jump. InputError for an unknown model or one with a user's effect,
    for which there are no independent equations; ValueError for an unknown form.
    """

    def __init__(
        self, model: str | Path | Mapping[str, Any] | PlantModel, *, forms: str = "same", method: str = "LSODA",
        tolerance: float = 1e-7,
    ) -> None:  # fmt: skip
        if forms not in FORMS:
            raise ValueError(f"forms is {forms!r}, expected one of {', '.join(FORMS)}")
        self.model, self.forms, self.method, self.tolerance = load_model(model), forms, method, tolerance
        for name, acts in self.model.effects.items():
            if name not in BUILT_IN and not all(CATALOGUE[name].is_neutral(values or {}) for values in acts):
                raise InputError(
                    f"{name}: the reference simulator has no equations for this user's effect; use hydro_env.plant.simulate"
                )
        self._delays = self.model.pair("command_delay.delay")
        self._rated = self.model.pair("u_rated")
        self.reset()

    def reset(self) -> None:
        """Puts the rig to rest at time zero."""
        coupled = any(self.model.pair("supply_droop.relative_drop"))
        sets: tuple[tuple[int, ...], ...] = ((0, 1),) if coupled else ((0,), (1,))
        self._groups = [_Group(self.model, members, self.forms) for members in sets]
        self.time = 0.0
        self._coming: tuple[list[tuple[float, float]], ...] = (
            [],
            [],
        )  # (when, voltage) on its way, by channel

    def signals(self) -> dict[str, Array]:
        """All `REFERENCE_SIGNALS` now, each (2,)."""
        out = {name: np.empty((1, 2)) for name in REFERENCE_SIGNALS}
        for group in self._groups:
            self._store(group, group.state[None, :], out, np.array([0]))
        return {name: values[0] for name, values in out.items()}

    def advance(
        self, command_V: ArrayLike, load_Nm: ArrayLike, duration: float, samples: int = 1
    ) -> dict[str, Array]:
        """Holds commands and loads, each (2,), over `duration` s.

        Returns `REFERENCE_SIGNALS`, each (samples, 2), at `samples` evenly spaced instants of which the last is the end.
        Commands beyond the rated one are clipped.
        """
        command = np.broadcast_to(np.asarray(command_V, dtype=float), (2,))
        load = np.broadcast_to(np.asarray(load_Nm, dtype=float), (2,))
        start, end = self.time, self.time + duration
        for c in (0, 1):
            voltage = min(max(float(command[c]), -self._rated[c]), self._rated[c])
            self._coming[c].append((start + self._delays[c], voltage))
        instants = np.linspace(start, end, samples + 1)[1:]
        out = {name: np.empty((samples, 2)) for name in REFERENCE_SIGNALS}
        for group in self._groups:
            for p, c in zip(group.channels, group.members, strict=True):
                p["load"] = load[c]
            self._run(group, start, end, instants, out)
        self.time = end
        return out

    def _run(self, group: _Group, start: float, end: float, instants: Array, out: dict[str, Array]) -> None:
        now = start
        while now < end - _INSTANT:
            until = end
            for p, c in zip(group.channels, group.members, strict=True):
                coming = self._coming[c]
                while coming and coming[0][0] <= now + _INSTANT:
                    p["command"] = coming.pop(0)[1]
                if coming and coming[0][0] < until - _INSTANT:
                    until = coming[0][0]
            rows = np.flatnonzero((instants > now + _INSTANT) & (instants <= until + _INSTANT))
            times = np.concatenate(([now], np.minimum(instants[rows], until)))
            if times[-1] < until - _INSTANT:
                times = np.append(times, until)
            states = group.integrate(times, self.method, self.tolerance)
            self._store(group, states[1 : 1 + rows.size], out, rows)
            now = until

    @staticmethod
    def _store(group: _Group, states: Array, out: dict[str, Array], rows: NDArray[np.intp]) -> None:
        states = np.ascontiguousarray(states)
        flow = np.empty((len(rows), len(group.members)))
        shown = np.empty_like(flow)
        _look(states, group.channels, flow, shown)
        for j, c in enumerate(group.members):
            at = int(group.channels["at_states"][j])
            for n, name in enumerate(_STATES):
                out[name][rows, c] = states[:, at + n]
            out["flow"][rows, c] = flow[:, j]
            out["measured_speed"][rows, c] = shown[:, j]


def simulate_reference(
    model: str | Path | Mapping[str, Any] | PlantModel, command_V: ArrayLike, load_Nm: ArrayLike | None, period: float, *,
    forms: str = "same", method: str = "LSODA", tolerance: float = 1e-7,
) -> dict[str, Array]:  # fmt: skip
    """Simulates a command sequence from rest: `command_V` and `load_Nm` (T, 2), each row held over `period` s.

    Returns `REFERENCE_SIGNALS`, each (T, 2): row n at the instant at which command n begins to act. Options as in
    `ReferenceRig`. ValueError for wrong shapes or values that are not finite.
    """
    command = np.asarray(command_V, dtype=float)
    load = np.zeros_like(command) if load_Nm is None else np.asarray(load_Nm, dtype=float)
    if command.ndim != 2 or command.shape[1] != 2 or load.shape != command.shape:
        raise ValueError(f"command_V {command.shape} and load_Nm {load.shape} must both be (T, 2)")
    if not (np.isfinite(command).all() and np.isfinite(load).all()):
        raise ValueError("a command or load is not finite")
    rig = ReferenceRig(model, forms=forms, method=method, tolerance=tolerance)
    length = command.shape[0]
    out = {name: np.empty((length, 2)) for name in REFERENCE_SIGNALS}
    for name, value in rig.signals().items():
        out[name][:1] = value
    changes = np.flatnonzero(
        (np.diff(command, axis=0) != 0.0).any(axis=1) | (np.diff(load, axis=0) != 0.0).any(axis=1)
    )
    starts = np.concatenate(([0], changes + 1))
    ends = np.concatenate((changes + 1, [length - 1]))  # the last row's command acts only after the log
    for first, last in zip(starts, ends, strict=True):
        if last > first:
            part = rig.advance(command[first], load[first], (last - first) * period, int(last - first))
            for name, values in part.items():
                out[name][first + 1 : last + 1] = values
    return out


def run_closed_loop(
    model: str | Path | Mapping[str, Any] | PlantModel, controller: Callable[[float, dict[str, Array]], ArrayLike],
    period: float, steps: int, *, load: Callable[[float], ArrayLike] | None = None, samples: int = 1, forms: str = "same",
    method: str = "LSODA", tolerance: float = 1e-7,
) -> dict[str, Array]:  # fmt: skip
    """Simulates a closed loop from rest.

    Every `period` s, `controller(time, signals)` gives the voltages (2,) that are held until the next; `signals` are
    `REFERENCE_SIGNALS` now, each (2,). `load(time)` gives the torques (2,). Returns those signals and "command" and
    "load", each (steps * samples, 2), with `samples` rows to a period in the row convention of `simulate_reference`.
    """
    rig = ReferenceRig(model, forms=forms, method=method, tolerance=tolerance)
    out = {name: np.empty((steps * samples, 2)) for name in (*REFERENCE_SIGNALS, "command", "load")}
    signals = rig.signals()
    for n in range(steps):
        time = n * period
        command = np.broadcast_to(np.asarray(controller(time, signals), dtype=float), (2,))
        torque = np.zeros(2) if load is None else np.broadcast_to(np.asarray(load(time), dtype=float), (2,))
        rows = slice(n * samples, (n + 1) * samples)
        out["command"][rows], out["load"][rows] = command, torque
        part = rig.advance(command, torque, period, samples)
        for name, values in part.items():
            out[name][n * samples] = signals[name]
            out[name][n * samples + 1 : (n + 1) * samples] = values[:-1]
            signals[name] = values[-1]
    return out
