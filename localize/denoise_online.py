"""The vibration filter for a live IMU: samples in, the same samples a stated while later out."""

from __future__ import annotations

import numpy as np

from localize.denoise import enhance_window
from localize.settings import DenoiseSettings
from semmap.measurements import ImuSample

_GAP_NS = 50_000_000


class OnlineDenoiser:
    """Sifts the last `online_window_s` every `online_step_s`; gives back what lies behind the margin.

    Every sample comes back once, in order, with its own stamp, when one no more than ``latency_s`` and one sample newer
    has arrived. Samples that are not newer than the last one are left out and counted in ``dropped``. After a hole in
    the stamps the filter starts anew.
    """

    def __init__(self, settings: DenoiseSettings) -> None:
        self.settings = settings
        self.latency_s = settings.latency_s
        self.dropped = 0
        self._samples: list[ImuSample] = []
        self._given = 0
        """How many of the samples held have been given back."""

    def add(self, sample: ImuSample) -> list[ImuSample]:
        """Take one sample in; returns those that are done, mostly none."""
        held, done = self._samples, []
        if held and sample.stamp_ns <= held[-1].stamp_ns:
            self.dropped += 1
            return []
        if held and sample.stamp_ns - held[-1].stamp_ns > _GAP_NS:
            done = self.finish()
        self._samples.append(sample)
        waiting_s = (sample.stamp_ns - self._samples[self._given].stamp_ns) * 1e-9
        return done + self._sift(self.settings.margin_s) if waiting_s >= self.latency_s else done

    def finish(self) -> list[ImuSample]:
        """Give back what is still held; the last ``margin_s`` of it with part of the vibration."""
        done = self._sift(0.0) if self._samples else []
        self._samples, self._given = [], 0
        return done

    def _sift(self, margin_s: float) -> list[ImuSample]:
        held = self._samples
        stamps = np.array([sample.stamp_ns for sample in held], np.int64)
        last = int(np.searchsorted(stamps, stamps[-1] - round(margin_s * 1e9), side="right"))
        done = held[self._given : last]
        if (stamps[-1] - stamps[0]) * 1e-9 >= 2.0 * self.settings.margin_s:
            rate_hz = (len(held) - 1) * 1e9 / float(stamps[-1] - stamps[0])
            gyro, accel = np.array([s.gyro for s in held]), np.array([s.accel for s in held])
            enhanced = enhance_window(gyro, accel, rate_hz, self.settings)
            done = [ImuSample(held[k].stamp_ns, enhanced.gyro[k], enhanced.accel[k]) for k in range(self._given, last)]
        # the next window reaches as far back from the next step as this one from now
        keep_ns = stamps[-1] - round((self.settings.online_window_s - self.settings.online_step_s) * 1e9)
        first = min(last, int(np.searchsorted(stamps, keep_ns)))
        self._samples, self._given = held[first:], last - first
        return done
