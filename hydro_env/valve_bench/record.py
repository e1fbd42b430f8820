"""Sweeps of a modelled valve in the plant's kernel.

The command goes as a triangle between plus and minus its rated value. A first quarter from zero to the rated value
only conditions the valve (magnetisation, friction) and is left out, so the loop is closed. The motor behind the valve
runs free, and the other valve stays closed. The pressure over the motor is then that of its own friction, which
stands for the constant valve pressure drop of the standard.
"""

import numpy as np

from hydro_env.errors import InputError
from hydro_env.plant import CATALOGUE, Plant, PlantModel
from hydro_env.valve_bench.curve import Curve, Floats
from hydro_env.waveforms import triangle

#: What can be taken as the valve's input, and its unit.
SIGNALS = {"current": "A", "command": "V"}
#: Time between two recorded samples is this share of the sweep, and at least `MIN_PERIOD` s.
SHARE, MIN_PERIOD = 1.0 / 10_000.0, 5e-4


def record(
    model: PlantModel,
    channel: int,
    *,
    seconds: float = 20.0,
    signal: str = "current",
    name: str | None = None,
) -> Curve:
    """Sweeps the valve of channel 0 or 1 once through its loop in `seconds`, read over "current" or "command".

    InputError for an unknown signal or a sweep that is not longer than 0.1 s.
    """
    if signal not in SIGNALS:
        raise InputError(f"unknown signal {signal!r}: current or command")
    if not seconds > 0.1:
        raise InputError(f"a sweep of {seconds:g} s: too short for a steady curve, 5 s and more are right")
    period = max(MIN_PERIOD, round(seconds * SHARE / MIN_PERIOD) * MIN_PERIOD)
    plant = Plant(model)
    time, share, swept = _swept(plant, (channel,), seconds, period, ("current", "flow"))
    if lost := plant.lost:
        raise InputError(f"model {model.name!r}: {lost[0]}")
    rated, per_volt = model.value("u_rated", channel), 1.0 / model.value("R", channel)
    travel = model.value("alpha", channel) / model.value("k", channel)
    by_current = signal == "current"
    return Curve(
        name=name or f"{model.name}:{channel + 1}",
        signal=swept["current"][:, 0, channel] if by_current else share * rated,
        flow=swept["flow"][:, 0, channel],
        signal_unit=SIGNALS[signal],
        rated=rated * (per_volt if by_current else 1.0),
        time=time,
        travel_per_signal=travel * (1.0 if by_current else per_volt),
    )


def record_rigs(plant: Plant, *, seconds: float = 8.0, period: float = 0.01) -> list[tuple[Curve, Curve]]:
    """Both valves of every rig of a batch, swept once in `seconds` and read over the command every `period` s.

    Both valves of a rig are swept at once, as on two benches, unless they share a supply that droops. The plant's state is
    used up: pass a copy.
    """
    coupled = any(CATALOGUE[effect].couples_channels for effect in plant.effects)
    flows: dict[int, Floats] = {}
    for channels in ((0,), (1,)) if coupled else ((0, 1),):
        plant.reset()
        time, share, swept = _swept(plant, channels, seconds, period, ("flow",))
        flows |= {channel: swept["flow"][:, :, channel] for channel in channels}
    rated = plant.get("u_rated")

    def curve(rig: int, channel: int) -> Curve:
        volts, name = float(rated[rig, channel]), f"{plant.model.name} {rig}:{channel + 1}"
        return Curve(name, share * volts, flows[channel][:, rig], SIGNALS["command"], volts, time)

    return [(curve(rig, 0), curve(rig, 1)) for rig in range(plant.num_rigs)]


def _swept(
    plant: Plant, channels: tuple[int, ...], seconds: float, period: float, signals: tuple[str, ...]
) -> tuple[Floats, Floats, dict[str, Floats]]:
    """Sweeps valves of all rigs: times (T,), commands (T,) as shares of the rated ones, and `signals` (T, rigs, 2), all after a
    quarter that conditions the valves."""
    quarter = max(1, round(seconds / 4.0 / period))
    share = triangle(np.arange(5 * quarter + 1) / (4 * quarter))
    command = np.zeros((len(share), plant.num_rigs, 2))
    for channel in channels:
        command[..., channel] = share[:, None] * plant.get("u_rated")[:, channel]
    out = plant.run(command, None, period, signals)
    # Row n of a run is the state when command n begins to act: what it answers to is command n - 1.
    answered = np.concatenate([[0.0], share[:-1]])
    time = np.asarray(np.arange(len(share)) * period, dtype=float)
    return time[quarter:], answered[quarter:], {name: values[quarter:] for name, values in out.items()}
