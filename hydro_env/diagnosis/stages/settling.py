"""Settling: what is reported goes all the way to its minimum (`estimation.settling`), before it is proved and given intervals."""

from __future__ import annotations

from ..estimation import Estimate, far_from_noise, settle, settle_finally
from ..logs import Logs
from .form_correction import Models

__all__ = ["run"]


def run(logs: Logs, models: Models) -> Models:
    """Settles the estimates that are reported: with the fit's tolerance, which costs less, then from there with the proof's.

    An estimate that stops a little early is far from the truth in what the logs know by ratios only, measured by its interval.
    What is far from the noise is left as it is: something is missing there, and its minimum is not where the truth is.
    """
    coarse, fine = (logs.fit.on(rig.for_long_refits()) for rig in (logs.rig, logs.fine))

    def settled(estimates: list[Estimate]) -> None:
        near = [p for p in estimates if p.simulated and not far_from_noise(fine, p)]
        settle(coarse, near)
        settle_finally(fine, near)

    return models.changed(settled)
