"""The rig in C99: the sweeps of the kernel, statement by statement, in the driver's loop for one rig.

`plant.c` holds what the kernel for one rig computes, to the last bit, and around it a structure of fixed size and five functions
(`plant.h`). Nothing is allocated, and nothing but math.h is needed, so the same text serves an FMU, a controller's own model, or
a web page.
"""

from dataclasses import dataclass

from hydro_env.ir.nodes import Expr, const, var
from hydro_env.ir.reader import Arr, Reader, module_sources
from hydro_env.plant import PARAMETERS, Plant, PlantModel
from hydro_env.plant.catalogue import CATALOGUE
from hydro_env.plant.catalogue.effect import parameter_of
from hydro_env.plant.kernel import Kernel
from hydro_env.plant.kernel.driver import MAX_ATTEMPTS, MAX_ATTEMPTS_PER_S, SWEEPS
from hydro_env.plant.validation import accepted
from hydro_env.units import RPM

from .c_printer import RESERVED, listed, literal, source
from .c_printer import expression as c_expression
from .templates import template

#: Signals of a channel beside the states, which are outputs too.
_OUTPUTS = ("flow", "measured_speed", "diverged")
#: Rows that the loop over steps knows, by their names among the driver's numbers.
_PLACES = ("moving", "command", "load", "applied", "todo", "row_left", "fresh", "delay", "coupled")

#: Commands that the line of a delay holds, at least, and for each second of its longest delay.
_MIN_SENT, _SENT_PER_S = 500, 1000.0


@dataclass(frozen=True)
class PlantSource:
    """`header` and `body` are plant.h and plant.c. `places` numbers the cell of channel 1 of every signal and parameter;
    channel 2 is the next one. `outputs` names the signals, `parameters` has the range of each parameter, `shared` those that
    belong to the rig as a whole. `max_sent`: how many commands can be under way, 0 without a delay."""

    model: PlantModel
    header: str
    body: str
    places: dict[str, int]
    outputs: tuple[str, ...]
    parameters: dict[str, tuple[float, float]]
    shared: frozenset[str]
    max_sent: int


def plant_source(model: PlantModel, version: str) -> PlantSource:
    """The source of a rig with the effects of a model, at its values."""
    plant = Plant(model)
    model, kernel = plant.model, plant.kernel
    reader = Reader(reserved=RESERVED, fuses=True)
    reader.reserve("exp", "tanh", "cos", "sin", "enter", "leave", "send", "arrive")
    own = [f"{e}.{p.name}" for e in model.declared for p in CATALOGUE[e].parameters]
    shared = {name for name in own if CATALOGUE[name.split(".")[0]].scope == "rig"}
    ranges = {name: parameter_of(name).possible for name in (*PARAMETERS, *own)}
    ranges |= dict.fromkeys(plant.delays, (0.0, plant.longest_delay))  # no longer than the line
    by_row = {kernel.rows[name]: _accepted(name, ends, name in shared) for name, ends in ranges.items()}
    sent = max(_MIN_SENT, int(_SENT_PER_S * plant.longest_delay) + 3) if kernel.has_delay else 0
    known = {name.upper(): str(2 * kernel.numbers[name]) for name in _PLACES if kernel.numbers[name] >= 0}
    known |= {name.upper(): call for name, call in _sweeps(reader, kernel, plant.tolerance).items()}
    known["ARE_COUPLED"] = "(room[COUPLED] + room[COUPLED + 1] > 0.0)" if "COUPLED" in known else "(0)"
    limits = {
        "MAX_DELAY": plant.longest_delay,
        "MAX_ATTEMPTS": MAX_ATTEMPTS,
        "MAX_ATTEMPTS_PER_S": MAX_ATTEMPTS_PER_S,
    }
    known |= {name: literal(limit, "double") for name, limit in limits.items()}
    header = template("plant.h").substitute(
        name=model.name.replace("*/", "* /"), version=version, effects=", ".join(model.declared) or "none",
        kept=2 * kernel.num_rows, total=kernel.num_cells, rpm=f"{plant.tolerance / RPM:g}", sent=sent,
    )  # fmt: skip
    body = template("plant.c").substitute(
        initial=listed(literal(x, "double") for x in plant.memory.reshape(-1).tolist()),
        settable=",\n    ".join(by_row.get(n, "{0, 0, 0, 0}") for n in range(kernel.num_rows)),
        known="\n".join(f"#define {name} {value}" for name, value in known.items()),
    )
    return PlantSource(
        model=model, header=header, body='#include "plant.h"\n' + source(reader, body),
        places={name: 2 * row for name, row in kernel.rows.items()},
        outputs=(*(name for name, row in kernel.rows.items() if row < kernel.rows["time"]), *_OUTPUTS),
        parameters=ranges, shared=frozenset(shared), max_sent=sent,
    )  # fmt: skip


def _sweeps(reader: Reader, kernel: Kernel, tolerance: float) -> dict[str, str]:
    """The call in C of each sweep of a kernel for one rig; an export shows no peak between its steps."""
    sources, calls = module_sources(kernel.source), {}
    for name in (name for name in SWEEPS if name != "pass_point"):
        given = const(tolerance, "double") if name == "precompute" else var("period", "double")
        called = reader.call(sources[name], [Arr.of("double", "p->room", (kernel.num_cells,)), given])
        calls[name] = c_expression(Expr("call", "int", tuple(called.handed), called.name))
    return calls


def _accepted(name: str, ends: tuple[float, float], shared: bool) -> str:
    """A row of the table `settable`."""
    numbers = ", ".join(literal(x, "double") for x in (parameter_of(name).neutral, *accepted(ends)))
    return f"{{{1 + shared}, {numbers}}}"
