"""Where nothing seems to be missing: effects that the logs would not show, and an experiment that would show them."""

from __future__ import annotations

from dataclasses import replace

from ..diagnosis import Diagnosis
from ..diagnosis.experiment_design import Question
from ..diagnosis.models.base import effect_in
from ..diagnosis.stages.next_experiment import CALIBRATION, proposed, questions
from ..diagnosis.stages.screening import medium_starts

#: Effects that an experiment is to show at most: as many models as where names compete on both channels.
MAX_UNSEEN = 6


def asked(found: Diagnosis) -> list[Question]:
    """What an experiment is to part: what the diagnosis leaves open; where nothing is missing the model without effects from it
    with one that the logs would not show, those first that they nearly show. What calibration takes up no experiment shows."""
    if found.verdict not in ("none", "calibration") or not found.rig.has_hidden_states:
        return questions(found)
    wanted: list[Question] = []
    for s in sorted((s for s in found.screening if not s.shows and not s.hidden), key=lambda s: -s.visible):
        if s.channel is not None and (bare := found.models.calibrated[s.channel]).columns:
            effect = effect_in(found.rig, s.effect, s.channel)
            start = medium_starts(effect, found.logs.seconds)[0]
            models = {CALIBRATION: bare, s.effect: bare.extended(effect, start, s.channel)}
            wanted.append(Question(s.channel, models))
    del wanted[MAX_UNSEEN:]
    found.logs.fit.evaluate([p for question in wanted for p in question.models.values()])
    return wanted


def with_experiment(found: Diagnosis) -> Diagnosis:
    """The diagnosis with an experiment for what the logs would not show, where it proposes none."""
    return found if found.next_experiment else replace(found, next_experiment=proposed(found, asked(found)))
