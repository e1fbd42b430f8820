"""Metrics on traces whose scores can be worked out by hand."""

import numpy as np
import pytest

from hydro_env.errors import InputError
from hydro_env.tasks.metrics import METRICS, Trace, compute, never_settled


def trace(speeds, *, setpoint=100.0, period=0.5, angle=None, command=None, peak=None):
    """One rig; speeds is a list of (motor 1, motor 2)."""
    speed = np.array(speeds, dtype=float)[:, None, :]
    rows = speed.shape[0]
    return Trace(
        period=period,
        setpoint_rpm=np.broadcast_to(np.asarray(setpoint, dtype=float), (rows,))[:, None].copy(),
        speed_rpm=speed,
        angle_difference_deg=np.zeros((rows, 1)) if angle is None else np.array(angle, dtype=float)[:, None],
        command=np.zeros((rows, 1, 2)) if command is None else np.array(command, dtype=float)[:, None, :],
        peak_difference_rpm=np.abs(np.diff(speed))[..., 0]
        if peak is None
        else np.array(peak, dtype=float)[:, None],
    )


def test_differences_and_tracking():
    scores = compute(trace([(100, 100), (103, 99), (90, 102), (100, 100)], angle=[0, 5, -8, 2]))
    assert scores["max_speed_difference_rpm"] == pytest.approx(12)
    assert scores["rms_speed_difference_rpm"] == pytest.approx(np.sqrt((16 + 144) / 4))
    assert scores["shaft_angle_difference_deg"] == pytest.approx(8)
    assert scores["tracking_mae_rpm"] == pytest.approx((3 + 1 + 10 + 2) / 8)


def test_the_peak_is_that_between_the_rows():
    scores = compute(trace([(100, 100), (103, 99), (100, 100)], peak=[0.0, 4.0, 7.0]))
    assert scores["max_speed_difference_rpm"] == 7.0


def test_command_travel_counts_the_first_move():
    # valve 1: 0.5 + 0.5, valve 2: 0.2 + 0 over two periods of 0.5 s: mean of 1.0 and 0.2 in one second
    scores = compute(trace([(0, 0)] * 2, command=[(0.5, 0.2), (0.0, 0.2)]))
    assert scores["command_travel_per_s"] == scores["command_variation"] == pytest.approx(0.6)


def test_valve_reversals_are_turns_of_a_hundredth_or_more():
    """Valve 1 turns at 0.5 and back at 0.2, in small steps; valve 2 shakes by less."""
    first = [0.0, 0.3, 0.5, 0.495, 0.485, 0.2, 0.2, 0.206, 0.215]
    second = [0.0, 0.1, 0.095, 0.1, 0.095, 0.1, 0.095, 0.1, 0.095]
    scores = compute(trace([(0, 0)] * 9, command=list(zip(first, second, strict=True))))
    assert scores["valve_reversals_per_s"] == pytest.approx((2 + 0) / 2 / (9 * 0.5))
    start = compute(trace([(0, 0)] * 3, command=[(-0.004, 0.3), (-0.008, 0.2), (-0.3, 0.3)]))
    assert start["valve_reversals_per_s"] == pytest.approx(
        (0 + 2) / 2 / (3 * 0.5)
    )  # the first move is no turn


def test_settling_time():
    """Rows 0.05 s apart, so that two rows together are back in step."""
    apart, together = (100, 80), (100, 95)
    value = lambda *rows, **more: compute(trace(rows, period=0.05, **more))["sync_settling_time_s"]  # noqa: E731
    assert value(together, together) == 0.0
    # apart in rows 1 and 2: in step again from row 3 on
    assert value(together, apart, apart, together, together) == pytest.approx(0.10)
    # together for one row only, while ringing: it all counts
    assert value(apart, together, apart, together, together) == pytest.approx(0.15)
    assert value(apart, together, (80, 100), together, apart, together) == pytest.approx(0.25)
    # together for two: the longer one of two times counts, whatever it was that disturbed
    twice = (apart, together, together, apart, apart, apart, together, together)
    assert value(*twice) == value(*twice, setpoint=[0, 0, 0, 400, 400, 400, 0, 0]) == pytest.approx(0.15)
    # never in step: all of the episode; out of step at its end: up to the end
    assert value(apart, apart, apart) == pytest.approx(0.15)
    assert value(together, together, apart, apart) == pytest.approx(0.10)


def test_a_time_out_of_step_that_the_episode_cuts_off_is_never_settled():
    apart, together = (100, 80), (100, 95)
    never = lambda *rows: bool(never_settled(trace(rows, period=0.05))[0])  # noqa: E731
    assert never(together, apart, apart) and never(
        apart, apart, together
    )  # one row is too few to be back in step
    assert not never(together, together) and not never(apart, apart, together, together)
    # The longest time ended; a shorter one was cut off: the value is a settling time.
    assert not never(apart, apart, apart, together, together, apart)
    assert never(apart, together, together, apart, apart)


def test_settling_time_tells_controllers_apart_where_loads_never_rest():
    """A difference that swings for ever is out of step for part of each half wave, or, if large enough, always."""
    time = np.arange(500) * 0.01
    half_waves = []
    for size in (9.0, 12.0, 15.0, 60.0):
        swing = size * np.sin(2 * np.pi * 1.5 * time + 0.01)
        speed = np.stack([100 + swing, np.full(500, 100.0)], axis=1)
        half_waves.append(float(compute(trace(speed, period=0.01))["sync_settling_time_s"][0]))
    none, short, longer, always = half_waves
    assert none == 0.0 and always > 4.9
    # arccos(10 / size) / (pi 1.5 Hz)
    assert short == pytest.approx(np.arccos(10 / 12) / (np.pi * 1.5), abs=0.011)
    assert longer == pytest.approx(np.arccos(10 / 15) / (np.pi * 1.5), abs=0.011)


def test_rigs_are_scored_apart():
    one, two = trace([(100, 100), (110, 90)]), trace([(100, 70), (100, 100)])
    both = Trace(
        0.5,
        *(
            np.concatenate([getattr(one, key), getattr(two, key)], axis=1)
            for key in ("setpoint_rpm", "speed_rpm", "angle_difference_deg", "command", "peak_difference_rpm")
        ),
    )
    for name in compute(both):
        metric = METRICS[name]
        np.testing.assert_array_equal(compute(both)[name], [metric.of(one)[0], metric.of(two)[0]])


def test_unknown_metric():
    with pytest.raises(InputError, match="speed_error"):
        compute(trace([(0, 0)]), ["speed_error"])
