"""A diagnosis in a process of its own, and the files that it is given."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Callable
from pathlib import Path

import pytest

from hydro_env.errors import InputError
from hydro_env.lab import uploads
from hydro_env.lab.jobs import Job, Jobs
from hydro_env.lab.session import Session, Settings
from hydro_env.lab.uploads import Uploads


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log of the rig that the preset describes."""
    session = Session(Settings(preset="paper", split="own", scenario="setpoint_steps"))
    session.record()
    for _ in range(900):
        session.step()
    session.stop_recording()
    path: Path = tmp_path_factory.mktemp("logs") / "log.csv"
    path.write_text(session.finished_log)
    return path


def wait(jobs: Jobs, until: Callable[[Job], bool]) -> Job:
    for _ in range(6000):
        assert jobs.latest is not None
        if until(jobs.latest):
            return jobs.latest
        time.sleep(0.05)
    raise AssertionError(f"still {jobs.latest}")


def test_a_log_is_diagnosed_with_progress_and_its_report_written(log: Path, tmp_path: Path) -> None:
    jobs = Jobs(tmp_path / "out")
    jobs.start("diagnose", [log], model="paper")
    with pytest.raises(InputError, match="is running"):
        jobs.start("diagnose", [log])
    wait(jobs, lambda job: job.simulations > 0)
    done = wait(jobs, lambda job: job.state != "running")
    assert done.state == "done" and done.folder == "diagnosis_1", done.problem
    assert (
        done.result is not None
        and done.result["verdict"] in ("none", "calibration")
        and done.result["summary"]
    )
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["diagnosis_1"]
    written = {path.name for path in (tmp_path / "out/diagnosis_1").iterdir()}
    assert written == {"report.html", "diagnosis.json", "model.yaml"}


def test_cancelling_leaves_nothing(log: Path, tmp_path: Path) -> None:
    jobs = Jobs(tmp_path)
    jobs.start("diagnose", [log])
    wait(jobs, lambda job: job.stage != "starting")
    jobs.cancel()
    assert jobs.latest is not None and jobs.latest.state == "cancelled" and not jobs.running
    assert list(tmp_path.iterdir()) == []


def test_a_bad_log_is_one_line(tmp_path: Path) -> None:
    path = tmp_path / "bad.csv"
    path.write_text("time_s,command_1_V,speed_1_rpm\n0,0,0\n0.1,x,0\n")
    jobs = Jobs(tmp_path / "out")
    jobs.start("diagnose", [path])
    failed = wait(jobs, lambda job: job.state != "running")
    assert failed.state == "failed" and "bad.csv" in failed.problem and "\n" not in failed.problem
    assert list((tmp_path / "out").iterdir()) == []


def test_a_foreign_log_gets_a_proposed_mapping(tmp_path: Path) -> None:
    path = tmp_path / "foreign.csv"
    rows = "".join(f"{n / 100},{5 * (n > 20)},{300 * (n > 30)}\n" for n in range(400))
    path.write_text(f"t [s],u_cmd [V],n [1/min]\n{rows}")
    jobs = Jobs(tmp_path / "out")
    jobs.start("inspect", [path])
    done = wait(jobs, lambda job: job.state != "running")
    assert done.state == "done" and done.folder == "" and done.result is not None
    assert "channel_1" in done.result["mapping"] and "u_cmd" in done.result["text"]


def test_a_folder_that_cannot_be_written_is_one_line(log: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot write there"):
        Jobs(tmp_path / "file").start("diagnose", [log])


async def pieces(*parts: bytes) -> AsyncIterator[bytes]:
    for part in parts:
        yield part


def test_uploads_get_plain_names_in_one_folder_and_go_away() -> None:
    store = Uploads()
    for name in (
        "../../etc/passwd.csv",
        "a b@0:1.CSV",
        "x\n.csv",
        "log.csv.gz",
    ):
        asyncio.run(store.receive(name, pieces(b"1", b"2")))
    folder = store.files[0].path.parent
    assert {file.path.parent for file in store.files} == {folder} and len(list(folder.iterdir())) == 4
    assert all(set(file.path.name) <= set("abcdefghijklmnopqrstuvwxyz_0123456789.") for file in store.files)
    assert all(file.name.isprintable() for file in store.files)
    assert [file.role for file in store.files] == ["fit"] * 4
    store.remove(store.files[0])
    assert len(list(folder.iterdir())) == 3 and len(store.with_role("fit")) == 3
    store.close()
    assert not folder.exists()


def test_a_yaml_file_is_what_its_schema_says() -> None:
    store = Uploads()
    for name, schema in (("my_mapping.yaml", b"model"), ("rig_model.yml", b"mapping")):
        asyncio.run(store.receive(name, pieces(b"schema: hydro_env/", schema, b"/1\n")))
    assert [file.role for file in store.files] == ["model", "mapping"]
    assert store.rigs("rig")[str(store.files[0].path)] == "my_mapping.yaml"
    for content, told in (
        (b"J: 1\n", "schema is None"),
        (b"schema: [1]\n", "a mapping"),
        (b"a: [\n", "plain.yaml line"),
    ):
        with pytest.raises(InputError, match=told) as caught:
            asyncio.run(store.receive("plain.yaml", pieces(content)))
        assert str(caught.value).startswith("plain.yaml")
    assert len(list(store.files[0].path.parent.iterdir())) == 2
    store.close()


def test_uploads_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(uploads, "MAX_BYTES", 10)
    monkeypatch.setattr(uploads, "MAX_FILES", 1)
    store = Uploads()
    with pytest.raises(InputError, match="larger than"):
        asyncio.run(store.receive("a.csv", pieces(b"123456", b"123456")))
    assert store.files == [] and list(Path(store._folder.name).iterdir()) == []
    for name in ("model.pkl", "agent.zip", "controller.py", "", "csv"):
        with pytest.raises(InputError, match="expected a log"):
            asyncio.run(store.receive(name, pieces(b"1")))
    asyncio.run(store.receive("a.csv", pieces(b"1")))
    with pytest.raises(InputError, match="remove some"):
        asyncio.run(store.receive("b.csv", pieces(b"1")))
    store.close()
