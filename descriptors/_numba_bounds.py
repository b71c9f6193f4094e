"""Kernels that add up how much contours differ at least, for every yaw at once. Callers: `descriptors.bounds`.

A table holds, for each code a sector (or a pattern, four sectors) may have, its costs against the query at consecutive
offsets; a contour is a row of codes, and its costs at all yaws are a sum of stretches of the table. Indices are
unsigned: they cannot count from the end, and the loops over yaws become vector instructions.
"""

from __future__ import annotations

import numpy as np
from numba import njit

_U = np.uint64


@njit(cache=True)
def pattern_table(first, second, patterns, table):
    """Costs (patterns, width) of four sectors: those of their two pairs at the cheaper of two neighbouring yaws.

    first, second : (pairs, width + 1) costs of a pair at the two yaws; the second pair's stand one column before.
    patterns : (n, 2) the pairs of each.
    """
    for row in range(patterns.shape[0]):
        a, b = patterns[row, 0], patterns[row, 1]
        for column in range(table.shape[1]):
            one = first[a, column + 1] + first[b, column]
            other = second[a, column + 1] + second[b, column]
            table[row, column] = min(one, other)


@njit(cache=True)
def least_costs(table, width, codes, rows, step, barrier, costs):
    """The least cost over all yaws of some contours, to ``costs`` (k,).

    table : flat, ``width`` entries a code. codes : (n, g) of all contours; rows : (k,) which of them.
    step : by how many entries the next code's stretch begins earlier.
    barrier : (yaws,) cost to begin with: high where a yaw is not asked for.
    """
    groups, yaws = codes.shape[1], _U(len(barrier))
    total = np.empty(len(barrier), np.uint16)
    for k in range(len(rows)):
        code = codes[rows[k]]
        for t in range(yaws):
            total[t] = barrier[t]
        for g in range(0, groups - 3, 4):
            start = _U(step * (groups - 1 - g))
            a = _U(code[g]) * _U(width) + start
            b = _U(code[g + 1]) * _U(width) + start - _U(step)
            c = _U(code[g + 2]) * _U(width) + start - _U(2 * step)
            d = _U(code[g + 3]) * _U(width) + start - _U(3 * step)
            for t in range(yaws):
                total[t] += table[a + t] + table[b + t] + table[c + t] + table[d + t]
        for g in range(groups - groups % 4, groups):
            a = _U(code[g]) * _U(width) + _U(step * (groups - 1 - g))
            for t in range(yaws):
                total[t] += table[a + t]
        least = total[0]
        for t in range(1, yaws):
            least = min(least, total[t])
        costs[k] = least


@njit(cache=True)
def best_scores(table, width, codes, rows, barrier, unseen, query_seen, unit, unseen_cost, scores):
    """The highest score over all yaws that the costs of some contours allow, to ``scores`` (k,) float32.

    table, width, codes, rows, barrier : as in `least_costs`; a code a sector, step 1, costs in ``unit``.
    unseen : the code of a sector not observed, which costs ``unseen_cost`` where the query observed its own.
    query_seen : (width,) uint16, 1 where the query's sector that the table's column stands for was observed.
    """
    sectors, yaws = codes.shape[1], _U(len(barrier))
    total, lost = np.empty(len(barrier), np.uint16), np.empty(len(barrier), np.uint16)
    query = np.float32(query_seen[:sectors].sum())
    for k in range(len(rows)):
        stored = np.float32(sectors)
        for t in range(yaws):
            total[t] = barrier[t]
            lost[t] = 0
        for s in range(sectors):
            code, start = codes[rows[k], s], _U(sectors - 1 - s)
            a = _U(code) * _U(width) + start
            for t in range(yaws):
                total[t] += table[a + t]
            if code == unseen:
                stored -= np.float32(1.0)
                for t in range(yaws):
                    lost[t] += query_seen[start + t]
        best = np.float32(0.0)
        for t in range(yaws):
            both = query - np.float32(lost[t])
            either = stored + np.float32(lost[t])
            disagreement = unit * np.float32(total[t]) - unseen_cost * np.float32(lost[t])
            mean = (both - disagreement) / max(both, np.float32(1.0))
            best = max(best, mean * np.sqrt(np.sqrt(both / max(either, np.float32(1.0)))))
        scores[k] = best
