"""Models as data: round trips and the one line that says what is wrong."""

from __future__ import annotations

import re
import sys
import warnings
from math import inf
from pathlib import Path

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hydro_env.errors import InputError
from hydro_env.plant import CATALOGUE, PARAMETERS, PlantModel, load_model, parameter_of, preset_names


@pytest.mark.parametrize("name", preset_names())
def test_presets_load_and_survive_a_round_trip(name: str, tmp_path: Path) -> None:
    model = load_model(name)
    assert model.name == name
    model.to_yaml(tmp_path / "model.yaml")
    assert load_model(tmp_path / "model.yaml") == model


_EFFECTS = [f"{e.name}.{p.name}" for e in CATALOGUE.values() for p in e.parameters]


def _values(names: list[str]) -> st.SearchStrategy[dict[str, tuple[float, float]]]:
    """Values of some of these parameters: possible or neutral ones."""

    def one(name: str) -> st.SearchStrategy[float]:
        p = parameter_of(name)
        low, high = p.possible
        return st.one_of(st.just(p.neutral), st.floats(low or sys.float_info.min, min(high, 1e12)))

    def pairs(chosen: list[str]) -> st.SearchStrategy[dict[str, tuple[float, float]]]:
        return st.fixed_dictionaries({name: st.tuples(one(name), one(name)) for name in chosen})

    return st.lists(st.sampled_from(names), max_size=6, unique=True).flatmap(pairs)


@pytest.mark.filterwarnings("ignore::hydro_env.errors.InputWarning")
@settings(suppress_health_check=[HealthCheck.too_slow], deadline=None)
@given(base=_values(list(PARAMETERS)), effects=_values(_EFFECTS))
def test_any_model_survives_a_round_trip(
    tmp_path_factory: pytest.TempPathFactory, base: dict, effects: dict
) -> None:
    try:
        model = PlantModel("mine", {**base, **effects}, tolerance=0.02)
    except InputError as refused:
        assert re.search(
            r"channel [12](: D is|: k_stop is| has) .* can be simulated",
            str(refused),
        )
        return
    path = tmp_path_factory.mktemp("model") / "model.yaml"
    model.to_yaml(path)
    again = load_model(path)
    assert again == model
    assert load_model(model.to_dict()) == model


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"L": 5e-5}, "L: 5e-05 H is out of range; inductance of the coil is 0.0001 to 100 H"),
        ({"Fs": 3.0}, "Fs: 3 N is out of range; .* is 0 to 2 N"),
        ({"Fc": 0.0}, "channel 1 has 0 N of Coulomb and 0.2 N of static friction; 0.001 N or more of either"),
        (
            {"R": 1.0, "k_stop": 1e4},
            "channel 1: k_stop is 10000; against 1.46e[+]03 N of the coil 1.43e[+]06 N/m or more can be simulated",
        ),
        (
            {"D": 0.1},
            "channel 1: D is 0.1; with these J, V and beta 0.00149 m3/rad or less can be simulated",
        ),
        ({"Km": -1.0}, "Km: -1 .* is 0 to 5e-09"),
        ({"shaft_backlash.inertia": 1e-6}, "0.0001 to 0.01 kg m2"),
        ({"driver_saturation.voltage_limit": 0.01}, "0.1 to 1000 V"),
    ],
)
def test_what_is_not_simulated_correctly_is_refused_with_the_bound(values: dict, said: str) -> None:
    with pytest.raises(InputError, match=said) as caught:
        load_model("paper").with_values(values)
    assert "\n" not in str(caught.value)


def test_values_and_channels() -> None:
    model = load_model("paper").with_values({"dead_zone.overlap_positive": (7e-5, 0.0), "J": 0.003})
    assert model.value("Kq", 0) == 476106e-6 and model.value("Kq", 1) == 315000e-6
    assert model.channels[1]["J"] == 0.003
    assert model.effects == {
        "dead_zone": (
            {"overlap_positive": 7e-5, "overlap_negative": 0.0},
            {"overlap_positive": 0.0, "overlap_negative": 0.0},
        )
    }
    assert model.without("dead_zone").effects == {}
    assert load_model("paper").value("driver_saturation.voltage_limit", 0) == inf


GOOD = "schema: hydro_env/model/1\n"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("schema: other\n", "schema"),
        (GOOD + "chanel_1: {}\n", "did you mean 'channel_1'"),
        (GOOD + "both: {Kqq: 1}\n", "did you mean 'Kq'"),
        (GOOD + "both: {Kq: large}\n", "both.Kq is .large., should be a number"),
        (GOOD + "both: {Kq: -1.0}\n", "Kq: -1 m2/s is out of range"),
        (GOOD + "both: 3\n", "name: value"),
        (GOOD + "effects: {deadzone: {}}\n", "did you mean 'dead_zone'"),
        (GOOD + "effects: {dead_zone: {channel_3: {}}}\n", "channel_3"),
        (GOOD + "effects: {dead_zone: {both: {overlap: 1}}}\n", "overlap"),
        (GOOD + "base: nothing\n", "unknown plant"),
        ("{unbalanced", "not YAML"),
        (GOOD + "both: {R: 100.0, R: 101.0}\n", "'R' is given twice"),
        (GOOD + "effects: {dead_zone: {on: {overlap_positive: 1.0e-4}}}\n", "'on' is a truth value"),
        ("", "name: value"),
    ],
)
def test_a_wrong_file_is_refused_in_one_line(text: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "rig.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=said) as caught:
        load_model(path)
    assert "rig.yaml" in str(caught.value) or "unknown plant" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_file_or_preset_is_named() -> None:
    with pytest.raises(InputError, match="paper"):
        load_model("papr")
    with pytest.raises(InputError, match="no such file"):
        load_model("nowhere.yaml")


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ("effects: {dead_zone: {both: {overlap_positive: 70}}}", ["70 m", "0 to 0.00045 m"]),
        ("effects: {dead_zone: {both: {overlap_positive: -1.0e-5}}}", ["-1e-05 m", "0 to 0.00045 m"]),
        ("both: {D: 8.47}", ["both.D: 8.47 m3/rad", "1e-07 to 0.3 m3/rad"]),
        ("channel_1: {Kq: 315000}", ["channel_1.Kq: 315000 m2/s", "100 m2/s"]),
        ("both: {u_rated: 0.001}", ["0.1 to 1e+06 V"]),
    ],
)
def test_values_that_no_component_has_are_refused(given: str, words: list[str], tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(GOOD + given)
    with pytest.raises(InputError) as caught:
        load_model(path)
    for word in ["mine.yaml", "out of range", *words]:
        assert word in str(caught.value)


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ("{J: 28.0}", r"the supply takes \d+ s to bring the motor up to speed \(by J\)"),
        ("{k: 1.7e+4, m: 5.0e-2, D: 8.47e-4}", r"the open valve turns the motor at 4\.6\d rpm \(by D, k\)"),
        ("{k: 4.0e+5, s0: 1.0e+6, m: 3.0e-2, alpha: 470.0}", ""),
    ],
)
def test_a_rig_that_moves_unusually_warns_unless_sources_say_why(
    given: str, told: str, tmp_path: Path
) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(GOOD + f"both: {given}\n")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        load_model(path)
        path.write_text(path.read_text() + "sources: {J: weighed, D: data sheet, k: data sheet}\n")
        load_model(path)
    assert len(caught) == bool(told) and all(re.search(told, str(w.message)) for w in caught)


def test_neutral_values_presets_and_left_out_terms_pass_without_a_word(tmp_path: Path) -> None:
    quiet = ["both: {R: 31.2, Km: 0.0}", "effects: {crossport_relief: {both: {relief_pressure: .inf}}}"]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for text in quiet:
            load_model({"schema": "hydro_env/model/1", **yaml.safe_load(text)})
        for name in preset_names():
            load_model(name).to_yaml(tmp_path / "model.yaml")
            assert load_model(tmp_path / "model.yaml") == load_model(name)


def test_ranges_are_kept_until_a_value_leaves_them(tmp_path: Path) -> None:
    file = {
        "schema": "hydro_env/model/1",
        "base": "rig",
        "ranges": {"J": [0.002, 0.004], "flow_force.coefficient": [0, 2e-4]},
    }
    model = load_model(file)
    model.to_yaml(tmp_path / "model.yaml", source="test")
    again = load_model(tmp_path / "model.yaml")
    assert again == model and again.ranges["J"] == (0.002, 0.004)
    assert set(model.with_values({"J": 0.003}).ranges) == set(model.ranges)
    assert set(model.with_values({"J": (0.003, 0.005)}).ranges) == {"flow_force.coefficient"}
    assert set(model.without("flow_force").ranges) == {"J"}
    for wrong, said in (
        ({"J": [0.003, 0.004]}, "outside of its own range"),
        ({"J": [0.004, 0.003]}, "is no range from low to high"),
        ({"spring_preload.preload": [0, 1]}, "does not have the effect"),
    ):
        with pytest.raises(InputError, match=said):
            load_model({**file, "ranges": wrong})
