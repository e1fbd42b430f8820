"""A controller as a project for a PLC: its function block, a fallback, scaling of analogue cards, modes, watchdog, a task.

The text `templates/plc.st` is the same for all controllers but for the sensors that these use. It is written twice: as
Structured Text, and as PLCopen XML, which engineering tools import (`plcopen`).
"""

from dataclasses import dataclass
from pathlib import Path

from hydro_env import __version__
from hydro_env.errors import InputError
from hydro_env.plant import Scales, load_model, scales_of
from hydro_env.units import BAR, RPM

from .controllers import texts_of, tuned_on, write_program
from .plcopen import plcopen_xml
from .structured_text import INPUTS, block_name
from .templates import template
from .tracing import Program, measured_by

#: Signals of sensors, and the raw value at their lower end as a share of that at the upper one.
SIGNALS = {"10V": -1, "4-20mA": 0}
#: How long a speed may stay the same, to the last digit, against a command that has changed much, s.
FROZEN = 0.2
#: Of each kind of sensor: the unit of its range, that unit in SI, the tens of its fault code, and the range on the paper's rig.
_KINDS = {"Speed": ("rpm", RPM, 1, 1200.0), "Current": ("A", 1.0, 3, 2.0), "Pressure": ("bar", BAR, 4, 100.0)}
#: What the project says of each sensor, and of each kind of sensor, by the place in the template.
_PARTS = {
    "raw": "    {name}Raw{at} : INT; (* from the card *)\n",
    "ranges": """    {kind}RawLow : INT := {low};
    {kind}RawHigh : INT := {full};
    {kind}Low : LREAL := {bottom}; (* {unit} at {kind}RawLow *)
    {kind}High : LREAL := {top}; (* {unit} at {kind}RawHigh *)\n""",
    "instances": "    {name}Input : AnalogInput;\n",
    "readings": "{name}Input(Raw := {name}Raw, RawLow := {kind}RawLow, RawHigh := {kind}RawHigh, Low := {kind}Low, "
    "High := {kind}High, Drive := Command{channel}, FrozenCommand := FrozenCommand, FrozenCalls := {calls}, Reset := Restart);\n",
    "causes": "IF (Cause = 50) AND {name}Input.OutOfRange THEN\n    Cause := {code};\nEND_IF;\n",
    "codes": "{code} {name} out of range; ",
}  # fmt: skip


@dataclass(frozen=True)
class Cards:
    """What is known of the analogue cards: the raw value at 10 V or 20 mA, the signal of the sensors (of `SIGNALS`), and whether
    the variables are declared as TwinCAT links them."""

    full_scale: int = 27648
    signal: str = "10V"
    twincat: bool = False


def plc_files(
    spec: str, folder: Path, period: float, plant: str | None, single: bool, trust: bool, fallback: str, cards: Cards
) -> None:  # fmt: skip
    """Writes plc.st, plc.xml and export.json. `fallback` is a controller that goes by the speeds alone.

    InputError for controllers that have no Structured Text, a fallback that needs other sensors, and an unknown signal.
    """
    if cards.signal not in SIGNALS:
        raise InputError(f"--signal is {cards.signal!r}; {' or '.join(SIGNALS)} is right")
    program, block = texts_of("st", spec, period, plant, single, trust)
    own = block_name(program)
    other, second = texts_of("st", fallback, period, plant, single, trust, f"Fallback_{own}")
    if measured_by(other) & set(range(3, 7)):
        why = "which needs currents or pressures; one that goes by speeds is right"
        raise InputError(f"--fallback is {fallback!r}, {why}")
    rig = scales_of(load_model(plant or tuned_on(spec)))
    text = template("plc.st").substitute(
        blocks="\n".join((block | second).values()), controller_block=own, fallback_block=block_name(other), period=repr(period),
        seconds=f"LREAL#{period!r}", milliseconds=f"{1e3 * period:.6g}", full=cards.full_scale,
        to_card=" AT %Q*" if cards.twincat else "", frozen=max(1, round(FROZEN / period)), top=_number(1200.0 * rig.speed),
        ramp=_number(600.0 * rig.speed), fallback_inputs=_call(other), controller_inputs=_call(program),
        **_sensors(program, rig, cards),
    )  # fmt: skip
    xml = plcopen_xml(text, own, period, __version__)
    write_program(folder, "plc", spec, program, {"plc.st": text, "plc.xml": xml})


def _number(value: float) -> str:
    """A default that somebody will change, to two digits."""
    return f"LREAL#{float(f'{value:.2g}')!r}"


def _used(program: Program) -> list[str]:
    """Its sensors, as the block's inputs are called; the speeds are always watched."""
    used = {1, 2} | (measured_by(program) & {3, 4, 5, 6})
    return [name for n, name in enumerate(INPUTS) if n in used]


def _sensors(program: Program, rig: Scales, cards: Cards) -> dict[str, str]:
    """The parts of the project that differ with the sensors of a controller."""
    made = dict.fromkeys(_PARTS, "")
    for name in _used(program):
        kind, channel = name[:-1], name[-1]
        unit, _, code, paper = _KINDS[kind]
        top = paper * getattr(rig, kind.lower())
        for part in [part for part in _PARTS if part != "ranges" or channel == "1"]:
            made[part] += _PARTS[part].format(
                name=name, kind=kind, channel=channel, unit=unit, code=f"{code}{channel}", full=cards.full_scale,
                at=" AT %I*" if cards.twincat else "", low=SIGNALS[cards.signal] * cards.full_scale,
                bottom=_number(-top), top=_number(top), calls="FrozenCalls" if kind == "Speed" else "0",
            )  # fmt: skip
    return made


def _call(program: Program) -> str:
    """What the block of a program is given, in SI."""
    given = [f"SpeedSetpoint := RampedSetpoint * LREAL#{RPM!r}"]
    given += [f"{name} := {name}Input.Value * LREAL#{_KINDS[name[:-1]][1]!r}" for name in _used(program)]
    given += ["CommandInForce1 := Command1", "CommandInForce2 := Command2", "Reset := Restart"]
    return ", ".join(given)
