"""Controllers in C and Structured Text: the same commands as in Python, over whole episodes in closed loop."""

from __future__ import annotations

import ctypes
import inspect
import os
import shutil
import subprocess
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

from hydro_env.cli import main
from hydro_env.controllers.learned.policy import NumpyPolicy
from hydro_env.controllers.registry import CONTROLLERS, make_controller
from hydro_env.controllers.tuning.gains import GainsFile, write_gains
from hydro_env.envs.observation import SCALES, scales_on
from hydro_env.export.controllers import c_code, export_controller, program_of
from hydro_env.export.fmu.build import find_compiler
from hydro_env.export.structured_text import INPUTS
from hydro_env.export.symbols import TraceError
from hydro_env.export.tracing import trace
from hydro_env.plant import Plant, load_model, scales_of
from hydro_env.training.export import write_policy
from tests.export.structured_text import Block

PERIOD = 0.01
needs_compiler = pytest.mark.skipif(find_compiler() is None, reason="no C compiler")
CLASSICAL = (
    "pid_paper", "pid_tuned", "master_slave", "cross_coupled", "relative_coupling", "virtual_leader", "disturbance_observer",
    "compensated", "servo_pid",
)  # fmt: skip
IN_TEXT = tuple(name for name in CLASSICAL if name != "disturbance_observer")
LAWS = ("adaptive_flow", "probing_flow", "bench_flow")
NETWORKS = ("ppo", "sac", "gru", "gru_any", "gru_rig")
Act = Callable[[np.ndarray], np.ndarray]


def episode(act: Act, scenario: str, plant: str, mismatch: str | None, period: float = PERIOD) -> np.ndarray:
    """Commands (T, 2) of one episode in closed loop."""
    env = gymnasium.make_vec(
        "hydro_env:HydraulicSync-v0", num_envs=1, plant=plant, mismatch=mismatch, scenario=scenario, control_period=period
    )  # fmt: skip
    observation, _ = env.reset(seed=3)
    commands, over = [], False
    while not over:
        commands.append(np.array(act(observation)[0], float))
        observation, _, terminated, truncated, _ = env.step(np.asarray(commands[-1][None], np.float32))
        over = bool((terminated | truncated).any())
    return np.array(commands)


def in_python(name: str) -> Any:
    """The controller as it is exported: networks in double precision."""
    entry = CONTROLLERS.get(name)
    if entry is not None and entry.file is not None and entry.file.suffix == ".npz":
        return NumpyPolicy(entry.file, name, np.float64)
    if name.endswith(".npz"):
        return NumpyPolicy(name, dtype=np.float64)
    controller = make_controller(name)
    if controller.needs == "bench":
        controller.prepare(Plant("paper_dead_zone"))
    return controller


class InC:
    """`NAME_step` of the compiled source; `fault` is what it returned last."""

    def __init__(self, folder: Path, name: str, flag: str) -> None:
        library, compiler = folder / f"{name}{flag}.so", find_compiler()
        assert compiler is not None
        strict = [*compiler, "-std=c99", flag, "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC"]
        command = [*strict, str(folder / f"{name}.c"), "-o", str(library), "-lm"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0 and not done.stderr, done.stderr[:2000]
        loaded = ctypes.CDLL(str(library))
        self.state, self.fault = ctypes.create_string_buffer(1 << 16), 0
        self.step = getattr(loaded, f"{name}_step")
        getattr(loaded, f"{name}_reset")(self.state)

    def __call__(self, observation: np.ndarray) -> np.ndarray:
        return self.of_measured(observation[0].astype(float) * SCALES)

    def of_measured(self, measured: np.ndarray) -> np.ndarray:
        command, pointer = np.full(2, np.nan), ctypes.c_void_p
        self.fault = self.step(self.state, measured.ctypes.data_as(pointer), command.ctypes.data_as(pointer))
        return command[None]


class InText:
    """The function block, interpreted; `fault` is its output."""

    def __init__(self, folder: Path, name: str) -> None:
        self.block, self.fault = Block((folder / f"{name}.st").read_text()), False

    def __call__(self, observation: np.ndarray) -> np.ndarray:
        measured = dict(zip(INPUTS, (observation[0].astype(float) * SCALES).tolist(), strict=True))
        values = self.block(**measured)
        self.fault = values["Fault"]
        return np.array([[values["Command1"], values["Command2"]]])


def rig_of(name: str) -> tuple[str, str | None]:
    own = {"servo_pid": ("servo", None), "gru_rig": ("rig", None)}
    return own.get(name, ("paper_dead_zone", "test_interp"))


def compare_c(folder: Path, name: str, scenario: str, mismatch: str | None = "") -> None:
    """Not compiled for speed and compiled for speed, C gives what Python gives."""
    plant, own = rig_of(name)
    mismatch = own if mismatch == "" else mismatch
    export_controller("c", name, folder, PERIOD, "paper_dead_zone", single=False)
    controller = in_python(name)
    controller.reset(1, PERIOD)
    expected = episode(controller.act, scenario, plant, mismatch)
    for flag in ("-O0", "-O2"):
        got = episode(InC(folder, name, flag), scenario, plant, mismatch)
        assert np.abs(got - expected).max() < 1e-12


@needs_compiler
@pytest.mark.parametrize("name", [*CLASSICAL, "probing_flow", *NETWORKS])
def test_c_equals_python(tmp_path: Path, name: str) -> None:
    compare_c(tmp_path, name, "setpoint_steps")


@needs_compiler
@pytest.mark.slow
@pytest.mark.parametrize("name", [*CLASSICAL, *LAWS, *NETWORKS])
@pytest.mark.parametrize("scenario", ["load_step", "random_steps", "sine"])
def test_c_equals_python_in_other_scenarios(tmp_path: Path, name: str, scenario: str) -> None:
    compare_c(tmp_path, name, scenario)


@needs_compiler
@pytest.mark.slow
@pytest.mark.parametrize("name", LAWS)
def test_c_equals_python_with_faults(tmp_path: Path, name: str) -> None:
    """Stuck and noisy sensors take other ways through the supervision."""
    compare_c(tmp_path, name, "random_steps", "faulted")


@pytest.mark.parametrize("name", [*IN_TEXT, "ppo", pytest.param("gru", marks=pytest.mark.slow)])
def test_structured_text_equals_python(tmp_path: Path, name: str) -> None:
    export_controller("st", name, tmp_path, PERIOD, "paper_dead_zone", single=False)
    plant, mismatch = rig_of(name)
    controller = in_python(name)
    controller.reset(1, PERIOD)
    expected = episode(controller.act, "setpoint_steps", plant, mismatch)
    got = episode(InText(tmp_path, name), "setpoint_steps", plant, mismatch)
    assert np.abs(got - expected).max() < 1e-12


HELD = 5  # samples, of 10 ms each


def with_gaps() -> np.ndarray:
    """Observations (T, 9), absent at first, then each input and all of them for one sample and about as long as they are held."""
    random = np.random.default_rng(4)
    gaps = [(slice(None), 1)]
    for which in [*range(9), slice(None)]:
        gaps += [(which, length) for length in (1, HELD - 1, HELD, HELD + 1, 3 * HELD)]
    rows: list[np.ndarray] = []
    for n, (which, length) in enumerate(gaps):
        part = random.uniform(-0.5, 0.5, (length + 3, 9)).astype(np.float32)
        part[:length, which] = (np.nan, np.inf, -np.inf)[n % 3]
        rows += [*part]
    return np.array(rows)


def by_the_rule(name: str, rows: np.ndarray) -> tuple[np.ndarray, list[bool]]:
    """Commands (T, 2) and faults: what the controller itself does with each input as it was up to five samples ago, and nothing
    where there is none."""
    controller = in_python(name)
    controller.reset(1, PERIOD)
    act = inspect.unwrap(type(controller).act)
    commands, faults = np.zeros((len(rows), 2)), []
    for t in range(len(rows)):
        recent = rows[max(0, t - HELD) : t + 1].T
        known = [column[np.isfinite(column)] for column in recent]
        faults.append(not all(each.size for each in known))
        if not faults[-1]:
            commands[t] = act(controller, np.array([[each[-1] for each in known]]))[0]
    return commands, faults


@needs_compiler
@pytest.mark.parametrize("name", [*CLASSICAL, *LAWS, *NETWORKS])
def test_absent_inputs(tmp_path: Path, name: str) -> None:
    """Held, then no command and a fault, and the state as it was; in Python, C and Structured Text."""
    rows = with_gaps()
    expected, faults = by_the_rule(name, rows)
    assert np.isfinite(expected).all() and sum(faults) == 111 and np.ptp(expected) > 0.1
    controller = in_python(name)
    controller.reset(1, PERIOD)
    export_controller("c", name, tmp_path, PERIOD, "paper_dead_zone", single=False)
    acts: list[Any] = [InC(tmp_path, name, "-O2")]
    if name in (*IN_TEXT, "ppo"):
        export_controller("st", name, tmp_path, PERIOD, "paper_dead_zone", single=False)
        acts.append(InText(tmp_path, name))
    for row, command, fault in zip(rows, expected, faults, strict=True):
        assert np.array_equal(controller.act(row[None])[0], command) and controller.guard.fault == [fault]
        for act in acts:
            assert np.abs(act(row[None])[0] - command).max() < 1e-12 and act.fault == fault


@needs_compiler
@pytest.mark.parametrize("name", [*CLASSICAL, "probing_flow", "gru"])
def test_no_input_makes_a_command_that_is_none(tmp_path: Path, name: str) -> None:
    export_controller("c", name, tmp_path, PERIOD, "paper_dead_zone", single=False)
    act, random = InC(tmp_path, name, "-O2"), np.random.default_rng(6)
    extremes = [
        1e308,
        -1e308,
        1e299,
        -1e299,
        1e9,
        -1e9,
        np.inf,
        -np.inf,
        np.nan,
        0.0,
        -0.0,
        5e-324,
        1.0,
        -1.0,
    ]
    sizes = np.r_[[12.0] * 8, np.ones(6)]
    for row in random.choice(extremes, (1500, 9), p=sizes / sizes.sum()):
        command = act.of_measured(np.where(random.random(9) < 0.5, row, random.uniform(-50.0, 50.0, 9)))
        assert np.abs(command).max() <= 1.0


def test_a_batch_loses_only_the_rigs_whose_inputs_are_gone() -> None:
    rows = with_gaps()[:, None, :].repeat(2, axis=1)
    rows[:, 1] = np.where(np.isfinite(rows[:, 1]), rows[:, 1], 0.0)
    controller, alone = make_controller("cross_coupled"), make_controller("cross_coupled")
    controller.reset(2, PERIOD)
    alone.reset(1, PERIOD)
    for row in rows:
        sent = controller.act(row)
        assert np.array_equal(sent[1:], alone.act(row[1:]))
        assert not sent[0].any() or not controller.guard.fault[0]


@needs_compiler
@pytest.mark.skipif(shutil.which("iec2c") is None, reason="no matiec")
@pytest.mark.parametrize("name", [*IN_TEXT, "ppo", "sac", "gru"])
def test_matiec_compiles_the_block(tmp_path: Path, name: str) -> None:
    """To C by iec2c, whose library lies beside it or at $MATIEC_LIB, and on by the C compiler."""
    export_controller("st", name, tmp_path, PERIOD, "paper_dead_zone", single=False)
    program, compiler = shutil.which("iec2c"), find_compiler()
    assert program is not None and compiler is not None
    library = os.environ.get("MATIEC_LIB", str(Path(program).resolve().parent / "lib"))
    (tmp_path / "all.c").write_text(
        '#include "iec_std_lib.h"\nextern unsigned long long common_ticktime__;\n'
        '#include "accessor.h"\n#include "POUS.h"\n#include "POUS.c"\n'
    )
    for command in (
        [program, "-I", library, "-T", str(tmp_path), f"{name}.st"],
        [*compiler, "-w", "-I", f"{library}/C", "-c", "all.c", "-o", "all.o"],
    ):
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode == 0, (done.stdout + done.stderr)[:2000]


@needs_compiler
def test_gains_and_period_of_ones_own(tmp_path: Path) -> None:
    spec = "cross_coupled:Kp=0.05,shape=0.3"
    export_controller("c", spec, tmp_path, 0.005, "paper_dead_zone", single=False)
    controller = make_controller(spec)
    controller.reset(1, 0.005)
    expected = episode(controller.act, "setpoint_steps", "paper_dead_zone", "train", 0.005)
    got = episode(InC(tmp_path, "cross_coupled", "-O2"), "setpoint_steps", "paper_dead_zone", "train", 0.005)
    assert np.array_equal(got, expected)


@needs_compiler
def test_a_network_keeps_the_period_it_was_trained_with(tmp_path: Path) -> None:
    export_controller("c", "gru", tmp_path, 0.005, "paper_dead_zone", single=False)
    controller = in_python("gru")
    controller.reset(1, 0.005)
    expected = episode(controller.act, "setpoint_steps", "paper_dead_zone", "train", 0.005)
    got = episode(InC(tmp_path, "gru", "-O2"), "setpoint_steps", "paper_dead_zone", "train", 0.005)
    np.testing.assert_allclose(got, expected, atol=1e-9)


OWN_LAW = """\
import numpy as np
from hydro_env.controllers.base import Controller, Gain

class Mine(Controller):
    GAINS = (Gain("Kp", "1", 0.01, 1.0), Gain("Ki", "1/s", 0.01, 10.0))

    def start(self, measured):
        self.total = np.zeros_like(measured.speed)
        self.measured, self._command = self.total + 0.0, self.total + 0.0

    def command(self, measured):
        error = (measured.setpoint[:, None] - self.measured) / 60.0
        self.measured, self._command = 0.5 * (self._command + measured.speed), measured.speed + 0.0
        self.total = np.clip(self.total + error * self.period, -1.0, 1.0)
        return self.gains["Kp"] * error + self.gains["Ki"] * self.total
"""


@needs_compiler
@pytest.mark.parametrize("law", ["cross_coupled", "law.py:Mine"])
def test_a_gains_file_of_ones_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, law: str) -> None:
    """Of a shipped law or of one's own, by the command; the file's name may have any letters."""
    monkeypatch.chdir(tmp_path)
    Path("law.py").write_text(OWN_LAW)
    gains = (
        {"Kp": 0.3, "Ki": 0.5}
        if law.endswith("Mine")
        else {**make_controller("cross_coupled", slew=3000.0).gains, "Kp": 0.04}
    )
    write_gains(
        "größe_1.json", GainsFile(controller=law, gains={key: float(value) for key, value in gains.items()})
    )
    trust = ["--trust"] if law.endswith("Mine") else []
    for kind in ("c", "st"):
        with pytest.raises(SystemExit) as ended:
            main(["export", kind, "größe_1.json", *trust, "--out", kind])
        assert ended.value.code == 0
    controller = make_controller("größe_1.json", trust=True)
    controller.reset(1, PERIOD)
    expected = episode(controller.act, "setpoint_steps", "paper_dead_zone", "train")
    for act in (InC(Path("c").resolve(), "gro_e_1", "-O2"), InText(Path("st"), "gro_e_1")):
        assert np.abs(episode(act, "setpoint_steps", "paper_dead_zone", "train") - expected).max() < 1e-12


def test_a_law_that_decides_by_a_gain_has_it_built_in(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("law.py").write_text(
        OWN_LAW.replace("return self", "return measured.speed if float(self.gains['Ki']) > 5.0 else self")
    )
    spec = "law.py:Mine:Kp=0.3,Ki=0.5"
    export_controller("st", spec, tmp_path, PERIOD)
    controller = make_controller(spec)
    controller.reset(1, PERIOD)
    expected = episode(controller.act, "setpoint_steps", "paper_dead_zone", "train")
    (file,) = tmp_path.glob("*.st")
    got = episode(InText(tmp_path, file.stem), "setpoint_steps", "paper_dead_zone", "train")
    assert "Gain_" not in file.read_text() and np.abs(got - expected).max() < 1e-12


MASKING_LAW = """\
import numpy as np
from hydro_env.controllers.base import Controller

class Masking(Controller):
    def start(self, measured):
        self.total = np.zeros_like(measured.speed)

    def command(self, measured):
        error = (measured.setpoint[:, None] - measured.speed) / 60.0
        far = np.abs(error).max(axis=1) > 0.3
        self.total[far] += 0.01 * error[far]
        self.total[far, 0] = 0.1 * error[far, 1]
        return self.total
"""


@needs_compiler
def test_a_mask_of_rigs_alone_and_beside_another_index(tmp_path: Path) -> None:
    (tmp_path / "law.py").write_text(MASKING_LAW)
    spec = f"{tmp_path / 'law.py'}:Masking"
    export_controller("c", spec, tmp_path, PERIOD)
    controller = make_controller(spec)
    controller.reset(1, PERIOD)
    expected = episode(controller.act, "setpoint_steps", "paper_dead_zone", "train")
    got = episode(InC(tmp_path, "Masking", "-O2"), "setpoint_steps", "paper_dead_zone", "train")
    assert np.abs(expected).max() > 0.1 and np.array_equal(got, expected)


@needs_compiler
def test_gains_are_exported_for_the_rig_that_they_were_tuned_on(tmp_path: Path) -> None:
    """Its rated command and the scales of its observations are those that are built in."""
    model = load_model("paper_dead_zone").with_values({"u_rated": 10.0, "R": 13.7, "D": 3.4e-6, "J": 0.02})
    model.to_yaml(tmp_path / "rig.yaml", source="this test")
    gains, plant = {"Kp": 0.1, "Ti": 0.1, "Td": 0.01, "slew": 300.0}, str(tmp_path / "rig.yaml")
    write_gains(tmp_path / "mine.json", GainsFile(controller="pid", gains=gains, tuning={"plant": plant}))
    export_controller("c", str(tmp_path / "mine.json"), tmp_path, PERIOD, None, single=False)
    controller, exported = make_controller(tmp_path / "mine.json"), InC(tmp_path, "mine", "-O2")
    controller.drives(model)
    controller.reset(1, PERIOD)
    scales = scales_on(scales_of(model))
    assert scales[0] < 0.5 * SCALES[0]

    def act(observation: np.ndarray) -> np.ndarray:
        return exported.of_measured(observation[0].astype(float) * scales)

    expected = episode(controller.act, "setpoint_steps", plant, "own")
    assert np.abs(expected).max() > 0.1
    assert np.abs(episode(act, "setpoint_steps", plant, "own") - expected).max() < 1e-12


@needs_compiler
@pytest.mark.parametrize("activation", ["tanh", "relu", "elu"])
def test_a_feed_forward_policy_with_history(tmp_path: Path, activation: str) -> None:
    """A network on several frames, with errors and increments, as PPO trains them; in Structured Text as well."""
    random = np.random.default_rng(1)
    shapes = {"w0": (32, 24), "b0": (32,), "w1": (2, 32), "b1": (2,)}
    arrays = {key: random.normal(0.0, 0.3, shape).astype(np.float32) for key, shape in shapes.items()}
    interface = {"kind": "frames", "frames": 2, "width": 9, "increment": 0.3, "errors": True}
    path = tmp_path / "mine.npz"
    write_policy(path, arrays, {"activation": activation, "squash": "tanh", "interface": interface})
    export_controller("c", str(path), tmp_path, PERIOD, "paper_dead_zone", single=False)
    export_controller("st", str(path), tmp_path, PERIOD, "paper_dead_zone", single=False)
    controller = in_python(str(path))
    controller.reset(1, PERIOD)
    expected = episode(controller.act, "setpoint_steps", "paper_dead_zone", "train")
    for act in (InC(tmp_path, "mine", "-O2"), InText(tmp_path, "mine")):
        assert np.abs(episode(act, "setpoint_steps", "paper_dead_zone", "train") - expected).max() < 1e-12


@needs_compiler
def test_single_precision_agrees_sample_by_sample(tmp_path: Path) -> None:
    """In closed loop stiction turns the last bit of a float into another course, so both see the same measurements."""
    export_controller("c", "gru", tmp_path, PERIOD, "paper_dead_zone", single=True)
    controller, act = make_controller("gru"), InC(tmp_path, "gru", "-O2")
    controller.reset(1, PERIOD)
    apart = []

    def both(observation: np.ndarray) -> np.ndarray:
        sent = controller.act(observation)
        apart.append(np.abs(sent - act(observation)).max())
        return np.asarray(sent)

    episode(both, "setpoint_steps", "paper_dead_zone", "test_interp")
    assert max(apart) < 1e-5


def test_shipped_controllers_that_need_no_oracle_can_be_exported() -> None:
    """A new controller is exported too, or says why not."""
    assert set(CONTROLLERS) - {*CLASSICAL, *LAWS, *NETWORKS} == {"oracle"}


class Asks:
    """A controller that decides by a measured value in plain Python."""

    needs = "measurements"

    def reset(self, num_rigs: int, control_period: float) -> None:
        pass

    def act(self, observation: Any) -> Any:
        return observation[:, :2] if observation[0, 0] > 0.0 else observation[:, 1:3]


class Counts:
    """A controller that counts samples in plain Python."""

    needs = "measurements"

    def reset(self, num_rigs: int, control_period: float) -> None:
        self.count = 0

    def act(self, observation: Any) -> Any:
        self.count += 1
        return observation[:, :2] * self.count


@pytest.mark.parametrize("kind", [Asks, Counts])
def test_what_cannot_be_followed_is_refused(kind: type) -> None:
    with pytest.raises(TraceError):
        trace(kind(), PERIOD, "mine")


def test_controllers_may_be_used_while_one_is_traced() -> None:
    controller, rows = (
        make_controller("cross_coupled"),
        np.random.default_rng(2).uniform(-0.5, 0.5, (40, 1, 9)),
    )

    def commands() -> np.ndarray:
        controller.reset(1, PERIOD)
        return np.array([controller.act(row) for row in rows])

    expected = commands()
    with ThreadPoolExecutor(2) as pool:
        traces = [pool.submit(program_of, name, PERIOD) for name in ("cross_coupled", "probing_flow")]
        while not all(trace.done() for trace in traces):
            assert np.array_equal(commands(), expected)
    alone = c_code(program_of("cross_coupled", PERIOD), "")
    assert c_code(traces[0].result(), "") == alone


def test_the_state_holds_nothing_that_is_not_needed() -> None:
    """Without output shaping no past command is kept; PI keeps two integrators."""
    program = program_of("pid_paper", PERIOD)
    assert set(program.state) <= {"pid_integral", "pid_derivative", "pid_last_error"}


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["c", "oracle"], "needs the true plant"),
        (["c", "nobody"], "unknown controller 'nobody'"),
        (["st", "probing_flow"], "export this controller as C"),
        (["onnx", "pid_tuned"], "has no network"),
        (["c", "gru:Kp=1"], "no gains"),
        (["c", "pid_tuned", "--control-period", "0"], "control-period"),
    ],
)
def test_bad_input(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], says: str
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["export", *arguments, "--out", str(tmp_path / "out")])
    said = capsys.readouterr().err
    assert ended.value.code == 2 and said.count("\n") == 1 and says in said
    assert not (tmp_path / "out").exists()


def test_onnx_command(tmp_path: Path) -> None:
    onnx = pytest.importorskip("onnx")
    with pytest.raises(SystemExit) as ended:
        main(["export", "onnx", "gru", "--out", str(tmp_path)])
    assert ended.value.code == 0
    onnx.checker.check_model(onnx.load(tmp_path / "gru.onnx"))
