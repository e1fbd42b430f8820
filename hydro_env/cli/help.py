"""What `--help` shows: options in groups, and the examples of examples.yaml, which can be copied."""

from functools import cache
from importlib.resources import files
from typing import Any

from typer import Typer
from typer.core import TyperCommand, TyperGroup


@cache
def lists(name: str) -> dict[str, list[str]]:
    """What stands in a file of the package, examples.yaml or headings.yaml."""
    import yaml

    text = files("hydro_env.cli").joinpath(name).read_text(encoding="utf-8")
    found: dict[str, list[str]] = yaml.safe_load(text)
    return found


def examples() -> dict[str, list[str]]:
    """Examples by command; "" for those of `hydro-env --help`."""
    return lists("examples.yaml")


def _write_examples(formatter: Any, command: str) -> None:
    if command in examples():
        with formatter.section("Examples"):
            # One line each, however long: it is to be copied.
            for example in examples()[command]:
                formatter.write(f"  {example}\n")


class HelpfulCommand(TyperCommand):
    """A command whose help shows its options below the headings of headings.yaml, and its examples."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Writes arguments and groups of options."""
        headings = lists("headings.yaml")
        heading_of = {option: heading for heading, options in headings.items() for option in options}
        groups: dict[str, list[Any]] = {name: [] for name in ("Arguments", "Task", *headings)}
        for parameter in self.get_params(ctx):
            if record := parameter.get_help_record(ctx):
                argument = parameter.param_type_name == "argument"
                heading = "Arguments" if argument else heading_of.get(str(parameter.name), "Task")
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
        own = str(self.name) if self.name in examples() else ""
        _write_examples(formatter, own)
        path = f"hydro-env {own}".strip()
        formatter.write(f"\nOptions and examples of a command: {path} COMMAND --help\n")


def group_of_commands(help: str) -> Typer:
    """A group of commands with such help; the commands in it have `HelpfulCommand` as their class."""
    return Typer(cls=HelpfulGroup, rich_markup_mode=None, no_args_is_help=True, help=help)
