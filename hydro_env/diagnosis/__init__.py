"""From rig logs to what the model of the rig lacks.

from hydro_env.diagnosis import diagnose

found = diagnose(["fit_1.csv", "fit_2.csv"], ["held_out.csv"], model="paper")
found.verdict, found.effects, found.as_dict(), found.model
found.report("report.html")

Calibration alone, without the search for what the model lacks:

from hydro_env.diagnosis import estimate

found = estimate(["fit_1.csv", "fit_2.csv"], model="paper", parameters=["J", "Kq"])
found.parameters["J_1"].estimate, found.residuals["speed_1_rpm"].after, found.model, found.warnings
"""

from .calibration import Calibration, Residual, estimate
from .result import Diagnosis
from .settings import Settings
from .workflow import STAGES, diagnose

__all__ = ["STAGES", "Calibration", "Diagnosis", "Residual", "Settings", "diagnose", "estimate"]
