"""From data sheets to a model of the rig.

sheet.py        the file of a data sheet, its template, and questions on a terminal
quantities.py   what is known: given, or a class value (class_values.yaml) with a range
derive.py       formulas from there to the parameters of the model
simulated.py    the data sheet of a model, measured on the simulated plant
describe.py     what no formula gives, simulated as given; the model with its sources (sources.yaml) and ranges, both sheets,
                assumptions
"""

from hydro_env.data_sheet.describe import Described, describe, write
from hydro_env.data_sheet.sheet import DataSheet, ask, read_sheet, template

__all__ = ["DataSheet", "Described", "ask", "describe", "read_sheet", "template", "write"]
