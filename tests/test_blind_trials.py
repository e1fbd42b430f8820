"""The seeds of blind trials stay what they are, whatever is added to the catalogue."""

from __future__ import annotations

from hydro_env.experiments import blind_trials as trials
from hydro_env.plant import BUILT_IN, CATALOGUE


def test_seeds_are_frozen() -> None:
    found = {(c.group, c.hidden): c.seed for c in trials.cases(list(trials.GROUPS), 100000, 2)}
    assert found["medium", ("command_delay:1",)] == 102000
    assert found["two", ("supply_droop", "dead_zone:2")] == 103003
    assert found["unlisted", ("supply_droop",)] == 104013
    assert found["no_twins", ("sensor_lag:2",)] == 111007
    assert found["noisy", ("sensor_offset:2",)] == 110027


def test_every_effect_has_its_trial() -> None:
    hidden = {c.hidden[0].split(":")[0] for c in trials.cases(["medium"], 0)}
    assert hidden == {n for n in BUILT_IN if not CATALOGUE[n].family}
