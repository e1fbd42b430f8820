"""The training file of a recurrent policy: YAML with the tables below; what is left out keeps its default."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, TypeVar

from hydro_env.controllers.base import HAND
from hydro_env.errors import InputError, shown, suggestion
from hydro_env.reading import MAX_BYTES_OF_YAML, parse_yaml, read_text

S = TypeVar("S")
MILLION = 1e6
ENV = {"plant": "paper_dead_zone", "mismatch": "train"}


def setting(default: Any, unit: str, summary: str, reason: str) -> Any:
    """A field of a settings dataclass; `reason`: where the value comes from."""
    return field(default=default, metadata={"unit": unit, "summary": summary, "reason": reason})


@dataclass(frozen=True)
class Sizes:
    """Units of the layers."""

    inputs: int = setting(64, "1", "dense layer before the recurrent one", HAND)
    recurrent: int = setting(80, "1", "gated recurrent unit", HAND)
    outputs: int = setting(64, "1", "dense layer after it", HAND)


@dataclass(frozen=True)
class Imitation:
    """The first stage, see `agents.recurrent.imitation`."""

    law: bool = setting(True, "", "imitates the law, otherwise PI controllers without memory", HAND)
    periods: float = setting(8.0, "million", "control periods of single rigs", HAND)
    rigs: int = setting(
        640, "1", "driven side by side", "the law and the network are fastest at some hundreds"
    )
    window: int = setting(
        100, "periods", "through which is propagated back; the length of an episode is a multiple", HAND
    )
    batch: int = setting(80, "1", "rigs whose window makes a step of the optimiser", HAND)
    epochs: int = setting(2, "1", "uses of each window; the law costs as much as a use", HAND)
    rate: float = setting(2e-3, "1", "step size of Adam", HAND)
    precise: float = setting(
        0.02, "1", "error of a command from which on it counts in proportion, not squared", HAND
    )
    notes: float = setting(
        1.0, "1", "weight of what is known of valves and rig, which the state is to hold", HAND
    )
    handover: float = setting(6.0, "million", "periods after which the student drives all that it may", HAND)
    share: float = setting(0.9, "1", "most of the rigs that the student drives", HAND)


@dataclass(frozen=True)
class Gradient:
    """The second stage, see `agents.recurrent.simulator_gradient`."""

    periods: float = setting(15.0, "million", "control periods of single rigs", HAND)
    rigs: int = setting(128, "1", "driven side by side", "with their copies they fill the plant's blocks")
    window: int = setting(
        30, "periods", "through which is propagated back; the length of an episode is a multiple", HAND
    )
    rate: float = setting(5e-3, "1", "step size of Adam, which falls to a twentieth along a cosine", HAND)
    difference: float = setting(1.0, "1", "weight of the squared speed difference over 10 rpm", HAND)
    huber_threshold: float = setting(
        40.0, "rpm", "from which on it counts in proportion: what a sudden load does", HAND
    )
    bound: float = setting(
        30.0, "rpm", "of the mean tracking error, up to which it may pay for the difference; 0: none", HAND
    )
    relative: float = setting(
        1.0, "1", "cost of a period of a rig from which on it counts relatively, not in full", HAND
    )
    tracking: float = setting(0.0015, "1/rpm", "weight of the tracking error at the start", HAND)
    travel: float = setting(0.1, "1", "weight of the move of a command", HAND)
    notes: float = setting(
        0.3, "1", "weight of what is known of the valves, which the state is to hold", HAND
    )
    keep_state: float = setting(0.9, "1", "of the plant's adjoint that is kept each period", HAND)
    keep_memory: float = setting(0.97, "1", "of the adjoint of the recurrent state", HAND)
    max_state: float = setting(
        500.0, "1", "largest adjoint of one rig's plant", "a multiple of the usual ones"
    )
    max_memory: float = setting(50.0, "1", "of its recurrent state", "likewise")
    max_reading: float = setting(200.0, "1", "of its readings", "likewise")
    max_command: float = setting(50.0, "1", "of its commands", "likewise")


@dataclass(frozen=True)
class Training:
    """What both stages share."""

    seed: int = setting(0, "1", "of network and episodes", HAND)
    evaluate: float = setting(2.0, "million", "periods between evaluations and checkpoints", HAND)
    tolerance_rpm: float = setting(0.0, "rpm", "of the plant while training; 0: the plant's own", HAND)
    pairs: int = setting(100, "1", "pairs of `val` an evaluation drives in `setpoint_steps`", HAND)
    tracking_weight: float = setting(0.5, "1", "of the tracking error in the score that chooses", HAND)
    tail_weight: float = setting(0.25, "1", "of the 95th percentile in it", HAND)


@dataclass(frozen=True)
class Settings:
    """A training file; `env` are arguments of the environment, `text` the file itself. `groups` are the rigs of the second stage
    where it has other ones: arguments of the environment and settings of each."""

    network: Sizes = field(default_factory=Sizes)
    imitation: Imitation = field(default_factory=Imitation)
    gradient: Gradient = field(default_factory=Gradient)
    training: Training = field(default_factory=Training)
    env: dict[str, Any] = field(default_factory=ENV.copy)
    groups: tuple[tuple[dict[str, Any], Gradient], ...] = ()
    text: str = ""

    @property
    def driven(self) -> tuple[tuple[dict[str, Any], Gradient], ...]:
        """Arguments of the environment and settings for each group of rigs of the second stage."""
        return self.groups or ((self.env, self.gradient),)


def read_settings(path: Path) -> Settings:
    """Reads a training file. InputError, in one line that names file and key, for anything that is not right."""
    text = read_text(path, "a training file in YAML", max_bytes=MAX_BYTES_OF_YAML)
    data = parse_yaml(text, str(path))
    tables = {"network": Sizes, "imitation": Imitation, "gradient": Gradient, "training": Training}
    groups = data.pop("groups", []) if isinstance(data, dict) else []
    if not isinstance(data, dict) or not all(isinstance(table, dict) for table in (*data.values(), *groups)):
        raise InputError(
            f"{path}: should hold the tables {', '.join((*tables, 'env'))}, and perhaps a list of groups"
        )
    for key in data:
        if key not in (*tables, "env"):
            raise InputError(f"{path}: unknown key {key!r}: {suggestion(key, [*tables, 'env', 'groups'])}")
    env = _env(data.get("env", {}), ENV, f"{path}: ")
    read: dict[str, Any] = {
        key: from_table(kind, data.get(key, {}), f"{path}: {key}: ") for key, kind in tables.items()
    }
    own = []
    for number, group in enumerate(groups, 1):
        where = f"{path}: group {number}: "
        others = {key: value for key, value in group.items() if key != "env"}
        settings = from_table(Gradient, {**data.get("gradient", {}), **others}, where)
        for key in ("periods", "window", "rate"):
            if key in others:
                raise InputError(f"{where}{key} is the same for all groups: it belongs to gradient")
        own.append((_env(group.get("env", {}), env, where), settings))
    for name, each in (
        ("imitation", read["imitation"]),
        *(("gradient", g) for _, g in [*own, (env, read["gradient"])]),
    ):
        for key in ("rigs", "window"):
            if getattr(each, key) < 1:
                raise InputError(f"{path}: {name}: {key} should be at least 1")
    return Settings(**read, env=env, groups=tuple(own), text=text)


def _env(given: Mapping[str, Any], default: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Arguments of the environment."""
    for key in given:
        if key not in ENV:
            raise InputError(f"{where}env: unknown key {key!r}: {suggestion(key, ENV)}")
    return {**default, **given}


def from_table(kind: type[S], table: Mapping[str, Any], where: str = "") -> S:
    """Settings of a dataclass from a table; fields that are left out keep their default. InputError, which begins with `where`,
    for anything else."""
    known = {each.name: each for each in fields(kind)}  # type: ignore[arg-type]
    values = {}
    for key, value in table.items():
        if key not in known:
            raise InputError(f"{where}{shown(key)} is unknown: {suggestion(key, known)}")
        default: Any = known[key].default
        if isinstance(default, bool):
            if not isinstance(value, bool):
                raise InputError(f"{where}{key} {shown(value)} should be true or false")
        elif isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value < 1e5:
            raise InputError(f"{where}{key} {shown(value)} should be a number from 0 to 100000")
        values[key] = type(default)(value)
    return kind(**values)
