"""Names of coordinate systems."""

from __future__ import annotations

import pytest

from semmap.crs import epsg_code, same_crs

WKT1 = 'PROJCS["a",GEOGCS["b",AUTHORITY["EPSG","4258"]],AUTHORITY["EPSG","25832"]]'
WKT2 = 'PROJCRS["a",BASEGEOGCRS["b",ID["EPSG",4258]],ID["EPSG",25832]]'
NO_CODE = 'PROJCS["a",GEOGCS["b",AUTHORITY["EPSG","4258"]],UNIT["metre",1]]'


@pytest.mark.parametrize(
    ("crs", "code"),
    [
        ("EPSG:25832", 25832),
        (" epsg::4978\n", 4978),
        (WKT1, 25832),
        (WKT2, 25832),
        (NO_CODE, None),
        ("mine grid", None),
        ("", None),
        (None, None),
    ],
)
def test_the_code_of_the_whole_is_taken_not_that_of_a_part(crs: str | None, code: int | None) -> None:
    assert epsg_code(crs) == code


def test_one_system_may_be_written_in_several_ways() -> None:
    assert same_crs(WKT1, WKT2) and same_crs(WKT1, "EPSG:25832") and same_crs(NO_CODE, NO_CODE)
    assert not same_crs(WKT1, "EPSG:25833")
    assert not same_crs(WKT1, NO_CODE)
