"""What asks for commands: a controller that follows a set-point, or an experiment that is played."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hydro_env.arrays import Floats
from hydro_env.controllers import Controller, make_controller
from hydro_env.controllers.rollout import inform
from hydro_env.envs.observation import FRAME, OBSERVATION, Measurements, encode
from hydro_env.errors import InputError, located
from hydro_env.live.link import Link, Sample
from hydro_env.plant import Plant, PlantModel, scales_of
from hydro_env.practice.manoeuvres import plans_of
from hydro_env.reading import read_yaml
from hydro_env.tasks import load_scenario

#: Samples in which a controller shows which signals it reads.
TRIED = 30


@dataclass(frozen=True)
class Driver:
    """`act(n, sample, command)` gives the commands (2,) that are wanted in cycle n of the run, as shares of the rated ones;
    `command` (2,) is in force. `cycles`: how many there are, None for no end. `setpoint(n)`: rad/s, NaN for that of the rig."""

    act: Callable[[int, Sample, Floats], Any]
    cycles: int | None
    setpoint: Callable[[int], float] | None = None


def played(path: str | Path, link: Link, model: PlantModel) -> Driver:
    """Plays a table of commands, as a diagnosis writes it. InputError for one that needs loads."""
    plans = plans_of(path, model.pair("u_rated"), link.cycle_s)
    if any(plan.load.any() for plan in plans):
        raise InputError(
            f"{path}: has loads, which a link cannot set; propose it with `hydro-env diagnose --load-limit 0`"
        )
    shares = np.column_stack([plan.value for plan in plans])
    return Driver(lambda n, sample, command: shares[n], len(shares))


def controlled(
    spec: str, link: Link, model: PlantModel, scenario: str | None, allowed: tuple[float, float], trust: bool = False
) -> Driver:  # fmt: skip
    """A controller as the benchmark takes it, with a `scenario` (a name, or step tables in YAML) or the rig's own set-point.

    `allowed`: largest command and largest change of it in a second, as shares of the rated one. InputError for a controller that
    reads what the rig lacks, or fails on a rig at rest.
    """
    scales, setpoint, cycles = scales_of(model), None, None
    if scenario is not None:
        named = scenario if not Path(scenario).suffix else read_yaml(scenario, "a scenario in YAML")
        with located(scenario):
            profile = load_scenario(named, scales)
        table = profile.reference(link.cycle_s, np.random.default_rng(0)).setpoint
        setpoint, cycles = (lambda n: float(table[n])), len(table)
    elif link.setpoint is None:
        raise InputError("no set-point: name `setpoint` in the link file, or give --scenario")

    def made() -> Any:
        return _told(make_controller(spec, trust=trust), link, model, allowed)

    controller, lacking = made(), _lacking(link)
    if any((_tried(made(), link, n) != _tried(made(), link, None)).any() for n in lacking):
        raise InputError(
            f"{spec} reads {', '.join(OBSERVATION[n] for n in lacking)}, which the link file lacks"
        )
    _tried(controller, link, None)  # compiles what is compiled, before the rig waits for it
    controller.reset(1, link.cycle_s)

    def act(n: int, sample: Sample, command: Floats) -> Any:
        aim = sample.values["setpoint"] if setpoint is None else setpoint(n)
        return controller.act(encode(_measured(sample.values, aim, command), scales))

    return Driver(act, cycles, setpoint)


def _told(controller: Any, link: Link, model: PlantModel, allowed: tuple[float, float]) -> Any:
    """A controller that knows which rig it drives, as far as `model` does."""
    if getattr(controller, "needs", "") == "everything":
        raise InputError(f"{controller.name} needs the loads to come, which no rig tells")
    inform(controller, model, Plant(model), lambda: np.zeros((1, 1, 2)))
    if isinstance(controller, Controller):
        controller.allowed = allowed
    controller.reset(1, link.cycle_s)
    return controller


def _lacking(link: Link) -> list[int]:
    """Places of a frame of which the link has no signal."""
    there = {*link.inputs, "setpoint", "command_1", "command_2"}
    there |= {f"pressure_{c}" for c in (1, 2) if {f"pressure_a_{c}", f"pressure_b_{c}"} <= there}
    return [n for n in range(FRAME) if OBSERVATION[n] not in there]


def _tried(controller: Any, link: Link, shaken: int | None) -> Floats:
    """Commands (TRIED, 2) for noise about rest with a set-point, place `shaken` of whose frames is disturbed."""
    rng, other = np.random.default_rng(0), np.random.default_rng(1)
    frames = 0.05 * rng.standard_normal((TRIED, 1, FRAME)).astype(np.float32)
    frames[..., 0] += np.linspace(0.0, 0.5, TRIED, dtype=np.float32)[:, None]
    frames[..., _lacking(link)] = 0.0
    if shaken is not None:
        frames[..., shaken] = other.standard_normal((TRIED, 1))
    try:
        return np.array([np.asarray(controller.act(frame), float).reshape(2) for frame in frames])
    except Exception as problem:  # a controller of the user's may raise anything
        raise InputError(f"{controller.name} fails on a rig at rest: {problem!r}") from None


def _measured(values: Any, setpoint: float, command: Floats) -> Measurements:
    """One row of measurements; zero for what is not there, which the controller does not read."""

    def pair(signal: str) -> Floats:
        return np.array([[values.get(f"{signal}_{c}", 0.0) for c in (1, 2)]])

    lines = pair("pressure_a") - pair("pressure_b")
    pressure = np.where([[f"pressure_{c}" in values for c in (1, 2)]], pair("pressure"), lines)
    return Measurements(np.array([setpoint]), pair("speed"), pair("current"), pressure, command[None])
