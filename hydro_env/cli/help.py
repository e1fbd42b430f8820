"""What `--help` shows: options in groups, and examples that can be copied."""

from __future__ import annotations

from typing import Any

from typer.core import TyperCommand, TyperGroup

__all__ = ["EXAMPLES", "HelpfulCommand", "HelpfulGroup"]

EXAMPLES: dict[str, tuple[str, ...]] = {
    "": (
        "hydro-env demo --out demo",
        "hydro-env list controllers",
        "hydro-env benchmark --suite quick --out scores",
        "hydro-env hide dead_zone:1 --out practice",
    ),
    "demo": ("hydro-env demo --out demo",),
    "reproduce": ("hydro-env reproduce --out paper",),
    "valve-test": (
        "hydro-env valve-test --out valves",
        "hydro-env valve-test my_rig.yaml:1 my_rig.yaml:2 --out valves",
        "hydro-env valve-test measured.csv --rated 730 --row-period 0.01 --out valves",
    ),
    "speed": ("hydro-env speed --num-envs 1024 --seconds 0.5 --out speed",),
    "tune": (
        "hydro-env tune --controller cross_coupled --out gains",
        "hydro-env tune --controller my_file.py:MyController --plant my_rig.yaml --out gains",
        "hydro-env tune --linear --out gains",
    ),
    "train": (
        "hydro-env train --algo ppo_quick --out run",
        "hydro-env train --algo ppo --seed 3 --out runs/ppo_3",
        "hydro-env train --config my_training.yml --out run",
        "hydro-env train --resume --out run",
    ),
    "benchmark": (
        "hydro-env benchmark --suite quick --out scores",
        "hydro-env benchmark my_file.py:MyController:Kp=0.02 pid_tuned --suite quick --out scores",
        "hydro-env benchmark my_agent.zip ppo --trust --split test_extrap --out scores",
        "hydro-env benchmark gains/gains.json --plant my_rig.yaml --out scores",
        "hydro-env benchmark pid_tuned --plant my_rig.fmu --mapping my_rig_fmu.yaml --trust --out scores",
    ),
    "dataset": (
        "hydro-env dataset --out data",
        "hydro-env dataset --controller pid_tuned --controller oracle --split train --episodes 1000 --out data",
        "hydro-env dataset --controller my_file.py:MyController --scenario sine --out data",
    ),
    "hide": (
        "hydro-env hide dead_zone:1 --out practice",
        "hydro-env hide supply_droop magnetic_hysteresis:2 --severity large --seed 3 --out practice",
        "hydro-env hide dead_zone:1 --value dead_zone.overlap_positive=8e-5 --out practice",
        "hydro-env hide dead_zone:1 --play found/next_experiment.csv --out second",
    ),
    "diagnose": (
        "hydro-env diagnose practice/fit_1.csv practice/fit_2.csv --sealed practice/sealed.csv --out found",
        "hydro-env diagnose --inspect monday.csv --out look",
        "hydro-env diagnose monday.csv --sealed tuesday.csv --mapping look/mapping.yaml --model my_rig.yaml --out found",
    ),
    "lab": ("hydro-env lab", "hydro-env lab --plant my_rig.yaml --controller gains/gains.json"),
    "close-loop": ("hydro-env close-loop --seeds 1 --out loop",),
    "export": (
        "hydro-env export fmu --model my_rig.yaml --out fmu",
        "hydro-env export c gru --out c",
    ),
    "fmu": (
        "hydro-env export fmu --model paper_dead_zone --out fmu",
        "hydro-env export fmu --model my_rig.yaml --fmi 2 --out fmu",
    ),
    "c": (
        "hydro-env export c cross_coupled --out c",
        "hydro-env export c pid_tuned:Kp=0.05 --control-period 0.005 --out c",
    ),
    "st": ("hydro-env export st cross_coupled --out plc",),
    "onnx": ("hydro-env export onnx gru --out onnx",),
    "naming-benchmark": (
        "hydro-env naming-benchmark make --rigs 40 --out naming",
        "hydro-env naming-benchmark run diagnose certify --set naming --out answers",
        "hydro-env naming-benchmark score answers/diagnose answers/certify --set naming --out scores",
    ),
    "make": ("hydro-env naming-benchmark make --rigs 40 --seed 1 --out naming",),
    "run": ("hydro-env naming-benchmark run all --set naming --out answers",),
    "score": ("hydro-env naming-benchmark score answers/diagnose my_answers --set naming --out scores",),
    "list": (
        "hydro-env list",
        "hydro-env list effects",
        "hydro-env list controllers --json",
    ),
}
"""Examples by command; "" for those of `hydro-env --help`."""

GROUPS: dict[str, tuple[str, ...]] = {
    "Task": (
        "algo", "config", "steps",
        "more", "controller", "controllers", "suite", "split", "scenario", "cases", "mismatch", "weight", "episodes", "only",
        "linear", "max_sensitivity", "case", "seeds", "none", "severity", "value", "noise", "base_error", "rate", "duration",
        "record", "num_envs", "seconds", "rigs", "set_folder", "sealed", "accept", "play",
        "command_limit", "rate_limit", "pressure_limit", "load_limit", "signal", "fmi",
    ),
    "Rig and model": ("plant", "model", "control_period", "steady", "effect_files"),
    "Columns of logs and curves": (
        "inspect", "mapping", "signal_column", "flow_column", "time_column", "signal_unit", "flow_unit", "time_unit", "rated",
        "row_period", "sweep_period", "one_valve",
    ),
    "Running": ("seed", "limit", "trust", "engine", "jobs", "cells", "resume", "quiet", "port", "browser"),
    "Output": ("out", "name", "pictures", "as_json"),
}  # fmt: skip
"""Options, by the names of their parameters, under the heading that they stand below; all others come last."""


def _write_examples(formatter: Any, command: str) -> None:
    if command in EXAMPLES:
        with formatter.section("Examples"):
            # One line each, however long: it is to be copied.
            for example in EXAMPLES[command]:
                formatter.write(f"  {example}\n")


class HelpfulCommand(TyperCommand):
    """A command whose help shows its options in `GROUPS`, and its `EXAMPLES`."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Writes arguments and groups of options."""
        groups: dict[str, list[tuple[str, str]]] = {
            "Arguments": [],
            **{name: [] for name in GROUPS},
            "Help": [],
        }
        headings = {option: heading for heading, options in GROUPS.items() for option in options}
        for parameter in self.get_params(ctx):
            if (record := parameter.get_help_record(ctx)) is not None:
                argument = parameter.param_type_name == "argument"
                heading = "Arguments" if argument else headings.get(str(parameter.name), "Help")
                groups[heading].append(record)
        for heading, records in groups.items():
            if records:
                with formatter.section(heading):
                    formatter.write_dl(records)

    def format_epilog(self, ctx: Any, formatter: Any) -> None:
        """Writes the examples."""
        _write_examples(formatter, str(self.name))


class HelpfulGroup(TyperGroup):
    """`hydro-env` itself, or a group of its commands."""

    def format_epilog(self, ctx: Any, formatter: Any) -> None:
        """Writes the examples, and where each command's own are."""
        own = str(self.name) if self.name in EXAMPLES else ""
        _write_examples(formatter, own)
        path = f"hydro-env {own}".strip()
        formatter.write(f"\nOptions and examples of a command: {path} COMMAND --help\n")
