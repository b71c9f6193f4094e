"""Rows of different lengths, end to end in one array."""

from __future__ import annotations

from collections.abc import Sequence
from typing import overload

import numpy as np
from numpy.typing import NDArray

from semmap.geometry import Array


class Ragged(Sequence[Array]):
    """Rows of different lengths: a sequence of arrays, each a view made when it is asked for.

    Parameters
    ----------
    values : (n, ...) all rows, end to end.
    offsets : (rows + 1,) where each row begins, and where the last ends.
    """

    __slots__ = ("offsets", "values")

    def __init__(self, values: Array, offsets: NDArray[np.int64]) -> None:
        self.values, self.offsets = values, offsets

    def __len__(self) -> int:
        return len(self.offsets) - 1

    @overload
    def __getitem__(self, row: int) -> Array: ...
    @overload
    def __getitem__(self, row: slice) -> tuple[Array, ...]: ...
    def __getitem__(self, row: int | slice) -> Array | tuple[Array, ...]:
        number = range(len(self))[row]
        if isinstance(number, range):
            return tuple(self[k] for k in number)
        return self.values[self.offsets[number] : self.offsets[number + 1]]
