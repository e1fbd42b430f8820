"""Where the motors part most: the stretches cover the episode, what is told reaches the law; a sudden load."""

import numpy as np

from agents.stretches import STRETCHES, Told, lines, parts
from agents.sudden_load import JUMP, differences
from hydro_env.controllers import make_controller
from hydro_env.controllers.rollout import roll_out


def test_stretches_cover_the_episode():
    largest, tracking = parts(make_controller("probing_flow"), range(8))
    whole = roll_out(
        make_controller("probing_flow"), range(8), mismatch="train", scenario="setpoint_steps"
    ).metrics()
    np.testing.assert_allclose(largest.max(axis=0), whole["max_speed_difference_rpm"])
    np.testing.assert_allclose(tracking, whole["tracking_mae_rpm"])
    assert largest.shape == (len(STRETCHES), 8)
    assert all(line.count("|") == len(STRETCHES) + 3 for line in lines("x", largest, tracking))


def test_told_gains_make_the_start_faster():
    plain, told = (parts(Told(what), range(32)) for what in ((), ("gains",)))
    np.testing.assert_array_equal(plain[0][0], told[0][0])  # at rest nothing is told yet
    assert np.median(told[1]) < np.median(plain[1]) - 1.5


def test_an_answer_to_a_sudden_load_begins_when_it_shows():
    law, harder = (differences(share, 4) for share in (0.0, 0.4))
    seen = round(JUMP / 0.01) + 1  # the control instant at which the load has worked for a period
    np.testing.assert_array_equal(law[: seen + 1], harder[: seen + 1])
    better = np.abs(law[seen + 1]) - np.abs(harder[seen + 1])
    assert np.all(better >= 0.0)  # none where the law gives its most already
    assert np.max(better) > 5.0
