"""What makes a name doubtful."""

import numpy as np

from hydro_env.diagnosis.estimation.estimate import Estimate
from hydro_env.diagnosis.estimation.fit import Fit
from hydro_env.diagnosis.estimation.uncertainty import Intervals, unpredictable
from hydro_env.diagnosis.logs import Logs
from hydro_env.diagnosis.models.base import Segment, Segments
from hydro_env.diagnosis.stages.candidates import Accepted
from hydro_env.diagnosis.stages.validation import Proof, Proofs
from hydro_env.diagnosis.stages.verdict import doubts
from hydro_env.plant import CATALOGUE
from tests.linear_rig import LinearRig, logged, time_of

ROWS = 12000
TIME = time_of(ROWS)


def _doubts(
    fit: dict[str, float],
    sealed: dict[str, float],
    has_hidden_states: bool = True,
    share: float = 1.0,
    apart: float = 0.0,
    low: float = 0.09,
    named: tuple[str, str, float, float] = ("load_bias", "bias", 0.1, 0.11),
) -> list[str]:
    """The doubts about a name with these errors of the speed, of which those of the fit logs are in a `share` of the time.

    `apart` is by how many times the noise the courses of a replica differ that the fit logs cannot part from the estimate;
    `low` is the lower end of the interval of the effect's size; `named`: effect, parameter, value, the upper end.
    """
    rig = LinearRig({"load_bias.bias": np.ones(ROWS)}, TIME, has_hidden_states=has_hidden_states, signals=2)
    every = np.arange(ROWS)
    size = np.where(every < share * ROWS, fit["after"] / np.sqrt(share), 1.0)
    errors = {"speed": size, "pressure": np.ones(ROWS)}
    rng = np.random.default_rng(1)
    rig.segments[0] = Segments(
        Segment(0, 0, name, v * rng.standard_normal(ROWS), every, every >= 0, 1e-3, slice(n * ROWS, (n + 1) * ROWS))
        for n, (name, v) in enumerate(errors.items())
    )  # fmt: skip
    effect, parameter, value, high = named
    found = Estimate(0, [], np.zeros(0)).with_effect(effect, {parameter: value})
    moved = found.q + apart / found.unknowns[-1].scale
    ends = [np.array([found.unknowns[-1].q(value)]) for value in (low, high)]
    found.intervals = Intervals(*ends, moved[None])
    entries = [{"noise": 1.0, "placebo": 30.0, "before": 50.0, **e} for e in (fit, sealed)]
    pressure = {"noise": 1.0, "calibrated": 20.0, "after": 1.0, "placebo": 9.0, "before": 50.0}
    traces = {"after": {0: np.zeros(2 * ROWS)}}
    proofs = [Proof(rig, {(0, "speed"): e, (0, "pressure"): pressure}, traces) for e in entries]  # type: ignore[arg-type]
    logs = Logs(Fit(rig, {(0, name): 1.0 for name in errors}), rig, rig)  # type: ignore[arg-type]
    return doubts(logs, [Accepted(effect, 0, 500.0, 18.0)], {0: found}, Proofs(*proofs, *proofs))


def test_an_effect_whose_interval_holds_the_neutral_value_is_not_confirmed() -> None:
    right = {"calibrated": 40.0, "after": 1.02}, {"calibrated": 38.0, "after": 1.05}
    assert not _doubts(*right, low=0.01)
    (doubt,) = _doubts(*right, low=-0.01)
    assert "holds the neutral value" in doubt
    # The upper end of the range of a limit stands for none.
    highest = CATALOGUE["driver_saturation"].parameter("voltage_limit").high
    limit = "driver_saturation", "voltage_limit", 60.0
    assert not _doubts(*right, low=55.0, named=(*limit, 65.0))
    (doubt,) = _doubts(*right, low=55.0, named=(*limit, 1.1 * highest))
    assert "holds the neutral value" in doubt


def test_right_names_are_not_doubted() -> None:
    assert not _doubts({"calibrated": 40.0, "after": 1.02}, {"calibrated": 38.0, "after": 1.05})
    # Far off in the catalogue's form and near the noise in the corrected one.
    assert not _doubts(
        {"calibrated": 40.0, "named": 7.0, "after": 1.1}, {"calibrated": 38.0, "named": 8.0, "after": 2.1}
    )
    # A course through an unstable rest is nobody's fault as long as the fit logs are explained.
    assert not _doubts({"calibrated": 40.0, "after": 1.3}, {"calibrated": 40.0, "after": 34.0})
    # With a tenth of the noise everything is so many times the noise.
    assert not _doubts({"calibrated": 400.0, "after": 12.0}, {"calibrated": 380.0, "after": 13.0})


def test_a_rest_that_no_form_explains_is_doubted() -> None:
    found = _doubts({"calibrated": 70.0, "after": 6.3}, {"calibrated": 65.0, "after": 6.2})
    assert len(found) == 1 and "the speed of channel 1" in found[0] and "6.3 times its noise" in found[0]
    # Off in a twentieth of the time it is doubted too, but not for one event, as a spool that sticks a moment longer makes it.
    assert _doubts({"calibrated": 70.0, "after": 6.3}, {"calibrated": 65.0, "after": 6.2}, share=0.05)
    assert not _doubts({"calibrated": 70.0, "after": 6.3}, {"calibrated": 65.0, "after": 6.2}, share=0.008)
    # A steady-valve model is known to leave what moves fast.
    assert not _doubts(
        {"calibrated": 70.0, "after": 6.3}, {"calibrated": 65.0, "after": 6.2}, has_hidden_states=False
    )


def test_a_rig_that_cannot_be_predicted_refutes_no_name() -> None:
    """What is left of the fit logs, or wrong on the sealed ones, says nothing where replicas part by more."""
    fit, sealed = {"calibrated": 70.0, "after": 6.3}, {"calibrated": 65.0, "after": 6.2}
    assert not _doubts(fit, sealed, apart=8.0) and _doubts(fit, sealed, apart=4.0)
    fit, sealed = {"calibrated": 40.0, "after": 1.0}, {"calibrated": 40.0, "after": 60.0}
    assert not _doubts(fit, sealed, apart=70.0) and _doubts(fit, sealed, apart=50.0)


def test_a_signal_that_pays_for_another_one_is_doubted() -> None:
    found = _doubts({"calibrated": 1.09, "after": 1.22}, {"calibrated": 1.15, "after": 1.20})
    assert len(found) == 1 and "worse" in found[0]
    assert not _doubts({"calibrated": 1.00, "after": 1.02}, {"calibrated": 1.15, "after": 1.20})
    assert not _doubts({"calibrated": 1.01, "after": 1.05}, {"calibrated": 1.01, "after": 1.05})


def test_what_the_sealed_logs_deny_is_doubted() -> None:
    assert _doubts({"calibrated": 40.0, "after": 1.0}, {"calibrated": 40.0, "after": 60.0})


def test_courses_that_part_by_less_than_a_fit_knows_are_said_to_be_unpredictable() -> None:
    fit, base = logged({}, {}, ROWS)
    same = np.zeros((8, 1))
    base.intervals = Intervals(same[0], same[0], same)
    assert unpredictable(fit, base, 0) == {}
    moved = same.copy()
    moved[3] = 1.0  # one of them has another inertia
    base.intervals = Intervals(same[0], same[0], moved)
    found = unpredictable(fit, base, 0)
    assert set(found) == {"speed"} and found["speed"] > 10.0
