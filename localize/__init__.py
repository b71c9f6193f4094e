"""A recording and a semantic map into a trajectory.

`Localizer` is the way in: ``localizer.add(measurement)`` for each measurement in order of arrival, then
``localizer.finish()``.
"""

from localize.live import LiveLocalizer
from localize.localizer import Localizer
from localize.results import LocalizationResult, Update
from localize.settings import LocalizeSettings

__all__ = ["LiveLocalizer", "LocalizationResult", "LocalizeSettings", "Localizer", "Update"]
