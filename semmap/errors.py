"""Typed errors. Each names what is wrong, where (file, field) and how to mend it.

Libraries raise them; only the command line turns them into one line and exit status 2.
"""

from __future__ import annotations

from pathlib import Path


class SemmapError(Exception):
    """Base of all errors a user can cause and mend.

    Parameters
    ----------
    what : what is wrong, one sentence without a full stop.
    file : the file at fault, if there is one.
    field : the key, topic, data set or column at fault, if there is one.
    mend : what the user can do about it.
    """

    def __init__(
        self, what: str, *, file: str | Path | None = None, field: str | None = None, mend: str | None = None
    ) -> None:
        self.what, self.file, self.field, self.mend = what, file, field, mend
        where = ": ".join(str(part) for part in (file, field) if part is not None)
        text = f"{where}: {what}" if where else what
        super().__init__(f"{text}; {mend}" if mend else text)


class InputFileError(SemmapError):
    """A file is missing, empty, truncated, or not of the format it claims."""


class RigError(SemmapError):
    """The rig file lacks or misspells something a sensor needs."""


class RecordingError(SemmapError):
    """A recording lacks a topic, has an unexpected message type, or breaks off."""


class CloudError(SemmapError):
    """A point cloud is empty, not finite, or lacks a field."""


class BuildError(SemmapError):
    """A build cannot go on: its work directory, workers or scheduler fail. What is finished of it is kept."""


class DatabaseError(SemmapError):
    """A file is not a semantic database, or not one this version reads."""


class SettingsError(SemmapError):
    """A settings file has an unknown key or a value out of range."""


class TrajectoryError(SemmapError):
    """A trajectory file is malformed, or two trajectories do not overlap in time."""


class MeasurementError(SemmapError):
    """A measurement handed to the library has the wrong shape, type, or non-finite content."""
