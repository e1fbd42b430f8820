"""The commands `hide` and `diagnose`."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from typer import Argument, Context, Option

from hydro_env.cli.options import EffectFiles, Model, Out, Seed, number, writing
from hydro_env.errors import InputError
from hydro_env.files import sha256_of, write_text
from hydro_env.limits import CORES, Limits
from hydro_env.units import BAR

#: Options that a case does not keep: they are of one call, or kept in another way.
_OF_ONE_CALL = ("out", "case", "fit_logs", "sealed", "inspect", "effect_files", "jobs")
FitLogs = Annotated[
    list[str] | None, Argument(metavar="FIT_LOG...", help="Logs to fit. LOG@FROM:TO is a part of a log, s.")
]
HeldOut = Annotated[
    list[str] | None,
    Option("--sealed", "--held-out", metavar="LOG...", help="Held-out logs: validation only, never fitted."),
]
OneDiagnosis = Annotated[Path | None, Option("--out", help="Folder to write to; created if needed.")]
Dialogue = Annotated[
    Path | None,
    Option(metavar="DIR", help="Instead of --out: ask for experiments until sure. DIR keeps the case."),
]
Questions = Annotated[int, number("With --case: questions at most.", Limits(0, 20, whole=True))]
SensorCosts = Annotated[
    list[str] | None,
    Option(metavar="NAME=COST", help="With --case: cost of a sensor in experiments (1); none: ask for none."),
]


def hide(
    out: Out,
    effects: Annotated[
        list[str] | None,
        Argument(metavar="[EFFECT[:CHANNEL]]...", help="Effects to hide; channel 1, 2 or both (default)."),
    ] = None,
    none: Annotated[bool, Option("--none", help="Hide nothing: logs that the model explains.")] = False,
    model: Model = "paper",
    severity: Annotated[str, Option(help="Range of the drawn sizes: small, medium or large.")] = "medium",
    value: Annotated[
        list[str] | None, Option(metavar="EFFECT.PARAMETER=NUMBER", help="An exact value (SI); may be repeated.")
    ] = None,
    noise: Annotated[float, number("Factor on the sensor noise; 0: none.", Limits(0.0, 100.0))] = 1.0,
    base_error: Annotated[
        float, number("Largest error of the model's base parameters.", Limits(0.0, 50.0, unit="%"))
    ] = 0.0,
    record: Annotated[
        str, Option(help="Columns besides time, command and speed: also spool, flow, line_pressures, motor_pressure.")
    ] = "setpoint,current,pressure,load",
    rate: Annotated[float, number("Rows per second.", Limits(10.0, 20_000.0))] = 1000.0,
    duration: Annotated[
        float | None,
        number("Length of each log; default: 12 s, more where motors start slowly.", Limits(3.0, 3600.0, unit="s")),
    ] = None,
    play: Annotated[
        str | None, Option(metavar="CSV", help="Play these commands on the same rig; writes only played.csv.")
    ] = None,
    effect_files: EffectFiles = None,
    seed: Seed = 0,
) -> None:  # fmt: skip
    """Make practice logs with hidden effects.

    Writes logs, model.yaml and truth.json.
    """
    with writing(out) as folder:
        from hydro_env.plant import load_effects
        from hydro_env.practice import generate as work

        load_effects(effect_files or [])
        columns = [name.strip() for name in record.split(",") if name.strip()]
        work.run(
            effects or [], folder, none=none, model=model, severity=severity, values=value or [], noise=noise,
            base_error_percent=base_error, record=columns, rate=rate, duration=duration, play=play, seed=seed,
        )  # fmt: skip


def diagnose(
    context: Context,
    out: OneDiagnosis = None,
    case: Dialogue = None,
    fit_logs: FitLogs = None,
    sealed: HeldOut = None,
    model: Model = "paper",
    mapping: Annotated[
        str | None, Option(metavar="YAML", help="Mapping of the columns of other logs to signals.")
    ] = None,
    steady: Annotated[bool, Option("--steady", help="Use the reduced model of a slow cylinder axis.")] = False,
    inspect: Annotated[
        str | None, Option(metavar="LOG", help="Show how a log would be read; propose a mapping.")
    ] = None,
    accept: Annotated[
        list[str] | None,
        Option(metavar="CODE", help="Continue in spite of an error found in a log: sign, swapped, unit, ..."),
    ] = None,
    effect_files: EffectFiles = None,
    jobs: Annotated[int | None, number("Threads to work with. Default: one for every core.", CORES)] = None,
    command_limit: Annotated[
        float, number("Largest command of the next experiment.", Limits(1.0, 100.0, unit="%"))
    ] = 100.0,
    rate_limit: Annotated[float, number("Its largest rate, rated commands per second.", Limits(0.1, 1000.0))] = 20.0,
    pressure_limit: Annotated[
        float | None, number("Its largest load pressure. Default: supply pressure.", Limits(1.0, 1000.0, unit="bar"))
    ] = None,
    load_limit: Annotated[
        float | None, number("Its largest load. Default: that of the logs.", Limits(0.0, 1e6, unit="N m"))
    ] = None,
    questions: Questions = 3,
    sensor: SensorCosts = None,
    seed: Seed = 0,
) -> None:  # fmt: skip
    """Identify from logs what physics a model lacks.

    Writes diagnosis.json, report.html, model.yaml and, where names stay open, next_experiment.csv; with --inspect only
    mapping.yaml, a proposal.
    """
    if (out is None) == (case is None):
        raise InputError("give either --out DIR for one diagnosis, or --case DIR for a dialogue")
    from hydro_env.plant import load_effects

    if out is None:
        if inspect is not None:
            raise InputError("--inspect shows a log without a case; give --out DIR with it")
        load_effects(effect_files or [])
        _dialogue(context)
        return
    with writing(out) as folder:
        if inspect is not None:
            _inspect(inspect, mapping, folder)
            return
        from hydro_env.case import command

        load_effects(effect_files or [])
        command.run(
            fit_logs or [], sealed or [], folder, model=model, mapping=mapping, jobs=jobs, **_arguments(context.params)
        )  # fmt: skip


def _inspect(log: str, mapping: str | None, folder: Path) -> None:
    """Prints how a log would be read, and writes a proposal of its mapping."""
    from hydro_env.measured.inspect import shown

    text, proposal = shown(log, mapping)
    print(text)
    if proposal:
        write_text(folder / "mapping.yaml", proposal)


def _dialogue(context: Context) -> None:
    """One call of a case. Code of effects is run only where it is named, so every call names it."""
    from hydro_env.case import dialogue

    options = context.params
    kept = {name: value for name, value in options.items() if name not in _OF_ONE_CALL}
    given = {n for n in kept if getattr(context.get_parameter_source(n), "name", "DEFAULT") != "DEFAULT"}
    kept["effects"] = [sha256_of(Path(path)) for path in options["effect_files"] or []]
    dialogue.run(
        options["case"], options["fit_logs"] or [], options["sealed"] or [], kept, given | {"effects"}, jobs=options["jobs"],
        arguments=_arguments,
    )  # fmt: skip


def _arguments(options: Mapping[str, Any]) -> dict[str, Any]:
    """Arguments of `diagnose` from options of the command."""
    from hydro_env.diagnosis import Settings

    pressure = options["pressure_limit"]
    settings = Settings(
        seed=options["seed"], command_limit=options["command_limit"] / 100.0, rate_limit=options["rate_limit"],
        load_limit=options["load_limit"], pressure_limit=None if pressure is None else pressure * BAR,
    )  # fmt: skip
    return {"settings": settings, "steady": options["steady"], "accept": options["accept"] or []}
