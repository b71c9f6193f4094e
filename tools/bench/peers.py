"""Other people's odometries behind one interface: what they are fed, with which settings, and when their poses hold.

NumPy and the standard library only, and each peer is imported by the adapter that needs it: the file runs in the
peers' own Python environment too. Every adapter hands its peer the data in the form and order that the peer's own
readers do.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from importlib.metadata import distribution
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from tools.bench.odometry_cache import Array, OrganisedScan, Recorded

Settings = Mapping[str, Any]
GRAVITY = 9.80665


class Estimate(NamedTuple):
    """A pose (4, 4) of the IMU in the system's own frame at ``stamp_ns``, and its covariance (6, 6) if it tells.

    The covariance is of ``[θ, δp]`` with ``R Exp(θ)``, ``p + δp``, relative to the start.
    """

    stamp_ns: int
    pose: Array
    covariance: Array | None = None


class System(Protocol):
    """One odometry under test."""

    def imu(self, stamp_ns: int, gyro: Array, accel: Array) -> None:
        """Take an IMU sample in; timed, apart from the scans."""

    def prepare(self, scan: OrganisedScan) -> Any:
        """The scan in the system's own form; not timed."""

    def scan(self, prepared: Any) -> None:
        """Take a scan in; timed."""

    def estimates(self) -> list[Estimate]:
        """What is new since the last call; not timed."""


@dataclass(frozen=True, slots=True)
class Peer:
    """A system by name: ``package`` that brings it, how to make it, and its sets of settings.

    ``settings`` maps the name of a set to what it changes: ``shipped`` is the system as it comes, ``mine`` what
    its own documentation advises for 16 beams in narrow places.

    evalio's pipelines stamp a pose with the start of its scan whatever moment it belongs to; ``at`` in their settings
    says when it holds, as a share of the turn: 1 for those that deskew to the scan's end, a half for those that
    deskew to the middle or not at all (there the attitude fits the truth best, too).
    """

    package: str
    make: Callable[[Recorded, Settings], System]
    settings: Mapping[str, Settings]


class RkoLio:
    """RKO-LIO: absolute int64 nanoseconds; the IMU before the scan's end, then the scan, as its own sequencer does."""

    def __init__(self, recorded: Recorded, settings: Settings) -> None:
        from rko_lio.config import LIOConfig
        from rko_lio.lio import LIO

        lidar = recorded.about["rig"]["lidar"]
        limits = {"min_range": lidar["min_range"], "max_range": lidar["max_range"]} if settings else {}
        self._lio = LIO(LIOConfig(**{**limits, **settings}))
        self._T_imu_lidar = recorded.T_imu_lidar
        self._late: list[tuple[Array, Array, int]] = []
        self._new: list[Estimate] = []

    def imu(self, stamp_ns: int, gyro: Array, accel: Array) -> None:
        self._late.append((accel, gyro, stamp_ns))

    def prepare(self, scan: OrganisedScan) -> tuple[Array, NDArray[np.int64], int, int]:
        points, offsets_ns, _ = scan.returns()
        return points.astype(np.float64), offsets_ns + scan.stamp_ns, scan.stamp_ns, scan.end_ns

    def scan(self, prepared: tuple[Array, NDArray[np.int64], int, int]) -> None:
        points, stamps_ns, start_ns, end_ns = prepared
        before = sum(stamp < end_ns for _, _, stamp in self._late)
        for accel, gyro, stamp in self._late[:before]:
            self._lio.add_imu_measurement(accel, gyro, stamp)
        del self._late[:before]
        self._lio.register_scan(points, stamps_ns, self._T_imu_lidar, start_ns, end_ns)
        self._new.append(Estimate(end_ns, self._lio.pose()))

    def estimates(self) -> list[Estimate]:
        new, self._new = self._new, []
        return new


class GenzLio:
    """GenZ-LIO: each scan with the IMU rows that span it, times in seconds, point times after the scan's start."""

    def __init__(self, recorded: Recorded, settings: Settings) -> None:
        from genz_lio import Config, GenZLIO, load_config

        root = distribution("genz-lio").locate_file("genz_lio/configs")
        config: Any = load_config(f"{root}/{settings['file']}", Config())
        lidar = recorded.about["rig"]["lidar"]
        config.preprocess.scan_line = lidar["beams"]
        config.preprocess.blind_min, config.preprocess.blind_max = lidar["min_range"], lidar["max_range"]
        config.mapping.extrinsic_t = recorded.T_imu_lidar[:3, 3]
        config.mapping.extrinsic_r = recorded.T_imu_lidar[:3, :3]
        self._lio = GenZLIO(config)
        self._rows: list[Array] = []
        self._new: list[Estimate] = []

    def imu(self, stamp_ns: int, gyro: Array, accel: Array) -> None:
        self._rows.append(np.concatenate([[1e-9 * stamp_ns], accel, gyro]))

    def prepare(self, scan: OrganisedScan) -> tuple[Any, ...]:
        points, offsets_ns, beam = scan.returns()
        inside = [row for row in self._rows if row[0] <= 1e-9 * scan.end_ns]
        self._rows = self._rows[len(inside) :]
        begin, end = 1e-9 * scan.stamp_ns, 1e-9 * scan.end_ns
        return points.astype(np.float64), begin, end, np.array(inside), 1e-9 * offsets_ns, beam

    def scan(self, prepared: tuple[Any, ...]) -> None:
        points, begin, end, imu, times, beam = prepared
        result = self._lio.register_scan(points, begin, end, imu, timestamps=times, rings=beam)
        if result.valid:
            self._new.append(Estimate(round(1e9 * result.timestamp), result.pose))

    def estimates(self) -> list[Estimate]:
        new, self._new = self._new, []
        return new


class Evalio:
    """A pipeline of evalio: organised row-major clouds with all points, zeros where nothing came back."""

    def __init__(self, pipeline: str, recorded: Recorded, settings: Settings) -> None:
        from evalio import pipelines, types
        from evalio._cpp import helpers

        self._types, self._helpers = types, helpers
        chosen: Any = pipelines.get_pipeline(pipeline)
        self._pipeline = chosen()
        self._configure(recorded, {name: value for name, value in settings.items() if name != "at"})
        self._shift_ns = round(settings["at"] * int(recorded.offsets_ns[-1]))
        beams, columns = recorded.directions.shape[:2]
        kind = np.dtype([("xyz", np.float32, 3), ("t", np.uint32), ("ring", np.uint8)])
        self._cloud = np.zeros((beams, columns), kind)
        self._cloud["t"], self._cloud["ring"] = recorded.offsets_ns, np.arange(beams)[:, None]
        names = (
            ("x", 0, "FLOAT32"),
            ("y", 4, "FLOAT32"),
            ("z", 8, "FLOAT32"),
            ("t", 12, "UINT32"),
            ("ring", 16, "UINT8"),
        )
        self._fields = [
            helpers.Field(name=name, datatype=getattr(helpers.DataType, of), offset=offset)
            for name, offset, of in names
        ]

    def _configure(self, recorded: Recorded, settings: Settings) -> None:
        types, rig, (beams, columns) = self._types, recorded.about["rig"], recorded.directions.shape[:2]
        imu, lidar = rig["imu"], rig["lidar"]
        self._pipeline.set_imu_params(
            types.ImuParams(
                gyro=imu["gyro_noise"], accel=imu["accel_noise"], gyro_bias=imu["gyro_bias_walk"],
                accel_bias=imu["accel_bias_walk"], bias_init=1e-3, integration=1e-4,
                gravity=np.array([0.0, 0.0, GRAVITY]), rate=imu["rate_hz"],
            )
        )  # fmt: skip
        self._pipeline.set_lidar_params(
            types.LidarParams(
                num_rows=beams, num_columns=columns, min_range=lidar["min_range"], max_range=lidar["max_range"],
                rate=lidar["rate_hz"],
            )
        )  # fmt: skip
        T = recorded.T_imu_lidar
        self._pipeline.set_imu_T_lidar(types.SE3(types.SO3.from_mat(T[:3, :3]), T[:3, 3]))
        unknown = self._pipeline.set_params({**self._pipeline.default_params(), **settings})
        assert not unknown, f"settings that the pipeline does not know: {unknown}"
        self._pipeline.initialize()

    def imu(self, stamp_ns: int, gyro: Array, accel: Array) -> None:
        self._pipeline.add_imu(self._types.ImuMeasurement(self._types.Stamp.from_nsec(stamp_ns), gyro, accel))

    def prepare(self, scan: OrganisedScan) -> Any:
        self._cloud["xyz"] = scan.cloud()
        step, width = self._cloud.dtype.itemsize, self._cloud.size
        head = self._helpers.PointCloudMetadata(
            stamp=self._types.Stamp.from_nsec(scan.stamp_ns), width=width, height=1, point_step=step,
            row_step=step * width, is_bigendian=0, is_dense=1,
        )  # fmt: skip
        measurement = self._helpers.pc2_to_evalio(head, self._fields, self._cloud.tobytes())
        self._helpers.fill_col_row_major(measurement)
        return measurement

    def scan(self, prepared: Any) -> None:
        self._pipeline.add_lidar(prepared)

    def estimates(self) -> list[Estimate]:
        return [
            Estimate(1_000_000_000 * stamp.sec + stamp.nsec + self._shift_ns, pose.to_mat())
            for stamp, pose in self._pipeline.saved_estimates()
        ]


def _evalio(pipeline: str, **settings: Settings) -> Peer:
    return Peer("evalio", partial(Evalio, pipeline), settings)


PEERS: dict[str, Peer] = {
    "rko-lio": Peer(
        "rko-lio",
        RkoLio,
        {"shipped": {}, "mine": {"voxel_size": 0.5, "double_downsample": False, "initialization_phase": True}},
    ),
    "genz-lio": Peer(
        "genz-lio",
        GenzLio,
        {"shipped": {"file": "default/velodyne.yaml"}, "mine": {"file": "experiments/superloc/vlp16_cave.yaml"}},
    ),
    "dlio": _evalio("dlio", shipped={"at": 0.5}, mine={"at": 0.5, "imu_calib_time": 2.0}),
    "kiss-icp": _evalio("kiss", shipped={"at": 0.5}, mine={"at": 1.0, "deskew": True, "voxel_size": 0.5}),
    "genz-icp": _evalio("genz", shipped={"at": 0.5}, mine={"at": 1.0, "deskew": True}),
    "lio-sam": _evalio("liosam", shipped={"at": 0.0}),
    "loam": _evalio("loam", shipped={"at": 0.0}),
    "ct-icp": _evalio("ct", shipped={"at": 0.0}),
    "mad-icp": _evalio("mad", shipped={"at": 0.5}),
    "form": _evalio("form", shipped={"at": 0.5}),
}
