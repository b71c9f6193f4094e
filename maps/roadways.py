"""One roadway: its centre line and how far the walls are from it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from semmap.geometry import Array


@dataclass(frozen=True, slots=True, eq=False)
class Roadway:
    """One roadway between two nodes.

    nodes : the nodes it joins.
    axis : (k, 3) centre line on the floor from the first node to the second [m].
    clearance : (k,) horizontal distance from the axis to the nearest wall [m].
    """

    nodes: tuple[int, int]
    axis: Array
    clearance: Array

    @property
    def length(self) -> float:
        """Length along the axis [m]."""
        return float(self.walked[-1])

    @property
    def walked(self) -> Array:
        """Length (k,) of the axis up to each of its points [m]."""
        return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(self.axis, axis=0), axis=1))])

    def reversed(self) -> Roadway:
        """The same roadway from its other end."""
        return Roadway((self.nodes[1], self.nodes[0]), self.axis[::-1], self.clearance[::-1])

    def joined(self, after: Roadway) -> Roadway:
        """This roadway and the one that goes on from its second node, as one."""
        return Roadway(
            (self.nodes[0], after.nodes[1]),
            np.vstack([self.axis, after.axis[1:]]),
            np.concatenate([self.clearance, after.clearance[1:]]),
        )

    def split(self, at: float, node: int) -> tuple[Roadway, Roadway]:
        """The two parts of this roadway, cut ``at`` [m] along its axis, where the new ``node`` is."""
        k = int(np.searchsorted(self.walked, at).clip(1, len(self.axis) - 2))
        return (
            Roadway((self.nodes[0], node), self.axis[: k + 1], self.clearance[: k + 1]),
            Roadway((node, self.nodes[1]), self.axis[k:], self.clearance[k:]),
        )

    def resampled(self, step: float) -> tuple[Array, Array]:
        """Path lengths (k,) and points (k, 3) along the axis, ``step`` [m] apart, both ends included."""
        walked = self.walked
        at = np.append(np.arange(0.0, walked[-1], step), walked[-1])
        return at, np.stack([np.interp(at, walked, self.axis[:, k]) for k in range(3)], axis=-1)
