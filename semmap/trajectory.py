"""Trajectories and their TUM files (`stamp x y z qx qy qz qw`, seconds with nine decimals)."""

from __future__ import annotations

from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from semmap.errors import TrajectoryError
from semmap.files import written_whole
from semmap.geometry import Array, interpolate_poses, quaternion_xyzw, rotation_of_quaternion, se3


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """Poses of the IMU over time.

    frame : the frame the poses are in, ``map`` or ``odom``.
    stamps_ns : (n,) int64, strictly increasing.
    poses : (n, 4, 4), ``T_frame_imu``.
    """

    frame: str
    stamps_ns: NDArray[np.int64]
    poses: Array

    def __post_init__(self) -> None:
        stamps = np.asarray(self.stamps_ns, dtype=np.int64).reshape(-1)
        poses = np.asarray(self.poses, dtype=np.float64).reshape(-1, 4, 4)
        if len(stamps) != len(poses):
            raise TrajectoryError(f"{len(stamps)} stamps for {len(poses)} poses", field="Trajectory")
        if not np.isfinite(poses).all():
            raise TrajectoryError("poses are not finite", field="Trajectory.poses")
        if (np.diff(stamps) <= 0).any():
            what = "stamps do not increase"
            raise TrajectoryError(what, field="Trajectory.stamps_ns", mend="sort, drop repeats")
        object.__setattr__(self, "stamps_ns", stamps)
        object.__setattr__(self, "poses", poses)

    def __len__(self) -> int:
        return len(self.stamps_ns)

    @property
    def positions(self) -> Array:
        """Positions (n, 3) [m] of the IMU."""
        return self.poses[:, :3, 3]

    def length(self) -> float:
        """Length of the track [m]."""
        return float(np.linalg.norm(np.diff(self.positions, axis=0), axis=1).sum())

    def at(self, query_ns: NDArray[np.int64]) -> Array:
        """Interpolated poses (m, 4, 4) at ``query_ns`` (m,), clamped to the ends."""
        if not len(self):
            raise TrajectoryError("has no poses to interpolate", field="Trajectory")
        return interpolate_poses(self.stamps_ns, self.poses, np.asarray(query_ns, dtype=np.int64))

    def save_tum(self, path: str | Path, *, comment: str = "") -> None:
        """Write a TUM file; its first line names the frame, ``comment`` follows on lines of its own."""
        q = quaternion_xyzw(self.poses[:, :3, :3])
        with written_whole(path) as temporary, temporary.open("w", encoding="utf-8") as out:
            out.write(f"# frame: {self.frame}; stamp[s] x y z[m] qx qy qz qw of the imu\n")
            for line in comment.splitlines():
                out.write(f"# {line}\n")
            for stamp, p, (x, y, z, w) in zip(self.stamps_ns.tolist(), self.positions, q, strict=True):
                position = f"{p[0]:.6f} {p[1]:.6f} {p[2]:.6f}"
                out.write(f"{text_of_stamp_ns(stamp)} {position} {x:.9f} {y:.9f} {z:.9f} {w:.9f}\n")

    @classmethod
    def load_tum(cls, path: str | Path, *, frame: str | None = None) -> Trajectory:
        """Read a TUM file; the frame comes from its first line unless given (``map`` where neither says).

        Raises `TrajectoryError` with the line at fault.
        """
        try:
            text = Path(path).read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as reason:
            raise TrajectoryError(f"cannot be read ({reason})", file=path, mend="check the path") from None
        stamps: list[int] = []
        rows: list[list[float]] = []
        for number, line in enumerate(text.splitlines(), 1):
            line = line.strip()
            if line.startswith("# frame:") and frame is None:
                frame = line.removeprefix("# frame:").split(";")[0].strip()
            if not line or line.startswith("#"):
                continue
            words = line.split()
            try:
                if len(words) != 8:
                    raise ValueError(f"has {len(words)} columns")
                stamps.append(stamp_ns_of_text(words[0]))
                rows.append([float(word) for word in words[1:]])
            except ValueError as reason:
                raise TrajectoryError(
                    str(reason), file=path, field=f"line {number}", mend="write `stamp x y z qx qy qz qw`"
                ) from None
        values = np.array(rows, dtype=np.float64).reshape(-1, 7)
        if not np.isfinite(values).all() or (np.linalg.norm(values[:, 3:], axis=1) < 0.5).any():
            raise TrajectoryError("holds a pose that is not finite or not a rotation", file=path)
        poses = se3(rotation_of_quaternion(values[:, 3:]), values[:, :3])
        try:
            return cls(frame or "map", np.array(stamps, np.int64), poses)
        except TrajectoryError as reason:
            raise TrajectoryError(reason.what, file=path, mend=reason.mend) from None


def text_of_stamp_ns(stamp_ns: int) -> str:
    """Decimal seconds with nine decimals of nanoseconds."""
    seconds, nanoseconds = divmod(abs(stamp_ns), 1_000_000_000)
    return f"{'-' if stamp_ns < 0 else ''}{seconds}.{nanoseconds:09d}"


def stamp_ns_of_text(text: str) -> int:
    """Nanoseconds of decimal seconds, exact to the last digit (a float64 is not, for epoch stamps)."""
    try:
        nanoseconds = Decimal(text) * 1_000_000_000
        if abs(nanoseconds) >= 2**63:
            raise ValueError
        return int(nanoseconds.to_integral_value())
    except (ArithmeticError, ValueError):
        raise ValueError(f"stamp {text!r} is not a number of seconds") from None
