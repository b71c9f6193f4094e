"""Intersections found in a map against those that are known to be there."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from semmap.errors import InputFileError
from semmap.geometry import Array
from semmap.intersections import Intersection

WITHIN = 4.0
"""[m] that a found intersection may be off the label it is taken for."""
_FAR = 1e6


@dataclass(frozen=True, slots=True, eq=False)
class Label:
    """A reference intersection: name, (3,) position in the map with NaN for an unknown height, bearings (b,) [rad]."""

    id: str
    p_map: Array
    bearings: Array


def read_labels(path: Path) -> list[Label]:
    """Labels of a ``junctions.csv``: ``id,x_m,y_m,branches,bearings_deg`` and maybe ``z_m``."""
    try:
        with path.open(encoding="utf-8") as lines:
            rows = list(csv.DictReader(lines))
        return [_label(row) for row in rows]
    except (OSError, KeyError, ValueError) as reason:
        raise InputFileError(f"holds no junctions ({reason})", file=path) from None


def _label(row: dict[str, str]) -> Label:
    p = np.array([float(row["x_m"]), float(row["y_m"]), float(row.get("z_m") or np.nan)])
    bearings = [float(word) for word in row["bearings_deg"].split(";")]
    if len(bearings) != int(row["branches"]):
        raise ValueError(f"junction {row['id']} has not as many bearings as branches")
    return Label(row["id"], p, np.radians(bearings))


@dataclass(frozen=True, slots=True, eq=False)
class Agreement:
    """Labels and found intersections paired one to one, nearest sum of distances, none farther than `WITHIN`.

    labels, found : what was paired. pairs : (k, 2) indices into the two; distance : (k,) between them [m], in plan
    where the label has no height.

    Only meetings of three roadways and more are missed or extra: what is called a corner depends on who calls it.
    """

    labels: Sequence[Label]
    found: Sequence[Intersection]
    pairs: NDArray[np.int64]
    distance: Array

    @property
    def missed(self) -> list[Label]:
        """Meetings on the list that were not found."""
        return [label for k, label in enumerate(self.labels) if k not in self.pairs[:, 0] and len(label.bearings) > 2]

    @property
    def extra(self) -> list[Intersection]:
        """Meetings found that are not on the list."""
        return [one for k, one in enumerate(self.found) if k not in self.pairs[:, 1] and len(one.branch_bearings) > 2]

    @property
    def meetings(self) -> list[tuple[Label, Intersection, float]]:
        """Pairs whose label is a meeting, with their distances."""
        triples = [(self.labels[a], self.found[b], d) for (a, b), d in zip(self.pairs, self.distance, strict=True)]
        return [triple for triple in triples if len(triple[0].bearings) > 2]

    @property
    def unequal(self) -> list[tuple[Label, Intersection]]:
        """Paired meetings with another number of branches."""
        return [(label, one) for label, one, _ in self.meetings if len(label.bearings) != len(one.branch_bearings)]

    def figures(self) -> Figures:
        """The counts and distances of this agreement."""
        found = sum(len(one.branch_bearings) > 2 for one in self.found)
        distances = np.array([d for *_, d in self.meetings])
        met = len(distances)
        return Figures(met + len(self.missed), found, met, found - len(self.extra), met - len(self.unequal), distances)


@dataclass(frozen=True, slots=True, eq=False)
class Figures:
    """Meetings on the list, found, on the list and found, found and on the list, with as many branches; distances."""

    labels: int
    found: int
    met: int
    right: int
    equal: int
    distance: Array

    def __add__(self, other: Figures) -> Figures:
        counts = (getattr(self, name) + getattr(other, name) for name in ("labels", "found", "met", "right", "equal"))
        return Figures(*counts, np.concatenate([self.distance, other.distance]))

    def __str__(self) -> str:
        median, most = (np.median(self.distance), self.distance.max()) if self.met else (np.nan, np.nan)
        return (
            f"{self.labels:6d} {self.found:5d} {_percent(self.met, self.labels)} {_percent(self.right, self.found)}"
            f" {median:7.2f} {most:6.2f} {_percent(self.equal, self.met)}"
        )


HEADER = "labels found  recall   prec.  median    max  branches"


def agreement(labels: Sequence[Label], found: Sequence[Intersection]) -> Agreement:
    """Pair labels and found intersections."""
    away = np.full((len(labels), len(found)), _FAR)
    for a, label in enumerate(labels):
        for b, one in enumerate(found):
            off = (one.p_map - label.p_map)[np.isfinite(label.p_map)]
            away[a, b] = min(float(np.linalg.norm(off)), _FAR)
    rows, columns = linear_sum_assignment(np.where(away <= WITHIN, away, _FAR))
    near = away[rows, columns] <= WITHIN
    pairs = np.stack([rows[near], columns[near]], axis=1).astype(np.int64)
    return Agreement(labels, found, pairs, away[rows[near], columns[near]])


def _percent(part: int, whole: int) -> str:
    return f"{100.0 * part / whole:6.1f}%" if whole else "      -"
