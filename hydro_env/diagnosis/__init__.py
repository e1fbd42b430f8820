"""From rig logs to what the model of the rig lacks.

from hydro_env.diagnosis import diagnose

found = diagnose(["fit_1.csv", "fit_2.csv"], ["held_out.csv"], model="paper")
found.verdict, found.effects, found.as_dict(), found.model
found.report("report.html")
"""

from .result import Diagnosis
from .settings import RULES, Settings
from .workflow import STAGES, diagnose

__all__ = ["RULES", "STAGES", "Diagnosis", "Settings", "diagnose"]
