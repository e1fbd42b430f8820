"""What is known of a rig: each quantity of its data sheets in the sheet's unit, given or assumed with a range.

The assumed values are class values: what data sheets of such components have in common, not one data sheet. None of them is from
a standard. Those of kinds of components stand in class_values.yaml, the others in this file, and nowhere else.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from hydro_env.data_sheet.derive import full_flow
from hydro_env.data_sheet.sheet import DataSheet, Lines, Motor, Supply, Valve
from hydro_env.reading import shipped_yaml


@dataclass(frozen=True)
class Quantity:
    """A number in the unit that its key ends in. `low` and `high` are None for what the sheet gives; `why` for the rest."""

    value: float
    low: float | None = None
    high: float | None = None
    why: str = ""

    @property
    def assumed(self) -> bool:
        """Whether it is an assumption."""
        return self.low is not None


#: Figures of the spool's dynamics that a sheet may have.
DYNAMIC = ("step_response_ms", "frequency_minus_3_dB_Hz", "frequency_minus_90_deg_Hz")
#: Speed of the oil by which the bore of a line is chosen, m/s.
_OIL_SPEED = 5.0
_RULE = "class value, assumed"
#: Value, low and high of each quantity by component and kind.
_CLASSES: Any = shipped_yaml(__package__, "class_values.yaml")


class _Known(dict[str, Quantity]):
    """Quantities by key: the first that gives one counts."""

    def give(self, key: str, value: float | None) -> None:
        if value is not None and not isinstance(value, bool | str):
            self.setdefault(key, Quantity(float(value)))

    def assume(self, key: str, low: float, value: float, high: float, why: str = _RULE) -> None:
        self.setdefault(key, Quantity(value, low, high, why))

    def assume_class(self, component: str, kind: str | None, default: str) -> None:
        """Class values of a kind; those of the default with the ranges of all kinds where it is not given."""
        classes = _CLASSES[component]
        own = classes[kind or default]
        for key, (value, low, high) in own.items():
            others = [own] if kind else list(classes.values())
            lows, highs = [low, *(c[key][1] for c in others)], [high, *(c[key][2] for c in others)]
            why = f"{_RULE}: {(kind or default).replace('_', ' ')}{'' if kind else ', as the kind is not given'}"
            self.assume(key, min(lows), value, max(highs), why)


def values_of(known: Mapping[str, Quantity]) -> dict[str, float]:
    """The values alone."""
    return {key: quantity.value for key, quantity in known.items()}


def quantities(sheet: DataSheet, channel: int) -> dict[str, Quantity]:
    """All quantities of channel 0 or 1 by the keys of the tables; those of oil and lines have their own names."""
    known = _Known()
    valve, motor, supply, lines, oil = sheet.tables(channel)
    for table in (valve, motor, supply, lines, oil):
        for key, value in table:
            known.give(f"oil_{key}" if table is oil else key, value)
    _of_valve(known, valve)
    _of_motor(known, motor, supply)
    known.assume_class("supplies", supply.kind, "pressure_compensated")
    _of_lines(known, lines)
    return dict(known)


def _of_valve(known: _Known, valve: Valve) -> None:
    if valve.pressure_drop_over is None:
        why = "the sheet does not say; 2: the drop is that over one edge, 1: over the valve"
        known.assume("edges", 1.0, 1.0, 2.0, why)
    known.give("edges", 2.0 if valve.pressure_drop_over == "edge" else 1.0)
    kind = None
    if valve.kind == "servo":
        kind = "servo valve"
    elif valve.spool_feedback:
        kind = "valve with spool feedback"
    elif valve.kind or valve.spool_feedback is False:
        kind = "proportional valve"
    timed = [key for key in DYNAMIC if key in known]
    known.assume_class("valves", kind, "proportional valve")
    if timed and "step_response_ms" not in timed:
        del known["step_response_ms"]
    known.assume("step_response_to_percent", 80.0, 90.0, 98.0)
    known.assume("frequency_amplitude_percent", 5.0, 25.0, 100.0)
    volts, ampere = valve.rated_command_V, (valve.rated_command_mA or 0.0) / 1000.0
    if volts is None and valve.coil_resistance_Ohm:
        volts = ampere * valve.coil_resistance_Ohm
    known.give("volts", volts)
    why = "a scale only: the model's command in V, in proportion to the current"
    known.assume("volts", 10.0, 10.0, 10.0, why)
    known.give("ampere", ampere or None)
    if valve.coil_resistance_Ohm and not valve.onboard_electronics:
        known.give("ampere", known["volts"].value / valve.coil_resistance_Ohm)
    why = "a scale only: the current behind an amplifier's input is not the sheet's"
    known.assume("ampere", 0.73, 0.73, 0.73, why)
    if valve.coil_inductance_mH:
        del known["coil_lag"]


def _of_motor(known: _Known, motor: Motor, supply: Supply) -> None:
    fastest = 60.0 * full_flow(values_of(known)) / (1e-6 * motor.displacement_cm3)
    if fastest < 1000.0:
        known.assume("at_speed_rpm", 0.4 * fastest, 0.7 * fastest, fastest, "share of the speed at full flow")
    known.assume_class("motors", motor.kind, "gear")
    known.assume("at_pressure_bar", 0.5 * supply.pressure_bar, supply.pressure_bar, supply.pressure_bar)
    cm3 = motor.displacement_cm3
    like = 0.0028 / 8.47 * cm3
    known.assume("inertia_kgm2", like / 4.0, like, 4.0 * like, f"{_RULE}: in proportion to the paper's rig")
    known.assume("dry_share", 0.2, 0.4, 0.8, f"{_RULE}: share of dry friction in the mechanical losses")
    bar = motor.starting_torque_at_bar or known["at_pressure_bar"].value
    if motor.starting_torque_Nm:
        share = 100.0 * motor.starting_torque_Nm / (cm3 * 1e-6 / (2.0 * math.pi) * bar * 1e5)
        known.give("starting_torque_percent", min(share, 99.9))
    if "starting_torque_percent" in known:
        known.give("starting_torque_at_bar", bar)
    else:
        known.assume("static_over_dry", 1.0, 1.5, 2.5, f"{_RULE}: static over dry friction of the motor")


def _of_lines(known: _Known, lines: Lines) -> None:
    known.assume("length_m", 0.3, 1.0, 3.0)
    bore = 1000.0 * math.sqrt(4.0 * full_flow(values_of(known)) / (math.pi * _OIL_SPEED))
    why = f"for {_OIL_SPEED:g} m/s at full flow, a usual speed of oil"
    known.assume("bore_mm", 0.7 * bore, bore, 1.4 * bore, why)
    known.assume_class("lines", lines.kind, "rubber")
    known.assume("fittings", 3.0, 10.0, 30.0, f"{_RULE}: loss coefficient of ports and couplings of one line")
    if lines.crossport_relief_bar:
        known.assume("override_percent", 5.0, 10.0, 20.0, f"{_RULE}: rise of a relief valve at full flow")
    known.assume("oil_viscosity_grade", 32.0, 46.0, 68.0)
    known.assume("oil_temperature_C", 30.0, 45.0, 60.0)
    known.assume("oil_bulk_modulus_bar", 10000.0, 14000.0, 17000.0, f"{_RULE}: mineral oil")
    known.assume("oil_air_percent", 0.0, 0.1, 1.0, f"{_RULE}: free air in lines at half the supply")
