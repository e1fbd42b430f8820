"""The command `hydro-env hide EFFECT[:CHANNEL] ... --out DIR`."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..errors import InputError
from ..plant import CATALOGUE
from .generate import Practice, make_practice
from .hidden import parse_values


def run(
    effects: Sequence[str], out: Path, *, none: bool = False, model: str = "paper", values: Sequence[str] = (),
    base_error_percent: float = 0.0, **settings: Any,
) -> Practice:  # fmt: skip
    """Writes fit_1.csv, fit_2.csv, sealed.csv (or played.csv, with `play`), model.yaml and truth.json to `out`.

    `values` are words "effect.parameter=value"; `none` (--none) hides nothing and must be given when no effect is named;
    `settings` as in `PracticeSettings`.
    """
    if none and effects:
        raise InputError(f"--none hides nothing, yet {effects[0]!r} is named; leave one of them out")
    if not none and not effects:
        raise InputError(f"name an effect to hide, or --none; effects are {', '.join(CATALOGUE)}")
    base_error = base_error_percent / 100.0
    practice = make_practice(
        effects, model=model, values=parse_values(values), base_error=base_error, progress=True, **settings
    )
    practice.write(Path(out))
    return practice
