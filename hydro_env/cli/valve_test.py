"""The command `valve-test`."""

from __future__ import annotations

from typing import Annotated

import typer

from hydro_env.cli.options import Out, Pictures, numbers, writing

Valves = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="[VALVE]...",
        help="Presets or model files (paper:2: channel 2), files of measured curves. Default: the paper's.",
    ),
]
Signal = Annotated[str, typer.Option(help="Signal axis of modelled valves: current or command.")]
Seconds = Annotated[str, typer.Option(help="Sweep times of modelled valves, s, separated by commas.")]
SignalColumn = Annotated[str | None, typer.Option(help="Name or number. Default: the first.")]
FlowColumn = Annotated[str | None, typer.Option(help="Name or number. Default: the second.")]
TimeColumn = Annotated[str | None, typer.Option(help="Name or number, if there is one.")]
SignalUnit = Annotated[str | None, typer.Option(help="mA, V, percent, ... Default: the header's.")]
FlowUnit = Annotated[str | None, typer.Option(help="lpm, GPM, ... Default: the header's.")]
TimeUnit = Annotated[str | None, typer.Option(help="s, ms, ... Default: the header's, or s.")]
Rated = Annotated[
    float | None, typer.Option(help="Rated signal of a measured valve, in its unit. Default: the largest.")
]
RowPeriod = Annotated[float | None, typer.Option(help="Time between rows, s, where no column holds it.")]
SweepPeriod = Annotated[
    str, typer.Option(help="Length of a whole sweep, s, where the file does not say; one for each file.")
]
OneValve = Annotated[bool, typer.Option("--one-valve", help="The measured files are sweeps of one valve.")]
Controllers = Annotated[
    str, typer.Option(help="Controllers that drive each pair of modelled valves; `none`: no pairs.")
]
Seeds = Annotated[int, typer.Option(min=1, help="Seeds of the sensor noise per pair.")]


def valve_test(
    out: Out,
    valves: Valves = None,
    signal: Signal = "current",
    seconds: Seconds = "5,20,80",
    signal_column: SignalColumn = None,
    flow_column: FlowColumn = None,
    time_column: TimeColumn = None,
    signal_unit: SignalUnit = None,
    flow_unit: FlowUnit = None,
    time_unit: TimeUnit = None,
    rated: Rated = None,
    row_period: RowPeriod = None,
    sweep_period: SweepPeriod = "",
    one_valve: OneValve = False,
    controllers: Controllers = "pid_paper,pid_tuned,adaptive_flow",
    seeds: Seeds = 4,
    pictures: Pictures = True,
) -> None:
    """Measure steady flow curves as in ISO 10770-1.

    Dead zone, hysteresis, gain, linearity, ... of modelled or measured valves, lag or hysteresis, and the most similar
    pair of several valves; writes valve_test.json, curves.csv and pictures.
    """
    with writing(out) as folder:
        from hydro_env.experiments import valve_test as work
        from hydro_env.valve_bench import Columns

        columns = Columns(
            signal=signal_column, flow=flow_column, time=time_column, signal_unit=signal_unit, flow_unit=flow_unit,
            time_unit=time_unit, rated=rated, row_period=row_period,
        )  # fmt: skip
        settings = work.Settings(
            signal=signal,
            seconds=tuple(numbers("--seconds", seconds)),
            columns=columns,
            sweep_periods=tuple(numbers("--sweep-period", sweep_period)),
            one_valve=one_valve,
            controllers=()
            if controllers == "none"
            else tuple(each.strip() for each in controllers.split(",")),
            seeds=seeds,
            pictures=pictures,
        )
        print(work.summary(work.run(folder, valves or work.default_valves(), settings)))
