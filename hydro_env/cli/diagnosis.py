"""The commands `hide` and `diagnose`."""

from __future__ import annotations

from typing import Annotated

import typer

from hydro_env.cli.options import EffectFiles, Model, Out, Seed, number, writing
from hydro_env.files import write_text
from hydro_env.limits import CORES, Limits
from hydro_env.units import BAR

FitLogs = Annotated[
    list[str] | None,
    typer.Argument(metavar="FIT_LOG...", help="Logs to fit. LOG@FROM:TO is a part of a log, s."),
]
HeldOut = Annotated[
    list[str] | None,
    typer.Option(
        "--sealed", "--held-out", metavar="LOG...", help="Held-out logs: validation only, never fitted."
    ),
]
MappingFile = Annotated[
    str | None,
    typer.Option("--mapping", metavar="YAML", help="Mapping of the columns of other logs to signals."),
]
Steady = Annotated[bool, typer.Option("--steady", help="Use the reduced model of a slow cylinder axis.")]
Inspect = Annotated[
    str | None,
    typer.Option("--inspect", metavar="LOG", help="Show how a log would be read; propose a mapping."),
]
Accept = Annotated[
    list[str] | None,
    typer.Option(
        metavar="CODE", help="Continue in spite of an error found in a log: sign, swapped, unit, ..."
    ),
]
Threads = Annotated[
    int | None, number("--jobs", within=CORES, help="Threads to work with. Default: one for every core.")
]

PressureLimit = Annotated[
    float | None,
    number(
        within=Limits(1.0, 1000.0, unit="bar"), help="Its largest load pressure. Default: supply pressure."
    ),
]
LoadLimit = Annotated[
    float | None,
    number(within=Limits(0.0, 1e6, unit="N m"), help="Its largest load. Default: that of the logs."),
]
Severity = Annotated[str, typer.Option(help="Range of the drawn sizes: small, medium or large.")]
Play = Annotated[
    str | None,
    typer.Option(metavar="CSV", help="Play these commands on the same rig; writes only played.csv."),
]


def hide(
    out: Out,
    effects: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[EFFECT[:CHANNEL]]...", help="Effects to hide; channel 1, 2 or both (default)."
        ),
    ] = None,
    none: Annotated[bool, typer.Option("--none", help="Hide nothing: logs that the model explains.")] = False,
    model: Model = "paper",
    severity: Severity = "medium",
    value: Annotated[
        list[str] | None,
        typer.Option(metavar="EFFECT.PARAMETER=NUMBER", help="An exact value (SI); may be repeated."),
    ] = None,
    noise: Annotated[
        float, number(within=Limits(0.0, 100.0), help="Factor on the sensor noise; 0: none.")
    ] = 1.0,
    base_error: Annotated[
        float,
        number(within=Limits(0.0, 50.0, unit="%"), help="Largest error of the model's base parameters."),
    ] = 0.0,
    record: Annotated[
        str, typer.Option(help="Columns besides time, command and speed: also spool, flow, line_pressures.")
    ] = "setpoint,current,pressure,load",
    rate: Annotated[float, number(within=Limits(10.0, 20_000.0), help="Rows per second.")] = 1000.0,
    duration: Annotated[
        float, number(within=Limits(3.0, 3600.0, unit="s"), help="Length of each log.")
    ] = 12.0,
    play: Play = None,
    effect_files: EffectFiles = None,
    seed: Seed = 0,
) -> None:
    """Make practice logs with hidden effects.

    Writes logs, model.yaml and truth.json.
    """
    with writing(out) as folder:
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
            play=play,
            seed=seed,
        )


def diagnose(
    out: Out,
    fit_logs: FitLogs = None,
    sealed: HeldOut = None,
    model: Model = "paper",
    mapping: MappingFile = None,
    steady: Steady = False,
    inspect: Inspect = None,
    accept: Accept = None,
    effect_files: EffectFiles = None,
    jobs: Threads = None,
    command_limit: Annotated[
        float, number(within=Limits(1.0, 100.0, unit="%"), help="Largest command of the next experiment.")
    ] = 100.0,
    rate_limit: Annotated[
        float, number(within=Limits(0.1, 1000.0), help="Its largest rate, rated commands per second.")
    ] = 20.0,
    pressure_limit: PressureLimit = None,
    load_limit: LoadLimit = None,
    seed: Seed = 0,
) -> None:
    """Identify from logs what physics a model lacks.

    Writes diagnosis.json, report.html, model.yaml and, where names stay open, next_experiment.csv; with --inspect only
    mapping.yaml, a proposal.
    """
    with writing(out) as folder:
        if inspect is not None:
            from hydro_env.measured.inspect import shown

            text, proposal = shown(inspect, mapping)
            print(text)
            if proposal:
                write_text(folder / "mapping.yaml", proposal)
            return
        from hydro_env.diagnosis import Settings, command
        from hydro_env.plant import load_effects

        load_effects(effect_files or [])
        command.run(
            fit_logs or [],
            sealed or [],
            folder,
            model=model,
            mapping=mapping,
            jobs=jobs,
            settings=Settings(
                seed=seed,
                command_limit=command_limit / 100.0,
                rate_limit=rate_limit,
                pressure_limit=None if pressure_limit is None else pressure_limit * BAR,
                load_limit=load_limit,
            ),
            steady=steady,
            accept=accept or [],
        )
