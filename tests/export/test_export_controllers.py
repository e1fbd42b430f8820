"""Controllers in C and Structured Text: the same commands as in Python, over whole episodes in closed loop."""

from __future__ import annotations

import ctypes
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

from hydro_env.cli import main
from hydro_env.controllers.learned.policy import NumpyPolicy
from hydro_env.controllers.registry import CONTROLLERS, make_controller
from hydro_env.envs.observation import OBSERVATION, SCALES
from hydro_env.export.compiler import find_compiler
from hydro_env.export.controllers import c_files, program_of, st_file
from hydro_env.export.symbols import TraceError
from hydro_env.export.tracing import trace
from hydro_env.plant import Plant
from hydro_env.training.export import write_policy
from tests.export.structured_text import Block

PERIOD = 0.01
needs_compiler = pytest.mark.skipif(find_compiler() is None, reason="no C compiler")
CLASSICAL = (
    "pid_paper", "pid_tuned", "master_slave", "cross_coupled", "relative_coupling", "virtual_leader", "disturbance_observer",
    "compensated", "servo_pid",
)  # fmt: skip
IN_TEXT = tuple(name for name in CLASSICAL if name != "disturbance_observer")
LAWS = ("adaptive_flow", "probing_flow", "bench_flow", "probing_flow_rig")
NETWORKS = ("ppo", "sac", "gru", "gru_rig")
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


def in_c(folder: Path, name: str, flag: str) -> Act:
    """`NAME_step` of the compiled source."""
    library = folder / f"{name}{flag}.so"
    compiler = find_compiler()
    assert compiler is not None
    warnings = [
        "-Wall",
        "-Wextra",
        "-Werror",
        "-Wno-unused-function",
        "-Wno-unused-parameter",
        "-Wno-unused-variable",
    ]
    command = [
        *compiler,
        "-std=c99",
        flag,
        *warnings,
        "-shared",
        "-fPIC",
        str(folder / f"{name}.c"),
        "-o",
        str(library),
        "-lm",
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[:2000]
    loaded = ctypes.CDLL(str(library))
    step, state = getattr(loaded, f"{name}_step"), ctypes.create_string_buffer(1 << 16)
    getattr(loaded, f"{name}_reset")(state)

    def act(observation: np.ndarray) -> np.ndarray:
        measured, command = observation[0].astype(float) * SCALES, np.zeros(2)
        step(state, measured.ctypes.data_as(ctypes.c_void_p), command.ctypes.data_as(ctypes.c_void_p))
        return command[None]

    return act


def in_text(folder: Path, name: str) -> Act:
    """The function block, interpreted."""
    block, fresh = Block((folder / f"{name}.st").read_text()), [True]

    def act(observation: np.ndarray) -> np.ndarray:
        measured = dict(zip(OBSERVATION, (observation[0].astype(float) * SCALES).tolist(), strict=True))
        values = block(**measured, reset=fresh[0])
        fresh[0] = False
        return np.array([[values["next_command_1"], values["next_command_2"]]])

    return act


def rig_of(name: str) -> tuple[str, str | None]:
    own = {"servo_pid": ("servo", None), "probing_flow_rig": ("rig", None), "gru_rig": ("rig", None)}
    return own.get(name, ("paper_dead_zone", "test_interp"))


def compare_c(folder: Path, name: str, scenario: str, mismatch: str | None = "") -> None:
    """Not compiled for speed and compiled for speed, C gives what Python gives."""
    plant, own = rig_of(name)
    mismatch = own if mismatch == "" else mismatch
    c_files(name, folder, PERIOD, "paper_dead_zone", single=False)
    controller = in_python(name)
    controller.reset(1, PERIOD)
    expected = episode(controller.act, scenario, plant, mismatch)
    for flag in ("-O0", "-O2"):
        got = episode(in_c(folder, name, flag), scenario, plant, mismatch)
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
    st_file(name, tmp_path, PERIOD, "paper_dead_zone", single=False)
    plant, mismatch = rig_of(name)
    controller = in_python(name)
    controller.reset(1, PERIOD)
    expected = episode(controller.act, "setpoint_steps", plant, mismatch)
    got = episode(in_text(tmp_path, name), "setpoint_steps", plant, mismatch)
    assert np.abs(got - expected).max() < 1e-12


@needs_compiler
def test_gains_and_period_of_ones_own(tmp_path: Path) -> None:
    spec = "cross_coupled:Kp=0.05,shape=0.3"
    c_files(spec, tmp_path, 0.005, "paper_dead_zone", single=False)
    controller = make_controller(spec)
    controller.reset(1, 0.005)
    expected = episode(controller.act, "setpoint_steps", "paper_dead_zone", "train", 0.005)
    got = episode(in_c(tmp_path, "cross_coupled", "-O2"), "setpoint_steps", "paper_dead_zone", "train", 0.005)
    assert np.array_equal(got, expected)


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
    c_files(str(path), tmp_path, PERIOD, "paper_dead_zone", single=False)
    st_file(str(path), tmp_path, PERIOD, "paper_dead_zone", single=False)
    controller = in_python(str(path))
    controller.reset(1, PERIOD)
    expected = episode(controller.act, "setpoint_steps", "paper_dead_zone", "train")
    for act in (in_c(tmp_path, "mine", "-O2"), in_text(tmp_path, "mine")):
        assert np.abs(episode(act, "setpoint_steps", "paper_dead_zone", "train") - expected).max() < 1e-12


@needs_compiler
def test_single_precision_agrees_sample_by_sample(tmp_path: Path) -> None:
    """In closed loop stiction turns the last bit of a float into another course, so both see the same measurements."""
    c_files("gru", tmp_path, PERIOD, "paper_dead_zone", single=True)
    controller, act = make_controller("gru"), in_c(tmp_path, "gru", "-O2")
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
def test_what_cannot_be_followed_is_refused(kind: type, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kind, "__module__", "hydro_env.controllers.mine")
    with pytest.raises(TraceError):
        trace(kind(), PERIOD, "mine")


def test_the_state_holds_nothing_that_is_not_needed() -> None:
    """Without output shaping no past command is kept; PI keeps two integrators."""
    program = program_of("pid_paper", PERIOD)
    assert {each.name for each in program.state} <= {"pid_integral", "pid_derivative", "pid_last_error"}


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
