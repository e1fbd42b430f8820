"""Models as data: round trips and the one line that says what is wrong."""

from __future__ import annotations

from math import inf
from pathlib import Path

import pytest
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


_NUMBER = st.floats(1e-12, 1e12)
_EFFECTS = st.dictionaries(
    st.sampled_from([f"{e.name}.{p.name}" for e in CATALOGUE.values() for p in e.parameters]),
    st.tuples(st.floats(allow_nan=False), st.floats(allow_nan=False)),
    max_size=6,
)


def _by_factors(name: str) -> bool:
    p = parameter_of(name)
    return p.log and p.nominal > 0.0


def _positive(pair: tuple[float, float]) -> tuple[float, float]:
    return abs(pair[0]) or 1.0, abs(pair[1]) or 1.0


@settings(suppress_health_check=[HealthCheck.too_slow])
@given(base=st.dictionaries(st.sampled_from(list(PARAMETERS)), st.tuples(_NUMBER, _NUMBER)), effects=_EFFECTS)
def test_any_model_survives_a_round_trip(
    tmp_path_factory: pytest.TempPathFactory, base: dict, effects: dict
) -> None:
    own = {name: _positive(pair) if _by_factors(name) else pair for name, pair in effects.items()}
    model = PlantModel("mine", {**base, **own})
    path = tmp_path_factory.mktemp("model") / "model.yaml"
    model.to_yaml(path)
    again = load_model(path)
    assert again == model
    assert load_model(model.to_dict()) == model


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
        (GOOD + "both: {Kq: large}\n", "no number"),
        (GOOD + "both: {Kq: -1.0}\n", "must be positive"),
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
    with pytest.raises(InputError, match="cannot be read"):
        load_model("nowhere.yaml")
