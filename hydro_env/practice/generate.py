"""Practice rig logs: measurements of a rig in which effects are hidden, with the truth in a file beside them.

The rig is the reference simulator in the "different" forms, so the hidden effects do not have the equations that a
diagnosis fits. An engineer's two runs and a third one to be sealed are made (`manoeuvres.py`):

    fit_1.csv   valve bench, open loop
    fit_2.csv   operation, closed loop
    sealed.csv  other values, order and mixture of both, for proof
    model.yaml  the model as an engineer has it, without the hidden effects
    truth.json  what was hidden, and everything else that was drawn for the rig

Or the same rig plays commands from a file, which makes played.csv in the place of the three.

A user's own effect (`plant.load_effects`) has one set of equations, its laws. If one is hidden, the rig is the compiled
plant with the laws of the catalogue for all effects, and truth.json says `"forms": "catalogue"`: the diagnosis then meets
its own equations, so such a log shows that an effect can be found, not that it would be found on a real rig.
"""

import hashlib
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from ..arrays import Floats
from ..errors import InputError, check_known
from ..files import write_json, write_text
from ..limits import Limits
from ..plant import BUILT_IN, CATALOGUE, PlantModel, load_model, scales_of
from .hidden import SEVERITIES, Hidden, check_values, choose, parse_effects, parse_values, true_model
from .manoeuvres import ROUND, RUNS, plans_of
from .recorder import CATALOGUE_FORMS, CONTROL_PERIOD, RECORDABLE, Recorder, columns_of, log_text, stretch_of
from .reference import FORMS
from .reference.forms import UNITS, Constants, draw, scaled

__all__ = ["Practice", "PracticeSettings", "constants_of", "make_practice", "run"]

SCHEMA = "hydro_env/truth/1"
#: The log of commands from a file.
PLAYED = "played"


#: Numbers of the settings: factor on the noise, fraction of base parameters, s, rows per second, and the seed.
_LIMITS = {
    "noise": Limits(0.0, 100.0),
    "base_error": Limits(0.0, 0.5),
    "duration": Limits(3.0, 3600.0, unit="s"),
    "rate": Limits(10.0, 20000.0, unit="Hz"),
    "seed": Limits(0, math.inf, whole=True),
}


@dataclass(frozen=True)
class PracticeSettings:
    """How practice logs are made. InputError in one line for anything unknown or out of range.

    severity    "small", "medium" or "large": sizes are drawn log-uniformly between 0.2 and 0.5, 0.4 and 2, or 1.5 and 3
                times the catalogue's typical distance from the neutral value, within the bounds; of what limits, between the
                typical limit over the roots of these. Signs are drawn where both make sense, shapes within a factor of 3,
                and drifts slower than the log are made as fast as it
    values      {"effect.parameter": value in SI}, instead of the drawn ones
    noise       factor on the sensors' noise; 0: no noise and no quantisation
    base_error  the rig's base parameters differ from the model's by up to this fraction (0.1: 10 %), each channel alone
    record      signals besides time, command and speed, of `RECORDABLE`; without "load" none is applied
    rate        rows per second, a multiple of 100 Hz or a rate below
    duration    of each log, s, at least 3; None: one round, 12 s, up to ten times as long where motors start slowly
    seed        the same seed gives the same logs; manoeuvres, sizes, base parameters and forms have streams of their own
    forms       of the effects in the simulator, see `reference.FORMS`; "catalogue": the laws of the catalogue, as wherever a
                user's effect is
    runs        which logs to make, of "fit_1", "fit_2", "sealed"
    play        a CSV file of commands (`manoeuvres.plans_of`): the same rig plays these instead of `runs`, as the log "played"
    """

    severity: str = "medium"
    values: Mapping[str, float] = field(default_factory=dict)
    noise: float = 1.0
    base_error: float = 0.0
    record: Sequence[str] = ("setpoint", "current", "pressure", "load")
    rate: float = 1000.0
    duration: float | None = None
    seed: int = 0
    forms: str = "different"
    runs: Sequence[str] = tuple(RUNS)
    play: str | Path | None = None

    def __post_init__(self) -> None:
        chosen = (
            ("severity", [self.severity], SEVERITIES), ("record", self.record, RECORDABLE),
            ("runs", self.runs, RUNS), ("forms", [self.forms], (*FORMS, CATALOGUE_FORMS)),
        )  # fmt: skip
        for field_name, names, known in chosen:
            check_known(f"{field_name}: unknown", names, known)
        for field_name, limits in _LIMITS.items():
            if getattr(self, field_name) is not None:
                limits.check(getattr(self, field_name), field_name)
        multiple = self.rate * CONTROL_PERIOD
        if multiple > 1.0 and abs(multiple - round(multiple)) > 1e-9:
            raise InputError(f"rate is {self.rate:g} Hz; expected a multiple of 100 Hz, or at most 100 Hz")


@dataclass(frozen=True)
class Practice:
    """Practice logs. `logs` maps "fit_1", "fit_2", "sealed" to columns by header name; `given` is the model an engineer
    has, `true` the one that made the logs with these `constants` of form (None: the catalogue's forms); `hidden` and `truth`
    (the content of truth.json) say what the difference is.
    """

    logs: Mapping[str, Mapping[str, Floats]]
    given: PlantModel
    true: PlantModel
    constants: Constants | None
    hidden: tuple[Hidden, ...]
    truth: Mapping[str, Any]

    def write(self, out: Path) -> None:
        """Writes the logs, model.yaml and truth.json into the folder `out`, which is made if need be."""
        out.mkdir(parents=True, exist_ok=True)
        kinds = columns_of(scales_of(self.given))
        texts = {f"{name}.csv": log_text(columns, kinds) for name, columns in self.logs.items()}
        sums = {name: hashlib.sha256(text.encode()).hexdigest() for name, text in texts.items()}
        for name, text in texts.items():
            write_text(out / name, text)
        self.given.to_yaml(out / "model.yaml")
        write_json(out / "truth.json", {**self.truth, "log_sha256": sums})


def make_practice(
    effects: Iterable[str] | Mapping[str, str] = (), *, model: str | Path | PlantModel = "paper",
    progress: bool = False, **settings: Any,
) -> Practice:  # fmt: skip
    """Makes practice logs of a rig with hidden effects.

    effects   "NAME" or "NAME:CHANNEL" (channel 1, 2 or both), or {name: channel}; none: nothing is hidden
    model     the model an engineer has: preset, YAML file or model
    progress  whether to show a bar
    settings  fields of `PracticeSettings`

    InputError in one line for anything unknown or out of range.
    """
    if isinstance(effects, Mapping):
        effects = [name if channel == "rig" else f"{name}:{channel}" for name, channel in effects.items()]
    chosen = parse_effects(effects)
    own = PracticeSettings(**settings)
    given = load_model(model)
    check_values(own.values, chosen, given)
    duration = round(ROUND * stretch_of(given), 1) if own.duration is None else own.duration
    size_seed, base_seed, *run_seeds, form_seed = np.random.SeedSequence(own.seed).spawn(3 + len(RUNS))
    sizes = np.random.default_rng(size_seed)
    hidden = tuple(choose(given, chosen, own.values, own.severity, duration, sizes))
    forms = own.forms if all(name in BUILT_IN for name in (*chosen, *given.declared)) else CATALOGUE_FORMS
    drawn = scaled(draw(np.random.default_rng(form_seed)), scales_of(given))
    constants = drawn if forms == "different" else None
    true, wrong = true_model(given, hidden, own.base_error, np.random.default_rng(base_seed))
    recorder = Recorder(given, true, forms, constants, own.record, own.noise, own.rate, duration)
    if own.play is not None:
        logs = {PLAYED: _played(own, given, recorder)}
    else:
        chosen_runs = [(name, seeds) for name, seeds in zip(RUNS, run_seeds, strict=True) if name in own.runs]
        bar = tqdm(chosen_runs, unit="log", leave=False, delay=0.5, disable=not progress)
        logs = {name: recorder.log(name, seeds) for name, seeds in bar}
    truth = {
        "schema": SCHEMA,
        "verdict": "effects" if hidden else ("calibration" if wrong else "none"),
        "effects": [_as_json(h) for h in hidden],
        "base_parameters": wrong,
        "form_constants": {n: {"value": v, "unit": UNITS[n]} for n, v in (constants or {}).items()},
        "model": given.name,
        "severity": own.severity,
        "noise": own.noise,
        "base_error": own.base_error,
        "record": list(own.record),
        "rate_Hz": own.rate,
        "duration_s": duration,
        "seed": own.seed,
        "forms": forms,
        "logs": {
            kind: [f"{n}.csv" for n in logs if n.startswith(kind)]
            for kind in (("fit", "sealed") if own.play is None else (PLAYED,))
        },
    }
    return Practice(logs, given, true, constants, hidden, truth)


def run(
    effects: Sequence[str], out: Path, *, none: bool = False, model: str = "paper", values: Sequence[str] = (),
    base_error_percent: float = 0.0, **settings: Any,
) -> Practice:  # fmt: skip
    """The command `hydro-env hide EFFECT[:CHANNEL] ... --out DIR`: writes fit_1.csv, fit_2.csv, sealed.csv (or played.csv, with
    `play`), model.yaml and truth.json to `out`.

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


def _played(own: PracticeSettings, given: PlantModel, recorder: Recorder) -> dict[str, Floats]:
    """The log of commands from a file. The same commands have the same noise, others have other noise."""
    assert own.play is not None
    channels = plans_of(own.play, given.pair("u_rated"), recorder.period)
    content = hashlib.sha256(b"".join(a.tobytes() for p in channels for a in (p.value, p.load))).digest()
    noise_seed = np.random.SeedSequence([own.seed, int.from_bytes(content[:8], "little")])
    return recorder.played(channels, noise_seed)


def constants_of(truth: Mapping[str, Any]) -> Constants | None:
    """The constants of form in the content of truth.json."""
    return {n: entry["value"] for n, entry in truth["form_constants"].items()} or None


def _as_json(hidden: Hidden) -> dict[str, Any]:
    effect = CATALOGUE[hidden.name]
    values = {
        n: {"value": v if math.isfinite(v) else None, "unit": effect.parameter(n).unit}
        for n, v in hidden.parameters.items()
    }
    return {"name": hidden.name, "channel": hidden.channel, "parameters": values}
