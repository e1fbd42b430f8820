"""The methods by name, each as the naming benchmark runs it; all but those that ask begin with the calibrated model of a rig."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

from hydro_env.experiments.naming_benchmark.answers import answer
from hydro_env.experiments.naming_benchmark.methods import Method, Start, asking, begin
from hydro_env.files import write_text
from hydro_env.practice.recorder import log_text

from .by_terms import Named, by_certification, by_regression
from .correction import Array, Model, fit_network, fit_polynomial, predicted
from .designs import at_random, d_optimal

#: The calibrated model of the last rig is kept, with the processor time that it took.
_begun = lru_cache(maxsize=1)(begin)


def _answer(start: Start, clock: float, rig: str, named: Named, **file: str) -> dict[str, Any]:
    """The answer of a method that began with `start` and went on at the processor time `clock`."""
    seconds = start.seconds + time.process_time() - clock
    return answer(rig, "effects" if named else start.verdict, named, seconds, **file)


def _naming(name_them: Callable[[Start], Named], folder: Path, out: Path) -> dict[str, Any]:
    """Asks for names where the calibrated model is not enough; the answer takes the held-out error of that model."""
    start = _begun(folder)
    clock = time.process_time()
    named = name_them(start) if start.verdict == "unknown" else []
    start.model.to_yaml(out / f"{folder.name}.yaml", source="calibration")
    return _answer(start, clock, folder.name, named, model=f"{folder.name}.yaml")


def _correcting(fit: Callable[[Array, Array], Model], folder: Path, out: Path) -> dict[str, Any]:
    """Adds a black box to the calibrated model and names nothing."""
    start = _begun(folder)
    clock = time.process_time()
    write_text(out / f"{folder.name}.csv", log_text(predicted(folder, start.model, fit)))
    return _answer(start, clock, folder.name, [], prediction=f"{folder.name}.csv")


METHODS: dict[str, Method] = {
    "sindy": partial(_naming, by_regression),
    "polynomial": partial(_correcting, fit_polynomial),
    "certify": partial(_naming, by_certification),
    "network": partial(_correcting, fit_network),
    "ask_random": partial(asking, at_random),
    "ask_d_optimal": partial(asking, d_optimal),
}
#: Methods that need PySINDy.
SPARSE = ("sindy", "polynomial")
