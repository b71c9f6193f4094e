"""Imports go down the list of rooms, never up, and heavy libraries come in through one door each."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
ROOMS = ("semmap", "descriptors", "maps", "localize", "tools")
"""From the ground up: a room may import itself and the rooms before it."""

DOORS = {
    "h5py": ("semmap/hdf5.py",),
    "rosbags": ("semmap/recordings.py",),
    "gtsam": ("localize/graph.py",),
    "laspy": ("maps/las.py",),
    "pye57": ("maps/e57.py",),
    "dask": ("maps/engine.py",),
    "distributed": ("maps/engine.py",),
    "matplotlib": ("tools/report/", "tools/bench/"),
    "pyvista": ("tools/view.py",),
    "vtkmodules": ("tools/view.py",),
    "rerun": ("tools/report/rerun_file.py",),
    "selenium": ("tools/bench/chromium.py",),
    "PyEMD": ("localize/denoise.py",),
    "allantools": ("localize/imu_noise.py",),
    "networkx": ("tools/export.py",),
    "typer": ("tools/cli.py",),
    "rich": ("tools/",),
}
"""Library -> the files or folders that may import it."""

FILES = [path for room in ROOMS for path in sorted((ROOT / room).rglob("*.py"))]


def imported(path: Path) -> set[str]:
    """Dotted names of everything a file imports, wherever the import stands."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import; write the whole name"
            names.add(node.module or "")
    return names


def test_there_are_files_in_every_room() -> None:
    assert {path.relative_to(ROOT).parts[0] for path in FILES} == set(ROOMS)


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_a_file_imports_only_from_rooms_below(path: Path) -> None:
    room = path.relative_to(ROOT).parts[0]
    above = set(ROOMS[ROOMS.index(room) + 1 :]) | {"tests"}
    assert not {name for name in imported(path) if name.split(".")[0] in above}


@pytest.mark.parametrize("library", DOORS)
def test_a_heavy_library_has_one_door(library: str) -> None:
    users = [
        str(path.relative_to(ROOT)) for path in FILES if library in {name.split(".")[0] for name in imported(path)}
    ]
    assert [user for user in users if not user.startswith(DOORS[library])] == []


def test_the_check_sees_an_import_upwards(tmp_path: Path) -> None:
    file = tmp_path / "bad.py"
    file.write_text("def f():\n    import localize.graph\n    from tools import run\n")
    assert imported(file) == {"localize.graph", "tools"}
