"""A traced controller as C99: one header, one source, a state of fixed size, nothing allocated."""

from hydro_env import __version__
from hydro_env.controllers.input_guard import HOLD, MAX_VALUE, held_samples
from hydro_env.ir.nodes import without_unread
from hydro_env.ir.reader import Reader

from .c_printer import RESERVED, TYPES, identifier, source, statements, variables
from .schedule import Schedule
from .templates import template
from .tracing import MEASURED, Program


def c_code(program: Program, about: str) -> dict[str, str]:
    """The texts of NAME.h and NAME.c for a program, by file. `about`: a sentence on the controller."""
    name = identifier(program.name)
    reader = Reader(reserved=RESERVED)
    bodies = []
    for which, assignments in (("first", program.first), ("next", program.next)):
        schedule = Schedule(assignments, reader, "s->")
        changing = {made.name for made in reader.functions.values() if made.written}
        body, declared = without_unread(schedule.body, schedule.variables, changing)
        lines = [*variables(declared), "(void)measured;", *statements(body)]
        head = f"static void {which}_sample({name}_state *s, const double *measured, double *command) {{"
        bodies.append("\n".join([head, *("    " + line for line in lines), "}", ""]))
    state = "".join(f"    {TYPES[kind]} {each}[{size}];\n" for each, (kind, size) in program.state.items())
    header, step = (
        template(file).substitute(
            name=name, guard=name.upper(), period=repr(program.period), about=about, version=__version__, measured=len(MEASURED),
            hold=f"{HOLD:g}", samples=held_samples(program.period), state=state, most=MAX_VALUE,
        )
        for file in ("controller.h", "controller.c")
    )  # fmt: skip
    return {f"{name}.h": header, f"{name}.c": f'#include "{name}.h"\n' + source(reader, *bodies, step)}
