"""`uncertainty.csv` of a run, read back: how well the pose was known at each scan, and what held it."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from semmap.errors import InputFileError
from semmap.geometry import Array
from semmap.trajectory import stamp_ns_of_text

_AXES = ("xx", "xy", "xz", "yy", "yz", "zz")
_NUMBERS = [f"{frame}_{axes}" for frame in ("map", "odom") for axes in _AXES] + ["rx_std", "ry_std", "rz_std"]
_UPPER = np.triu_indices(3)
_MEND = "run `semmap localize` again"


@dataclass(frozen=True, slots=True, eq=False)
class Uncertainties:
    """One row a scan.

    stamps_ns : (n,). modes : (n,) names. position : (n, 3, 3) covariance of the position [m²] in ``frame``: of the
    published pose in the map, NaN while there was none, or of the filter's in odom. rotation_std : (n, 3) of the
    filter's attitude about the IMU's axes [rad].
    """

    stamps_ns: NDArray[np.int64]
    modes: NDArray[np.str_]
    frame: str
    position: Array
    rotation_std: Array

    def at(self, stamps_ns: NDArray[np.int64]) -> Uncertainties:
        """The rows of these stamps."""
        rows = np.flatnonzero(np.isin(self.stamps_ns, stamps_ns))
        return Uncertainties(
            self.stamps_ns[rows], self.modes[rows], self.frame, self.position[rows], self.rotation_std[rows]
        )

    def stretches(self) -> list[tuple[int, int, str]]:
        """Rows from, up to and without, and the mode they have in common."""
        cuts = [0, *(np.flatnonzero(self.modes[1:] != self.modes[:-1]) + 1).tolist(), len(self.modes)]
        return [(a, b, str(self.modes[a])) for a, b in pairwise(cuts) if b > a]


def read_uncertainties(path: Path) -> Uncertainties:
    """The rows of ``uncertainty.csv``. Raises `InputFileError` with the line that cannot be read."""
    stamps: list[int] = []
    modes: list[str] = []
    rows: list[list[float]] = []
    try:
        with path.open(newline="", encoding="utf-8") as file:
            for row in csv.DictReader(file):
                stamps.append(stamp_ns_of_text(row["stamp"]))
                modes.append(row["mode"])
                rows.append([float(row[name] or "nan") for name in _NUMBERS])
    except OSError as reason:
        raise InputFileError(f"cannot be read ({reason})", file=path, mend=_MEND) from None
    except (KeyError, TypeError, ValueError):
        what = "does not say how well a pose was known"
        raise InputFileError(what, file=path, field=f"line {len(stamps) + 1}", mend=_MEND) from None
    numbers = np.array(rows).reshape(-1, len(_NUMBERS))
    values, rotation_std = numbers[:, :12].reshape(-1, 2, 6), numbers[:, 12:]
    in_map = bool(np.isfinite(values[:, 0]).any())
    covariance = np.empty((len(values), 3, 3))
    covariance[:, *_UPPER] = covariance[:, *_UPPER[::-1]] = values[:, 0 if in_map else 1]
    frame = "map" if in_map else "odom"
    return Uncertainties(np.array(stamps, np.int64), np.array(modes, np.str_), frame, covariance, rotation_std)
