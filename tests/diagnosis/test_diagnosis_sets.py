"""Sets of effects: several local ones against one that both channels share, and one in the place of two."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hydro_env.diagnosis import diagnose
from hydro_env.diagnosis.estimation.gauss_newton import solve
from hydro_env.diagnosis.logs import Logs
from hydro_env.diagnosis.stages import naming
from hydro_env.diagnosis.stages.candidates import (
    ABSENT,
    ACCEPTED,
    OUTDONE,
    Accepted,
    Candidate,
    Selection,
    penalty,
)
from hydro_env.diagnosis.stages.form_correction import Models
from hydro_env.diagnosis.stages.search import Search
from hydro_env.diagnosis.stages.selection import better_set, without_weakest
from hydro_env.diagnosis.stages.validation import Proof, Proofs
from hydro_env.diagnosis.stages.verdict import Confirmed
from hydro_env.practice.generate import make_practice
from tests.linear_rig import logged, time_of

ROWS = 4000
FIRST, SECOND = (np.sin(w * time_of(ROWS)) for w in (60.0, 83.0))
ONE, TWO = ("flow_gain_nonlinearity.curvature",), ("load_bias.bias", "sensor_offset.offset")
CURVES = dict(zip((*ONE, *TWO), (FIRST + SECOND, FIRST, SECOND), strict=True))


def _search(truth: dict[str, float], names: tuple[str, ...]) -> Search:
    """A search that has accepted these effects, on a rig whose speed is a sum of curves."""
    fit, base = logged(CURVES, truth, ROWS)
    found, search = base, Search(fit, {0: base}, [], 4.0, {0: base})
    for name in names:
        effect, _, parameter = name.partition(".")
        found = found.with_effect(effect, {parameter: 0.1})
        needed = penalty(fit, effect)
        search.accepted.append(Accepted(effect, 0, 500.0, needed, {}, base))
        search.candidates.append(Candidate(effect, 0, 1, 500.0, needed, ACCEPTED, found))
    solve(fit, [found], 8)
    search.present = {0: found}
    return search


def _selection(search: Search) -> Selection:
    logs = Logs(search.fit, search.fit.rig, search.fit.rig)
    return Selection(logs, search.calibrated, search.present, search.accepted, [], {})


@pytest.mark.parametrize("order", [1, -1])
def test_the_smaller_set_is_named_unless_the_larger_one_explains_more(order: int) -> None:
    shared = {ONE[0]: 0.2}
    alone, several = (_search(shared, names) for names in (ONE, TWO))
    best = better_set(*(alone, several)[::order])
    assert [k.effect for k in best.accepted] == ["flow_gain_nonlinearity"]
    # Little more than the price of the parameter that it saves parts them, so the name is not sure.
    (named,) = naming.name_effects(_selection(best), best.present)
    assert 0.5 < named.probability < 0.9
    assert [c.outcome for c in best.candidates].count(OUTDONE) == 2

    apart = {TWO[0]: 0.212, TWO[1]: 0.188}
    alone, several = (_search(apart, names) for names in (ONE, TWO))
    best = better_set(*(alone, several)[::order])
    assert [k.effect for k in best.accepted] == ["load_bias", "sensor_offset"]
    assert min(k.rival for k in best.accepted) > 200.0


def test_an_effect_that_both_sets_have_is_not_doubted_for_the_other_set() -> None:
    alone, several = (_search({ONE[0]: 0.2}, names) for names in (ONE, (*ONE, TWO[0])))
    best = better_set(several, alone)
    assert [(k.effect, k.rival) for k in best.accepted] == [("flow_gain_nonlinearity", np.inf)]


def test_what_may_be_absent_is_left_out_and_the_rest_is_settled() -> None:
    search = _search({ONE[0]: 0.2}, (*ONE, TWO[0]))
    search.accepted[1] = replace(search.accepted[1], gain=60.0)
    selection = replace(_selection(search), candidates=search.candidates)
    less = without_weakest(selection, search.accepted)
    assert [k.effect for k in less.accepted] == ["flow_gain_nonlinearity"]
    assert [k.outcome for k in less.candidates] == [ACCEPTED, ABSENT]
    pairs = zip(less.estimates[0].unknowns, less.estimates[0].q, strict=True)
    values = {u.effect: u.value(q) for u, q in pairs if u.effect}
    assert values == {"flow_gain_nonlinearity": pytest.approx(0.2, abs=0.01)}
    assert [k.outcome for k in selection.candidates] == [ACCEPTED, ACCEPTED] and len(selection.accepted) == 2


@pytest.mark.slow
def test_a_second_name_that_may_be_absent_costs_no_confirmation(tmp_path: Path) -> None:
    """Speed and load alone: beside the dead zone a delay and a sensor's scale take up what the laws' form leaves."""
    make_practice(
        ["dead_zone:2"], record=["setpoint", "load"], duration=6.0, rate=500.0, seed=650003, base_error=0.15,
        runs=("fit_2", "sealed"),
    ).write(tmp_path)  # fmt: skip
    found = diagnose([tmp_path / "fit_2.csv"], [tmp_path / "sealed.csv"], model=tmp_path / "model.yaml")
    assert [(e.name, e.channel) for e in found.effects] == [("dead_zone", "2")]
    assert found.verdict == "effects" and found.effects[0].indistinguishable_from == ["spring_preload"]


@pytest.mark.parametrize(("left", "factor"), [(1.05, 1.0), (1.2, naming.INCOMPLETE)])
def test_a_name_that_leaves_more_than_the_noise_is_less_likely(left: float, factor: float) -> None:
    search = _search({ONE[0]: 0.2}, ONE)
    selection, found = _selection(search), search.present
    proof = Proof(search.fit.rig, {(0, "speed"): {"noise": 1.0, "after": left}}, {})
    models = Models({}, search.calibrated, found, found, {})
    confirmed = Confirmed("effects", models, Proofs(proof, proof, proof, proof), [], [], [])
    (named,) = naming.run(selection, confirmed)
    (bare,) = naming.name_effects(selection, found)
    assert bare.probability > 0.99
    assert named.probability == pytest.approx(factor * bare.probability, abs=1e-3)


def _names(folder: Path, effects: list[str], values: dict[str, float], seed: int) -> dict[str, float]:
    """What a diagnosis of six seconds in closed loop names, "effect:channel", with the probabilities."""
    practice = make_practice(
        effects, values=values, duration=6.0, rate=500.0, seed=seed, base_error=0.1, runs=("fit_2", "sealed")
    )
    practice.write(folder)
    found = diagnose([folder / "fit_2.csv"], [folder / "sealed.csv"], model=folder / "model.yaml")
    assert found.verdict == "effects"
    return {f"{e.name}:{e.channel}": e.probability for e in found.effects}


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 4])
def test_a_weak_supply_is_no_set_of_local_effects(tmp_path: Path, seed: int) -> None:
    values = {
        "supply_droop.relative_drop": 0.477,
        "supply_droop.time_constant": 0.01,
        "pressure_dependent_flow.supply_pressure": 60e5,
    }
    named = _names(tmp_path, ["supply_droop", "pressure_dependent_flow"], values, seed)
    assert {*named} == {"supply_droop:rig", "pressure_dependent_flow:both"}


@pytest.mark.slow
def test_two_local_effects_are_no_effect_of_the_rig(tmp_path: Path) -> None:
    named = _names(tmp_path, ["flow_gain_nonlinearity"], {"flow_gain_nonlinearity.curvature": 0.3}, 2)
    assert {*named} == {"flow_gain_nonlinearity:both"}


@pytest.mark.slow
def test_an_orifice_law_at_a_low_supply_pressure_needs_no_second_name(tmp_path: Path) -> None:
    values = {"pressure_dependent_flow.supply_pressure": 14e5}
    assert {*_names(tmp_path, ["pressure_dependent_flow"], values, 1)} == {"pressure_dependent_flow:both"}
