"""The commands `hide` and `diagnose`."""

from __future__ import annotations

from typing import Annotated

import typer

from hydro_env.cli.options import EffectFiles, Model, Out, Seed, number, writing
from hydro_env.files import write_text
from hydro_env.limits import CORES, Limits

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
    severity: Annotated[
        str, typer.Option(help="Range of the drawn sizes: small, medium or large.")
    ] = "medium",
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
    seed: Seed = 0,
) -> None:
    """Identify from logs what physics a model lacks.

    Writes diagnosis.json, report.html and model.yaml; with --inspect only mapping.yaml, a proposal.
    """
    with writing(out) as folder:
        if inspect is not None:
            from hydro_env.measured.inspect import shown

            text, proposal = shown(inspect, mapping)
            print(text)
            if proposal:
                write_text(folder / "mapping.yaml", proposal)
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
