"""A recording on disk that every odometry under test reads, from whatever Python environment it lives in.

NumPy and the standard library only. A directory holds ``about.json`` (the rig and how it was made), ``imu.npz``,
``truth.npz``, ``scans.npz`` (stamps, beam directions, column times) and ``ranges.u16``: one range image a scan,
row-major (beams, columns), in units of 2 mm, zero where nothing came back.
"""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

RANGE_UNIT = 0.002
"""[m]: a tenth of the noise of the ranges, and 131 m fit into 16 bits."""
_ABOUT, _IMU, _TRUTH, _SCANS, _RANGES = "about.json", "imu.npz", "truth.npz", "scans.npz", "ranges.u16"


@dataclass(frozen=True, slots=True, eq=False)
class OrganisedScan:
    """One turn: ``stamp_ns`` of its start, ``ranges`` (beams, columns) float32 [m], 0 where nothing came back.

    ``directions`` (beams, columns, 3) float32 are unit vectors in the lidar frame, ``offsets_ns`` (columns,) int64
    the times of the columns after the stamp, ``end_ns`` the time of the last.
    """

    stamp_ns: int
    ranges: NDArray[np.float32]
    directions: NDArray[np.float32]
    offsets_ns: NDArray[np.int64]

    @property
    def end_ns(self) -> int:
        return self.stamp_ns + int(self.offsets_ns[-1])

    def cloud(self) -> NDArray[np.float32]:
        """All points (beams, columns, 3), zeros where nothing came back."""
        return self.directions * self.ranges[..., None]

    def returns(self) -> tuple[NDArray[np.float32], NDArray[np.int64], NDArray[np.uint16]]:
        """Points (n, 3) that came back, their times after the stamp (n,) [ns] and their beams (n,)."""
        beam, column = np.nonzero(self.ranges)
        return self.cloud()[beam, column], self.offsets_ns[column], beam.astype(np.uint16)


@dataclass(frozen=True, slots=True, eq=False)
class Recorded:
    """A cached recording, opened.

    about : what is in ``about.json``; ``about["rig"]`` has the keys of a rig file.
    stamps_ns : (n,) starts of the scans. imu_ns (m,), gyro, accel (m, 3) [rad/s, m/s²].
    """

    directory: Path
    about: dict[str, Any]
    stamps_ns: NDArray[np.int64]
    directions: NDArray[np.float32]
    offsets_ns: NDArray[np.int64]
    imu_ns: NDArray[np.int64]
    gyro: Array
    accel: Array

    @classmethod
    def open(cls, directory: Path) -> Recorded:
        """Read all but the ranges."""
        scans, imu = np.load(directory / _SCANS), np.load(directory / _IMU)
        return cls(
            directory,
            json.loads((directory / _ABOUT).read_text(encoding="utf-8")),
            *(scans[name] for name in ("stamps_ns", "directions", "offsets_ns")),
            *(imu[name] for name in ("stamps_ns", "gyro", "accel")),
        )

    @property
    def T_imu_lidar(self) -> Array:
        """Pose (4, 4) of the lidar on the IMU."""
        T = np.eye(4)
        T[:3] = self.about["T_imu_lidar"]
        return T

    def truth(self) -> tuple[NDArray[np.int64], Array]:
        """Stamps (k,) and true poses (k, 4, 4) of the IMU."""
        file = np.load(self.directory / _TRUTH)
        poses = np.tile(np.eye(4), (len(file["stamps_ns"]), 1, 1))
        poses[:, :3] = file["poses"]
        return file["stamps_ns"], poses

    def scans(self, first: int = 0) -> Iterator[OrganisedScan]:
        """The scans from number ``first`` on, one in memory at a time."""
        shape = self.directions.shape[:2]
        with (self.directory / _RANGES).open("rb") as file:
            file.seek(2 * shape[0] * shape[1] * first)
            for stamp in self.stamps_ns[first:].tolist():
                units = np.frombuffer(file.read(2 * shape[0] * shape[1]), np.uint16).reshape(shape)
                yield OrganisedScan(stamp, units * np.float32(RANGE_UNIT), self.directions, self.offsets_ns)

    def in_order(self, first: int = 0) -> Iterator[tuple[slice, OrganisedScan]]:
        """Each scan with the rows of the IMU to hand over before it: up to the first at or after the scan's end.

        first : number of the scan to begin with, as if the recording began there.
        """
        done = int(np.searchsorted(self.imu_ns, self.stamps_ns[first])) if first else 0
        for scan in self.scans(first):
            covered = int(np.searchsorted(self.imu_ns, scan.end_ns)) + 1
            if covered > len(self.imu_ns):
                return
            yield slice(done, covered), scan
            done = covered


class RecordedWriter:
    """Writes a cached recording, scan by scan; the directory appears when `finish` is called.

    Use as a context manager: without `finish` nothing is left behind.
    """

    def __init__(
        self, directory: Path, directions: NDArray[np.float32], offsets_ns: NDArray[np.int64], about: dict[str, Any]
    ) -> None:
        directory.parent.mkdir(parents=True, exist_ok=True)
        self.directory, self.about = directory, about
        self._directions, self._offsets_ns = np.ascontiguousarray(directions, np.float32), offsets_ns
        self._aside = Path(tempfile.mkdtemp(prefix=f".{directory.name}.", dir=directory.parent))
        self._file: BinaryIO = (self._aside / _RANGES).open("wb")
        self._stamps_ns: list[int] = []

    def __enter__(self) -> RecordedWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()
        shutil.rmtree(self._aside, ignore_errors=True)

    def write(
        self, stamp_ns: int, beam: NDArray[Any], offsets_ns: NDArray[np.int64], ranges: NDArray[np.floating[Any]]
    ) -> None:
        """Add a scan: beam, time after the stamp and range (n,) of the points that came back."""
        image = np.zeros(self._directions.shape[:2], np.uint16)
        image[beam, np.searchsorted(self._offsets_ns, offsets_ns)] = np.rint(ranges / RANGE_UNIT)
        self._file.write(image.tobytes())
        self._stamps_ns.append(stamp_ns)

    def finish(self, imu: tuple[NDArray[np.int64], Array, Array], truth: tuple[NDArray[np.int64], Array]) -> None:
        """Add the IMU (stamps, gyro, accel) and the truth (stamps, poses (k, 4, 4)), and put all in place."""
        self._file.close()
        stamps = np.array(self._stamps_ns, np.int64)
        np.savez(self._aside / _SCANS, stamps_ns=stamps, directions=self._directions, offsets_ns=self._offsets_ns)
        np.savez(self._aside / _IMU, stamps_ns=imu[0], gyro=imu[1], accel=imu[2])
        np.savez(self._aside / _TRUTH, stamps_ns=truth[0], poses=truth[1][:, :3])
        (self._aside / _ABOUT).write_text(json.dumps(self.about, indent=1) + "\n", encoding="utf-8")
        self._aside.chmod(0o755)
        self._aside.rename(self.directory)
