"""The methods by name, each as the naming benchmark runs it."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from hydro_env.experiments.naming_benchmark.calibrated import answer_beside, begin, name_beside
from hydro_env.experiments.naming_benchmark.methods import Method, asking
from hydro_env.files import write_text
from hydro_env.practice.recorder import log_text

from .by_terms import by_certification, by_regression
from .correction import Array, Model, fit_network, fit_polynomial, predicted
from .designs import at_random, d_optimal


def _correcting(fit: Callable[[Array, Array], Model], folder: Path, out: Path) -> dict[str, Any]:
    """Adds a black box to the calibrated model and names nothing."""
    start = begin(folder)
    clock = time.process_time()
    write_text(out / f"{folder.name}.csv", log_text(predicted(folder, start.model, fit)))
    return answer_beside(start, clock, folder.name, [], prediction=f"{folder.name}.csv")


METHODS: dict[str, Method] = {
    "sindy": partial(name_beside, by_regression),
    "polynomial": partial(_correcting, fit_polynomial),
    "certify": partial(name_beside, by_certification),
    "network": partial(_correcting, fit_network),
    "ask_random": partial(asking, at_random),
    "ask_d_optimal": partial(asking, d_optimal),
}
#: Methods that need PySINDy.
SPARSE = ("sindy", "polynomial")
