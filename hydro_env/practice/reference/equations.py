"""Equations of the rig, one by one, in both forms of every effect: coil and spool, valve flow, line, motor and load, sensor.

`p` is the record of a channel: base parameters by symbol, those of effects as EFFECT__PARAMETER, constants of form as
form_NAME (those of `forms.SAME` are neutral in the same form), `different` for the form, `lines_supply`, the supply pressure of
the effects on single lines, and `at_...`, the places of its states in `y` (-1: it has none). Numbers in brackets are equations of
the paper.
"""

import math

import numpy as np

from ...jit import compiled
from .forms import PLAYS, STOPS

_SUPPLY_FLOW = 2.0 * 476106e-6 * 20.0 * 73.0 / (100.0 * 17000.0)  # m3/s; rated flow of two nominal valves


@compiled
def _limited(value, limit, knee):
    """A limit, hard where `knee` is 0, else the p-norm with this exponent."""
    if knee > 0.0:
        return value / (1.0 + (abs(value) / limit) ** knee) ** (1.0 / knee)
    return min(max(value, -limit), limit)


@compiled
def _rounded(excess, width):
    """What is above zero, with the corner rounded over `width`."""
    return 0.5 * (excess + math.hypot(excess, width))


@compiled
def _against(way, pressure):
    """The load pressure that acts against a way."""
    return pressure if way > 0.0 else (-pressure if way < 0.0 else 0.0)


@compiled
def _lagged(p, y, at, unlagged):
    """What comes out of one lag, or in the different form of two; `unlagged` where there is none (`at` -1)."""
    if at < 0:
        return unlagged
    return y[at + 1] if p.different else y[at]


@compiled
def _lag_rates(p, y, dy, at, target, memory, share):
    """Sets the rates of such a lag of `memory` s; `share` is that of the first of two."""
    if p.different:
        dy[at] = (target - y[at]) / (share * memory)
        dy[at + 1] = (y[at] - y[at + 1]) / ((1.0 - share) * memory)
    else:
        dy[at] = (target - y[at]) / memory


@compiled
def _root(p, drive):
    """Flow of an edge over that at the supply's whole pressure: the root, laminar about zero in the different form."""
    if p.different:
        transition = p.form_orifice_transition**2
        return drive * ((1.0 + transition) / (drive * drive + transition)) ** 0.25
    return math.sqrt(max(drive, 0.0))


@compiled
def _edge_root(p, drop):
    """The same of the edges of single lines, which pass back where a line is above the supply or below the tank."""
    return _root(p, drop) if p.different else math.copysign(math.sqrt(abs(drop)), drop)


@compiled
def _opening(p, spool):
    """Opening of the metering edges, m, as a function of the spool's position."""
    x = spool + p.null_offset__offset
    high, low = p.dead_zone__overlap_positive, p.dead_zone__overlap_negative
    if high != 0.0 or low != 0.0:
        above, below = x - high, x + low
        x = 0.5 * (above + math.sqrt(above * above + p.form_clearance**2))
        x += 0.5 * (below - math.sqrt(below * below + p.form_clearance**2))
    if p.underlap__underlap_positive != 0.0 or p.underlap__underlap_negative != 0.0:
        # What the edges of both directions are open.
        first, second = x + p.underlap__underlap_positive, p.underlap__underlap_negative - x
        x = _rounded(first, p.form_clearance) - _rounded(second, p.form_clearance)
    x = _limited(x, p.flow_saturation__opening_limit, p.form_saturation_knee)
    ratio = p.directional_gain__ratio
    if ratio != 1.0:
        if p.different:
            x *= 0.5 * (1.0 + ratio) + 0.5 * (1.0 - ratio) * math.tanh(x / p.form_gain_blend)
        elif x < 0.0:
            x *= ratio
    curvature = p.flow_gain_nonlinearity__curvature
    if curvature != 0.0:
        share = min(abs(x) * p.R * p.k / (p.alpha * p.u_rated), 1.0)
        x *= 1.0 - curvature + curvature * share**p.form_notch_power
    return x


@compiled
def _drive(p, x, pressure, droop):
    """Pressure drop over both edges that are open, as a share of the supply's pressure."""
    return 1.0 - _against(x, pressure) / p.pressure_dependent_flow__supply_pressure - droop


@compiled
def _valve_flow(p, spool, pressure, droop, mean):
    """Flow through the valve, m3/s, (8) with the orifice law of (7) where an effect asks for it.

    `mean` is by how much the mean pressure of the lines exceeds half the supply's, as a share of that.
    """
    x = _opening(p, spool)
    drive = _drive(p, x, pressure, droop)
    if p.at_mean >= 0:
        passed = 0.5 * (_edge_root(p, drive - mean) + _edge_root(p, drive + mean))
        flow = p.Kq * x * (passed if p.different else max(passed, 0.0))
    else:
        flow = p.Kq * x * _root(p, drive)
    width = p.underlap__underlap_positive + p.underlap__underlap_negative
    if width > abs(x):
        # The smaller edge passes as much as the opening lacks, at the drop of the other direction.
        smaller = 0.5 * (width - abs(x))
        way = -1.0 if x < 0.0 else 1.0
        share = way * pressure / p.underlap__supply_pressure
        here = drive if x != 0.0 else drive - share
        flow -= way * p.Kq * smaller * (_root(p, here + 2.0 * share) - _root(p, here))
    return flow


@compiled
def _outflow(p, line, leak):
    """Flow from a line with this leak to the tank, m3/s, less what it draws from there through its check valve.

    The conductance of a leak is that at half the supply pressure, that of the check valve at 1 bar.
    """
    driving = max(line, 0.0)
    below = max(p.anti_cavitation__opening_pressure - line, 0.0)
    if p.different:
        half = 0.5 * p.lines_supply
        driving = half * (driving / half) ** p.form_leak_power
        # The poppet lifts over its spring, then the valve is an orifice.
        lift = p.form_check_lift
        below = below**2 / (2.0 * lift) if below < lift else below - 0.5 * lift
        below = 1e5 * (below / 1e5) ** p.form_check_power
    drained = (max(leak, 0.0) + p.case_drain__conductance) * driving
    return drained - p.anti_cavitation__conductance * below


@compiled
def _played(p, y, dy):
    """The command behind the play at the valve's input, V."""
    if p.at_play < 0:
        return p.command
    out, count = 0.0, PLAYS if p.different else 1
    for j in range(count):
        spread = (j - 1) * p.form_play_spread if p.different else 0.0
        half = 0.5 * p.input_hysteresis__width * (1.0 + spread)
        gap = p.command - y[p.at_play + j]
        held = min(max(gap, -half), half)
        dy[p.at_play + j] = (gap - held) / 5e-5
        out += (p.command - held) / count
    return out


@compiled
def _magnetic_force(p, y, dy, current_rate):
    """Force of the solenoid, N; sets the rates of the hysteresis."""
    force = p.alpha * y[p.at_states]
    if p.at_loop >= 0:
        width = max(p.magnetic_hysteresis__width, 2.0 * p.magnetic_hysteresis__amplitude / p.alpha)
        if p.different:
            for j in range(STOPS):
                s = y[p.at_loop + j]
                free = 1.0
                if s * current_rate > 0.0:
                    free = max(1.0 - abs(s) ** p.form_stop_softness, 0.0)
                dy[p.at_loop + j] = free * current_rate / (width * p.form_stop_travels[j])
                force -= p.form_stop_shares[j] * p.magnetic_hysteresis__amplitude * s
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
    friction = p.s2 * v
    if max(coulomb, static) > 0.0:
        peak = math.exp(-((v / p.vs) ** 2))
        # What moves no spool, less than 0.1 mN, would be too stiff for the solver with bristles that do not soften.
        least = min(1e-4, max(coulomb, static) / 20.0)
        coulomb, static = max(coulomb, least), max(static, least)
        soft = min(1.0, min(coulomb, static) / 1e-4)
        z_rate = v - abs(v) * soft * p.s0 / (coulomb + (static - coulomb) * peak) * z
        dy[p.at_states + 3] = z_rate
        friction = soft * (p.s0 * z + p.s1 * z_rate) + p.s2 * v
    if p.at_second_bristle >= 0:
        z = y[p.at_second_bristle]
        coulomb, static = p.spool_stiction__coulomb, p.spool_stiction__static
        stiffness = p.form_bristle_stiffness * p.s0
        peak = math.exp(-((v / (p.form_bristle_stribeck * p.vs)) ** 2))
        limit = (coulomb + (static - coulomb) * peak) / stiffness
        # Purely elastic up to a share of the limit, then ever more plastic.
        elastic = p.form_bristle_elastic
        plastic = 0.0
        if z * v > 0.0 and abs(z) > elastic * limit:
            plastic = 1.0
            if abs(z) < limit:
                plastic = 0.5 - 0.5 * math.cos(math.pi * (abs(z) / limit - elastic) / (1.0 - elastic))
                plastic **= p.form_bristle_yield
        z_rate = v - plastic * abs(v) * z / limit
        dy[p.at_second_bristle] = z_rate
        friction += stiffness * z + p.form_bristle_damping * p.s1 * z_rate
    return friction


@compiled
def _spool_rates(p, y, dy, pressure):
    """Coil (6), spool (5) and all that acts on them."""
    at = p.at_states
    i, x, v = y[at], y[at + 1], y[at + 2]
    voltage = _limited(_played(p, y, dy), p.driver_saturation__voltage_limit, p.form_driver_knee)
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
            force -= preload * x / math.sqrt(x * x + p.form_preload_travel**2)
        else:
            force -= preload * math.tanh(x / 20e-6)
    if p.flow_force__coefficient != 0.0:
        travel = x
        if p.different:
            open_ = _opening(p, x)
            travel = open_ * math.sqrt(1.0 + (p.form_clearance / max(abs(open_), p.form_clearance)) ** 2)
        drop = max(p.flow_force__supply_pressure - _against(travel, pressure), 0.0)
        force -= p.flow_force__coefficient * travel * drop

    stop = 0.0
    beyond = abs(x) - min(p.x_max, p.spool_stop__travel)
    if beyond > 0.0:
        side = 1.0 if x > 0.0 else -1.0
        nearer = p.spool_stop__travel < p.x_max
        yields = (beyond / p.form_stop_depth) ** (p.form_stop_power - 1.0) if nearer else 1.0
        # Hunt and Crossley: pushes, never pulls
        stop = -side * max(p.k_stop * beyond * yields * (1.0 + v * side / p.v_stop), 0.0)
    friction = _spool_friction(p, y, dy)
    dy[at + 2] = (force + stop - p.k * x - p.C * v - friction) / p.m


@compiled
def _shaft_torque(p, y, dy, speed, angle, load):
    """Torque on the motor's shaft besides that of the pressure and of viscous friction, N m."""
    torque = -load - p.load_bias__bias
    coulomb, static = p.motor_coulomb_friction__coulomb, p.motor_coulomb_friction__static
    if coulomb != 0.0 or static != 0.0:
        peak = math.exp(-(abs(speed / p.motor_coulomb_friction__stribeck_speed) ** p.form_shaft_stribeck))
        level = coulomb + (static - coulomb) * peak
        if p.different:
            stiffness = max(coulomb, static) / p.form_shaft_travel
            damping = 2.0 * p.form_shaft_damping * math.sqrt(stiffness * p.J)
            damping *= math.exp(-((speed / p.form_shaft_damping_speed) ** 2))
            z = y[p.at_shaft_bristle]
            z_rate = speed - abs(speed) * stiffness * z / level
            dy[p.at_shaft_bristle] = z_rate
            torque -= stiffness * z + damping * z_rate
        else:
            torque -= level * math.tanh(10.0 * speed)
    torque -= p.quadratic_drag__coefficient * speed * math.hypot(speed, p.form_drag_transition)
    torque -= p.eccentric_load__amplitude * math.sin(angle + p.eccentric_load__phase)
    if p.at_twist >= 0:
        twist, outer = y[p.at_twist], y[p.at_twist + 1]
        wound = max(abs(twist) - 0.5 * p.shaft_backlash__gap, 0.0)
        passed = 0.0
        if wound > 0.0:
            side = 1.0 if twist > 0.0 else -1.0
            grown = wound / (wound + p.form_backlash_damping) if p.different else min(50.0 * wound, 1.0)
            damping = p.shaft_backlash__damping * grown
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
    area = p.schloesser_losses__turbulent_area
    if area > 0.0:
        inertia = p.schloesser_losses__density / (2.0 * area * area)
        if p.different:
            gap = math.sqrt(inertia * p.form_gap_transition)
            past += 2.0 * height / (gap + math.sqrt(gap * gap + 4.0 * inertia * height))
        else:
            past += math.sqrt(height * height / math.hypot(height, 1e4) / inertia)

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
    way = speed / math.hypot(speed, p.form_dry_speed) if p.different else math.tanh(10.0 * speed)
    return dry * way + wet * speed


@compiled
def _above(p, pressure, setting):
    """Pressure above a setting, Pa; rounded where a poppet cracks in the different form."""
    excess = pressure - setting
    if p.different:
        rounding = p.form_relief_rounding
        return _rounded(excess, rounding) * math.tanh(max(pressure, 0.0) / rounding)
    return max(excess, 0.0)


@compiled
def _relief_flow(p, y, dy, pressure):
    """Flow through the relief valves between the ports, m3/s; sets the rates at which their poppets lift, each in Pa above
    the setting."""
    setting, half = p.crossport_relief__relief_pressure, 0.5 * p.crossport_relief__hysteresis
    lag = p.crossport_relief__time_constant
    total = 0.0
    for j in range(2):
        way = 1.0 - 2.0 * j
        lift = y[p.at_lift + j]
        least = _above(p, way * pressure, setting * (1.0 + half))
        most = _above(p, way * pressure, setting * (1.0 - half))
        wanted = min(max(lift, least), most)
        slower = p.form_relief_closing if p.different and wanted < lift else 1.0
        dy[p.at_lift + j] = (wanted - lift) / max(lag * slower, 5e-5)
        share = abs(pressure) / setting
        power = p.form_relief_growth if share > 1.0 else 0.5
        through = share**power if p.different else math.sqrt(min(share, 1.0))
        total += math.copysign((lift if lag > 0.0 else wanted) * through, pressure)
    return p.crossport_relief__conductance * total


@compiled
def _displacement(p, angle):
    """Displacement at an angle of the shaft, m3/rad."""
    ripple = p.displacement_ripple__amplitude
    if ripple == 0.0:
        return p.D
    turn = p.displacement_ripple__order * angle
    wave = math.cos(turn)
    wave += p.form_ripple_second * math.cos(2.0 * turn + p.form_ripple_phase)
    return p.D * (1.0 + ripple * wave)


@compiled
def _at_motor(p, pressure, motor_flow):
    """Load pressure at the ports of the motor, Pa."""
    return pressure - p.line_loss__coefficient * motor_flow * math.hypot(motor_flow, p.form_line_transition)


@compiled
def _motor_rates(p, y, dy, flow, load, time, droop):
    """Line (1), (3) and shaft (2)."""
    at = p.at_states
    pressure, speed, angle = y[at + 4], y[at + 5], y[at + 6]
    change = p.viscosity_drift__change
    if change != 0.0:
        warm = 1.0 - math.exp(-time / p.viscosity_drift__time_constant)
        warm += p.form_drift_bend * warm * (1.0 - warm)
        change *= warm
    softness = 1.0 / p.beta
    air = p.entrained_air__fraction
    if air != 0.0:
        ratio = 101325.0 / (101325.0 + abs(pressure))
        if p.different:
            n = p.form_air_exponent
            softness += air / (n * 101325.0) * ratio ** ((n + 1.0) / n)
        else:
            softness += air / 101325.0 * ratio**2
    displacement = _displacement(p, angle)
    leakage = p.Km * math.exp(-change) * pressure + p.speed_dependent_leakage__coefficient * speed
    if p.at_lift >= 0:
        leakage += _relief_flow(p, y, dy, pressure)
    if p.at_mean >= 0:
        mean = y[p.at_mean]
        middle, leak = 0.5 * p.lines_supply * (1.0 + mean), p.external_leakage__conductance
        a, b = _outflow(p, middle + 0.5 * pressure, leak), _outflow(p, middle - 0.5 * pressure, -leak)
        leakage += 0.5 * (a - b)
        # The mean pressure, as a share of half the supply's. Each line holds twice the volume that both have in series.
        x = _opening(p, y[at + 1])
        drive = _drive(p, x, pressure, droop)
        gained = p.Kq * abs(x) * (_edge_root(p, drive - mean) - _edge_root(p, drive + mean))
        dy[p.at_mean] = (gained - a - b) / (2.0 * p.V * softness * p.lines_supply)
    if p.at_side >= 0:
        drop = pressure - y[p.at_side]
        if p.different:
            drop = math.copysign(1e5 * (abs(drop) / 1e5) ** p.form_throttle_power, drop)
        passed = p.line_volume__conductance * drop
        dy[p.at_side] = p.beta * passed / p.line_volume__volume
        leakage += passed
    leakage += _loss_flow(p, pressure, speed)
    motor_flow = displacement * speed
    dy[at + 4] = (flow - motor_flow - leakage) / (p.V * softness)

    at_motor = _at_motor(p, pressure, motor_flow)
    torque = displacement * at_motor - p.B * math.exp(change) * speed
    torque -= _loss_torque(p, at_motor, speed)
    dy[at + 5] = (torque + _shaft_torque(p, y, dy, speed, angle, load)) / p.J
    dy[at + 6] = speed


@compiled
def rates(time, y, channels):
    """Right-hand side of one or of both channels: `channels` is an array of parameter records."""
    dy = np.zeros(y.size)
    total = 0.0
    for p in channels:
        at = p.at_states
        droop = _lagged(p, y, p.at_droop, 0.0)
        pressure = y[at + 4]
        flow = _valve_flow(p, y[at + 1], pressure, droop, y[p.at_mean] if p.at_mean >= 0 else 0.0)
        total += abs(flow)
        _spool_rates(p, y, dy, pressure)
        _motor_rates(p, y, dy, flow, p.load, time, droop)
        if p.at_lag >= 0:
            _lag_rates(p, y, dy, p.at_lag, y[at + 5], p.sensor_lag__time_constant, p.form_lag_share)
    p = channels[0]
    if p.at_droop >= 0:
        # One supply for both valves; `relative_drop` is the drop at the rated flow of two nominal valves.
        target = p.supply_droop__relative_drop * total / _SUPPLY_FLOW
        _lag_rates(p, y, dy, p.at_droop, target, p.supply_droop__time_constant, p.form_supply_share)
    return dy


@compiled
def outputs(y, channels, flow, shown, lines, at_motor):
    """Flow, measured speed (without noise), mean line pressure and motor pressure of every row of states: y (T, states) -> (T,
    channels) each."""
    for t in range(y.shape[0]):
        for c in range(channels.shape[0]):
            p = channels[c]
            droop = _lagged(p, y[t], p.at_droop, 0.0)
            mean = y[t, p.at_mean] if p.at_mean >= 0 else 0.0
            pressure, speed, angle = y[t, p.at_states + 4], y[t, p.at_states + 5], y[t, p.at_states + 6]
            flow[t, c] = _valve_flow(p, y[t, p.at_states + 1], pressure, droop, mean)
            shown[t, c] = _lagged(p, y[t], p.at_lag, speed) * p.sensor_gain__gain + p.sensor_offset__offset
            # Half the sum of both above the tank's; of a model without a supply pressure what differs from it.
            supply = p.pressure_dependent_flow__supply_pressure
            level = 0.0 if supply == np.inf else 0.5 * supply * (1.0 - droop)
            lines[t, c] = level + 0.5 * p.lines_supply * mean
            at_motor[t, c] = _at_motor(p, pressure, _displacement(p, angle) * speed)
