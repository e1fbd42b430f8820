"""Which controllers there are, and how a name, a file or a Python path becomes one."""

import importlib.util
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
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
from hydro_env.controllers.learned.policy import NumpyPolicy
from hydro_env.controllers.learned.sb3_policy import Sb3Policy
from hydro_env.controllers.mpc.flow_control import AdaptiveFlow, BenchFlow, ProbingFlow
from hydro_env.controllers.mpc.oracle import Oracle
from hydro_env.controllers.tuning.gains import read_gains
from hydro_env.controllers.user_files import checked, controllers_in, loaded
from hydro_env.errors import InputError, located, place_of, shown, suggestion

HERE = Path(__file__).parent

#: Control laws by the name that gains files and `hydro-env tune` use.
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


@dataclass(frozen=True)
class Entry:
    """A controller that ships with the package."""

    name: str
    summary: str
    build: Callable[[], Any]
    file: Path | None = None
    apart: bool = False
    """Made for another plant than the leaderboard's; `all` leaves it out."""


def _law(law: type[Controller], name: str, summary: str, **gains: Any) -> Entry:
    return Entry(name, summary, lambda: law(name, **gains).carry() if gains else law(name))


def _tuned(name: str, summary: str) -> Entry:
    path = HERE / "data" / f"{name}.json"
    return Entry(name, summary, lambda: _from_gains(path, name).carry(), path)


def _policy(name: str, summary: str, apart: bool = False) -> Entry:
    path = HERE / "policies" / f"{name}.npz"
    return Entry(name, summary, lambda: NumpyPolicy(path, name), path, apart)


#: The controllers that ship with the package, in the order of the leaderboard.
CONTROLLERS: dict[str, Entry] = {
    entry.name: entry
    for entry in (
        _law(PidController, "pid_paper", "the paper's PIDs, Table III", **TABLE_III),
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
        _tuned("oracle", "model-predictive control with the true plant and loads: the reference"),
        _policy("ppo", "network from the observation alone, trained with PPO"),
        _policy("sac", "network from the observation alone, trained with SAC"),
        _policy("gru", "recurrent network from the observation alone"),
        _policy("gru_any", "the same for every rig"),
        _policy("gru_rig", "recurrent network for the preset `rig`", apart=True),
    )
}


def make_controller(spec: Any, *, trust: bool = False, **overrides: Any) -> Any:
    """A controller from a name of `CONTROLLERS`, a gains file (.json), a policy file (.npz), an agent of Stable-Baselines3
    (.zip), `path/to/file.py:Class`, `module:Class`, a class or a ready object. All that is text may end with gains, as in
    `NAME:gain=1.5,other=2`; `file.py` will do for a file with one controller.

    `overrides` replace single gains of a controller with gains, or are passed to a class. `trust`: whether files may run code: a
    .zip, which is a pickle, and gains of a law in a Python file. An agent that was trained with `increment` gets it as
    `my_agent.zip:increment=0.3`.
    InputError says which names there are, and which one was probably meant.
    """
    if not isinstance(spec, str | Path):
        return checked(spec(**overrides) if isinstance(spec, type) else spec, repr(spec))
    text, changes = split_gains(str(spec))
    controller, overrides = _unchanged(text, trust, changes | overrides)
    if overrides:
        if not isinstance(controller, Controller):
            raise InputError(f"controller {text!r}: has no gains that could be changed")
        controller = controller.with_gains(**overrides)
    if changes:
        controller.name = f"{controller.name}:{str(spec).rpartition(':')[2]}"
    return controller


def split_gains(text: str) -> tuple[str, dict[str, float]]:
    """`file.py:Class:Kp=0.2,Ki=1` as `file.py:Class` and the gains. InputError for what is neither a name nor a gain."""
    head, _, tail = text.rpartition(":")
    if not head or ("=" not in tail and head not in CONTROLLERS):
        return text, {}
    try:
        return head, {key: float(value) for key, value in (each.split("=") for each in tail.split(","))}
    except ValueError:
        raise InputError(f"controller {text!r}: expected GAIN=NUMBER,... after the colon") from None


def source_of(text: str) -> Path | None:
    """The file of code, gains or a network that a controller given as text is read from, whatever gains follow; None for one
    that ships and for what is no file."""
    text = split_gains(text)[0]
    where = text.rpartition(":")[0]
    if where and not where.endswith(".py"):
        try:
            module = importlib.util.find_spec(where)
        except (ImportError, ValueError):  # no module's name
            module = None
        where = (module and module.origin) or ""
    path = Path(where or text)
    return path if text not in CONTROLLERS and path.is_file() else None


def law_of(name: str) -> type[Controller]:
    """A control law by its name in `LAWS`, or `file.py:Class` or `module:Class` of a subclass of `Controller` that declares its
    gains. InputError for anything else.
    """
    if name in LAWS:
        return LAWS[name]
    if ":" not in name:
        near = suggestion(name, LAWS)
        raise InputError(f"unknown control law {name!r}: {near}; file.py:Class and module:Class will do too")
    law = loaded(name)
    if not (isinstance(law, type) and issubclass(law, Controller) and law.GAINS):
        raise InputError(f"{name}: has no gains to tune; expected a Controller that lists them in GAINS")
    return law


def _unchanged(text: str, trust: bool, gains: dict[str, Any]) -> tuple[Any, dict[str, Any]]:
    """The controller before single gains of it are changed, and those of `gains` that it has not taken yet."""
    if text in CONTROLLERS:
        return CONTROLLERS[text].build(), gains
    path = Path(text)
    if text.endswith(".json"):
        return _from_gains(path, path.stem, trust), gains
    if text.endswith(".npz"):
        return NumpyPolicy(path, path.stem), gains
    if text.endswith(".zip"):
        own = dict(gains)
        return Sb3Policy(path, path.stem, trust, own.pop("increment", None)), own
    if text.endswith(".py"):
        text, *others = controllers_in(text)
        if others:
            names = ", ".join([text, *others])
            raise InputError(f"controller {path}: has several, name one of them: {names}")
    if ":" in text:
        return _from_python(text, gains), {}
    kinds = "a .json gains file, a .npz policy, a .zip of Stable-Baselines3, file.py:Class and module:Class will do too"
    raise InputError(f"unknown controller {text!r}: {suggestion(text, CONTROLLERS)}; {kinds}")


def _from_gains(path: Path, name: str, trust: bool = False) -> Controller:
    found = read_gains(path)
    if ":" in found.controller and not trust:
        raise InputError(f"{path}: gains of {shown(found.controller)}, code that is run only with --trust")
    with located(path):
        law = law_of(_beside(path, found.controller))
        controller: Controller = _made(lambda: law(found.name or name, **found.gains), found.controller)
        controller.for_periods(found.by_period())
        controller.plant = found.plant or None
        return controller


def _beside(path: Path, law: str) -> str:
    """`file.py:Class` of a gains file; a file that is not in the working folder is looked for beside the gains."""
    file, _, name = law.rpartition(":")
    other = path.parent / Path(file).name
    elsewhere = file.endswith(".py") and not os.path.isfile(file) and os.path.isfile(other)
    return f"{other}:{name}" if elsewhere else law


def _from_python(text: str, overrides: dict[str, Any]) -> Any:
    made = loaded(text)
    controller = checked(_made(lambda: made(**overrides), text) if callable(made) else made, text)
    if not isinstance(getattr(controller, "name", None), str):
        controller.name = text.rpartition(":")[2]
    return controller


def _made(make: Callable[[], Any], text: str) -> Any:
    """What `make` makes with code that may be the user's, called `text`. InputError if that fails in any way."""
    try:
        return make()
    except InputError:
        raise
    except (Exception, SystemExit) as problem:
        place = f" ({place_of(problem)})" if place_of(problem) else ""
        raise InputError(f"{text}: cannot be made: {type(problem).__name__}: {problem}{place}") from problem
