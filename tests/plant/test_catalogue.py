"""An effect is described once: what a new entry of the catalogue declares is what every part of the program uses."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator
from math import inf
from pathlib import Path

import numpy as np
import pytest

from hydro_env.diagnosis.estimation.unknowns import effect_starts, effect_unknowns
from hydro_env.diagnosis.input.parts import read_parts
from hydro_env.diagnosis.models.dynamic_rig import DynamicRig
from hydro_env.diagnosis.report import wording
from hydro_env.plant import (
    CATALOGUE,
    Effect,
    Parameter,
    Scales,
    load_model,
    register,
    simulate,
    unregister,
)
from hydro_env.plant.catalogue import separating_experiment
from hydro_env.practice.generate import make_practice

NAME = "seal_swelling"


def _torque(torque, speed, amount, drift, time):
    return torque - amount * speed * (time / (time + drift))


def _shared(drive, share, other_flow):
    return drive - share * other_flow


SWELLING = Effect(
    name=NAME,
    port="motor",
    title="swelling seals of the motor",
    summary="drag that grows with time",
    signature="the motor slows down",
    source="an example",
    parameters=(
        Parameter("amount", "N m s/rad", 0.0, low=0.0, high=0.02, typical=0.004, scaling={"D": 1.0},
                  note="drag in the end; per speed", source="assumed"),
        Parameter("drift", "s", 60.0, low=0.5, high=600.0, log=True, role="time_constant", source="assumed"),
    ),
    laws={"torque": _torque},
    indistinguishable_from=("viscosity_drift",),
    separated_by={"viscosity_drift": "hold the temperature of the oil"},
)  # fmt: skip
SHARED = Effect(
    name="shared_return", port="flow", summary="s", signature="s", source="s",
    parameters=(Parameter("share", "s/m3", 0.0, low=0.0, high=1e3, typical=300.0, source="assumed"),),
    laws={"drive": _shared},
)  # fmt: skip
SECOND_DELAY = Effect(
    name="bus_delay", port="driver", summary="s", signature="s", source="s", delays_command="late",
    parameters=(Parameter("late", "s", 0.0, low=0.0, high=0.02, typical=0.01, source="assumed"),),
)  # fmt: skip


@pytest.fixture(autouse=True)
def registered() -> Iterator[None]:
    for effect in (SWELLING, SHARED, SECOND_DELAY):
        register(effect)
    yield
    for effect in (SWELLING, SHARED, SECOND_DELAY):
        unregister(effect.name)


def _effects_table() -> str:
    path = Path(__file__).parents[2] / "docs" / "generate.py"
    specification = importlib.util.spec_from_file_location("docs_generate", path)
    assert specification is not None and specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return str(module.effects())


def test_a_new_effect_is_simulated_hidden_a_candidate_and_in_the_documents(tmp_path: Path) -> None:
    values = {f"{NAME}.amount": np.array([0.0, 0.01]), f"{NAME}.drift": 1.0}
    speed = simulate("paper", np.full((200, 2), 50.0), None, 0.01, values=values, num_rigs=2)["speed"]
    assert 0.2 * speed[-1, 0, 0] < speed[-1, 1, 0] < 0.9 * speed[-1, 0, 0]

    practice = make_practice([f"{NAME}:1"], runs=("fit_1",), duration=3.0, rate=100.0, noise=0.0, seed=3)
    assert [e["name"] for e in practice.truth["effects"]] == [NAME]
    practice.write(tmp_path)
    rig = DynamicRig(load_model("paper"), read_parts([tmp_path / "fit_1.csv"], None))
    assert NAME in rig.candidates()

    row = next(line for line in _effects_table().splitlines() if f"`{NAME}`" in line)
    assert SWELLING.summary in row and "`amount` 0 to 0.02" in row and "`drift` 0.5 to 600 s" in row


def test_its_words_and_its_experiment_are_those_of_the_report() -> None:
    assert wording.title(NAME) == "swelling seals of the motor"
    assert CATALOGUE[NAME].parameter("amount").title == "drag in the end"
    assert CATALOGUE[NAME].parameter("drift").title == "drift"
    assert wording.title("shared_return") == "shared return"
    assert separating_experiment(NAME, "viscosity_drift") == "hold the temperature of the oil"
    assert separating_experiment("viscosity_drift", NAME) == "hold the temperature of the oil"
    assert separating_experiment(NAME, "dead_zone") == ""


def test_its_roles_decide_how_it_is_estimated() -> None:
    assert [p.role for p in SWELLING.parameters] == ["size", "time_constant"]
    # A time constant of a minute is tried as fast as the log is long.
    first = effect_starts(SWELLING, 6.0)
    assert {row["drift"] for row in first} == {0.4 * 6.0}
    amount, drift = effect_unknowns(SWELLING, first[0])
    assert drift.log and drift.prior and not amount.prior
    assert SWELLING.is_neutral({"drift": 3.0}) and not SWELLING.is_neutral({"amount": 1e-3})


def test_what_is_usual_in_volts_is_a_share_of_the_rated_command() -> None:
    limits = [
        row["voltage_limit"]
        for row in effect_starts(Scales(command=10.0 / 73.0).effect(CATALOGUE["driver_saturation"]), 12.0)
    ]
    assert min(limits) < 4.0 and max(limits) < 10.0


def test_an_effect_that_reads_the_other_flow_couples_the_channels(tmp_path: Path) -> None:
    assert SHARED.couples_channels and not SWELLING.couples_channels
    command = np.column_stack([np.full(100, 50.0), np.full(100, 70.0)])
    both = simulate("paper", command, None, 0.01, values={"shared_return.share": 300.0})["speed"][-1, 0]
    alone = simulate("paper", command * [1.0, 0.0], None, 0.01, values={"shared_return.share": 300.0})[
        "speed"
    ][-1, 0]
    assert both[0] < 0.99 * alone[0]
    practice = make_practice(["dead_zone:1"], runs=("fit_1",), duration=3.0, rate=100.0, seed=3)
    practice.write(tmp_path)
    lines = (tmp_path / "fit_1.csv").read_text().splitlines()
    keep = [n for n, column in enumerate(lines[0].split(",")) if "_2_" not in column]
    (tmp_path / "one.csv").write_text("\n".join(",".join(line.split(",")[n] for n in keep) for line in lines))
    rig = DynamicRig(load_model("paper"), read_parts([tmp_path / "one.csv"], None))
    assert rig.channels == (0,)
    assert {"shared_return", "supply_droop"}.isdisjoint(rig.candidates()) and NAME in rig.candidates()


def test_delays_of_the_command_add_up() -> None:
    command = np.concatenate([np.zeros((5, 2)), np.full((60, 2), 50.0)])
    runs = {
        names: simulate("paper", command, None, 1e-3, record=("current",),
                        values={"command_delay.delay": names[0], "bus_delay.late": names[1]})["current"][:, 0, 0]
        for names in ((0.0, 0.0), (0.004, 0.0), (0.004, 0.007))
    }  # fmt: skip
    onset = {names: int(np.argmax(current > 1e-3)) for names, current in runs.items()}
    assert [n - onset[0.0, 0.0] for n in onset.values()] == [0, 4, 11]


def test_what_effects_say_of_each_other_exists() -> None:
    for effect in CATALOGUE.values():
        others = (*effect.indistinguishable_from, *effect.separated_by, *effect.corrects)
        assert {*others} <= {*CATALOGUE}, effect.name
        for name in effect.separated_by:
            assert effect.name not in CATALOGUE[name].separated_by, "the experiment for a pair stands once"


@pytest.mark.parametrize(
    ("change", "line"),
    [
        ({"port": "pipe"}, "port 'pipe' is none of driver, coil"),
        ({"laws": {"flows": _shared}}, "a law changes 'flows', none of"),
        ({"name": "dead_zone"}, "is in the catalogue already"),
        ({"delays_command": "delay"}, "has no parameter 'delay', none of share"),
        ({"adds_to": {"Fc": "more"}}, "has no parameter 'more'"),
        ({"parameters": (Parameter("share", "1", 0.0, 0.0, 1.0, "assumed"),)}, "must have a typical value"),
    ],
)
def test_a_wrong_entry_is_refused(change: dict[str, object], line: str) -> None:
    with pytest.raises(ValueError, match=line):
        register(Effect(**{**vars(SHARED), "name": "other", "title": "", **change}))  # type: ignore[arg-type]
    assert "other" not in CATALOGUE


@pytest.mark.parametrize(
    ("change", "line"),
    [
        ({"role": "number"}, "role 'number' is none of size, limit"),
        ({"role": "shape"}, "a shape has no typical value"),
        ({"role": "size", "typical": 0.0}, "needs a typical value besides its neutral one"),
        ({"scaling": {"J": 1.0}}, "scaling 'J' is none of k, Kq, D"),
    ],
)
def test_a_wrong_parameter_is_refused(change: dict[str, object], line: str) -> None:
    with pytest.raises(ValueError, match=line):
        Parameter("p", "1", 0.0, 0.0, 1.0, "assumed", **{"typical": 0.5, **change})  # type: ignore[arg-type]


def test_a_limit_is_a_size_whose_neutral_value_is_infinite() -> None:
    limit = Parameter("p", "V", inf, 1.0, 70.0, "assumed", typical=40.0)
    assert limit.role == "limit" and limit.carries_size
    assert CATALOGUE["driver_saturation"].is_neutral({"voltage_limit": inf})
