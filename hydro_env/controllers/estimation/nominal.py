"""The nominal channel: what a controller knows of any rig of the paper's type before it has seen one.

Flows are shares of the nominal rated flow (Kq x at the spool travel of the rated command), commands and spool positions
shares of the rated command, so that a nominal valve without a dead zone has edge 0 and gain 1.
"""

from math import inf, sqrt
from typing import Annotated, NamedTuple

import numpy as np

from hydro_env.arrays import Floats
from hydro_env.plant import PARAMETERS
from hydro_env.plant.sensors import NOISE
from hydro_env.units import BAR, RPM

NOMINAL = {name: parameter.nominal for name, parameter in PARAMETERS.items()}
#: Spool travel at the rated command, m.
RATED_TRAVEL = NOMINAL["alpha"] * NOMINAL["u_rated"] / (NOMINAL["R"] * NOMINAL["k"])
#: Flow of the nominal valve at the rated command, m3/s.
RATED_FLOW = NOMINAL["Kq"] * RATED_TRAVEL
#: Angular frequency of the undamped spool, 1/s.
SPOOL_RATE = sqrt(NOMINAL["k"] / NOMINAL["m"])
#: Friction of the nominal spool as a share of the rated command.
STICTION = NOMINAL["Fs"] / (NOMINAL["k"] * RATED_TRAVEL)
#: Standard deviation of a speed sensor, rad/s.
SPEED_NOISE = NOISE["speed_rpm"] * RPM
#: Standard deviation of a pressure sensor, Pa.
PRESSURE_NOISE = NOISE["pressure_bar"] * BAR
#: Standard deviation of the measured flow (eq. 1): both sensors' noise through displacement and leakage, rounded up.
FLOW_NOISE = 0.002
#: Share of the rated flow that counts as flow: four standard deviations of its noise.
FLOWING = 4.0 * FLOW_NOISE
#: The control period that rates and gains were tuned at, s.
TUNED_PERIOD = 0.01


class Motor(NamedTuple):
    """Flow, as a share of the rated one, that torque, speed and acceleration of a motor take (eq. 1 and 2)."""

    leakage: Annotated[float, "1", "leakage relative to the paper's motor", "Table I"] = 1.0
    compliance: Annotated[float, "1e-12 m3/Pa", "flow into the lines per pressure rate", "none in (1)"] = 0.0
    mode: Annotated[float, "1/s", "rate to a flow's speed; 0: by the leakage", "the paper's motor"] = 0.0
    damping: Annotated[
        float, "1", "leakage that feedback of the pressure adds", "the paper's motor needs none"
    ] = 0.0
    friction: Annotated[float, "1", "viscous friction relative to the paper's motor", "Table I"] = 1.0
    supply: Annotated[
        float, "Pa", "supply pressure by which a valve's flow falls (7)", "none in the paper's simulation"
    ] = inf
    noise: Annotated[float, "1", "noise of a pressure, of the usual one", "sensors"] = 1.0

    @property
    def per_torque(self) -> float:
        """Leakage that a torque costs: the pressure for it drives the leak (rated flow per N m)."""
        return (self.leakage + self.damping) * NOMINAL["Km"] / NOMINAL["D"] / RATED_FLOW

    @property
    def per_speed(self) -> float:
        return NOMINAL["D"] / RATED_FLOW + self.friction * NOMINAL["B"] * self.per_torque

    @property
    def per_acceleration(self) -> float:
        return NOMINAL["J"] * self.per_torque

    @property
    def rate(self) -> float:
        """Rate at which a motor without flow coasts down, 1/s."""
        return self.per_speed / self.per_acceleration

    def demand(self, speed: Floats, acceleration: Floats | float, load: Floats | float) -> Floats:
        """The share of the rated flow that a speed (rad/s), an acceleration (rad/s2) and a load (N m) take."""
        return self.per_speed * speed + self.per_acceleration * acceleration + self.per_torque * load

    def strength(self, flow: Floats, pressure: Floats) -> Floats:
        """Share of the flow without pressure that a valve passes (7), both (num_rigs, 2)."""
        return np.sqrt(np.maximum(1.0 - np.sign(flow) * pressure / self.supply, 0.1))

    def flow(self, speed: Floats, pressure: Floats, rise: Floats | float = 0.0) -> Floats:
        """Flow seen from speed and leakage (eq. 1) and the lines' swelling; `rise` is the pressure's, Pa/s."""
        leak = self.leakage * NOMINAL["Km"] * pressure
        return (NOMINAL["D"] * speed + leak + 1e-12 * self.compliance * rise) / RATED_FLOW

    def flow_noise(self, speed: Floats, pressure: Floats) -> Floats:
        """Noise of that flow where the sensors' noise is these multiples of the usual."""
        leak, turn = NOMINAL["Km"] * PRESSURE_NOISE / RATED_FLOW, NOMINAL["D"] * SPEED_NOISE / RATED_FLOW
        return np.hypot(self.noise * leak * pressure, turn * speed)
