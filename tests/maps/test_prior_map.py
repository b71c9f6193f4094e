"""Prior maps in every format: the same points come out, to the precision of the file, with a float64 origin."""

import hashlib
import shutil
import struct
from pathlib import Path

import laspy
import lazrs
import numpy as np
import pye57
import pytest
from laspy.vlrs.known import GeoKeyDirectoryVlr, LasZipVlr
from numpy.testing import assert_allclose, assert_array_equal

from maps._numba_lzf import lzf_decompress
from maps.e57 import from_spherical
from maps.las import save_laz
from maps.prior_map import Piece, PriorMap, blocks, read_prior_map, survey
from semmap.errors import CloudError, InputFileError, SemmapError
from semmap.geometry import so3_exp

N = 1500
BENCHMARK = Path(__file__).resolve().parents[3] / "shared" / "data" / "edgar_mine"


def mine(n: int = N, at=(0.0, 0.0, 0.0), seed: int = 0) -> np.ndarray:
    """Points (n, 3) float64 [m], to the millimetre, around a place."""
    return np.round(np.random.default_rng(seed).uniform(-40, 40, (n, 3)), 3) + np.asarray(at)


def coordinates_of(prior: PriorMap) -> np.ndarray:
    return prior.points.astype(np.float64) + prior.origin


def lzf_compress(data: bytes) -> bytes:
    """A plain LZF compressor: references back wherever three bytes repeat."""
    out, literals, seen, i = bytearray(), bytearray(), {}, 0

    def flush():
        while literals:
            run = literals[:32]
            out.append(len(run) - 1)
            out.extend(run)
            del literals[:32]

    while i < len(data):
        key = data[i : i + 3]
        start = seen.get(key, -1)
        seen[key] = i
        if len(key) == 3 and start >= 0 and i - start <= 8192:
            length = 3
            while i + length < len(data) and length < 264 and data[start + length] == data[i + length]:
                length += 1
            flush()
            back = i - start - 1
            if length < 9:
                out.extend([((length - 2) << 5) | (back >> 8), back & 255])
            else:
                out.extend([(7 << 5) | (back >> 8), length - 9, back & 255])
            i += length
        else:
            literals.append(data[i])
            i += 1
    flush()
    return bytes(out)


def write_pcd(path: Path, table: np.ndarray, encoding: str) -> Path:
    kinds = {"f": "F", "i": "I", "u": "U"}
    names = table.dtype.names
    header = [
        "# .PCD v0.7 - Point Cloud Data file format",
        "VERSION 0.7",
        "FIELDS " + " ".join(names),
        "SIZE " + " ".join(str(table.dtype[n].base.itemsize) for n in names),
        "TYPE " + " ".join(kinds[table.dtype[n].base.kind] for n in names),
        "COUNT " + " ".join(str(int(np.prod(table.dtype[n].shape))) for n in names),
        f"WIDTH {len(table)}",
        "HEIGHT 1",
        "VIEWPOINT 0 0 0 1 0 0 0",
        f"POINTS {len(table)}",
        f"DATA {encoding}",
    ]
    if encoding == "ascii":
        rows = [" ".join(repr(v.item()) for n in names for v in np.atleast_1d(row[n])) for row in table]
        body = ("\n".join(rows) + "\n").encode()
    elif encoding == "binary":
        body = table.tobytes()
    else:
        columns = b"".join(np.ascontiguousarray(table[n]).tobytes() for n in names)
        packed = lzf_compress(columns)
        body = np.array([len(packed), len(columns)], "<u4").tobytes() + packed
    path.write_bytes("\n".join(header).encode() + b"\n" + body)
    return path


def write_ply(path: Path, points: np.ndarray, encoding: str, dtype: str, *, faces: bool = True) -> Path:
    order = ">" if "big" in encoding else "<"
    kind = {"f4": "float", "f8": "double"}[dtype]
    names = ["x", "y", "z", "red"]
    header = ["ply", f"format {encoding} 1.0", "comment made by hand", f"element vertex {len(points)}"]
    header += [f"property {kind} {a}" for a in "xyz"] + ["property uchar red"]
    header += ["element face 2", "property list uchar int vertex_indices"] if faces else []
    table = np.zeros(len(points), [(n, order + ("u1" if n == "red" else dtype)) for n in names])
    for k, axis in enumerate("xyz"):
        table[axis] = points[:, k]
    if encoding == "ascii":
        body = "".join(" ".join(repr(v.item()) for v in row) + "\n" for row in table).encode()
        body += b"3 0 1 2\n3 1 2 3\n" if faces else b""
    else:
        face = b"\x03" + np.array([0, 1, 2], order + "i4").tobytes()
        body = table.tobytes() + (2 * face if faces else b"")
    path.write_bytes("\n".join([*header, "end_header"]).encode() + b"\n" + body)
    return path


def xyz_table(points: np.ndarray, dtype: str) -> np.ndarray:
    columns = [("rgb", "u4"), ("x", dtype), ("y", dtype), ("_", "u1", (4,)), ("z", dtype), ("_", "f4")]
    names = [c[0] if c[0] != "_" else f"pad{k}" for k, c in enumerate(columns)]
    table = np.zeros(len(points), [(n, *c[1:]) for n, c in zip(names, columns, strict=True)])
    for k, axis in enumerate("xyz"):
        table[axis] = points[:, k]
    return table


def write_e57(path: Path, scans) -> Path:
    """``scans``: points in the scanner's frame, rotation as a quaternion w x y z, position."""
    with pye57.E57(str(path), mode="w") as file:
        for points, rotation, position in scans:
            data = {f"cartesian{a}": np.ascontiguousarray(points[:, k]) for k, a in enumerate("XYZ")}
            file.write_scan_raw(data, rotation=np.array(rotation), translation=np.array(position))
    return path


def write_copc(path: Path, points: np.ndarray) -> Path:
    """LAZ as COPC lays it out: chunks of varying size, an info record first, and a hierarchy record at the end."""
    las = laspy.LasData(laspy.LasHeader(version="1.4", point_format=6))
    las.header.scales = np.full(3, 1e-3)
    las.x, las.y, las.z = points.T
    las.update_header()
    packing = lazrs.LazVlr.new_for_compression(6, 0, True)
    las.header.vlrs.append(laspy.VLR("copc", 1, "COPC info", bytes(160)))
    las.header.vlrs.append(LasZipVlr(bytes(packing.record_data())))
    las.header.are_points_compressed = True
    las.header.number_of_evlrs = 1
    with path.open("wb") as file:
        las.header.write_to(file)
        compressor = lazrs.LasZipCompressor(file, packing)
        compressor.reserve_offset_to_chunk_table()
        for part in np.split(las.points.array, [100, 101, 700]):
            compressor.compress_many(np.frombuffer(part.tobytes(), np.uint8))
            compressor.finish_current_chunk()
        compressor.done()
        las.header.start_of_first_evlr = file.tell()
        file.write(struct.pack("<H16sHQ32s", 0, b"copc", 1000, 32, b"") + bytes(32))
        file.seek(0)
        las.header.write_to(file)
    return path


FORMATS = {
    "laz": lambda p, x: save_laz(p.with_suffix(".laz"), x) or p.with_suffix(".laz"),
    "las": lambda p, x: save_laz(p.with_suffix(".las"), x) or p.with_suffix(".las"),
    "pcd ascii": lambda p, x: write_pcd(p, xyz_table(x, "f8"), "ascii"),
    "pcd binary": lambda p, x: write_pcd(p, xyz_table(x, "f8"), "binary"),
    "pcd compressed": lambda p, x: write_pcd(p, xyz_table(x, "f8"), "binary_compressed"),
    "ply ascii": lambda p, x: write_ply(p, x, "ascii", "f8"),
    "ply little": lambda p, x: write_ply(p, x, "binary_little_endian", "f8"),
    "ply big": lambda p, x: write_ply(p, x, "binary_big_endian", "f8"),
    "ply bare": lambda p, x: write_ply(p, x, "binary_little_endian", "f8", faces=False),
    "e57": lambda p, x: write_e57(p, [(x - x[0], [1.0, 0, 0, 0], x[0])]),
}


class TestFormats:
    @pytest.mark.parametrize("at", [(0, 0, 0), (5_712_345.678, 34_012_345.0, -612.0)], ids=["local", "mine grid"])
    @pytest.mark.parametrize("name", FORMATS)
    def test_every_format_keeps_the_millimetres(self, tmp_path, name, at):
        points = mine(at=at)
        path = FORMATS[name](tmp_path / "cloud", points)
        prior = read_prior_map(path)
        assert prior.points.dtype == np.float32
        assert_allclose(coordinates_of(prior), points, rtol=0, atol=1.01e-3 if "la" in name else 1e-4)
        assert prior.sources == {path.name: hashlib.sha256(path.read_bytes()).hexdigest()}
        assert prior.n_dropped == 0

    @pytest.mark.parametrize("encoding", ["ascii", "binary", "binary_compressed"])
    @pytest.mark.parametrize("dtype", ["f4", "i2", "i4"])
    def test_pcd_of_other_number_types(self, tmp_path, encoding, dtype):
        points = np.round(mine()).astype(dtype).astype(float)
        prior = read_prior_map(write_pcd(tmp_path / "c.pcd", xyz_table(points, dtype), encoding))
        assert_array_equal(prior.points, points)

    def test_float_ply(self, tmp_path):
        path = write_ply(tmp_path / "c.ply", mine(), "binary_big_endian", "f4")
        assert_array_equal(read_prior_map(path).points, mine().astype(np.float32))

    def test_ply_with_windows_line_ends(self, tmp_path):
        path = write_ply(tmp_path / "c.ply", mine(), "ascii", "f8")
        path.write_bytes(path.read_bytes().replace(b"\n", b"\r\n"))
        assert_allclose(read_prior_map(path).points, mine(), atol=1e-5)

    def test_a_ply_element_before_the_vertices_is_passed_over(self, tmp_path):
        path = write_ply(tmp_path / "c.ply", mine(), "binary_little_endian", "f8")
        camera = b"element camera 2\nproperty float view\nproperty uchar id\n"
        head, body = path.read_bytes().split(b"end_header\n", 1)
        head = head.replace(b"element vertex", camera + b"element vertex")
        path.write_bytes(head + b"end_header\n" + bytes(10) + body)
        assert_allclose(read_prior_map(path).points, mine(), atol=1e-5)

    def test_the_content_decides_not_the_name(self, tmp_path):
        path = write_ply(tmp_path / "cloud.pcd", mine(), "ascii", "f8")
        assert len(read_prior_map(path)) == N

    def test_every_e57_scan_is_put_into_its_pose(self, tmp_path):
        points, half_turn = mine(), np.array([np.sqrt(0.5), 0, 0, np.sqrt(0.5)])
        R = so3_exp([0, 0, np.pi / 2])
        position = np.array([1000.0, 2000.0, -300.0])
        scans = [(points[:700], [1.0, 0, 0, 0], [0.0, 0, 0]), ((points[700:] - position) @ R, half_turn, position)]
        prior = read_prior_map(write_e57(tmp_path / "c.e57", scans))
        assert_allclose(coordinates_of(prior), points, rtol=0, atol=5e-4)

    def test_e57_points_marked_as_invalid_are_dropped(self, tmp_path):
        data = {f"cartesian{axis}": np.ascontiguousarray(mine()[:, k]) for k, axis in enumerate("XYZ")}
        data["cartesianInvalidState"] = (np.arange(N) < 3).astype(np.int8)
        with pye57.E57(str(tmp_path / "c.e57"), mode="w") as file:
            file.write_scan_raw(data)
        prior = read_prior_map(tmp_path / "c.e57")
        assert prior.n_dropped == 3
        assert_allclose(prior.points, mine()[3:], atol=1e-4)

    def test_spherical_coordinates(self):
        points = mine()
        distance = np.linalg.norm(points, axis=1)
        azimuth, elevation = np.arctan2(points[:, 1], points[:, 0]), np.arcsin(points[:, 2] / distance)
        assert_allclose(from_spherical(np.stack([distance, azimuth, elevation], axis=1)), points, atol=1e-12)

    @pytest.mark.parametrize("name", FORMATS)
    def test_in_blocks_it_is_the_same_cloud(self, tmp_path, name):
        path = FORMATS[name](tmp_path / "cloud", mine(at=(5_712_345.678, 34_012_345.0, -612.0)))
        found = survey(path)
        parts = [points for piece in found.pieces for points, _ in blocks(piece, found.origin, 97)]
        assert max(map(len, parts)) == 97
        whole = read_prior_map(path)
        assert_array_equal(found.origin, whole.origin)
        assert_array_equal(np.concatenate(parts), whole.points)

    @pytest.mark.parametrize("name", ["laz", "las", "pcd binary", "ply little", "ply big", "ply bare"])
    def test_pieces_are_read_without_what_is_before_them(self, tmp_path, name):
        path = FORMATS[name](tmp_path / "cloud", mine())
        pieces = [Piece(path, low, min(low + 400, N), 0) for low in range(0, N, 400)]
        found = [points for piece in pieces for points, _ in blocks(piece, np.zeros(3), 150)]
        assert_array_equal(np.concatenate(found), read_prior_map(path).points)

    def test_lzf_copies_runs_that_overlap_themselves(self):
        data = np.frombuffer(b"abc" * 500 + bytes(3000) + bytes(range(256)), np.uint8)
        out = np.empty_like(data)
        assert lzf_decompress(np.frombuffer(lzf_compress(data.tobytes()), np.uint8), out) == len(data)
        assert_array_equal(out, data)


class TestOrigin:
    def test_a_local_grid_keeps_origin_zero(self, tmp_path):
        save_laz(tmp_path / "m.laz", mine(at=(2800, -1900, 4900)))
        assert_array_equal(read_prior_map(tmp_path / "m.laz").origin, np.zeros(3))

    def test_a_mine_grid_has_a_round_origin_near_the_mine(self, tmp_path):
        save_laz(tmp_path / "m.laz", mine(at=(5_712_345, -33_999_700, -612)))
        prior = read_prior_map(tmp_path / "m.laz")
        assert_array_equal(prior.origin, [5_712_000, -34_000_000, 0])
        assert np.abs(prior.points).max() < 1000

    def test_a_shift_of_whole_kilometres_changes_nothing_but_the_origin(self, tmp_path):
        shift = np.array([3e6, 7e6, 0])
        save_laz(tmp_path / "a.laz", mine(at=(9e6, 9e6, 0)))
        save_laz(tmp_path / "b.laz", mine(at=(9e6, 9e6, 0)) + shift)
        a, b = read_prior_map(tmp_path / "a.laz"), read_prior_map(tmp_path / "b.laz")
        assert_array_equal(b.origin - a.origin, shift)
        assert_allclose(a.points, b.points, atol=1e-6)

    def test_several_files_share_one_origin_in_any_order(self, tmp_path):
        tiles = [mine(at=(1e6 + 900 * k, 2e6, 0), seed=k) for k in range(3)]
        paths = [FORMATS[name](tmp_path / name.replace(" ", "."), x) for name, x in zip(
            ("laz", "ply little", "pcd binary"), tiles, strict=True)]  # fmt: skip
        forth, back = read_prior_map(paths), read_prior_map(paths[::-1])
        assert_array_equal(forth.origin, back.origin)
        assert_allclose(coordinates_of(forth), np.concatenate(tiles), atol=1.01e-3)
        assert_allclose(coordinates_of(back), np.concatenate(tiles[::-1]), atol=1.01e-3)
        assert list(forth.sources) == [path.name for path in paths]


class TestLaz:
    def test_a_large_file_comes_in_pieces(self, tmp_path, monkeypatch):
        monkeypatch.setattr("maps.las.PIECE_POINTS", 60_001)
        save_laz(tmp_path / "m.laz", mine(200_003))
        pieces = survey(tmp_path / "m.laz").pieces
        assert [piece.stop for piece in pieces] == [60_001, 120_002, 180_003, 200_003]
        assert sum(piece.share for piece in pieces) == (tmp_path / "m.laz").stat().st_size
        found = [points for piece in pieces for points, _ in blocks(piece, np.zeros(3), 25_000)]
        assert_allclose(np.concatenate(found), mine(200_003), atol=1e-3)

    def test_copc_with_its_chunks_of_many_sizes_is_read_in_one_go(self, tmp_path, monkeypatch):
        monkeypatch.setattr("maps.las.PIECE_POINTS", 400)
        path = write_copc(tmp_path / "m.copc.laz", mine())
        assert len(survey(path).pieces) == 1
        assert_allclose(read_prior_map(path).points, mine(), atol=1e-3)

    def test_the_same_points_give_the_same_bytes(self, tmp_path):
        for name in "ab":
            save_laz(tmp_path / f"{name}.laz", mine(), crs="LOCAL_CS[]")
        assert (tmp_path / "a.laz").read_bytes() == (tmp_path / "b.laz").read_bytes()

    def test_the_coordinate_system_is_kept(self, tmp_path):
        save_laz(tmp_path / "m.laz", mine(), crs='PROJCS["Mine grid"]')
        assert read_prior_map(tmp_path / "m.laz").crs == 'PROJCS["Mine grid"]'
        save_laz(tmp_path / "n.laz", mine())
        assert read_prior_map([tmp_path / "m.laz", tmp_path / "n.laz"]).crs == 'PROJCS["Mine grid"]'

    def test_points_marked_as_noise_or_withheld_are_dropped(self, tmp_path):
        las = laspy.LasData(laspy.LasHeader(version="1.4", point_format=6))
        las.x, las.y, las.z = mine().T
        las.classification[:5] = 7
        las.classification[5:9] = 18
        las.withheld[9:10] = 1
        las.write(str(tmp_path / "m.las"))
        prior = read_prior_map(tmp_path / "m.las")
        assert prior.n_dropped == 10
        assert_allclose(coordinates_of(prior), mine()[10:], atol=0.0051)

    def test_an_epsg_code_from_geotiff_keys(self, tmp_path):
        header = laspy.LasHeader(version="1.2", point_format=0)
        keys = GeoKeyDirectoryVlr()
        keys.parse_record_data(np.array([1, 1, 0, 1, 3072, 0, 1, 25832], "<u2").tobytes())
        header.vlrs.append(keys)
        las = laspy.LasData(header)
        las.x, las.y, las.z = mine().T
        las.write(str(tmp_path / "m.las"))
        assert read_prior_map(tmp_path / "m.las").crs == "EPSG:25832"

    def test_two_coordinate_systems_do_not_mix(self, tmp_path):
        for name in ("one", "two"):
            save_laz(tmp_path / f"{name}.laz", mine(), crs=name)
        with pytest.raises(InputFileError, match=r"two\.laz: is in another coordinate system"):
            read_prior_map([tmp_path / "one.laz", tmp_path / "two.laz"])

    @pytest.mark.parametrize(
        ("points", "pattern"),
        [
            (np.empty((0, 3)), "is empty or not finite"),
            ([[0, 0, np.nan]], "is empty or not finite"),
            ([[0, 0, 0], [5e6, 0, 0]], "spreads over more than 2000 km"),
        ],
    )
    def test_points_that_make_no_map_are_not_written(self, tmp_path, points, pattern):
        with pytest.raises(CloudError, match=pattern):
            save_laz(tmp_path / "m.laz", points)
        assert not (tmp_path / "m.laz").exists()

    def test_progress_ends_at_the_bytes_of_all_files(self, tmp_path):
        paths = [FORMATS[name](tmp_path / name, mine()) for name in ("laz", "ply ascii")]
        seen = []
        read_prior_map(paths, progress=lambda done, total: seen.append((done, total)))
        total = sum(path.stat().st_size for path in paths)
        assert seen[-1] == (total, total)
        assert seen == sorted(seen)


def test_points_that_are_not_finite_are_dropped_and_counted(tmp_path):
    points = mine()
    points[3, 1], points[9], points[11, 0] = np.nan, 1e30, 5e4
    prior = read_prior_map(write_pcd(tmp_path / "c.pcd", xyz_table(points, "f8"), "binary"))
    assert prior.n_dropped == 3
    assert_allclose(prior.points, np.delete(points, [3, 9, 11], axis=0), atol=1e-5)


def edited(path: Path, old: bytes, new: bytes) -> Path:
    data = path.read_bytes()
    assert old in data
    path.write_bytes(data.replace(old, new, 1))
    return path


def text(path: Path, content: bytes) -> Path:
    path.write_bytes(content)
    return path


def pcd(p: Path, encoding: str = "binary", points=None) -> Path:
    return write_pcd(p, xyz_table(mine() if points is None else points, "f8"), encoding)


BAD = {
    "nothing there": (lambda p: p, InputFileError, "cannot be read .*check the path"),
    "a directory": (lambda p: (p.mkdir(), p)[1], InputFileError, "is a directory; name its"),
    "empty": (lambda p: text(p, b""), InputFileError, "is empty"),
    "text": (lambda p: text(p, b"1 2 3\n4 5 6\n"), InputFileError, "unknown format; convert it to PCD, PLY"),
    "too few": (lambda p: pcd(p, points=mine(999)), CloudError, "has 999 finite points of 999, fewer than 1000"),
    "no points": (lambda p: pcd(p, points=mine(0)), CloudError, "has 0 finite points of 0"),
    "no points in ascii": (lambda p: pcd(p, "ascii", mine(0)), CloudError, "has 0 finite points of 0"),
    "no points in PLY": (lambda p: write_ply(p, mine(0), "ascii", "f8"), CloudError, "has 0 finite points of 0"),
    "all NaN": (lambda p: pcd(p, points=mine() * np.nan), CloudError, "has 0 finite points of 1500"),
    "PCD without z": (
        lambda p: write_pcd(p, np.zeros(N, [("x", "f4"), ("y", "f4")]), "binary"),
        CloudError,
        "z: is missing; the file has x, y",
    ),
    "PCD without DATA": (lambda p: text(p, b"VERSION .7\nFIELDS x y z\n"), InputFileError, "has no SIZE line"),
    "PCD of another encoding": (lambda p: edited(pcd(p), b"DATA binary", b"DATA zip"), InputFileError, "DATA zip"),
    "PCD of a type of its own": (lambda p: edited(pcd(p), b"TYPE U", b"TYPE Q"), InputFileError, "not a readable PCD"),
    "PCD of columns that differ": (lambda p: edited(pcd(p), b"SIZE 4 ", b"SIZE "), InputFileError, "differ in length"),
    "ascii PCD with words": (
        lambda p: edited(pcd(p, "ascii"), b"DATA ascii\n", b"DATA ascii\na b c d e f g h i\n"),
        InputFileError,
        "could not convert",
    ),
    "PLY without end": (lambda p: text(p, b"ply\nformat ascii 1.0\n"), InputFileError, "its header does not end"),
    "PLY without vertices": (
        lambda p: edited(write_ply(p, mine(), "ascii", "f8"), b"element vertex", b"element corner"),
        InputFileError,
        "has no element vertex",
    ),
    "PLY of another format": (
        lambda p: edited(write_ply(p, mine(), "ascii", "f8"), b"ascii", b"utf-8"),
        InputFileError,
        "unknown format 'utf-8'",
    ),
    "PLY without y": (
        lambda p: edited(write_ply(p, mine(), "ascii", "f8"), b"double y", b"double v"),
        CloudError,
        "y: is missing; the file has x, v, z, red",
    ),
    "PLY with ragged vertices": (
        lambda p: edited(
            write_ply(p, mine(), "binary_little_endian", "f8"), b"property uchar", b"property list uchar int"
        ),
        InputFileError,
        "a list in element vertex",
    ),
    "PLY with short lines": (
        lambda p: edited(
            write_ply(p, mine(), "ascii", "f8"), b"property double z", b"property double z\nproperty int q"
        ),
        InputFileError,
        "not a readable PLY",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_maps_say_what_is_wrong_in_one_line(name, tmp_path):
    make, error, pattern = BAD[name]
    path = make(tmp_path / "map")
    with pytest.raises(error, match=pattern) as caught:
        read_prior_map(path)
    assert_one_line_that_names(path, caught.value)


def assert_one_line_that_names(path: Path, error: SemmapError) -> None:
    assert str(error).startswith(str(path))
    assert "\n" not in str(error)
    assert error.mend
    assert error.__cause__ is None


@pytest.mark.parametrize("share", [0.001, 0.05, 0.3, 0.7, 0.99])
@pytest.mark.parametrize("name", FORMATS)
def test_maps_cut_off(name, share, tmp_path):
    whole = FORMATS[name](tmp_path / "whole", mine())
    data = whole.read_bytes()
    path = text(tmp_path / f"cut{whole.suffix}", data[: int(share * len(data))])
    if name == "ply ascii" and share == 0.99:
        path = text(path, data[: data.rindex(b"\n3 0 1 2") - 30])
    if name in ("ply little", "ply big") and share == 0.99:
        path = text(path, data[:-30])
    with pytest.raises(SemmapError) as caught:
        read_prior_map(path)
    assert isinstance(caught.value, InputFileError | CloudError)
    assert_one_line_that_names(path, caught.value)


def test_a_name_given_twice_and_no_name_at_all(tmp_path):
    save_laz(tmp_path / "m.laz", mine())
    (tmp_path / "other").mkdir()
    shutil.copy(tmp_path / "m.laz", tmp_path / "other" / "m.laz")
    with pytest.raises(InputFileError, match="has the name of another map file"):
        read_prior_map([tmp_path / "m.laz", tmp_path / "other" / "m.laz"])
    with pytest.raises(CloudError, match="has 0 finite points"):
        read_prior_map([])


@pytest.mark.skipif(not BENCHMARK.exists(), reason="the benchmark mine is not beside the repository")
def test_the_benchmark_map():
    prior = read_prior_map(BENCHMARK / "prior_map.laz")
    assert len(prior) == 3_138_981
    assert_array_equal(prior.origin, np.zeros(3))
    assert 200 < np.ptp(prior.points[:, 0]) < 400
