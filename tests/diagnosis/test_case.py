"""A case: a dialogue until the diagnosis is sure, in a folder that survives kills and refuses what does not belong to it."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hydro_env.case import dialogue, folder
from hydro_env.case.folder import CaseFile, Place
from hydro_env.case.hypotheses import certainty, expected, places_of, with_experiment
from hydro_env.case.sensors import SENSORS, Shown, chosen, costs_of, shown
from hydro_env.cli.main import run
from hydro_env.diagnosis import Diagnosis, Settings, diagnose
from hydro_env.diagnosis.estimation.estimate import Estimate, Intervals
from hydro_env.diagnosis.estimation.fit import Fit
from hydro_env.diagnosis.estimation.unknowns import effect_unknowns
from hydro_env.diagnosis.experiment_design import Design, Question, Trial
from hydro_env.diagnosis.input.parts import read_parts
from hydro_env.diagnosis.models.dynamic_rig import DynamicRig
from hydro_env.diagnosis.stages.naming import PARAMETERS, UNKNOWN, NamedEffect
from hydro_env.diagnosis.stages.next_experiment import CALIBRATION, PARTED, NextExperiment
from hydro_env.diagnosis.stages.validation import AT_NOISE
from hydro_env.errors import InputError
from hydro_env.measured import read_log
from hydro_env.plant import CATALOGUE, load_model
from hydro_env.practice.generate import make_practice
from hydro_env.units import BAR, RPM

TWINS = ("spool_stiction", "dead_zone")
OPTIONS: dict[str, Any] = {"model": "paper", "mapping": None, "questions": 3, "seed": 0, "sensor": None}


def _log(path: Path, value: float, more: str = "") -> Path:
    """A log of 3 s of some command; `more` names a further column."""
    head = "time_s,command_1_V,speed_1_rpm" + (f",{more}" if more else "")
    rows = (f"{n * 0.01:.2f},{value},{n % 7}" + (",0.1" if more else "") for n in range(300))
    path.write_text("\n".join([head, *rows]) + "\n")
    return path


class Rigged:
    """Stands for a diagnosis: two names are open until there are as many logs as `sure_at`."""

    def __init__(self, sure_at: int = 9, sensor: str | None = None) -> None:
        self.sure_at, self.sensor, self.calls = sure_at, sensor, 0
        self.former: list[Path | None] = []

    def __call__(
        self, fit: Sequence[str], sealed: Sequence[str], out: Path, *, settings: Settings, former: Path | None = None, **_: Any
    ) -> Any:  # fmt: skip
        self.calls += 1
        self.former.append(former)
        (out / "model.yaml").write_text("found")
        (out / "report.html").write_text("full")
        shares = {TWINS[0]: 0.5, TWINS[1]: 0.45, UNKNOWN: 0.05}
        apart = {TWINS: 1.5}
        design = Design(np.ones((10, 2)), np.zeros((10, 2)), apart)
        experiment: NextExperiment | None = NextExperiment("play next_experiment.csv", TWINS, design)
        if len(fit) >= self.sure_at:
            shares, experiment = {TWINS[0]: 0.97, UNKNOWN: 0.03}, None
        named = NamedEffect(TWINS[0], (0,), {}, shares)
        parts = [SimpleNamespace(log=read_log(word, None)) for word in fit]
        logged = SimpleNamespace(parts=parts)
        return SimpleNamespace(
            effects=[named], verdict="effects", best_guess=False, next_experiment=experiment, seconds=1.0, rig=logged,
            logs=SimpleNamespace(fit=SimpleNamespace(rig=logged, settings=settings), held_out=SimpleNamespace(parts=[])),
        )  # fmt: skip


@pytest.fixture
def rigged(monkeypatch: pytest.MonkeyPatch) -> Rigged:
    found = Rigged()
    monkeypatch.setattr(dialogue.command, "run", found)
    monkeypatch.setattr(dialogue, "shown", lambda *_: Shown({TWINS: 1.5}, found.sensor))
    return found


@pytest.fixture
def call(tmp_path: Path) -> Callable[..., CaseFile]:
    def called(
        *logs: Path, sealed: Sequence[Path] = (), given: Sequence[str] = (), **options: Any
    ) -> CaseFile:
        return dialogue.run(
            tmp_path / "case", [str(p) for p in logs], [str(p) for p in sealed], OPTIONS | options, {*given, *options},
            arguments=lambda o: {"settings": Settings(seed=o["seed"])},
        )  # fmt: skip

    return called


@pytest.fixture
def begun(tmp_path: Path, rigged: Rigged, call: Callable[..., CaseFile]) -> Callable[..., CaseFile]:
    """A case that waits for the answer to its first question; its originals are gone."""
    first, held_out = _log(tmp_path / "first.csv", 1.0), _log(tmp_path / "held_out.csv", 2.0)
    call(first, sealed=[held_out])
    first.unlink()
    held_out.unlink()
    return call


def test_a_dialogue_asks_until_it_is_sure(
    tmp_path: Path, rigged: Rigged, begun: Callable[..., CaseFile], capsys: pytest.CaptureFixture[str]
) -> None:
    case = begun()
    said = capsys.readouterr().out
    assert rigged.calls == 1 and "question 1 of 3" in said and len(said.splitlines()) <= 15
    assert f"then: hydro-env diagnose --case {tmp_path / 'case'} LOG" in said
    assert case.rounds[0].question is not None and case.rounds[0].question.expected > 0.9
    assert sum(case.rounds[0].open[0].hypotheses.values()) == pytest.approx(1.0)
    assert (tmp_path / "case/question_1.csv").read_text().startswith("time_s,command_1_V")
    rigged.sure_at = 2
    case = begun(_log(tmp_path / "answer.csv", 3.0))
    assert case.closed == "sure" and len(case.asked) == 1
    page = (tmp_path / "case/report.html").read_text()
    assert "round_2/report.html" in page and "<svg" in page
    data = json.loads((tmp_path / "case/case.json").read_text())
    assert data["schema"] == "hydro_env/case/1" and data["closed"] == "sure"
    with pytest.raises(InputError, match="closed"):
        begun(_log(tmp_path / "more.csv", 4.0))


def test_questions_are_used_up(tmp_path: Path, rigged: Rigged, begun: Callable[..., CaseFile]) -> None:
    for n in range(3):
        case = begun(_log(tmp_path / f"answer_{n}.csv", 3.0 + n))
    assert case.closed == "questions used up" and len(case.asked) == 3
    # What a round found takes part in the next one.
    assert rigged.former == [None, *(tmp_path / f"case/round_{n}/model.yaml" for n in (1, 2, 3))]


def test_a_kill_before_or_in_the_diagnosis_costs_only_time(
    tmp_path: Path, rigged: Rigged, begun: Callable[..., CaseFile], monkeypatch: pytest.MonkeyPatch
) -> None:
    answer = _log(tmp_path / "answer.csv", 3.0)

    def killed(*_: Any, **__: Any) -> Any:
        raise KeyboardInterrupt

    for home, place in ((dialogue.command, "run"), (dialogue, "case_page")):
        with monkeypatch.context() as patch:
            patch.setattr(home, place, killed)
            with pytest.raises(KeyboardInterrupt):
                begun(answer)
        assert folder.read(tmp_path / "case").rounds[1].verdict is None
    case = begun()
    assert len(case.rounds) == 2 and case.rounds[1].verdict == "effects"
    assert sum(len(r.logs) for r in case.rounds) == 2


def test_a_kill_before_case_json_knows_the_log(
    tmp_path: Path, begun: Callable[..., CaseFile], monkeypatch: pytest.MonkeyPatch
) -> None:
    answer = _log(tmp_path / "answer.csv", 3.0)
    with monkeypatch.context() as patch:
        patch.setattr(folder, "write", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            begun(answer)
    assert len(folder.read(tmp_path / "case").rounds) == 1
    assert len(begun(answer).rounds) == 2


def test_a_log_is_never_counted_twice(tmp_path: Path, begun: Callable[..., CaseFile]) -> None:
    answer = _log(tmp_path / "answer.csv", 3.0)
    begun(answer)
    with pytest.raises(InputError, match="holds this log already"):
        begun(shutil.copy(answer, tmp_path / "renamed.csv"))
    twice = _log(tmp_path / "a.csv", 5.0), _log(tmp_path / "b.csv", 5.0)
    with pytest.raises(InputError, match="twice"):
        begun(*twice)


def test_a_log_that_cannot_be_used_leaves_the_case_as_it_was(
    tmp_path: Path, begun: Callable[..., CaseFile]
) -> None:
    before = (tmp_path / "case/case.json").read_bytes()
    bad = tmp_path / "bad.csv"
    bad.write_text("nonsense\n1\n")
    with pytest.raises(InputError, match=re.escape(str(bad))):
        begun(bad)
    assert (tmp_path / "case/case.json").read_bytes() == before
    assert not any("bad" in p.name for p in (tmp_path / "case/logs").iterdir())


def test_wrong_and_damaged_folders_are_refused(
    tmp_path: Path, begun: Callable[..., CaseFile], call: Callable[..., CaseFile]
) -> None:
    case = tmp_path / "case"
    good = (case / "case.json").read_text()
    for text, said in (
        (good[:-20], "case.json"),
        (good.replace("case/1", "case/2"), "schema"),
        (good.replace('"logs/1_first.csv"\n', '"logs/../x.csv"\n'), "rounds.0.logs.0"),
        (good.replace('"seed": 0', '"sees": 0'), "options should be"),
    ):
        (case / "case.json").write_text(text)
        with pytest.raises(InputError, match=re.escape(said)):
            begun()
    (case / "case.json").write_text(good)
    log = next((case / "logs").iterdir())
    log.write_text(log.read_text() + "9,9,9\n")
    with pytest.raises(InputError, match="SHA-256"):
        begun()
    (case / "case.json").unlink()
    with pytest.raises(InputError, match="no case"):
        begun()
    with pytest.raises(InputError, match="neither a case nor empty"):
        call(_log(tmp_path / "x.csv", 1.0), sealed=[_log(tmp_path / "y.csv", 2.0)])


def test_options_are_those_of_the_first_call(tmp_path: Path, begun: Callable[..., CaseFile]) -> None:
    assert begun(model="paper", seed=0).options["model"] == "paper"
    for other in ({"model": "rig"}, {"seed": 1}, {"questions": 2}):
        with pytest.raises(InputError, match=f"--{next(iter(other))} is .* begun with"):
            begun(**other)
    with pytest.raises(InputError, match="--sealed"):
        begun(sealed=[_log(tmp_path / "z.csv", 9.0)])


def test_a_log_without_the_sensor_is_accepted_and_said(
    tmp_path: Path, rigged: Rigged, begun: Callable[..., CaseFile]
) -> None:
    rigged.sensor = "spool"
    first = begun(_log(tmp_path / "answer.csv", 3.0))
    assert first.rounds[1].question is not None and first.rounds[1].question.record == ["spool"]
    lacking = begun(_log(tmp_path / "lacking.csv", 4.0))
    assert lacking.rounds[2].remarks == ["came back without spool"]
    assert begun(_log(tmp_path / "there.csv", 5.0, "spool_1_mm")).rounds[3].remarks == []


def _estimate(fit: Fit, name: str) -> Estimate:
    """A model with an effect of its typical size that the logs determine."""
    unknowns = effect_unknowns(CATALOGUE[name], {p.name: p.typical for p in CATALOGUE[name].parameters})
    zeros = np.zeros(len(unknowns))
    found = Estimate(0, unknowns, zeros, name, intervals=Intervals(zeros, zeros, np.zeros((8, len(zeros)))))
    found.simulated = {0: np.concatenate([s.filled for s in fit.rig.segments[0]])}
    return found


@pytest.fixture(scope="module")
def twins(tmp_path_factory: pytest.TempPathFactory) -> Trial:
    """Stiction and a dead zone, by speed, current and pressure."""
    where = tmp_path_factory.mktemp("twins")
    make_practice([], duration=3.0, rate=500.0, runs=("fit_1",)).write(where)
    logged = DynamicRig(load_model("paper"), read_parts([where / "fit_1.csv"], None))
    noise = {(0, "speed"): RPM, (0, "current"): 0.002, (0, "pressure"): 0.05 * BAR}
    fit = Fit(logged, noise, Settings())
    return Trial(fit, [Question(0, {name: _estimate(fit, name) for name in TWINS})])


def _sine(amplitude: float) -> np.ndarray:
    command = amplitude * np.sin(2.0 * np.pi * np.arange(1200) / 400)
    return np.stack([np.column_stack([command, command]), np.zeros((1200, 2))], axis=-1)[None]


def test_a_sensor_is_asked_for_where_it_shows_more_than_its_cost(
    twins: Trial, monkeypatch: pytest.MonkeyPatch
) -> None:
    def asked(without: float, with_it: float, cost: float) -> str | None:
        def read(trial: Trial, _: Any) -> Any:
            return [{TWINS: np.array([trial.times * (with_it if trial.more else without) ** 2])}], {}

        monkeypatch.setattr(Trial, "read", read)
        return chosen(twins, ([], np.ones((1, 2), bool)), {"current": 0.0, "flow": cost}).sensor

    assert asked(0.05, 1.2, 1.0) == "flow"  # twins that commands cannot part; the current is logged already
    assert asked(0.1, 0.12, 1.0) is None and asked(0.1, 0.12, 0.0) == "flow"  # 0.44 of an experiment
    assert asked(0.1, 0.2, 1.0) == "flow" and asked(0.1, 0.2, 4.0) is None  # three
    assert asked(2.0, 5.0, 1.0) is None  # commands part them


def test_with_a_sensor_models_are_no_nearer(twins: Trial) -> None:
    answers = twins.simulated(_sine(0.1))
    assert replace(twins, more=["spool"]).distances(answers)[TWINS] > 1.2 * twins.distances(answers)[TWINS]


def test_an_experiment_done_twice_shows_twice_as_much(twins: Trial) -> None:
    answers = twins.simulated(_sine(0.01))
    once, twice = (replace(twins, times=n).distances(answers)[TWINS] for n in (1.0, 2.0))
    assert 1.2 < twice / once < 1.42


def test_what_is_expected_follows_from_the_distance() -> None:
    places = [Place(channel="1", hypotheses={"a": 0.5, "b": 0.4, UNKNOWN: 0.1})]
    none, some, far = (expected(places, {("b", "a"): d}, 0.1) for d in (0.0, 0.5, 5.0))
    assert certainty(places) == none == 0.5 and 0.5 < some < far == pytest.approx(0.9, abs=1e-3)


def test_what_no_model_stands_for_shows_as_little_as_none() -> None:
    """Of two effects that the logs would not show the experiment shows one: the other keeps its share."""
    places = [Place(channel="rig", hypotheses={PARAMETERS: 0.8, "a": 0.1, "b": 0.1})]
    assert expected(places, {(CALIBRATION, "a"): 5.0}, 0.1) == pytest.approx(0.9, abs=2e-3)


def _practice(folder: Path, **settings: Any) -> tuple[Callable[..., Diagnosis], Callable[..., Path]]:
    """A rig with one log and one held out: diagnoses these and further logs, and plays what a diagnosis proposes."""
    rig = {"base_error": 0.15, "duration": 6.0, "rate": 500.0, **settings}
    make_practice(**rig, runs=("fit_2", "sealed")).write(folder)

    def diagnosed(*answers: Path) -> Diagnosis:
        return diagnose(
            [folder / "fit_2.csv", *answers], [folder / "sealed.csv"], model=folder / "model.yaml"
        )

    def played(found: Diagnosis, record: Sequence[str]) -> Path:
        assert found.next_experiment is not None
        (folder / "q.csv").write_text(str(found.next_experiment.csv()))
        make_practice(**rig, play=folder / "q.csv", record=record).write(folder / "answer")
        return folder / "answer" / "played.csv"

    return diagnosed, played


@pytest.mark.slow
def test_what_the_logs_would_not_show_is_asked_for(tmp_path: Path) -> None:
    """Small commands do not reach the limit of a driver: calibration is enough, but not sure, and the experiment shows it."""
    diagnosed, played = _practice(tmp_path, effects=["driver_saturation:2"], severity="small", seed=687001)
    first = diagnosed()
    assert first.verdict == "calibration" and not first.effects
    assert 0.5 < certainty(places_of(first)) < dialogue.SURE
    found = with_experiment(first)
    question, closed = dialogue.next_question(found, places_of(found), shown(found, {}), "q.csv", True)
    assert closed is None and question is not None and max(question.apart.values()) > PARTED
    second = diagnosed(played(found, question.record))
    assert [(e.name, e.channel) for e in second.effects] == [("driver_saturation", "2")]


@pytest.mark.slow
def test_a_name_that_leaves_more_than_the_noise_is_asked_about(tmp_path: Path) -> None:
    """One wrong name, and nothing competes: an experiment that shows what the model does not predict finds the right one."""
    diagnosed, played = _practice(tmp_path, effects=["flow_force:1"], severity="medium", seed=670006)
    first = diagnosed()
    (wrong,) = first.effects
    assert wrong.name != "flow_force" and wrong.probability < dialogue.SURE
    assert first.proofs.left([0]) > AT_NOISE
    question, closed = dialogue.next_question(first, places_of(first), shown(first, {}), "q.csv", True)
    assert closed is None and question is not None and question.why.startswith("leaves more than the noise")
    second = diagnosed(played(first, question.record))
    assert [(e.name, e.channel) for e in second.effects] == [("flow_force", "1")]


def test_costs_of_sensors() -> None:
    assert costs_of(["spool=2"]) == {**dict.fromkeys(SENSORS, 1.0), "spool": 2.0}
    assert costs_of(["none"]) == {}
    for word in ("spol=1", "spool", "spool=-1", "spool=nan", "spool=x"):
        with pytest.raises(InputError, match="--sensor"):
            costs_of([word])


def test_the_command_takes_out_or_case(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for words in ([], ["--out", "a", "--case", "b"]):
        assert run(["diagnose", "x.csv", *words]) == 2
        assert "either --out DIR" in capsys.readouterr().err
    assert run(["diagnose", "--case", str(tmp_path / "none")]) == 2
    assert "no case" in capsys.readouterr().err


@pytest.mark.slow
def test_a_whole_dialogue_on_a_practice_rig(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Names are open at first; the rig plays what is asked, until the case closes; no log is lost on the way."""
    monkeypatch.chdir(tmp_path)
    hide = [
        "hide",
        "spool_stiction:1",
        "--seed",
        "650001",
        "--duration",
        "6",
        "--rate",
        "500",
        "--base-error",
        "15",
    ]
    assert run([*hide, "--out", "rig"]) == 0
    logs = ["rig/fit_2.csv", "--sealed", "rig/sealed.csv", "--model", "rig/model.yaml"]
    for n in range(1, 5):
        assert run(["diagnose", *logs, "--case", "case"]) == 0
        case = folder.read(Path("case"))
        if case.closed:
            break
        question = case.asked[-1]
        record = ["--record", ",".join(question.record)]
        assert run([*hide, *record, "--play", f"case/{question.commands}", "--out", f"answer_{n}"]) == 0
        logs = [f"answer_{n}/played.csv"]
    assert case.closed and len(case.rounds) == n > 1
    assert all(sum(p.hypotheses.values()) == pytest.approx(1.0) for r in case.rounds for p in r.open)
