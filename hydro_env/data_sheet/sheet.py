"""Data sheets of a rig in a file (`hydro_env/datasheet/1`): what is printed on paper or can be measured with a tape.

    schema: hydro_env/datasheet/1
    name: my rig
    valve: {rated_flow_lpm: 24, at_pressure_drop_bar: 10, rated_command_V: 10}
    motor: {displacement_cm3: 50}
    supply: {pressure_bar: 160}

These values are needed. Everything else may be given, in the units that the keys end in; what is not becomes an assumption, a
class value with a range. `hydro-env describe --template` prints all keys. `valve_2`, `motor_2` and `lines_2` are those of
channel 2 where they differ; each is a whole table of its own. `source` says which data sheet a table is from.
"""

from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import yaml
from pydantic import BeforeValidator, Field, TypeAdapter, ValidationError, model_validator
from pydantic.fields import FieldInfo

from hydro_env.errors import InputError, shown
from hydro_env.reading import parse_yaml, read_yaml
from hydro_env.validation import FileTable, Number, checked

Positive = Annotated[Number, Field(gt=0.0, le=1e6)]
Efficiency = Annotated[Number, Field(ge=10.0, lt=100.0)]
YesOrNo = Annotated[bool, BeforeValidator(lambda x: {"yes": True, "no": False}.get(str(x).lower(), x))]


def _key(text: str, default: Any = None) -> Any:
    return Field(default=default, description=text)


class _Table(FileTable):
    source: str = _key("which data sheet, or what was measured")


class Valve(_Table):
    """A valve."""

    rated_flow_lpm: Positive = _key("rated flow, l/min", ...)
    at_pressure_drop_bar: Positive = _key("pressure drop at which that is the flow, bar", ...)
    pressure_drop_over: Literal["valve", "edge"] | None = _key(
        "drop over the whole valve, or one edge (P to A)"
    )
    rated_command_V: Positive | None = _key("rated command, V: of the amplifier's input, else at the coil")
    rated_command_mA: Positive | None = _key("rated current, mA (this or the rated command is needed)")
    coil_resistance_Ohm: Positive | None = _key("resistance of the coil, warm, Ohm")
    coil_inductance_mH: Positive | None = _key("inductance of the coil, mH")
    kind: Literal["proportional", "servo"] | None = _key("a proportional or a servo valve")
    spool_feedback: YesOrNo | None = _key("whether the spool's position is fed back: yes or no")
    onboard_electronics: YesOrNo | None = _key("whether the valve has an amplifier on it: yes or no")
    dead_band_percent: Annotated[Number, Field(ge=0.0, le=50.0)] | None = _key(
        "share of the rated command at which flow begins, either way (overlap), %"
    )
    hysteresis_percent: Annotated[Number, Field(gt=0.0, le=20.0)] | None = _key(
        "hysteresis, % of the rated command"
    )
    step_response_ms: Positive | None = _key("time of the step from 0 to 100 % of the command, ms")
    step_response_to_percent: Annotated[Number, Field(ge=50.0, le=100.0)] | None = _key(
        "share of the step that is reached then, %"
    )
    frequency_minus_3_dB_Hz: Positive | None = _key("frequency at -3 dB, Hz")
    frequency_minus_90_deg_Hz: Positive | None = _key("frequency at -90 degrees, Hz")
    frequency_amplitude_percent: Annotated[Number, Field(ge=1.0, le=100.0)] | None = _key(
        "amplitude of the command at these frequencies, % of the rated one"
    )

    @model_validator(mode="after")
    def _whole(self) -> "Valve":
        volts, milliamperes, ohm = self.rated_command_V, self.rated_command_mA, self.coil_resistance_Ohm
        if volts is None and milliamperes is None:
            raise ValueError("rated_command_V or rated_command_mA is missing")
        if volts and milliamperes and ohm and not self.onboard_electronics:
            drop = ohm * milliamperes / 1000.0
            if drop > 1.2 * volts:
                raise ValueError(
                    f"{milliamperes:g} mA through {ohm:g} Ohm take {drop:.3g} V, rated_command_V is {volts:g}"
                )
        return self


class Motor(_Table):
    """A motor."""

    displacement_cm3: Annotated[Number, Field(ge=0.7, le=1e6)] = _key("displacement, cm3 a revolution", ...)
    kind: Literal["gear", "orbital", "piston"] | None = _key("kind of motor")
    inertia_kgm2: Positive | None = _key("inertia of motor and load together, kg m2")
    volumetric_efficiency_percent: Efficiency | None = _key("volumetric efficiency, %")
    mechanical_efficiency_percent: Efficiency | None = _key("hydromechanical efficiency, %")
    at_pressure_bar: Positive | None = _key("pressure difference at which the efficiencies are given, bar")
    at_speed_rpm: Positive | None = _key("speed at which they are given, rpm")
    starting_torque_percent: Efficiency | None = _key("starting torque, % of the theoretical one")
    starting_torque_Nm: Positive | None = _key("the same in N m, instead")
    starting_torque_at_bar: Positive | None = _key("pressure difference of the starting torque, bar")


class Supply(_Table):
    """The supply of both valves."""

    pressure_bar: Annotated[Number, Field(ge=1.0, le=1000.0)] = _key("supply pressure, bar", ...)
    kind: Literal["pressure_compensated", "fixed_pump", "accumulator"] | None = _key(
        "pressure-compensated pump, fixed pump with relief valve, or accumulator"
    )
    relief_bar: Positive | None = _key("relief valve of the supply, bar")

    @model_validator(mode="after")
    def _relief_above(self) -> "Supply":
        if self.relief_bar is not None and self.relief_bar < self.pressure_bar:
            raise ValueError(
                f"relief_bar is {self.relief_bar:g}, below the supply pressure of {self.pressure_bar:g}"
            )
        return self


class Lines(_Table):
    """The two lines between a valve and its motor."""

    length_m: Positive | None = _key("length of one line, m")
    bore_mm: Positive | None = _key("inner diameter, mm")
    kind: Literal["rubber", "thermoplastic", "steel"] | None = _key("hoses of which kind, or steel pipes")
    crossport_relief_bar: Positive | None = _key("relief valves between the motor's ports, if there are, bar")


class Oil(_Table):
    """The oil."""

    viscosity_grade: Positive | None = _key("ISO VG number, mm2/s at 40 degC")
    temperature_C: Annotated[Number, Field(ge=-40.0, le=120.0)] | None = _key("working temperature, degC")
    bulk_modulus_bar: Positive | None = _key("bulk modulus, bar")


class DataSheet(FileTable):
    """What stands in the file."""

    FORMAT = "hydro_env/datasheet/1"

    name: str = "my rig"
    valve: Valve
    valve_2: Valve | None = None
    motor: Motor
    motor_2: Motor | None = None
    supply: Supply
    lines: Lines = Lines()
    lines_2: Lines | None = None
    oil: Oil = Oil()

    def tables(self, channel: int) -> tuple[Valve, Motor, Supply, Lines, Oil]:
        """The tables of channel 0 or 1."""
        valve, motor, lines = (self.valve_2, self.motor_2, self.lines_2) if channel else (None, None, None)
        return valve or self.valve, motor or self.motor, self.supply, lines or self.lines, self.oil


TABLES: dict[str, type[_Table]] = {
    "valve": Valve, "motor": Motor, "supply": Supply, "lines": Lines, "oil": Oil,
}  # fmt: skip


def read_sheet(path: str | Path) -> DataSheet:
    """The data sheet in a file. InputError, in one line that names file and key, for anything that is not right."""
    return checked(DataSheet, read_yaml(path, "a data sheet in YAML"), path)


def _choices(field: FieldInfo) -> str:
    words = [word for each in (field.annotation, *get_args(field.annotation)) for word in get_args(each)]
    listed = [str(word) for word in words if isinstance(word, str)]
    return f" ({', '.join(listed)})" if listed else ""


def template() -> str:
    """An empty data sheet with a comment at each key."""
    lines = [f"schema: {DataSheet.FORMAT}", "name: my rig"]
    for name, table in TABLES.items():
        lines.append(
            f"{name}:" if any(f.is_required() for f in table.model_fields.values()) else f"# {name}:"
        )
        for key, field in table.model_fields.items():
            needed = "needed: " if field.is_required() else ""
            lines.append(f"  {'' if needed else '# '}{key}:  # {needed}{field.description}{_choices(field)}")
    return "\n".join(lines) + "\n"


def ask(where: Path) -> tuple[DataSheet, str]:
    """Asks for all of it on the terminal; the sheet, and the text of its file. `where` names it in errors."""
    print("What is not known is left empty. Units are those of the question.")
    data: dict[str, Any] = {
        "schema": DataSheet.FORMAT,
        "name": input("name of the rig: ").strip() or "my rig",
    }
    for name, table in TABLES.items():
        print(f"\n{(table.__doc__ or name).strip()}")
        if answers := _asked_table(name, table):
            data[name] = answers
    return checked(DataSheet, data, where), yaml.safe_dump(data, sort_keys=False)


def _asked_table(name: str, table: type[_Table]) -> dict[str, Any]:
    asked: dict[str, Any] = {}
    while True:
        asked = {key: _asked(key, field, asked.get(key)) for key, field in table.model_fields.items()}
        answers = {key: value for key, value in asked.items() if value is not None}
        try:
            checked(table, answers, name)
            return answers
        except InputError as problem:
            print(f"  {problem}; once more, an empty line keeps the answer in brackets:")


def _asked(key: str, field: FieldInfo, before: Any = None) -> Any:
    """The answer to a question; an empty one is that of `before`, if there is one."""
    needed = " (needed)" if field.is_required() else ""
    kept = "" if before is None else f" [{before}]"
    kind: TypeAdapter[Any] = TypeAdapter(Annotated[field.annotation, field])  # type: ignore[arg-type]
    while True:
        text = input(f"  {field.description}{_choices(field)}{needed}{kept}: ").strip()
        if not text and (kept or not needed):
            return before
        if not text:
            print("  an answer is needed")
            continue
        try:
            value = text if field.annotation is str else parse_yaml(text, key)
            kind.validate_python(value)
            return value
        except InputError as problem:
            print(f"  {problem}")
        except ValidationError as problem:
            print(f"  {shown(text)}: {problem.errors()[0]['msg']}")
