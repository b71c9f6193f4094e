"""The database file: it reads back what was written, byte for byte the same, and refuses everything else."""

import json
import os
import pickle
import shutil
import weakref
from collections.abc import Sequence
from dataclasses import fields, replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from semmap import database
from semmap.errors import DatabaseError, InputFileError
from semmap.intersections import (
    Intersection,
    IntersectionColumns,
    IntersectionTable,
    RoadwayGraph,
    SemanticMap,
    WallContour,
)
from semmap.ragged import Ragged

ORIGIN = np.array([5_712_000.0, 3_401_000.0, 0.0])


def place(k: int, n_points: int, rng: np.random.Generator) -> Intersection:
    n = 3 + k % 2
    return Intersection(
        id=7 * k,
        p_map=ORIGIN + rng.normal(0, 100, 3),
        kind=("T", "X", "multi")[k % 3],
        branch_bearings=np.sort(rng.uniform(0, 2 * np.pi, n)),
        branch_widths=rng.uniform(3, 6, n),
        quality=float(rng.random()),
        contour=WallContour(
            pwcv=rng.random(36, dtype=np.float32),
            pwcv_observed=rng.random(36) > 0.3,
            cwc=rng.random((4, 36), dtype=np.float32),
            cwc_observed=rng.random((4, 36)) > 0.3,
        ),
        cloud=rng.normal(0, 5, (n_points, 3)).astype(np.float32),
    )


def some_map(sizes=(20000, 0, 5), crs: str | None = "EPSG:25832") -> SemanticMap:
    rng = np.random.default_rng(0)
    places = tuple(place(k, n, rng) for k, n in enumerate(sizes))
    positions = np.array([p.p_map for p in places] + [ORIGIN]).reshape(-1, 3)
    roadways = RoadwayGraph(
        node_p_map=positions,
        node_intersection=np.array([p.id for p in places] + [-1]),
        node_kind=np.array(["intersection"] * len(places) + ["open_end"]),
        edge_nodes=np.array([[0, 1], [1, 1]])[: len(places)],
        edge_length=np.array([12.5, 80.0])[: len(places)],
        edge_width=np.array([4.0, 3.5])[: len(places)],
        edge_height=np.array([3.2, 0.0])[: len(places)],
        edge_slope=np.array([-0.12, 0.3])[: len(places)],
        edge_axes=(rng.normal(size=(5, 3)), rng.normal(size=(0, 3)))[: len(places)],
        edge_profiles=(rng.random((5, 2)), rng.random((0, 2)))[: len(places)],
    )
    return SemanticMap(
        intersections=places,
        roadways=roadways,
        origin=ORIGIN,
        settings={"contour": {"sectors": 36, "radius": 12.0}},
        sources={"a.laz": "ab" * 32, "Schächt 2.e57": "cd" * 32},
        crs=crs,
    )


def assert_equal_values(a, b) -> None:
    """Equal in value and type, all the way down; what is put together when asked for is as good as a tuple."""
    if isinstance(a, IntersectionTable | Ragged):
        assert_equal_values(tuple(a), tuple(b))
        return
    assert isinstance(a, type(b))
    if isinstance(a, np.ndarray):
        assert a.dtype == b.dtype
        assert_array_equal(a, b)
    elif isinstance(a, tuple):
        assert len(a) == len(b)
        for x, y in zip(a, b, strict=True):
            assert_equal_values(x, y)
    elif hasattr(a, "__dataclass_fields__"):
        for field in fields(a):
            if field.init:
                assert_equal_values(getattr(a, field.name), getattr(b, field.name))
    else:
        assert a == b


EMPTY = RoadwayGraph(
    np.empty((0, 3)),
    np.empty(0, np.int64),
    np.empty(0, np.str_),
    np.empty((0, 2), np.int64),
    *(np.empty(0) for _ in range(4)),
    (),
    (),
)


class TestRoundTrip:
    @pytest.mark.parametrize("sizes", [(20000, 0, 5), (3,), (0,)])
    @pytest.mark.parametrize("crs", ["EPSG:25832", None])
    def test_a_map_reads_back_as_it_was(self, tmp_path, sizes, crs):
        written = some_map(sizes, crs)
        database.save(written, tmp_path / "m.h5")
        assert_equal_values(database.load(tmp_path / "m.h5"), written)

    def test_a_mine_without_intersections(self, tmp_path):
        written = SemanticMap((), EMPTY, np.zeros(3), {})
        database.save(written, tmp_path / "m.h5")
        assert_equal_values(database.load(tmp_path / "m.h5"), written)

    def test_the_same_map_gives_the_same_bytes(self, tmp_path):
        for name in "ab":
            database.save(some_map(), tmp_path / f"{name}.h5")
        assert (tmp_path / "a.h5").read_bytes() == (tmp_path / "b.h5").read_bytes()

    def test_it_replaces_an_old_file(self, tmp_path):
        (tmp_path / "m.h5").write_text("old")
        database.save(some_map(), tmp_path / "m.h5")
        assert len(database.load(tmp_path / "m.h5")) == 3
        assert os.listdir(tmp_path) == ["m.h5"]

    def test_intersections_are_found_by_id(self, tmp_path):
        database.save(some_map(), tmp_path / "m.h5")
        loaded = database.load(tmp_path / "m.h5")
        for semantic_map in (loaded, some_map()):
            assert semantic_map.by_id(14).id == 14
            with pytest.raises(KeyError):
                semantic_map.by_id(1)


class TestLazyReading:
    """What is read when, and what becomes of a file that does not stay as it was."""

    @pytest.fixture
    def path(self, tmp_path) -> Path:
        database.save(some_map((300, 0, 40_000, 7)), tmp_path / "m.h5")
        return tmp_path / "m.h5"

    def test_rows_are_those_of_the_tuple_however_they_are_asked_for(self, path):
        table, rows = database.load(path).intersections, some_map((300, 0, 40_000, 7)).intersections
        assert len(table) == 4
        for index in (2, -1, np.int64(0)):
            assert_equal_values(table[index], rows[index])
        for part in (slice(None), slice(1, 3), slice(None, None, -2), slice(4, 9)):
            assert_equal_values(tuple(table[part]), rows[part])
        assert_equal_values(tuple(table[::-1][1:3][::2]), rows[::-1][1:3][::2])
        with pytest.raises(IndexError):
            table[4]

    def test_columns_are_those_of_the_tuple(self, path):
        loaded, written = database.load(path), some_map((300, 0, 40_000, 7))
        assert_equal_values(loaded.columns, written.columns)
        assert_equal_values(loaded.p_map, np.array([p.p_map for p in written.intersections]))
        assert_equal_values(loaded.contours, written.contours)
        assert_equal_values(loaded.contours.at(2), written.intersections[2].contour)
        assert_equal_values(loaded.intersections[1:].columns, IntersectionColumns.of(written.intersections[1:]))

    def test_changed_copies_and_pickles_are_whole(self, path):
        one = database.load(path).intersections[2]
        moved = replace(one, id=99)
        assert moved.id == 99 and moved.cloud is one.cloud
        assert_equal_values(pickle.loads(pickle.dumps(one)), some_map((300, 0, 40_000, 7)).intersections[2])
        again = pickle.loads(pickle.dumps(database.load(path)))
        assert_equal_values(again.intersections[2], one)
        assert not hasattr(one, "colour")

    def test_a_cloud_is_read_once_an_object(self, path):
        one = database.load(path).intersections[2]
        assert one.cloud is one.cloud

    @pytest.mark.parametrize("look", [lambda m: m.intersections.read_cloud(0), lambda m: m.contours])
    def test_a_file_removed_meanwhile(self, path, look):
        loaded = database.load(path)
        path.unlink()
        with pytest.raises(DatabaseError, match="is no longer there; load it from where it is now") as caught:
            look(loaded)
        assert caught.value.file == path

    @pytest.mark.parametrize("look", [lambda m: m.intersections.read_cloud(0), lambda m: m.contours])
    def test_a_file_changed_meanwhile(self, path, look):
        loaded = database.load(path)
        database.save(some_map((300, 0, 40_000, 7)), path)
        with pytest.raises(DatabaseError, match="has changed since it was loaded; load it again"):
            look(loaded)

    def test_another_working_directory(self, path, tmp_path, monkeypatch):
        monkeypatch.chdir(tmp_path)
        loaded = database.load("m.h5")
        monkeypatch.chdir("/")
        assert len(loaded.intersections[0].cloud) == 300

    def test_a_map_read_from_a_file_is_written_to_the_same_bytes(self, path, tmp_path):
        database.save(database.load(path), tmp_path / "again.h5")
        assert (tmp_path / "again.h5").read_bytes() == path.read_bytes()
        before = path.read_bytes()
        database.save(database.load(path), path)
        assert path.read_bytes() == before

    def test_writing_keeps_a_few_clouds_at_a_time(self, tmp_path):
        clouds: list[weakref.ref] = []
        alive = []

        class Rows(Sequence):
            """Intersections that exist only while they are looked at."""

            def __len__(self):
                return 40

            def __getitem__(self, k):
                if k >= len(self):
                    raise IndexError
                one = place(k, 10_000, np.random.default_rng(k))
                clouds.append(weakref.ref(one.cloud))
                alive.append(sum(cloud() is not None for cloud in clouds))
                return one

        database.save(replace(some_map((3,)), intersections=Rows(), roadways=EMPTY), tmp_path / "s.h5")
        assert len(alive) == 40 and max(alive) <= 4
        loaded = database.load(tmp_path / "s.h5")
        assert_equal_values(loaded.intersections[39], place(39, 10_000, np.random.default_rng(39)))


def write_version_1(path: Path, semantic_map: SemanticMap) -> None:
    """The file that semmap 0.1.0 wrote before schema version 2."""
    places, roads = semantic_map.intersections, semantic_map.roadways
    with h5py.File(path, "w") as file:
        file.attrs.update({"format": "semmap-database", "schema_version": 1, "frame": "map", "origin": ORIGIN})
        file.attrs.update({"sources": "{}", "settings": json.dumps(semantic_map.settings)})
        group = file.create_group("intersections")
        group["id"] = np.array([p.id for p in places])
        group["p_map"] = np.array([p.p_map for p in places])
        group["kind"] = np.array([p.kind.encode() for p in places], "S16")
        group["branch_offsets"] = np.cumsum([0, *(len(p.branch_widths) for p in places)])
        group["branch_bearings"] = np.concatenate([p.branch_bearings for p in places])
        group["branch_widths"] = np.concatenate([p.branch_widths for p in places])
        for name in ("pwcv", "pwcv_observed", "cwc", "cwc_observed"):
            group[name] = np.array([getattr(p.contour, name) for p in places])
        group["cloud_offsets"] = np.cumsum([0, *(len(p.cloud) for p in places)])
        group["cloud_points"] = np.concatenate([p.cloud for p in places])
        group = file.create_group("roadways")
        for name in ("node_p_map", "node_intersection", "edge_nodes", "edge_length", "edge_width"):
            group[name] = getattr(roads, name)
        group["axis_offsets"] = np.cumsum([0, *map(len, roads.edge_axes)])
        group["axis_points"] = np.concatenate(roads.edge_axes)


def test_a_file_of_version_1_is_read_with_what_follows_from_it(tmp_path):
    written = some_map((300, 0, 5), crs=None)
    axes = (np.array([[0.0, 0.0, 10.0], [3.0, 4.0, 10.5], [3.0, 14.0, 13.0]]), np.empty((0, 3)))
    written = replace(written, roadways=replace(written.roadways, edge_axes=axes), sources={})
    write_version_1(tmp_path / "m.h5", written)
    loaded = database.load(tmp_path / "m.h5")
    expected = replace(
        written,
        intersections=tuple(replace(p, quality=float(p.contour.cwc_observed.mean())) for p in written.intersections),
        roadways=replace(
            written.roadways,
            node_kind=np.array(["intersection"] * 3 + ["dead_end"]),
            edge_height=np.zeros(2),
            edge_slope=np.array([3.0 / 15.0, 0.0]),
            edge_profiles=(np.zeros((3, 2)), np.zeros((0, 2))),
        ),
    )
    assert_equal_values(loaded, expected)
    database.save(loaded, tmp_path / "new.h5")
    assert_equal_values(database.load(tmp_path / "new.h5"), expected)


class TestSaveRefuses:
    """What `load` would not take is not written, and an old file stays."""

    def refuses(self, semantic_map: SemanticMap, tmp_path: Path, pattern: str) -> None:
        path = tmp_path / "m.h5"
        path.write_text("old")
        with pytest.raises(DatabaseError, match=pattern) as caught:
            database.save(semantic_map, path)
        assert caught.value.file == path
        assert path.read_text() == "old"
        assert os.listdir(tmp_path) == ["m.h5"]

    def changed(self, **values) -> SemanticMap:
        good = some_map()
        return replace(good, intersections=(replace(good.intersections[0], **values), *good.intersections[1:]))

    def test_positions_that_are_not_finite(self, tmp_path):
        self.refuses(self.changed(p_map=np.array([0, np.nan, 0])), tmp_path, r"intersections/p_map: holds NaN")

    @pytest.mark.parametrize("cloud", [np.full((2, 3), np.inf, np.float32), np.zeros((2, 2), np.float32)])
    def test_clouds_that_are_no_finite_points(self, tmp_path, cloud):
        self.refuses(self.changed(cloud=cloud), tmp_path, r"intersection 0: has a cloud that is not \(n, 3\) finite")

    def test_contours_with_a_wall_behind(self, tmp_path):
        contour = some_map().intersections[0].contour
        self.refuses(self.changed(contour=replace(contour, cwc=-contour.cwc)), tmp_path, "cwc: holds a negative dist")

    def test_a_profile_that_does_not_follow_its_axis(self, tmp_path):
        good = some_map()
        lost = replace(good.roadways, edge_profiles=good.roadways.edge_profiles[::-1])
        self.refuses(replace(good, roadways=lost), tmp_path, "axis_profile: do not have one row a point")

    def test_ids_given_twice(self, tmp_path):
        self.refuses(self.changed(id=7), tmp_path, r"intersections/id: holds an id twice")

    def test_unknown_kinds(self, tmp_path):
        self.refuses(self.changed(kind="Z"), tmp_path, r"kind: holds 'Z', which is none of L, T, Y, X, multi")

    def test_bearings_out_of_order(self, tmp_path):
        self.refuses(self.changed(branch_bearings=np.array([3.0, 1, 2])), tmp_path, "are not ascending")

    def test_widths_that_do_not_match_the_bearings(self, tmp_path):
        self.refuses(self.changed(branch_widths=np.ones(2)), tmp_path, "intersection 0: has not one width a branch")

    def test_contours_of_several_sizes(self, tmp_path):
        contour = some_map().intersections[0].contour
        small = replace(contour, pwcv=contour.pwcv[:18], pwcv_observed=contour.pwcv_observed[:18])
        self.refuses(self.changed(contour=small), tmp_path, "contours differ")

    def test_roadways_to_nowhere(self, tmp_path):
        good = some_map()
        lost = replace(good.roadways, edge_nodes=np.array([[0, 99], [1, 1]]))
        self.refuses(replace(good, roadways=lost), tmp_path, r"roadways/edge_nodes: names a node that is not there")

    def test_a_place_that_cannot_be_written(self, tmp_path):
        with pytest.raises(InputFileError, match="is a directory"):
            database.save(some_map(), tmp_path)


@pytest.fixture(scope="module")
def good(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("database") / "good.h5"
    database.save(some_map(), path)
    return path


def set_value(name, index, value):
    def change(file):
        file[name][index] = value

    return change


def set_attribute(name, value):
    def change(file):
        file.attrs[name] = value

    return change


def rewrite(name, make):
    """Replace a data set by what ``make`` makes of its values."""

    def change(file):
        values = file[name][()]
        del file[name]
        file[name] = make(values)

    return change


def link(name, target):
    def change(file):
        del file[name]
        file[name] = target

    return change


def as_objects(file):
    del file["intersections/kind"]
    file["intersections"].create_dataset("kind", data=["T", "X", "multi"], dtype=h5py.string_dtype())


def as_virtual(file):
    del file["intersections/id"]
    layout = h5py.VirtualLayout((3,), np.int64)
    layout[:] = h5py.VirtualSource("elsewhere.h5", "id", (3,))
    file["intersections"].create_virtual_dataset("id", layout)


def as_external(file):
    del file["intersections/id"]
    file["intersections"].create_dataset("id", (3,), np.int64, external=[("/etc/hostname", 0, 24)])


def as_huge(file):
    del file["intersections/cloud_points"]
    file["intersections"].create_dataset("cloud_points", (1 << 45, 3), np.float32, chunks=(1024, 3))


CORRUPT = {
    "no format": (lambda f: f.attrs.__delitem__("format"), "is an HDF5 file, but not a semantic database"),
    "other format": (set_attribute("format", "kitchen"), "but not a semantic database"),
    "format a number": (set_attribute("format", 3), "format: is missing or not text"),
    "newer version": (
        set_attribute("schema_version", 3),
        "schema_version: is of schema version 3, this program reads 1 to 2",
    ),
    "version zero": (set_attribute("schema_version", 0), "is of schema version 0, this program reads 1 to 2"),
    "version text": (set_attribute("schema_version", "one"), "schema_version: is not a whole number"),
    "no frame": (lambda f: f.attrs.__delitem__("frame"), "frame: is missing or not text"),
    "origin of two": (set_attribute("origin", np.zeros(2)), "origin: is not 3 numbers"),
    "origin text": (set_attribute("origin", "zero"), "origin: is not 3 numbers"),
    "origin NaN": (set_attribute("origin", np.full(3, np.nan)), "origin: is not finite"),
    "settings no JSON": (set_attribute("settings", "{"), "settings: is not JSON"),
    "settings a list": (set_attribute("settings", "[1]"), "settings: is not a mapping"),
    "sources pickled": (set_attribute("sources", np.void(b"\x80\x04.")), "sources: is missing or not text"),
    "no intersections": (lambda f: f.__delitem__("intersections"), "intersections: is missing or not a group"),
    "width one short": (rewrite("roadways/edge_width", lambda v: v[:1]), "roadways/edge_width: has shape"),
    "group linked out": (link("roadways", h5py.ExternalLink("x.h5", "/")), "roadways: is missing or not a group"),
    "no ids": (lambda f: f.__delitem__("intersections/id"), "intersections/id: is missing or a link"),
    "soft link": (link("intersections/id", h5py.SoftLink("/roadways/node_intersection")), "id: is missing or a link"),
    "external link": (link("intersections/id", h5py.ExternalLink("x.h5", "/id")), "id: is missing or a link"),
    "virtual": (as_virtual, "id: is not a data set of this file"),
    "external storage": (as_external, "id: is not a data set of this file"),
    "objects": (as_objects, "kind: is of type object"),
    "huge": (as_huge, r"cloud_points: claims 4\d+ bytes and holds 0"),
    "id twice": (set_value("intersections/id", 0, 7), "id: holds an id twice"),
    "negative id": (set_value("intersections/id", 0, -3), "id: holds an id twice, or a negative one"),
    "float ids": (rewrite("intersections/id", lambda v: v.astype(float)), "id: is of type float64, not int64"),
    "position NaN": (set_value("intersections/p_map", (1, 2), np.nan), "p_map: holds NaN or infinity"),
    "position flat": (rewrite("intersections/p_map", np.ravel), r"p_map: has shape \(9,\), not \(3, 3\)"),
    "kind unknown": (set_value("intersections/kind", 0, b"Q"), "kind: holds 'Q'"),
    "kind not ascii": (set_value("intersections/kind", 0, b"\xff"), "kind: holds"),
    "offsets fall": (set_value("intersections/cloud_offsets", 1, 20001), "cloud_offsets: do not divide the 20005"),
    "offsets from 1": (set_value("intersections/cloud_offsets", 0, 1), "cloud_offsets: do not divide"),
    "offsets too long": (set_value("intersections/branch_offsets", 3, 99), "branch_offsets: do not divide the 10"),
    "offsets one short": (rewrite("intersections/branch_offsets", lambda v: v[:-1]), "branch_offsets: has shape"),
    "cloud double": (rewrite("intersections/cloud_points", np.float64), "cloud_points: is of type float64"),
    "cloud infinite": (set_value("intersections/cloud_points", (9, 0), np.inf), "cloud_points: holds NaN or inf"),
    "bearing of four pi": (set_value("intersections/branch_bearings", 2, 12.0), "branch_bearings: are not ascending"),
    "width negative": (set_value("intersections/branch_widths", 2, -1.0), "branch_widths: holds a negative number"),
    "sectors differ": (rewrite("intersections/pwcv", lambda v: v[:, :-1]), "pwcv: has shape"),
    "distance negative": (set_value("intersections/cwc", (0, 0, 0), -1.0), "cwc: holds a negative distance"),
    "observed as bytes": (rewrite("intersections/cwc_observed", np.uint8), "cwc_observed: is of type uint8, not bool"),
    "unknown node": (set_value("roadways/edge_nodes", (0, 0), 40), "edge_nodes: names a node that is not there"),
    "unknown intersection": (set_value("roadways/node_intersection", 0, 5), "node_intersection: names an inter"),
    "length negative": (set_value("roadways/edge_length", 0, -1.0), "edge_length: holds a negative number"),
    "height negative": (set_value("roadways/edge_height", 0, -1.0), "edge_height: holds a negative number"),
    "profile negative": (set_value("roadways/axis_profile", (0, 1), -1.0), "axis_profile: holds a negative number"),
    "profile cut": (rewrite("roadways/axis_profile", lambda v: v[:-1]), "axis_profile: has shape"),
    "slope NaN": (set_value("roadways/edge_slope", 0, np.nan), "edge_slope: holds NaN"),
    "node kind unknown": (set_value("roadways/node_kind", 3, b"shaft"), "node_kind: holds 'shaft'"),
    "node kind wrong": (set_value("roadways/node_kind", 0, b"hall"), "node_kind: does not agree with"),
    "quality of two": (set_value("intersections/quality", 0, 2.0), "quality: is not between 0 and 1"),
    "axis cut": (rewrite("roadways/axis_points", lambda v: v[:-1]), "axis_offsets: do not divide the 4 rows"),
}


@pytest.mark.parametrize("name", CORRUPT)
def test_corrupt_databases(name, good, tmp_path):
    change, pattern = CORRUPT[name]
    path = tmp_path / "m.h5"
    shutil.copy(good, path)
    with h5py.File(path, "r+") as file:
        change(file)
    with pytest.raises(DatabaseError, match=pattern) as caught:
        read_all(path)
    assert_one_line_that_names(path, caught.value)


def read_all(path: Path) -> None:
    """Open a database and look at all of it."""
    for place in database.load(path).intersections:
        assert len(place.contour.pwcv) and len(place.cloud) >= 0


def assert_one_line_that_names(path: Path, error: DatabaseError) -> None:
    assert str(error).startswith(str(path))
    assert "\n" not in str(error)
    assert error.mend
    assert error.__cause__ is None


@pytest.mark.parametrize("share", [0.0, 0.001, 0.1, 0.5, 0.9, 0.999])
def test_databases_cut_off(share, good, tmp_path):
    path = tmp_path / "m.h5"
    data = good.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    with pytest.raises(DatabaseError) as caught:
        database.load(path)
    assert_one_line_that_names(path, caught.value)


@pytest.mark.parametrize("seed", range(30))
def test_databases_with_a_hole_are_refused_or_read_but_never_crash(seed, good, tmp_path):
    data = bytearray(good.read_bytes())
    rng = np.random.default_rng(seed)
    start = int(rng.integers(0, 8000 if seed % 2 else len(data) - 64))
    data[start : start + 64] = rng.bytes(64)
    path = tmp_path / "m.h5"
    path.write_bytes(data)
    try:
        read_all(path)
    except DatabaseError as error:
        assert_one_line_that_names(path, error)


@pytest.mark.parametrize(
    ("content", "pattern"),
    [(None, "no such file"), (b"", "not HDF5"), (b"hello", "not HDF5"), (b"\x89HDF\r\n\x1a\n", "is damaged")],
)
def test_files_that_are_none(content, pattern, tmp_path):
    path = tmp_path / "m.h5"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(DatabaseError, match=pattern):
        database.load(path)
    with pytest.raises(DatabaseError, match="no such file"):
        database.load(tmp_path)
