"""What a small mine, its database and its recording look like: made for tests that need files, not physics."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from maps.settings import MapSettings
from semmap.intersections import Intersection, RoadwayGraph, SemanticMap, WallContour
from semmap.measurements import ImuSample, Measurement, Scan, WheelSpeed
from semmap.recordings import RecordingWriter, Storage
from semmap.rig import Rig

RIG = {
    "frame": "map",
    "imu": {"topic": "/imu/data", "rate_hz": 200},
    "lidar": {"topic": "/lidar/points", "rate_hz": 10, "p_imu_lidar": [0.05, 0.0, 0.12]},
    "wheel": {"topic": "/wheel/twist", "p_imu_wheel": [-0.1, 0.0, -0.35]},
}


def small_stream(seconds: float = 2.0) -> list[Measurement]:
    """A robot at rest in a square room: IMU at 200 Hz, wheel at 50 Hz, a scan every tenth of a second."""
    rng = np.random.default_rng(0)
    start = 1_700_000_000_000_000_000
    stream: list[tuple[int, Measurement]] = []
    for i in range(int(200 * seconds)):
        stamp = start + i * 5_000_000
        gyro, accel = rng.normal(0.0, 1e-3, 3), rng.normal(0.0, 1e-2, 3) + np.array([0.0, 0.0, 9.81])
        stream.append((stamp, ImuSample(stamp, gyro, accel)))
        if i % 4 == 0:
            stream.append((stamp, WheelSpeed(stamp, 0.0)))
    for i in range(int(10 * seconds) - 1):
        stamp = start + i * 100_000_000
        angle = np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False)
        reach = 3.0 / np.maximum(np.abs(np.cos(angle)), np.abs(np.sin(angle)))
        height = rng.uniform(-1.0, 1.5, 400)
        points = np.stack([reach * np.cos(angle), reach * np.sin(angle), height], axis=-1)
        offsets = np.linspace(0, 99_000_000, 400).astype(np.int64)
        scan = Scan(stamp, points.astype(np.float32), offsets)
        stream.append((scan.end_ns, scan))
    return [measurement for _, measurement in sorted(stream, key=lambda pair: pair[0])]


def write_recording(path: Path, rig_file: Path, storage: Storage = "mcap") -> Path:
    """`small_stream` as a recording at ``path``."""
    with RecordingWriter(path, Rig.from_yaml(rig_file), storage) as writer:
        for measurement in small_stream():
            writer.write(measurement)
    return path


def _intersection(id: int, p_map: np.ndarray, kind: str) -> Intersection:
    settings = MapSettings()
    sectors, layers = settings.contour.sectors, settings.contour.layers
    rng = np.random.default_rng(id)
    pwcv = rng.uniform(2.0, 6.0, sectors).astype(np.float32)
    pwcv[:5] = 0.0
    seen = np.arange(sectors) >= 12
    contour = WallContour(pwcv, seen, np.tile(pwcv, (layers, 1)), np.tile(seen, (layers, 1)))
    cloud = rng.normal(0.0, 3.0, (200, 3)).astype(np.float32)
    bearings = {"T": [0.1, 2.0, 4.0], "X": [0.1, 1.6, 3.2, 4.8]}[kind]
    return Intersection(id, p_map, kind, np.array(bearings), np.full(len(bearings), 4.0), 0.9, contour, cloud)


def small_map() -> SemanticMap:
    """Two intersections and a dead end, in the millions of metres of a mine grid."""
    p = np.array([600_000.0, 5_400_000.0, 200.0]) + np.array([[0.0, 0.0, 0.0], [30.0, 5.0, 0.0], [60.0, 5.0, 0.0]])
    graph = RoadwayGraph(
        node_p_map=p,
        node_intersection=np.array([3, 8, -1]),
        node_kind=np.array(["intersection", "intersection", "dead_end"]),
        edge_nodes=np.array([[0, 1], [1, 2]]),
        edge_length=np.linalg.norm(np.diff(p, axis=0), axis=1),
        edge_width=np.array([4.0, 4.0]),
        edge_height=np.array([3.0, 0.0]),
        edge_slope=np.zeros(2),
        edge_axes=(p[:2], p[1:]),
        edge_profiles=(np.array([[4.0, 3.0], [4.0, 3.0]]), np.array([[4.0, 0.0], [4.0, 0.0]])),
    )
    intersections = (_intersection(3, p[0], "T"), _intersection(8, p[1], "X"))
    settings = MapSettings().model_dump(mode="json")
    return SemanticMap(intersections, graph, p[0], settings, {"mine.laz": "0" * 64})
