"""How often the diagnosis is right: blind trials on practice logs of the independent simulator, and what each rule is worth.

    python -m docs.evidence.blind_trials --out DIR [--groups medium two ...] [--seed N] [--minutes M] [--slice K/N]
        [--jobs N] [--empty N] [--only SEED FIRST-LAST ...]
    python -m docs.evidence.blind_trials --out DIR --write docs/evidence   # publishes what is in DIR, no new trial
    python -m docs.evidence.blind_trials --out DIR --logs LOGS --make      # practice logs for later trials only
    python -m docs.evidence.blind_trials --out DIR --without-rule NAME     # the same trials without a rule
    python -m docs.evidence.blind_trials --out DIR --ablation              # table: what is worse or better without it

A trial hides effects in a rig whose base parameters are up to 15 % off the given model's, each channel alone, with noise and
quantisation. The rig is `practice.reference` with the "different" forms: SciPy's stiff solver, no line of physics in common
with what is fitted, and every effect in another shape than the catalogue's where one exists. Sizes, forms and manoeuvres are
drawn again for every seed. Groups of trials:

    nothing     nothing hidden and the model right
    parameters  nothing hidden, only parameters wrong
    medium      every effect at medium severity on one channel (alternately 1 and 2)
    small, large  the same at small and large severity
    two         two effects at once
    unlisted    every effect hidden at medium severity and taken out of the candidates
    speed_only, current_too   every effect, only command and speed (and current) in the log, no load applied
    quiet, noisy  every effect with a tenth of the noise and ten times the noise
    no_twins    every effect that the catalogue declares not to be told from others, these taken out of the candidates too

Trials that DIR holds already are not run again, so a run may be interrupted and continued. Slices write files of their own
(trials_K_of_N.json) and may run side by side. Each row says by a hash of the sources which method it ran on, how much the
*true* values in the catalogue's form leave on the held-out log (`form`: less than that no naming of effects can reach), and how
far the hidden effects move the signals (`strength`).

cases     what is hidden, and the frozen seeds
judging   a diagnosis against the truth: names, false alarms, gap, coverage of the intervals
running   makes the logs, runs what is missing, keeps the rows
tables    counts as text
ablation  trials with a rule switched off beside the same trials with it
"""

from .ablation import ablation, ablation_table
from .cases import GROUPS, Case, cases, commands
from .judging import CRITERIA, judge, summary
from .running import method, practice_logs, rows_of, run_case, run_trials
from .tables import publish, table

__all__ = [
    "CRITERIA",
    "GROUPS",
    "Case",
    "ablation",
    "ablation_table",
    "cases",
    "commands",
    "judge",
    "method",
    "practice_logs",
    "publish",
    "rows_of",
    "run_case",
    "run_trials",
    "summary",
    "table",
]
