"""The motion modes of paper 000 (Eq. 18, 19): which sensor holds the pose, as a pure function of state and evidence.

A mode is `LI` (`I` without a LiDAR) and the letter of what holds the place beside it:

====  ===================================  ===================  ================================
mode  when                                 holds the place      fused beside it, while it passes
====  ===================================  ===================  ================================
LIP   the total station sees the prism     prism                LiDAR, UWB, wheel
LIU   anchors are heard, in their sphere   UWB                  LiDAR, wheel
LIW   neither, and the LiDAR degenerates   wheel, along there   LiDAR, odd ranges
LIO   neither, and it does not, or the     LiDAR                wheel, odd ranges
      wheel slips or is silent
====  ===================================  ===================  ================================

Paper 000 takes UWB in for LIU alone and the wheel for LIW alone. Here whatever passes its own check is fused in every
mode, and the mode says which of it the place hangs on: where LiDAR or UWB hold the velocity the wheel's scale is learnt
and its slip is noticed, and the tunnel that needs both begins without warning; a range that fits does no harm anywhere.
Leaving a sensor out is the rig's matter (`Rig.without`), not the mode's.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from localize.settings import ModeSettings


@dataclass(frozen=True, slots=True)
class Evidence:
    """What is known of the sensors at a moment.

    anchors : UWB anchors whose ranges arrived and fitted lately, fused or not.
    outside : distance from the middle of the anchors' sphere over its radius (Eq. 18), None where not known.
    prism : whether a fix arrived and fitted lately. wheel : whether the wheel was read lately, and grips.
    degree : how degenerate the pose is, from 1 on it is (Eq. 17).
    """

    stamp_ns: int
    anchors: int = 0
    outside: float | None = None
    prism: bool = False
    wheel: bool = False
    degree: float = 0.0


@dataclass(frozen=True, slots=True)
class Latch:
    """Yes or no that follows what is seen only when that has lasted. contrary_ns : since when it says otherwise."""

    on: bool = False
    contrary_ns: int | None = None

    def seen(self, on: bool, stamp_ns: int, dwell_s: float) -> Latch:
        """The latch after one more look."""
        if on == self.on:
            return Latch(on)
        since = stamp_ns if self.contrary_ns is None else self.contrary_ns
        return Latch(on) if stamp_ns - since >= dwell_s * 1e9 else Latch(self.on, since)


@dataclass(frozen=True, slots=True)
class ModeState:
    """The mode and what it was concluded from; ``mode`` is empty before the first evidence."""

    mode: str = ""
    prism: Latch = field(default_factory=Latch)
    uwb: Latch = field(default_factory=Latch)
    wheel: Latch = field(default_factory=Latch)
    degenerate: Latch = field(default_factory=Latch)


def next_mode(state: ModeState, evidence: Evidence, settings: ModeSettings, *, lidar: bool) -> ModeState:
    """The mode after ``evidence`` (paper 000 Eq. 18, 19); ``lidar``: whether the robot has one.

    Each conclusion has two limits, one to come to it and a looser one to stay, and changes only when the evidence has
    said so for ``dwell_s``: so a mode that is left comes back no sooner than that.
    """
    dwell_s = settings.dwell_s if state.mode else 0.0
    sphere = 1.0 + (settings.slack if state.uwb.on else 0.0)
    near = evidence.outside is None or evidence.outside <= sphere
    heard = evidence.anchors >= (1 if state.uwb.on else settings.min_anchors)
    limit = 1.0 / (1.0 + settings.slack) if state.degenerate.on else 1.0
    stamp_ns = evidence.stamp_ns
    prism = state.prism.seen(evidence.prism, stamp_ns, dwell_s)
    uwb = state.uwb.seen(heard and near, stamp_ns, dwell_s)
    wheel = state.wheel.seen(evidence.wheel, stamp_ns, dwell_s)
    # without a LiDAR there is nothing that could hold the place without the wheel
    degenerate = state.degenerate.seen(not lidar or evidence.degree >= limit, stamp_ns, dwell_s)
    held = "P" if prism.on else "U" if uwb.on else "W" if wheel.on and degenerate.on else "O"
    return ModeState(("LI" if lidar else "I") + held, prism, uwb, wheel, degenerate)
