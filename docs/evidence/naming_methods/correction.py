"""A black box added to the right-hand side of the line: V/beta dp/dt = flow - D w - Km p + f(command, spool, p, w).

f is fitted to the flow that the measured speed and pressure need beyond the calibrated model. Since line and shaft are
linear, what f changes is a linear system of two states beside the simulation of the calibrated model: it is
integrated exactly over a row of the log, with f held, at the corrected pressure and speed.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.optimize import minimize
from scipy.signal import savgol_filter

from hydro_env.experiments.naming_benchmark.sets import read_commands
from hydro_env.measured import read_log
from hydro_env.measured.log import RigLog
from hydro_env.plant import PlantModel, simulate
from hydro_env.units import RPM

from .equations import WIDTH

Array = NDArray[np.float64]
Model = Callable[[Array], Array]

#: Scales of the features: command and spool by their largest value, pressure (Pa) and speed (rad/s) by those of a usual rig.
PRESSURE, SPEED = 50e5, 600.0 * RPM
#: Step between the rows of the logs to fit that are used.
STRIDE = 8
#: Hidden units of the network, weight decay, iterations of L-BFGS.
UNITS, DECAY, ITERATIONS = 24, 1e-3, 200


def fit_network(x: Array, y: Array, seed: int = 0) -> Model:
    """A network with one hidden layer of tanh, x (n, k) to y (n,), by L-BFGS with weight decay."""
    rng = np.random.default_rng(seed)
    k = x.shape[1]
    size = float(np.std(y)) or 1.0
    first = np.concatenate(
        [rng.normal(0.0, 1.0 / np.sqrt(k), k * UNITS), rng.normal(0, 0.3, UNITS), np.zeros(UNITS + 1)]
    )

    def parts(v: Array) -> tuple[Array, Array, Array, float]:
        return v[: k * UNITS].reshape(k, UNITS), v[k * UNITS : -UNITS - 1], v[-UNITS - 1 : -1], float(v[-1])

    def loss(v: Array) -> tuple[float, Array]:
        w, b, out, bias = parts(v)
        hidden = np.tanh(x @ w + b)
        error = hidden @ out + bias - y / size
        back = np.outer(error, out) * (1.0 - hidden**2)
        slope = np.concatenate([(x.T @ back).ravel(), back.sum(0), hidden.T @ error, [error.sum()]]) / len(y)
        return 0.5 * float(np.mean(error**2)) + 0.5 * DECAY * float(
            v @ v
        ) / v.size, slope + DECAY * v / v.size

    best = minimize(loss, first, jac=True, method="L-BFGS-B", options={"maxiter": ITERATIONS}).x
    w, b, out, bias = parts(best)
    return lambda z: size * (np.tanh(z @ w + b) @ out + bias)


def fit_polynomial(x: Array, y: Array) -> Model:
    """A sparse polynomial of third degree by PySINDy's STLSQ (Brunton, Proctor and Kutz 2016), y over its own size."""
    import pysindy

    size = float(np.std(y)) or 1.0
    library = pysindy.PolynomialLibrary(degree=3)
    found = pysindy.STLSQ(threshold=0.05, alpha=1e-3).fit(
        np.asarray(library.fit_transform(x)), (y / size)[:, None]
    )
    weights = np.asarray(found.coef_).ravel()
    powers = np.asarray(library.powers_)
    return lambda z: size * (np.prod(z[..., None, :] ** powers, axis=-1) @ weights)


def predicted(folder: Path, model: PlantModel, fit: Callable[[Array, Array], Model]) -> dict[str, Array]:
    """Time and speeds (rpm), by columns, under commands.csv of a rig's folder, with a black box that `fit` makes on its logs to
    fit."""
    logs = [read_log(folder / name) for name in ("fit_1.csv", "fit_2.csv")]
    of_logs = [_simulated(model, log.command_V, log.load, log.period) for log in logs]
    time, command, load, period = read_commands(folder)
    simulated = _simulated(model, command, load, period)
    found = {"time_s": time}
    for c in (0, 1):
        pairs = [_samples(model, c, log, sim) for log, sim in zip(logs, of_logs, strict=True)]
        x, y = (np.concatenate([pair[k] for pair in pairs]) for k in (0, 1))
        found[f"speed_{c + 1}_rpm"] = _integrated(
            model, c, fit(x, y), (x, y), command[:, c], simulated, period
        )
    return found


def _simulated(model: PlantModel, command: Array, load: Array | None, period: float) -> dict[str, Array]:
    out = simulate(model, command, load, period, record=["measured_speed", "pressure", "spool"])
    return {name: values[:, 0, :] for name, values in out.items()}


def _features(
    model: PlantModel, c: int, command: Array, spool: Array, pressure: Array, speed: Array
) -> Array:
    scales = model.value("u_rated", c), model.value("x_max", c), PRESSURE, SPEED
    return np.column_stack([command, spool, pressure, speed]) / np.array(scales)


def _samples(model: PlantModel, c: int, log: RigLog, sim: dict[str, Array]) -> tuple[Array, Array]:
    """Features (n, 4) and missing flow (n,), m3/s, of a log to fit."""
    width = 2 * round(0.5 * WIDTH / log.period) + 1
    known = log.pressure is not None
    speed = log.speed[:, c]
    pressure = log.pressure[:, c] if log.pressure is not None else sim["pressure"][:, c]
    dw, dp = speed - sim["measured_speed"][:, c], pressure - sim["pressure"][:, c]
    missing = model.value("D", c) * savgol_filter(dw, width, 2)
    if known:
        squeezed = savgol_filter(dp, width, 2, deriv=1, delta=log.period)
        missing += model.value("Km", c) * savgol_filter(dp, width, 2)
        missing += model.value("V", c) / model.value("beta", c) * squeezed
    x = _features(model, c, log.command_V[:, c], sim["spool"][:, c], pressure, speed)
    return x[::STRIDE], np.asarray(missing)[::STRIDE]


def _integrated(
    model: PlantModel, c: int, flow: Model, seen: tuple[Array, Array], command: Array, sim: dict[str, Array], period: float
) -> Array:  # fmt: skip
    """Speed (T,), rpm, with the missing flow; it and its features stay within what was seen."""
    D, J, B, Km = (model.value(n, c) for n in ("D", "J", "B", "Km"))
    stiffness = model.value("beta", c) / model.value("V", c)
    whole = np.zeros((3, 3))
    whole[:2] = [[-stiffness * Km, -stiffness * D, stiffness], [D / J, -B / J, 0.0]]
    step = expm(whole * period)[:2]
    low, high = seen[0].min(0), seen[0].max(0)
    least, most = float(seen[1].min()), float(seen[1].max())
    pressure, speed = sim["pressure"][:, c], sim["measured_speed"][:, c]
    x = _features(model, c, command, sim["spool"][:, c], pressure, speed)
    state, found = np.zeros(2), np.empty(len(command))
    for n in range(len(command)):
        found[n] = speed[n] + state[1]
        own = np.clip(x[n] + [0.0, 0.0, state[0] / PRESSURE, state[1] / SPEED], low, high)
        missing = min(max(float(flow(own)), least), most)
        state = step[:, :2] @ state + step[:, 2] * missing
    return found / RPM
