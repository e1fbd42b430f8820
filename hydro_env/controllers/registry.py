"""Which controllers there are, and how a name, a file or a Python path becomes one."""

from __future__ import annotations

import importlib
import importlib.util
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

from hydro_env.controllers.base import Controller
from hydro_env.controllers.classical.compensated import Compensated
from hydro_env.controllers.classical.cross_coupling import (
    CrossCoupled,
    MasterSlave,
    RelativeCoupled,
    VirtualLeader,
)
from hydro_env.controllers.classical.disturbance_observer import DisturbanceObserver
from hydro_env.controllers.classical.pid import TABLE_III, PidController, RampedPid
from hydro_env.controllers.mpc.flow_control import AdaptiveFlow, BenchFlow, ProbingFlow
from hydro_env.controllers.mpc.oracle import Oracle
from hydro_env.controllers.tuning.gains import read_gains
from hydro_env.errors import InputError, suggestion

__all__ = ["CONTROLLERS", "LAWS", "Entry", "make_controller"]

HERE = Path(__file__).parent

LAWS: dict[str, type[Controller]] = {
    "pid": PidController,
    "ramped_pid": RampedPid,
    "cross_coupled": CrossCoupled,
    "relative_coupling": RelativeCoupled,
    "virtual_leader": VirtualLeader,
    "master_slave": MasterSlave,
    "disturbance_observer": DisturbanceObserver,
    "compensated": Compensated,
    "oracle": Oracle,
}
"""Control laws by the name that gains files and `hydro-env tune` use."""


@dataclass(frozen=True)
class Entry:
    """A controller that ships with the package."""

    name: str
    summary: str
    build: Callable[[], Any]
    file: Path | None = None
    apart: bool = False
    """Made for another plant than the leaderboard's; `all` leaves it out."""

    @property
    def available(self) -> bool:
        """Whether the file it is made of is there."""
        return self.file is None or self.file.is_file()


def _law(law: type[Controller], name: str, summary: str) -> Entry:
    return Entry(name, summary, lambda: law(name))


def _tuned(name: str, summary: str) -> Entry:
    path = HERE / "data" / f"{name}.json"
    return Entry(name, summary, lambda: _from_gains(path, name), path)


def _policy(name: str, summary: str, apart: bool = False) -> Entry:
    path = HERE / "policies" / f"{name}.npz"
    return Entry(name, summary, lambda: _from_policy(path, name), path, apart)


CONTROLLERS: dict[str, Entry] = {
    entry.name: entry
    for entry in (
        Entry("pid_paper", "the paper's PIDs, Table III", lambda: PidController("pid_paper", **TABLE_III)),
        _tuned("pid_tuned", "the same law, gains found by search"),
        _tuned("master_slave", "motor 2 follows motor 1"),
        _tuned("cross_coupled", "PI with a PI on the speed difference"),
        _tuned("relative_coupling", "PI on the error plus the weighted speed difference"),
        _tuned("virtual_leader", "cross coupling behind a leader that waits for the slower motor"),
        _tuned("disturbance_observer", "estimates and compensates deviations from a rated motor"),
        _tuned("compensated", "dead-zone inverse from a valve bench, with cross coupling"),
        _law(AdaptiveFlow, "adaptive_flow", "estimates dead-zone edges and gains on line"),
        _law(ProbingFlow, "probing_flow", "probes the valves at rest, estimates on line, plans ahead"),
        _law(BenchFlow, "bench_flow", "the same, starting from valve-bench curves"),
        _tuned("servo_pid", "PID behind a ramp, on the same motors behind servo valves"),
        _tuned("oracle", "model-predictive control with the true plant: the bound"),
        _policy("ppo", "neural policy on a model-based law, trained with PPO"),
        _policy("ppo_calm", "the same on a slower reference: better synchronised, more tracking error"),
        _policy("sac", "neural policy on a model-based law, trained with SAC"),
        _policy("ppo_rig", "neural policy for the preset `rig`", apart=True),
    )
}
"""The controllers that ship with the package, in the order of the leaderboard."""


def make_controller(spec: Any, **overrides: Any) -> Any:
    """A controller from a name of `CONTROLLERS` (`NAME:gain=1.5,other=2` changes gains of it), a gains file (.json), a policy
    file (.npz), `module:Class`, `path/to/file.py:Class`, a class or a ready object.

    `overrides` replace single gains of a controller with gains, or are passed to a class. InputError says
    which names there are, and which one was probably meant.
    """
    if not isinstance(spec, str | Path):
        return _checked(spec(**overrides) if isinstance(spec, type) else spec, repr(spec))
    text = str(spec)
    if text in CONTROLLERS:
        entry = CONTROLLERS[text]
        if not entry.available:
            raise InputError(f"controller {text!r}: its file {entry.file} is not there")
        controller = entry.build()
    elif text.endswith(".json"):
        controller = _from_gains(Path(text), Path(text).stem)
    elif text.endswith(".npz"):
        controller = _from_policy(Path(text), Path(text).stem)
    elif text.partition(":")[0] in CONTROLLERS:
        controller = make_controller(text.partition(":")[0], **_overrides(text))
        controller.name = text
    elif ":" in text:
        return _from_python(text, overrides)
    else:
        if text.endswith(".py"):
            raise InputError(f"controller {text!r}: name its class too, as in {text}:MyController")
        others = "a .json gains file, a .npz policy, module:Class and file.py:Class will do too"
        raise InputError(f"unknown controller {text!r}: {suggestion(text, CONTROLLERS)}; {others}")
    if overrides:
        if not isinstance(controller, Controller):
            raise InputError(f"controller {text!r}: has no gains that could be changed")
        return controller.with_gains(**overrides)
    return controller


def _overrides(text: str) -> dict[str, float]:
    try:
        return {
            key: float(value)
            for key, value in (each.split("=") for each in text.partition(":")[2].split(","))
        }
    except ValueError:
        raise InputError(
            f"controller {text!r}: after the colon GAIN=NUMBER is expected, several with commas"
        ) from None


def _from_gains(path: Path, name: str) -> Controller:
    found = read_gains(path)
    if found.controller not in LAWS:
        raise InputError(
            f"{path}: unknown control law {found.controller!r}: {suggestion(found.controller, LAWS)}"
        )
    try:
        controller = LAWS[found.controller](found.name or name, **found.gains)
        controller.for_periods(found.by_period())
        controller.plant = found.plant or None
        return controller
    except InputError as problem:
        raise InputError(f"{path}: {problem}") from None


def _from_policy(path: Path, name: str) -> Any:
    if not path.is_file():
        raise InputError(f"{path}: no such policy file")
    from hydro_env.controllers.learned.policy import NumpyPolicy

    return NumpyPolicy(path, name)


def _from_python(text: str, overrides: dict[str, Any]) -> Any:
    where, _, attribute = text.rpartition(":")
    module = _load_file(Path(where)) if where.endswith(".py") else _import(where)
    made = getattr(module, attribute, None)
    if made is None:
        names = [name for name, value in vars(module).items() if isinstance(value, type)]
        raise InputError(f"{where}: has no {attribute!r}: {suggestion(attribute, names)}")
    try:
        controller = made(**overrides) if callable(made) else made
    except InputError:
        raise
    except Exception as problem:
        raise InputError(f"{text}: could not be made: {type(problem).__name__}: {problem}") from problem
    if not isinstance(getattr(controller, "name", None), str):
        controller.name = attribute
    return _checked(controller, text)


def _import(where: str) -> ModuleType:
    try:
        return importlib.import_module(where)
    except ImportError as problem:
        raise InputError(f"{where}: cannot be imported ({problem})") from None


def _load_file(path: Path) -> ModuleType:
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    spec = importlib.util.spec_from_file_location(f"hydro_env_user_{path.stem}", path)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # so that what it defines can be pickled to worker processes
    try:
        # From the source itself: Python's cache takes a file of the same size that was written in the same second for the same.
        exec(compile(path.read_bytes(), str(path), "exec"), module.__dict__)
    except Exception as problem:
        raise InputError(f"{path}: {type(problem).__name__}: {problem}") from problem
    return module


def _checked(controller: Any, text: str) -> Any:
    for method in ("reset", "act"):
        if not callable(getattr(controller, method, None)):
            raise InputError(f"{text}: is no controller, it has no method {method!r}")
    return controller
