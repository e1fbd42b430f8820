"""Documentation. A package only so that `python -m docs.evidence.NAME` runs in a checkout; not part of the wheel."""
