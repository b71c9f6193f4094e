"""Fixtures for all tests."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from small_files import RIG, small_map, write_recording

from semmap.intersections import SemanticMap


@pytest.fixture
def rig_file(tmp_path: Path) -> Path:
    """A rig with IMU, LiDAR and wheel."""
    path = tmp_path / "rig.yaml"
    path.write_text(yaml.safe_dump(RIG))
    return path


@pytest.fixture
def recording(tmp_path: Path, rig_file: Path) -> Path:
    """Two seconds at rest, as rosbag2 with MCAP."""
    return write_recording(tmp_path / "recording", rig_file)


@pytest.fixture
def semantic_map() -> SemanticMap:
    """Two intersections and a dead end, in the millions of metres of a mine grid."""
    return small_map()
