"""Imports go one way between the rooms of the package and never in a circle; functions and signatures stay short."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).parents[2]

#: What each room (a folder or module directly below `hydro_env`) may import from the package, beside itself.
#: "envs.observation" allows that module only. `agents` and `docs.evidence` may import all of it; nothing in `hydro_env` imports
#: these: what they hold is in no wheel, and no change of it invalidates a cache of a user.
ALLOWED = {
    "arrays": "",
    "errors": "",
    "pickles": "",
    "jit": "errors files pickles",
    "files": "errors",
    "reading": "errors",
    "limits": "errors",
    "validation": "errors",
    "units": "errors",
    "ir": "",
    "pages": "errors files",
    "waveforms": "arrays",
    "streams": "arrays jit",
    "parallel": "errors files pickles",
    "plant": "arrays errors files reading units validation ir jit",
    "practice": "arrays errors files reading limits units jit waveforms plant measured",
    "tasks": "arrays errors files reading units validation streams plant",
    "measured": "errors files reading units validation",
    "envs": "arrays errors files limits units jit streams plant tasks",
    "sb3": "errors envs",
    "multi_agent": "errors envs",
    "valve_bench": "arrays errors files reading units pages waveforms plant measured",
    "data_sheet": "arrays errors files reading units validation plant valve_bench",
    "controllers": "arrays errors files reading limits units validation jit waveforms plant tasks envs valve_bench",
    "datasets": "arrays errors streams plant tasks controllers",
    "diagnosis": "errors files units pages waveforms parallel plant tasks measured",
    "case": "errors files reading limits validation pages plant diagnosis",
    "benchmark": "arrays errors files reading units validation pages parallel plant tasks envs controllers",
    "fmu_plant": "arrays errors reading units validation plant",
    "export": "errors files ir plant units envs controllers",
    "training": "errors files reading validation pickles units tasks controllers sb3",
    "experiments": "arrays errors files reading limits units validation pages waveforms parallel plant practice tasks measured"
    " envs valve_bench controllers diagnosis case benchmark",
    "live": "arrays errors files reading units validation plant practice tasks measured envs controllers",
    "lab": "arrays errors files reading limits units streams pages plant practice tasks measured envs controllers diagnosis case"
    " benchmark live",
    "cli": "errors files jit limits units pages plant practice tasks measured valve_bench data_sheet controllers datasets"
    " diagnosis case benchmark training experiments export fmu_plant live lab",
    "__main__": "cli",
}

#: Imports against the table that are still to be removed. Add none.
AGAINST_THE_TABLE: set[str] = set()

MAX_LINES = 60
#: Functions that are longer, and why.
LONGER = {
    "hydro_env.plant.rhs.rates": "the equations of the plant, read from top to bottom",
}

MAX_PARAMETERS = 10
#: Functions with more parameters, and why.
CROWDED = {
    "hydro_env.plant.kernel.driver.advance": "the arrays of a block: a tuple of them would be taken apart at every step",
    "hydro_env.plant.rhs.rates": "states, inputs and parameters of one channel by their own names",
    "hydro_env.envs.batch.HydraulicSyncVectorEnv.__init__": "the keyword arguments of gymnasium.make_vec",
    "hydro_env.envs.hydraulic_sync.HydraulicSyncEnv.__init__": "the keyword arguments of gymnasium.make",
    "hydro_env.plant.catalogue.form_corrections.valve._gain_curve": "a law asks by name for all that it reads",
    "hydro_env.plant.catalogue.form_corrections.valve._second_bristle": "a law asks by name for all that it reads",
    "hydro_env.plant.catalogue.form_corrections.valve._stops_force": "a law asks by name for all that it reads",
    "hydro_env.plant.catalogue.losses._jeong_torque": "a law asks by name for all that it reads",
    "hydro_env.cli.controllers.benchmark": "an option each",
    "hydro_env.diagnosis.workflow.diagnose": "all that a user may give, most of it optional",
    "hydro_env.cli.diagnosis.diagnose": "an option each",
    "hydro_env.cli.diagnosis.hide": "an option each",
    "hydro_env.cli.controllers.tune": "an option each",
    "hydro_env.cli.components.valve_test": "an option each",
}


@cache
def modules() -> dict[str, Path]:
    """All modules of the package, the workshop and the evidence by their dotted names."""
    paths = [
        path for folder in ("hydro_env", "agents", "docs/evidence") for path in (ROOT / folder).rglob("*.py")
    ]
    return {
        ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path
        for path in paths
    }


@cache
def syntax(module: str) -> ast.Module:
    return ast.parse(modules()[module].read_text(encoding="utf-8"))


def imports(module: str, *, for_types: bool) -> Iterator[str]:
    """Modules of ours that `module` imports anywhere, also inside functions; under TYPE_CHECKING if `for_types`."""
    package = module.split(".") if modules()[module].name == "__init__.py" else module.split(".")[:-1]

    def below(node: ast.AST) -> Iterator[ast.AST]:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test) and not for_types:
                continue
            yield child
            yield from below(child)

    for node in below(syntax(module)):
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            above = package[: len(package) - node.level + 1] if node.level else []
            source = ".".join([*above, *([node.module] if node.module else [])])
            full = [f"{source}.{alias.name}" for alias in node.names]
            names = [name if name in modules() else source for name in full]
        yield from (name for name in names if name in modules() and name != module)


def room(module: str) -> str:
    top, _, rest = module.partition(".")
    return rest.partition(".")[0] if top == "hydro_env" else top


def compare(found: set[str], listed: set[str]) -> None:
    assert not found - listed, f"over the limit: {sorted(found - listed)}"
    assert not listed - found, (
        f"within the limit now, or gone; take it off the list: {sorted(listed - found)}"
    )


def test_every_room_has_its_row() -> None:
    assert {room(module) for module in modules()} == {*ALLOWED, "", "agents", "docs"}


def test_imports_between_rooms_go_one_way() -> None:
    against = set()
    for module in modules():
        if room(module) in ("agents", "docs"):
            continue
        allowed = [f"hydro_env.{name}" for name in ALLOWED.get(room(module), "").split()]
        for target in imports(module, for_types=True):
            inside = room(target) in (room(module), "")
            if not inside and not any(target == each or target.startswith(f"{each}.") for each in allowed):
                against.add(f"{module} -> {target}")
    compare(against, AGAINST_THE_TABLE)


def test_no_modules_import_each_other() -> None:
    graph = {module: set(imports(module, for_types=False)) for module in modules()}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        raise AssertionError("a circle: " + " -> ".join(reversed(error.args[1]))) from None


def functions() -> Iterator[tuple[str, ast.FunctionDef | ast.AsyncFunctionDef]]:
    """Every function with its dotted name, methods and inner ones too."""

    def below(node: ast.AST, name: str) -> Iterator[tuple[str, ast.FunctionDef | ast.AsyncFunctionDef]]:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
                inner = f"{name}.{child.name}"
                if not isinstance(child, ast.ClassDef):
                    yield inner, child
                yield from below(child, inner)
            else:
                yield from below(child, name)

    for module in modules():
        yield from below(syntax(module), module)


def test_functions_are_short() -> None:
    compare(
        {name for name, node in functions() if (node.end_lineno or 0) - node.lineno >= MAX_LINES},
        {*LONGER},
    )


def test_signatures_are_short() -> None:
    def parameters(node: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
        return len(node.args.posonlyargs) + len(node.args.args) + len(node.args.kwonlyargs)

    compare(
        {name for name, node in functions() if parameters(node) > MAX_PARAMETERS},
        {*CROWDED},
    )
