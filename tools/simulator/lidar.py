"""The spinning LiDAR: every column is cast from the pose the sensor has at that column's own time."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from semmap.geometry import Array
from semmap.measurements import Scan
from semmap.rig import LidarBlock
from tools.simulator.dust import dusty
from tools.simulator.flight import Flight, Stamps
from tools.simulator.raycaster import Hits
from tools.simulator.settings import SensorFaults

RATE_HZ = 10.0
_SENSOR = 2
_SCANS_AT_ONCE = 5
_INTENSITY = 100.0
_FAR_POWER = 6


def scans(flight: Flight) -> Iterator[Scan]:
    """Whole turns. A scan's stamp is the start of its turn; a turn without any return makes no scan."""
    block = flight.rig.lidar
    if block is None:
        return
    rate = block.rate_hz or RATE_HZ
    starts = flight.stamps(rate)[:-1]
    offsets_ns = np.rint(np.arange(block.columns) / block.columns / rate * 1e9).astype(np.int64)
    directions = beam_directions(block)
    rng = flight.rng(_SENSOR)
    for first in range(0, len(starts), _SCANS_AT_ONCE):
        chunk = starts[first : first + _SCANS_AT_ONCE]
        hits = _cast(flight, block, chunk[:, None] + offsets_ns, directions)
        ranges, kept = measured_ranges(hits, block, flight.faults, rng)
        ranges, kept = dusty(ranges, kept, flight.faults.dust, len(chunk) * block.columns, rng)
        shape = (len(chunk), block.columns, block.beams)
        intensity = (_INTENSITY * hits.cosines).reshape(shape)
        for index, stamp in enumerate(chunk.tolist()):
            scan_ranges, scan_kept = ranges.reshape(shape)[index], kept.reshape(shape)[index]
            if scan_kept.any():
                yield _scan(stamp, scan_ranges, scan_kept, directions, offsets_ns, intensity[index])


def beam_directions(block: LidarBlock) -> Array:
    """Unit vectors (columns, beams, 3), lidar frame: clockwise from straight behind, lowest beam first."""
    azimuth = np.pi - 2.0 * np.pi * np.arange(block.columns) / block.columns
    elevation = np.radians(np.linspace(*block.fov_deg, block.beams))
    level = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1)[:, None, :] * np.cos(elevation)[:, None]
    height = np.broadcast_to(np.sin(elevation)[:, None], (block.columns, block.beams, 1))
    return np.concatenate([level, height], axis=-1)


def measured_ranges(
    hits: Hits, block: LidarBlock, faults: SensorFaults, rng: np.random.Generator
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Noisy ranges (n,) [m] and which of them come back (n,).

    Lost are those out of the sensor's reach, some at random, and more the flatter they hit and the farther
    they go.
    """
    count = len(hits.distances)
    noise = rng.standard_normal(count, dtype=np.float32) * np.float32(block.range_std * faults.noise)
    luck = rng.random(count, dtype=np.float32)
    reached = np.isfinite(hits.distances)
    ranges = np.where(reached, hits.distances, 0.0).astype(np.float32) + noise
    returns = (
        1.0 - faults.lidar_dropout - faults.lidar_far_loss * np.clip(ranges / block.max_range, 0.0, 1.0) ** _FAR_POWER
    )
    if faults.lidar_grazing > 0.0:
        returns = returns * (1.0 - np.exp(-hits.cosines / faults.lidar_grazing))
    return ranges, reached & (ranges >= block.min_range) & (ranges <= block.max_range) & (luck < returns)


def _cast(flight: Flight, block: LidarBlock, stamps: Stamps, directions: Array) -> Hits:
    """Hits of all beams of scans whose columns have ``stamps`` (scans, columns)."""
    T_map_lidar = flight.motion(flight.times(stamps.ravel())).poses() @ block.T_imu_lidar
    columns = np.tile(directions.astype(np.float32), (len(stamps), 1, 1))
    rays = columns @ T_map_lidar[:, :3, :3].transpose(0, 2, 1).astype(np.float32)
    starts = np.repeat(T_map_lidar[:, :3, 3], block.beams, axis=0)
    return flight.mine.raycaster.cast(starts, rays.reshape(-1, 3))


def _scan(
    stamp: int,
    ranges: NDArray[np.float32],
    kept: NDArray[np.bool_],
    directions: Array,
    offsets_ns: Stamps,
    intensity: NDArray[np.float32],
) -> Scan:
    column, beam = np.nonzero(kept)
    points = ranges[kept][:, None] * directions[kept]
    return Scan(
        stamp,
        points.astype(np.float32),
        offsets_ns[column],
        beam.astype(np.uint16),
        intensity[kept].astype(np.float32),
    )
