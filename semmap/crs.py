"""Coordinate systems, as far as their names go: nothing is reprojected here."""

from __future__ import annotations

import re

_AT_THE_END = re.compile(
    r'(?:^EPSG:{1,2}|(?:AUTHORITY|ID)\s*\[\s*"EPSG"\s*,\s*"?)(\d+)"?[\s\]]*$',
    re.IGNORECASE,
)


def epsg_code(crs: str | None) -> int | None:
    """The EPSG code in ``EPSG:25832``, or at the end of a WKT, where that of the whole stands; else None."""
    found = _AT_THE_END.search((crs or "").strip())
    return int(found.group(1)) if found else None


def same_crs(a: str, b: str) -> bool:
    """Whether two texts name one coordinate system: by EPSG code where both have one, else word for word."""
    codes = epsg_code(a), epsg_code(b)
    return a == b if None in codes else codes[0] == codes[1]
