"""Splits, distributions and pairs: ranges as published, fixed cases, disjoint splits, clear refusals."""

import warnings

import numpy as np
import pytest
import yaml

from hydro_env.errors import InputError, InputWarning
from hydro_env.plant import CATALOGUE, PARAMETERS, load_model, preset_names
from hydro_env.tasks import SCENARIOS
from hydro_env.tasks.mismatch import NAMED_PAIRS, SENSOR_PARAMETERS, SPLITS, draw_pairs, load_mismatch

KQ = 476106e-6
NARROW = {
    "dead_zone.overlap_positive": (0, 200e-6),
    "dead_zone.overlap_negative": (0, 200e-6),
    "Kq": (0.65 * KQ, KQ),
    "Fs": (0.1, 0.4),
    "Fc": (0.1, 0.3),
    "vs": (1e-4, 1e-2),
    "null_offset.offset": (-30e-6, 30e-6),
    "R": (90, 110),
}
WIDE = {
    **NARROW,
    "dead_zone.overlap_positive": (0, 300e-6),
    "dead_zone.overlap_negative": (0, 300e-6),
    "Kq": (0.5 * KQ, 1.25 * KQ),
    "Fs": (0.1, 0.6),
    "Fc": (0.1, 0.6),
    "null_offset.offset": (-50e-6, 50e-6),
    "R": (80, 120),
    "magnetic_hysteresis.amplitude": (0, 0.3),
}


@pytest.mark.parametrize("split", ["train", "val", "test_interp", "test_extrap"])
def test_ranges_are_kept_and_used(split):
    ranges = WIDE if split == "test_extrap" else NARROW
    pairs = draw_pairs(split, 400)
    assert set(pairs.values) == set(ranges)
    for name, (low, high) in ranges.items():
        values = pairs.values[name]
        assert values.shape == (400, 2)
        assert (values >= low).all() and (values <= high).all(), name
        assert np.corrcoef(values.T)[0, 1] == pytest.approx(0.0, abs=0.2), name
        # the whole range is used, evenly in the logarithm where it says so
        ends = np.log([low, high]) if name in ("Kq", "vs") else np.array([low, high])
        spread = np.log(values) if name in ("Kq", "vs") else values
        assert np.ptp(spread) > 0.9 * (ends[1] - ends[0]), name
        if name != "Fc":
            assert spread.mean() == pytest.approx(ends.mean(), abs=0.06 * (ends[1] - ends[0])), name
    assert (pairs.values["Fc"] <= pairs.values["Fs"]).all()


def test_every_extrapolated_pair_leaves_the_training_ranges():
    pairs = draw_pairs("test_extrap", 1000).values
    outside = np.zeros(1000, bool)
    for name, (low, high) in NARROW.items():
        outside |= ((pairs[name] < low) | (pairs[name] > high)).any(axis=1)
    assert outside.all()


def test_pairs_inside_are_drawn_again():
    wide = {"R": {"uniform": [89.0, 111.0]}}
    source = load_mismatch({"parameters": wide, "entropy": 5, "cases": 100, "outside": "train"})
    values = draw_pairs(source, 100).values["R"]
    assert ((values < 90) | (values > 110)).any(axis=1).all()
    np.testing.assert_array_equal(draw_pairs(source, [41]).values["R"][0], values[41])


def test_splits_are_disjoint():
    seen = {}
    for split in SPLITS:
        for pair in draw_pairs(split, 300).values["Kq"]:
            assert seen.setdefault(tuple(pair), split) == split
    for seed in range(20):
        for pair in draw_pairs("train", 20, seed=seed).values["Kq"]:
            assert seen.get(tuple(pair), "train") == "train"


@pytest.mark.parametrize("split", ["val", "test_interp", "test_extrap", "faulted"])
def test_cases_are_fixed(split):
    whole = draw_pairs(split, 40)
    some = draw_pairs(split, [3, 17, 3], seed=99)
    for name, values in whole.values.items():
        np.testing.assert_array_equal(some.values[name], values[[3, 17, 3]])
    assert some.fault == tuple(whole.fault[k] for k in (3, 17, 3))
    with pytest.raises(InputError, match="999"):
        draw_pairs(split, [1000])


def test_published_cases_stay_what_they_are():
    """Scores of different versions can only be compared on the same pairs."""
    interp, extrap = draw_pairs("test_interp", [0]).values, draw_pairs("test_extrap", [7]).values
    assert interp["Kq"][0] == pytest.approx([0.35704729330637947, 0.346551192630065], rel=1e-12)
    assert extrap["R"][0] == pytest.approx([119.50602431543032, 87.61461265069929], rel=1e-12)


def test_train_follows_the_seed():
    first, second = draw_pairs("train", 5, seed=1).values, draw_pairs("train", 5, seed=2).values
    assert not np.intersect1d(first["Kq"], second["Kq"]).size
    np.testing.assert_array_equal(draw_pairs("train", [4], seed=1).values["R"][0], first["R"][4])


def test_one_fault_per_case_on_one_channel():
    pairs = draw_pairs("faulted", 60)
    names = list(SPLITS["faulted"].faults)
    assert len(names) == 6
    assert [pairs.fault.count(name) for name in names] == [10] * 6
    neutral = {
        "speed_sensor.stuck_from": np.inf, "speed_sensor.noise_factor": 1.0, "spool_stiction.static": 0.0,
        "spool_stiction.coulomb": 0.0, "sensor_lag.time_constant": 0.0, "Km": load_model("paper").value("Km", 0),
    }  # fmt: skip
    for case, fault in enumerate(pairs.fault):
        sick = {name for name, healthy in neutral.items() if (pairs.values[name][case] != healthy).any()}
        assert sick == set(SPLITS["faulted"].faults[fault]) - {"R"}
        for name in sick:
            assert (pairs.values[name][case] != neutral[name]).sum() == 1
        hot = (pairs.values["R"][case] > 110).sum()
        assert hot == (1 if fault == "hot_coil" else 0)
        assert (
            pairs.values["spool_stiction.coulomb"][case] <= pairs.values["spool_stiction.static"][case]
        ).all()


def test_named_pair_is_the_papers():
    model = load_model("paper")
    for name, values in draw_pairs("paper_pair", 1).values.items():
        assert tuple(values[0]) == model.pair(name)


def test_mapping_and_file(tmp_path):
    source = {"Kq": {"loguniform": [0.3, 0.4]}, "dead_zone.overlap_positive": [7e-5, 0], "R": "101.5"}
    values = draw_pairs(source, 3).values
    assert (values["dead_zone.overlap_positive"] == [7e-5, 0]).all()
    assert (values["R"] == 101.5).all()
    assert ((values["Kq"] >= 0.3) & (values["Kq"] <= 0.4)).all()
    path = tmp_path / "mine.yaml"
    path.write_text("Kq: {loguniform: [0.3, 4e-1]}\ndead_zone.overlap_positive: [7e-5, 0]\nR: 101.5\n")
    for name, same in draw_pairs(str(path), 3).values.items():
        np.testing.assert_array_equal(same, values[name])


def test_a_split_is_extended(tmp_path):
    """What is not named stays as it is, number by number."""
    of_base = draw_pairs("train", 20).values
    more = {
        "base": "train",
        "R": {"uniform": [95, 105]},
        "magnetic_hysteresis.amplitude": {"uniform": [0.0, 0.1]},
    }
    values = draw_pairs(more, 20).values
    assert values.keys() - of_base.keys() == {"magnetic_hysteresis.amplitude"}
    for name in of_base.keys() - {"R"}:
        np.testing.assert_array_equal(values[name], of_base[name])
    assert ((values["R"] >= 95) & (values["R"] <= 105)).all() and np.ptp(values["R"]) > 5
    path = tmp_path / "mine.yaml"
    path.write_text("base: test_interp\ncases: 3\nparameters: {R: 100}\n")
    mine = load_mismatch(path)
    assert mine.cases == 3
    np.testing.assert_array_equal(draw_pairs(mine, 3).values["Kq"], draw_pairs("test_interp", 3).values["Kq"])


def test_what_is_unusual_warns_once():
    source = {"Kq": {"uniform": [0.3, 2.0]}, "R": [100.0, 300.0], "command_delay.delay": 0.5, "Fs": 0.2}
    with pytest.warns(InputWarning) as caught:
        load_mismatch(source)
    (told,) = [str(each.message) for each in caught]
    for part in (
        "mismatch: ",
        "Kq 0.3 to 2 (usual 0.15 to 0.75 m2/s)",
        "R 100 to 300 (usual 80 to 125 Ohm)",
        "delay 0.5",
    ):
        assert part in told
    assert "Fs" not in told and "\n" not in told


def test_what_is_usual_on_the_plant_that_it_is_meant_for_does_not_warn():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load_mismatch(
            {
                "R": {"uniform": [28.0, 34.0], "meant_for": 31.2},
                "Km": {"uniform": [1e-10, 4e-10]},
            }
        )
        load_mismatch({"base": "faulted", "R": {"uniform": [95, 105]}})
    with pytest.warns(InputWarning, match="R 28 to 34"):
        load_mismatch({"R": {"uniform": [28.0, 34.0]}})


def test_rig_effects_are_shared():
    values = draw_pairs({"supply_droop.relative_drop": {"uniform": [0.1, 0.5]}}, 5).values[
        "supply_droop.relative_drop"
    ]
    assert (values[:, 0] == values[:, 1]).all()
    assert np.ptp(values) > 0


@pytest.mark.parametrize(
    ("source", "told"),
    [
        ("test_interpp", "did you mean 'test_interp'"),
        ("nothing.yaml", "nothing.yaml"),
        ({"Kqq": 1.0}, "Kqq.*did you mean 'Kq'"),
        ({"dead_zone.width": 1.0}, "no parameter 'width'"),
        ({"speed_sensor.stuck": 1.0}, "stuck_from"),
        ({"Kq": {"normal": [0.3, 0.1]}}, "Kq: unknown key 'normal': did you mean 'uniform'"),
        ({"Kq": {"uniform": [0.4, 0.3]}}, "no range"),
        ({"Kq": {"uniform": [0.4]}}, "Kq.uniform is .* at least 2 items"),
        ({"Kq": {"at_most": "Fs"}}, "uniform or loguniform"),
        ({"vs": {"loguniform": [0.0, 1.0]}}, "above zero"),
        ({"Kq": [1, 2, 3]}, "each of the two"),
        ({"Kq": True}, "neither a number"),
        ({"Kq": float("nan")}, "neither a number"),
        ({"J": -1.0}, "out of range"),
        ({"Fc": {"uniform": [0.1, 0.3], "at_most": "Fs"}}, "not among the parameters above"),
        ({"supply_droop.relative_drop": [0.1, 0.2]}, "share"),
        ({"base": "trian"}, "base: .*did you mean 'train'"),
        ({"base": "train", "Fs": {"uniform": [0.05, 0.4]}}, "Fs may be lower"),
    ],
)
def test_refused(source, told):
    with pytest.raises(InputError, match=told) as caught:
        load_mismatch(source)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("R: 100.0\nKq: 0.3\nR: 101.0\n", "mine.yaml line 3: .*'R' is given twice"),
        ("Kq: {uniform: [0.3, 0.4], on: 0.5}\n", "mine.yaml line 1: .*'on' is a truth value in YAML"),
        ("no: 1.0\n", "'no' is a truth value"),
        ("Kq: yes\n", "neither a number"),
        ("Kq: [0.3\n", "mine.yaml line"),
    ],
)
def test_the_traps_of_yaml_are_one_line(text, told, tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=told) as caught:
        load_mismatch(path)
    assert "\n" not in str(caught.value)


def test_no_name_of_ours_means_something_else_to_yaml():
    """YAML 1.1 reads on, off, yes, no as truth values, 1:30 as a number, and more; our names stay words."""
    names = [*PARAMETERS, *CATALOGUE, *(p.name for e in CATALOGUE.values() for p in e.parameters)]
    names += [
        *SPLITS,
        *NAMED_PAIRS,
        *SENSOR_PARAMETERS,
        *SPLITS["faulted"].faults,
        *SCENARIOS,
        *preset_names(),
    ]
    names += ["uniform", "loguniform", "at_most", "meant_for", "outside", "valve", "both", "rig", "sources"]
    for name in names:
        assert yaml.safe_load(f"{name}: 1") == {name: 1}


def test_none_is_the_plants_own_pair():
    assert load_mismatch(None) is None
