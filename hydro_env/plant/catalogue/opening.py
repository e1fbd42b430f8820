"""Effects on the opening of the valve: what the edges make of the spool's position."""

from __future__ import annotations

from math import inf

from ..parameters import Parameter
from ..vector_math import clip
from .effect import Effect

__all__ = ["EFFECTS"]


def _null_offset(opening, offset):
    return opening + offset


NULL_OFFSET = Effect(
    name="null_offset",
    port="opening",
    summary="hydraulic centre beside the electrical one",
    signature="asymmetric onset, offset at zero command",
    source="ISO 10770-1, null bias",
    parameters=(Parameter("offset", "m", 0.0, -1.5e-4, 1.5e-4, "assumed", "opening at centred spool", 3e-5),),
    laws={"opening": _null_offset},
)


def _dead_zone(opening, overlap_positive, overlap_negative):
    return opening - clip(opening, -overlap_negative, overlap_positive)


DEAD_ZONE = Effect(
    name="dead_zone",
    port="opening",
    summary="positive overlap: no flow until the spool has passed it, each direction with its own",
    signature="flat flow around zero, each direction its own width",
    source="ISO 10770-1, dead band; the paper's Fig. 2 shows none below 300 mA",
    parameters=(
        Parameter(
            "overlap_positive",
            "m",
            0.0,
            0.0,
            4.5e-4,
            "Fig. 2: 300 mA are 353 um",
            "overlap, positive flow",
            1e-4,
        ),
        Parameter(
            "overlap_negative",
            "m",
            0.0,
            0.0,
            4.5e-4,
            "Fig. 2: 300 mA are 353 um",
            "overlap, negative flow",
            1e-4,
        ),
    ),
    laws={"opening": _dead_zone},
    indistinguishable_from=("spring_preload",),
)


def _flow_saturation(opening, opening_limit):
    return clip(opening, -opening_limit, opening_limit)


FLOW_SATURATION = Effect(
    name="flow_saturation",
    port="opening",
    summary="the opening stops growing although the spool moves on",
    signature="flat top at large commands",
    source="ISO 10770-1, flow saturation",
    parameters=(
        Parameter("opening_limit", "m", inf, 1e-4, 8.6e-4, "assumed", "largest opening", 3e-4, log=True),
    ),
    laws={"opening": _flow_saturation},
)


def _directional_gain(opening, ratio):
    return opening * (1.0 if opening > 0.0 else ratio)


DIRECTIONAL_GAIN = Effect(
    name="directional_gain",
    port="opening",
    summary="the negative direction has another flow gain than the positive one",
    signature="gain split by the sign of the command",
    source="ISO 10770-1, symmetry",
    parameters=(
        Parameter("ratio", "1", 1.0, 0.4, 2.5, "assumed", "negative over positive flow gain", 0.75, log=True),
    ),
    laws={"opening": _directional_gain},
)


def _flow_gain_nonlinearity(opening, curvature, alpha, u_rated, R, k):
    rated = alpha * u_rated / (R * k)
    share = abs(opening) / rated
    return opening * ((1.0 - curvature) + curvature * (share if share < 1.0 else 1.0))


FLOW_GAIN_NONLINEARITY = Effect(
    name="flow_gain_nonlinearity",
    port="opening",
    summary="progressive control edge: little gain at small openings",
    signature="residual over opening only",
    source="V-notches of proportional spools; ISO 10770-1, linearity",
    parameters=(
        Parameter(
            "curvature", "1", 0.0, -0.8, 0.9, "assumed", "share of the gain that grows with the opening", 0.5
        ),
    ),
    laws={"opening": _flow_gain_nonlinearity},
)


#: In the order in which they act.
EFFECTS = (
    NULL_OFFSET,
    DEAD_ZONE,
    FLOW_SATURATION,
    DIRECTIONAL_GAIN,
    FLOW_GAIN_NONLINEARITY,
)
