"""What an IMU felt, before and after its vibration is taken out, over time and by frequency (paper 002, Fig. 2, 5)."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from localize.denoise import enhance
from localize.settings import DenoiseSettings
from semmap.errors import InputFileError
from semmap.geometry import Array
from semmap.measurements import ImuSample
from semmap.recordings import read_recording
from semmap.rig import Rig
from tools.report.colours import BLUE, ORANGE
from tools.report.figures import Drawing, logarithmic, look

SECONDS = 60.0
"""Of the recording's beginning that are looked at."""
_SHOWN_S = 10.0
_FLOOR = 1e-6
"""Amplitudes drawn, at the least: none of them moves a robot."""
_OTHERS = ("lidar", "wheel", "uwb", "prism")


def inertial_drawings(recording: Path, rig_file: Path, settings: DenoiseSettings) -> Iterator[Drawing]:
    """The figure of a recording's first minute; raises the errors of the rig and the recording."""
    rig = Rig.from_yaml(rig_file).without(*_OTHERS)
    stamps, gyro, accel = _first_minute(recording, rig)
    clear = enhance(stamps, gyro, accel, settings)
    times = (stamps - stamps[0]) * 1e-9
    words = (
        "The specific force and the rate along x, as measured and with engine vibration taken out; right: by frequency"
    )
    yield Drawing(
        "inertial", _figure(times, (accel, gyro), (clear.accel, clear.gyro)), f"{words} (paper 002, Fig. 2, 5)."
    )


def _first_minute(recording: Path, rig: Rig) -> tuple[NDArray[np.int64], Array, Array]:
    samples: list[ImuSample] = []
    for measurement in read_recording(recording, rig):
        if isinstance(measurement, ImuSample):
            samples.append(measurement)
            if (measurement.stamp_ns - samples[0].stamp_ns) * 1e-9 > SECONDS:
                break
    if len(samples) < 100:
        raise InputFileError("has too few samples of the IMU", file=recording, mend="give the run's recording")
    stamps = np.array([sample.stamp_ns for sample in samples], np.int64)
    return stamps, np.array([sample.gyro for sample in samples]), np.array([sample.accel for sample in samples])


def _figure(times: Array, measured: tuple[Array, Array], clear: tuple[Array, Array]) -> Figure:
    with look():
        fig = Figure(figsize=(9.5, 4.4))
        panels = fig.subplots(2, 2)
        units = ("specific force x", "m/s²"), ("rate x", "rad/s")
        for row, (name, unit) in enumerate(units):
            shown = times < _SHOWN_S
            for values, colour, label in ((measured[row], ORANGE, "measured"), (clear[row], BLUE, "enhanced")):
                axes, spectrum = panels[row]
                axes.plot(times[shown], values[shown, 0], color=colour, linewidth=0.8, label=label)
                _draw_spectrum(spectrum, times, values[:, 0], colour)
            axes.set_ylabel(f"{name} [{unit}]")
            spectrum.set_ylabel(f"amplitude [{unit}]")
        panels[1, 0].set_xlabel("time [s]")
        panels[1, 1].set_xlabel("frequency [Hz]")
        fig.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
        return fig


def _draw_spectrum(axes: Axes, times: Array, values: Array, colour: str) -> None:
    """Amplitude of the tones in evenly sampled values, by a window that shows each tone at its height."""
    step = float(np.median(np.diff(times)))
    window = np.hanning(len(values))
    amplitude = 2.0 * np.abs(np.fft.rfft((values - values.mean()) * window)) / window.sum()
    frequency = np.fft.rfftfreq(len(values), step)
    kept = frequency > 0.1
    axes.plot(frequency[kept], np.maximum(amplitude[kept], _FLOOR), color=colour, linewidth=0.8)
    logarithmic(axes.yaxis)
