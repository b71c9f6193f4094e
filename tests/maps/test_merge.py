"""Intersections of two surveys: recognised as the same, kept or replaced by a rule that is told, and new ones added."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from planned_survey import survey
from synthetic_mine import SyntheticMine

from maps.build import build_semantic_map
from maps.merge import MergeSettings, directions, merge_maps
from maps.prior_map import PriorMap
from maps.settings import MapSettings
from semmap import database
from semmap.errors import DatabaseError, SettingsError
from semmap.intersections import SemanticMap

NODES = {
    "a": (0, 0), "b": (40, 0), "c": (80, 0), "d": (40, 40), "e": (80, 40), "f": (0, 40),
    "a1": (-30, 0), "a2": (0, -30), "b1": (40, -30), "c1": (110, 0), "e1": (110, 40), "d1": (40, 70),
}  # fmt: skip
ROADS = ("a b", "b c", "b d", "c e", "d e", "a a1", "a a2", "c c1", "e e1", "d d1")
"""T at a, b, c, d and e; b and d face each other, e looks like none of the others."""


def mine(**options: object) -> SemanticMap:
    return survey(NODES, ROADS, **options)


def test_a_survey_merged_with_itself_is_itself(tmp_path) -> None:
    whole = mine()
    database.save(whole, tmp_path / "a.h5")
    a = database.load(tmp_path / "a.h5")
    for b in (a, whole):
        result = merge_maps(a, b)
        assert len(result.pairs) == 5 and all(pair.distance == 0.0 and pair.similarity > 0.999 for pair in result.pairs)
        assert result.added == () and result.conflicts == () and result.added_roadways == 0.0
        database.save(result.map, tmp_path / "c.h5")
        assert (tmp_path / "c.h5").read_bytes() == (tmp_path / "a.h5").read_bytes()


def test_ids_of_a_stay_and_new_ones_follow_them() -> None:
    a = survey(NODES, ("a b", "b c", "b d", "a a1", "a a2"), first_id=7)
    b = mine(first_id=3)
    result = merge_maps(a, b)
    id_a = {tuple(p): id for id, p in zip(a.columns.id.tolist(), a.p_map.tolist(), strict=True)}
    id_b = {tuple(p): id for id, p in zip(b.columns.id.tolist(), b.p_map.tolist(), strict=True)}
    assert {pair.id: pair.id_b for pair in result.pairs} == {id: id_b[p] for p, id in id_a.items()}
    assert_array_equal(result.map.columns.id, [*a.columns.id, *(id for _, id in result.added)])
    assert [id for _, id in result.added] == [9, 10, 11]
    for old, new in result.added:
        assert_array_equal(result.map.by_id(new).p_map, b.by_id(old).p_map)
        assert_array_equal(result.map.by_id(new).cloud, b.by_id(old).cloud)
        assert_array_equal(result.map.by_id(new).contour.pwcv, b.by_id(old).contour.pwcv)


@pytest.mark.parametrize("qualities", [(0.9, 0.5), (0.9, 0.92), (0.9, 0.99)])
def test_where_the_surveys_agree_the_clearly_better_description_is_kept(qualities) -> None:
    a, b = mine(quality=qualities[0]), mine(quality=qualities[1], first_id=20)
    result = merge_maps(a, b)
    kept = "B" if qualities[1] > qualities[0] + MergeSettings().min_gain else "A"
    assert {pair.kept for pair in result.pairs} == {kept}
    assert_allclose(result.map.columns.quality, qualities["AB".index(kept)])
    chosen = {"A": a, "B": b}[kept]
    for pair in result.pairs:
        there = chosen.by_id(pair.id if kept == "A" else pair.id_b)
        assert_array_equal(result.map.by_id(pair.id).cloud, there.cloud)
    assert result.conflicts == ()


@pytest.mark.parametrize(
    ("quality", "kept", "words"), [(0.8, "B", "0.80 against 0.90"), (0.6, "A", "0.90 against 0.60")]
)
def test_the_survey_with_more_branches_is_kept_unless_it_saw_much_less(quality, kept, words) -> None:
    a, b = mine(quality=0.9), survey(NODES, (*ROADS, "b b1"), quality=quality)
    result = merge_maps(a, b)
    (conflict,) = result.conflicts
    assert "T with 3 branches in A, X with 4 in B" in conflict.what
    assert conflict.kept.startswith(f"{kept}'s") and words in conflict.kept
    assert len(result.map.by_id(conflict.id).branch_bearings) == (4 if kept == "B" else 3)
    assert_allclose(conflict.p_map, [40, 0, 0])
    assert_allclose(result.added_roadways, 30.0)
    back = merge_maps(b, a)
    assert [len(back.map.by_id(one.id).branch_bearings) for one in back.conflicts] == [4 if kept == "B" else 3]


@pytest.mark.parametrize(("quality", "kept"), [(0.8, "B"), (0.6, "A")])
def test_of_contradicting_surveys_the_newer_is_kept_unless_it_saw_much_less(quality, kept) -> None:
    a = mine(quality=0.9)
    first, *others = a.intersections
    turned = replace(first, branch_bearings=first.branch_bearings + [0.0, 0.6, 0.0], quality=quality)
    (conflict,) = merge_maps(a, replace(a, intersections=(turned, *others))).conflicts
    assert conflict.kept.startswith(f"{kept}'s: {'newer' if kept == 'B' else 'seen much better'}")


def test_other_bearings_walls_and_kinds_are_differences() -> None:
    a = mine()
    first, *others = a.intersections
    turned = replace(first, branch_bearings=first.branch_bearings + [0.0, 0.6, 0.0])
    walls = replace(first, contour=replace(first.contour, cwc=6.0 - 0.5 * first.contour.cwc))
    for changed, words in (
        (turned, "branches at 0° 180° 270° in A, at 0° 214° 270° in B"),
        (walls, "walls differ (similarity 0."),
        (replace(first, kind="Y"), "T in A, Y in B"),
    ):
        result = merge_maps(a, replace(a, intersections=(changed, *others)))
        (conflict,) = result.conflicts
        assert conflict.what.startswith(words)
        assert conflict.id == conflict.id_b == first.id


def test_bearings_on_either_side_of_east_are_one_branch() -> None:
    a = mine()
    first, *others = a.intersections
    assert first.branch_bearings[0] == 0.0
    below = replace(first, branch_bearings=np.sort((first.branch_bearings - 0.05) % (2.0 * np.pi)))
    assert merge_maps(a, replace(a, intersections=(below, *others))).conflicts == ()


class TestShift:
    OFFSET = np.array([0.42, -0.1, 0.25])

    def test_it_is_found_and_reported_and_b_stays(self) -> None:
        a, b = mine(), survey(NODES, (*ROADS, "d f"), shift=self.OFFSET)
        result = merge_maps(a, b)
        assert result.shift is not None and result.shift.significant and not result.aligned
        assert_allclose(result.shift.offset, -self.OFFSET)
        assert max(pair.distance for pair in result.pairs if not pair.differences) < 1e-6
        (added,) = [one for one in result.map.roadways.node_p_map if np.hypot(*(one[:2] - [0, 40])) < 5.0]
        assert_allclose(added, [0.42, 39.9, 0.25])

    def test_it_is_taken_out_when_asked_for(self) -> None:
        a, b = survey(NODES, ROADS[:9]), survey(NODES, (*ROADS, "d f"), shift=self.OFFSET, quality=0.99)
        result = merge_maps(a, b, align=True)
        truth = survey(NODES, (*ROADS, "d f"))
        assert result.aligned
        found = result.map.p_map[np.lexsort(result.map.p_map.T)]
        assert_allclose(found, truth.p_map[np.lexsort(truth.p_map.T)], atol=1e-9)
        nodes, planned = result.map.roadways.node_p_map, truth.roadways.node_p_map
        assert_allclose(nodes[np.lexsort(nodes.round(3).T)], planned[np.lexsort(planned.round(3).T)], atol=1e-9)

    def test_surveys_that_lie_on_each_other_are_not_moved(self) -> None:
        rng = np.random.default_rng(0)
        a, b = mine(), mine()
        b = replace(
            b, intersections=tuple(replace(one, p_map=one.p_map + rng.normal(0, 0.05, 3)) for one in b.intersections)
        )
        result = merge_maps(a, b, align=True)
        assert result.shift is not None and not result.shift.significant
        assert_array_equal(result.map.p_map, a.p_map)

    def test_one_intersection_that_lies_elsewhere_is_a_conflict_not_a_shift(self) -> None:
        a = mine()
        first, *others = a.intersections
        b = replace(a, intersections=(replace(first, p_map=first.p_map + [1.5, 0.0, 0.0]), *others))
        result = merge_maps(a, b)
        assert result.shift is not None and not result.shift.significant
        (conflict,) = result.conflicts
        assert conflict.what == "1.5 m from A's place in B (1.50 m east)"

    def test_too_few_tell_none(self) -> None:
        a, b = mine(), survey(NODES, ROADS[:1] + ROADS[5:7], shift=self.OFFSET)
        assert merge_maps(a, b).shift is None
        with pytest.raises(SettingsError, match="align: too few intersections agree"):
            merge_maps(a, b, align=True)


def test_the_same_place_on_another_level_is_another_intersection() -> None:
    a, b = mine(), survey({name: (*p, 6.0) for name, p in NODES.items()}, ROADS)
    result = merge_maps(a, b)
    assert result.pairs == () and len(result.map) == 10 and result.conflicts == ()


def test_an_empty_survey_changes_nothing_and_is_filled_by_the_other() -> None:
    empty = replace(survey(NODES, ()), sources={"empty.laz": "0"})
    whole = mine()
    kept, filled = merge_maps(whole, empty), merge_maps(empty, whole)
    assert kept.shift is None and filled.shift is None
    for result in (kept, filled):
        assert_array_equal(result.map.p_map, whole.p_map)
        assert_array_equal(result.map.contours.cwc, whole.contours.cwc)
        assert_allclose(sum(result.map.roadways.edge_length), sum(whole.roadways.edge_length))
    assert len(filled.added) == 5 and kept.added == ()
    assert len(merge_maps(empty, empty).map) == 0


def test_what_cannot_be_merged_is_refused_by_name() -> None:
    a = mine()
    other = MapSettings.model_validate({"contour": {"radius": 10.0}}).model_dump(mode="json")
    for b, words in (
        (replace(a, settings=other), "settings.contour.radius: is 10.0 in B and 12.0 in A"),
        (replace(a, frame="mine"), "frame: is 'mine' in B and 'map' in A"),
        (replace(a, settings={"contuor": {}}), "contuor: unknown key; did you mean `contour`"),
    ):
        with pytest.raises(DatabaseError, match=words.replace("(", r"\(")):
            merge_maps(a, b)
    with pytest.raises(DatabaseError, match="crs: is EPSG:2 in B and EPSG:1 in A"):
        merge_maps(replace(a, crs="EPSG:1"), replace(a, crs="EPSG:2"))
    merge_maps(replace(a, crs="EPSG:1"), replace(a, crs='PROJCS["mine",AUTHORITY["EPSG","1"]]'))


def test_what_describes_the_map_comes_from_both() -> None:
    a = replace(mine(), origin=np.array([5e6, 3e6, 0.0]), sources={"mine.laz": "aa", "old.laz": "bb"})
    b = replace(mine(), sources={"mine.laz": "cc", "old.laz": "bb", "new.laz": "dd"}, crs="EPSG:25832")
    both = merge_maps(a, b).map
    assert both.sources == {"mine.laz": "aa", "old.laz": "bb", "mine.laz (2)": "cc", "new.laz": "dd"}
    assert both.crs == "EPSG:25832"
    assert_array_equal(both.origin, a.origin)


def test_directions_in_words() -> None:
    assert directions(np.array([0.42, -0.1, 0.0])) == "0.42 m east, 0.10 m south"
    assert directions(np.array([-1.0, 2.0, -0.5])) == "1.00 m west, 2.00 m north, 0.50 m down"
    assert directions(np.zeros(3)) == "nowhere"


def test_two_scanned_surveys_of_a_ladder() -> None:
    """Clouds of the same roadways sampled anew; the second shows one roadway more and lies 0.4 m aside."""
    ladder = SyntheticMine(
        (
            (-25.0, 0.0, 65.0, 0.0, 4.5),
            (0.0, 0.0, 0.0, 24.0, 3.5),
            (24.0, 0.0, 24.0, 24.0, 4.0),
            (48.0, 0.0, 48.0, -24.0, 3.8),
            (-1.75, 24.0, 45.0, 24.0, 4.0),
        )
    )
    whole = replace(ladder, roadways=(*ladder.roadways, (24.0, 0.0, 24.0, -25.0, 3.0)))
    a, b = (
        build_semantic_map(PriorMap((one.cloud(0.15, seed=seed) + shift).astype(np.float32), np.zeros(3)))
        for one, seed, shift in ((ladder, 0, np.zeros(3)), (whole, 1, np.array([0.4, 0.0, 0.0])))
    )
    result = merge_maps(a, b)
    assert len(result.pairs) == len(a) == len(b) and result.added == ()
    assert result.shift is not None
    assert_allclose(result.shift.offset, [-0.4, 0.0, 0.0], atol=0.1)
    (conflict,) = result.conflicts
    assert "T with 3 branches in A, X with 4 in B" in conflict.what
    assert_allclose(result.map.roadways.edge_length.sum(), b.roadways.edge_length.sum(), rtol=0.01)
    assert_allclose(result.added_roadways, 25.0, atol=2.0)
