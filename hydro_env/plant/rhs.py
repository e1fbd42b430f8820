"""The one right-hand side: two lines of physics for every state of a channel.

`rates` is ordinary Python and can be called as it stands. The compiler (`kernel`) reads its source, inserts
the laws of the chosen effects at the lines that begin with `# effects on`, and turns the result into the vectorised
kernel that the environments, the benchmark and the diagnosis run. Equation numbers are the paper's.
"""

from .vector_math import bell, sqrt


def rates(
    current, spool, spool_speed, bristle, pressure, speed, angle, command, load, time,
    D, J, B, Km, beta, V, m, R, L, alpha, k, C, Kq, Fc, Fs, vs, s0, s1, s2, x_max, k_stop, v_stop, u_rated,
):  # fmt: skip
    """Time derivatives of (current, spool, spool_speed, bristle, pressure, speed, angle) of one channel, SI.

    `command` is the voltage of the driver (V), `load` the torque on the shaft (N m), `time` the time since the reset.
    """
    # Driver and coil, (6); the paper prints "R_i" for R i.
    voltage = command
    # effects on voltage
    resistance = R
    # effects on resistance
    current_rate = (voltage - resistance * current - alpha * spool_speed) / L

    # Friction of the spool: LuGre, (9)-(11); (10) is printed without the factor z.
    breakaway = Fc + (Fs - Fc) * bell(spool_speed / vs)
    relaxation = s0 * bristle * abs(spool_speed) / breakaway
    bristle_rate = spool_speed - relaxation
    friction = s0 * bristle + (s1 + s2) * spool_speed - s1 * relaxation

    # End stops: a stiff spring that damps on the way in and never pulls (Hunt and Crossley 1975), so that a blow is
    # nearly plastic: the spool leaves no faster than v_stop.
    past = abs(spool) - x_max
    outward = spool_speed if spool > 0.0 else -spool_speed
    grip = 1.0 + outward / v_stop
    contact = k_stop * past * grip if past > 0.0 and grip > 0.0 else 0.0
    stop = contact if spool > 0.0 else -contact

    # Spool, (5).
    force = alpha * current
    # effects on force
    spool_speed_rate = (force - k * spool - C * spool_speed - friction - stop) / m
    spool_rate = spool_speed

    # Flow through the valve, (8); `drive` is the share of the supply pressure that drives it.
    opening = spool
    # effects on opening
    drive = 1.0
    # effects on drive
    flow = Kq * opening * sqrt(drive if drive > 0.0 else 0.0)
    # effects on flow

    # Line and motor, (1) and (3).
    bulk_modulus = beta
    # effects on bulk_modulus
    displacement = D
    # effects on displacement
    leakage_coefficient = Km
    # effects on leakage_coefficient
    leakage = leakage_coefficient * pressure
    # effects on leakage
    pressure_rate = bulk_modulus / V * (flow - displacement * speed - leakage)

    # Shaft, (2).
    viscous_friction = B
    # effects on viscous_friction
    motor_pressure = pressure
    # effects on motor_pressure
    torque = -load
    # effects on torque
    speed_rate = (displacement * motor_pressure - viscous_friction * speed + torque) / J
    angle_rate = speed
    return current_rate, spool_rate, spool_speed_rate, bristle_rate, pressure_rate, speed_rate, angle_rate
