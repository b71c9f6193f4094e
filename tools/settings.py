"""All settings in one file: what `--config` reads, `--dump-config` prints and `settings.yaml` keeps."""

from __future__ import annotations

from pathlib import Path

from pydantic import Field, NonNegativeInt

from localize.settings import LocalizeSettings
from maps.accumulate import ScanMapSettings
from maps.merge import MergeSettings
from maps.settings import MapSettings
from semmap.settings import Settings
from tools.simulator.settings import SimulationSettings


class ToolSettings(Settings):
    """Everything that can be set, one block a room."""

    seed: NonNegativeInt = 0
    """For everything random; `--seed` goes before it."""
    map: MapSettings = Field(default_factory=MapSettings)
    merge: MergeSettings = Field(default_factory=MergeSettings)
    scan_map: ScanMapSettings = Field(default_factory=ScanMapSettings)
    localize: LocalizeSettings = Field(default_factory=LocalizeSettings)
    simulate: SimulationSettings = Field(default_factory=SimulationSettings)


def load_settings(config: Path | None, seed: int | None) -> ToolSettings:
    """The settings of a command: the defaults, changed by ``config``, changed by ``seed``."""
    settings = ToolSettings() if config is None else ToolSettings.from_yaml(config)
    return settings if seed is None else settings.model_copy(update={"seed": seed})
