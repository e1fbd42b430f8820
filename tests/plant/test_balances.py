"""What goes in comes out or stays: oil, hydraulic energy and electrical energy of the compiled plant itself.

The books are kept from recorded signals alone: integrals by the trapezoidal rule over the rows, stores in closed form
(compressed oil and air, inertias, springs, coil, bristles), losses from the meaning of each parameter. Nothing of the
plant's code is used. The rule's error falls with the square of the period, so the books must close the better the finer
the period; a term that was wrong or missing would stay.
"""

from __future__ import annotations

import copy

import numpy as np
import pytest
from numpy.typing import NDArray

from hydro_env.plant import BUILT_IN, CATALOGUE, PARAMETERS, Plant, load_model, preset_names
from hydro_env.plant.kernel import STATES
from tests.golden import typical

Array = NDArray[np.float64]

#: Memories of effects that take part in the books.
MEMORIES = (
    "coil_heating__heat",
    "magnetic_hysteresis__loop",
    "shaft_backlash__twist",
    "shaft_backlash__load_speed",
    "input_hysteresis__follower",
    "lines__mean_pressure",
    "line_volume__side_pressure",
    "crossport_relief__lift",
    "crossport_relief__lift_back",
)
SECONDS = 0.3
ATMOSPHERE = 101325.0


def rows() -> list[str]:
    """One rig to a preset, and one to an effect at its typical size."""
    return [*preset_names(), *BUILT_IN]


def build(period: float) -> Plant:
    names = rows()
    plant = Plant("paper", len(names), effects=BUILT_IN, tolerance=1e-7)
    for row, name in enumerate(names):
        if name in CATALOGUE:
            plant.set_values(typical(name), rows=[row])
        else:
            plant.set_values(load_model(name).values, rows=[row])
    plant.reset()
    return plant


def motion(kind: str, period: float, rated: Array) -> tuple[Array, Array]:
    """Commands (T, rigs, 2) and loads (T, 1, 2) that change slowly, or at once."""
    time = np.arange(round(SECONDS / period)) * period
    share = np.stack([0.7 * np.sin(9.0 * time), 0.8 * np.sin(6.0 * time + 0.5)], axis=1)
    load = np.stack([0.4 * np.sin(5.0 * time), 0.3 * np.sin(4.0 * time + 1.0)], axis=1)
    if kind == "jumps":
        rng = np.random.default_rng(0)
        hold = round(0.025 / period)
        share = np.repeat(rng.uniform(-1.0, 1.0, (len(time) // hold, 2)), hold, axis=0)
        load = np.repeat(rng.uniform(-0.6, 0.6, (len(time) // hold // 4, 2)), 4 * hold, axis=0)
    return share[:, None, :] * rated, load[:, None, :]


class Books:
    """Residuals of the balances over their turnover, (rigs, 2) each."""

    def __init__(self, kind: str, period: float) -> None:
        plant = build(period)
        self.h = period
        self.p = {name: plant.get(name) for name in PARAMETERS}
        for effect in BUILT_IN:
            self.p |= {
                f"{effect}.{q.name}": plant.get(f"{effect}.{q.name}") for q in CATALOGUE[effect].parameters
            }
        command, load = motion(kind, period, self.p["u_rated"])
        self.out = plant.run(command, load, period, (*STATES, "flow", *MEMORIES))
        assert not plant.diverged.any()
        self.load, self.command = np.broadcast_to(load, command.shape), command
        self.time = (np.arange(len(command)) * period)[:, None, None]

    def __getitem__(self, name: str) -> Array:
        return self.out[name] if name in self.out else self.p[name]

    def of(self, row: int) -> Books:
        """The books of one rig."""
        one, rig = copy.copy(self), slice(row, row + 1)
        one.p = {name: value[rig] for name, value in self.p.items()}
        one.out = {name: value[:, rig] for name, value in self.out.items()}
        one.command, one.load = self.command[:, rig], self.load[:, rig]
        return one

    def driver(self) -> tuple[Array, Array]:
        """Delay, play and limit of the driver at both ends of each period; the delays here are whole rows."""
        late = np.rint(self.p["command_delay.delay"] / self.h).astype(int)
        index = np.arange(len(self.command))[:, None, None] - late
        shifted = np.take_along_axis(self.command, np.maximum(index, 0), axis=0) * (index >= 0)
        limit, half = self.p["driver_saturation.voltage_limit"], 0.5 * self.p["input_hysteresis.width"]
        follower = self["input_hysteresis__follower"]
        later = np.concatenate([follower[1:], follower[-1:]])
        first, last = (
            np.clip(shifted - np.clip(shifted - f, -half, half), -limit, limit) for f in (follower, later)
        )
        return first, last

    def total(self, rate: Array) -> Array:
        """Integral of a rate that is continuous, from the start to each row."""
        return np.concatenate(
            [np.zeros_like(rate[:1]), np.cumsum(0.5 * self.h * (rate[1:] + rate[:-1]), axis=0)]
        )

    def held(self, held: Array, rate: Array) -> Array:
        """Integral of held value times rate: the value jumps between rows and is constant in each."""
        steps = held[:-1] * 0.5 * self.h * (rate[1:] + rate[:-1])
        return np.concatenate([np.zeros_like(rate[:1]), np.cumsum(steps, axis=0)])

    @staticmethod
    def residual(inflow: Array, *outflows: Array) -> Array:
        """Largest residual over the turnover of the greatest account."""
        rest = inflow - sum(each - each[:1] for each in outflows)
        turnover = max(np.abs(np.diff(each, axis=0)).sum(axis=0).max() for each in (inflow, *outflows))
        scale = np.abs(np.diff(inflow, axis=0)).sum(axis=0)
        return np.asarray(np.abs(rest).max(axis=0) / np.maximum(scale, 1e-3 * turnover))

    # --- oil ----------------------------------------------------------------------------------------------------------
    def leakage(self) -> Array:
        pressure, speed, size = self["pressure"], self["speed"], np.abs(self["pressure"])
        drift = self["viscosity_drift.change"] * (
            1.0 - np.exp(-self.time / self["viscosity_drift.time_constant"])
        )
        flow = self["Km"] * np.exp(-drift) * pressure + self["speed_dependent_leakage.coefficient"] * speed
        setting, half = self["crossport_relief.relief_pressure"], 0.5 * self["crossport_relief.hysteresis"]
        forth, back = self["crossport_relief__lift"], self["crossport_relief__lift_back"]
        low, high = (np.maximum(size - setting * (1.0 + way * half), 0.0) for way in (1.0, -1.0))
        held = np.clip(np.where(pressure > 0.0, forth, back), low, high)
        lift = np.where(self["crossport_relief.time_constant"] > 0.0, forth + back, held)
        root = np.sqrt(np.minimum(size / setting, 1.0))
        flow = flow + np.sign(pressure) * self["crossport_relief.conductance"] * lift * root
        mean = 0.5 * (1.0 + self["lines__mean_pressure"])
        middle, leak = mean * self["external_leakage.supply_pressure"], self["external_leakage.conductance"]
        of_line = np.maximum(middle + 0.5 * np.sign(leak) * pressure, 0.0)
        flow = flow + 0.5 * leak * of_line
        drained, drain = mean * self["case_drain.supply_pressure"], self["case_drain.conductance"]
        a, b = (np.maximum(drained + 0.5 * way * pressure, 0.0) for way in (1.0, -1.0))
        flow = flow + 0.5 * drain * (a - b)
        below = self["anti_cavitation.opening_pressure"] - mean * self["anti_cavitation.supply_pressure"]
        a, b = (np.maximum(below - 0.5 * way * pressure, 0.0) for way in (1.0, -1.0))
        flow = flow - 0.5 * self["anti_cavitation.conductance"] * (a - b)
        flow = flow + self["line_volume.conductance"] * (pressure - self["line_volume__side_pressure"])
        for name in ("wilson_losses", "schloesser_losses", "dorey_losses", "jeong_losses"):
            laminar = self[f"{name}.slip"] * self["D"] / self[f"{name}.viscosity"] * pressure
            if name == "dorey_losses":
                laminar = laminar * (1.0 + self["dorey_losses.slip_growth"] * size)
                squeezed = self["dorey_losses.compression"] * self["D"] / self["beta"]
                laminar = laminar + squeezed * np.abs(speed) * pressure
            if name == "jeong_losses":
                laminar = laminar * (1.0 + self["jeong_losses.gap_growth"] * size) ** 3
            flow = flow + laminar
        # The root is smooth within 0.1 bar, as the document says.
        root = np.sqrt(2.0 / self["schloesser_losses.density"]) * pressure / (size**2 + 1e8) ** 0.25
        flow = flow + self["schloesser_losses.turbulent_area"] * root
        mixed = self["ivantysyn_losses.flow_pp"] * size + self["ivantysyn_losses.flow_pw"] * np.abs(speed)
        return flow + mixed * pressure

    def swept(self) -> Array:
        """Volume the motor swept, with the ripple of its chambers."""
        order = self["displacement_ripple.order"]
        ripple = self["displacement_ripple.amplitude"] * np.sin(order * self["angle"]) / order
        return self["D"] * (self["angle"] + ripple)

    def oil(self) -> Array:
        pressure = self["pressure"]
        air = self["entrained_air.fraction"] * pressure / (ATMOSPHERE + np.abs(pressure))  # Boyle
        stored = self["V"] * (pressure / self["beta"] + air)
        return self.residual(self.total(self["flow"]), stored, self.total(self.leakage()), self.swept())

    # --- hydraulic energy ---------------------------------------------------------------------------------------------
    def dry_friction(self) -> Array:
        """Torque of all that has the sign of the speed, which is steep within 0.1 rad/s."""
        speed, size = self["speed"], np.abs(self["speed"])
        theoretical = self["D"] * np.abs(self["pressure"])
        slip = speed / self["motor_coulomb_friction.stribeck_speed"]
        coulomb = self["motor_coulomb_friction.coulomb"]
        dry = coulomb + (self["motor_coulomb_friction.static"] - coulomb) * np.exp(-(slip**2))
        for name in ("wilson_losses", "schloesser_losses"):
            dry = dry + self[f"{name}.friction"] * theoretical + self[f"{name}.constant_torque"]
        boundary = self["dorey_losses.boundary"] * np.exp(-size / self["dorey_losses.boundary_speed"])
        dry = dry + self["dorey_losses.friction"] * (1.0 + boundary) * theoretical
        stribeck = 1.0 + self["jeong_losses.stribeck"] * np.exp(-size / self["jeong_losses.stribeck_speed"])
        rubbing = self["jeong_losses.friction"] * theoretical + self["jeong_losses.constant_torque"]
        dry = dry + rubbing * stribeck
        dry = (
            dry
            + self["ivantysyn_losses.torque_0"]
            + self["ivantysyn_losses.torque_p"] * np.abs(self["pressure"])
        )
        return dry * np.tanh(10.0 * speed)

    def fluid_friction(self) -> Array:
        speed, size = self["speed"], np.abs(self["speed"])
        drift = self["viscosity_drift.change"] * (
            1.0 - np.exp(-self.time / self["viscosity_drift.time_constant"])
        )
        drag = self["B"] * np.exp(drift) + self["quadratic_drag.coefficient"] * size
        for name in ("wilson_losses", "schloesser_losses", "dorey_losses", "jeong_losses"):
            drag = drag + self[f"{name}.drag"] * self["D"] * self[f"{name}.viscosity"]
        for name in ("schloesser_losses", "jeong_losses"):
            drag = drag + self[f"{name}.hydrodynamic"] * self[f"{name}.density"] * size
        drag = drag + self["ivantysyn_losses.torque_ww"] * size
        drag = drag + self["ivantysyn_losses.torque_pw"] * np.abs(self["pressure"])
        return drag * speed

    def coupling(self) -> tuple[Array, Array]:
        """Torque in the coupling behind a gap, and speed of what it drives: the shaft itself where there is none."""
        twist, behind = self["shaft_backlash__twist"], self["shaft_backlash__load_speed"]
        half = 0.5 * self["shaft_backlash.gap"]
        wound = twist - np.clip(twist, -half, half)
        damper = self["shaft_backlash.damping"] * np.clip(50.0 * np.abs(wound), 0.0, 1.0)
        torque = self["shaft_backlash.stiffness"] * wound + damper * (self["speed"] - behind)
        there = self["shaft_backlash.inertia"] > 0.0
        return np.where(there & (torque * wound > 0.0), torque, 0.0), np.where(there, behind, self["speed"])

    def hydraulic(self) -> Array:
        pressure, speed, angle = self["pressure"], self["speed"], self["angle"]
        size = np.abs(pressure)
        air = np.log1p(size / ATMOSPHERE) - size / (ATMOSPHERE + size)  # isothermal work of the air
        compressed = self["V"] * (
            0.5 * pressure**2 / self["beta"] + self["entrained_air.fraction"] * ATMOSPHERE * air
        )
        torque, driven = self.coupling()
        masses = (
            0.5 * self["J"] * speed**2
            + 0.5 * self["shaft_backlash.inertia"] * self["shaft_backlash__load_speed"] ** 2
        )
        phase = self["eccentric_load.phase"]
        weight = self["eccentric_load.amplitude"] * (np.cos(phase) - np.cos(angle + phase))
        ripple = 1.0 + self["displacement_ripple.amplitude"] * np.cos(
            self["displacement_ripple.order"] * angle
        )
        through = self["D"] * ripple * np.abs(speed)
        return self.residual(
            self.total(self["flow"] * pressure),
            compressed, masses, weight, self["load_bias.bias"] * angle,
            self.held(self.load, driven), self.total(torque * (speed - driven)),
            self.total(self.leakage() * pressure), self.total(self["line_loss.coefficient"] * through**3),
            self.total(self.fluid_friction() * speed), self.total(self.dry_friction() * speed),
        )  # fmt: skip

    # --- electrical energy --------------------------------------------------------------------------------------------
    def worked(self, current: Array) -> Array:
        """Integral of voltage times current."""
        first, last = self.driver()
        steps = 0.5 * self.h * (first[:-1] * current[:-1] + last[:-1] * current[1:])
        return np.concatenate([np.zeros_like(current[:1]), np.cumsum(steps, axis=0)])

    def electrical(self) -> Array:
        current, x, v, z = (self[name] for name in ("current", "spool", "spool_speed", "bristle"))
        resistance = self["R"] * (1.0 + self["coil_heating.rise"] * self["coil_heating__heat"])
        coulomb = self["Fc"] + self["spool_stiction.coulomb"]
        static = self["Fs"] + self["spool_stiction.static"]
        breakaway = coulomb + (static - coulomb) * np.exp(-((v / self["vs"]) ** 2))
        yielding = self["s0"] * np.abs(v) / breakaway * z  # of the bristles, m/s
        friction = self["s0"] * z * yielding + self["s1"] * (v - yielding) * v + self["s2"] * v**2
        side = np.where(x > 0.0, 1.0, -1.0)
        past = np.maximum(side * x - np.minimum(self["x_max"], self["spool_stop.travel"]), 0.0)
        stop = self["k_stop"] * past * np.maximum(1.0 + side * v / self["v_stop"], 0.0) * side * v
        preload = self["spring_preload.preload"] / 5e4 * np.log(np.cosh(np.clip(5e4 * x, -300.0, 300.0)))
        drop = np.maximum(self["flow_force.supply_pressure"] - np.sign(x) * self["pressure"], 0.0)
        return self.residual(
            self.worked(current),
            0.5 * self["L"] * current**2, 0.5 * self["m"] * v**2, 0.5 * self["k"] * x**2, 0.5 * self["s0"] * z**2, preload,
            self.total(resistance * current**2), self.total(self["C"] * v**2), self.total(friction), self.total(stop),
            self.total(self["magnetic_hysteresis.amplitude"] * self["magnetic_hysteresis__loop"] * v),
            self.total(self["flow_force.coefficient"] * x * drop * v),
        )  # fmt: skip


PERIODS = (1e-4, 5e-5, 2.5e-5)
#: Largest residuals at 100 us, as shares of the turnover; they fall with the square of the period (kinks: nearly).
LIMITS = {
    "smooth": {"oil": 2e-6, "hydraulic": 2e-6, "electrical": 2e-5},
    "jumps": {"oil": 5e-5, "hydraulic": 5e-5, "electrical": 1e-3},
}
#: How many times as much an effect may leave whose state the matrix of the integrator does not couple to the line.
COUPLED = {"line_volume": 2.5}
BALANCES = ("oil", "hydraulic", "electrical")
#: Effects without a term of their own in any balance: they shape the flow, which is recorded, or only the measurement.
NO_TERM = (
    "null_offset", "dead_zone", "underlap", "flow_saturation", "directional_gain", "flow_gain_nonlinearity",
    "pressure_dependent_flow", "supply_droop", "sensor_lag", "sensor_gain", "sensor_offset",
)  # fmt: skip


@pytest.fixture(scope="module")
def kept() -> dict[str, list[Books]]:
    return {kind: [Books(kind, period) for period in PERIODS] for kind in LIMITS}


@pytest.mark.parametrize("kind", list(LIMITS))
@pytest.mark.parametrize("balance", BALANCES)
def test_the_books_close(balance: str, kind: str, kept: dict[str, list[Books]]) -> None:
    """Every preset and every effect; twice as well, and more, with half the period."""
    found = np.array([getattr(books, balance)().max(axis=1) for books in kept[kind]])
    for row, name in enumerate(rows()):
        for residual, period in zip(found[:, row], PERIODS, strict=True):
            limit = COUPLED.get(name, 1.0) * LIMITS[kind][balance] * (period / PERIODS[0]) ** 1.5
            assert residual < limit, f"{name}: {residual:.2g} of the turnover at {period * 1e6:.0f} us"
    # Most rigs have few kinks, and there the order is 2.
    order = np.log2(found[0] / found[2]) / 2.0
    assert np.median(order) > 1.9 and order.min() > 0.9, dict(zip(rows(), order.round(2), strict=True))


@pytest.mark.parametrize("name", [name for name in BUILT_IN if name not in NO_TERM])
def test_the_books_notice_every_term(name: str, kept: dict[str, list[Books]]) -> None:
    """With an effect's term left out of the books they no longer close; not by far."""
    kind = "jumps" if name in ("crossport_relief", "anti_cavitation") else "smooth"
    books, finer = kept[kind][-1], (PERIODS[-1] / PERIODS[0]) ** 1.5
    alone = books.of(rows().index(name))
    for q in CATALOGUE[name].parameters:
        alone.p[f"{name}.{q.name}"] = np.full((1, 2), q.nominal)
    left_out = max(getattr(alone, b)().max() / (finer * LIMITS[kind][b]) for b in BALANCES)
    assert left_out > 20.0
