"""The leaderboard as a table for the terminal and as one page of HTML that needs no network.

The page carries its data as JSON and draws with a few lines of JavaScript into SVG: a table that sorts, the
Pareto front (synchronisation error over tracking error) and the typical and the worst case behind every row.
"""

from importlib.resources import files
from typing import Any

from hydro_env import __version__
from hydro_env.benchmark.cells import SCORE, SCORED
from hydro_env.benchmark.suite import PEAK
from hydro_env.pages import fill

#: Privileged information: what a controller has beyond the measurements on the rig, by its attribute `needs`.
NEEDS = {
    "measurements": "",
    "bench": "valve bench",
    "parameters": "true valve parameters",
    "everything": "true parameters, state, future loads",
}


def scores_table(scores: dict[str, Any]) -> str:
    """One block per split and scenario, one line per controller, one column per metric: interquartile
    means.
    """
    columns = [*_columns(scores), BETTER]
    texts = _texts(scores)
    idle = {_place(each) for each in scores["idle"]}
    failed = {_place(each): each["reason"] for each in scores["failed"]}
    cases: dict[tuple[str, ...], int] = {}
    for each in (*scores["rows"], *scores["failed"]):
        cases.setdefault(_place(each)[:2], each.get("n", 0))
    width = max(len(name + IDLE) for name in scores["controllers"])
    lines = []
    for block, n in cases.items():
        places = [(*block, name) for name in scores["controllers"]]
        rows = {place: [texts.get((*place, what), "-") for what in columns] for place in places}
        heads = [_short(metric) for metric in columns]
        ran = (row for place, row in rows.items() if place not in failed)
        wide = [2 + max(map(len, column)) for column in zip(heads, *ran, strict=True)]
        lines.append(f"\n{' / '.join(block)}, {n} cases: interquartile mean and its 95 % interval")
        lines.append("  " + "controller".ljust(width) + _row(heads, wide))
        for place in sorted(places, key=idle.__contains__):
            row = f"  failed: {failed[place]}" if place in failed else _row(rows[place], wide)
            lines.append("  " + (place[-1] + IDLE * (place in idle)).ljust(width) + row)
    lines += _overall(scores, width)
    return "\n".join(lines).lstrip("\n")


def _overall(scores: dict[str, Any], width: int) -> list[str]:
    """The score over the whole suite, the best first; who was idle anywhere comes last."""
    idle = {each["controller"] for each in scores["idle"]}
    rows = [row for row in scores["overall"] if row["metric"] == SCORE.name]
    rows.sort(key=lambda row: (row["controller"] in idle, -row["iqm"]))
    lines = ["\nthe whole suite: normalised score, its 95 % interval, and its worst 5 %"] if rows else []
    for row in rows:
        name = row["controller"] + IDLE * (row["controller"] in idle)
        lines.append(f"  {name.ljust(width)}  {_cell(row)}  {row['cvar95']:.3g}")
    return lines


def _columns(scores: dict[str, Any]) -> list[str]:
    """The metrics of the rows without those that are another one under a second name."""
    names = dict.fromkeys(row["metric"] for row in scores["rows"])
    first = {(SCORED[name].of, SCORED[name].more and name): name for name in reversed(names)}
    return list(first.values())[::-1]


#: Of the peak synchronisation error: the probability of improvement.
BETTER = "better"
#: Beside the name of a controller that hardly moves the motors.
IDLE = " (idle)"
SETTLING = "sync_settling_time_s"


def _place(entry: dict[str, Any]) -> tuple[str, str, str]:
    return entry["split"], entry["scenario"], entry["controller"]


def _texts(scores: dict[str, Any]) -> dict[tuple[str, ...], str]:
    """What stands in the table, by split, scenario, controller and column."""
    texts: dict[tuple[str, ...], str] = {(*_place(row), row["metric"]): _cell(row) for row in scores["rows"]}
    for entry in scores["improvement"]:
        if entry["metric"] == PEAK:
            texts[*_place(entry), BETTER] = f"{entry['probability']:.0%}"
    for entry in scores["never_settled"]:
        # Where no case settled, the number would be the length of the episode.
        if entry["cases"] == scores["splits"][entry["split"]]:
            texts[*_place(entry), SETTLING] = "never settled"
    return texts


def _row(texts: list[str], widths: list[int]) -> str:
    return "".join(text.rjust(width) for text, width in zip(texts, widths, strict=True))


def _short(metric: str) -> str:
    """`max_speed_difference_rpm` as `peak sync error, rpm`, so that a line fits a terminal."""
    for long, short in (
        ("max_speed_difference_", "peak sync error_"),
        ("_speed_difference_", " diff_"),
        ("shaft_angle_difference_", "shaft angle_"),
        ("travel_per_s", "travel, 1/s"),
        ("reversals_per_s", "reversals, 1/s"),
    ):
        metric = metric.replace(long, short)
    head, _, unit = metric.rpartition("_")
    return f"{head.replace('_', ' ')}, {unit}" if unit in ("rpm", "s", "deg") else metric.replace("_", " ")


def _cell(row: dict[str, Any]) -> str:
    return f"{row['iqm']:.3g} [{row['ci95'][0]:.3g}, {row['ci95'][1]:.3g}]"


def privileged_information(scores: dict[str, Any], name: str) -> str:
    """The privileged information of a controller in a few words; without it scores cannot be compared."""
    needs, plant = scores["needs"][name], scores["own_plant"].get(name)
    return ", ".join(filter(None, [NEEDS.get(needs, needs), plant and f"on {plant} valves"]))


def scores_page(scores: dict[str, Any], traces: dict[str, Any] | None) -> str:
    """The HTML page. `traces`: {"period_s", "limit_rpm", "metric", "splits": {split: {scenario: {controller: {"typical": case,
    "worst": case}}}}}, each case as `hydro_env.benchmark.command` thins it."""
    privileged = {name: privileged_information(scores, name) for name in scores["controllers"]}
    metrics = {
        name: {
            "title": ", ".join(filter(None, (each.title, each.unit))),
            "definition": each.definition,
            "more": each.more,
        }
        for name, each in SCORED.items()
    }
    page = files("hydro_env.benchmark").joinpath("scores_page.html")
    more = {
        "privileged": privileged, "metrics": metrics, "version": __version__, "settling": SETTLING, "columns": _columns(scores),
    }  # fmt: skip
    return fill(page, SCORES={**scores, **more}, TRACES=traces)
