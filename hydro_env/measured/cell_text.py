"""What the text of a cell may be: a number, one with an SI suffix, a time, or nothing."""

import re
from datetime import UTC, datetime

#: Powers of ten that circuit simulators and bench instruments write behind a number.
SI_SUFFIX = {"n": 1e-9, "u": 1e-6, "µ": 1e-6, "m": 1e-3, "k": 1e3, "M": 1e6}
#: Cells that say that nothing was measured, in lower case.
MISSING = frozenset({"", "nan", "na", "n/a", "null", "none", "-", "#n/a"})
_HOURS = re.compile(r"(\d{1,2}):([0-5]\d):([0-5]\d(?:[.,]\d+)?)")
_DAYS = re.compile(
    r"(?P<y>\d{4})(?P<s>[-/.])(?P<m>\d\d?)(?P=s)(?P<d>\d\d?)|(?P<d2>\d\d?)\.(?P<m2>\d\d?)\.(?P<y2>\d{4})"
)


def seconds(text: str) -> float | None:
    """The seconds of a time of day (since midnight) or of a date and time (since 1970), or None: 2024-01-02T12:30:01.5 as in ISO
    8601, with / or . for -, or 2.1.2024 12:30:01,5."""
    day, _, time = text.strip().replace("T", " ").rpartition(" ")
    match, date = _HOURS.fullmatch(time.rstrip("Z")), _DAYS.fullmatch(day.strip())
    if not match or (day and not date):
        return None
    of_day = 3600.0 * int(match[1]) + 60.0 * int(match[2]) + float(match[3].replace(",", "."))
    if not date:
        return of_day
    year, month, of_month = date.group("y", "m", "d") if date["y"] else date.group("y2", "m2", "d2")
    try:
        return datetime(int(year), int(month), int(of_month), tzinfo=UTC).timestamp() + of_day
    except ValueError:
        return None


def is_value(text: str) -> bool:
    """Whether `text` is a number, with an SI suffix or without."""
    return is_number(text) or has_suffix(text)


def has_suffix(text: str) -> bool:
    """Whether `text` is a number with an SI suffix."""
    return text[-1:] in SI_SUFFIX and is_number(text[:-1])


def is_number(text: str) -> bool:
    """Whether `text` is a plain number."""
    try:
        float(text.strip())
    except ValueError:
        return False
    return True
