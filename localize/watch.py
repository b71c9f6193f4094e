"""Watches over the run: which mode it is in, where it degenerates, when the wheel slips, how well the pose is known."""

from __future__ import annotations

from typing import Literal

import numpy as np

from localize.degeneracy import DegeneracyMonitor
from localize.modes import Evidence, Latch, ModeState, next_mode
from localize.odometry import OdometryPose
from localize.results import Event, Uncertainty, Update
from localize.settings import LocalizeSettings
from localize.slip import WheelFusion
from localize.state import POSITION, ROTATION


class ModeWatch:
    """Collects the evidence for the modes (paper 000 Eq. 15 to 19) and tells what changes, as events.

    Attributes
    ----------
    mode : the present one. uncertainty : a row for each pose.
    """

    def __init__(self, settings: LocalizeSettings, *, lidar: bool) -> None:
        self.settings, self.lidar = settings.modes, lidar
        self.mode = ModeState()
        self.uncertainty: list[Uncertainty] = []
        self._degeneracy = DegeneracyMonitor(settings.degeneracy, settings.keyframes)
        self._slips_told = 0
        self._dust = Latch()
        self._fitted_ns: dict[str, dict[int | None, int]] = {"uwb": {}, "prism": {}}

    def fitted(self, kind: Literal["uwb", "prism"], anchor: int | None, stamp_ns: int) -> None:
        """A range or fix arrived and agreed with what was known."""
        self._fitted_ns[kind][anchor] = stamp_ns

    def begin_again(self) -> None:
        """The odometry, and with it the wheel's fusion, begins anew."""
        self._slips_told = 0

    def reached(self, pose: OdometryPose, wheel: WheelFusion | None, *, outside: float | None) -> list[Event]:
        """Take a pose in; returns what changed. ``outside``: see `Evidence`."""
        events = self._slips(wheel, pose.stamp_ns) + self._degeneracy.watch(pose, self.settings) + self._dusty(pose)
        mode = next_mode(self.mode, self._evidence(pose.stamp_ns, wheel, outside), self.settings, lidar=self.lidar)
        if mode.mode != self.mode.mode:
            change = {"before": self.mode.mode, "after": mode.mode}
            events.append({"stamp_ns": int(pose.stamp_ns), "kind": "mode", **change})
        self.mode = mode
        return events

    def _dusty(self, pose: OdometryPose) -> list[Event]:
        """Dust that begins, and air that is clear again."""
        before = self._dust
        self._dust = before.seen(pose.dust > 0.0, pose.stamp_ns, self.settings.dwell_s)
        if self._dust.on == before.on:
            return []
        return [{"stamp_ns": int(pose.stamp_ns), "kind": "dust", "begun": self._dust.on, "share": pose.dust}]

    def _slips(self, wheel: WheelFusion | None, stamp_ns: int) -> list[Event]:
        events: list[Event] = []
        for change in wheel.changes[self._slips_told :] if wheel is not None else []:
            if change.stamp_ns > stamp_ns:
                break
            told = {"begun": change.slipping, "excess_m_s": change.excess}
            # as of the scan that it was noticed with: events are in order of time
            events.append({"stamp_ns": int(stamp_ns), "kind": "slip", **told})
            self._slips_told += 1
        return events

    def _evidence(self, stamp_ns: int, wheel: WheelFusion | None, outside: float | None) -> Evidence:
        since_ns = stamp_ns - round(self.settings.hold_s * 1e9)
        return Evidence(
            stamp_ns,
            anchors=sum(heard_ns > since_ns for heard_ns in self._fitted_ns["uwb"].values()),
            outside=outside,
            prism=any(seen_ns > since_ns for seen_ns in self._fitted_ns["prism"].values()),
            wheel=wheel is not None and wheel.gripped_ns > since_ns,
            degree=self._degeneracy.degree,
        )

    def note_uncertainty(self, pose: OdometryPose, update: Update) -> None:
        """A row for a pose, as it was published."""
        position_map = None
        if update.T_map_imu is not None and update.covariance is not None:
            R = update.T_map_imu[:3, :3]
            position_map = R @ update.covariance[3:, 3:] @ R.T
        P, d = pose.covariance, self._degeneracy
        row = Uncertainty(
            pose.stamp_ns, self.mode.mode, d.degenerate, d.scan, d.translation, d.rotation,
            np.sqrt(np.diag(P)[ROTATION]), P[POSITION, POSITION].copy(), position_map,
        )  # fmt: skip
        self.uncertainty.append(row)
