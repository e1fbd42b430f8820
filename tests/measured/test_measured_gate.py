"""The data gate: each mistake that recordings have is told, and a clean log is silent."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hydro_env.errors import InputError
from hydro_env.measured import RigLog, read_log

Columns = dict[str, np.ndarray]


def clean(rows: int = 3000) -> Columns:
    """A plausible recording at 1 kHz: two motors that follow different commands with a lag, and noise."""
    rng = np.random.default_rng(5)
    time = np.arange(rows) * 1e-3
    columns: Columns = {"time_s": time}
    for channel, frequency in ((1, 1.0), (2, 1.7)):
        phase = 2 * np.pi * frequency * time
        columns[f"command_{channel}_V"] = 40 * np.sin(phase)
        columns[f"current_{channel}_A"] = 0.6 * np.sin(phase - 0.1) + 2e-3 * rng.normal(size=rows)
        columns[f"pressure_{channel}_bar"] = 40 * np.cos(phase) + 0.05 * rng.normal(size=rows)
        columns[f"speed_{channel}_rpm"] = 400 * np.sin(phase - 0.4) + rng.normal(size=rows)
    columns["supply_bar"] = 150 + 0.1 * rng.normal(size=rows)
    columns["temperature_C"] = 40 + 0.1 * rng.normal(size=rows)
    return columns


def save(folder: Path, columns: Columns) -> Path:
    path = folder / "log.csv"
    rows = np.column_stack(list(columns.values()))
    np.savetxt(path, rows, fmt="%.15g", delimiter=",", header=",".join(columns), comments="")
    return path


def test_a_clean_log_is_silent(tmp_path: Path) -> None:
    assert read_log(save(tmp_path, clean())).findings == ()


def test_a_noise_free_simulation_is_silent(tmp_path: Path) -> None:
    """Exactly steady stretches are no stuck sensors, plateaus no clipping, equal channels no copied columns."""
    time = np.arange(4000) * 1e-3
    command = 30.0 * (time > 0.2) - 40.0 * (time > 2.0)
    speed = np.zeros(4000)
    for n in range(3999):
        speed[n + 1] = speed[n] + 0.02 * (20 * command[n] - speed[n])
    columns = {"time_s": time, "setpoint_rpm": 20 * command}
    for channel in (1, 2):
        columns |= {
            f"command_{channel}_V": command,
            f"speed_{channel}_rpm": speed,
            f"pressure_{channel}_bar": speed / 10,
        }
    assert read_log(save(tmp_path, columns)).findings == ()


def test_a_speed_that_moves_on_its_own_says_nothing_of_its_unit(tmp_path: Path) -> None:
    """Valves driven in open loop, beside a set-point that moves a sixth as much: alike in part, and by chance."""
    columns = clean()
    speed = columns["speed_1_rpm"]
    other = np.std(speed) * np.sin(0.01 * np.arange(len(speed)))
    columns["setpoint_rpm"] = 0.14 * (speed + 1.2 * other)
    assert 0.5 < np.corrcoef(speed, columns["setpoint_rpm"])[0, 1] < 0.9
    assert 4.6 < np.std(speed) / np.std(columns["setpoint_rpm"]) < 8.0
    assert not [f for f in read_log(save(tmp_path, columns)).findings if f.code == "unit"]


def stuck(columns: Columns) -> None:
    columns["speed_1_rpm"][1100:1700] = columns["speed_1_rpm"][1100]


def clip(columns: Columns) -> None:
    columns["pressure_2_bar"] = np.clip(columns["pressure_2_bar"], -30, 30)


def prick(columns: Columns) -> None:
    columns["speed_1_rpm"][[300, 1200, 2001]] = 5000.0
    columns["pressure_2_bar"][[700, 701]] -= 30.0


def coarsen(columns: Columns) -> None:
    columns["speed_1_rpm"] = 25 * np.round(columns["speed_1_rpm"] / 25)


def freeze(columns: Columns) -> None:
    columns["current_2_A"][:] = 0.25


def flip(columns: Columns) -> None:
    columns["speed_2_rpm"] *= -1


def swap(columns: Columns) -> None:
    columns["speed_1_rpm"], columns["speed_2_rpm"] = columns["speed_2_rpm"], columns["speed_1_rpm"]


def copy(columns: Columns) -> None:
    columns["pressure_2_bar"] = columns["pressure_1_bar"]


def gap(columns: Columns) -> None:
    columns["time_s"][1500:] += 0.3


def jump(columns: Columns) -> None:
    columns["time_s"][1500:] += 3600.0


def jitter(columns: Columns) -> None:
    columns["time_s"] = columns["time_s"] + 4e-4 * np.random.default_rng(1).random(len(columns["time_s"]))


def repeat(columns: Columns) -> None:
    columns["time_s"][700] = columns["time_s"][699]


def epoch(columns: Columns) -> None:
    columns["time_s"] = columns["time_s"] + 17e8


def holes(columns: Columns) -> None:
    columns["speed_1_rpm"][10:20] = np.nan


def empty(columns: Columns) -> None:
    columns["current_1_A"][:] = np.nan


def extra(columns: Columns) -> None:
    columns["presure_1_bar"] = columns.pop("pressure_1_bar")


def scaled(name: str, factor: float, offset: float = 0.0) -> Callable[[Columns], None]:
    def change(columns: Columns) -> None:
        columns[name] = factor * columns[name] + offset

    return change


def radians(columns: Columns) -> None:
    columns["setpoint_rpm"] = columns["speed_1_rpm"].copy()
    columns["speed_1_rpm"] = columns["speed_1_rpm"] * 2 * np.pi / 60


@pytest.mark.parametrize(
    ("spoil", "code", "column", "channel"),
    [
        (stuck, "stuck", "speed_1_rpm", 1),
        (clip, "clipped", "pressure_2_bar", 2),
        (prick, "spikes", "speed_1_rpm", 1),
        (coarsen, "coarse", "speed_1_rpm", 1),
        (freeze, "constant", "current_2_A", 2),
        (flip, "sign", "speed_2_rpm", 2),
        (swap, "swapped", None, None),
        (copy, "duplicate_column", "pressure_2_bar", None),
        (gap, "gap", "time_s", None),
        (jump, "clock_jump", "time_s", None),
        (jitter, "uneven_sampling", "time_s", None),
        (repeat, "duplicate_time", "time_s", None),
        (epoch, "epoch_time", "time_s", None),
        (holes, "missing_values", "speed_1_rpm", 1),
        (empty, "empty_column", "current_1_A", None),
        (extra, "unknown_column", "presure_1_bar", None),
        (scaled("pressure_1_bar", 100.0), "unit", "pressure_1_bar", 1),
        (scaled("supply_bar", 0.01), "unit", "supply_bar", None),
        (scaled("current_1_A", 1000.0), "unit", "current_1_A", 1),
        (scaled("command_1_V", 0.02), "unit", "command_1_V", 1),
        (scaled("speed_1_rpm", 2 * np.pi / 60), "unit", "speed_1_rpm", 1),
        (radians, "unit", "speed_1_rpm", 1),
        (scaled("temperature_C", 1.0, 273.15), "unit", "temperature_C", None),
        (scaled("time_s", 1000.0), "time_unit", "time_s", None),
    ],
    ids=lambda value: getattr(value, "__name__", value) if callable(value) else None,
)
def test_a_mistake_is_found(
    tmp_path: Path, spoil: Callable[[Columns], None], code: str, column: str | None, channel: int | None
) -> None:
    columns = clean()
    spoil(columns)
    log = read_log(save(tmp_path, columns))
    hits = [finding for finding in log.findings if finding.code == code]
    assert hits, log.findings
    assert (hits[0].column, hits[0].channel) == (column, channel)
    assert len(log.findings) <= 3  # one mistake does not set off every alarm


def test_rows_are_named_as_in_the_file(tmp_path: Path) -> None:
    columns = clean()
    gap(columns)
    assert read_log(save(tmp_path, columns)).findings[0].row == 1502  # header is row 1, sample 0 row 2


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "the file is empty"),
        ("  \n\n", "the file is empty"),
        ("time_s,command_1_V,speed_1_rpm\n", "only a header, no rows"),
        ("time_s,command_1_V,speed_1_rpm\n0,0,0\n", "only 1 row"),
        ("0,0,0\n0.01,1,1\n", "holds numbers where the header should be"),
        ("time,command_1_V,speed_1_rpm\n0,0,0\n1,0,0\n", "required column 'time_s' is missing"),
        ("time,command_1_V,speed_1_rpm\n0,0,0\n1,0,0\n", "rename 'time'"),
        ("time_s,command_1_V,speed1_rpm\n0,0,0\n1,0,0\n", "'speed_1_rpm' is missing (found: "),
        ("time_s,speed_1_rpm\n0,0\n1,0\n", "required column 'command_1_V' is missing"),
        ("time_s,command_1_V,speed_1_rpm\n0,0,0\n0.01,1,fast\n", "row 3, column 'speed_1_rpm': 'fast' is not a number"),
        ("time_s,command_1_V,speed_1_rpm\n0,0,0\n\n0.01,1,fast\n", "row 4, column 'speed_1_rpm'"),
        ("time_s,command_1_V,speed_1_rpm\n0,0,0\n0.02,1,1\n0.01,1,1\n", "row 4, column 'time_s': time runs backwards"),
        ("time_s,command_1_V,speed_1_rpm\n0,0,0\n,1,1\n", "row 3, column 'time_s': no time"),
        ("time_s,command_1_V,speed_1_rpm\n0,0,0\n0,1,1\n0,1,1\n0,1,1\n", "rows repeat the time"),
        ("time_s,command_1_V,speed_1_rpm\n0,0,0\n0.01,1\n", "row 3 has 2 cells, the header has 3"),
        ("time_s,command_1_V,speed_1_rpm\n0,0,0\n0,01,1,1\n", "decimal commas need another delimiter"),
        ("time_s;command_1_V;speed_1_rpm\n0;0;0\n0,01;1;1.234,5\n", "thousands separators"),
        ("time_s;command_1_V;speed_1_rpm\n0;0;0\n0,01;1;1.234\n", "write all numbers alike"),
        ("time_s,command_1_V,speed_1_rpm\n12h,0,0\n12:61:02,1,1\n", "'12h' is not a number"),
        ("time_s,command_1_V,speed_1_rpm,speed_1_rpm\n0,0,0,0\n1,1,1,1\n", "appears 2 times (columns 3, 4)"),
        ("time_s,command_1_V,speed_1_rpm\n0,0,\n0.01,1,\n", "column 'speed_1_rpm' is empty"),
        ("time_s,command_1_V,speed_1_rpm\n0,0,inf\n0.01,1,1\n", "row 2, column 'speed_1_rpm'"),
        ('time_s,command_1_V,speed_1_rpm\n0,0,"1\n0.01,1,1\n', "row "),
        ("\x00\x01\x02\x03", "not a text file"),
    ],
)  # fmt: skip
def test_what_cannot_be_used_is_one_clear_line(tmp_path: Path, text: str, expected: str) -> None:
    path = tmp_path / "log.csv"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        read_log(path)
    line = str(caught.value)
    assert line.startswith(str(path)) and expected in line and "\n" not in line


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        read_log(tmp_path / "nothing.csv")


def test_equal_speeds_in_closed_loop_are_not_called_swapped(tmp_path: Path) -> None:
    """A controller that keeps two unequal motors together commands the weak one more; nothing is wrong with that."""
    columns = clean()
    rng = np.random.default_rng(2)
    columns["speed_2_rpm"] = columns["speed_1_rpm"] + rng.normal(size=3000)
    columns["command_2_V"] = 1.6 * columns["command_1_V"] + 5 * np.sign(columns["command_1_V"])
    assert read_log(save(tmp_path, columns)).findings == ()


def test_findings_do_not_change_equality() -> None:
    assert RigLog.__dataclass_fields__["findings"].compare is False


def with_lines(columns: Columns) -> Columns:
    """The recording with both line pressures beside the load pressure of channel 1."""
    half = 0.5 * columns["pressure_1_bar"]
    return columns | {"pressure_a_1_bar": 75.0 + half, "pressure_b_1_bar": 75.0 - half}


def test_both_line_pressures_give_the_load_pressure(tmp_path: Path) -> None:
    columns = with_lines(clean())
    both = read_log(save(tmp_path, columns))
    assert both.findings == ()
    load = columns.pop("pressure_1_bar")
    alone = read_log(save(tmp_path, columns))
    assert alone.findings == () and alone.pressure is not None and alone.mean_line_pressure is not None
    np.testing.assert_allclose(alone.pressure[:, 0], load * 1e5, rtol=1e-9, atol=1e-3)
    np.testing.assert_allclose(alone.mean_line_pressure[:, 0], 75e5, rtol=1e-9)
    assert not alone.has("mean_line_pressure", 1)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda c: c.pop("pressure_b_1_bar"), ("pressure_a_1_bar", "no pressure of its other line")),
        (lambda c: c.update(pressure_a_1_bar=c["pressure_a_1_bar"] - 75.0), ("pressure_a_1_bar", "below -1 bar")),
        (lambda c: c.update(pressure_1_bar=-c["pressure_1_bar"]), ("pressure_1_bar", "pressure b less a", "exchange")),
        (lambda c: c.update(pressure_1_bar=0.1 * c["pressure_1_bar"]), ("pressure_1_bar", "0.1 times that")),
    ],
)  # fmt: skip
def test_line_pressures_that_cannot_be_are_named(
    tmp_path: Path, change: Callable[[Columns], object], words: tuple[str, ...]
) -> None:
    columns = with_lines(clean())
    change(columns)
    found = [f for f in read_log(save(tmp_path, columns)).findings if f.code in ("line_pressure", "one_line")]
    assert len(found) == 1 and "\n" not in found[0].text
    assert all(word in found[0].text for word in words), found[0].text
    assert found[0].sure == (found[0].code == "line_pressure")


def spiky(rng: np.random.Generator, rate: int, share: float) -> tuple[Columns, np.ndarray]:
    """A shaft that follows steps of its command with 0.1 s, with noise of 1 rpm; in some rows 220 to 600 rpm off."""
    rows = 12 * rate
    columns: Columns = {"time_s": np.arange(rows) / rate}
    command = np.repeat(rng.uniform(-60.0, 60.0, rows // rate + 1), rate)[:rows]
    speed = np.zeros(rows)
    for n in range(rows - 1):
        speed[n + 1] = speed[n] + (10.0 * command[n] - speed[n]) / (0.1 * rate)
    bad = rng.random(rows) < share
    speed += rng.normal(size=rows) + bad * rng.choice([-1.0, 1.0], rows) * rng.uniform(220.0, 600.0, rows)
    columns |= {"command_1_V": command, "speed_1_rpm": speed}
    return columns, bad


@pytest.mark.parametrize("rate", [1000, 100])
@pytest.mark.parametrize(("noise", "coarse"), [(0.5, False), (0.1, True)])
def test_steps_within_the_noise_are_not_coarse(tmp_path: Path, rate: int, noise: float, coarse: bool) -> None:
    """A small range of a sensor that resolves twice its noise, or ten times; the rig rests half of the time."""
    time = np.arange(12 * rate) / rate
    rng = np.random.default_rng(1)
    pressure = 40.0 * np.minimum(np.sin(time), 0.0) + noise * rng.normal(size=len(time))
    columns = {"time_s": time, "command_1_V": 20.0 * np.sin(time), "speed_1_rpm": 500.0 * np.sin(time)}
    columns["pressure_1_bar"] = np.round(pressure)
    found = read_log(save(tmp_path, columns)).findings
    assert ("coarse" in [f.code for f in found if f.signal == "pressure"]) == coarse


@pytest.mark.parametrize(("rate", "found"), [(1000, 1.0), (200, 0.9)])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_spikes_are_judged_by_the_noise_and_by_what_the_shaft_does(
    tmp_path: Path, rate: int, found: float, seed: int
) -> None:
    """One row in a hundred: all that no shaft does are left out, and nothing else."""
    columns, bad = spiky(np.random.default_rng(seed), rate, 0.01)
    log = read_log(save(tmp_path, columns))
    left_out = np.isnan(log.speed[:, 0])
    assert not (left_out & ~bad).any()
    assert (
        left_out.sum() >= found * bad.sum() - 1
    )  # three in a row, or the first or last row, are not known from motion
    assert [f.code for f in log.findings] == ["spikes"] and f"{left_out.sum()} rows" in log.findings[
        0
    ].message


@pytest.mark.parametrize("rate", [1000, 100])
@pytest.mark.parametrize("noise", [0.0, 0.1, 1.0, 10.0])
def test_steps_of_a_shaft_are_no_spikes(tmp_path: Path, rate: int, noise: float) -> None:
    for seed in range(5):
        rng = np.random.default_rng(seed)
        columns, _ = spiky(rng, rate, 0.0)
        columns["speed_1_rpm"] += (noise - 1.0) * rng.normal(size=len(columns["time_s"]))
        assert not [f for f in read_log(save(tmp_path, columns)).findings if f.code == "spikes"]


def test_a_sensor_that_shows_noise_alone_is_absent(tmp_path: Path) -> None:
    columns = clean()
    columns["current_1_A"] = 0.2 + 2e-3 * np.random.default_rng(6).normal(size=3000)
    log = read_log(save(tmp_path, columns))
    assert [(f.code, f.column) for f in log.findings] == [("constant", "current_1_A")]
    assert "nothing but noise" in log.findings[0].message and not log.has("current", 0)


def test_a_pressure_sensor_that_sticks_in_its_own_noise(tmp_path: Path) -> None:
    """From 1 s on it shows 5 bar and the noise of its converter, while the shaft goes on to turn to and fro."""
    columns = clean(6000)
    columns["pressure_1_bar"][1000:] = 5.0 + 0.05 * np.random.default_rng(7).normal(size=5000)
    log = read_log(save(tmp_path, columns))
    assert [(f.code, f.column) for f in log.findings] == [("stuck", "pressure_1_bar")]
    assert log.pressure is not None and np.isnan(log.pressure[1000:, 0]).all()
    assert np.isfinite(log.pressure[:1000, 0]).all() and log.has("pressure", 1)


def test_a_blank_end_of_a_command_is_cut(tmp_path: Path) -> None:
    columns = clean()
    columns["command_1_V"][1200:] = np.nan
    log = read_log(save(tmp_path, columns))
    assert len(log) == 1200 and "ends with row 1201" in log.findings[0].text
    columns = clean()
    columns["command_1_V"][600:900] = np.nan
    log = read_log(save(tmp_path, columns))
    assert len(log) == 3000 and np.isnan(log.speed[600:1900]).all() and np.isfinite(log.speed[1901:]).all()
    assert "count for nothing" in log.findings[0].text


def test_commands_that_are_written_once_are_held(tmp_path: Path) -> None:
    """A controller of 50 Hz beside sensors of 1 kHz: its command stands in every twentieth row."""
    columns = clean()
    command = columns["command_1_V"].copy()
    columns["command_1_V"][np.arange(3000) % 20 > 0] = np.nan
    log = read_log(save(tmp_path, columns))
    assert len(log) == 3000 and np.isfinite(log.speed).all()
    np.testing.assert_allclose(log.command_V[:, 0], np.repeat(command[::20], 20))


def test_counts_of_an_encoder_are_called_coarse(tmp_path: Path) -> None:
    columns = clean()
    turns = np.floor(500.0 * np.cumsum(columns["speed_1_rpm"]) * 1e-3 / 60.0)
    columns["speed_1_rpm"] = (turns - np.concatenate([np.zeros(10), turns[:-10]])) / 500.0 / 0.01 * 60.0
    found = read_log(save(tmp_path, columns)).findings
    assert [f.code for f in found] == ["coarse"] and "half a window late" in found[0].text
