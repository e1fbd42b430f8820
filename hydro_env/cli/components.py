"""The commands `describe` and `valve-test`: what data sheets and curves say of components."""

import sys
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from hydro_env.cli.options import Out, Pictures, number, numbers, writing
from hydro_env.errors import InputError, located
from hydro_env.limits import Limits

SWEEP = Limits(0.5, 3600.0, unit="s")
MEASURED_SWEEP = Limits(1e-3, 1e6, unit="s")


def describe(
    sheet: Annotated[
        Path | None,
        Argument(metavar="[SHEET.yaml]", help="Data sheet of the rig. Without one, questions are asked."),
    ] = None,
    out: Annotated[Path | None, Option("--out", help="Folder to write to; created if needed.")] = None,
    empty: Annotated[
        bool, Option("--template", help="Print an empty data sheet with all keys, and end.")
    ] = False,
) -> None:
    """Make a model from data sheets.

    Valve, motor, supply, lines and oil as their data sheets print them. Shows the given data sheet beside the simulated one and
    what had to be assumed; writes model.yaml, describe.json and describe.txt, and after questions data_sheet.yaml.
    """
    from hydro_env import data_sheet
    from hydro_env.files import write_text

    if empty:
        print(data_sheet.template(), end="")
        return
    if out is None:
        raise InputError("Missing option '--out': the folder to write the model to")
    if sheet is None and not sys.stdin.isatty():
        raise InputError(
            "name a data sheet (`hydro-env describe --template` prints an empty one); questions need a terminal"
        )
    given, answers = (data_sheet.read_sheet(sheet), "") if sheet else data_sheet.ask(out / "data_sheet.yaml")
    with writing(out) as folder:
        if answers:
            write_text(folder / "data_sheet.yaml", answers)
        with located(sheet or "the answers"):
            described = data_sheet.describe(given)
        print(data_sheet.write(described, folder))


def valve_test(
    out: Out,
    valves: Annotated[list[str] | None, Argument(
        metavar="[VALVE]...",
        help="Presets or model files (paper:2: channel 2), files of measured curves. Default: the presets valve_1, ...",
    )] = None,
    signal: Annotated[str, Option(help="Signal axis of modelled valves: current or command.")] = "current",
    seconds: Annotated[
        str, Option(help=f"Sweep times of modelled valves, separated by commas. Each {SWEEP}.")
    ] = "5,20,80",
    signal_column: Annotated[str | None, Option(help="Name or number. Default: the first.")] = None,
    flow_column: Annotated[str | None, Option(help="Name or number. Default: the second.")] = None,
    time_column: Annotated[str | None, Option(help="Name or number, if there is one.")] = None,
    signal_unit: Annotated[str | None, Option(help="mA, V, percent, ... Default: the header's.")] = None,
    flow_unit: Annotated[str | None, Option(help="lpm, GPM, ... Default: the header's.")] = None,
    time_unit: Annotated[str | None, Option(help="s, ms, ... Default: the header's, or s.")] = None,
    rated: Annotated[
        float | None, number("Rated signal of a measured valve, in its unit. Default: the largest.", Limits(1e-6, 1e6))
    ] = None,
    row_period: Annotated[
        float | None, number("Time between rows, where no column holds it.", Limits(1e-9, 3600.0, unit="s"))
    ] = None,
    sweep_period: Annotated[str, Option(
        help=f"Length of a whole sweep, where the file does not say; one for each file. Each {MEASURED_SWEEP}."
    )] = "",
    one_valve: Annotated[bool, Option("--one-valve", help="The measured files are sweeps of one valve.")] = False,
    controllers: Annotated[
        str, Option(help="Controllers that drive each pair of modelled valves; `none`: no pairs.")
    ] = "pid_paper,pid_tuned,adaptive_flow",
    seeds: Annotated[int, number("Seeds of the sensor noise per pair.", Limits(1, 1000, whole=True))] = 4,
    pictures: Pictures = True,
) -> None:  # fmt: skip
    """Measure steady flow curves as in ISO 10770-1.

    Dead zone, hysteresis, gain, linearity, ... of modelled or measured valves, lag or hysteresis, and the most similar
    pair of several valves; writes valve_test.json, curves.csv, valve_test.html and pictures.
    """
    times = numbers("--seconds", seconds, SWEEP)
    if not times:
        raise InputError("--seconds is empty; sweep times separated by commas, such as 5,20,80, are right")
    with writing(out) as folder:
        from hydro_env.experiments import valve_test as work
        from hydro_env.valve_bench import Columns
        from hydro_env.valve_bench.bench import Sweeps

        columns = Columns(
            signal=signal_column, flow=flow_column, time=time_column, signal_unit=signal_unit, flow_unit=flow_unit,
            time_unit=time_unit, rated=rated, row_period=row_period,
        )  # fmt: skip
        periods = numbers("--sweep-period", sweep_period, MEASURED_SWEEP)
        names = [] if controllers == "none" else [each.strip() for each in controllers.split(",")]
        sweeps = Sweeps(signal, times, columns, periods, one_valve)
        data = work.run(
            folder, valves or work.VALVES, sweeps, controllers=names, seeds=seeds, pictures=pictures
        )
        print(work.summary(data))
