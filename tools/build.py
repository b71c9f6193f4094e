"""Point-cloud maps into a semantic database file."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

from maps.build import build_from_tiles
from maps.engine import engine
from maps.tile_files import tiled
from maps.tiles import TILE_M
from semmap import database
from semmap.intersections import SemanticMap
from tools.files import writable_file
from tools.progress import progress_bar
from tools.settings import ToolSettings


def build_database(
    maps: Sequence[Path],
    out: Path,
    settings: ToolSettings,
    *,
    workers: int = 1,
    scheduler: str | None = None,
    tile: float = TILE_M,
) -> SemanticMap:
    """Read ``maps``, build the semantic map, save it to ``out``, with a bar for each of the long steps.

    What is finished is kept beside ``out`` until all is done. workers, scheduler : see `maps.engine.engine`.
    tile : see `maps.tile_files.tiled`.
    """
    writable_file(out)
    work = out.with_name(f"{out.name}.work")
    with ExitStack() as stack:
        hands = stack.enter_context(engine(workers, scheduler))
        with progress_bar("reading the prior map") as progress:
            mine = stack.enter_context(tiled(maps, work, settings.map, hands, tile=tile, progress=progress))
        with progress_bar("building the semantic map") as progress:
            semantic_map = build_from_tiles(mine, settings.map, hands, progress=progress)
        database.save(semantic_map, out)
    return semantic_map
