"""Noise of the rig's sensors: standard deviations of white noise, in the units that keys and logs name.

They stand here once: environments, controllers, practice logs and the diagnosis take them from here.
"""

from collections.abc import Mapping

#: Standard deviation by signal: of the rig's three sensors, and of two that only a test bench has.
NOISE: Mapping[str, float] = {
    "speed_rpm": 1.0, "current_A": 0.002, "pressure_bar": 0.05, "spool_mm": 0.001, "flow_lpm": 0.05,
}  # fmt: skip
