"""Effects of the line between valve and motor: fluid, hoses, relief and check valves."""

from dataclasses import replace
from functools import partial
from math import inf

from ..parameters import MOTOR_SIZE, SUPPLY_PRESSURE, Parameter, assumed
from ..vector_math import clip, positive, sign, sqrt
from .effect import Effect, State

_effect = partial(Effect, port="line")


def _entrained_air(bulk_modulus, pressure, fraction):
    absolute = 101325.0 + abs(pressure)
    return bulk_modulus / (1.0 + fraction * bulk_modulus * 101325.0 / (absolute * absolute))


ENTRAINED_AIR = _effect(
    name="entrained_air",
    title="air in the oil",
    summary="free air makes the fluid soft at low pressure",
    signature="slow first pressure rise",
    source="isothermal air in parallel with the liquid, Manring 2005",
    parameters=(
        Parameter("fraction", "1", 0.0, low=0.0, high=0.1, typical=0.02,
            note="share of free air; by volume at 1 atm", source="0.5-5 % at atmospheric pressure are usual"),
    ),
    laws={"bulk_modulus": _entrained_air},
)  # fmt: skip


def _line_loss(motor_pressure, displacement, speed, coefficient):
    motor_flow = displacement * speed
    return motor_pressure - coefficient * motor_flow * abs(motor_flow)


LINE_LOSS = _effect(
    name="line_loss",
    title="pressure loss in the lines",
    summary="turbulent pressure loss between valve and motor",
    signature="loss only at high flow",
    source="Darcy-Weisbach, fittings; dp = c Q |Q|",
    parameters=(
        assumed("coefficient", "Pa s2/m6", 0.0, low=0.0, high=3e14, typical=4e13, scaling={"D": -2.0},
            note="pressure loss per flow squared"),
    ),
    laws={"motor_pressure": _line_loss},
    indistinguishable_from=("quadratic_drag",),
    separated_by={
        "quadratic_drag": "drive the motor from outside with the valve closed and both ports connected: drag acts, line loss "
        "does not; or log the pressure at the motor's ports (motor_pressure)",
    },
)  # fmt: skip


# The lift of an open relief valve is given as the pressure above the setting that would hold it there. Dry friction lets it rest
# between the line on which it opens and the one on which it closes; without friction both are the dead zone of the setting.
# Each direction has its own valve, which lags on its own.
def _lift_at_rest(lift, size, relief_pressure, hysteresis):
    low = size - relief_pressure * (1.0 + 0.5 * hysteresis)
    high = size - relief_pressure * (1.0 - 0.5 * hysteresis)
    return clip(lift, positive(low), positive(high))


def _crossport_relief(
    leakage, pressure, lift, lift_back, relief_pressure, conductance, hysteresis, time_constant
):
    size = abs(pressure)
    held = _lift_at_rest(lift if pressure > 0.0 else lift_back, size, relief_pressure, hysteresis)
    lifted = lift + lift_back if time_constant > 0.0 else held
    # Below its setting it is open only as it lags or sticks; its flow then falls with the root of the pressure.
    share = size / relief_pressure
    root = sqrt(share if share < 1.0 else 1.0)
    return leakage + sign(pressure) * conductance * lifted * root


def _lift_rate(lift, pressure, way, relief_pressure, hysteresis, time_constant):
    held = _lift_at_rest(lift, way * pressure, relief_pressure, hysteresis)
    # Without friction and lag the pressure says it all; a lift that fades for ever would only cost time.
    moves = 1.0 if hysteresis > 0.0 or time_constant > 0.0 else 0.0
    return moves * (held - lift) / (time_constant if time_constant > 1e-4 else 1e-4)


CROSSPORT_RELIEF = _effect(
    name="crossport_relief",
    title="opening of the cross-port relief valves",
    summary="relief valves between the ports open above their setting, with hysteresis and lag where they have them",
    signature="clipped pressure difference; with hysteresis it opens higher than it closes",
    source="override straight as in data sheets; ISO 6403, opening and reseating pressure; poppet with friction and damping, "
    "Merritt 1967, ch. 8",
    parameters=(
        assumed("relief_pressure", "Pa", inf, low=5e5, high=350e5, typical=15e5, log=True,
            note="setting of the relief valves; midway between opening and reseating"),
        assumed("conductance", "m3/(s Pa)", 1e-9, low=1e-10, high=3e-9, log=True, scaling=MOTOR_SIZE,
            note="slope of the open relief valves"),
        Parameter("hysteresis", "1", 0.0, low=0.0, high=0.4,
            note="opening less reseating pressure, as a share of the setting",
            source="direct-operated valves reseat at 80 to 95 % of their opening pressure, worn or dirty ones lower"),
        Parameter("time_constant", "s", 0.0, low=0.0, high=0.03,
            note="lag of the relief valves",
            source="response of direct-operated valves 2 to 10 ms, of pilot-operated ones 20 to 100 ms"),
    ),
    laws={"leakage": _crossport_relief},
    states=(
        State("lift", _lift_rate, scale=3e4, given={"way": 1.0}),
        State("lift_back", _lift_rate, scale=3e4, given={"lift": "lift_back", "way": -1.0}),
    ),
)  # fmt: skip


# Pressures of both lines from their difference and from their mean, whose deviation from half the supply, as a share of that, is
# a state. Oil that both lines gain or lose moves it; the edges of the valve bring it back to the middle.
def _drive_of_both_edges(drive, mean_pressure):
    # The mean of both edges' roots, squared; exactly the one drive while the mean pressure is half the supply. Where the mean is
    # further off than the drive, one line is above the supply or below the tank, and its edge passes back.
    off = abs(mean_pressure)
    product = drive * drive - off * off
    root = sqrt(abs(product))
    driven = 0.5 * (drive + root if product > 0.0 else off - root)
    return driven if drive > 0.0 else drive


def _gained_at_the_edges(mean_pressure, opening, drive, bulk_modulus, V, Kq, supply_pressure):
    # By which the root of the filling edge exceeds that of the emptying one, of what `drive` is above. Beyond the supply pressure
    # it is the one drive of both edges; as the load pressure moves no oil there, the mean alone does.
    off = abs(mean_pressure)
    beyond = sqrt(off - drive if drive < 0.0 else 0.0) + sign(off + drive) * sqrt(abs(off + drive))
    back = 2.0 * sqrt(positive(off - drive))
    forth = off / sqrt(drive if drive > 1e-12 else 1e-12)
    apart = beyond if drive <= 0.0 else back if drive < 0.5 * off else forth
    return -bulk_modulus / (2.0 * V * supply_pressure) * Kq * abs(opening) * sign(mean_pressure) * apart


def _decay_by_the_edges(mean_pressure, opening, drive, bulk_modulus, V, Kq, supply_pressure):
    share = 0.5 * abs(mean_pressure)
    share = drive if drive > share else share
    slopes = 1.0 / sqrt(share if share > 0.01 else 0.01)
    return bulk_modulus / (2.0 * V * supply_pressure) * Kq * abs(opening) * slopes


def _off_the_middle(mean_line_pressure, mean_pressure, supply_pressure):
    return mean_line_pressure + 0.5 * supply_pressure * mean_pressure


BOTH_LINES = _effect(
    name="lines",
    title="pressures of both lines",
    summary="the mean pressure of both lines leaves the middle of the supply where they lose or gain oil",
    signature="mean of both line pressures; flow through the edges of the valve",
    source="mean pressure of the lines from the flows of both edges, Merritt 1967, ch. 5 and 6",
    parameters=(SUPPLY_PRESSURE,),
    laws={"drive": _drive_of_both_edges, "mean_line_pressure": _off_the_middle},
    states=(State("mean_pressure", _gained_at_the_edges, _decay_by_the_edges, scale=0.01),),
)


# Pressure of a line above the tank's; half: 0.5 for the line that drives in the positive direction, -0.5 for the other one.
def _line_pressure(half, pressure, mean_pressure, supply_pressure):
    middle = 0.5 * supply_pressure * (1.0 + mean_pressure)
    return positive(middle + half * pressure)


def _leaking_line(pressure, mean_pressure, conductance, supply_pressure):
    return _line_pressure(0.5 if conductance > 0.0 else -0.5, pressure, mean_pressure, supply_pressure)


def _external_leakage(leakage, pressure, mean_pressure, conductance, supply_pressure):
    line = _leaking_line(pressure, mean_pressure, conductance, supply_pressure)
    return leakage + 0.5 * conductance * line


def _drained(mean_pressure, pressure, bulk_modulus, V, conductance, supply_pressure):
    line = _leaking_line(pressure, mean_pressure, conductance, supply_pressure)
    return -bulk_modulus / (2.0 * V * supply_pressure) * abs(conductance) * line


EXTERNAL_LEAKAGE = _effect(
    name="external_leakage",
    title="a leak from a line to the tank",
    summary="one line loses oil to the tank, in proportion to its own pressure",
    signature="slower where the leaking line drives, faster the other way, much as a null offset; the lines drain at rest",
    source="laminar leak; mean pressure of the lines from the flows of both edges, Merritt 1967, ch. 5 and 6",
    parameters=(
        Parameter("conductance", "m3/(s Pa)", 0.0, low=-1e-10, high=1e-10, typical=4e-12, scaling=MOTOR_SIZE,
            note="conductance of the leak; positive: of the line that drives in the positive direction, negative: of the other",
            source="assumed: 4 % of the rated flow at half of 100 bar"),
        SUPPLY_PRESSURE,
    ),
    laws={"leakage": _external_leakage},
    states=(State("mean_pressure", _drained, scale=0.01),),
    shares=BOTH_LINES,
    separated_by={"null_offset": "record the pressure of each line: a leak lowers that of its own"},
)  # fmt: skip


# Pressure by which a line is below the one at which its check valve opens; `half` as in `_line_pressure`.
def _suction(half, pressure, mean_pressure, opening_pressure, supply_pressure):
    middle = opening_pressure - 0.5 * supply_pressure * (1.0 + mean_pressure)
    return positive(middle - half * pressure)


def _made_up(leakage, pressure, mean_pressure, conductance, opening_pressure, supply_pressure):
    a = _suction(0.5, pressure, mean_pressure, opening_pressure, supply_pressure)
    b = _suction(-0.5, pressure, mean_pressure, opening_pressure, supply_pressure)
    return leakage - 0.5 * conductance * (a - b)


def _filled(mean_pressure, pressure, bulk_modulus, V, conductance, opening_pressure, supply_pressure):
    a = _suction(0.5, pressure, mean_pressure, opening_pressure, supply_pressure)
    b = _suction(-0.5, pressure, mean_pressure, opening_pressure, supply_pressure)
    return bulk_modulus / (2.0 * V * supply_pressure) * (conductance * (a + b))


ANTI_CAVITATION = _effect(
    name="anti_cavitation",
    title="anti-cavitation (make-up) check valves",
    summary="a line that the motor empties draws oil from the tank through a check valve, which opens gradually",
    signature="in a quick stop or under an overrunning load the drained line stays near tank pressure and load pressure "
    "changes more slowly",
    source="flow in proportion to the pressure below the opening one, as in data sheets; mean pressure of the lines from the "
    "flows of both edges, Merritt 1967, ch. 5 and 6",
    parameters=(
        Parameter("conductance", "m3/(s Pa)", 0.0, low=0.0, high=3e-9, typical=1e-9, scaling=MOTOR_SIZE,
            note="slope of the open check valves",
            source="assumed: 6 l/min at 1 bar; valves of sizes 6 to 10 pass 2 to 18 l/min"),
        Parameter("opening_pressure", "Pa", -0.3e5, low=-1e5, high=5e5, absolute=True,
            note="pressure of a line at which its valve opens; above the tank's: below 0 by the spring, above 0 where the "
            "return line is boosted",
            source="cracking pressures of 0.05 to 1 bar are usual; boosted return lines have 2 to 5 bar"),
        # The valves open where the load pressure exceeds the supply's less twice their own.
        replace(SUPPLY_PRESSURE, low=10e5, possible=(10e5, 350e5), starts=(20e5, 30e5, 45e5, 70e5, 100e5)),
    ),
    laws={"leakage": _made_up},
    states=(State("mean_pressure", _filled, scale=0.0025),),
    shares=BOTH_LINES,
)  # fmt: skip


def _volume_behind_a_throttle(leakage, pressure, side_pressure, conductance):
    return leakage + conductance * (pressure - side_pressure)


def _side_pressure_rate(side_pressure, pressure, bulk_modulus, conductance, volume):
    return bulk_modulus / volume * conductance * (pressure - side_pressure)


LINE_VOLUME = _effect(
    name="line_volume",
    title="a volume behind a throttle",
    summary="a long line, hose or vessel takes oil through a throttle and gives it back",
    signature="flow that is missing while the pressure rises and comes back as it falls, with memory",
    source="lumped line: capacity V / beta behind a laminar resistance, Merritt 1967, ch. 3",
    parameters=(
        assumed("conductance", "m3/(s Pa)", 0.0, low=0.0, high=1e-9, typical=1e-10, scaling=MOTOR_SIZE,
            note="conductance of the throttle"),
        Parameter("volume", "m3", 1e-3, low=5e-4, high=3e-2, log=True, scaling=MOTOR_SIZE,
            note="volume behind it, of oil as stiff as the line's",
            source="assumed: 1 l; a hose or a gas-loaded vessel counts as many times its size"),
    ),
    laws={"leakage": _volume_behind_a_throttle},
    states=(State("side_pressure", _side_pressure_rate, scale=5e3),),
)  # fmt: skip


def _case_drain(leakage, pressure, mean_pressure, conductance, supply_pressure):
    a = _line_pressure(0.5, pressure, mean_pressure, supply_pressure)
    b = _line_pressure(-0.5, pressure, mean_pressure, supply_pressure)
    return leakage + 0.5 * conductance * (a - b)


def _drained_alike(mean_pressure, pressure, bulk_modulus, V, conductance, supply_pressure):
    a = _line_pressure(0.5, pressure, mean_pressure, supply_pressure)
    b = _line_pressure(-0.5, pressure, mean_pressure, supply_pressure)
    return -bulk_modulus / (2.0 * V * supply_pressure) * conductance * (a + b)


CASE_DRAIN = _effect(
    name="case_drain",
    title="a case drain of both lines",
    summary="both lines lose oil to the tank through the motor's case, each in proportion to its own pressure",
    signature="like internal leakage, and both lines stand below the middle of the supply, in either direction alike",
    source="external leakage of a motor, Merritt 1967, ch. 4; mean pressure of the lines, ch. 5 and 6",
    parameters=(
        replace(EXTERNAL_LEAKAGE.parameter("conductance"), low=0.0, possible=(0.0, 1e-10),
            note="conductance of the drain from either line"),
        SUPPLY_PRESSURE,
    ),
    laws={"leakage": _case_drain},
    states=(State("mean_pressure", _drained_alike, scale=0.01),),
    shares=BOTH_LINES,
    separated_by={"external_leakage": "record the pressure of each line, in both directions: a case drain lowers both alike"},
)  # fmt: skip


#: In the order in which they act.
EFFECTS = (
    ENTRAINED_AIR, LINE_LOSS, CROSSPORT_RELIEF, EXTERNAL_LEAKAGE, ANTI_CAVITATION, LINE_VOLUME, CASE_DRAIN,
)  # fmt: skip
