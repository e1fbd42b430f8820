"""Effects on the opening of the valve: what the edges make of the spool's position."""

from functools import partial
from math import inf

from ..parameters import SPOOL_TRAVEL, SUPPLY_PRESSURE, Parameter, assumed
from ..vector_math import clip, positive, sqrt
from .effect import Effect

_effect = partial(Effect, port="opening")


def _null_offset(opening, offset):
    return opening + offset


NULL_OFFSET = _effect(
    name="null_offset",
    title="an offset of the hydraulic null",
    summary="hydraulic centre beside the electrical one",
    signature="asymmetric onset, offset at zero command",
    source="ISO 10770-1, null bias",
    parameters=(
        assumed("offset", "m", 0.0, low=-1.5e-4, high=1.5e-4, typical=3e-5, scaling=SPOOL_TRAVEL,
            note="opening at centred spool"),
    ),
    laws={"opening": _null_offset},
)  # fmt: skip


def _dead_zone(opening, overlap_positive, overlap_negative):
    return opening - clip(opening, -overlap_negative, overlap_positive)


DEAD_ZONE = _effect(
    name="dead_zone",
    title="spool overlap (dead zone)",
    summary="positive overlap: no flow until the spool has passed it, each direction with its own",
    signature="flat flow around zero, each direction its own width",
    source="ISO 10770-1, dead band; the paper's Fig. 2 shows none below 300 mA",
    parameters=(
        Parameter("overlap_positive", "m", 0.0, low=0.0, high=4.5e-4, typical=1e-4, scaling=SPOOL_TRAVEL,
            note="overlap, positive direction", source="Fig. 2: 300 mA are 353 um"),
        Parameter("overlap_negative", "m", 0.0, low=0.0, high=4.5e-4, typical=1e-4, scaling=SPOOL_TRAVEL,
            note="overlap, negative direction", source="Fig. 2: 300 mA are 353 um"),
    ),
    laws={"opening": _dead_zone},
    indistinguishable_from=("spring_preload",),
    separated_by={
        "spring_preload": "record the spool position: overlap lets the spool move without flow, a preload does not let it move",
        "flow_gain_nonlinearity": "slow triangles of 20, 40 and 80 % of the rated command: overlap is the same width in all",
        "null_offset": "slow triangle through zero with at least 10 s per cycle",
    },
)  # fmt: skip


def _underlap(opening, underlap_positive, underlap_negative):
    # The edges of one direction open by x + up, those of the other by un - x: the first less the second.
    return opening + clip(
        opening + underlap_positive - underlap_negative, -underlap_negative, underlap_positive
    )


def _underlap_flow(flow, opening, drive, pressure, Kq, underlap_positive, underlap_negative, supply_pressure):
    # While both are open, the edges of the other direction pass the other way, at the other pressure drop. At no opening at
    # all, `drive` knows nothing of the pressure.
    other = 0.5 * (underlap_positive + underlap_negative - abs(opening))
    way = -1.0 if opening < 0.0 else 1.0
    share = way * pressure / supply_pressure
    here = drive if opening != 0.0 else drive - share
    there = here + 2.0 * share
    back = sqrt(positive(there)) - sqrt(positive(here))
    return flow - way * Kq * positive(other) * back


UNDERLAP = _effect(
    name="underlap",
    title="spool underlap (open centre)",
    summary="negative overlap: around the centre all edges are open, each direction with its own underlap",
    signature="twice the flow gain around zero; there the pressure yields to a load",
    source="Merritt 1967, ch. 5: open-centre valve; ISO 10770-1, pressure gain",
    parameters=(
        Parameter("underlap_positive", "m", 0.0, low=0.0, high=1.5e-4, typical=3e-5, scaling=SPOOL_TRAVEL,
            note="underlap of the edges of the positive direction",
            source="1 to 5 % of the travel for valves with a soft centre"),
        Parameter("underlap_negative", "m", 0.0, low=0.0, high=1.5e-4, typical=3e-5, scaling=SPOOL_TRAVEL,
            note="underlap of the edges of the negative direction", source="the same"),
        SUPPLY_PRESSURE,
    ),
    laws={"opening": _underlap, "flow": _underlap_flow},
)  # fmt: skip


def _flow_saturation(opening, opening_limit):
    return clip(opening, -opening_limit, opening_limit)


FLOW_SATURATION = _effect(
    name="flow_saturation",
    title="saturation of the flow",
    summary="the opening stops growing although the spool moves on",
    signature="flat top at large commands",
    source="ISO 10770-1, flow saturation",
    parameters=(
        assumed("opening_limit", "m", inf, low=1e-4, high=8.6e-4, typical=3e-4, log=True, scaling=SPOOL_TRAVEL,
            note="opening at which flow saturates"),
    ),
    laws={"opening": _flow_saturation},
    indistinguishable_from=("spool_stop", "driver_saturation"),
)  # fmt: skip


def _directional_gain(opening, ratio):
    return opening * (1.0 if opening > 0.0 else ratio)


DIRECTIONAL_GAIN = _effect(
    name="directional_gain",
    title="different flow gains of the two directions",
    summary="the negative direction has another flow gain than the positive one",
    signature="gain split by the sign of the command",
    source="ISO 10770-1, symmetry",
    parameters=(
        assumed("ratio", "1", 1.0, low=0.4, high=2.5, typical=0.75, log=True,
            note="gain of the negative direction over the positive"),
    ),
    laws={"opening": _directional_gain},
)  # fmt: skip


def _flow_gain_nonlinearity(opening, curvature, alpha, u_rated, R, k):
    rated = alpha * u_rated / (R * k)
    share = abs(opening) / rated
    return opening * ((1.0 - curvature) + curvature * (share if share < 1.0 else 1.0))


FLOW_GAIN_NONLINEARITY = _effect(
    name="flow_gain_nonlinearity",
    title="a progressive flow gain",
    summary="progressive control edge: little gain at small openings",
    signature="residual over opening only",
    source="V-notches of proportional spools; ISO 10770-1, linearity",
    parameters=(
        assumed("curvature", "1", 0.0, low=-0.8, high=0.9, typical=0.5, note="share of the gain that grows with the opening"),
    ),
    laws={"opening": _flow_gain_nonlinearity},
)  # fmt: skip


#: In the order in which they act.
EFFECTS = (NULL_OFFSET, DEAD_ZONE, UNDERLAP, FLOW_SATURATION, DIRECTIONAL_GAIN, FLOW_GAIN_NONLINEARITY)
