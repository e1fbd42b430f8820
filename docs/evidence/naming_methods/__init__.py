"""Simple methods beside the diagnosis in the naming benchmark, whose answers the published table compares.

    python -m docs.evidence.naming_methods METHOD... --set DIR --out DIR

METHOD is one of these, or `all`:

    sindy       sparse regression of the equations' errors on the catalogue's terms (PySINDy's STLSQ)
    polynomial  sparse polynomial of the line's error, added to the right-hand side; names nothing
    certify     localisation by equation and regime, one term each, F-test on the other log, false-discovery control
    network     small neural network added to the right-hand side of the line; names nothing

DIR of `--set` is a set of `hydro-env naming-benchmark make`; answers go to a folder for each method, for
`hydro-env naming-benchmark score`. Answers that are there already are kept, so a run may be interrupted and continued.

All begin with the calibrated model and share its verdict `none` or `calibration` where it leaves the speeds of the validation
log at their noise.

methods     the methods by name
equations   errors of the equations of coil, line and shaft beside a calibrated model, and the terms of every candidate
by_terms    effects named by the terms that explain these errors
correction  a black box added to the right-hand side of the line
"""
