"""A controller of one rig as a program: its own `act` is run on symbols, and what it keeps between samples becomes the state.

A copy of the controller is traced, of classes from copies of their modules (`copies`). There NumPy is a stand-in whose new arrays
hold expressions, and compiled functions are recorded instead of run. The first sample is traced by itself, since a controller
sets its state from it; then samples are traced until the same program comes out again.
"""

import copy
import inspect
import sys
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hydro_env.controllers.base import Gain
from hydro_env.envs.observation import LIMIT, OBSERVATION, scales_on
from hydro_env.ir.reader import Reader
from hydro_env.plant import PAPER, Scales

from .copies import Copies
from .schedule import kernel_call
from .symbols import (
    Expr,
    Items,
    Kernel,
    MaskedRows,
    RowNumbers,
    Symbols,
    TraceError,
    cast,
    each_once,
    interned,
    item,
    known,
    leaf,
    symbols,
)  # fmt: skip

#: What a controller is given, in this order, SI: rad/s, A, Pa; commands as fractions of the rated one.
MEASURED = OBSERVATION
#: Samples after which what is kept has taken its form, or never will.
MAX_SAMPLES = 50
#: What the names of gains begin with that are inputs of a program.
GAIN = "Gain_"
#: What the names of modules begin with that controllers are made of.
_TRACED = ("hydro_env.controllers.", "hydro_env.envs.observation")


@dataclass
class Program:
    """What a controller does with a sample: at the first one, and at all others.

    `state`: the arrays that are kept between samples, by name with their kind and size.
    `first` and `next` map (array, index) of the state, and ("command", 0 or 1), to expressions of the measurements
    ("measured", n), of the `gains` that are inputs (`GAIN` and the name, n), and of the state before. Elements of the state that
    are not in `next` keep their value. `names`: what the controller's own variables are called, and which element of them it is.
    """

    name: str
    period: float
    gains: list[tuple[Gain, list[float]]] = field(default_factory=list)
    names: dict[Expr, tuple[str, int]] = field(default_factory=dict)
    state: dict[str, tuple[str, int]] = field(default_factory=dict)
    first: dict[tuple[str, int], Expr] = field(default_factory=dict)
    next: dict[tuple[str, int], Expr] = field(default_factory=dict)

    def expressions(self) -> list[Expr]:
        return [*self.first.values(), *self.next.values()]


#: What makes new arrays.
_FILLED = ("zeros", "empty", "ones", "full")


# --- the stand-in for NumPy -------------------------------------------------------------------------------------------
class _Numpy:
    """NumPy for traced modules: new arrays hold expressions, and symbols stay symbols where NumPy would make numbers."""

    def __getattr__(self, name: str) -> Any:
        own = getattr(np, "zeros" if name == "empty" else name)
        return (lambda *shape, **more: known(own(*shape, **more))) if name in _FILLED else own

    @staticmethod
    def asarray(value: Any, dtype: Any = None) -> Any:
        if isinstance(value, list | tuple) and any(isinstance(each, Symbols) for each in value):
            value = np.stack(value)  # type: ignore[arg-type]
        if isinstance(value, Symbols):
            return value if dtype is None else value.astype(dtype)
        return np.asarray(value, dtype)

    ascontiguousarray = asarray

    @classmethod
    def array(cls, value: Any, dtype: Any = None) -> Any:
        return cls.asarray(value, dtype).copy()

    @staticmethod
    def arange(*bounds: Any) -> Any:
        return np.arange(*bounds).view(RowNumbers)


class _Recorder:
    """A compiled function of a traced module: with symbols among its arguments it is recorded, else run."""

    def __init__(self, function: Any, reader: Reader) -> None:
        self._function, self._reader = function, reader
        self.py_func = function.py_func

    def __call__(self, *arguments: Any) -> None:
        parts = [part for each in arguments for part in _parts(each)]
        if not parts:
            return self._function(*arguments)
        arrays = list({id(part): part for part in parts if isinstance(part, Symbols) and part.ndim}.values())
        numbers = [
            part.mask if isinstance(part, MaskedRows) else part.view(np.ndarray).item()
            for part in parts
            if isinstance(part, MaskedRows) or not part.ndim
        ]
        before = [array.elements() for array in arrays]
        call = Kernel(self._function, arguments, arrays, before, numbers)
        for place in kernel_call(call, self._reader)[2]:
            array = arrays[place]
            after = call.after[place] = Items(call, array.kind)
            made = symbols((item(after, n) for n in range(array.size)), array.shape)
            array.view(np.ndarray)[...] = made.view(np.ndarray)


def _parts(value: Any) -> Iterator[Symbols | MaskedRows]:
    """What is not known beforehand of an argument."""
    if isinstance(value, tuple):
        for each in value:
            yield from _parts(each)
    elif isinstance(value, Symbols | MaskedRows):
        yield value


def _copies(own: set[str]) -> Copies:
    """Copies of controllers' modules, and of those named in `own`, in which numbers may be symbols."""
    reader = Reader()
    recorders: dict[Any, _Recorder] = {}

    def private(name: str) -> bool:
        return name.startswith(_TRACED) or name in own

    def changed(value: Any, original: Any) -> Any:
        if hasattr(value, "py_func") and hasattr(value, "signatures"):
            return recorders.setdefault(original, _Recorder(original, reader))
        return known(value) if type(value) is np.ndarray and value.dtype.kind in "bif" else value

    return Copies(private, _Numpy(), changed)


# --- the state ---------------------------------------------------------------------------------------------------------
def _leaves(value: Any, path: str, seen: set[int]) -> Iterator[tuple[str, Any]]:
    """All arrays of expressions, and all plain values, below an object, with their path."""
    if isinstance(value, np.ndarray | np.generic | str | int | float | bool | type(None)):
        yield path, value
        return
    if id(value) in seen or isinstance(value, type) or (callable(value) and not hasattr(value, "__dict__")):
        return
    seen.add(id(value))
    inner: Iterable[tuple[Any, Any]] = getattr(value, "__dict__", {}).items()
    if isinstance(value, dict):
        inner = value.items()
    elif isinstance(value, list | tuple):
        inner = zip(getattr(value, "_fields", range(len(value))), value, strict=True)
    for key, each in inner:
        yield from _leaves(each, f"{path}.{key}", seen)


def _arrays(controller: Any) -> tuple[dict[str, Symbols], dict[str, Any]]:
    """The arrays of expressions of a controller by path, and its plain values."""
    found = dict(_leaves(controller, "", set()))
    arrays = {path: each for path, each in found.items() if isinstance(each, Symbols)}
    plain = {path: each for path, each in found.items() if not isinstance(each, Symbols | np.ndarray)}
    return arrays, plain


def _observation(rig: Scales) -> Any:
    """The scaled observation, as the environment of a rig of this size makes it of what is measured."""
    measured = symbols((leaf("measured", n, "double") for n in range(len(MEASURED))), (1, len(MEASURED)))
    return np.clip(measured / scales_on(rig), -LIMIT, LIMIT).astype(np.float32)


def _sample(controller: Any, rig: Scales) -> Any:
    """What the controller does with a sample, without the guard around it, which each language has for itself."""
    return inspect.unwrap(type(controller).act)(controller, _observation(rig))


def _commands(sent: Any) -> dict[tuple[str, int], Expr]:
    """What is sent to both valves, in the place of the program's assignments."""
    plain = (sent if isinstance(sent, Symbols) else known(sent)).elements()
    return {("command", channel): cast(plain[channel], "double") for channel in (0, 1)}


def trace(
    controller: Any, period: float, name: str, rig: Scales = PAPER, readable: bool = False, gains: bool = False
) -> Program:  # fmt: skip
    """The program of a controller at a control period in s on a rig of this size; a `readable` one has names, and with `gains`
    those that are in use are inputs. TraceError, in one line, for what cannot be followed."""
    program = Program(name, period)
    own = {kind.__module__ for kind in type(controller).__mro__} - {"builtins"}
    with interned(), _named(program.names, own) if readable else nullcontext():
        controller = _copies(own).of(controller)
        controller.reset(1, period)
        if gains and isinstance(getattr(controller, "gains", None), dict):
            program.gains = _gains_as_inputs(controller)
        program.first = _commands(_sample(controller, rig))
        settled = _settled(controller, rig)
        if _arrays(controller)[0].keys() != _arrays(settled)[0].keys():
            raise TraceError("what it keeps between samples changes its form after the first one")
        named = _paths_by_name(settled)
        kept = _kept_by(controller, named)
        changing = {key for key, each in kept.items() if each.op != "const" and not _of_gains_only(each)}
        while True:
            again = copy.deepcopy(settled)
            _as_state(again, named, {key: each for key, each in kept.items() if key not in changing})
            program.next = _commands(_sample(again, rig))
            after = _kept_by(again, named)
            more = {key for key, each in after.items() if key not in changing and each is not kept[key]}
            if not more:
                break
            changing |= more
        _check_settled(again, rig)
    _fill(program, kept, after, changing)
    return program


@contextmanager
def _named(names: dict[Expr, tuple[str, int]], own: set[str]) -> Iterator[None]:
    """Inside, what local variables of traced functions hold when these end gets their names, unless it has one."""

    def seen(frame: Any, event: str, _: Any) -> None:
        module, function = frame.f_globals.get("__name__", ""), frame.f_code.co_name
        traced = module.startswith(_TRACED) or module in own
        if event == "return" and traced and function[0] != "<":  # a comprehension's variables say little
            for name, value in frame.f_locals.items():
                for n, each in enumerate(value.elements() if isinstance(value, Symbols) else ()):
                    names.setdefault(each, (name, n if value.size > 1 else -1))

    before = sys.getprofile()
    sys.setprofile(seen)
    try:
        yield
    finally:
        sys.setprofile(before)


def _gains_as_inputs(controller: Any) -> list[tuple[Gain, list[float]]]:
    """Puts leaves in the place of the gains that are in use, one or one for each channel; these gains with their values."""
    given, made = dict(controller.gains_given()), []
    for gain in controller.GAINS:
        values = np.asarray(given[gain.name])
        if np.any(values != gain.default) and values.size <= 2:
            leaves = [leaf(GAIN + gain.name, n, "double") for n in range(values.size)]
            given[gain.name] = symbols(leaves, values.shape)
            made.append((gain, values.reshape(-1).tolist()))
    controller.gains = controller.converted(given)
    return made


def measured_by(program: Program) -> set[int]:
    """Which measurements a program reads."""
    return {n for name, n in _leaves_of(program.expressions()) if name == "measured"}


def divisors(program: Program) -> set[tuple[str, int]]:
    """The leaves that something is divided by."""
    nodes = each_once(program.expressions())
    return _leaves_of(node.args[1] for node in nodes if isinstance(node, Expr) and node.op == "div")


def _of_gains_only(x: Expr) -> bool:
    return {name[: len(GAIN)] for name, _ in _leaves_of([x])} == {GAIN}


def _settled(controller: Any, rig: Scales) -> Any:
    """The controller some samples later, when the same arrays are the same objects from sample to sample: at the beginning a
    history may hold one array several times."""
    before: dict[str, list[str]] = {}
    for _ in range(MAX_SAMPLES):
        controller = copy.deepcopy(controller)
        _as_state(controller, _paths_by_name(controller), {})
        _sample(controller, rig)
        now = _paths_by_name(controller)
        if now == before:
            return controller
        before = now
    raise TraceError(f"what it keeps between samples has not settled after {MAX_SAMPLES} samples")


def _c_name(path: str) -> str:
    words = [word.strip("_").removeprefix("Controller__") for word in path.split(".") if word]
    words = [word.split("__")[-1] for word in words]
    return "_".join(word for word in words if word not in ("law", "state")) or "state"


def _paths_by_name(controller: Any) -> dict[str, list[str]]:
    """The paths that lead to each array of expressions, by the name that it gets."""
    groups: dict[int, list[str]] = {}
    for path, array in _arrays(controller)[0].items():
        groups.setdefault(id(array), []).append(path)
    found: dict[str, list[str]] = {}
    for paths in groups.values():
        name = _c_name(paths[0])
        while name in ("measured", "command", *found):  # the first two are inputs and outputs
            name += "2"
        found[name] = paths
    return found


def _kept_by(controller: Any, named: dict[str, list[str]]) -> dict[tuple[str, int], Expr]:
    """What the arrays hold, by their name and the place in them. TraceError where a name stands for several arrays."""
    held = {path: array.elements() for path, array in _arrays(controller)[0].items()}
    for first, *others in named.values():
        for other in others:
            if held[other] != held[first]:
                both = f"{other.strip('.')} and {first.strip('.')}"
                raise TraceError(f"{both} are the same array in some samples only")
    return {(name, n): each for name, paths in named.items() for n, each in enumerate(held[paths[0]])}


def _as_state(controller: Any, named: dict[str, list[str]], fixed: dict[tuple[str, int], Expr]) -> None:
    """Puts leaves in the place of what changes, and what is `fixed` in its own."""
    arrays, _ = _arrays(controller)
    for name, paths in named.items():
        plain: Any = arrays[paths[0]].view(np.ndarray)
        for n, place in enumerate(np.ndindex(plain.shape)):
            here = name, n
            plain[place] = fixed[here] if here in fixed else leaf(name, n, plain[place].kind)


def _check_settled(controller: Any, rig: Scales) -> None:
    """A third sample has to change no plain value, or the program would be another one with time."""
    _, before = _arrays(controller)
    again = copy.deepcopy(controller)
    _sample(again, rig)
    _, after = _arrays(again)
    for path, value in after.items():
        if path not in before or (before[path] != value and before[path] == before[path]):
            raise TraceError(f"{path.strip('.')} is a plain Python value that changes from sample to sample")


def _leaves_of(roots: Iterable[Expr]) -> set[tuple[str, int]]:
    """Measurements, gains and elements of the state that expressions read."""
    return {node.value for node in each_once(roots) if isinstance(node, Expr) and node.op == "leaf"}


def _fill(
    program: Program, kept: dict[tuple[str, int], Expr], after: dict[tuple[str, int], Expr],
    changing: set[tuple[str, int]],
) -> None:  # fmt: skip
    """State and assignments of the program, without what no command depends on."""
    needed: set[tuple[str, int]] = set()
    found = _leaves_of(program.next.values()) & changing
    while found - needed:
        needed |= found
        found = _leaves_of(after[key] for key in needed) & changing
    sizes = Counter(name for name, _ in kept)
    for (name, n), first in kept.items():
        if (name, n) in needed:
            program.state[name] = first.kind, sizes[name]
            program.first[name, n] = first
            if not (after[name, n].op == "leaf" and after[name, n].value == (name, n)):
                program.next[name, n] = after[name, n]
