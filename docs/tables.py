"""Writes the tables of docs/plant.md and docs/effects.md from the code: `python docs/tables.py`.

A table stands between `<!-- table: NAME -->` and `<!-- end -->` and is never edited by hand.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path

from hydro_env.plant import CATALOGUE, PARAMETERS, load_model, preset_names

HERE = Path(__file__).parent


def _number(value: float) -> str:
    return "none" if math.isinf(value) else f"{value:.4g}"


def _table(head: list[str], rows: list[list[str]]) -> str:
    lines = ["| " + " | ".join(row) + " |" for row in [head, ["---"] * len(head), *rows]]
    return "\n".join(lines)


def parameters() -> str:
    rows = [
        [
            f"`{p.name}`",
            p.note or "",
            _number(p.nominal),
            p.unit,
            f"{_number(p.low)} to {_number(p.high)}",
            p.source,
        ]
        for p in PARAMETERS.values()
    ]
    return _table(["symbol", "meaning, reading", "nominal", "unit", "plausible range", "source"], rows)


def presets() -> str:
    rows = []
    for name in preset_names():
        model = load_model(name)
        rows.append([f"`{name}`", ", ".join(f"`{effect}`" for effect in model.effects) or "none"])
    return _table(["preset", "effects beyond the paper's equations"], rows)


def effects() -> str:
    rows = []
    for effect in CATALOGUE.values():
        sizes = [
            f"`{p.name}` {_number(p.low)} to {_number(p.high)} {p.unit if p.unit != '1' else ''}".strip()
            for p in effect.parameters
        ]
        scope = "rig" if effect.scope == "rig" else effect.port
        rows.append(
            [f"`{effect.name}`", scope, effect.summary, effect.signature, "; ".join(sizes), effect.source]
        )
    return _table(["effect", "port", "what it is", "how it shows", "parameters", "source"], rows)


TABLES: dict[str, Callable[[], str]] = {"parameters": parameters, "presets": presets, "effects": effects}


def filled(text: str) -> str:
    """The text with every table made anew."""

    def fill(match: re.Match[str]) -> str:
        return f"{match[1]}\n{TABLES[match[2]]()}\n<!-- end -->"

    return re.sub(r"(<!-- table: (\w+) -->)\n.*?<!-- end -->", fill, text, flags=re.S)


def main() -> None:
    for path in sorted(HERE.glob("*.md")):
        path.write_text(filled(path.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
