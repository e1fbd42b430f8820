"""The command `export` with what it exports: fmu, c, st, plc, onnx."""

from typing import Annotated

from typer import Argument, Context, Option

from hydro_env.cli.help import HelpfulCommand, group_of_commands
from hydro_env.cli.options import ControlPeriod, Out, number, writing
from hydro_env.errors import InputError
from hydro_env.limits import Limits

export = group_of_commands(
    "Take the rig or a controller to another tool: FMU, C99, Structured Text, a PLC project, ONNX."
)

# fmt: off
Controller = Annotated[str, Argument(
    metavar="CONTROLLER",
    help="A shipped controller, a gains file (.json), a policy (.npz) or file.py:Class, with gains if wanted (NAME:Kp=0.2).",
)]
Bench = Annotated[
    str | None, Option("--plant", help="Preset or YAML file of the rig that it drives, whose valves go on the bench where "
    "needed. Default: that of a gains file, else paper_dead_zone.")
]
Trust = Annotated[bool, Option("--trust", help="Use gains (.json) of a law in a Python file, which is run.")]
Single = Annotated[bool, Option("--single", help="Networks in single precision: smaller and faster.")]
# fmt: on


@export.command(cls=HelpfulCommand)
def fmu(
    out: Out,
    model: Annotated[str, Option(help="Preset or YAML file of the rig.")],
    fmi: Annotated[str, Option(help="Version of the standard: 2, 3 or both.")] = "both",
    platform: Annotated[list[str] | None, Option(
        help="Platform of a binary: linux64, win64, darwin64, linux-arm64 or darwin-arm64; may be given several times (extra "
        "`windows` for others than this machine's). Default: this machine.")] = None,
) -> None:  # fmt: skip
    """Export a rig as a co-simulation FMU.

    FMI 2.0 and 3.0, with the C source and, where there is a C compiler, binaries.
    """
    versions = {"2": (2,), "3": (3,), "both": (2, 3)}.get(fmi)
    if versions is None:
        raise InputError(f"--fmi is {fmi!r}; 2, 3 or both is right")
    with writing(out) as folder:
        from hydro_env.export.fmu.build import export_fmu
        from hydro_env.plant import load_model

        made = export_fmu(load_model(model), folder, versions, tuple(platform or ()))
        if made.note:
            print(f"Note: {made.note}.")


def _controller(
    context: Context, controller: Controller, out: Out, control_period: ControlPeriod = 0.01, plant: Bench = None,
    single: Single = False, trust: Trust = False,
) -> None:  # fmt: skip
    with writing(out) as folder:
        from hydro_env.export.controllers import export_controller

        export_controller(str(context.info_name), controller, folder, control_period, plant, single, trust)


for _language, _help in {
    "c": "Export a controller as C99.\n\n"
    "One header and one source; a state of fixed size, nothing allocated, nothing but math.h.",
    "st": "Export a controller as Structured Text.\n\n"
    "A function block of IEC 61131-3 for a PLC: PID, couplings, and networks.",
}.items():
    export.command(_language, cls=HelpfulCommand, help=_help)(_controller)


@export.command(cls=HelpfulCommand)
def plc(
    controller: Controller, out: Out,
    fallback: Annotated[str, Option(metavar="CONTROLLER", help="A controller that goes by the speeds alone.")] = "pid_tuned",
    full_scale: Annotated[int, number(
        "Raw value of the analogue cards at 10 V or 20 mA.", Limits(1000, 32767, whole=True), "--full-scale")] = 27648,
    signal: Annotated[str, Option(help="Signal of the sensors: 10V or 4-20mA.")] = "10V",
    twincat: Annotated[bool, Option(
        "--twincat", help="Declare what is wired with AT %I* and AT %Q*, as TwinCAT links it.")] = False,
    control_period: ControlPeriod = 0.01, plant: Bench = None, single: Single = False, trust: Trust = False,
) -> None:  # fmt: skip
    """Export a controller as a project for a PLC.

    Structured Text and the same as PLCopen XML: scaling, modes, ramp, watchdog, fallback, and a task that calls it all.
    """
    with writing(out) as folder:
        from hydro_env.export.plc import Cards, plc_files

        cards = Cards(full_scale, signal, twincat)
        plc_files(controller, folder, control_period, plant, single, trust, fallback, cards)


@export.command(cls=HelpfulCommand)
def onnx(controller: Controller, out: Out) -> None:
    """Export the network of a learned agent as ONNX.

    The graph alone; its metadata say what its inputs are (needs the extra `agents`).
    """
    with writing(out) as folder:
        from hydro_env.export.controllers import export_network

        export_network(controller, folder)
