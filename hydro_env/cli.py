"""The command `hydro-env`: reads options, calls the function that does the work, reports errors in one line.

Exit status: 0 done; 2 bad input or a folder that cannot be written, with one line on stderr; 130 interrupted.
Every command writes to a hidden folder first, which becomes `--out` when the work is done, so that nothing
half-written is left behind. What a command needs is imported when it runs, after a look at `--out`: `--help` and
a wrong folder are answered at once.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, NoReturn, TextIO

import typer

from hydro_env import __version__
from hydro_env.errors import InputError
from hydro_env.files import output_folder

__all__ = ["app", "main"]

EXTRAS = {
    "plotly": "report",
    "jinja2": "report",
    "matplotlib": "report",
    "pandas": "measured",
    "pyarrow": "measured",
    "asammdf": "measured",
    "nptdms": "measured",
    "pygame": "render",
    "torch": "agents",
    "stable_baselines3": "agents",
    "sb3_contrib": "agents",
    "onnx": "agents",
    "onnxruntime": "agents",
    "ray": "ray",
}
"""Which extra of the package holds an optional library."""

app = typer.Typer(
    add_completion=False,
    invoke_without_command=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    help="Two hydraulic motors behind two unequal proportional valves.",
)

Out = Annotated[Path, typer.Option("--out", help="Folder to write to; made if need be.")]
Plant = Annotated[str, typer.Option("--plant", help="Preset or YAML file of the rig.")]
Model = Annotated[str, typer.Option("--model", help="Preset or YAML file of the model.")]
ControlPeriod = Annotated[float, typer.Option("--control-period", help="Time between two commands, s.")]
Seed = Annotated[int, typer.Option("--seed", help="Same seed, same result.")]
EffectFiles = Annotated[
    list[str] | None,
    typer.Option(
        "--effects", metavar="FILE.py", help="Python file that registers your own effects; it is run."
    ),
]
Jobs = Annotated[int, typer.Option("--jobs", min=1, help="Processes to work with.")]


class _Patient:
    """Standard output that nobody needs to read to the end (`hydro-env ... | head`): what a command is for is the files in
    `--out`, so it goes on."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        """Writes, or does nothing once the reader has gone."""
        try:
            return self._stream.write(text)
        except BrokenPipeError:
            self._to_nowhere()
            return len(text)

    def flush(self) -> None:
        """The same for what is still in the buffer."""
        try:
            self._stream.flush()
        except BrokenPipeError:
            self._to_nowhere()

    def _to_nowhere(self) -> None:
        # What the buffer holds is written again when the process ends, so the pipe itself is replaced.
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, self._stream.fileno())
        os.close(nowhere)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Runs one command and ends the process with its exit status."""
    if sys.stdout is None:  # closed before it began (`>&-`)
        sys.exit(_run(arguments))
    sys.stdout = _Patient(sys.stdout)  # type: ignore[assignment]
    status = _run(arguments)
    sys.stdout.flush()
    sys.exit(status)


def _run(arguments: Sequence[str] | None) -> int:
    try:
        given = sys.argv[1:] if arguments is None else list(arguments)
        many = "--controllers" if given[:1] == ["benchmark"] else "--sealed"
        status = app(args=_spread(given, many), prog_name="hydro-env", standalone_mode=False)
    except InputError as problem:
        return _fail(problem)
    except (KeyboardInterrupt, typer.Abort):
        return _fail("interrupted; nothing half-written is left in --out", status=130)
    except ModuleNotFoundError as problem:
        extra = EXTRAS.get((problem.name or "").partition(".")[0])
        if extra is None:
            raise
        return _fail(f"this needs {problem.name}: pip install 'hydro_env[{extra}]'")
    except OSError as problem:
        where = f"{problem.filename}: " if problem.filename else ""
        return _fail(f"{where}{problem.strerror or problem}")
    except Exception as problem:
        usage = getattr(
            problem, "format_message", None
        )  # typer's own errors: an option that does not exist, ...
        if usage is None:
            raise
        return _fail(f"{usage()} Try `{_path(problem)} --help`.")
    if status == 130:  # typer turns an interruption into this
        return _fail("interrupted; nothing half-written is left in --out", status=130)
    return status if isinstance(status, int) else 0


def _spread(arguments: list[str], option: str) -> list[str]:
    """`--sealed A B` as `--sealed A --sealed B`: options of typer take one value each."""
    spread: list[str] = []
    active = False
    for word in arguments:
        if active and not word.startswith("-") and spread[-1] != option:
            spread.append(option)
        active = word == option or (active and not word.startswith("-"))
        spread.append(word)
    return spread


def _fail(problem: object, status: int = 2) -> int:
    print(f"error: {' '.join(str(problem).split())}", file=sys.stderr)
    return status


def _path(problem: Exception) -> str:
    context = getattr(problem, "ctx", None)
    return context.command_path if context else "hydro-env"


@contextmanager
def _writing(out: Path) -> Iterator[Path]:
    """The folder to work in; names what was written and how long it took once it is in its place."""
    start = time.perf_counter()
    with output_folder(out) as folder:
        yield folder
        written = sorted(path.name + "/" * path.is_dir() for path in folder.iterdir())
    print(f"{time.perf_counter() - start:.1f} s. Written to {out}: {', '.join(written)}")


def _version(wanted: bool) -> None:
    if wanted:
        print(f"hydro_env {__version__}")
        raise typer.Exit


def _numbers(option: str, text: str) -> list[float]:
    """`5,20,80` as numbers."""
    try:
        return [float(part) for part in text.split(",") if part.strip()]
    except ValueError:
        raise InputError(f"{option} is {text!r}: numbers with commas, such as 5,20,80") from None


@app.callback()
def _options(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version and leave.")
    ] = False,
) -> None:
    if context.invoked_subcommand is None:
        print(context.get_help())


@app.command()
def demo(out: Out, seed: Seed = 0, jobs: Jobs = 1) -> None:
    """Show what the package does, on one page.

    The paper's experiment, a score board and one diagnosis; writes index.html and a folder for each part.
    """
    with _writing(out) as folder:
        from hydro_env.experiments import demo as work

        work.run(folder, seed=seed, jobs=jobs)
    print(f"Open {out / 'index.html'} in a browser.")


@app.command()
def reproduce(
    out: Out,
    pictures: Annotated[bool, typer.Option("--pictures/--no-pictures", help="Draw the figures too.")] = True,
) -> None:
    """Run the paper's experiments.

    Fig. 2, 7 and 8; writes reproduce.json, traces.csv and figures.
    """
    with _writing(out) as folder:
        from hydro_env.experiments import reproduce as work

        print(work.summary(work.run(folder, pictures=pictures)))


@app.command(name="valve-test")
def valve_test(
    out: Out,
    valves: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[VALVE]...",
            help="Presets or model files (paper:2: channel 2), files of measured curves. Default: the paper's.",
        ),
    ] = None,
    signal: Annotated[
        str, typer.Option(help="What modelled valves are read over: current or command.")
    ] = "current",
    seconds: Annotated[str, typer.Option(help="Sweeps of modelled valves, s.")] = "5,20,80",
    signal_column: Annotated[str | None, typer.Option(help="Name or number. Default: the first.")] = None,
    flow_column: Annotated[str | None, typer.Option(help="Name or number. Default: the second.")] = None,
    time_column: Annotated[str | None, typer.Option(help="Name or number, if there is one.")] = None,
    signal_unit: Annotated[
        str | None, typer.Option(help="mA, V, percent, ... Default: the header's.")
    ] = None,
    flow_unit: Annotated[str | None, typer.Option(help="lpm, GPM, ... Default: the header's.")] = None,
    time_unit: Annotated[str | None, typer.Option(help="s, ms, ... Default: the header's, or s.")] = None,
    rated: Annotated[
        float | None,
        typer.Option(help="Rated signal of a measured valve, in its unit. Default: the largest."),
    ] = None,
    row_period: Annotated[
        float | None, typer.Option(help="Time between rows, s, where no column tells it.")
    ] = None,
    sweep_period: Annotated[
        str, typer.Option(help="Length of a whole sweep, s, where nothing else tells it; one for each file.")
    ] = "",
    one_valve: Annotated[
        bool, typer.Option("--one-valve", help="The measured files are sweeps of one valve.")
    ] = False,
    controllers: Annotated[
        str, typer.Option(help="Pairs of modelled valves are compared under these; `none`: not at all.")
    ] = "pid_paper,pid_tuned,adaptive_flow",
    seeds: Annotated[int, typer.Option(min=1, help="Seeds of the sensor noise per pair.")] = 4,
    pictures: Annotated[bool, typer.Option("--pictures/--no-pictures", help="Draw the curves too.")] = True,
) -> None:
    """Measure steady flow curves as in ISO 10770-1.

    Dead zone, hysteresis, gain, linearity, ... of modelled or measured valves, whether a loop is lag, and the
    most alike pair of several valves; writes valve_test.json, curves.csv and pictures.
    """
    with _writing(out) as folder:
        from hydro_env.experiments import valve_test as work
        from hydro_env.valve_bench import Columns

        print(
            work.summary(
                work.run(
                    folder,
                    valves or work.default_valves(),
                    signal=signal,
                    seconds=_numbers("--seconds", seconds),
                    columns=Columns(
                        signal=signal_column,
                        flow=flow_column,
                        time=time_column,
                        signal_unit=signal_unit,
                        flow_unit=flow_unit,
                        time_unit=time_unit,
                        rated=rated,
                        row_period=row_period,
                    ),
                    sweep_periods=_numbers("--sweep-period", sweep_period),
                    one_valve=one_valve,
                    controllers=[]
                    if controllers == "none"
                    else [each.strip() for each in controllers.split(",")],
                    seeds=seeds,
                    pictures=pictures,
                )
            )
        )


@app.command()
def speed(
    out: Out,
    num_envs: Annotated[
        list[int] | None, typer.Option(min=1, help="Size of a batch; may be repeated. Default: 1 to 1024.")
    ] = None,
    seconds: Annotated[float, typer.Option(min=0.05, help="Time to spend on each figure, s.")] = 1.0,
) -> None:
    """Measure how fast and exact the simulator is.

    Writes speed.json.
    """
    with _writing(out) as folder:
        from hydro_env.experiments import speed as work

        print(work.summary(work.run(folder, num_envs=num_envs or work.NUM_ENVS, seconds=seconds)))


@app.command()
def tune(
    out: Out,
    controller: Annotated[
        str,
        typer.Option(
            help="Control law whose gains are searched; `all`: every controller that ships, each with the common budget."
        ),
    ] = "pid",
    plant: Plant = "paper_dead_zone",
    mismatch: Annotated[
        str, typer.Option(help="Split the pairs of valves come from, or `none`: the plant's own pair.")
    ] = "train",
    scenario: Annotated[
        str, typer.Option(help="What is driven; several with commas.")
    ] = "setpoint_steps,random_steps",
    cases: Annotated[int, typer.Option(min=1, help="Pairs of valves each candidate drives.")] = 12,
    episodes: Annotated[int, typer.Option(min=1, help="Budget: how many episodes may be simulated.")] = 11520,
    weight: Annotated[
        float, typer.Option(help="Rpm of tracking error that one rpm of speed difference is worth.")
    ] = 2.0,
    control_period: ControlPeriod = 0.01,
    seed: Seed = 0,
    name: Annotated[str | None, typer.Option(help="The controller's name in score boards.")] = None,
    only: Annotated[str | None, typer.Option(help="With `all`: these controllers, with commas.")] = None,
    linear: Annotated[
        bool,
        typer.Option(
            help="PID gains from the linearised plant, as a PID tuner finds them, beside Table III."
        ),
    ] = False,
    max_sensitivity: Annotated[
        float, typer.Option(help="With `--linear`: how near the loop may come to instability.")
    ] = 1.3,
) -> None:
    """Search the gains of a controller.

    Writes gains.json, which `benchmark` takes. `--controller all` writes one file for each controller that ships, with gains
    for all control periods, as soon as it is found; interrupt it and give the same command to go on. Of the other options only
    --seed and --only matter then. `--linear` takes --plant and --max-sensitivity.
    """
    if controller == "all":
        from hydro_env.controllers.tuning.tune import run_all

        names = run_all(out, names=only.split(",") if only else None, seed=seed)
        print(f"In {out}: {', '.join(f'{name}.json' for name in names)}")
        return
    with _writing(out) as folder:
        if linear:
            from hydro_env.controllers.tuning import linearised as tuner

            # The linearised plant has no dead zone: the paper's own is the one to be asked unless another one is named.
            chosen = "paper" if plant == "paper_dead_zone" else plant
            print(tuner.summary(tuner.run(folder, plant=chosen, max_sensitivity=max_sensitivity, name=name)))
            return
        from hydro_env.controllers.tuning import tune as work

        work.run(
            folder,
            controller=controller,
            plant=plant,
            mismatch=None if mismatch == "none" else mismatch,
            scenario=scenario,
            cases=cases,
            episodes=episodes,
            weight=weight,
            control_period=control_period,
            seed=seed,
            name=name,
        )


@app.command()
def benchmark(
    out: Out,
    controllers: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[CONTROLLER]...",
            help="Names, gains files (.json), policies (.npz), module:Class or file.py:Class; all: those that ship, "
            "which is the default.",
        ),
    ] = None,
    more: Annotated[
        list[str] | None,
        typer.Option("--controllers", metavar="CONTROLLER...", help="The same, as an option."),
    ] = None,
    suite: Annotated[str, typer.Option(help="quick, full or a YAML file.")] = "full",
    split: Annotated[list[str] | None, typer.Option(help="Only this split; may be repeated.")] = None,
    scenario: Annotated[list[str] | None, typer.Option(help="Only this scenario; may be repeated.")] = None,
    cases: Annotated[
        int | None, typer.Option(min=1, help="Pairs of valves per split, other than the suite's.")
    ] = None,
    plant: Plant = "paper_dead_zone",
    control_period: ControlPeriod = 0.01,
    seed: Seed = 0,
    limit: Annotated[
        float, typer.Option(help="Longest that a controller may take for one split and scenario, s.")
    ] = 600.0,
    engine: Annotated[
        str,
        typer.Option(help="local: --jobs processes; ray: the Ray cluster at RAY_ADDRESS or on this machine."),
    ] = "local",
    jobs: Jobs = 1,
    cells: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Keep finished cells here; a run that was stopped goes on."),
    ] = None,
) -> None:
    """Score controllers on the fixed suite.

    Writes scores.json and scores.html.
    """
    with _writing(out) as folder:
        from hydro_env.benchmark import command

        scores = command.run(
            folder,
            controllers=[*(controllers or []), *(more or [])],
            suite=suite,
            splits=split,
            scenarios=scenario,
            cases=cases,
            plant=plant,
            control_period=control_period,
            seed=seed,
            limit=limit,
            engine=engine,
            jobs=jobs,
            cells_folder=cells,
        )
        print(command.report(scores))


@app.command()
def hide(
    out: Out,
    effects: Annotated[
        list[str] | None,
        typer.Argument(metavar="[EFFECT[:CHANNEL]]...", help="What to hide; channel 1, 2 or both (default)."),
    ] = None,
    none: Annotated[bool, typer.Option("--none", help="Hide nothing: logs that the model explains.")] = False,
    model: Model = "paper",
    severity: Annotated[
        str, typer.Option(help="Range of the drawn sizes: small, medium or large.")
    ] = "medium",
    value: Annotated[
        list[str] | None,
        typer.Option(metavar="EFFECT.PARAMETER=NUMBER", help="An exact value (SI); may be repeated."),
    ] = None,
    noise: Annotated[float, typer.Option(help="Factor on the sensor noise; 0: none.")] = 1.0,
    base_error: Annotated[
        float, typer.Option(help="How wrong the model's base parameters are, up to, %.")
    ] = 0.0,
    record: Annotated[
        str, typer.Option(help="Columns besides time, command and speed: also spool, flow.")
    ] = "setpoint,current,pressure,load",
    rate: Annotated[float, typer.Option(help="Rows per second.")] = 1000.0,
    duration: Annotated[float, typer.Option(help="Length of each log, s.")] = 12.0,
    effect_files: EffectFiles = None,
    seed: Seed = 0,
) -> None:
    """Make practice logs with effects hidden.

    Writes logs, model.yaml and truth.json.
    """
    with _writing(out) as folder:
        from hydro_env.plant import load_effects
        from hydro_env.practice import command as work

        load_effects(effect_files or [])
        work.run(
            effects or [],
            folder,
            none=none,
            model=model,
            severity=severity,
            values=value or [],
            noise=noise,
            base_error_percent=base_error,
            record=[name.strip() for name in record.split(",") if name.strip()],
            rate=rate,
            duration=duration,
            seed=seed,
        )


@app.command()
def diagnose(
    out: Out,
    fit_logs: Annotated[
        list[str] | None,
        typer.Argument(metavar="FIT_LOG...", help="Logs to learn from; LOG@FROM:TO: a part, s."),
    ] = None,
    sealed: Annotated[
        list[str] | None, typer.Option(metavar="LOG...", help="Logs that are kept for the proof.")
    ] = None,
    model: Model = "paper",
    mapping: Annotated[
        str | None, typer.Option(metavar="YAML", help="What the columns of foreign logs are.")
    ] = None,
    steady: Annotated[
        bool, typer.Option("--steady", help="Use the reduced model of a slow cylinder axis.")
    ] = False,
    inspect: Annotated[
        str | None,
        typer.Option("--inspect", metavar="LOG", help="Show what would be read of a log; propose a mapping."),
    ] = None,
    accept: Annotated[
        list[str] | None,
        typer.Option(
            metavar="CODE",
            help="Go on in spite of a finding that says the log is wrong: sign, swapped, unit.",
        ),
    ] = None,
    effect_files: EffectFiles = None,
    jobs: Annotated[
        int | None,
        typer.Option("--jobs", min=1, help="Threads to work with; one for every core unless told."),
    ] = None,
    seed: Seed = 0,
) -> None:
    """Find out from logs what a model lacks.

    Writes diagnosis.json, report.html and model.yaml; with --inspect only mapping.yaml, a proposal.
    """
    with _writing(out) as folder:
        if inspect is not None:
            from hydro_env.measured.inspect import shown

            text, proposal = shown(inspect, mapping)
            print(text)
            if proposal:
                (folder / "mapping.yaml").write_text(proposal)
            return
        from hydro_env.diagnosis import command
        from hydro_env.plant import load_effects

        load_effects(effect_files or [])
        command.run(
            fit_logs or [],
            sealed or [],
            folder,
            model=model,
            mapping=mapping,
            jobs=jobs,
            seed=seed,
            steady=steady,
            accept=accept or [],
        )


@app.command(name="close-loop")
def close_loop(
    out: Out,
    case: Annotated[list[str] | None, typer.Option(help="Only this case; may be repeated.")] = None,
    seeds: Annotated[int, typer.Option(min=1, help="Hidden rigs per case.")] = 2,
    engine: Annotated[str, typer.Option(help="local: --jobs processes; ray: a Ray cluster.")] = "local",
    jobs: Jobs = 1,
    cells: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Keep what is done here; a run that was stopped goes on."),
    ] = None,
    pictures: Annotated[bool, typer.Option("--pictures/--no-pictures", help="Draw the picture too.")] = True,
    seed: Seed = 0,
) -> None:
    """Show what a repaired model is worth to a controller.

    Hides effects, diagnoses, tunes controllers on the wrong and on the repaired model and scores them on the hidden
    rigs; writes close_loop.json, close_loop.md, a picture and the rigs' models.
    """
    with _writing(out) as folder:
        from hydro_env.experiments import close_loop as work

        print(
            work.summary(
                work.run(
                    folder,
                    cases=case,
                    seeds=seeds,
                    seed=seed,
                    cells=cells,
                    jobs=jobs,
                    engine=engine,
                    pictures=pictures,
                )
            )
        )
