"""The command `hydro-env diagnose`.

hydro-env diagnose FIT_LOG... --sealed LOG... [--model PRESET_OR_YAML] [--mapping YAML] [--jobs N] [--seed N] --out DIR
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..diagnosis import Diagnosis, diagnose
from ..diagnosis.stages.next_experiment import FILE as NEXT_EXPERIMENT
from ..files import write_json, write_text
from ..pages import beside_results


def run(
    fit_logs: Sequence[str | Path], sealed: Sequence[str | Path], out: str | Path, *, jobs: int | None = None,
    quiet: bool = False, summary: bool = True, **options: Any,
) -> Diagnosis:  # fmt: skip
    """Diagnoses with a progress bar, prints a `summary` of about twenty lines, and writes diagnosis.json, report.html and
    model.yaml to `out`.

    `jobs` threads (None: one for every core that this process may use), `quiet`: prints nothing, other options as in `diagnose`.
    """
    from loky import cpu_count
    from tqdm import tqdm

    with tqdm(unit=" simulations", disable=quiet or None, leave=False) as bar:

        def progress(text: str, simulations: int) -> None:
            if simulations:
                bar.update(simulations)
            else:
                bar.set_description(text)

        found = diagnose(fit_logs, sealed, jobs=jobs or cpu_count(), progress=progress, **options)
        bar.set_description("writing the report")
        write(found, Path(out))
    if summary and not quiet:
        with beside_results(Path("the summary")):
            print(found.summary())
    return found


def write(found: Diagnosis, folder: Path) -> None:
    """Writes diagnosis.json, model.yaml, where names are open next_experiment.csv, and report.html to a folder, which is made if
    needed. A page that fails costs only the page."""
    folder.mkdir(parents=True, exist_ok=True)
    write_json(folder / "diagnosis.json", found.as_dict())
    if found.next_experiment and (commands := found.next_experiment.csv()):
        write_text(folder / NEXT_EXPERIMENT, commands)
    found.model.to_yaml(folder / "model.yaml", source="diagnosis of logs")
    with beside_results(folder / "report.html"):
        found.report(folder / "report.html")
