"""Validation: how far the models are from manoeuvres that took no part in the fit."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..estimation.estimate import Estimates
from ..estimation.fit import noise_in
from ..logs import Logs
from ..models.base import UNITS, RigModel, Samples
from .form_correction import Models

#: Where the form of an effect was corrected this model is compared besides: the named effects without that correction.
NAMED = "named"
#: A signal is at its noise up to this many times that: a fifth more power, which is more than the noise itself is uncertain by.
AT_NOISE = 1.1


@dataclass(frozen=True)
class Proof:
    """`errors[channel, signal][model]` are RMS errors in the unit of `shown_unit`, beside "noise"; `traces[model][channel]` the
    simulated samples (n,) in the order of `rig.segments[channel]`."""

    rig: RigModel
    errors: dict[tuple[int, str], dict[str, float]]
    traces: dict[str, Samples]

    def as_dict(self) -> dict[str, dict[str, float]]:
        """The errors by `speed_1_rpm`."""
        return {signal_key(self.rig, signal, c): entry for (c, signal), entry in self.errors.items()}


@dataclass(frozen=True)
class Proofs:
    """The models beside the logs to fit and those held out: by free simulations, which are reported, and by those that names are
    `judged` by, which follow the measured speed where a coupling rattles."""

    fit: Proof
    held_out: Proof
    judged_fit: Proof
    judged: Proof

    def left(self, channels: Sequence[int], signals: Collection[str] = UNITS) -> float:
        """What the final model leaves of the held-out logs, the largest error of these signals and channels in times the noise. A
        reduced model is not held against the noise, which is not all that it leaves out: 0."""
        every = self.judged.errors.items()
        errors = [e["after"] / e["noise"] for (c, s), e in every if c in channels and s in signals]
        return max(errors, default=0.0) if self.judged.rig.has_hidden_states else 0.0


def run(logs: Logs, models: Models) -> Proofs:
    """Compares all models with the logs to fit and with those held out."""
    every: dict[str, Estimates] = {
        "before": models.given, "calibrated": models.calibrated, "after": models.final,
        "placebo": {**models.calibrated, **models.placebo},
    }  # fmt: skip
    if models.corrections:
        every[NAMED] = models.named
    judged_fit, judged = free = prove(logs.fine, every), prove(logs.held_out, every)
    if logs.rig.followed:
        freely = logs.following(())
        free = prove(freely.fine, every), prove(freely.held_out, every)
    return Proofs(*free, judged_fit, judged)


def shown_unit(rig: RigModel, signal: str, channel: int) -> tuple[str, float]:
    """Unit in which a signal is reported, and its size in SI; a cylinder's speed is in mm/s."""
    if signal == "speed" and rig.parts[0].log.kinds[channel] == "cylinder":
        return "mm_per_s", 1e-3
    return UNITS[signal]


def signal_key(rig: RigModel, signal: str, channel: int) -> str:
    """The name of a signal in diagnosis.json: `speed_1_rpm`."""
    return f"{signal}_{channel + 1}_{shown_unit(rig, signal, channel)[0]}"


def prove(rig: RigModel, models: Mapping[str, Estimates]) -> Proof:
    """Simulates every model from the logged commands and compares with all logs of `rig`."""
    every = list(dict.fromkeys(p for estimates in models.values() for p in estimates.values()))
    results = dict(zip(every, rig.predict([p.request() for p in every]), strict=True))
    traces = {name: {c: results[p][c] for c, p in own.items()} for name, own in models.items()}
    errors: dict[tuple[int, str], dict[str, float]] = {}
    for channel in rig.channels:
        for signal, own in rig.segments[channel].by_signal.items():
            size = shown_unit(rig, signal, channel)[1]
            # The noise by the residual that is smoothest of both.
            smooth = [traces[name][channel] for name in ("calibrated", "after")]
            noise = [min(noise_in(rig, s, s.measured - x[s.place]) for x in smooth) for s in own]
            left = {name: np.concatenate([s.left(traces[name][channel]) for s in own]) for name in models}
            rms = {name: float(np.sqrt(np.mean(error**2))) / size for name, error in left.items()}
            errors[channel, signal] = {"noise": float(np.median(noise)) / size, **rms}
    return Proof(rig, errors, traces)
