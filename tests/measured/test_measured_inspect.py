"""What `hydro-env diagnose --inspect` makes of foreign logs."""

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from hydro_env.cli import app
from hydro_env.errors import InputError
from hydro_env.measured import load_mapping, read_log
from hydro_env.measured.inspect import propose, shown

HEADER = "Zeit [ms];Spannung links [V];Drehzahl links [1/min];p_links_kPa;Spannung rechts [V];Drehzahl rechts [1/min];Notiz"


@pytest.fixture
def foreign(tmp_path: Path) -> Path:
    path = tmp_path / "pruefstand.csv"
    t = np.arange(400)
    rows = [
        f"{n};{10 * np.sin(n / 40):.3f};{200 * np.sin((n - 4) / 40):.2f};{900 * np.cos(n / 40):.1f};"
        f"{9 * np.cos(n / 30):.3f};{150 * np.cos((n - 4) / 30):.2f};ok"
        for n in t
    ]
    path.write_text("\n".join([HEADER, *rows]) + "\n")
    return path


def test_names_and_units_in_another_language(foreign: Path) -> None:
    found = propose(foreign)
    assert found.log is not None, found.problem
    assert found.log.channels == (0, 1)
    assert found.log.period == pytest.approx(1e-3)
    speed = found.log.get("speed")
    assert speed is not None and np.abs(speed[:, 0]).max() == pytest.approx(200 * np.pi / 30, rel=1e-3)
    pressure = found.log.get("pressure")
    assert pressure is not None and np.nanmax(pressure[:, 0]) == pytest.approx(9e5, rel=1e-3)
    assert any("'Notiz'" in note or "Notiz" not in found.text for note in found.notes)


def test_the_proposal_is_a_mapping_file_that_reads_the_log(foreign: Path, tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["diagnose", "--inspect", str(foreign), "--out", str(tmp_path / "out")])
    assert result.exit_code == 0, result.output
    assert "400 rows" in result.output and "speed 1" in result.output
    mapping = load_mapping(tmp_path / "out" / "mapping.yaml")
    assert len(read_log(foreign, mapping)) == 400


def test_units_guessed_from_magnitudes(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    t = np.arange(300) * 0.01
    table = np.column_stack([t, np.sin(t), 30 * np.sin(t), 40e5 * np.cos(t), np.ones_like(t)])
    np.savetxt(path, table, delimiter=",", header="t,u,n,dp,Qpump_note", comments="")
    found = propose(path)
    assert "unit: fraction" in found.text and "unit: Pa" in found.text and "unit: rpm" in found.text
    assert any("full_scale is a guess" in note for note in found.notes)


def test_a_rig_log_needs_no_mapping(tmp_path: Path) -> None:
    path = tmp_path / "rig.csv"
    t = np.arange(100) * 1e-3
    table = np.column_stack([t, np.sin(t), np.sin(t - 0.01)])
    np.savetxt(path, table, delimiter=",", header="time_s,command_1_V,speed_1_rpm", comments="")
    text, mapping = shown(path)
    assert "no mapping is needed" in text and "schema: hydro_env/mapping/1" in mapping


def test_what_cannot_be_proposed_is_said(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("t,foo,bar\n0,1,2\n1,2,3\n2,3,5\n")
    text, _ = shown(path)
    assert "not readable yet" in text and "'foo': not recognised" in text
    with pytest.raises(InputError, match="no such file"):
        propose(tmp_path / "absent.csv")
