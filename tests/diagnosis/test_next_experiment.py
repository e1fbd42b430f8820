"""The next experiment: commands that part models, within the limits, as a file that a rig can play."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from docs.evidence.naming_methods.designs import random_design
from hydro_env.diagnosis import Settings, experiment_design
from hydro_env.diagnosis.estimation.estimate import Estimate, Intervals
from hydro_env.diagnosis.estimation.fit import Fit
from hydro_env.diagnosis.estimation.unknowns import base_unknown, effect_unknowns
from hydro_env.diagnosis.experiment_design import (
    PERIOD,
    SECONDS,
    Operation,
    Question,
    Trial,
    best_design,
)
from hydro_env.diagnosis.input.parts import read_parts
from hydro_env.diagnosis.models.dynamic_rig import DynamicRig
from hydro_env.diagnosis.stages.next_experiment import NextExperiment, max_load
from hydro_env.plant import CATALOGUE, PARAMETERS, PlantModel, load_model, simulate
from hydro_env.practice.generate import make_practice
from hydro_env.practice.manoeuvres import plans_of
from hydro_env.units import BAR, RPM

NOISE = {(0, "speed"): RPM, (0, "current"): 0.002, (0, "pressure"): 0.05 * BAR}
RATED = 73.0


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> DynamicRig:
    folder = tmp_path_factory.mktemp("practice")
    make_practice([], duration=3.0, rate=500.0, runs=("fit_1",)).write(folder)
    return DynamicRig(load_model("paper"), read_parts([folder / "fit_1.csv"], None))


def _estimate(
    fit: Fit, name: str, times: float = 1.0, spread: float = 0.0, channel: int | None = 0
) -> Estimate:
    """A model with an effect of so many times its typical size; the logs leave it open by `spread` (in q)."""
    effect = CATALOGUE[name]
    values = {p.name: p.nominal + times * ((p.typical or p.nominal) - p.nominal) for p in effect.parameters}
    unknowns = effect_unknowns(effect, values)
    found = Estimate(channel, unknowns, np.zeros(len(unknowns)), name)
    draws = np.linspace(-1.0, 1.0, 8)[:, None] * np.full(len(unknowns), spread)
    found.intervals = Intervals(*(np.zeros(len(unknowns)) for _ in range(2)), draws)
    # As if it explained the logs.
    found.simulated = {
        c: np.concatenate([s.filled for s in fit.rig.segments[c]]) for c in fit.channels_of(found)
    }
    return found


def _experiment(command_V: np.ndarray, load: np.ndarray) -> np.ndarray:
    return np.stack([command_V / RATED, load], axis=-1)


def _asked(fit: Fit) -> list[Question]:
    return [Question(0, {name: _estimate(fit, name) for name in ("spool_stiction", "dead_zone")})]


def test_commands_part_two_models_better_than_random_ones(rig: DynamicRig) -> None:
    fit = Fit(rig, NOISE)
    asked = _asked(fit)
    found = best_design(Trial(fit, asked), np.random.default_rng(1))
    assert found is not None and min(found.apart.values()) > 1.0
    others = [random_design(rig.model, fit.settings, np.random.default_rng(n)) for n in range(10)]
    tried = np.array([_experiment(*each) for each in ((found.command_V, found.load), *others)])
    trial = Trial(fit, asked)
    scores = trial.scores(trial.simulated(tried))[:, 0]
    assert scores[0] > scores[1:].max()


def test_what_is_apart_already_counts_no_more(rig: DynamicRig, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ten times the distance is worth next to nothing where two models are far apart, and much where they are not."""

    def score(square: float) -> float:
        apart = {("a", "b"): np.array([square])}
        monkeypatch.setattr(Trial, "read", lambda *_: ([apart], {}))
        return float(Trial(Fit(rig, NOISE), [Question(0, {})]).scores(([], np.ones((1, 2), bool)))[0, 0])

    assert 0.0 < score(1e4) - score(1e2) < 0.02
    assert score(1e-1) - score(1e-3) > 1.0 and score(0.0) == 0.0


def test_the_form_of_an_effect_hides_what_a_log_says(
    rig: DynamicRig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An estimate with an effect is left more open by an experiment than if its law were exact; one without is not."""
    fit = Fit(rig, NOISE)
    tried = _experiment(*random_design(rig.model, fit.settings, np.random.default_rng(8)))[None]

    def left(effect: str, form: float) -> float:
        monkeypatch.setattr(experiment_design, "FORM", form)
        estimate = _estimate(fit, effect, 1.0, 0.02) if effect else _base(fit)
        trial = Trial(fit, [], {0: Operation(estimate, np.eye(8))})
        return float(trial.read(trial.simulated(tried))[1][0][0])

    assert left("dead_zone", 0.1) > 1.05 * left("dead_zone", 0.0)
    assert left("", 0.1) == left("", 0.0)


def _base(fit: Fit) -> Estimate:
    """A model without any effect, of which the logs leave the gain open."""
    found = Estimate(0, [base_unknown(PARAMETERS["Kq"], fit.rig.model.value("Kq", 0))], np.zeros(1), "")
    found.intervals = Intervals(*(np.zeros(1) for _ in range(2)), np.linspace(-0.05, 0.05, 8)[:, None])
    found.simulated = {0: np.concatenate([s.filled for s in fit.rig.segments[0]])}
    return found


def test_the_commands_keep_to_the_limits(rig: DynamicRig) -> None:
    fit = Fit(rig, NOISE, Settings(command_limit=0.5, rate_limit=2.0, pressure_limit=6.0 * BAR))
    asked = _asked(fit)
    found = best_design(Trial(fit, asked), np.random.default_rng(2))
    assert found is not None and found.command_V.shape == (round(SECONDS / PERIOD), 2)
    share = found.command_V / RATED
    assert np.abs(share).max() <= 0.5 and np.abs(np.diff(share, axis=0)).max() <= 2.0 * PERIOD * (1 + 1e-9)
    assert share[0].tolist() == [0.0, 0.0] and np.abs(share).max() > 0.1
    model = _model(rig.model, asked[0].models["dead_zone"])
    out = simulate(model, found.command_V, np.zeros_like(share), PERIOD, record=["pressure"])
    assert np.abs(out["pressure"][:, 0, 0]).max() < 6.0 * BAR
    impossible = replace(fit, settings=Settings(pressure_limit=1.0))
    assert best_design(Trial(impossible, asked), np.random.default_rng(2)) is None


def _model(model: PlantModel, estimate: Estimate) -> PlantModel:
    return model.with_values({n: (v, model.value(n, 1)) for n, v in estimate.values(0).items()})


def test_what_a_parameter_would_make_up_for_counts_for_nothing(rig: DynamicRig) -> None:
    fit = Fit(rig, NOISE)
    tried = _experiment(*random_design(rig.model, fit.settings, np.random.default_rng(3)))[None]

    def apart(spread: float) -> float:
        other = _estimate(fit, "quadratic_drag", 1.05)
        trial = Trial(
            fit, [Question(0, {"one": _estimate(fit, "quadratic_drag", 1.0, spread), "other": other})]
        )
        (apart,), _ = trial.read(trial.simulated(tried))
        return float(apart["one", "other"][0])

    assert apart(spread=0.3) < 0.02 * apart(spread=0.0)


def test_a_model_of_the_rig_is_parted_from_one_of_a_channel(rig: DynamicRig) -> None:
    """Where an effect of the rig was accepted before those of a channel, they are tied with estimates of that channel alone."""
    fit = Fit(rig, NOISE | {(1, signal): noise for (_, signal), noise in NOISE.items()})
    models = {
        "supply_droop": _estimate(fit, "supply_droop", channel=None),
        "dead_zone": _estimate(fit, "dead_zone"),
    }
    trial = Trial(fit, [Question(0, models)])
    tried = _experiment(*random_design(rig.model, fit.settings, np.random.default_rng(7)))[None]
    (apart,), _ = trial.read(trial.simulated(tried))
    assert apart["supply_droop", "dead_zone"][0] > 0.1


def test_where_torques_have_no_scale_loads_are_proposed(rig: DynamicRig, tmp_path: Path) -> None:
    """The fit logs leave open one scale of displacement, inertia, losses, flow and capacity; the held-out log is under load."""
    fit = Fit(rig, NOISE)
    names = {"D": 1.0, "J": 1.0, "B": 1.0, "Km": 1.0, "Kq": 1.0, "beta": -1.0}
    unknowns = [base_unknown(PARAMETERS[name], rig.model.value(name, 0)) for name in names]
    estimate = Estimate(0, unknowns, np.zeros(len(names)), "")
    ways = np.array([sign * 0.05 / u.scale for sign, u in zip(names.values(), unknowns, strict=True)])
    draws = np.linspace(-1.0, 1.0, 8)[:, None] * ways
    estimate.intervals = Intervals(*(np.zeros(len(names)) for _ in range(2)), draws)
    estimate.simulated = {0: np.concatenate([s.filled for s in fit.rig.segments[0]])}
    make_practice([], rate=500.0, runs=("sealed",)).write(tmp_path)
    held_out = fit.on(DynamicRig(rig.model, read_parts([tmp_path / "sealed.csv"], None)))
    operation = Operation.of(held_out, estimate, 0)
    assert operation is not None and np.trace(operation.apart) > 1.0
    trial = Trial(fit, [], {0: operation})
    command, load = random_design(rig.model, fit.settings, np.random.default_rng(5), max_load=0.6)
    both = np.array([_experiment(command, load), _experiment(command, 0.0 * load)])
    (with_load, without) = trial.read(trial.simulated(both))[1][0]
    assert with_load < 0.2 * without and without > 0.5 * np.trace(operation.apart)
    found = best_design(trial, np.random.default_rng(6), max_load=0.6)
    assert found is not None and 0.1 < np.abs(found.load[:, 0]).max() <= 0.6
    assert found.prediction is not None and found.prediction[1] < 0.2 * found.prediction[0]


def test_the_commands_are_a_file_that_a_rig_plays(rig: DynamicRig, tmp_path: Path) -> None:
    fit = Fit(rig, NOISE)
    found = best_design(Trial(fit, _asked(fit)), np.random.default_rng(4), max_load=0.5)
    assert found is not None
    text = NextExperiment("", ["dead_zone", "spool_stiction"], found).csv()
    assert text is not None
    (tmp_path / "next.csv").write_text(text)
    plans = plans_of(tmp_path / "next.csv", (RATED, RATED), PERIOD)
    played = np.column_stack([p.value for p in plans]) * RATED
    np.testing.assert_allclose(played, found.command_V, rtol=0.0, atol=0.00051)
    loads = np.column_stack([p.load for p in plans])
    np.testing.assert_allclose(loads, found.load, rtol=0.0, atol=0.00051)
    assert loads.any() and not any(p.closed.any() for p in plans)


@pytest.mark.parametrize(
    ("loads", "largest"), [((None, None), 0.0), ((None, np.array([-0.4, np.nan, 0.3])), 0.4)]
)
def test_loads_are_no_larger_than_those_of_the_logs(
    loads: tuple[np.ndarray | None, ...], largest: float
) -> None:
    fit, held_out = ([SimpleNamespace(log=SimpleNamespace(load=load))] for load in loads)
    logs = SimpleNamespace(fit=SimpleNamespace(settings=Settings()), held_out=SimpleNamespace(parts=held_out))
    state: Any = SimpleNamespace(logs=logs, rig=SimpleNamespace(parts=fit))
    assert max_load(state) == largest
