"""Point-cloud maps into a semantic database file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from maps.build import build_semantic_map
from maps.prior_map import read_prior_map
from semmap import database
from semmap.intersections import SemanticMap
from tools.files import writable_file
from tools.progress import progress_bar
from tools.settings import ToolSettings


def build_database(maps: Sequence[Path], out: Path, settings: ToolSettings) -> SemanticMap:
    """Read ``maps``, build the semantic map, save it to ``out``, with a bar for each of the long steps."""
    writable_file(out)
    with progress_bar("reading the prior map") as progress:
        prior = read_prior_map(maps, progress=progress)
    with progress_bar("building the semantic map") as progress:
        semantic_map = build_semantic_map(prior, settings.map, progress=progress)
    database.save(semantic_map, out)
    return semantic_map
